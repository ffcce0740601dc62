"""Levels of detail: fine splats merged cell by cell, for pictures that do not resolve the cells.

A splat finer than a pixel is widened to a pixel. Many of them in one pixel show too large, and each
takes its time. Groups of neighbouring chunks are therefore kept at several levels. At each of them
the splats that are finer than the cells of a grid are one for each cell and way that they face: a
Gaussian of their mean, covariance and colour (moments are kept, as where mixtures are reduced;
Runnalls 2007, IEEE Trans. Aerosp. Electron. Syst. 43(3)), each weighted by the light that it stops,
and the new one stops as much: optical depth times area is kept. A picture takes of each group the
coarsest level whose cells are small enough in it, by the group's depth: which one depends on the
camera, the size of the picture and the capture, never on the picture before.

An optical depth d e^-q at the place q stops 1 - exp(-d e^-q), which is flat in the middle where d
is large, as in a wall. A Gaussian of opacity d / (2 ln 2), which blending bounds at one, stops a
half at the same places. With no more than 1 - exp(-d) a wall of merged splats lets a third of the
light through between them. Opacities above one are also what Kerbl et al. 2024 (A Hierarchical 3D
Gaussian Representation, ACM Trans. Graph. 43(4)) give to merged splats.

`coarsest_level` merges once, for pictures that need one level only: those in wet ground, and the
chunks that big captures are cut into.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rainsim.splatting.level_kernels import LEAST, find_cells, merge_colors, merge_shapes, minors_of
from rainsim.splatting.prepared import (
    GEOMETRY,
    LANES,
    NOBODY,
    OPACITY,
    boxes,
    by_splat,
    laid_out,
    recolor,
)

SIDES = tuple(0.01 * 2**k for k in range(7))  # m, of the cells of the levels
GROUP = 8  # chunks whose level is chosen together
WIDE = 64  # chunks of a group where one level is made: a leaf of a big capture
ASIDE = 0.2  # share of a group's centres that its box leaves out on each side
WORTH = 0.8  # of a group's splats at the level before: with more, a level is left out


class Level(NamedTuple):
    """Which splats are merged at a level, and where it is written.

    side : float32 [capture units]. Of its cells.
    number, count : ndarray. As `find_cells` writes them.
    wanted : int64 array (m,). Groups that have the level.
    start : int64 array (m + 1,). First chunk of each of them.
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

    prepared : PreparedSplats. Without levels.
    sides : sequence of float [capture units]. Of the cells of each level,
        ascending.
    group : int. Chunks whose level is chosen together; a cell's splats are merged
        within them.
    worth : float. A group has a level if it keeps at most this share of the
        splats of the level before.
    drawn : PreparedSplats. The splats with their levels before them. Its `order`
        is -1 at places that no splat fills, and at a merged splat the index of
        one of those that it stands for. What does not lie in leading chunks has
        no levels.
    """

    def __init__(self, prepared, sides, group=GROUP, worth=WORTH):
        n = len(prepared.box)
        self._leading = n if prepared.leading is None else prepared.leading
        self._size, self._worth = group, worth
        parts = prepared.geometry[: self._leading].reshape(self._leading, GEOMETRY, LANES)
        before, reach, self._weight = measured(parts, group)
        number = np.empty((len(sides), self._leading * LANES), np.int16)
        count = np.empty((len(sides), len(before), 2), np.int64)
        self._levels = [
            self._level(prepared, np.float32(side), before, *at)
            for side, *at in zip(sides, number, count, strict=True)
        ]
        self._number, self._numbers = number, count
        self._count, self._first = len(prepared), sum(x.start[-1] for x in self._levels)
        self.drawn = self._with_levels(prepared, reach)
        self._merge_colors()

    def recolor(self, splats):
        """Take over the colours of `splats`, otherwise the same, in the memory of `drawn`."""
        recolor(self.prepared, splats)
        self.drawn = replace(self.drawn)  # another one, for those who ask whether it changed
        self._merge_colors()

    @property
    def prepared(self):
        """The `PreparedSplats` without levels, in the memory of `drawn`."""
        d, first = self.drawn, self._first
        return replace(
            d, geometry=d.geometry[first:], sh=d.sh[first:], fine=d.fine[first:],
            step=d.step[first:], box=d.box[first:], order=d.order[first * LANES :][: self._count],
            leading=d.leading - first, span=None, reach=None,
        )  # fmt: skip

    def coarsest(self):
        """Return the splats of the last level alone, one for each row.

        Returns rows : float32 array (n, 13). Geometry, as in `laid_out`.
            values : float32 array (n, 3 k). Harmonics.
            order : int32 array (n,). As in `drawn`.
            merged : bool array (n,). Whether each stands for several.
        """
        level, end = self._levels[-1], self._levels[-1].start[-1]  # it lies before the others
        rows = by_splat(self.drawn.geometry[:end].reshape(-1, GEOMETRY, LANES))
        lanes = LANES * np.diff(level.start)
        place = np.arange(len(rows)) - LANES * np.repeat(level.start[:-1], lanes)
        merged = place >= np.repeat(level.count[level.wanted, 0], lanes)
        there = rows[:, OPACITY] > -np.inf
        values, order = by_splat(self.drawn.harmonics(0, end)), self.drawn.order[: len(rows)]
        return rows[there], values[there], order[there], merged[there]

    def _level(self, prepared, side, before, number, count):
        """Return a `Level`; `before`, splats of each group, becomes their number at the level."""
        find_cells(prepared.geometry, self._leading, self._size, side, number, count)
        total = count.sum(axis=1)
        wanted = np.flatnonzero(total <= self._worth * np.maximum(before, 1))
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

    def _with_levels(self, prepared, reach):
        """Return the splats with their levels, whose colours are not yet written."""
        first, n, leading = self._first, len(prepared.box), self._leading
        runs = [
            with_room(array, first)
            for array in (prepared.geometry, prepared.sh, prepared.fine, prepared.step)
        ]
        geometry = runs[0]
        box, order = with_room(prepared.box, first), np.full((first + n) * LANES, NOBODY, np.int32)
        order[first * LANES :][: self._count] = prepared.order
        span, around = np.zeros((first + n, 2), np.float32), np.zeros((first + n, 6), np.float32)
        until = np.full(len(reach), np.inf, np.float32)
        for level, here in self._places():
            lanes = slice(here.start * LANES, here.stop * LANES)
            merge_shapes(
                prepared.geometry, prepared.order, self._weight, leading, self._size,
                level.wanted, level.number, level.count, level.start, geometry[here],
                order[lanes],
            )  # fmt: skip
            span[here, 0], span[here, 1] = level.side, until[level.group]
            around[here] = reach[level.group]
            until[level.wanted] = level.side
        own, base = np.arange(leading) // self._size, slice(first, first + leading)
        span[first:, 1] = np.inf
        span[base, 1], around[base] = until[own], reach[own]
        boxes(geometry[:first].reshape(first, GEOMETRY, LANES), first * LANES, box[:first])
        return replace(
            prepared, **dict(zip(("geometry", "sh", "fine", "step"), runs, strict=True)), box=box,
            order=order, leading=first + leading, span=span, reach=around,
        )  # fmt: skip

    def _merge_colors(self):
        """Write the colours of the levels from those of the splats."""
        own, drawn = self.prepared, self.drawn
        place = np.full(self._numbers.shape[:2], -1)
        for (level, here), row in zip(self._places(), place[::-1], strict=True):
            row[level.wanted] = here.start + level.start[:-1]
        merge_colors(
            own.sh, own.fine, own.step, self._weight, self._leading, self._size, self._number,
            self._numbers, place, drawn.sh, drawn.fine, drawn.step,
        )  # fmt: skip


def measured(parts, size):
    """Return the splats of groups of `size` chunks, the box of most centres, and weights of splats.

    parts : float32 array (chunks, 13, 256). Geometry.
    Returns count : int64 array (groups,)
        reach : float32 array (groups, 6) [capture units]. The box leaves out a
            share `ASIDE` of the centres on each side.
        weight : float32 array (256 chunks,) [capture units^2]. Light that each
            splat stops: its opacity times a measure of its mean shadow over all
            directions.
    """
    groups = -(-len(parts) // size)
    with np.errstate(all="ignore"):  # absurd splats
        opacity = np.exp2(parts[:, OPACITY])
        area = np.sqrt(np.fmax(minors_of(*parts[:, 3:9].swapaxes(0, 1)), 0))
        weight = np.fmax(opacity * area, LEAST)
    there = (opacity > 0) & np.isfinite(parts[:, :3]).all(axis=1)
    place = np.full((groups * size, 3, LANES), np.inf, np.float32)
    np.copyto(place[: len(parts)], parts[:, :3], where=there[:, None])
    place = np.sort(
        place.reshape(groups, size, 3, LANES).swapaxes(1, 2).reshape(groups, 3, size * LANES)
    )
    count = np.isfinite(place[:, 0]).sum(axis=1)
    beside = (ASIDE * count).astype(np.int64)
    ends = np.stack([beside, np.maximum(count - 1 - beside, 0)], axis=1)[:, None]
    reach = np.where(count[:, None, None] > 0, np.take_along_axis(place, ends, 2), 0)
    return count, reach.swapaxes(1, 2).reshape(groups, 6), weight.ravel()


def with_room(array, first):
    """Return a copy of an array with so many rows more before the others."""
    whole = np.empty((first + len(array), *array.shape[1:]), array.dtype)
    whole[first:] = array
    return whole


def coarsest_level(prepared, side):
    """Return what `Detail.coarsest` does, merged at cells of one side [capture units]."""
    return Detail(replace(prepared, leading=None), [side], WIDE, np.inf).coarsest()


def merge_fine(prepared, side):
    """Return prepared splats of which those finer than a cell are one a cell and way they face.

    prepared : PreparedSplats
    side : float [capture units]. Of the cells. A splat is fine if the squares of
        its deviations along its three axes add up to less than the square of it.
    Returns PreparedSplats. `order` names one of the splats that each stands for.
    """
    if not len(prepared):
        return prepared
    rows, values, order, _ = coarsest_level(prepared, side)
    found = laid_out(rows, values, np.arange(len(rows), dtype=np.int32), order)
    return replace(found, compensate=prepared.compensate)
