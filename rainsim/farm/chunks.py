"""Which worker draws which frames, and whether it has: no engine is known here."""

from __future__ import annotations

import hashlib
import statistics
import time
from collections import Counter
from dataclasses import dataclass

from rainsim.errors import InputError, RainsimError
from rainsim.io.files import replacing
from rainsim.io.fingerprint import hash_of_file
from rainsim.output_folder import FRAME_FACTS
from rainsim.render.frame_files import FRAME

MOST_IN_CHUNK = 16  # frames
CHUNKS_LEFT = 2  # for each worker, of the frames that are left: the last chunks are small
MOST_TRIES = 5  # of one frame
LEAST_PATIENCE = 60.0  # s, and PATIENCE times the median of a frame for each: a worker hangs
PATIENCE = 20
FIRST_PATIENCE = 1800.0  # s for the first chunk of a worker, which compiles


@dataclass
class Chunk:
    """Frames that a worker is at."""

    indices: list
    steps: int  # frames that the worker simulates or draws for it
    begun: float  # s


class Chunks:
    """Gives frames to workers until all are drawn.

    One frame is given to a worker `tries` times at most. A chunk may take at least `patience` [s],
    the first one of a worker `first` [s], before its worker counts as hanging.
    """

    def __init__(self, indices, tries=MOST_TRIES, patience=LEAST_PATIENCE, first=FIRST_PATIENCE):
        self._all, self._most = sorted(indices), tries
        self._open, self._begun = self._all, set()
        self._patience, self._first = patience, first
        self._at, self._next, self._drawn = {}, {}, Counter()  # by worker
        self._tries, self._seconds = Counter(), []

    @property
    def left(self):
        """Number of frames that are not drawn."""
        return len(self._open) + sum(len(chunk.indices) for chunk in self._at.values())

    def give(self, worker, workers):
        """Return the frames that a worker is to draw next, of so many workers; [] without any.

        They lie behind those that it drew before, if there are any such: its water goes on. Each
        begins with a part of its own, so that not all of them simulate what the others draw.
        """
        position = reached = self._next.get(worker, 0)
        if worker not in self._begun:
            part = len(self._begun) % workers
            position = self._all[part * len(self._all) // workers]
            self._begun.add(worker)
        ahead = [i for i in self._open if i >= position] or self._open
        if not ahead:
            return []
        count = min(max(len(self._open) // (CHUNKS_LEFT * workers), 1), MOST_IN_CHUNK)
        if self._tries[ahead[0]]:
            count = 1  # a frame that ends its worker takes no others along
        indices = [i for i in ahead[:count] if i - ahead[0] < MOST_IN_CHUNK]
        indices = [i for i in indices if i == ahead[0] or not self._tries[i]]
        self._open = [i for i in self._open if i not in indices]
        begin = reached if reached <= indices[0] else 0
        self._at[worker] = Chunk(indices, indices[-1] + 1 - begin, time.monotonic())
        return indices

    def drawn(self, worker):
        """Note that a worker has drawn its chunk; return the frames."""
        chunk = self._at.pop(worker)
        self._drawn[worker] += 1
        self._next[worker] = chunk.indices[-1] + 1
        self._seconds.append((time.monotonic() - chunk.begun) / len(chunk.indices))
        return chunk.indices

    def failed(self, worker, why):
        """Take back the chunk that a worker was given, and did not draw.

        RainsimError if one of the frames was given to workers too often.
        """
        chunk = self._at.pop(worker, None)
        self._next.pop(worker, None)
        for index in chunk.indices if chunk else ():
            self._tries[index] += 1
            if self._tries[index] >= self._most:
                raise RainsimError(
                    f"frame {index} was given to workers {self._most} times and not drawn; each "
                    f"must be drawn by one; the last time {why}; draw it alone with "
                    f"--frame-range {index}:{index + 1} to see what is wrong"
                )
        self._open = sorted([*self._open, *(chunk.indices if chunk else ())])

    def taken_back(self, worker):
        """Take back the chunk that a worker was given and could not begin with."""
        self._open = sorted([*self._open, *self._at.pop(worker).indices])
        self._next.pop(worker, None)

    def hangs(self, worker):
        """Whether a worker takes far longer than others took for their frames."""
        chunk = self._at[worker]
        limit = self._patience
        if self._seconds:
            limit += PATIENCE * statistics.median(self._seconds) * chunk.steps
        if not self._drawn[worker]:
            limit = max(limit, self._first)
        return time.monotonic() - chunk.begun > limit


def accept(frames, indices, folder, shape, is_ours):
    """Write the files of frames that were sent; return the fault in words, None if all is well.

    `frames` is what `worker.draw_chunk` returns, or what came in its place; `indices` were asked
    for. The files are written to the folder, or are there already; `shape` is that of the pictures.
    is_ours(name) says whether a name is one that the program gives to files.
    """
    if not isinstance(frames, list) or [_get(f, "index", int) for f in frames] != indices:
        return "other frames came than it was asked for"
    for frame in frames:
        files, sent = _get(frame, "files", dict) or {}, _get(frame, "bytes", dict)
        picture = FRAME.format(frame["index"])
        if picture not in files or not all(isinstance(n, str) and is_ours(n) for n in files):
            return f"frame {frame['index']} came with other files than frames have"
        if not _are_facts(frame.get("facts")):
            return f"what came of frame {frame['index']} is not complete"
        for name, known in files.items():
            if sent is not None and not _written(folder / name, sent.get(name), known):
                return f"{name} came damaged: its SHA-256 is another"
            if not (folder / name).is_file() or hash_of_file(folder / name) != known:
                return f"{name} is damaged: its SHA-256 is another"
        if not _is_picture(folder / picture, shape):
            return f"{picture} is no picture of {shape[1]} x {shape[0]} px"
    return None


def _written(path, content, known):
    """Write sent bytes as a file; return False if their hash is not the known one."""
    if not isinstance(content, bytes) or hashlib.sha256(content).hexdigest() != known:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return True


def _get(mapping, name, kind):
    value = mapping.get(name) if isinstance(mapping, dict) else None
    return value if isinstance(value, kind) else None


def _is_picture(path, shape):
    from rainsim.io.images import read_image

    try:
        return read_image(path).shape == (*shape, 3)
    except InputError:
        return False


def _are_facts(facts):
    return isinstance(facts, dict) and all(
        isinstance(facts.get(name), kind) for name, kind in FRAME_FACTS.items()
    )
