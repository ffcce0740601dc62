"""The files of frames: a picture for each, and its layers."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from rainsim.compiling.pool import cores
from rainsim.io.files import write_json
from rainsim.io.fingerprint import hash_of_file
from rainsim.render import picture_processes
from rainsim.render.report import FrameReport

FRAME = "frames/{:05d}.png"
VERSION = 1  # of layers/NNNNN.json
WRITERS = min(max(cores() - 1, 1), 16)  # pictures encoded at a time


class FrameWriter:
    """Writes frames to a folder, several at a time, while the next ones are drawn.

    Use as a context manager: on the way out the frames that are being written are waited for.

    folder : Path
    noted : callable. noted(report, files) is called when all files of a frame are
        whole, for one frame after another; `files` are the hashes, or None, of
        names relative to the folder, the picture's first; the report has no
        layers any more.
    apart : int. Frames that processes encode in place of threads, where that is
        possible: no more processes are begun than there are frames.
    """

    def __init__(self, folder, noted, apart=0):
        self.folder, self._noted = folder, noted
        self._pending = deque()  # frames that are being written
        count = min(WRITERS, apart) if picture_processes.POSSIBLE else 0
        self._most = count or WRITERS
        self._encoders = picture_processes.PictureProcesses(count) if count else _Threads(WRITERS)
        # What draws notes frames itself where no other thread is to disturb it.
        self._notes = None if count else ThreadPoolExecutor(1)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        with ExitStack() as stack:  # whatever fails, the other frames are noted
            stack.callback(self._encoders.shutdown)
            if self._notes is not None:
                stack.callback(self._notes.shutdown)
            while self._pending:
                stack.callback(self._pending.pop().result)  # called in the opposite order

    def add(self, picture, report, also=None):
        """Begin to write a frame, once fewer than can be at a time are being written.

        picture : uint8 array (height, width, 3)
        report : FrameReport
        also : callable, optional. Called with the picture, or with that of a
            preview if processes encode, in the order of the frames, when it is
            written and before the frame is noted.
        Raises OSError if this frame's layers or a frame before could not be
            written.
        """
        self.wait(self._most - 1)
        (self.folder / "frames").mkdir(exist_ok=True)
        names = write_layers(self.folder, report) if report.aovs else ()
        written = self._encoders.submit(picture, self.folder / FRAME.format(report.index))
        about = written, replace(report, aovs={}, parts=None), names, also
        if self._notes is None:
            self._pending.append(_Later(written.done, partial(self._note, *about)))
        else:
            self._pending.append(self._notes.submit(self._note, *about))

    def wait(self, most=0):
        """Note the frames that are written; wait until at most so many are being written."""
        while self._pending and (len(self._pending) > most or self._pending[0].done()):
            self._pending.popleft().result()

    def _note(self, written, report, names, also):
        digest, picture = written.result()
        if also is not None:
            also(picture)
        self._noted(report, {FRAME.format(report.index): digest, **dict.fromkeys(names)})


class _Later(NamedTuple):
    """A future whose result is found when it is asked for."""

    done: Callable
    result: Callable


class _Threads(ThreadPoolExecutor):
    """Threads that encode pictures."""

    def submit(self, picture, path):
        picture = picture.copy()  # on a GPU the next frame overwrites it
        return super().submit(_encode, picture, path)


def _encode(picture, path):
    from rainsim.io import images

    images.write_png(path, picture)
    return hash_of_file(path), picture


def write_layers(folder, report):
    """Write a frame's layers as folder/layers/NAME/NNNNN.*, and the light that recomposing needs.

    An OpenEXR file with all in one is written before, if the report asks for it. Returns the names
    of the files.
    """
    if report.exr is None:
        return _write_apart(folder, report)
    from rainsim.render.exr_frame import write_exr

    whole = write_exr(folder, report)
    if not report.exr.layers:
        return [whole]
    apart = {name: report.aovs[name] for name in report.exr.layers}
    return [whole, *_write_apart(folder, replace(report, aovs=apart))]


def _write_apart(folder, report):
    from rainsim.io import images
    from rainsim.render.aov import AOVS, DATA, INDEX, PICTURE

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
            images.write_data(folder / path, values, AOVS[name].channels)
        else:
            images.write_png16(folder / path, np.rint(np.clip(values, 0, 1) * 65535))
        written.append(path)
    name = f"layers/{report.index:05d}.json"
    units = {n: AOVS[n].unit for n in report.aovs}
    about = {"light": report.light, "units": units, "files": written, **report.facts}
    about = {"rainsim_layers": VERSION, **about}
    write_json(folder / name, about)
    return [*written, name]


def facts_of(report):
    """Return a journal's facts of a frame besides its files; see `report_of`."""
    return {
        "time": report.time, "milliseconds": report.milliseconds, "ledger": report.ledger,
        "notes": list(report.notes),
    }  # fmt: skip


def report_of(index, entry):
    """Return the `FrameReport` of a frame that a journal notes, without its layers."""
    facts = entry["time"], entry["milliseconds"], entry["ledger"], tuple(entry["notes"])
    return FrameReport(index, *facts)


def mean_milliseconds(reports):
    """Return the mean time of each stage over frame reports [ms]."""
    stages = dict.fromkeys(stage for report in reports for stage in report.milliseconds)
    return {
        stage: round(sum(r.milliseconds.get(stage, 0.0) for r in reports) / len(reports), 3)
        for stage in stages
    }
