"""Drops that end, on a CUDA device: twin of `rainsim.drops.impacts`, and where their water goes.

A lane looks which cubes over its column of the map may hold drops that end in the interval; the
warp goes through them together, a lane a drop. The list's order is that of chance; what is made
from it is added up in whole numbers, so that the order does not show.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.cubes import cube_key, drop_diameter, drop_id, drops_in_cube
from rainsim.cuda.account import UNIT
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.numbers import Numbers
from rainsim.cuda.warp import LANES, ballot, from_lane, lane, lowest
from rainsim.drops import GROUND, cubes_swept, landing, may_land
from rainsim.random import mix
from rainsim.spectrum import CLASSES, WATER_DENSITY, drop_volume

WARPS = 1 if SIMULATED else 4  # of a block
BLOCKS = 2 if SIMULATED else 132 * 8
ABREAST = (
    1 if SIMULATED else 8
)  # columns that a warp looks at before it goes through those that count
THREADS = 32 if SIMULATED else 128
FOLLOWERS = 2 if SIMULATED else 132 * 4  # blocks of `fill_impacts`
SOUGHT = 4  # drops sought, at most, for one that is found
ROOM = 1.5  # of a list, over the hits that are expected on level ground
VOLUME_UNIT = 2.0**-64  # m3: what fell on obstacles is counted in whole numbers of it
PUSH_UNIT = 2.0**-60  # kg m/s: and so is the momentum that rings come from
FIELD = ("velocity", "cube", "class_key", "count", "size", "share", "frame")
_SHIFT_11 = np.uint64(11)


@cuda_kernel
def seek(
    counts, first, last, times, velocity, cube, class_key, count, share, frame,
    low, high, x0, y0, spacing, ground, underside, top, sought_out, places_out, words_out,
):  # fmt: skip
    """List the drops that may end in an interval: a cheap test of each in the air.

    Parameters
    ----------
    counts : device array of shape (CLASSES + 1,), int64
        Columns of cubes of the classes before each, and of all.
    first, last : device array of shape (CLASSES, 3), int64
        First and last cube of each class along x, y and z.
    times : device array of shape (2,), float64 [s]
        Start and end.
    sought_out : device array of shape (1,), int32
        Raised by the number of drops, also of those for which the list has no room.
    places_out : device array of shape (room, 4), int64
        Class and cube.
    words_out : device array of shape (room,), uint64
        The drops' ids. The other arrays are those of the CPU's kernel.
    """
    start, stop = times[0], times[1]
    warp = cuda.blockIdx.x * WARPS + cuda.threadIdx.x // LANES
    warps = cuda.gridDim.x * WARPS
    total, changes = counts[CLASSES], share.shape[1] > 1
    chunks = (total + ABREAST - 1) // ABREAST
    for chunk in range(warp, chunks, warps):
        task = lane() * chunks + chunk
        b, i, j, k_first, k_last = 0, first[0, 0], first[0, 0], first[0, 0], first[0, 0] - 1
        low_z, high_z = 0.0, 0.0
        if lane() < ABREAST and task < total:
            b, i, j = _column_of(task, counts, first, last)
            k_first, k_last, low_z, high_z = cubes_swept(
                b, i, j, start, stop, velocity, cube, frame, low, high, x0, y0, spacing
            )
        there = ballot(k_last >= k_first)
        while there != 0:
            source = lowest(there)
            there &= there - 1
            c, x, y = from_lane(b, source), from_lane(i, source), from_lane(j, source)
            begin, end = from_lane(k_first, source), from_lane(k_last, source)
            from_z, to_z = from_lane(low_z, source), from_lane(high_z, source)
            for k in range(begin, end + 1):
                key = cube_key(class_key[c], x, y, k)
                for n in range(lane(), drops_in_cube(key, c, count), LANES):
                    word = drop_id(key, n)
                    if may_land(
                        word, c, x, y, k, start, stop, from_z, to_z, changes, velocity, cube, share,
                        frame, low, high, x0, y0, spacing, ground, underside, top,
                    ):  # fmt: skip
                        at = cuda.atomic.add(sought_out, 0, 1)
                        if at < words_out.shape[0]:
                            places_out[at, 0], places_out[at, 1] = c, x
                            places_out[at, 2], places_out[at, 3] = y, k
                            words_out[at] = word


@cuda_kernel
def fill_impacts(
    sought, places, words, times, velocity, cube, size, frame,
    x0, y0, spacing, sky, ground, underside, top, block_high,
    found_out, values_out, labels_out, ids_out,
):  # fmt: skip
    """List those of the drops sought that end in an interval; a thread follows each.

    Parameters
    ----------
    sought, places, words
        As `seek` left them.
    times : device array of shape (2,), float64 [s]
        Start and end.
    found_out : device array of shape (1,), int32
        Raised by the number of hits, also of those for which the list has no room; beyond all room
        if there was none for a drop sought.
    values_out : device array of shape (room, 5), float64
        Place [m], diameter [m] and time [s].
    labels_out : device array of shape (room, 4), int32
        Class, kind, row and column.
    ids_out : device array of shape (room,), uint64
        The other arrays are those of the CPU's kernel.
    """
    start, stop = times[0], times[1]
    thread, room = cuda.grid(1), words.shape[0]
    if thread == 0 and sought[0] > room:
        cuda.atomic.add(found_out, 0, ids_out.shape[0] + sought[0] - room)
    for n in range(thread, min(sought[0], room), cuda.gridsize(1)):
        b, word = places[n, 0], words[n]
        time, kind, row, column, x, y, z = landing(
            word, b, places[n, 1], places[n, 2], places[n, 3], start, stop, velocity, cube, frame,
            x0, y0, spacing, sky, ground, underside, top, block_high,
        )  # fmt: skip
        if start <= time < stop:
            at = cuda.atomic.add(found_out, 0, 1)
            if at < ids_out.shape[0]:
                values_out[at, 0], values_out[at, 1], values_out[at, 2] = x, y, z
                values_out[at, 3] = drop_diameter(word, b, size)
                values_out[at, 4] = time
                labels_out[at, 0], labels_out[at, 1] = b, kind
                labels_out[at, 2], labels_out[at, 3] = row, column
                ids_out[at] = word


@cuda.jit(device=True)
def _column_of(task, counts, first, last):
    """Return the class and the place (i, j) of column number `task` of all classes' boxes."""
    b, end = 0, CLASSES
    while end - b > 1:
        middle = (b + end) // 2
        if counts[middle] <= task:
            b = middle
        else:
            end = middle
    rest = task - counts[b]
    wide = last[b, 1] - first[b, 1] + 1
    return b, first[b, 0] + rest // wide, first[b, 1] + rest % wide


