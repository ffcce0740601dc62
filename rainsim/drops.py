"""Falling drops without state: which drops are where at any time, and what they hit.

All drops of a size class have one velocity. Seen from a frame that moves with the class they stand
still: a frozen Poisson field. That frame is cut into cubes; a counter-based hash of (seed, class,
cube) says how many drops a cube holds, and of (cube, drop) where each is and how big. So the drops
in any box of air at any time, or the hits in any interval, can be listed alone, without history.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from rainsim.cubes import (
    class_keys,
    cube_key,
    cube_sides,
    drop_diameter,
    drop_id,
    drops_in_cube,
    left_out,
    size_tables,
    slab_tasks,
    swept_cubes,
)
from rainsim.errors import ParameterError, require_finite, require_not_negative
from rainsim.jit import cpu_kernel, inlined_function, lean_function, prange
from rainsim.random import poisson_tables, uniform_triple
from rainsim.spectrum import CLASSES, RainSpectrum, drop_volume
from rainsim.surfaces import (
    BLOCK,
    GROUND,
    OBSTACLE,
    Surfaces,
    first_hit,
    flat_surfaces,
    stopped_at,
)

__all__ = [
    "GROUND", "OBSTACLE", "Drops", "Impacts", "RainField", "RainSpectrum", "Surfaces",
    "drop_volume", "flat_surfaces", "impacts",
]  # fmt: skip

_STEEP = 4.0  # room for hits per hit on level ground; walls in wind catch more than their area
_MOST_VALUES, _MOST_LABELS = 5, 4  # per row of a listing
_MARGIN = 1e-6  # s; hits are searched this far beyond an interval's ends, then cut exactly


@dataclass(frozen=True)
class Drops:
    """Drops in the air at one time.

    Attributes
    ----------
    position : ndarray of shape (n, 3), float64 [m]
    velocity : ndarray of shape (n, 3), float64 [m/s]
    diameter : ndarray of shape (n,), float64 [m]
    id : ndarray of shape (n,), uint64
        The drop's own random word: the same at all times; ascending.
    """

    position: np.ndarray
    velocity: np.ndarray
    diameter: np.ndarray
    id: np.ndarray

    def __len__(self):
        return len(self.id)


@dataclass(frozen=True)
class Impacts:
    """Drops that ended on a surface, each with its own time.

    Attributes
    ----------
    position : ndarray of shape (n, 3), float64 [m]
    velocity : ndarray of shape (n, 3), float64 [m/s]
    diameter : ndarray of shape (n,), float64 [m]
    time : ndarray of shape (n,), float64 [s]
    kind : ndarray of shape (n,), uint8
        GROUND (the ground or the water on it) or OBSTACLE (top or side of an occluder).
    row, column : ndarray of shape (n,), int32
        The cell of the map.
    id : ndarray of shape (n,), uint64
        The drops' ids, ascending.
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


