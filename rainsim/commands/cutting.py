"""`rainsim import --lod`: a large capture cut into chunks, and the scene that it then is."""

import threading
from dataclasses import replace
from pathlib import Path, PurePosixPath

from rainsim.errors import InputError
from rainsim.scene.formats.streamed import LOD_META

STAGE = "cut"


class CutChunks:
    """The chunks of a cut, on the record of its folder; with `resume` whole ones are kept."""

    def __init__(self, record, resume):
        self._record, self._resumes, self._lock = record, resume, threading.Lock()
        self._whole, self._number = {}, 0

    def begin(self):
        """Find what is kept of an unfinished cut, or remove the files of an earlier one."""
        from rainsim.output_folder import JOURNAL

        if self._resumes:
            self._record.resume(())
        self._record.begin()
        entries = self._record.journal.entries()
        self._number = max(entries, default=-1) + 1
        whole = self._record.journal.finished(entries) if self._resumes else {}
        self._whole = {PurePosixPath(next(iter(e["files"]))).parent: e for e in whole.values()}
        self._record.add(JOURNAL, LOD_META)

    def has(self, name):
        """Return whether a chunk of an unfinished cut is there, whole."""
        entry = self._whole.get(PurePosixPath(name).parent)
        if entry is not None:
            self._record.add(*entry["files"])
        return entry is not None

    def done(self, name):
        """Note a chunk whose files are whole."""
        with self._lock:  # two threads write chunks
            folder = (self._record.folder / name).parent
            names = sorted(p.relative_to(self._record.folder).as_posix() for p in folder.iterdir())
            self._record.journal.add(self._number, names)
            self._record.add(*names)
            self._number += 1


def require_cuttable(path):
    """Return the splat file that is to be cut and its model's folder, or raise an error."""
    from rainsim.actors.actor_files import actors_file
    from rainsim.scene.folder import SCENE_FILE, locate

    path = Path(path)
    if actors_file(path) is not None or (path / SCENE_FILE).is_file():
        raise InputError(
            f"{path} is no splat file; --lod cuts one; name the file, and the chunks as the scene "
            "of an actors.json where there are actors"
        )
    file, model = locate(path)
    if file.name == LOD_META:
        raise InputError(f"{file} is no plain splat file; --lod cuts a static set; leave --lod out")
    return file, model


def cut_to_scene(job, file, model):
    """Cut a splat file into chunks in the folder of a `Job`, set its scene; return the record."""
    from rainsim.commands.given import scene_of
    from rainsim.io.fingerprint import hash_of, hash_of_file
    from rainsim.lod.cut import cut
    from rainsim.output_folder import Record, input_facts
    from rainsim.scene.cameras import cameras_to_data, load_cameras
    from rainsim.scene.folder import cameras_beside
    from rainsim.scene.formats import splat_blocks, trained_antialiased
    from rainsim.scene.formats.extra import load_extra
    from rainsim.scene.origin import near_origin, origin_note
    from rainsim.scene.photographs import with_photographs
    from rainsim.scene.ply import origin_of

    out, given = job.out, {name: job.given[name] for name in job.given if name != "threads"}
    load_extra(out, "a set of chunks (SOG)", "imagecodecs")  # before the cut, which takes minutes
    cameras = given["cameras"]
    cameras, notes = load_cameras(cameras) if cameras else cameras_beside(file, model)
    origin = origin_of(file)
    cameras = near_origin(cameras, origin)
    blocks, _ = splat_blocks(file)
    record = Record(out, None, {
        "cut": hash_of_file(file), "cameras": hash_of(cameras_to_data(cameras)),
        "options": {name: str(value) for name, value in given.items()},
    })  # fmt: skip
    cut(
        out, blocks, tell=lambda done, total: job.status.progress(STAGE, done, total),
        antialiased=trained_antialiased(file), keep=CutChunks(record, job.resume),
    )  # fmt: skip
    beside, photos = given["cameras"], given["photos"]
    given |= {"cameras": cameras, "photos": None}
    scene = scene_of(str((out / LOD_META).resolve()), given)
    keep = given["ground_frame"] is not None
    scene = with_photographs(scene, file, beside, photos, keep)
    name = model.resolve().name if file.stem in ("point_cloud", "meta") else file.stem
    notes = *scene.notes, *notes, *origin_note(origin)
    job.set_scene(replace(scene, name=name, source=file, notes=notes, origin=origin))
    record.facts["input"] = input_facts(job.scene, out)
    return record
