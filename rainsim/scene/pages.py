"""The splats of a big capture, read from its chunks when they are asked for and kept for a while.

What is kept stays below a limit in bytes; what was used longest ago goes first. Whether something
was kept or is read again changes no number.
"""

import threading
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from rainsim.errors import InputError
from rainsim.io.allocator import return_large_blocks
from rainsim.scene.activate import MAX_BROKEN_SHARE
from rainsim.scene.formats.streamed import NONE, read_chunk, require_run
from rainsim.scene.splat_sets import joined
from rainsim.scene.types import Splats

OVERVIEW = 400_000  # splats of a level that the whole scene is known by, at most
DEFAULT_MEMORY = 0.6e9  # bytes
PICTURE = 0.4  # of the memory, that the splats of a picture take at most
READ = 0.15  # of the memory, for runs as they were read
ALWAYS = -1  # number of the leaf that stands for the splats which are always drawn
_READER = ThreadPoolExecutor(1)  # reads ahead


class Pages:
    """The runs of a `ChunkTree`, read when needed.

    memory : float [bytes]. That the splats may take, see `limit`.
    change : Change, optional. What is drawn in place of the capture's own splats.
    memory, picture_memory : float [bytes]
    kept : Kept. Prepared pages, such as `lod.paged.Page`; shared by all that
        draw.
    read : Kept. Runs as they were read. They are kept apart from prepared pages,
        since a map of the ground reads many runs once, and must not displace
        pages that every picture needs.
    """

    def __init__(self, tree, memory=DEFAULT_MEMORY, change=None):
        self.tree, self.change, self.kept, self.read = tree, change, Kept(0), Kept(0)
        return_large_blocks()
        self._reading, self._ahead = threading.Lock(), None
        self.limit(memory)

    def limit(self, memory):
        """Let the splats take `memory` [bytes], those of one picture two fifths of it."""
        self.memory, self.picture_memory = memory, PICTURE * memory
        self.kept.most, self.read.most = (1 - READ) * memory, READ * memory

    def __getstate__(self):
        return {"tree": self.tree, "memory": self.memory, "change": self.change}

    def __setstate__(self, state):
        self.__init__(**state)

    @property
    def count(self):
        """Number of splats of the finest level, with those that are always drawn left out."""
        finest = np.argmax(self.tree.file != NONE, axis=1)
        return int(self.tree.count[np.arange(len(finest)), finest].sum())

    @property
    def always(self):
        """Whether there are splats that are always drawn."""
        return self.tree.environment is not None or self.change is not None

    def splats(self, leaf, level):
        """Return the usable Splats of a leaf at a level; of ALWAYS those that are always drawn."""
        found = self.read.get((leaf, level))
        if found is None:
            with self._reading:
                found = self.read.get((leaf, level))
                if found is None:
                    found = self._read(leaf, level)
        return found

    def read_ahead(self, wanted):
        """Begin to read runs (leaf, level) on a thread, unless it still reads earlier ones."""
        if self._ahead is not None and not self._ahead.done():
            return
        missing = [key for key in wanted if not self.read.has(key)]
        if missing:
            self._ahead = _READER.submit(self._read_all, missing)

    def overview(self):
        """Return the whole scene as `Splats`, as fine as few splats allow, and their level."""
        every, tree = [], self.tree
        total = [int(tree.count[np.arange(len(tree.file)), levels_at(tree, k)].sum())
                 for k in range(tree.levels)]  # fmt: skip
        fits = [k for k, n in enumerate(total) if n <= OVERVIEW]
        level = min(fits) if fits else tree.levels - 1
        if self.always:
            every.append(self.splats(ALWAYS, 0))
        for leaf, own in enumerate(levels_at(tree, level)):
            every.append(self.splats(leaf, int(own)))
        return joined(every), level

    def _read_all(self, wanted):
        for leaf, level in wanted:
            try:
                self.splats(leaf, level)
            except InputError:  # raised again where the run is needed
                return

    def _read(self, leaf, level):
        """Read the chunk of a run, keep all of its runs, and return the one."""
        tree = self.tree
        if leaf == ALWAYS:
            found = self._always()
            self.read.put((leaf, level), found, size_of(found))
            return found
        file = int(tree.file[leaf, level])
        name = tree.names[file]
        splats, good = read_chunk(tree, name)
        _usable(tree, name, splats, good)
        found = None
        for other in np.flatnonzero(tree.file[:, level] == file):
            offset, count = int(tree.offset[other, level]), int(tree.count[other, level])
            require_run(tree, name, splats, offset, count)
            part = slice(offset, offset + count)
            run = splats.take(part)
            if not good[part].all():
                run = run.take(good[part])
            run = self._changed(run)
            if other == leaf:
                found = run
            else:
                self.read.put((int(other), level), run, size_of(run))
        self.read.put((leaf, level), found, size_of(found))
        return found

    def _always(self):
        """Return the splats that are always drawn, those of the change after the capture's."""
        tree, parts = self.tree, []
        if tree.environment is not None:
            splats, good = read_chunk(tree, tree.environment)
            parts.append(self._changed(_usable(tree, tree.environment, splats, good)))
        if self.change is not None:
            parts.append(self.change.added)
        return joined(parts)

    def _changed(self, splats):
        return splats if self.change is None else splats.take(~self.change.gone(splats))