class RainField:
    """All drops of a steady rain in a steady wind, everywhere and at every time.

    Parameters
    ----------
    spectrum : RainSpectrum
    wind : (float, float) [m/s]
        Horizontal velocity of the air along x and y.
    seed : int
        Rains of different seeds are independent. At the same seed a lighter rain's drops are,
        nearly all, among a heavier one's.
    offset : (float, float) [m]
        How much farther the air has come along x and y than this wind alone would have taken it,
        for a wind that was another before.
    follow : ndarray of shape (CLASSES,), float64 or None
        Horizontal speed of each class over the wind's, see `rainsim.weather.wind_shares`; None
        for a wind that is the same at all heights, which all drops follow.
    heaviest : RainSpectrum or None
        The rain whose drops are listed, if it changes; `spectrum` is then only what it is now.
    share : ndarray of shape (CLASSES, n), float64 or None
        The share of those drops that there are, at n even times of passing z = 0; the first and
        last hold before and after.
    clock : (float, float) [s]
        The first of those times and the step.

    Attributes
    ----------
    velocity : ndarray of shape (CLASSES, 3), float64 [m/s]
    cube : ndarray of shape (CLASSES,), float64 [m]
        Side of the cubes in which the class is listed.
    """

    def __init__(
        self, spectrum, wind=(0.0, 0.0), seed=0, offset=(0.0, 0.0), heaviest=None, share=None,
        clock=(0.0, 1.0), follow=None,
    ):  # fmt: skip
        self.spectrum = spectrum
        self.listed = spectrum if heaviest is None else heaviest
        self._share = np.ones((CLASSES, 1)) if share is None else share
        follow = np.ones(CLASSES) if follow is None else np.asarray(follow, np.float64)
        # of each class: offset in x and y, first time, steps per second
        self._frame = np.empty((CLASSES, 4))
        self._frame[:, :2] = follow[:, None] * np.asarray(offset)
        self._frame[:, 2:] = clock[0], 1 / clock[1]
        self.wind = tuple(require_finite("wind component", w) for w in wind)
        if len(self.wind) != 2:
            raise ParameterError(f"wind is {wind!r}; it must be two numbers, along x and y in m/s")
        if isinstance(seed, bool) or int(seed) != seed:
            raise ParameterError(f"seed is {seed!r}; it must be a whole number")
        self.seed = int(seed)
        self.velocity = np.empty((CLASSES, 3))
        self.velocity[:, :2] = follow[:, None] * self.wind
        self.velocity[:, 2] = -spectrum.speed
        self.cube = cube_sides()
        self._key = class_keys(self.seed)
        self._count = poisson_tables(self.listed.density * self.cube**3)
        self._size = size_tables(self.listed)

    def arrays(self):
        """Return what the kernels need to list the drops of a cube, in their order."""
        return (
            self.velocity, self.cube, self._key, self._count, self._size, self._share, self._frame,
        )  # fmt: skip

    def drops_in_box(self, time, low, high):
        """List the drops in the box low <= position < high at `time`.

        Parameters
        ----------
        time : float [s]
        low, high : array_like of shape (3,) [m]

        Returns
        -------
        Drops
        """
        time = require_finite("time", time)
        low, high = np.array(low, dtype=np.float64), np.array(high, dtype=np.float64)
        if low.shape != (3,) or high.shape != (3,):
            raise ParameterError("a box is its low and its high corner, three numbers each")
        drift = self.velocity * time
        first, last = self.cube_range(low - drift, high - drift)
        tasks = slab_tasks(first, last)
        cubes = np.prod(last - first + 1, axis=1)[tasks[:, 0]] / (last - first + 1)[tasks[:, 0], 0]
        expected = (self.listed.density * self.cube**3)[tasks[:, 0]] * cubes
        values, labels, ids = _gather(
            expected, 4, 1, _fill_box, tasks, first, last, time, low, high, *self.arrays()
        )
        return Drops(
            np.ascontiguousarray(values[:, :3]),
            self.velocity[labels[:, 0]],
            np.ascontiguousarray(values[:, 3]),
            ids,
        )

    def cube_range(self, low, high):
        """Return the first and last cubes, (CLASSES, 3) int64, of co-moving boxes per class."""
        side = self.cube[:, None]
        offset = np.concatenate([self._frame[:, :2], np.zeros((CLASSES, 1))], axis=1)
        low, high = low - offset, high - offset
        first = np.floor(low / side).astype(np.int64)
        return first, np.maximum(np.floor(high / side).astype(np.int64), first - 1)


