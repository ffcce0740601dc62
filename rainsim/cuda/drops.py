"""Drops that end where their splash may show, listed on a CUDA device.

A thread finds which cubes over its column of the map may hold drops that end in the column's time,
and in view; the block then goes through all its cubes, a group of lanes a cube and a lane a drop. A
second kernel follows the drops that may end: those near something over that time, and from the sky
the few that meet something in it. The list's order is that of chance; sums over the list are taken
in whole numbers, so that its order does not matter.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.cuda.driver import fetch
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.warp import GROUP, THREADS, ballot, claim_row
from rainsim.numerics.random import uniform
from rainsim.particles.splash_pass import BOXES, Windows, column_in_view
from rainsim.rain import poisson_cells
from rainsim.rain.heightfield import first_hit
from rainsim.rain.impacts import TIME_MARGIN, cubes_swept, may_land
from rainsim.rain.size_distribution import CLASSES

BLOCK_COLUMNS = 4 if SIMULATED else 32  # that a block looks at together
BLOCKS = 2 if SIMULATED else 132 * 8
SOUGHT = 16  # drops sought, at most, for one that is found
_CHUNK = 2 * THREADS  # drops sought that a block of `fill_impacts` goes through together
_FEW = 36  # cells that the cheap test of a path looks at
_ASIDE = 1e-3  # of a cell, or m: how far it looks beyond
# Places in a row of `values` (float64: place [m], diameter [m], time [s]) and of `labels` (int32).
VALUES, LABELS = 5, 4
X, Y, Z, DIAMETER, TIME = range(VALUES)
CLASS, KIND, ROW, COLUMN = range(LABELS)


class ImpactList(NamedTuple):
    """A list of drops that ended, as `fill_impacts` writes it.

    found : int32 device array (1,). Drops that ended, also those for which there
        is no room.
    values : float64 device array (room, VALUES). See X to TIME.
    labels : int32 device array (room, LABELS). See CLASS to COLUMN.
    ids : uint64 device array (room,)
    """

    found: object
    values: object
    labels: object
    ids: object


@cuda_kernel
def seek(counts, windows, sent, field, surfaces, sought_out, tasks_out, words_out):
    """List the drops that may end in a window and in view: a cheap test of each in the air.

    counts : int64 device array (BOXES + 1,). Columns of cubes in all boxes before
        each of the windows'.
    sent : ShutterView
    surfaces : HeightFields. As the others, of device arrays.
    sought_out : int32 device array (1,). Raised by the number of drops, also of
        those for which the list has no room.
    tasks_out : int32 device array (room, 2). The column's number and the cube's
        place along z.
    words_out : uint64 device array (room,). The drops' ids.
    """
    places = cuda.shared.array((BLOCK_COLUMNS, 4), np.int64)  # class and first cube
    spans = cuda.shared.array((BLOCK_COLUMNS, 4), np.float64)  # lowest, highest; start, stop
    many = cuda.shared.array(BLOCK_COLUMNS, np.int32)  # cubes of each column
    ends = cuda.shared.array(BLOCK_COLUMNS, np.int32)  # and of all up to it
    thread, lane, most = cuda.threadIdx.x, cuda.threadIdx.x % GROUP, field.count.shape[1]
    total = counts[BOXES]
    batches = (total + BLOCK_COLUMNS - 1) // BLOCK_COLUMNS
    for batch in range(cuda.blockIdx.x, batches, cuda.gridDim.x):
        if thread < BLOCK_COLUMNS:
            # Far from each other, so that all blocks find about as many.
            task = thread * batches + batch
            many[thread] = 0
            if task < total:
                b, i, j, start, stop = _column_of(task, counts, windows)
                k_first, k_last, low_z, high_z = cubes_swept(b, i, j, start, stop, field, surfaces)
                places[thread, 0], places[thread, 1] = b, i
                places[thread, 2], places[thread, 3] = j, k_first
                spans[thread, 0], spans[thread, 1] = low_z, high_z
                spans[thread, 2], spans[thread, 3] = start, stop
                if k_first <= k_last and column_in_view(
                    b, i, j, start, stop, low_z, high_z, field, sent
                ):
                    many[thread] = k_last - k_first + 1
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
                        word, cube, spans[column, 2], spans[column, 3], spans[column, 0],
                        spans[column, 1], field, surfaces,
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
    counts, windows, sought, tasks, words, field, surfaces, found_out, values_out, labels_out,
    ids_out,
):  # fmt: skip
    """List those of the drops sought that end in their window.

    found_out, values_out, labels_out, ids_out. See `ImpactList`. The number
        found is beyond all room if there was none for a drop sought.
    """
    near = cuda.shared.array(_CHUNK, np.int32)  # drops that may meet something in the interval
    hitting = cuda.shared.array(_CHUNK, np.int32)  # drops that would, if nothing stopped them
    waiting = cuda.shared.array(2, np.int32)
    thread, room = cuda.threadIdx.x, words.shape[0]
    listed = min(sought[0], room)
    if cuda.grid(1) == 0 and sought[0] > room:
        cuda.atomic.add(found_out, 0, ids_out.shape[0] + sought[0] - room)
    # Each test keeps less than half of the drops; those that are kept go on in full warps.
    for begin in range(cuda.blockIdx.x * _CHUNK, listed, cuda.gridDim.x * _CHUNK):
        if thread == 0:
            waiting[0] = waiting[1] = 0
        cuda.syncthreads()
        for part in range(_CHUNK // THREADS):
            n = begin + part * THREADS + thread
            wanted = False
            if n < listed:
                b, x, y, z, start, stop = _place(n, tasks, words, counts, windows, field)
                wanted = not _passes_over(b, x, y, z, start, stop, field, surfaces)
            at = claim_row(waiting, 0, wanted)
            if wanted:
                near[at] = n
        cuda.syncthreads()
        for at in range(0, waiting[0], THREADS):
            wanted = False
            if at + thread < waiting[0]:
                n = near[at + thread]
                b, x, y, z, start, stop = _place(n, tasks, words, counts, windows, field)
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
                b, x, y, z, start, stop = _place(n, tasks, words, counts, windows, field)
                vx, vy, vz = field.velocity[b, 0], field.velocity[b, 1], field.velocity[b, 2]
                time, kind, row, column = first_hit(
                    x, y, z, vx, vy, vz, -np.inf, stop + TIME_MARGIN, surfaces
                )
                wanted = start <= time < stop
            place = claim_row(found_out, 0, wanted)
            if wanted and place < ids_out.shape[0]:
                word = words[n]
                values_out[place, X] = x + vx * time
                values_out[place, Y] = y + vy * time
                values_out[place, Z] = z + vz * time
                values_out[place, DIAMETER] = poisson_cells.drop_diameter(word, b, field)
                values_out[place, TIME] = time
                labels_out[place, CLASS], labels_out[place, KIND] = b, kind
                labels_out[place, ROW], labels_out[place, COLUMN] = row, column
                ids_out[place] = word
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
def _place(n, tasks, words, counts, windows, field):
    """Return the class of drop n of a list, where it would be at time 0 [m], and its window."""
    b, i, j, start, stop = _column_of(tasks[n, 0], counts, windows)
    x, y, z = poisson_cells.drop_place(words[n], poisson_cells.Cube(b, i, j, tasks[n, 1]), field)
    return b, x, y, z, start, stop


@cuda.jit(device=True)
def box_of(task, counts):
    """Return the box that holds number `task` of all boxes', and its number in the box."""
    box, end = 0, len(counts) - 1
    while end - box > 1:
        middle = (box + end) // 2
        if counts[middle] <= task:
            box = middle
        else:
            end = middle
    return box, task - counts[box]


