"""Output folders: checked before use, filled file by file, with a record of all written files.

`provenance.json` in a folder names the files that the program wrote there; only these are ever
removed or replaced, and only when new results are ready to take their place.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from rainsim import __version__
from rainsim.config.preset_files import SKIES
from rainsim.errors import InputError, ParameterError, one_line
from rainsim.io.claim import ClaimedError, claim
from rainsim.io.files import named_path, read_json, write_json
from rainsim.io.fingerprint import fingerprint, hash_of, hash_of_file
from rainsim.io.fingerprint import versions as library_versions
from rainsim.io.journal import SHARED_FOLDER, Journal
from rainsim.render.frame_files import FRAME, FrameWriter, facts_of, mean_milliseconds, report_of

PROVENANCE, RECORD_VERSION, VERSION = "provenance.json", "rainsim_record", 1
WRITER = {RECORD_VERSION: VERSION, "program": "rainsim", "version": __version__}
NOT_OF_THE_CONTENT = ("preset", "terrain_input")  # facts that name things and change none
CLAIM = ".rainsim-claim"  # locked by the run that writes to the folder
# Names that the program gives to files; other names in a provenance file are ignored.
OURS = re.compile(
    r"frames/\d{5}\.png|states/\d{5}\.npz|preview\.webp|(terrain|splats|actors)\.npz"
    r"|(scene|ground_frame|simulation|transforms)\.json|(bed|top)\.tif|puddles-\d+mm\.png"
    r"|(hillshade|classes|check)\.png|video\.(mp4|mov)|finished\.jsonl|lod-meta\.json"
    r"|layers/(\d{5}\.json|[a-z_]+/\d{5}\.(png|exr|npz))|(env|\d+_\d+)/\w+\.(webp|json)"
)
JOURNAL = "finished.jsonl"  # which frames or states are finished
STATE = "states/{:05d}.npz"
STATE_FACTS = {"ledger": dict, "notes": list}  # what the journal says of a state, and of a frame
FRAME_FACTS = STATE_FACTS | {"time": float, "milliseconds": dict}
# Files of a run that was killed while it wrote them, see `rainsim.io.files.replacing`.
TEMPORARY = re.compile(r"\.([\w.-]+)\.[a-z0-9_]{8}(\.[a-z0-9]+)?")
FOLDERS = ("", "frames", "states", "layers", "layers/*", "env", "[0-9]*_[0-9]*")
VERSIONS_OF = ("numpy", "scipy", "numba", "llvmlite", "pillow")


@contextmanager
def claimed(path, overwrite=False, resume=False, sources=()):
    """Check and make an output folder and yield it; remove it again if it stays empty.

    Parameters
    ----------
    path : path-like
        Made, with the folders above it, if it does not exist.
    overwrite : bool
        Whether it may hold files already. Earlier results are replaced, other files stay.
    resume : bool
        Whether it may hold an unfinished run, see `Record.resume`.
    sources : iterable of path-like or None
        What the run reads: results in the folder are not replaced while they are read.

    Raises
    ------
    ParameterError
        If it holds files and `overwrite` is not set, is no folder, or another run writes to it; or
        if results would replace what the run reads or files that no record of a run lists.
    OSError
        If it cannot be made or written to.
    """
    path = Path(path)
    require_no_file(path)
    _require_empty(path, overwrite or resume)
    made = [p for p in (path, *path.parents) if not p.exists()]
    try:
        with claim(path / CLAIM):
            _require_empty(path, overwrite or resume)  # another run may have been first
            if overwrite and not resume:
                _require_replaceable(path, sources)
            tempfile.TemporaryFile(dir=path).close()  # before hours of work, not after
            yield path
    except ClaimedError as error:
        raise ParameterError(
            f"another run writes to output folder {path} ({error}); each run needs its own; give "
            f"another --out, or remove {path / CLAIM} if that run has ended"
        ) from None
    finally:
        for folder in (path / "frames", path / "states", path / "layers", *made):
            with suppress(OSError):  # it is not empty, or not there
                folder.rmdir()


def require_no_file(path):
    """Raise ParameterError if an output folder's path is that of a file."""
    if path.exists() and not path.is_dir():
        raise ParameterError(f"output {path} is a file; it must be a folder; give another --out")


def _require_empty(path, overwrite):
    if path.is_dir() and not overwrite and any(entry.name != CLAIM for entry in path.iterdir()):
        raise ParameterError(
            f"output folder {path} exists and is not empty; it must be new or empty; "
            "give another --out, --overwrite to replace results in it, or --resume to go on with "
            "an unfinished run"
        )


