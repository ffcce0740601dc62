"""Output folders: checked before use, filled file by file, with a record of what was written.

`provenance.json` in a folder names the files that the program wrote there; only these are ever
removed, and only when new results are ready to take their place.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np

from rainsim import __version__
from rainsim.errors import InputError, ParameterError
from rainsim.io.claim import ClaimedError, claim
from rainsim.io.files import read_json, write_json

PROVENANCE = "provenance.json"
CLAIM = ".rainsim-claim"  # locked by the run that writes to the folder
# Names that the program gives to files; other names in a provenance file are ignored.
OURS = re.compile(
    r"frames/\d{5}\.png|states/\d{5}\.npz|preview\.webp|video\.mp4|transforms\.json"
    r"|(terrain|splats)\.npz|(scene|ground_frame|simulation)\.json|(bed|top)\.tif"
    r"|(hillshade|classes|check|puddles-\d+mm)\.png"
    r"|layers/(\d{5}\.json|[a-z_]+/\d{5}\.(png|exr|npz))"
)
VERSIONS_OF = ("numpy", "scipy", "numba", "llvmlite", "pillow")


@contextmanager
def claimed(path, overwrite=False):
    """Check and make an output folder and yield it; remove it again if it stays empty.

    Parameters
    ----------
    path : path-like
        Made, with the folders above it, if it does not exist.
    overwrite : bool
        Whether it may hold files already. Earlier results are replaced, other files stay.

    Raises
    ------
    ParameterError
        If it holds files and `overwrite` is not set, is no folder, or another run writes to it.
    OSError
        If it cannot be made or written to.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise ParameterError(f"output {path} is a file; it must be a folder; give another --out")
    _require_empty(path, overwrite)
    made = [p for p in (path, *path.parents) if not p.exists()]
    try:
        with claim(path / CLAIM):
            _require_empty(path, overwrite)  # another run may have been first
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


def _require_empty(path, overwrite):
    if path.is_dir() and not overwrite and any(entry.name != CLAIM for entry in path.iterdir()):
        raise ParameterError(
            f"output folder {path} exists and is not empty; it must be new or empty; "
            "give another --out, or --overwrite to replace results in it"
        )


class Record:
    """The record of a run: `provenance.json` in its output folder.

    Parameters
    ----------
    folder : Path
    scene : Scene or None
    **facts
        More entries; they must be plain JSON values.
    """

    def __init__(self, folder, scene=None, **facts):
        self.folder, self._start = folder, time.perf_counter()
        self.facts = {
            "program": "rainsim",
            "version": __version__,
            "command": ["rainsim", *sys.argv[1:]],
            "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "versions": versions(),
            "input": input_facts(scene, folder),
            **facts,
        }
        self.fingerprint = _hash(
            {k: v for k, v in self.facts.items() if k not in ("command", "started")}
        )
        self.files = []

    def begin(self):
        """Delete the files of an earlier run, unless it had the same input and settings."""
        before = read_record(self.folder)
        listed = before.get("files") if isinstance(before.get("files"), list) else []
        kept = [f for f in listed if isinstance(f, str) and OURS.fullmatch(f)]
        if before.get("fingerprint") == self.fingerprint:
            self.files = kept  # other frames of the same frame sequence
        else:
            for name in kept:
                (self.folder / name).unlink(missing_ok=True)

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


def read_record(folder):
    """Return what an earlier run recorded in a folder, {} if nothing readable."""
    try:
        record = read_json(Path(folder) / PROVENANCE, "a record")
    except (OSError, InputError):
        return {}
    ours = isinstance(record, dict) and record.get("program") == "rainsim"
    return record if ours else {}


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

    The source is named as a record in `folder` names it, see `named_path`.
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


def named_path(path, folder):
    """Return how a record in `folder` names a path: as seen from the folder unless it is absolute.

    The record then means the same path wherever a later command is started.
    """
    path = Path(path)
    if path.is_absolute():
        return str(path)
    return os.path.relpath(path.resolve(), Path(folder).resolve())


def path_named(name, folder):
    """Return the path that a record in `folder` names."""
    seen = Path(folder) / name
    # Older records name paths as seen from where the command was started.
    return seen if seen.exists() or not Path(name).exists() else Path(name)


def cameras_facts(cameras):
    """Return number and hash of the frames' cameras; transforms.json holds the cameras."""
    from rainsim.scene.cameras import cameras_to_data

    return {"count": len(cameras), "sha256": _hash(cameras_to_data(cameras))}


def versions():
    """Return the versions of Python and of the libraries that the numbers depend on."""
    found = {"python": platform.python_version(), "platform": platform.platform()}
    for name in VERSIONS_OF:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found


