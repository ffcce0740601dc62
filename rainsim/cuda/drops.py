"""Drops that end, on a CUDA device: twin of `rainsim.drops.impacts`.

A thread finds which cubes over its column of the map may hold drops that end in the interval; the
block then goes through all its cubes, a group of lanes a cube and a lane a drop. A second kernel
follows the drops that may end: those near something over the interval, and from the sky the few
that meet something in it. The list's order is that of chance; sums over the list are taken in whole
numbers, so that its order does not matter.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.warp import GROUP, THREADS, ballot, claim_row
from rainsim.numerics.random import uniform
from rainsim.rain import poisson_cells
from rainsim.rain.heightfield import first_hit
from rainsim.rain.impacts import TIME_MARGIN, cubes_swept, may_land
from rainsim.rain.size_distribution import CLASSES

BLOCK_COLUMNS = 4 if SIMULATED else 32  # that a block looks at together
BLOCKS = 2 if SIMULATED else 132 * 8
SOUGHT = 16  # drops sought, at most, for one that is found
ROOM = 1.5  # of a list, over the hits that are expected on level ground
_CHUNK = 2 * THREADS  # drops sought that a block of `fill_impacts` goes through together
_FEW = 36  # cells that the cheap test of a path looks at
_ASIDE = 1e-3  # of a cell, or m: how far it looks beyond
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
    ids : uint64 device array (slots, room)
    """

    found: object
    values: object
    labels: object
    ids: object


class Columns(NamedTuple):
    """Columns of cubes over a map, class by class.

    first, last : int64 device array (CLASSES, 3). First and last cube of each
        class along x, y and z.
    """

    counts: object
    first: object
    last: object