def _require_replaceable(path, sources):
    """Raise ParameterError if new results in `path` would cost more than results of before."""
    record, here = read_record(path), path.resolve()
    for source in (Path(source).resolve() for source in sources if source is not None):
        is_ours = source.parent == here and OURS.fullmatch(source.name)
        if is_ours or (record and source == here):
            raise ParameterError(
                f"output folder {path} holds what this run reads, {one_line(source.name)}; "
                "--overwrite would remove it; give another --out"
            )
    if record and not record.get("complete"):
        return  # a killed run leaves a file or two that it had no time to note
    noted = Journal(path, JOURNAL, OURS.fullmatch).entries().values()
    known = {*_files_of(record), *(name for entry in noted for name in entry["files"])}
    known |= {JOURNAL, PROVENANCE} if record else set()
    for name in sorted(_names_in(path)):
        if (name == PROVENANCE or OURS.fullmatch(name)) and name not in known:
            raise ParameterError(
                f"{path / name} is on no record of a run; --overwrite replaces recorded results "
                "only; give another --out, or move the file away"
            )


def _names_in(folder):
    """Yield the names of all files where the program writes, relative to the folder."""
    for pattern in FOLDERS:
        for path in folder.glob(f"{pattern}/*".lstrip("/")):
            if path.is_file():
                yield path.relative_to(folder).as_posix()


class Record:
    """The record of a run: `provenance.json` in its output folder.

    Parameters
    ----------
    folder : Path
    scene : Scene or None
    content : dict, optional
        Plain JSON values that the results depend on besides the scene and the facts, or in place
        of facts of the same name.
    **facts
        More entries; they must be plain JSON values.
    """

    def __init__(self, folder, scene=None, content=None, **facts):
        self.folder, self._start = folder, time.perf_counter()
        self.facts = {
            **WRITER,
            "command": ["rainsim", *sys.argv[1:]],
            "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "versions": versions(),
            "input": input_facts(scene, folder),
            **facts,
        }
        own = {k: v for k, v in facts.items() if k not in NOT_OF_THE_CONTENT}
        own |= content or {}
        self.fingerprint = fingerprint({"scene": scene_content(scene), **own})
        self.files, self.shared = [], False
        self.journal = Journal(folder, JOURNAL, OURS.fullmatch)

    def share(self, name):
        """Leave the folder to other processes of the same run too; `name` is this one's."""
        self.shared = True
        self.journal = Journal(self.folder, JOURNAL, OURS.fullmatch, name)

    def begin(self):
        """Delete the files of an earlier run, unless it was the same, and write this record."""
        before = read_record(self.folder)
        noted = (name for entry in self.journal.entries().values() for name in entry["files"])
        kept = sorted({*_files_of(before), *noted})
        if before.get("fingerprint") == self.fingerprint:
            self.files = kept  # other frames of the same frame sequence
        else:
            for name in (*kept, JOURNAL):
                (self.folder / name).unlink(missing_ok=True)
            shutil.rmtree(self.folder / SHARED_FOLDER, ignore_errors=True)
        if not self.shared:
            self.journal.gather()
            shutil.rmtree(self.folder / SHARED_FOLDER, ignore_errors=True)
        self.journal.begin_line()
        for name in list(_names_in(self.folder)):
            folder, _, last = name.rpartition("/")
            while temporary := TEMPORARY.fullmatch(last):  # of a temporary file, too
                last = temporary[1]
            meant = f"{folder}/{last}".lstrip("/")
            if meant != name and (meant == PROVENANCE or OURS.fullmatch(meant)):
                (self.folder / name).unlink()
        self.write(complete=False)  # first of all: a run that is killed can be gone on with

    def resume(self, indices, part=FRAME, facts=FRAME_FACTS):
        """Return the journal's entries of the finished parts among `indices`, by index.

        Parameters
        ----------
        indices : sequence of int
        part : str
            Name of the file that each part has, with its index to be filled in.
        facts : dict of str to type
            What an entry must hold.

        Raises
        ------
        ParameterError
            If the folder holds something else than a run with the same fingerprint.
        """
        # First the files, then the record: others may just begin, and write the record first.
        found = [path.name for path in self.folder.iterdir()]
        own = (CLAIM, SHARED_FOLDER)
        others = [name for name in found if name not in own and not TEMPORARY.fullmatch(name)]
        before = read_record(self.folder)
        if not before:
            if others:
                raise ParameterError(
                    f"output folder {self.folder} holds {one_line(others[0])} and no record of a "
                    "run; --resume and --frame-range go on with an unfinished run only; give "
                    "another --out"
                )
        elif before.get("fingerprint") != self.fingerprint:
            raise self.was_another()
        return {
            index: entry
            for index, entry in self.journal.finished(indices).items()
            if part.format(index) in entry["files"]
            and all(isinstance(entry.get(name), kind) for name, kind in facts.items())
        }

    def was_another(self):
        """Return the error for a folder that holds another run."""
        return ParameterError(
            f"the run in {self.folder} was another: other scene, settings, cameras, layers, "
            "version of rainsim or of its libraries; --resume and --frame-range go on with the "
            "very same run only; give another --out, or --overwrite to replace its results"
        )

    def add(self, *names):
        """Note that files, named relative to the folder, are written."""
        self.files += [name for name in names if name not in self.files]

    def write(self, complete, **facts):
        """Write the record as it stands."""
        self.facts.update(facts)
        write_json(
            self.folder / PROVENANCE,
            {
                **self.facts,
                "complete": complete,
                "seconds": round(time.perf_counter() - self._start, 3),
                "fingerprint": self.fingerprint,
                "files": sorted(self.files),
            },
        )