@cuda.jit(device=True)
def _column_of(task, counts, windows):
    """Return class, place (i, j) and window (start, stop) of column `task` of all boxes'."""
    box, rest = box_of(task, counts)
    wide = windows.last[box, 1] - windows.first[box, 1] + 1
    i, j = windows.first[box, 0] + rest // wide, windows.first[box, 1] + rest % wide
    return box % CLASSES, i, j, windows.starts[box], windows.stops[box]


class Impacts:
    """The drops whose splashes may show in a picture, listed on a CUDA device."""

    def __init__(self):
        f8, i8, i4 = np.float64, np.int64, np.int32
        self._now = now = FrameUniforms({
            "counts": ((BOXES + 1,), i8), "starts": ((BOXES,), f8), "stops": ((BOXES,), f8),
            "first": ((BOXES, 3), i8), "last": ((BOXES, 3), i8), "sought": ((1,), i4),
            "found": ((1,), i4),
        })  # fmt: skip
        self._windows = Windows(*(now[name] for name in Windows._fields))
        self.room = 0

    def _make_room(self, room):
        """Take another list, an empty one with room for so many drops."""
        self.room, many, i4 = room, SOUGHT * room + 2**16, np.int32  # more beside tall things
        self._sought = self.listed = None  # freed before more is asked for
        self._sought = (
            self._now["sought"], cuda.device_array((many, 2), i4),
            cuda.device_array(many, np.uint64),
        )  # fmt: skip
        self.listed = ImpactList(
            self._now["found"], cuda.device_array((room, VALUES), np.float64),
            cuda.device_array((room, LABELS), i4), cuda.device_array(room, np.uint64),
        )  # fmt: skip

    def list(self, field, windows, streaks):
        """List the drops that end in `Windows`, in columns of air that are in view; waits.

        streaks : cuda.particles.streaks.Streaks. Of the same rain; what it has of
            it, the camera and the map on the device is used.
        """
        now, rain = self._now, (streaks.field, streaks.surfaces)
        where = now["counts"], self._windows
        sides, lasting = windows.last - windows.first + 1, windows.stops - windows.starts
        columns = sides[:, 0] * sides[:, 1] * (lasting > 0)
        rate = field.listed.density * field.listed.speed * field.cube**2  # of a column [Hz]
        expected = float(columns @ (np.tile(rate, BOXES // CLASSES) * lasting))
        now.host["counts"][1:] = columns.cumsum()
        now.update(**windows._asdict())
        room = int(expected + 6 * math.sqrt(expected) + 256)
        while True:
            if self.room < room:
                self._make_room(room)
            now.send()  # which blanks the counts
            seek[BLOCKS, THREADS](*where, streaks.view, *rain, *self._sought)
            fill_impacts[BLOCKS, THREADS](*where, *self._sought, *rain, *self.listed)
            lacking = int(fetch(now["found"])[0]) - self.room
            if lacking <= 0:
                return
            room = self.room + 2 * lacking


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