@cuda_kernel
def seek(
    columns, start, stop, slot, field, surfaces, found_out, sought_out, tasks_out, words_out
):  # fmt: skip
    """List the drops that may end in an interval: a cheap test of each in the air.

    start, stop : float [s]
    slot : int. Which list of impacts will be filled from these drops; it is
        emptied.
    surfaces : HeightFields. Both of device arrays.
    found_out : int32 device array (slots,)
    sought_out : int32 device array (1,). Raised by the number of drops, also of
        those for which the list has no room.
    tasks_out : int32 device array (room, 2). The column's number and the cube's
        place along z.
    words_out : uint64 device array (room,). The drops' ids.
    """
    places = cuda.shared.array((BLOCK_COLUMNS, 4), np.int64)  # class and first cube
    heights = cuda.shared.array((BLOCK_COLUMNS, 2), np.float64)
    many = cuda.shared.array(BLOCK_COLUMNS, np.int32)  # cubes of each column
    ends = cuda.shared.array(BLOCK_COLUMNS, np.int32)  # and of all up to it
    thread, lane, most = cuda.threadIdx.x, cuda.threadIdx.x % GROUP, field.count.shape[1]
    if thread == 0 and cuda.blockIdx.x == 0:
        found_out[slot] = 0
    total = columns.counts[CLASSES]
    batches = (total + BLOCK_COLUMNS - 1) // BLOCK_COLUMNS
    for batch in range(cuda.blockIdx.x, batches, cuda.gridDim.x):
        if thread < BLOCK_COLUMNS:
            # Far from each other, so that all blocks find about as many.
            task = thread * batches + batch
            many[thread] = 0
            if task < total:
                b, i, j = _column_of(task, columns)
                k_first, k_last, low_z, high_z = cubes_swept(b, i, j, start, stop, field, surfaces)
                places[thread, 0], places[thread, 1] = b, i
                places[thread, 2], places[thread, 3] = j, k_first
                heights[thread, 0], heights[thread, 1] = low_z, high_z
                many[thread] = max(k_last - k_first + 1, 0)
        cuda.syncthreads()
        if thread < BLOCK_COLUMNS:
            cubes = 0
            for column in range(thread + 1):
                cubes += many[column]
            ends[thread] = cubes
        cuda.syncthreads()
        cubes = ends[BLOCK_COLUMNS - 1]
        for begin in range(0, cubes, THREADS // GROUP):
            rest = begin + thread // GROUP
            column, n, chance = 0, most, 0.0
            cube = poisson_cells.Cube(places[0, 0], places[0, 0], places[0, 0], places[0, 0])
            word = key = field.class_key[0]
            if rest < cubes:
                column = _holder_of(rest, ends)
                k = places[column, 3] + rest - ends[column] + many[column]
                cube = poisson_cells.Cube(
                    places[column, 0], places[column, 1], places[column, 2], k
                )
                key, n = poisson_cells.cube_key(cube, field), lane
                chance = uniform(key)
            while True:
                # The cube holds drop n if its number is beyond that chance, see `drops_in_cube`.
                there = n < most and chance >= field.count[cube.size_class, n]
                if ballot(there) == 0:
                    break
                wanted = False
                if there:
                    word = poisson_cells.drop_id(key, n)
                    wanted = may_land(
                        word, cube, start, stop, heights[column, 0], heights[column, 1], field,
                        surfaces,
                    )  # fmt: skip
                at = claim_row(sought_out, 0, wanted)
                if wanted and at < words_out.shape[0]:
                    tasks_out[at, 0], tasks_out[at, 1] = column * batches + batch, cube.k
                    words_out[at] = word
                n = n + GROUP if there else most
        cuda.syncthreads()


@cuda.jit(device=True)
def _holder_of(n, ends):
    """Return which of a block's columns holds cube n, by the columns' ends; a binary search."""
    which, step = 0, BLOCK_COLUMNS // 2
    while step > 0:
        if ends[which + step - 1] <= n:
            which += step
        step //= 2
    return which


@cuda_kernel
def fill_impacts(
    columns, start, stop, slot, sought, tasks, words, field, surfaces, found_out, values_out,
    labels_out, ids_out,
):  # fmt: skip
    """List those of the drops sought that end in an interval.

    found_out, values_out, labels_out, ids_out. See `ImpactLists`. The number
        found is beyond all room if there was none for a drop sought.
    """
    near = cuda.shared.array(_CHUNK, np.int32)  # drops that may meet something in the interval
    hitting = cuda.shared.array(_CHUNK, np.int32)  # drops that would, if nothing stopped them
    waiting = cuda.shared.array(2, np.int32)
    thread, room = cuda.threadIdx.x, words.shape[0]
    listed = min(sought[0], room)
    if cuda.grid(1) == 0 and sought[0] > room:
        cuda.atomic.add(found_out, slot, ids_out.shape[1] + sought[0] - room)
    # Each test keeps less than half of the drops; those that are kept go on in full warps.
    for begin in range(cuda.blockIdx.x * _CHUNK, listed, cuda.gridDim.x * _CHUNK):
        if thread == 0:
            waiting[0] = waiting[1] = 0
        cuda.syncthreads()
        for part in range(_CHUNK // THREADS):
            n = begin + part * THREADS + thread
            wanted = False
            if n < listed:
                b, x, y, z = _place(n, tasks, words, columns, field)
                wanted = not _passes_over(b, x, y, z, start, stop, field, surfaces)
            at = claim_row(waiting, 0, wanted)
            if wanted:
                near[at] = n
        cuda.syncthreads()
        for at in range(0, waiting[0], THREADS):
            wanted = False
            if at + thread < waiting[0]:
                n = near[at + thread]
                b, x, y, z = _place(n, tasks, words, columns, field)
                _, kind, _, _ = first_hit(
                    x, y, z, field.velocity[b, 0], field.velocity[b, 1], field.velocity[b, 2],
                    start - TIME_MARGIN, stop + TIME_MARGIN, surfaces,
                )  # fmt: skip
                wanted = kind >= 0
            place = claim_row(waiting, 1, wanted)
            if wanted:
                hitting[place] = n
        cuda.syncthreads()
        # They may have ended before: these are followed from the sky.
        for at in range(0, waiting[1], THREADS):
            wanted = False
            if at + thread < waiting[1]:
                n = hitting[at + thread]
                b, x, y, z = _place(n, tasks, words, columns, field)
                vx, vy, vz = field.velocity[b, 0], field.velocity[b, 1], field.velocity[b, 2]
                time, kind, row, column = first_hit(
                    x, y, z, vx, vy, vz, -np.inf, stop + TIME_MARGIN, surfaces
                )
                wanted = start <= time < stop
            place = claim_row(found_out, slot, wanted)
            if wanted and place < ids_out.shape[1]:
                word = words[n]
                values_out[slot, place, X] = x + vx * time
                values_out[slot, place, Y] = y + vy * time
                values_out[slot, place, Z] = z + vz * time
                values_out[slot, place, DIAMETER] = poisson_cells.drop_diameter(word, b, field)
                values_out[slot, place, TIME] = time
                labels_out[slot, place, CLASS], labels_out[slot, place, KIND] = b, kind
                labels_out[slot, place, ROW], labels_out[slot, place, COLUMN] = row, column
                ids_out[slot, place] = word
        cuda.syncthreads()


@cuda.jit(device=True)
def _passes_over(b, x, y, z, start, stop, field, surfaces):
    """Tell whether a drop stays above all that stands in the cells of a short path, cheaply."""
    vx, vy, end = field.velocity[b, 0], field.velocity[b, 1], z + field.velocity[b, 2] * stop
    x0, y0, per_cell, top = surfaces.x0, surfaces.y0, 1.0 / surfaces.spacing, surfaces.top
    x_end, y_end = x + vx * stop, y + vy * stop
    x, y = x + vx * start, y + vy * start
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
    return end > highest + _ASIDE


@cuda.jit(device=True)
def _place(n, tasks, words, columns, field):
    """Return the class of drop n of a list and where it would be at time 0 [m]."""
    b, i, j = _column_of(tasks[n, 0], columns)
    x, y, z = poisson_cells.drop_place(words[n], poisson_cells.Cube(b, i, j, tasks[n, 1]), field)
    return b, x, y, z


@cuda.jit(device=True)
def class_of(task, counts):
    """Return the class that holds number `task` of all classes', and its number in the class."""
    b, end = 0, CLASSES
    while end - b > 1:
        middle = (b + end) // 2
        if counts[middle] <= task:
            b = middle
        else:
            end = middle
    return b, task - counts[b]


@cuda.jit(device=True)
def _column_of(task, columns):
    """Return the class and the place (i, j) of column number `task` of all classes' boxes."""
    b, rest = class_of(task, columns.counts)
    wide = columns.last[b, 1] - columns.first[b, 1] + 1
    return b, columns.first[b, 0] + rest // wide, columns.first[b, 1] + rest % wide


class Listed(FrameUniforms):
    """The interval that is listed, as kernels take it; each `send` blanks "sought"."""

    def __init__(self, field):
        i8, i4 = np.int64, np.int32
        names = {
            "counts": ((CLASSES + 1,), i8), "first": ((CLASSES, 3), i8), "last": ((CLASSES, 3), i8),
            "sought": ((1,), i4),
        }  # fmt: skip
        super().__init__(names | arrays_of(field))
        self.columns = Columns(*(self[name] for name in Columns._fields))
        self.field = poisson_cells.DropField(
            *(self[name] for name in poisson_cells.DropField._fields)
        )
        self._taken = None

    def take(self, field):
        """Set the drops, a RainField."""
        if field is not self._taken:
            self._taken = field
            self.update(**field.arrays()._asdict())


class Impacts:
    """The drops that end on a map, listed on a CUDA device; twin of `drops.impacts`.

    surfaces : HeightFields. Of device arrays.
    """

    def __init__(self, field, surfaces, room, slots=1):
        corner, (ny, nx) = np.array([*surfaces.origin, 0.0]), surfaces.shape
        self._corners = corner, corner + np.array([nx, ny, 0.0]) * surfaces.spacing
        self.surfaces = sent_surfaces(surfaces)
        self._now = Listed(field)
        self._slots = slots
        self.make_room(room)

    def make_room(self, room):
        """Take other lists, empty ones with room for so many hits each."""
        self.room, slots, i4 = room, self._slots, np.int32
        many = SOUGHT * room + 2**16  # those near tall things are sought for longer
        self._tasks = cuda.device_array((many, 2), i4)
        self._words = cuda.device_array(many, np.uint64)
        self.lists = ImpactLists(
            cuda.to_device(np.zeros(slots, i4)),
            cuda.device_array((slots, room, VALUES), np.float64),
            cuda.device_array((slots, room, LABELS), i4),
            cuda.device_array((slots, room), np.uint64),
        )

    def list(self, field, start, stop, smallest=0.0):
        """List the drops that end in an interval; arguments as `rainsim.drops.impacts` has them."""
        self._queue(field, start, stop, smallest)
        while (lacking := self.lacking()) > 0:
            self.make_room(self.room + 2 * lacking)
            self._queue(field, start, stop, smallest)

    def _queue(self, field, start, stop, smallest=0.0, slot=0):
        """Queue the filling of a list."""
        first, last = field.cubes_in(*self._corners, start, stop - start)
        sides = np.maximum(last - first + 1, 0)
        columns = sides[:, 0] * sides[:, 1] * (field.spectrum.edges[1:] > smallest)
        now = self._now
        now.host["counts"][1:] = columns.cumsum()
        now.update(first=first, last=last)
        now.take(field)
        now.send()
        times = float(start), float(stop), slot
        seek[BLOCKS, THREADS](
            now.columns, *times, now.field, self.surfaces, self.lists.found, now["sought"],
            self._tasks, self._words,
        )  # fmt: skip
        fill_impacts[BLOCKS, THREADS](
            now.columns, *times, now["sought"], self._tasks, self._words, now.field,
            self.surfaces, *self.lists,
        )  # fmt: skip

    def lacking(self):
        """Return how many hits the fullest list has no room for; waits."""
        return max(int(self.lists.found.copy_to_host().max()) - self.room, 0)


def sent_surfaces(surfaces):
    """Return the `HeightFields` of a map with its arrays on the device."""
    fields = surfaces.height_fields()
    return fields._replace(
        **{
            name: cuda.to_device(value)
            for name, value in fields._asdict().items()
            if isinstance(value, np.ndarray)
        }
    )


def arrays_of(field):
    """Return name, shape and dtype of the arrays of a `DropField`, for `FrameUniforms`."""
    return {name: (a.shape, a.dtype) for name, a in field.arrays()._asdict().items()}


def room_for(field, surfaces, duration):
    """Return how many hits a list for `duration` [s] should have room for."""
    rate = float((field.listed.density * field.listed.speed).sum())
    expected = rate * surfaces.area * duration
    return int(ROOM * expected + 6 * math.sqrt(expected) + 256)