def _files_of(record):
    """Return the names of the program's files that a record lists."""
    listed = record.get("files") if isinstance(record.get("files"), list) else []
    return [f for f in listed if isinstance(f, str) and OURS.fullmatch(f)]


def settings_content(config):
    """Return the settings that results depend on: without paths, threads and frame range."""
    settings = config.as_dict()
    settings["threads"] = settings["frame_range"] = None
    if config.render.sky not in SKIES:
        settings["render"]["sky"] = hash_of_file(config.render.sky)
    return settings


def states_content(folder):
    """Return the parts of a folder of states that frames depend on, as plain values."""
    return {
        "terrain": hash_of_file(folder / "terrain.npz"),
        "simulation": read_record(folder).get("fingerprint"),
    }


def scene_content(scene):
    """Return the parts of a scene that results depend on, as plain values; None without one."""
    if scene is None:
        return None
    from rainsim.scene.cameras import cameras_to_data
    from rainsim.scene.ground import ground_frame_to_dict

    frame = ground_frame_to_dict(scene.ground_frame)
    return {
        "sha256": scene.source_hash, "splats": len(scene.splats), "drains": scene.drains,
        "ground_frame": {name: frame[name] for name in frame if name != "notes"},
        "cameras": hash_of(cameras_to_data(scene.cameras)), "painted": scene.painted_hash,
    }  # fmt: skip


def host_facts():
    """Return the host and process that draw frames, which may differ between frames of one run."""
    return {"name": platform.node(), "platform": platform.platform(), "process": os.getpid()}


def read_record(folder):
    """Return the record of an earlier run in a folder, {} if nothing readable by this version."""
    try:
        record = read_json(Path(folder) / PROVENANCE, "a record")
    except (OSError, InputError):
        return {}
    ours = isinstance(record, dict) and record.get("program") == "rainsim"
    return record if ours and record.get(RECORD_VERSION, VERSION) == VERSION else {}


def settings_facts(config, preset):
    """Return the settings for a record, without threads and frame range, which change no frame."""
    settings = config.as_dict()
    settings["threads"] = settings["frame_range"] = None
    return {
        "preset": str(preset),
        "seed": config.rain.seed,
        "settings": settings,
        "settings_units": "SI: m, s, m/s, rad; px",
    }


def input_facts(scene, folder):
    """Return name, source, hash and ground frame of a scene as plain values; None without one.

    The source is named as a record in `folder` names it, see `rainsim.io.files.named_path`.
    """
    if scene is None:
        return None
    from rainsim.scene.ground import ground_frame_to_dict

    return {
        "scene": scene.name,
        "source": None if scene.source is None else named_path(scene.source, folder),
        "sha256": scene.source_hash,
        "splats": len(scene.splats),
        "ground_frame": ground_frame_to_dict(scene.ground_frame),
        "notes": list(scene.notes),
    }


def cameras_facts(cameras):
    """Return number and hash of the frames' cameras; transforms.json holds the cameras."""
    from rainsim.scene.cameras import cameras_to_data

    return {"count": len(cameras), "sha256": hash_of(cameras_to_data(cameras))}


