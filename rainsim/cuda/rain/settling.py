"""Lists of drops that ended, on a CUDA device, and where their water and their momentum go.

Sums are taken in whole numbers, so that the order of a list does not matter.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import WATER_DENSITY
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.cuda.water.flow import UNIT
from rainsim.numerics.random import mix, uniform
from rainsim.rain.heightfield import GROUND
from rainsim.rain.size_distribution import drop_volume
from rainsim.water.ripples import SIZE_MOMENTA

VOLUME_UNIT = 2.0**-56  # m3: what falls on objects is counted in whole numbers of it, up to 128 m3
PUSH_UNIT = 2.0**-60  # kg m/s: and so is the momentum that rings come from
# Places in a row of `values` (float64: place [m], diameter [m], time [s]) and of `labels` (int32).
VALUES, LABELS = 5, 4
X, Y, Z, DIAMETER, TIME = range(VALUES)
CLASS, KIND, ROW, COLUMN = range(LABELS)


class ImpactLists(NamedTuple):
    """Lists of drops that ended, as `fill_impacts` writes them.

    found : int32 device array (slots,). Drops in each list, also those for which
        it has no room.
    values : float64 device array (slots, room, VALUES). See X to TIME.
    labels : int32 device array (slots, room, LABELS). See CLASS to COLUMN.
    """

    found: object
    values: object
    labels: object
    ids: object


class CellLayout(NamedTuple):
    """Where the cells of a map lie in the water solver's arrays: see `cuda.water.conserving_flow`.

    first, width : int. Place of the first cell, and from one row to the next.
    area : float [m2]. Of a cell.
    """

    first: int
    width: int
    area: float


class RippleTile(NamedTuple):
    """The periodic tile on which drops ring.

    size : float [m]. Side.
    steps, cells : int. Parts of an interval, and cells along a side.
    share : float. Of the drops on the ground that ring on the tile.
    """

    size: float
    steps: int
    cells: int
    share: float


@cuda_kernel
def settle(lists, start, stop, slot, fall, layout, tile, point, waiting_out, came_out, pushes_out):
    """Give the water of listed drops to the cells that they fell on, and some to the ripples.

    point : int32 device array (ny, nx). The point of `came_out` that a cell's
        water goes to; negative: the last.
    waiting_out : device array, int64. Depth that waits in each cell, in
        `flow.UNIT`; added to.
    came_out : int64 device array (points + 1,). Volume that fell on obstacles by
        the point that it goes to, in VOLUME_UNIT; added to.
    pushes_out : int64 device array (ripples.SIZES * 2 * maps * cells * cells,).
        Momentum by size of the drops, part of the interval (two in a map) and
        cell of the tile, in PUSH_UNIT; added to.
    """
    values, labels = lists.values, lists.labels
    listed = min(lists.found[slot], lists.ids.shape[1])
    for at in range(cuda.grid(1), listed, cuda.gridsize(1)):
        volume = drop_volume(values[slot, at, DIAMETER])
        row, column = labels[slot, at, ROW], labels[slot, at, COLUMN]
        if labels[slot, at, KIND] != GROUND:
            water = np.int64(volume / VOLUME_UNIT + 0.5)
            goes = point[row, column]
            cuda.atomic.add(came_out, goes if goes >= 0 else len(came_out) - 1, water)
            continue
        cell = layout.first + row * layout.width + column
        cuda.atomic.add(waiting_out, cell, np.int64(volume / (layout.area * UNIT) + 0.5))
        if uniform(mix(lists.ids[slot, at])) < tile.share:
            momentum = WATER_DENSITY * volume * fall[labels[slot, at, CLASS]]
            age = (stop - values[slot, at, TIME]) / max(stop - start, 1e-30)
            x, y = values[slot, at, X], values[slot, at, Y]
            _ring(x, y, momentum, age, tile, pushes_out)


@cuda_kernel
def ring_each(count, drops, tile, pushes_out):
    """Let drops ring on the tile.

    drops : float64 device array (room, 4). Place (x, y) [m], momentum [kg m/s], and
        the time since it came down over the interval's length.
    """
    for n in range(cuda.grid(1), count, cuda.gridsize(1)):
        _ring(drops[n, 0], drops[n, 1], drops[n, 2], drops[n, 3], tile, pushes_out)


@cuda.jit(device=True)
def _ring(x, y, momentum, age, tile, pushes_out):
    """Let a drop ring on the tile; see `ring_each`."""
    push, steps, cells = momentum / PUSH_UNIT, tile.steps, tile.cells
    step = min(max(steps - 1 - int(age * steps), 0), steps - 1)
    for least in SIZE_MOMENTA:
        if momentum >= least:
            step += 2 * ((steps + 1) // 2)
    x, y = x / tile.size, y / tile.size
    x, y = (x - math.floor(x)) * cells, (y - math.floor(y)) * cells
    i, j = int(x), int(y)
    right, up = x - i, y - j
    for side in range(4):
        di, dj = side & 1, side >> 1
        part = (right if di == 1 else 1.0 - right) * (up if dj == 1 else 1.0 - up)
        place = (step * cells + (j + dj) % cells) * cells + (i + di) % cells
        cuda.atomic.add(pushes_out, place, _whole(push * part))


@cuda.jit(device=True)
def _whole(x):
    return np.int64(math.floor(x + 0.5))
