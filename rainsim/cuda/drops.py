"""Drops that end, on a CUDA device: twin of `rainsim.drops.impacts`, and where their water goes.

A thread looks which cubes over its column of the map may hold drops that end in the interval; the
block then goes through all its cubes, a group of lanes a cube and a lane a drop. A second kernel
follows those that may end: those near something over the interval, and from the sky the few that
meet something in it. The list's order is that of chance; what is made from it is added up in whole
numbers, so that the order does not show.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.cubes import cube_key, drop_diameter, drop_id
from rainsim.cuda.account import UNIT
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.numbers import Numbers
from rainsim.cuda.warp import GROUP, THREADS, ballot, take_place
from rainsim.drops import _MARGIN, GROUND, cubes_swept, may_land
from rainsim.random import mix, uniform, uniform_triple
from rainsim.spectrum import CLASSES, WATER_DENSITY, drop_volume
from rainsim.surfaces import first_hit

COLUMNS = 4 if SIMULATED else 32  # that a block looks at together
BLOCKS = 2 if SIMULATED else 132 * 8
SOUGHT = 16  # drops sought, at most, for one that is found
ROOM = 1.5  # of a list, over the hits that are expected on level ground
VOLUME_UNIT = 2.0**-56  # m3: what falls on objects is counted in whole numbers of it, up to 128 m3
PUSH_UNIT = 2.0**-60  # kg m/s: and so is the momentum that rings come from
FIELD = ("velocity", "cube", "class_key", "count", "size", "share", "frame")
_CHUNK = 2 * THREADS  # drops sought that a block of `fill_impacts` goes through together
_FEW = 36  # cells that the cheap test of a way looks at
_ASIDE = 1e-3  # of a cell, or m: how far it looks beyond
_SHIFT_11 = np.uint64(11)


@cuda_kernel
def seek(
    counts, first, last, times, slot, velocity, cube, class_key, count, share, frame,
    low, high, x0, y0, spacing, ground, underside, top, found_out, sought_out, tasks_out, words_out,
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
    slot : device array of shape (1,), int32
        Which list of impacts will be filled from these drops; it is emptied.
    found_out : device array of shape (slots,), int32
    sought_out : device array of shape (1,), int32
        Raised by the number of drops, also of those for which the list has no room.
    tasks_out : device array of shape (room, 2), int32
        The column's number and the cube's place along z.
    words_out : device array of shape (room,), uint64
        The drops' ids. The other arrays are those of the CPU's kernel.
    """
    start, stop = times[0], times[1]
    places = cuda.shared.array((COLUMNS, 4), np.int64)  # class and first cube
    heights = cuda.shared.array((COLUMNS, 2), np.float64)
    many = cuda.shared.array(COLUMNS, np.int32)  # cubes of each column
    ends = cuda.shared.array(COLUMNS, np.int32)  # and of all up to it
    thread, lane = cuda.threadIdx.x, cuda.threadIdx.x % GROUP
    if thread == 0 and cuda.blockIdx.x == 0:
        found_out[slot[0]] = 0
    total, changes = counts[CLASSES], share.shape[1] > 1
    batches = (total + COLUMNS - 1) // COLUMNS
    for batch in range(cuda.blockIdx.x, batches, cuda.gridDim.x):
        if thread < COLUMNS:
            # Far from each other, so that all blocks find about as many.
            task = thread * batches + batch
            many[thread] = 0
            if task < total:
                b, i, j = _column_of(task, counts, first, last)
                k_first, k_last, low_z, high_z = cubes_swept(
                    b, i, j, start, stop, velocity, cube, frame, low, high, x0, y0, spacing
                )
                places[thread, 0], places[thread, 1] = b, i
                places[thread, 2], places[thread, 3] = j, k_first
                heights[thread, 0], heights[thread, 1] = low_z, high_z
                many[thread] = max(k_last - k_first + 1, 0)
        cuda.syncthreads()
        if thread < COLUMNS:
            cubes = 0
            for column in range(thread + 1):
                cubes += many[column]
            ends[thread] = cubes
        cuda.syncthreads()
        cubes = ends[COLUMNS - 1]
        for begin in range(0, cubes, THREADS // GROUP):
            rest = begin + thread // GROUP
            column, n, chance = 0, count.shape[1], 0.0
            b, i, j, k = places[0, 0], places[0, 0], places[0, 0], places[0, 0]
            word = key = class_key[0]
            if rest < cubes:
                step = COLUMNS // 2
                while step > 0:
                    if ends[column + step - 1] <= rest:
                        column += step
                    step //= 2
                rest -= ends[column] - many[column]
                b, i, j = places[column, 0], places[column, 1], places[column, 2]
                k, n = places[column, 3] + rest, lane
                key = cube_key(class_key[b], i, j, k)
                chance = uniform(key)
            while True:
                # The cube holds drop n if its number is beyond that chance, see `drops_in_cube`.
                there = n < count.shape[1] and chance >= count[b, n]
                if ballot(there) == 0:
                    break
                wanted = False
                if there:
                    word = drop_id(key, n)
                    wanted = may_land(
                        word, b, i, j, k, start, stop, heights[column, 0], heights[column, 1],
                        changes, velocity, cube, share, frame, low, high, x0, y0, spacing, ground,
                        underside, top,
                    )  # fmt: skip
                at = take_place(sought_out, 0, wanted)
                if wanted and at < words_out.shape[0]:
                    tasks_out[at, 0], tasks_out[at, 1] = column * batches + batch, k
                    words_out[at] = word
                n = n + GROUP if there else count.shape[1]
        cuda.syncthreads()


@cuda_kernel
def fill_impacts(
    counts, first, last, times, slot, sought, tasks, words, velocity, cube, size, frame,
    x0, y0, spacing, sky, ground, underside, top, block_high,
    found_out, values_out, labels_out, ids_out,
):  # fmt: skip
    """List those of the drops sought that end in an interval.

    Parameters
    ----------
    counts, first, last, times, slot, sought, tasks, words
        As `seek` has and left them.
    found_out : device array of shape (slots,), int32
        Raised by the number of hits, also of those for which the list has no room; beyond all room
        if there was none for a drop sought.
    values_out : device array of shape (slots, room, 5), float64
        Place [m], diameter [m] and time [s].
    labels_out : device array of shape (slots, room, 4), int32
        Class, kind, row and column.
    ids_out : device array of shape (slots, room), uint64
        The other arrays are those of the CPU's kernel.
    """
    near = cuda.shared.array(_CHUNK, np.int32)  # those that may meet something in the interval
    rest = cuda.shared.array(_CHUNK, np.int32)  # and those that would
    waiting = cuda.shared.array(2, np.int32)
    start, stop, which = times[0], times[1], slot[0]
    thread, room, per_cell = cuda.threadIdx.x, words.shape[0], 1.0 / spacing
    listed = min(sought[0], room)
    if cuda.grid(1) == 0 and sought[0] > room:
        cuda.atomic.add(found_out, which, ids_out.shape[1] + sought[0] - room)
    # Each test leaves less than half; what is left goes on in full warps.
    for begin in range(cuda.blockIdx.x * _CHUNK, listed, cuda.gridDim.x * _CHUNK):
        if thread == 0:
            waiting[0] = waiting[1] = 0
        cuda.syncthreads()
        for part in range(_CHUNK // THREADS):
            n = begin + part * THREADS + thread
            wanted = False
            if n < listed:
                b, x, y, z = _place(n, tasks, words, counts, first, last, cube, frame)
                vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
                wanted = not _passes_over(
                    x + vx * start, y + vy * start, x + vx * stop, y + vy * stop, z + vz * stop,
                    x0, y0, per_cell, top,
                )  # fmt: skip
            at = take_place(waiting, 0, wanted)
            if wanted:
                near[at] = n
        cuda.syncthreads()
        for at in range(0, waiting[0], THREADS):
            wanted = False
            if at + thread < waiting[0]:
                n = near[at + thread]
                b, x, y, z = _place(n, tasks, words, counts, first, last, cube, frame)
                vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
                _, kind, _, _ = first_hit(
                    x, y, z, vx, vy, vz, start - _MARGIN, stop + _MARGIN,
                    x0, y0, spacing, sky, ground, underside, top, block_high,
                )  # fmt: skip
                wanted = kind >= 0
            place = take_place(waiting, 1, wanted)
            if wanted:
                rest[place] = n
        cuda.syncthreads()
        # They may have ended before: these are followed from the sky.
        for at in range(0, waiting[1], THREADS):
            wanted = False
            if at + thread < waiting[1]:
                n = rest[at + thread]
                b, x, y, z = _place(n, tasks, words, counts, first, last, cube, frame)
                vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
                time, kind, row, column = first_hit(
                    x, y, z, vx, vy, vz, -np.inf, stop + _MARGIN,
                    x0, y0, spacing, sky, ground, underside, top, block_high,
                )  # fmt: skip
                wanted = start <= time < stop
            place = take_place(found_out, which, wanted)
            if wanted and place < ids_out.shape[1]:
                word = words[n]
                values_out[which, place, 0] = x + vx * time
                values_out[which, place, 1] = y + vy * time
                values_out[which, place, 2] = z + vz * time
                values_out[which, place, 3] = drop_diameter(word, b, size)
                values_out[which, place, 4] = time
                labels_out[which, place, 0], labels_out[which, place, 1] = b, kind
                labels_out[which, place, 2], labels_out[which, place, 3] = row, column
                ids_out[which, place] = word
        cuda.syncthreads()


@cuda.jit(device=True)
def _passes_over(x, y, x_end, y_end, z, x0, y0, per_cell, top):
    """Tell whether height z is above all that stands in the cells of a short way, a cheap test."""
    west = max(int((min(x, x_end) - x0) * per_cell - _ASIDE), 0)
    south = max(int((min(y, y_end) - y0) * per_cell - _ASIDE), 0)
    east = min(int((max(x, x_end) - x0) * per_cell + _ASIDE), top.shape[1] - 1)
    north = min(int((max(y, y_end) - y0) * per_cell + _ASIDE), top.shape[0] - 1)
    if (east - west) * (north - south) > _FEW:
        return False
    highest = np.float32(-np.inf)
    for row in range(south, north + 1):
        for column in range(west, east + 1):
            highest = max(highest, top[row, column])
    return z > highest + _ASIDE


@cuda.jit(device=True)
def _place(n, tasks, words, counts, first, last, cube, frame):
    """Return the class of drop n of a list and where it would be at time 0 [m]."""
    b, i, j = _column_of(tasks[n, 0], counts, first, last)
    side, (ux, uy, uz) = cube[b], uniform_triple(words[n])
    x, y = (i + ux) * side + frame[b, 0], (j + uy) * side + frame[b, 1]
    return b, x, y, (tasks[n, 1] + uz) * side


@cuda.jit(device=True)
def class_of(task, counts):
    """Return the class that holds number `task` of all classes', and which of it that is."""
    b, end = 0, CLASSES
    while end - b > 1:
        middle = (b + end) // 2
        if counts[middle] <= task:
            b = middle
        else:
            end = middle
    return b, task - counts[b]


@cuda.jit(device=True)
def _column_of(task, counts, first, last):
    """Return the class and the place (i, j) of column number `task` of all classes' boxes."""
    b, rest = class_of(task, counts)
    wide = last[b, 1] - first[b, 1] + 1
    return b, first[b, 0] + rest // wide, first[b, 1] + rest % wide


@cuda_kernel
def settle(
    found, values, labels, ids, times, slot, fall, area, first, width, tile, steps, cells,
    share, point, waiting_out, obstacles_out, came_out, pushes_out,
):  # fmt: skip
    """Give the water of listed drops to the cells that they fell on, and some to the ripples.

    Parameters
    ----------
    found, values, labels, ids
        As `fill_impacts` left them.
    times : device array of shape (2,), float64 [s]
        Start and end.
    slot : device array of shape (1,), int32
        Which of the lists.
    fall : device array of shape (CLASSES,), float64 [m/s]
        Fall speeds.
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
    point : device array of shape (ny, nx), int32
        The point of `came_out` that a cell's water goes to; negative: the last.
    waiting_out : device array, int64
        Depth that waits in each cell, in `account.UNIT`; added to.
    obstacles_out : device array of shape (1,), int64
        Volume that fell on obstacles, in VOLUME_UNIT; added to.
    came_out : device array of shape (points + 1,), int64
        And by the point that it goes to; added to. Of shape (0,): nothing drips.
    pushes_out : device array of shape (steps * cells * cells,), int64
        Momentum in each cell of the tile and each part of the interval, in PUSH_UNIT; added to.
    """
    which = slot[0]
    listed = min(found[which], ids.shape[1])
    for at in range(cuda.grid(1), listed, cuda.gridsize(1)):
        volume = drop_volume(values[which, at, 3])
        if labels[which, at, 1] != GROUND:
            water = np.int64(volume / VOLUME_UNIT + 0.5)
            cuda.atomic.add(obstacles_out, 0, water)
            if len(came_out) > 0:
                goes = point[labels[which, at, 2], labels[which, at, 3]]
                cuda.atomic.add(came_out, goes if goes >= 0 else len(came_out) - 1, water)
            continue
        cell = first + labels[which, at, 2] * width + labels[which, at, 3]
        cuda.atomic.add(waiting_out, cell, np.int64(volume / (area * UNIT) + 0.5))
        momentum = WATER_DENSITY * volume * fall[labels[which, at, 0]]
        ring(
            ids[which, at], values[which, at, 0], values[which, at, 1], momentum,
            values[which, at, 4], times[0], times[1], tile, steps, cells, share, pushes_out,
        )  # fmt: skip


@cuda.jit(device=True)
def ring(word, x, y, momentum, time, start, stop, tile, steps, cells, share, pushes_out):
    """Let a drop of a momentum [kg m/s] ring on the tile if it is of those that do; see `settle`.

    `time` [s] is when it came down, in the interval from `start` to `stop`.
    """
    if np.float64(mix(word) >> _SHIFT_11) * 2.0**-53 >= share:
        return
    push, age = momentum / PUSH_UNIT, (stop - time) / max(stop - start, 1e-30)
    step = min(max(steps - 1 - int(age * steps), 0), steps - 1)
    x, y = x / tile, y / tile
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
        Of a list.
    stream : cuda.stream
    slots : int
        Lists that are kept.

    Attributes
    ----------
    found : device array of shape (slots,), int32
    values, labels, ids : device arrays
        The lists, in no order; see `fill_impacts`.
    obstacles : device array of shape (1,), int64
        Volume that fell on obstacles since the start, in VOLUME_UNIT.
    ground_and_top : tuple
        x0, y0, spacing, and heights on the device: see `fill_impacts`.
    """

    def __init__(self, field, surfaces, room, stream=0, slots=1):
        self.stream, self._map = stream, surfaces
        f8, i8, i4 = np.float64, np.int64, np.int32
        x0, y0, spacing, sky, *maps = surfaces.arrays()
        around = surfaces.around_low, surfaces.around_high
        self._around = [cuda.to_device(m, stream) for m in around]
        ground, underside, top, high = (cuda.to_device(m, stream) for m in maps)
        self._surfaces = [x0, y0, spacing, sky, ground, underside, top, high]
        self.ground_and_top = x0, y0, spacing, ground, top
        self._no_point = cuda.to_device(np.zeros((0, 0), i4), stream)
        self._no_drips = cuda.to_device(np.zeros(0, i8), stream)
        names = {
            "counts": ((CLASSES + 1,), i8), "first": ((CLASSES, 3), i8), "last": ((CLASSES, 3), i8),
            "times": ((2,), f8), "slot": ((1,), i4), "sought": ((1,), i4),
        }  # fmt: skip
        for name, array in zip(FIELD, field.arrays(), strict=True):
            names[name] = array.shape, array.dtype
        self.now = Numbers(stream, names)  # "sought" is blanked by each `send`
        self.settled = Numbers(stream, {"times": ((2,), f8), "slot": ((1,), i4)})
        self._fall = cuda.to_device(np.ascontiguousarray(-field.velocity[:, 2]), stream)
        many = SOUGHT * room + 2**16  # those near tall things are sought for longer
        self._tasks = cuda.device_array((many, 2), i4, stream=stream)
        self._words = cuda.device_array(many, np.uint64, stream=stream)
        self.room, self.room_sought = room, many
        self.found = cuda.to_device(np.zeros(slots, i4), stream)
        self.values = cuda.device_array((slots, room, 5), f8, stream=stream)
        self.labels = cuda.device_array((slots, room, 4), i4, stream=stream)
        self.ids = cuda.device_array((slots, room), np.uint64, stream=stream)
        self.obstacles = cuda.to_device(np.zeros(1, i8), stream)

    def update(self, field, start, stop, smallest=0.0, slot=0):
        """Say what is listed next; arguments as `drops.impacts` has them, and which list to fill.

        `settle` settles that list.
        """
        surfaces, duration = self._map, stop - start
        corner = np.array([*surfaces.origin, 0.0])
        ny, nx = surfaces.shape
        opposite = corner + np.array([nx, ny, 0.0]) * surfaces.spacing
        drift, offset = field.velocity * duration, field.velocity * start
        first, last = field.cube_range(
            corner - np.maximum(drift, 0.0) - offset, opposite - np.minimum(drift, 0.0) - offset
        )
        columns = np.prod(np.maximum(last - first + 1, 0)[:, :2], axis=1)
        columns *= field.spectrum.edges[1:] > smallest
        self.settled.update(times=(start, stop), slot=slot)
        self.now.update(
            counts=np.concatenate([[0], np.cumsum(columns)]), first=first, last=last,
            times=(start, stop), slot=slot, **dict(zip(FIELD, field.arrays(), strict=True)),
        )  # fmt: skip

    def launch(self, stream=None):
        """Queue the listing, on another stream than its own if given."""
        stream = self.stream if stream is None else stream
        self.now.send(stream)
        now = self.now
        x0, y0, spacing, _, ground, underside, top, _ = self._surfaces
        where = [now[name] for name in ("counts", "first", "last", "times", "slot")]
        seek[BLOCKS, THREADS, stream](
            *where, now["velocity"], now["cube"], now["class_key"], now["count"], now["share"],
            now["frame"], *self._around, x0, y0, spacing, ground, underside, top, self.found,
            now["sought"], self._tasks, self._words,
        )  # fmt: skip
        fill_impacts[BLOCKS, THREADS, stream](
            *where, now["sought"], self._tasks, self._words, now["velocity"], now["cube"],
            now["size"], now["frame"], *self._surfaces, self.found, self.values, self.labels,
            self.ids,
        )  # fmt: skip

    def settle(self, water, ripples, share, stream=0, point=None, came=None):
        """Queue what a list does to `water` and `ripples`; `share` rings on the tile.

        Where objects drip, `point` and `came` are those of `cuda.drips.Drips`.
        """
        self.settled.send(stream)
        if came is None:
            point, came = self._no_point, self._no_drips
        blocks = -(-self.room // THREADS) if not SIMULATED else 2
        settle[blocks, THREADS, stream](
            self.found, self.values, self.labels, self.ids, self.settled["times"],
            self.settled["slot"], self._fall, self._map.spacing**2, water.first, water.width,
            ripples.size, ripples.steps, ripples.cells, share, point, water.waiting,
            self.obstacles, came, ripples.pushes,
        )  # fmt: skip

    def missing(self):
        """Return how many hits the first list had no room for; waits for them."""
        return max(int(self.found.copy_to_host(stream=self.stream)[0]) - self.room, 0)


def room_for(field, surfaces, duration):
    """Return how many hits a list for `duration` [s] should have room for."""
    rate = float((field.listed.density * field.listed.speed).sum())
    expected = rate * surfaces.area * duration
    return int(ROOM * expected + 6 * math.sqrt(expected) + 256)