def versions():
    """Return the versions of Python and of the libraries that the numbers depend on."""
    return {**library_versions(VERSIONS_OF), "platform": platform.platform()}


class FrameFolder:
    """Writes frames one by one as DIR/frames/NNNNN.png, with cameras, preview, video and record.

    Use as a context manager around the loop over frames: if the loop is interrupted, finished
    frames are kept and recorded. Nothing in the folder changes before the first frame. A frame is
    written in a thread of its own while the next one is drawn. A frame and its layers are noted in
    the journal when they are whole.

    Parameters
    ----------
    folder : Path
        As `claimed` yields it.
    record : Record
    cameras : sequence of Camera
        One per frame of the whole sequence, or one for all.
    config : Config
    video : VideoFormat or None
        What video to write too.
    resume : bool
        Whether to go on with an unfinished run in the folder.

    Attributes
    ----------
    kept : dict of int to dict
        The journal's entries of the frames that need not be drawn, by index.
    """

    def __init__(self, folder, record, cameras, config, video=None, resume=False):
        from rainsim.io import images

        self._image, self.folder, self.record = images, folder, record
        self._cameras, self._config = cameras, config
        self.kept = record.resume(config.indices) if resume else {}
        self._preview = images.Preview(len(config.indices), config.fps)
        self._stack, self._video = ExitStack(), None
        self._format = video
        self._writer = FrameWriter(folder, self._note)
        self._has_begun, self.reports = False, []

    def __enter__(self):
        return self

    def add(self, picture, report):
        """Begin to write the next frame, when the one before is written.

        Raises
        ------
        OSError
            If this frame's layers or the frame before could not be written.
        """
        self._writer.wait()
        self._begin()
        self._keep_until(report.index)
        self._writer.add(picture, report, self._show)

    @property
    def done(self):
        """Number of frames that were kept or handed over."""
        return len(self.kept) + len(self.reports) + self._writer.is_writing

    def _show(self, picture):
        """Add a frame to preview and video."""
        self._preview.add(picture)
        if self._video is not None:
            self._video.add(picture)

    def _note(self, report, names):
        """Enter a written frame in the record and its journal."""
        self.record.add(JOURNAL, *names)
        self.record.journal.add(report.index, names, **facts_of(report), host=host_facts())
        self.reports.append(report)

    def _keep_until(self, end):
        """Take over the finished frames of an earlier run up to the frame `end`."""
        for index in [index for index in sorted(self.kept) if index < end]:
            entry = self.kept.pop(index)
            self._show(self._image.read_image(self.folder / FRAME.format(index)))
            self.record.add(JOURNAL, *entry["files"])
            self.reports.append(report_of(index, entry))

    def _begin(self):
        from rainsim.io.video import VideoWriter
        from rainsim.scene.cameras import write_transforms

        if self._has_begun:
            return
        self._has_begun = True
        self.record.begin()
        count = self._config.frames
        cameras = list(self._cameras) if len(self._cameras) > 1 else [self._cameras[0]] * count
        names = [FRAME.format(i) for i in range(count)]
        write_transforms(self.folder / "transforms.json", cameras[:count], names)
        self.record.add("transforms.json")
        if self._format:
            path = self.folder / self._format.name
            writer = VideoWriter(path, self._config.fps, self._format)
            self._video = self._stack.enter_context(writer)

    def __exit__(self, kind, *exception):
        try:
            with self._writer:
                pass
            if kind is None and self.kept:
                self._begin()
                self._keep_until(self._config.frames)
        finally:
            self._stack.close()
            self._finish(kind is None)

    def _finish(self, undisturbed):
        """Write the preview and the record of the written frames."""
        if not self.reports:
            return
        self._preview.write(self.folder / "preview.webp")
        self.record.add("preview.webp", *([self._format.name] if self._video else []))
        self.record.write(
            complete=undisturbed and len(self.reports) == len(self._config.indices),
            frames=[report.index for report in self.reports],
            milliseconds=mean_milliseconds(self.reports),
            ledger=self.reports[-1].ledger,
            notes=list(dict.fromkeys(note for r in self.reports for note in r.notes)),
        )


def relative(path):
    """Return a path as messages show it, str.

    It is relative to the current folder if it lies below that folder, else as given.
    """
    path = Path(path)
    try:
        short = os.path.relpath(path)
    except ValueError:  # another drive
        return str(path)
    return str(path) if short.startswith("..") else short
