"""`rainsim import --lod`: a large capture cut into chunks, and the scene that it then is."""

from dataclasses import replace
from functools import partial
from pathlib import Path

from rainsim.errors import InputError
from rainsim.scene.formats.streamed import LOD_META

STAGE = "cut"


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
    from rainsim.output_folder.facts import input_facts
    from rainsim.output_folder.names import OURS, names_in
    from rainsim.output_folder.record import Record
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
    }, job.resume)  # fmt: skip
    record.begin()
    tell = partial(job.status.progress, STAGE)
    cut(out, blocks, tell=tell, antialiased=trained_antialiased(file))
    record.add(*filter(OURS.fullmatch, names_in(out)))
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
