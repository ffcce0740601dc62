"""Levels of detail: fine splats merged cell by cell, for pictures that do not resolve the cells.

A splat finer than a pixel is widened to a pixel. Many of them in one pixel show too large, and each
takes its time. Groups of neighbouring chunks are therefore kept at several levels. At each of them
the splats that are finer than the cells of a grid are one for each cell and way that they face,
with their moments and their light kept as in `rainsim.splatting.coarse`. A picture takes of each
group the coarsest level whose cells are small enough in it, by the group's depth: which one depends
on the camera, the size of the picture and the capture, never on the picture before.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rainsim.splatting.level_kernels import (
    GROUP,
    find_cells,
    measure_groups,
    merge_colors,
    merge_shapes,
)
from rainsim.splatting.prepared import GEOMETRY, LANES, NOBODY, boxes

SIDES = tuple(0.01 * 2**k for k in range(7))  # m, of the cells of the levels
WORTH = 0.8  # of a group's splats at the level before: with more, a level is left out


class Level(NamedTuple):
    """Which splats are merged at a level, and where it is written.

    Attributes
    ----------
    side : float32 [capture units]
        Of its cells.
    number, count : ndarray
        As `find_cells` writes them.
    wanted : ndarray of shape (m,), int64
        Groups that have the level.
    start : ndarray of shape (m + 1,), int64
        First chunk of each of them.
    """

    side: np.float32
    number: np.ndarray
    count: np.ndarray
    wanted: np.ndarray
    start: np.ndarray

    @property
    def group(self):
        """Group of each chunk, ndarray of shape (chunks,), int64."""
        return np.repeat(self.wanted, np.diff(self.start))


class Detail:
    """Levels of detail of prepared splats, whose colours may change.

    Parameters
    ----------
    prepared : PreparedSplats
        Without levels.
    sides : sequence of float [capture units]
        Of the cells of each level, ascending.

    Attributes
    ----------
    drawn : PreparedSplats
        The splats with their levels before them. Its `order` is -1 at places that no splat fills,
        and at a merged splat the index of one of those that it stands for. What does not lie in
        leading chunks has no levels.
    """

    def __init__(self, prepared, sides):
        n = len(prepared.box)
        self._leading = n if prepared.leading is None else prepared.leading
        groups = -(-self._leading // GROUP)
        before, reach = np.empty(groups, np.int64), np.empty((groups, 6), np.float32)
        self._weight = np.empty(self._leading * LANES, np.float32)
        measure_groups(prepared.geometry, self._leading, before, reach, self._weight)
        levels = [self._level(prepared, np.float32(side), before) for side in sides]
        self._levels = [level for level in levels if len(level.wanted)]
        self._count, self._first = len(prepared), sum(x.start[-1] for x in self._levels)
        self.drawn = self._with_colors(self._with_shapes(prepared, reach), prepared)

    def recolor(self, prepared):
        """Take over `prepared`: the same splats in other colours, see `prepared.recolored`."""
        self.drawn = self._with_colors(self.drawn, prepared)

    @property
    def prepared(self):
        """The `PreparedSplats` without levels, in the memory of `drawn`."""
        d, first = self.drawn, self._first
        return replace(
            d, geometry=d.geometry[first:], sh=d.sh[first:], fine=d.fine[first:],
            step=d.step[first:], box=d.box[first:], order=d.order[first * LANES :][: self._count],
            leading=d.leading - first, span=None, reach=None,
        )  # fmt: skip

    def _level(self, prepared, side, before):
        """Return a `Level`; `before`, splats that groups have, becomes what they have at it."""
        number = np.empty(self._leading * LANES, np.int16)
        count = np.empty((len(before), 2), np.int64)
        find_cells(prepared.geometry, self._leading, side, number, count)
        total = count.sum(axis=1)
        wanted = np.flatnonzero(total <= WORTH * before)
        before[wanted] = total[wanted]
        start = np.concatenate([[0], np.cumsum(-(-total[wanted] // LANES))])
        return Level(side, number, count, wanted, start)

    def _places(self):
        """Yield each level, the last first, with the range of its chunks."""
        end = self._first
        for level in self._levels[::-1]:
            begin = end - level.start[-1]
            yield level, slice(begin, end)
            end = begin

    def _with_shapes(self, prepared, reach):
        """Return the splats with their levels' geometry, all in the colours of `prepared`."""
        first, n, leading = self._first, len(prepared.box), self._leading
        geometry = np.empty((first + n, GEOMETRY * LANES), np.float32)
        box, order = np.empty((first + n, 6), np.float32), np.full((first + n) * LANES, NOBODY)
        geometry[first:], box[first:] = prepared.geometry, prepared.box
        order = order.astype(np.int32)
        order[first * LANES :][: self._count] = prepared.order
        span, around = np.zeros((first + n, 2), np.float32), np.zeros((first + n, 6), np.float32)
        until = np.full(len(reach), np.inf, np.float32)
        for level, here in self._places():
            lanes = slice(here.start * LANES, here.stop * LANES)
            merge_shapes(
                prepared.geometry, prepared.order, self._weight, leading, level.wanted,
                level.number, level.count, level.start, geometry[here], order[lanes],
            )  # fmt: skip
            span[here, 0], span[here, 1] = level.side, until[level.group]
            around[here] = reach[level.group]
            until[level.wanted] = level.side
        own, base = np.arange(leading) // GROUP, slice(first, first + leading)
        span[first:, 1] = np.inf
        span[base, 1], around[base] = until[own], reach[own]
        boxes(geometry[:first].reshape(first, GEOMETRY, LANES), first * LANES, box[:first])
        return replace(
            prepared, geometry=geometry, box=box, order=order, leading=first + leading, span=span,
            reach=around,
        )  # fmt: skip

    def _with_colors(self, drawn, prepared):
        """Return `drawn` in the colours of `prepared`."""
        arrays = []
        for array in (prepared.sh, prepared.fine, prepared.step):
            arrays.append(np.empty((self._first + len(array), array.shape[1]), array.dtype))
            arrays[-1][self._first :] = array
        for level, here in self._places():
            merge_colors(
                prepared.sh, prepared.fine, prepared.step, self._weight, self._leading,
                level.wanted, level.number, level.count, level.start, *(a[here] for a in arrays),
            )  # fmt: skip
        return replace(drawn, sh=arrays[0], fine=arrays[1], step=arrays[2])