def _hash(facts):
    text = json.dumps(facts, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


class FrameFolder:
    """Writes frames one by one as DIR/frames/NNNNN.png, with cameras, preview, video and record.

    Use as a context manager around the loop over frames: if the loop is interrupted, finished
    frames are kept and recorded. Nothing in the folder changes before the first frame. A frame is
    written in a thread of its own while the next one is drawn.

    Parameters
    ----------
    folder : Path
        As `claimed` yields it.
    record : Record
    cameras : sequence of Camera
        One per frame of the whole sequence, or one for all.
    config : Config
    video : bool
        Whether to write video.mp4 too.
    """

    def __init__(self, folder, record, cameras, config, video=False):
        from rainsim.io import images

        self._image, self.folder, self.record = images, folder, record
        self._cameras, self._config = cameras, config
        self._preview = images.Preview(len(config.indices), config.fps)
        self._stack = ExitStack()
        self._video = None
        self._wants_video = video
        self._writer, self._written = ThreadPoolExecutor(1), None  # the frame that is being written
        self.reports = []

    def __enter__(self):
        return self

    def add(self, picture, report):
        """Begin to write the next frame, when the one before is written.

        Raises
        ------
        OSError
            If this frame's layers or the frame before could not be written.
        """
        self._finish_frame()
        if not self.reports:
            self._begin()
        names = write_layers(self.folder, report) if report.aovs else ()
        # A copy: on a GPU the next frame overwrites the picture.
        written = self._writer.submit(self._write, picture.copy(), report.index)
        self._written = written, names, replace(report, aovs={})

    def _write(self, picture, index):
        """Write a frame's picture; return its name."""
        name = f"frames/{index:05d}.png"
        self._image.write_png(self.folder / name, picture)
        self._preview.add(picture)
        if self._video is not None:
            self._video.add(picture)
        return name

    def _finish_frame(self):
        """Wait for the frame that is being written and record it."""
        if self._written is not None:
            (written, names, report), self._written = self._written, None
            self.record.add(written.result(), *names)
            self.reports.append(report)

    def _begin(self):
        from rainsim.scene.cameras import write_transforms

        self.record.begin()
        (self.folder / "frames").mkdir(exist_ok=True)
        count = self._config.frames
        cameras = list(self._cameras) if len(self._cameras) > 1 else [self._cameras[0]] * count
        names = [f"frames/{i:05d}.png" for i in range(count)]
        write_transforms(self.folder / "transforms.json", cameras[:count], names)
        self.record.add("transforms.json")
        self.record.write(complete=False)
        if self._wants_video:
            writer = self._image.VideoWriter(self.folder / "video.mp4", self._config.fps)
            self._video = self._stack.enter_context(writer)

    def __exit__(self, kind, *exception):
        try:
            self._finish_frame()
        finally:
            self._writer.shutdown()
            self._stack.close()
            self._finish(kind is None)

    def _finish(self, undisturbed):
        """Write preview and record of what was written."""
        if not self.reports:
            return
        self._preview.write(self.folder / "preview.webp")
        self.record.add("preview.webp", *(["video.mp4"] if self._video is not None else []))
        self.record.write(
            complete=undisturbed and len(self.reports) == len(self._config.indices),
            frames=[report.index for report in self.reports],
            milliseconds=mean_milliseconds(self.reports),
            ledger=self.reports[-1].ledger,
            notes=list(dict.fromkeys(note for r in self.reports for note in r.notes)),
        )


def write_layers(folder, report):
    """Write a frame's layers as folder/layers/NAME/NNNNN.*, and the light that recomposing needs.

    Returns the names of the files.
    """
    from rainsim.io import images
    from rainsim.render.aov import AOVS, DATA, INDEX, PICTURE, channels

    written = []
    for name, values in report.aovs.items():
        kind = AOVS[name].kind
        end = "png" if kind != DATA else images.data_suffix()
        path = f"layers/{name}/{report.index:05d}.{end}"
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        if kind == PICTURE:
            images.write_png(folder / path, values)
        elif kind == INDEX:
            images.write_png16(folder / path, values)
        elif kind == DATA:
            images.write_data(folder / path, values, channels(name))
        else:
            images.write_png16(folder / path, np.rint(np.clip(values, 0, 1) * 65535))
        written.append(path)
    name = f"layers/{report.index:05d}.json"
    units = {n: AOVS[n].unit for n in report.aovs}
    write_json(folder / name, {"light": report.light, "units": units, "files": written})
    return [*written, name]


def mean_milliseconds(reports):
    """Return the mean time of each stage over frame reports [ms]."""
    stages = dict.fromkeys(stage for report in reports for stage in report.milliseconds)
    return {
        stage: round(sum(r.milliseconds.get(stage, 0.0) for r in reports) / len(reports), 3)
        for stage in stages
    }


def relative(path):
    """Return a path relative to the current folder if it lies below, else as it is."""
    path = Path(path)
    try:
        short = os.path.relpath(path)
    except ValueError:  # another drive
        return str(path)
    return str(path) if short.startswith("..") else short