@cuda_kernel
def settle(
    found, values, labels, ids, times, velocity, area, first, width, tile, steps, cells,
    share, waiting_out, obstacles_out, pushes_out,
):  # fmt: skip
    """Give the water of listed drops to the cells that they fell on, and some to the ripples.

    Parameters
    ----------
    found, values, labels, ids
        As `fill_impacts` left them.
    times : device array of shape (2,), float64 [s]
        Start and end.
    velocity : device array of shape (CLASSES, 3), float64 [m/s]
    area : float [m2]
        Of a cell.
    first, width : int
        Where the first cell is in `waiting_out`, and from one row to the next.
    tile : float [m]
        Side of the tile of ripples.
    steps, cells : int
        Parts of the interval, and cells along a side of the tile.
    share : float
        Of the drops on the ground that ring on the tile.
    waiting_out : device array, int64
        Depth that waits in each cell, in `account.UNIT`; added to.
    obstacles_out : device array of shape (1,), int64
        Volume that fell on obstacles, in VOLUME_UNIT; added to.
    pushes_out : device array of shape (steps * cells * cells,), int64
        Momentum in each cell of the tile and each part of the interval, in PUSH_UNIT; added to.
    """
    listed = min(found[0], ids.shape[0])
    for at in range(cuda.grid(1), listed, cuda.gridsize(1)):
        volume = drop_volume(values[at, 3])
        if labels[at, 1] != GROUND:
            cuda.atomic.add(obstacles_out, 0, np.int64(volume / VOLUME_UNIT + 0.5))
            continue
        cell = first + labels[at, 2] * width + labels[at, 3]
        cuda.atomic.add(waiting_out, cell, np.int64(volume / (area * UNIT) + 0.5))
        if np.float64(mix(ids[at]) >> _SHIFT_11) * 2.0**-53 >= share:
            continue
        push = -WATER_DENSITY * volume * velocity[labels[at, 0], 2] / PUSH_UNIT
        age = (times[1] - values[at, 4]) / max(times[1] - times[0], 1e-30)
        step = min(max(steps - 1 - int(age * steps), 0), steps - 1)
        x, y = values[at, 0] / tile, values[at, 1] / tile
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