def joined(*parts):
    """Return several `Impacts` as one."""
    names = Impacts.__dataclass_fields__
    return Impacts(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


def impacts(field, surfaces, start, stop, smallest=0.0, within=None):
    """List the drops that meet the surfaces at start <= time < stop.

    Intervals that share an end share no drop and lose none. What a drop would have met on its
    path before `start` counts: under a roof there are no drops. Drops that come in over the map's
    edge below the highest top count if nothing on the map was in their way.

    Parameters
    ----------
    field : RainField
    surfaces : Surfaces
    start, stop : float [s]
    smallest : float [m]
        Classes with smaller drops only are left out, for whoever asks about big drops.
    within : ndarray of shape (2, 2) [m] or None
        Low and high corner (x, y): only hits inside are listed.

    Returns
    -------
    Impacts
        Sorted by drop id. Their volume is all the water that tracked drops bring; the drops under
        `spectrum.SMALLEST` come besides, as `field.spectrum.fine_rate`.
    """
    start = require_finite("start", start)
    duration = require_not_negative("stop - start", stop - start, "s")
    first, last, corner, opposite = swept_cubes(field, surfaces, start, stop, within)
    tasks = slab_tasks(first, last)
    tasks = tasks[field.spectrum.edges[tasks[:, 0] + 1] > smallest]
    flux = field.listed.density * field.listed.speed * field.cube * duration
    level = (flux * (last - first + 1)[:, 1] * field.cube)[tasks[:, 0]]
    expected = _STEEP * level
    values, labels, ids = _gather(
        expected, 5, 4, _fill_impacts, tasks, first, last, start, float(stop), *field.arrays(),
        surfaces.around_low, surfaces.around_high, *surfaces.arrays(),
    )  # fmt: skip
    if within is not None:
        place = values[:, :2]
        inside = ((place >= corner) & (place < opposite)).all(axis=1)
        values, labels, ids = values[inside], labels[inside], ids[inside]
    return Impacts(
        position=np.ascontiguousarray(values[:, :3]),
        velocity=field.velocity[labels[:, 0]],
        diameter=np.ascontiguousarray(values[:, 3]),
        time=np.ascontiguousarray(values[:, 4]),
        kind=labels[:, 1].astype(np.uint8),
        row=np.ascontiguousarray(labels[:, 2]),
        column=np.ascontiguousarray(labels[:, 3]),
        id=ids,
    )


# ---- kernels


@cpu_kernel
def _fill_box(
    tasks, first, last, time, low, high, velocity, cube, class_key, count, size, share, frame,
    offset, values_out, labels_out, ids_out, needed_out,
):  # fmt: skip
    """List the drops of each slab of cubes that are in the box; see `_gather` for the outputs."""
    changes = share.shape[1] > 1
    for t in prange(tasks.shape[0]):
        b, i = tasks[t]
        side, found = cube[b], 0
        vx, vy, vz = velocity[b]
        for j in range(first[b, 1], last[b, 1] + 1):
            for k in range(first[b, 2], last[b, 2] + 1):
                key = cube_key(class_key[b], i, j, k)
                for n in range(drops_in_cube(key, b, count)):
                    word = drop_id(key, n)
                    ux, uy, uz = uniform_triple(word)
                    if changes and left_out(word, b, (k + uz) * side, vz, share, frame):
                        continue
                    x = (i + ux) * side + vx * time + frame[b, 0]
                    y = (j + uy) * side + vy * time + frame[b, 1]
                    z = (k + uz) * side + vz * time
                    if low[0] <= x < high[0] and low[1] <= y < high[1] and low[2] <= z < high[2]:
                        if offset[t] + found < offset[t + 1]:
                            out = offset[t] + found
                            values_out[out, 0], values_out[out, 1] = x, y
                            values_out[out, 2] = z
                            values_out[out, 3] = drop_diameter(word, b, size)
                            labels_out[out, 0] = b
                            ids_out[out] = word
                        found += 1
        needed_out[t] = found


@inlined_function
def cubes_swept(b, i, j, start, stop, velocity, cube, frame, low, high, x0, y0, spacing):
    """Return which cubes (i, j, k) of class b may hold drops that end in [start, stop).

    As the first and last k, none if the last is less, and the lowest and highest that such a drop
    would be at time 0 [m].
    """
    side, block, duration = cube[b], spacing * BLOCK, stop - start
    vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
    west = i * side + frame[b, 0] + vx * start + min(vx * duration, 0.0) - x0
    east = west + side + abs(vx) * duration
    south = j * side + frame[b, 1] + vy * start + min(vy * duration, 0.0) - y0
    north = south + side + abs(vy) * duration
    z_low, z_high = _heights_within(
        west / block, east / block, south / block, north / block, low, high
    )
    if z_low > z_high:
        return 0, -1, z_low, z_high
    lowest, highest = z_low - vz * start, z_high - vz * stop
    return int(np.floor(lowest / side)), int(np.floor(highest / side)), lowest, highest


@inlined_function
def may_land(
    word, b, i, j, k, start, stop, lowest, highest, changes, velocity, cube, share, frame,
    low, high, x0, y0, spacing, ground, underside, top,
):  # fmt: skip
    """Tell cheaply whether the drop `word` of cube (i, j, k) of class b may end in the interval."""
    side, block, duration = cube[b], spacing * BLOCK, stop - start
    vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
    ux, uy, uz = uniform_triple(word)
    z = (k + uz) * side
    if z > highest or z < lowest:
        return False
    # At time 0, had the wind always been the one of now.
    x, y = (i + ux) * side + frame[b, 0], (j + uy) * side + frame[b, 1]
    clear = False  # of all that stands around, when the interval begins
    if max(abs(vx), abs(vy)) * duration < block:  # it stays within the next block
        per_block = 1.0 / block
        m = min(max(int((y + vy * start - y0) * per_block), 0), low.shape[0] - 1)
        c = min(max(int((x + vx * start - x0) * per_block), 0), low.shape[1] - 1)
        if z + vz * stop > high[m, c] or z + vz * start < low[m, c]:
            return False
        clear = z + vz * start > high[m, c]
    if changes and left_out(word, b, z, vz, share, frame):
        return False
    # Of the others most were stopped before: only the rest are followed from the sky.
    return clear or not stopped_at(
        x + vx * start, y + vy * start, z + vz * start, x0, y0, spacing, ground, underside, top
    )


@inlined_function
def landing(
    word, b, i, j, k, start, stop, velocity, cube, frame, x0, y0, spacing, sky, ground, underside,
    top, block_high,
):  # fmt: skip
    """Return when and where a drop that may land ends.

    Returns
    -------
    time : float64 [s]
        Infinite, or not in [start, stop), if it does not end then.
    kind, row, column : int
        As `surfaces.first_hit` has them.
    x, y, z : float64 [m]
    """
    side, (ux, uy, uz) = cube[b], uniform_triple(word)
    vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
    x, y = (i + ux) * side + frame[b, 0], (j + uy) * side + frame[b, 1]
    z = (k + uz) * side
    time, kind, row, column = first_hit(
        x, y, z, vx, vy, vz, start - _MARGIN, stop + _MARGIN,
        x0, y0, spacing, sky, ground, underside, top, block_high,
    )  # fmt: skip
    if kind < 0:
        return np.inf, -1, 0, 0, x, y, z
    if z + vz * (start - _MARGIN) < sky:  # it may have ended before
        time, kind, row, column = first_hit(
            x, y, z, vx, vy, vz, -np.inf, stop + _MARGIN,
            x0, y0, spacing, sky, ground, underside, top, block_high,
        )  # fmt: skip
    return time, kind, row, column, x + vx * time, y + vy * time, z + vz * time


@cpu_kernel
def _fill_impacts(
    tasks, first, last, start, stop, velocity, cube, class_key, count, size, share, frame,
    low, high, x0, y0, spacing, sky, ground, underside, top, block_high,
    offset, values_out, labels_out, ids_out, needed_out,
):  # fmt: skip
    """List the drops of each slab of cubes that end in [start, stop)."""
    changes = share.shape[1] > 1
    for t in prange(tasks.shape[0]):
        b, i = tasks[t]
        found = 0
        for j in range(first[b, 1], last[b, 1] + 1):
            k_first, k_last, lowest, highest = cubes_swept(
                b, i, j, start, stop, velocity, cube, frame, low, high, x0, y0, spacing
            )
            for k in range(k_first, k_last + 1):
                key = cube_key(class_key[b], i, j, k)
                for n in range(drops_in_cube(key, b, count)):
                    word = drop_id(key, n)
                    if not may_land(
                        word, b, i, j, k, start, stop, lowest, highest, changes, velocity, cube,
                        share, frame, low, high, x0, y0, spacing, ground, underside, top,
                    ):  # fmt: skip
                        continue
                    time, kind, row, column, x, y, z = landing(
                        word, b, i, j, k, start, stop, velocity, cube, frame, x0, y0, spacing, sky,
                        ground, underside, top, block_high,
                    )  # fmt: skip
                    if start <= time < stop:
                        if offset[t] + found < offset[t + 1]:
                            out = offset[t] + found
                            values_out[out, 0], values_out[out, 1] = x, y
                            values_out[out, 2] = z
                            values_out[out, 3] = drop_diameter(word, b, size)
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


# ---- drivers' helpers


def _gather(expected, width, label_width, kernel, tasks, *arguments):
    """Run a listing kernel and return its rows, sorted by id.

    Each task writes to its own stretch of the outputs and says how many rows it needed; if a
    stretch was too short, all is done once more with what was needed.
    """
    capacity = (expected + 6 * np.sqrt(expected) + 8).astype(np.int64)
    while True:
        offset = np.concatenate([[0], np.cumsum(capacity)])
        values, labels, ids = _room(offset[-1], width, label_width)
        needed = np.zeros(len(tasks), np.int64)
        kernel(tasks, *arguments, offset, values, labels, ids, needed)
        if (needed <= capacity).all():
            break
        capacity = needed
    skipped = np.repeat(offset[:-1] - (np.cumsum(needed) - needed), needed)
    rows = skipped + np.arange(needed.sum())
    rows = rows[np.argsort(ids[rows])]  # ids differ, so any sort gives one order
    return values[rows], labels[rows], ids[rows]


_kept = threading.local()


def _room(rows, width, label_width):
    """Return outputs for a listing kernel, kept from call to call: fresh memory costs its time."""
    if getattr(_kept, "rows", -1) < rows:
        _kept.rows = int(1.2 * rows)
        _kept.values = np.empty(_kept.rows * _MOST_VALUES)
        _kept.labels = np.empty(_kept.rows * _MOST_LABELS, np.int32)
        _kept.ids = np.empty(_kept.rows, np.uint64)
    return (
        _kept.values[: rows * width].reshape(rows, width),
        _kept.labels[: rows * label_width].reshape(rows, label_width),
        _kept.ids[:rows],
    )
