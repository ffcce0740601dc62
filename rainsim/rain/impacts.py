"""Where and when falling drops end: the formulas of a landing, and the lists of those that do.

A drop's path is straight and its time of passing any height is known, so the drops that end on the
map in an interval are found without a history: cube by cube of the co-moving frame, a cheap test
for each drop, and the search along its path for those that pass it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rainsim.jit import cpu_kernel, inlined_function, lean_function, prange
from rainsim.rain import poisson_cells
from rainsim.rain.heightfield import BLOCK, first_hit, stopped_at
from rainsim.rain.size_distribution import drop_volume

TIME_MARGIN = 1e-6  # s; hits are searched this far beyond an interval's ends, then cut exactly


@dataclass(frozen=True)
class Impacts:
    """Drops that ended on a surface, each with its own time.

    kind : uint8 array (n,). GROUND (the ground or the water on it) or OBSTACLE
        (top or side of an occluder).
    row, column : int32 array (n,) (drops of the rain) or int64 (drips). The cell
        of the map.
    id : uint64 array (n,). The drops' ids, ascending.
    """

    position: np.ndarray
    velocity: np.ndarray
    diameter: np.ndarray
    time: np.ndarray
    kind: np.ndarray
    row: np.ndarray
    column: np.ndarray
    id: np.ndarray

    def __len__(self):
        return len(self.id)

    @property
    def volume(self):
        """Volume of each drop, ndarray of shape (n,), float64 [m3]."""
        return drop_volume(self.diameter)

    def take(self, which):
        """Return the impacts that the index or mask array `which` selects."""
        return Impacts(*(getattr(self, name)[which] for name in self.__dataclass_fields__))

    def arrays(self):
        """Return the attributes as kernels take them, `ImpactArrays`."""
        values = {name: getattr(self, name) for name in ImpactArrays._fields}
        for name in ("row", "column"):  # of drops alone, as of drips: kernels compile for one type
            values[name] = values[name].astype(np.int64, copy=False)
        return ImpactArrays(**{name: np.ascontiguousarray(a) for name, a in values.items()})


class ImpactArrays(NamedTuple):
    """The arrays of `Impacts`, for kernels."""

    position: np.ndarray
    velocity: np.ndarray
    diameter: np.ndarray
    time: np.ndarray
    kind: np.ndarray
    row: np.ndarray
    column: np.ndarray
    id: np.ndarray


def no_impacts():
    """Return `Impacts` without any, of the types that drips have: no kernel is compiled for it."""
    rows, numbers, cells = np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64)
    return Impacts(
        rows, rows, numbers, numbers, np.zeros(0, np.uint8), cells, cells, np.zeros(0, np.uint64)
    )


def joined(*parts):
    """Return several `Impacts` as one."""
    names = Impacts.__dataclass_fields__
    return Impacts(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


# ---- kernels


@inlined_function
def cubes_swept(size_class, i, j, start, stop, field, surfaces):
    """Return which cubes (i, j, k) of a class may hold drops that end in [start, stop).

    Returns first, last : int. Of k; none if the last is less than the first.
        lowest, highest : float64 [m]. Where such a drop would be at time 0.
    """
    side, block, duration = field.cube[size_class], surfaces.spacing * BLOCK, stop - start
    vx, vy, vz = (
        field.velocity[size_class, 0], field.velocity[size_class, 1], field.velocity[size_class, 2]
    )  # fmt: skip
    x, y = field.frame[size_class, 0] - surfaces.x0, field.frame[size_class, 1] - surfaces.y0
    west = i * side + x + vx * start + min(vx * duration, 0.0)
    east = west + side + abs(vx) * duration
    south = j * side + y + vy * start + min(vy * duration, 0.0)
    north = south + side + abs(vy) * duration
    z_low, z_high = _heights_within(
        west / block, east / block, south / block, north / block,
        surfaces.around_low, surfaces.around_high,
    )  # fmt: skip
    if z_low > z_high:
        return 0, -1, z_low, z_high
    lowest, highest = z_low - vz * start, z_high - vz * stop
    return int(np.floor(lowest / side)), int(np.floor(highest / side)), lowest, highest


@inlined_function
def may_land(word, cube, start, stop, lowest, highest, field, surfaces):
    """Return False if the drop `word` of a `Cube` surely does not end in [start, stop); cheap."""
    b, block = cube.size_class, surfaces.spacing * BLOCK
    low, high = surfaces.around_low, surfaces.around_high
    vx, vy, vz = field.velocity[b, 0], field.velocity[b, 1], field.velocity[b, 2]
    x, y, z = poisson_cells.drop_place(word, cube, field)
    if z > highest or z < lowest:
        return False
    clear = False  # above all that stands around, when the interval begins
    if max(abs(vx), abs(vy)) * (stop - start) < block:  # it stays within the next block
        per_block = 1.0 / block
        m = min(max(int((y + vy * start - surfaces.y0) * per_block), 0), low.shape[0] - 1)
        c = min(max(int((x + vx * start - surfaces.x0) * per_block), 0), low.shape[1] - 1)
        if z + vz * stop > high[m, c] or z + vz * start < low[m, c]:
            return False
        clear = z + vz * start > high[m, c]
    if poisson_cells.thinned_out(word, b, z, field):
        return False
    # Most drops that are not clear were stopped before: only the others are followed from the sky.
    return clear or not stopped_at(x + vx * start, y + vy * start, z + vz * start, surfaces)


@inlined_function
def landing(word, cube, start, stop, field, surfaces):
    """Return when and where a drop that may land ends.

    Returns time : float64 [s]. Infinite, or not in [start, stop), if the drop
        does not end then.
        kind, row, column : int. As `heightfield.first_hit` has them.
        x, y, z : float64 [m]
    """
    b = cube.size_class
    vx, vy, vz = field.velocity[b, 0], field.velocity[b, 1], field.velocity[b, 2]
    x, y, z = poisson_cells.drop_place(word, cube, field)
    time, kind, row, column = first_hit(
        x, y, z, vx, vy, vz, start - TIME_MARGIN, stop + TIME_MARGIN, surfaces
    )
    if kind < 0:
        return np.inf, -1, 0, 0, x, y, z
    if z + vz * (start - TIME_MARGIN) < surfaces.sky:  # it may have ended before
        time, kind, row, column = first_hit(
            x, y, z, vx, vy, vz, -np.inf, stop + TIME_MARGIN, surfaces
        )
    return time, kind, row, column, x + vx * time, y + vy * time, z + vz * time


@cpu_kernel
def fill_impacts(
    tasks, first, last, start, stop, field, surfaces, offset, values_out, labels_out, ids_out,
    needed_out,
):  # fmt: skip
    """List the drops of each slab of cubes that end in [start, stop).

    tasks : int64 array (n, 2). Class and first number i of each slab's cubes.
    surfaces : HeightFields
    values_out : float64 array (rows, 5). x, y, z, diameter [m] and time [s].
    labels_out : int32 array (rows, 4). Class, kind, row and column.
    ids_out : uint64 array (rows,)
    """
    for t in prange(tasks.shape[0]):
        b, i = tasks[t]
        found = 0
        for j in range(first[b, 1], last[b, 1] + 1):
            k_first, k_last, lowest, highest = cubes_swept(b, i, j, start, stop, field, surfaces)
            for k in range(k_first, k_last + 1):
                cube = poisson_cells.Cube(b, i, j, k)
                key = poisson_cells.cube_key(cube, field)
                for n in range(poisson_cells.drops_in_cube(key, b, field)):
                    word = poisson_cells.drop_id(key, n)
                    if not may_land(word, cube, start, stop, lowest, highest, field, surfaces):
                        continue
                    time, kind, row, column, x, y, z = landing(
                        word, cube, start, stop, field, surfaces
                    )
                    if start <= time < stop:
                        if offset[t] + found < offset[t + 1]:
                            out = offset[t] + found
                            values_out[out, 0], values_out[out, 1] = x, y
                            values_out[out, 2] = z
                            values_out[out, 3] = poisson_cells.drop_diameter(word, b, field)
                            values_out[out, 4] = time
                            labels_out[out, 0], labels_out[out, 1] = b, kind
                            labels_out[out, 2], labels_out[out, 3] = row, column
                            ids_out[out] = word
                        found += 1
        needed_out[t] = found


@lean_function
def _heights_within(west, east, south, north, low, high):
    """Lowest and highest surface of the blocks under a rectangle, in blocks; empty: low > high."""
    z_low, z_high = np.inf, -np.inf
    ny, nx = low.shape
    for j in range(max(int(np.floor(south)), 0), min(int(np.floor(north)) + 1, ny)):
        for i in range(max(int(np.floor(west)), 0), min(int(np.floor(east)) + 1, nx)):
            z_low, z_high = min(z_low, low[j, i]), max(z_high, high[j, i])
    return z_low, z_high


# ---- lists


def run_listing(expected, width, label_width, kernel, tasks, *arguments):
    """Run a listing kernel and return its rows, sorted by id.

    Each task writes to its own stretch of the outputs and says how many rows it needed; if a
    stretch was too short, all is done once more with what was needed.
    """
    capacity = (expected + 6 * np.sqrt(expected) + 8).astype(np.int64)
    while True:
        offset = np.concatenate([[0], np.cumsum(capacity)])
        values = np.empty((offset[-1], width))
        labels = np.empty((offset[-1], label_width), np.int32)
        ids = np.empty(offset[-1], np.uint64)
        needed = np.zeros(len(tasks), np.int64)
        kernel(tasks, *arguments, offset, values, labels, ids, needed)
        if (needed <= capacity).all():
            break
        capacity = needed
    skipped = np.repeat(offset[:-1] - (np.cumsum(needed) - needed), needed)
    rows = skipped + np.arange(needed.sum())
    rows = rows[np.argsort(ids[rows])]  # ids differ, so any sort gives one order
    return values[rows], labels[rows], ids[rows]
