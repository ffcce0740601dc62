"""Cuts a large capture into a Streamed SOG: chunks in a tree of boxes, at several levels of detail.

Memory does not grow with the capture but for 100 bytes of each leaf: the splats are read twice in
blocks, sorted by leaf in a file beside the result, and written leaf by leaf. A leaf's coarser
levels are merged from its own splats.
"""

import json
import shutil
import tempfile
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rainsim import __version__
from rainsim.errors import InputError
from rainsim.io.files import replacing
from rainsim.lod.merge import merged_splats, reach_box
from rainsim.scene.formats.sog import META
from rainsim.scene.formats.sog_writer import write_sog
from rainsim.scene.formats.streamed import LOD_META, MOST_LEVELS, SIDES, VERSION
from rainsim.scene.splat_sets import joined
from rainsim.scene.types import Splats
from rainsim.splatting.prepared import morton_order

LEAF = 1 << 14  # splats of a leaf, about
CHUNK = 1 << 16  # splats of a chunk, about: one is read at once
SAMPLES = 1 << 21  # positions by which the tree is made
JUDGED = 16  # leaves by which the levels' cells are chosen
START = 0.2  # of the median deviation of splats: cells of level 1 are at least so wide
FIRST_SHARE = 0.6  # of all splats that level 1 has, at most
LEAST = 50_000  # splats of the coarsest level, about
BROAD = 2.0  # times a leaf's width from which a splat belongs to no leaf
MOST_BROAD = 0.02  # of all splats that belong to no leaf, at most
ENVIRONMENT = f"env/{META}"
WRITERS = 2  # threads