@dataclass(frozen=True)
class Change:
    """Splats that a capture in chunks is drawn without, and splats that are always drawn with it.

    gone : callable. gone(splats) returns which of the `Splats` are left out,
        ndarray of shape (n,), bool; a function of a module or a
        `functools.partial` of one, so that it can be sent to workers.
    added : Splats
    """

    gone: object
    added: Splats


def _usable(tree, name, splats, good):
    """Return the usable splats of a chunk; refuse it if too many are not."""
    if good.all():
        return splats
    broken = int(np.count_nonzero(~good))
    if broken > max(1, MAX_BROKEN_SHARE * len(good)):
        raise InputError(
            f"{tree.folder / name} has {broken} of {len(good)} splats with absurd values; at most "
            f"{100 * MAX_BROKEN_SHARE:g} % are tolerated; export the capture again"
        )
    return splats.take(good)


def levels_at(tree, wanted):
    """Return the level that each leaf shows where a level is wanted, ndarray of shape (leaves,).

    A leaf without that level shows the next finer one that it has; without a finer one the next
    coarser.

    wanted : int or array (leaves,)
    """
    there, level = tree.file != NONE, np.arange(tree.levels)
    wanted = np.broadcast_to(wanted, len(there))[:, None]
    away = np.where(level <= wanted, wanted - level, tree.levels + level - wanted)
    return np.where(there, away, 3 * tree.levels).argmin(axis=1)


def size_of(splats):
    """Return the bytes of a set of splats."""
    return sum(getattr(splats, name).nbytes for name in Splats.__slots__)


class Kept:
    """Values by key, up to a limit in bytes; the least recently used goes first."""

    def __init__(self, most):
        self.most, self.size, self.peak, self.made = most, 0, 0, 0
        self._values, self._lock = OrderedDict(), threading.Lock()

    def has(self, key):
        """Tell whether a key is kept; that counts as no use of it."""
        return key in self._values

    def get(self, key):
        """Return the value of a key, None if it is not kept."""
        with self._lock:
            if key not in self._values:
                return None
            self._values.move_to_end(key)
            return self._values[key][0]

    def get_all(self, keys):
        """Return a list of the values of keys, None for those that are not kept."""
        with self._lock:
            found = [self._values.get(key) for key in keys]
            for key, entry in zip(keys, found, strict=True):
                if entry is not None:
                    self._values.move_to_end(key)
        return [None if entry is None else entry[0] for entry in found]

    def clear(self):
        """Forget all values."""
        with self._lock:
            self._values.clear()
            self.size = 0

    def drop(self, key):
        """Let go of a key's value, if it is kept."""
        with self._lock:
            if key in self._values:
                self.size -= self._values.pop(key)[1]

    def put(self, key, value, size):
        """Keep a value, and let go of others until all fit; the newest always stays."""
        with self._lock:
            if key in self._values:
                self.size -= self._values.pop(key)[1]
            while self._values and self.size + size > self.most:
                self.size -= self._values.popitem(last=False)[1][1]
            self._values[key] = value, size
            self.size, self.made = self.size + size, self.made + 1
            self.peak = max(self.peak, self.size)