class Impacts:
    """The drops that end on a map, listed on a CUDA device; twin of `drops.impacts`.

    Parameters
    ----------
    field : RainField
        Of the weather; `update` takes those of other times.
    surfaces : Surfaces
    room : int
        Of the list.
    stream : cuda.stream

    Attributes
    ----------
    found : device array of shape (1,), int32
    values, labels, ids : device arrays
        The list, in no order; see `fill_impacts`.
    obstacles : device array of shape (1,), int64
        Volume that fell on obstacles since the start, in VOLUME_UNIT.
    """

    def __init__(self, field, surfaces, room, stream=0):
        self.stream, self._map = stream, surfaces
        x0, y0, spacing, sky, *maps = surfaces.arrays()
        around = surfaces.around_low, surfaces.around_high
        self._around = [cuda.to_device(m, stream) for m in around]
        self._surfaces = [x0, y0, spacing, sky, *(cuda.to_device(m, stream) for m in maps)]
        f8, i8 = np.float64, np.int64
        names = {
            "counts": ((CLASSES + 1,), i8), "first": ((CLASSES, 3), i8), "last": ((CLASSES, 3), i8),
            "times": ((2,), f8), "found": ((1,), np.int32), "sought": ((1,), np.int32),
        }  # fmt: skip
        for name, array in zip(FIELD, field.arrays(), strict=True):
            names[name] = array.shape, array.dtype
        self.now = Numbers(stream, names)
        self.found = self.now["found"]  # blanked by each `send`, as "sought" is
        many = SOUGHT * room + 2**16  # those near tall things are sought for longer
        self._places = cuda.device_array((many, 4), np.int64, stream=stream)
        self._words = cuda.device_array(many, np.uint64, stream=stream)
        self.values = cuda.device_array((room, 5), np.float64, stream=stream)
        self.labels = cuda.device_array((room, 4), np.int32, stream=stream)
        self.ids = cuda.device_array(room, np.uint64, stream=stream)
        self.obstacles = cuda.to_device(np.zeros(1, np.int64), stream)

    def update(self, field, start, stop, smallest=0.0, within=None):
        """Say what is listed next; arguments as `drops.impacts` has them.

        Hits beyond `within` are listed too, where cubes reach over it.
        """
        surfaces, duration = self._map, stop - start
        corner = np.array([*surfaces.origin, 0.0])
        ny, nx = surfaces.shape
        opposite = corner + np.array([nx, ny, 0.0]) * surfaces.spacing
        if within is not None:
            corner[:2] = np.maximum(corner[:2], within[0])
            opposite[:2] = np.maximum(np.minimum(opposite[:2], within[1]), corner[:2])
        drift, offset = field.velocity * duration, field.velocity * start
        first, last = field.cube_range(
            corner - np.maximum(drift, 0.0) - offset, opposite - np.minimum(drift, 0.0) - offset
        )
        columns = np.prod(np.maximum(last - first + 1, 0)[:, :2], axis=1)
        columns *= field.spectrum.edges[1:] > smallest
        self.now.update(
            counts=np.concatenate([[0], np.cumsum(columns)]), first=first, last=last,
            times=(start, stop), **dict(zip(FIELD, field.arrays(), strict=True)),
        )  # fmt: skip

    def launch(self):
        """Queue the listing."""
        self.now.send()
        now, sought = self.now, (self.now["sought"], self._places, self._words)
        x0, y0, spacing, _, ground, underside, top, _ = self._surfaces
        seek[BLOCKS, WARPS * LANES, self.stream](
            now["counts"], now["first"], now["last"], now["times"], now["velocity"], now["cube"],
            now["class_key"], now["count"], now["share"], now["frame"], *self._around, x0, y0,
            spacing, ground, underside, top, *sought,
        )  # fmt: skip
        fill_impacts[FOLLOWERS, THREADS, self.stream](
            *sought, now["times"], now["velocity"], now["cube"], now["size"], now["frame"],
            *self._surfaces, self.found, self.values, self.labels, self.ids,
        )  # fmt: skip

    def settle(self, water, ripples, share):
        """Queue what the listed drops do to `water` and `ripples`; `share` rings on the tile."""
        blocks = -(-len(self.ids) // THREADS) if not SIMULATED else 2
        settle[blocks, THREADS, self.stream](
            self.found, self.values, self.labels, self.ids, self.now["times"],
            self.now["velocity"], self._map.spacing**2, water.first, water.width, ripples.size,
            ripples.steps, ripples.cells, share, water.waiting, self.obstacles, ripples.pushes,
        )  # fmt: skip

    def missing(self):
        """Return how many hits the list had no room for; waits for them."""
        found = int(self.found.copy_to_host(stream=self.stream)[0])
        return max(found - len(self.ids), 0)


def room_for(field, surfaces, duration):
    """Return how many hits a list for `duration` [s] should have room for."""
    rate = float((field.listed.density * field.listed.speed).sum())
    expected = rate * surfaces.area * duration
    return int(ROOM * expected + 6 * math.sqrt(expected) + 256)