def cut(folder, blocks, leaf=LEAF, tell=None, antialiased=False):
    """Write a Streamed SOG of a capture.

    blocks : callable. blocks() returns an iterator over the capture's `Splats`,
        in parts of any size; it is called twice and must give the same splats.
    leaf : int. Splats of a leaf, about.
    tell : callable, optional. tell(done, total) is called as splats are written.
    antialiased : bool. Whether the chunks say that their splats were trained
        antialiased.
    Returns list of int. Splats of each level, without those that are always
        drawn. What a cut that fails has written is removed.
    Raises InputError if there are no splats.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    sample = _Sample()
    for block in blocks():
        sample.add(block)
    if not sample.count:
        raise InputError("the capture holds no splats; nothing can be cut; check the file")
    tree = _Tree(sample.position(), max(1, round(leaf * sample.share)))
    broad = sample.broad(tree.width)
    with tempfile.TemporaryFile(dir=folder) as file:
        sorted_ = _Sorted(file, tree.leaves, sample.coefficients)
        for block in blocks():
            is_broad = block.scale.max(axis=1) > broad
            sorted_.add(block.take(~is_broad), tree)
            sorted_.add_broad(block.take(is_broad))
        return _write(folder, antialiased, sorted_, tree, tell or (lambda done, total: None))


def _write(folder, antialiased, sorted_, tree, tell):
    """Write all chunks and the index; return the number of splats of each level."""
    sides = _sides(sorted_)
    boxes, runs, done, total = {}, {}, 0, sorted_.count
    with _Chunks(folder, antialiased, len(sides)) as chunks:
        for leaf in range(tree.leaves):
            splats = sorted_.leaf(leaf)
            if not len(splats):
                continue
            every = [in_order(splats), *(in_order(merged_splats(splats, s)) for s in sides[1:])]
            ends = np.array([reach_box(level) for level in every])
            boxes[leaf] = np.concatenate([ends[:, :3].min(axis=0), ends[:, 3:].max(axis=0)])
            runs[leaf] = [chunks.add(k, level) for k, level in enumerate(every)]
            done += len(splats)
            tell(done, total)
        broad = sorted_.broad()
        if broad is not None:
            chunks.write(ENVIRONMENT, in_order(broad))
    counts = [sum(run[k]["count"] for run in runs.values()) for k in range(len(sides))]
    index = {
        "version": VERSION,
        "asset": {"generator": f"rainsim {__version__}"},
        "count": sum(counts), "counts": counts, "lodLevels": len(sides),
        SIDES: [float(f"{side:.7g}") for side in sides],
        **({} if broad is None else {"environment": ENVIRONMENT}),
        "filenames": chunks.names,
        "tree": tree.nested(boxes, runs),
    }  # fmt: skip
    with replacing(folder / LOD_META) as path:
        path.write_text(json.dumps(index, separators=(",", ":")), encoding="utf-8")
    return counts


def in_order(splats):
    """Return splats in Morton order."""
    return splats.take(morton_order(splats.position))


def _sides(sorted_):
    """Return the side of each level's cells [capture units], 0 for level 0.

    That of level 1 is where about half of the splats are left; each further one is twice as wide.
    """
    filled = [n for n in range(sorted_.leaves) if sorted_.counts[n]]
    chosen = np.random.default_rng(0).permutation(filled)[:JUDGED]  # no step: scenes repeat
    few = [sorted_.leaf(n) for n in chosen]
    if not few:
        return [0.0]
    number = sum(map(len, few))
    spread = np.concatenate([np.linalg.norm(splats.scale, axis=1) for splats in few])
    side = max(START * float(np.median(spread)), 1e-9)

    def share(side):
        return sum(len(merged_splats(splats, side)) for splats in few) / number

    while share(side) > FIRST_SHARE and side < 1e9 * max(float(np.median(spread)), 1e-9):
        side *= 2**0.5
    sides = [0.0, side]
    left = share(side)
    while left * sorted_.count > LEAST and len(sides) < MOST_LEVELS:
        before, left = left, share(2 * sides[-1])
        if left > 0.9 * before:  # what is left is as wide as the leaves
            break
        sides.append(2 * sides[-1])
    return sides


class _Sample:
    """Some of the positions and widths of splats that come in blocks, evenly chosen."""

    def __init__(self):
        self.count, self.coefficients, self._step = 0, 1, 1
        self._position, self._width = [], []

    @property
    def share(self):
        """Share of the splats that are in the sample."""
        return sum(map(len, self._width)) / self.count

    def add(self, splats):
        """Add every so many-th splat of a block to the sample."""
        first = -self.count % self._step
        self.count += len(splats)
        self.coefficients = max(self.coefficients, splats.sh.shape[1])
        self._position.append(splats.position[first :: self._step].copy())
        self._width.append(splats.scale[first :: self._step].max(axis=1))
        while sum(map(len, self._width)) > SAMPLES:
            self._position = [np.concatenate(self._position)[::2]]
            self._width = [np.concatenate(self._width)[::2]]
            self._step *= 2

    def position(self):
        """Return the positions in the sample, (n, 3) float32."""
        return np.concatenate(self._position)

    def broad(self, width):
        """Return the deviation [capture units] beyond which a splat is as wide as leaves are."""
        most = float(np.quantile(np.concatenate(self._width), 1 - MOST_BROAD))
        return max(BROAD * width / 3, most)


@dataclass
class _Node:
    """A node of the tree: `leaf` is its number, or `axis` and `value` where it is cut."""

    leaf: int = -1
    axis: int = 0
    value: float = 0.0
    below: int = 0
    above: int = 0


class _Tree:
    """Boxes that are cut at the median of their longest side until few splats are in each."""

    def __init__(self, position, most):
        self.nodes, self.leaves, widths = [_Node()], 0, []
        ahead = [(0, position)]
        while ahead:
            place, points = ahead.pop()
            node = self.nodes[place]
            extent = np.ptp(np.percentile(points, (2, 98), axis=0), axis=0) if len(points) else 0
            node.axis = int(np.argmax(extent))
            values = points[:, node.axis]
            node.value = float(np.median(values)) if len(points) else 0.0
            below = values <= node.value
            if len(points) <= most or below.all():
                node.leaf, self.leaves = self.leaves, self.leaves + 1
                widths.append(float(np.max(extent)))
                continue
            node.below, node.above = len(self.nodes), len(self.nodes) + 1
            self.nodes += [_Node(), _Node()]
            ahead += [(node.above, points[~below]), (node.below, points[below])]
        self.width = float(np.median(widths))

    def leaf_of(self, position):
        """Return the number of the leaf that each position (n, 3) lies in."""
        axis, value, below, above, leaf = (
            np.array([getattr(node, name) for node in self.nodes])
            for name in ("axis", "value", "below", "above", "leaf")
        )
        at = np.zeros(len(position), np.int64)
        rows = np.arange(len(position))
        inner = leaf[at] < 0
        while inner.any():
            step = np.where(position[rows, axis[at]] <= value[at], below[at], above[at])
            at = np.where(inner, step, at)
            inner = leaf[at] < 0
        return leaf[at]

    def nested(self, boxes, runs, place=0):
        """Return the tree as lod-meta.json has it; a node without splats has an empty leaf."""
        node = self.nodes[place]
        if node.leaf >= 0:
            box = boxes.get(node.leaf)
            lods = {str(k): run for k, run in enumerate(runs.get(node.leaf, ())) if run["count"]}
            return {"bound": _bound(np.zeros(6) if box is None else box), "lods": lods}
        children = [self.nested(boxes, runs, n) for n in (node.below, node.above)]
        full = [child for child in children if child.get("lods") != {}] or children
        low = np.min([child["bound"]["min"] for child in full], axis=0)
        high = np.max([child["bound"]["max"] for child in full], axis=0)
        bound = {"min": low.tolist(), "max": high.tolist()}
        return {"bound": bound, "children": children}


def _bound(box):
    """Return a box (6,) as the index has it, rounded outwards to seven digits."""
    slack = 1e-6 * np.abs(box)
    low, high = box[:3] - slack[:3], box[3:] + slack[3:]
    return {"min": [float(f"{v:.7g}") for v in low], "max": [float(f"{v:.7g}") for v in high]}


class _Sorted:
    """Splats by leaf, as rows of numbers in a file."""

    def __init__(self, file, leaves, coefficients):
        self._file, self._coefficients = file, coefficients
        self._row, self.leaves = 4 * (11 + 3 * coefficients), leaves
        self._parts = [[] for _ in range(leaves + 1)]  # the last one for splats of no leaf
        self.counts = np.zeros(leaves + 1, np.int64)
        self._end = 0

    @property
    def count(self):
        """Number of the splats that belong to leaves."""
        return int(self.counts[:-1].sum())

    def add(self, splats, tree):
        """Store a block, each splat with its leaf's."""
        if not len(splats):
            return
        leaf = tree.leaf_of(splats.position)
        order = np.argsort(leaf, kind="stable")
        cut = np.searchsorted(leaf[order], np.arange(self.leaves + 1))
        self._store(splats.take(order))
        for n in np.flatnonzero(np.diff(cut)):
            self._note(n, int(cut[n]), int(cut[n + 1] - cut[n]), len(splats))

    def add_broad(self, splats):
        """Store splats that belong to no leaf."""
        if len(splats):
            self._store(splats)
            self._note(self.leaves, 0, len(splats), len(splats))

    def _store(self, splats):
        rows = np.zeros((len(splats), self._row // 4), np.float32)
        sh = splats.sh.reshape(len(splats), -1)
        parts = (splats.position, splats.rotation, splats.scale, splats.opacity[:, None], sh)
        at = 0
        for part in parts:
            rows[:, at : at + part.shape[1]] = part
            at += part.shape[1]
        self._file.seek(0, 2)
        self._file.write(rows.tobytes())
        self._end += len(splats)

    def _note(self, leaf, first, count, stored):
        self._parts[leaf].append((self._end - stored + first, count))
        self.counts[leaf] += count

    def leaf(self, number):
        """Return the Splats of a leaf in the order of the capture."""
        count = int(self.counts[number])
        rows, at = np.empty((count, self._row // 4), np.float32), 0
        for first, length in self._parts[number]:
            self._file.seek(first * self._row)
            data = self._file.read(length * self._row)
            rows[at : at + length] = np.frombuffer(data, np.float32).reshape(length, -1)
            at += length
        position, rotation, scale, opacity, sh = np.split(rows, (3, 7, 10, 11), axis=1)
        arrays = (position, rotation, scale, opacity[:, 0], sh.reshape(count, -1, 3))
        return Splats(*(np.ascontiguousarray(a) for a in arrays))

    def broad(self):
        """Return the splats of no leaf, None if there are none."""
        return self.leaf(self.leaves) if self.counts[self.leaves] else None


class _Chunks:
    """Runs of splats on their way into chunks, level by level."""

    def __init__(self, folder, antialiased, levels):
        self.folder, self.antialiased, self.levels, self.names = folder, antialiased, levels, []
        self._open = [[] for _ in range(levels)]
        self._number = [0] * levels
        self._file = [None] * levels
        self._pool, self._ahead = ThreadPoolExecutor(WRITERS), deque()

    def __enter__(self):
        return self

    def __exit__(self, kind, *exception):
        try:
            if kind is None:
                for level in range(self.levels):
                    self._close(level)
                while self._ahead:
                    self._ahead.popleft().result()
        finally:
            self._pool.shutdown(cancel_futures=True)
            if kind is not None:
                for name in [*self.names, ENVIRONMENT]:
                    shutil.rmtree((self.folder / name).parent, ignore_errors=True)

    def add(self, level, splats):
        """Put a leaf's splats into the open chunk of a level; return where they are."""
        if self._file[level] is None:
            self.names.append(f"{level}_{self._number[level]}/{META}")
            self._file[level] = len(self.names) - 1
            self._number[level] += 1
        offset = sum(map(len, self._open[level]))
        file = self._file[level]
        self._open[level].append(splats)
        if offset + len(splats) >= CHUNK:
            self._close(level)
        return {"file": file, "offset": offset, "count": len(splats)}

    def _close(self, level):
        runs, self._open[level] = self._open[level], []
        if runs:
            self.write(self.names[self._file[level]], joined(runs))
        self._file[level] = None

    def write(self, name, splats):
        """Write a chunk beside the work on the next ones."""
        while len(self._ahead) > WRITERS:
            self._ahead.popleft().result()
        chunk = (self.folder / name).parent
        self._ahead.append(self._pool.submit(write_sog, chunk, splats, self.antialiased))
