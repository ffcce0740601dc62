"""Drips from edges on a CUDA device: twin of `rainsim.drips`, and of how pictures show them.

A thread takes a point from which drops part, or a drop that is in the air. Water is counted in
whole numbers of VOLUME_UNIT, so that the order in which it comes does not show; lists are in the
order of chance. A step reads one page and writes the other: the frame before may still show it.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.cuda.account import UNIT, block_sum
from rainsim.cuda.drops import BLOCKS, VOLUME_UNIT, ring
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel, pinned
from rainsim.cuda.numbers import Numbers
from rainsim.cuda.splash import list_splash, seen_at, splashes_still
from rainsim.cuda.warp import GROUPS, THREADS
from rainsim.drips import (
    _MOST_AT_ONCE,
    DRIP_COLUMNS,
    KEPT,
    SMALLEST,
    drip_end,
    drip_line,
    fall_time,
)
from rainsim.errors import BackendError
from rainsim.random import subkey, uniform
from rainsim.spectrum import WATER_DENSITY, drop_volume
from rainsim.splash import LONGEST_LIFE
from rainsim.streaks import draw_line
from rainsim.weather import wind_at

MOST = 2**20  # drips that there is ever room for
_STEP_BLOCKS = 2 if SIMULATED else 132 * 2
# `sites`, float64: as the first of DRIP_COLUMNS, then the time [s] that a drop falls (negative:
# the water runs off) and the wind there over that at WIND_HEIGHT
(X, Y, TOP, BOTTOM, DIAMETER, FALL, WIND) = range(7)
SITE = 7
# `ends`, int32: the point that takes what falls there, the foot's cell, and cells that bring water
(NEXT, ROW, COLUMN, CELLS) = range(4)
# `book`, int64: drops listed; water [VOLUME_UNIT] on edges and in the air; and, since the start, in
# films, where no edge can be reached, come down to the ground, and come as finer rain
(LISTED, HANGING, AIRBORNE, FILM, LOST, RETURNED, FINE) = range(7)
BOOK = 7
# `now`, float64: the interval [s], the wind [m/s], and a cell's share of the finer rain [m3]
(START, STOP, WIND_X, WIND_Y, FINER) = range(5)
NOW = 5


@cuda_kernel
def drip(
    now, keys, sites, ends, came, store, room, parted, point, x0, y0, spacing, ground, top, book,
    table, where, ids, first, width, tile, steps, cells, share, came_out, book_out, table_out,
    where_out, ids_out, waiting_out, pushes_out,
):  # fmt: skip
    """Let drops part, fall and land in an interval, and list those that show after it.

    Parameters
    ----------
    now : device array of shape (NOW,), float64
        See the module's constants; so for `sites`, `ends` and `book`.
    keys : device array of shape (sites,), uint64
    sites : device array of shape (sites, SITE), float64
    ends : device array of shape (sites + 1, 4), int32
        The last one is all that reaches no edge.
    came : device array of shape (sites + 1,), int64 [VOLUME_UNIT]
        What has come to each point; blanked.
    store, room, parted : device arrays of shape (sites,), int64
        Water at each edge, what the films still take [VOLUME_UNIT], drops so far; modified.
    point : device array of shape (ny, nx), int32
        As `rainsim.drips.Drips` has it.
    x0, y0, spacing, ground, top
        As `drops.fill_impacts` has them.
    book, table, where, ids : device arrays
        The drops of the page before: account, `DRIP_COLUMNS`, point and id.
    first, width, tile, steps, cells, share
        As in `drops.settle`.
    came_out : device array of shape (sites + 1,), int64 [VOLUME_UNIT]
        What has come for the next interval.
    book_out, table_out, where_out, ids_out : device arrays
        This page; `book_out` blank.
    waiting_out, pushes_out
        As in `drops.settle`.
    """
    sums = cuda.shared.array(THREADS, np.int64)
    start, stop, count = now[START], now[STOP], len(keys)
    hanging = flying = taken = lost = returned = finer = np.int64(0)
    for n in range(cuda.grid(1), count + 1, cuda.gridsize(1)):
        fine = np.int64(now[FINER] / VOLUME_UNIT * ends[n, CELLS] + 0.5)
        finer += fine
        water = came[n] + fine
        came[n] = 0
        if n == count:
            lost += water
            continue
        film = min(water, room[n])
        room[n] -= film
        taken += film
        water += store[n] - film
        if sites[n, FALL] < 0.0:
            down = _come_down(
                ends, n, ends[n, ROW], ends[n, COLUMN], water, spacing, first, width, came_out,
                waiting_out,
            )  # fmt: skip
            returned += down
            hanging += water - down
            store[n] = 0
            continue
        volume = _units(sites[n, DIAMETER])
        drops = min(water // volume, _MOST_AT_ONCE)
        store[n] = water - drops * volume
        hanging += store[n]
        wind_x, wind_y = now[WIND_X] * sites[n, WIND], now[WIND_Y] * sites[n, WIND]
        for drop in range(drops):
            word = subkey(keys[n], parted[n] + drop + 16)
            begin = start + (stop - start) * ((drop + uniform(word)) / drops)
            end = begin + sites[n, FALL]
            if end >= stop:
                flying += volume
            else:
                down = _land(
                    ends, n, sites[n, X], sites[n, Y], sites[n, DIAMETER], begin, end, wind_x,
                    wind_y, word, start, stop, point, x0, y0, spacing, ground, top, first, width,
                    tile, steps, cells, share, came_out, waiting_out, pushes_out,
                )  # fmt: skip
                returned += down
                hanging += volume - down
            if end >= stop - KEPT:
                at = cuda.atomic.add(book_out, LISTED, 1)
                if at < len(ids_out):
                    for column in range(5):  # place, heights, diameter
                        table_out[at, column] = sites[n, column]
                    table_out[at, 5], table_out[at, 6] = begin, end
                    table_out[at, 7], table_out[at, 8] = wind_x, wind_y
                    where_out[at], ids_out[at] = n, word
        parted[n] += drops
    for n in range(cuda.grid(1), min(book[LISTED], len(ids)), cuda.gridsize(1)):
        end, volume = table[n, 6], _units(table[n, 4])
        if end >= stop:
            flying += volume
        elif end >= start:
            down = _land(
                ends, where[n], table[n, 0], table[n, 1], table[n, 4], table[n, 5], end,
                table[n, 7], table[n, 8], ids[n], start, stop, point, x0, y0, spacing, ground, top,
                first, width, tile, steps, cells, share, came_out, waiting_out, pushes_out,
            )  # fmt: skip
            returned += down
            hanging += volume - down
        if end >= stop - KEPT:
            at = cuda.atomic.add(book_out, LISTED, 1)
            if at < len(ids_out):
                for column in range(table.shape[1]):
                    table_out[at, column] = table[n, column]
                where_out[at], ids_out[at] = where[n], ids[n]
    thread = cuda.threadIdx.x
    hanging, flying = block_sum(sums, thread, hanging), block_sum(sums, thread, flying)
    taken, lost = block_sum(sums, thread, taken), block_sum(sums, thread, lost)
    returned, finer = block_sum(sums, thread, returned), block_sum(sums, thread, finer)
    if thread == 0:
        cuda.atomic.add(book_out, HANGING, hanging)
        cuda.atomic.add(book_out, AIRBORNE, flying)
        begun = 1 if cuda.blockIdx.x == 0 else 0  # one block takes over what was before
        cuda.atomic.add(book_out, FILM, taken + begun * book[FILM])
        cuda.atomic.add(book_out, LOST, lost + begun * book[LOST])
        cuda.atomic.add(book_out, RETURNED, returned + begun * book[RETURNED])
        cuda.atomic.add(book_out, FINE, finer + begun * book[FINE])


@cuda.jit(device=True)
def _units(diameter):
    """Return the water of a drop in VOLUME_UNIT."""
    return np.int64(drop_volume(diameter) / VOLUME_UNIT + 0.5)


@cuda.jit(device=True)
def _come_down(ends, site, row, column, water, spacing, first, width, came_out, waiting_out):
    """Give water [VOLUME_UNIT] to a cell of the ground, or to a lower object; return the former."""
    after = ends[site, NEXT]
    if after != -1:
        cuda.atomic.add(came_out, after if after >= 0 else len(came_out) - 1, water)
        return np.int64(0)
    depth = water * (VOLUME_UNIT / UNIT) / (spacing * spacing)
    cuda.atomic.add(waiting_out, first + row * width + column, np.int64(depth + 0.5))
    return water


@cuda.jit(device=True)
def _land(
    ends, site, x, y, diameter, begin, end, wind_x, wind_y, word, start, stop, point, x0, y0,
    spacing, ground, top, first, width, tile, steps, cells, share, came_out, waiting_out,
    pushes_out,
):  # fmt: skip
    """Let a drop come down; return its water [VOLUME_UNIT] if it is on the ground then."""
    x, y, speed = drip_end(x, y, diameter, begin, end, wind_x, wind_y)
    row, column, inside = _cell(x, y, x0, y0, spacing, top)
    if top[row, column] <= ground[row, column]:
        ring(
            word, x, y, WATER_DENSITY * drop_volume(diameter) * speed, end, start, stop, tile,
            steps, cells, share, pushes_out,
        )  # fmt: skip
    if not (inside and point[row, column] == -1):
        row, column = ends[site, ROW], ends[site, COLUMN]
    return _come_down(
        ends, site, row, column, _units(diameter), spacing, first, width, came_out, waiting_out
    )


@cuda.jit(device=True)
def _cell(x, y, x0, y0, spacing, top):
    """Return the cell of a place, or the nearest one, and whether it is on the map."""
    ny, nx = top.shape
    row, column = np.int64(math.floor((y - y0) / spacing)), np.int64(math.floor((x - x0) / spacing))
    inside = 0 <= row < ny and 0 <= column < nx
    return min(max(row, 0), ny - 1), min(max(column, 0), nx - 1), inside


@cuda_kernel
def draw_drips(
    book, table, times, rotation, eye, rotation_end, eye_end, lens, near, width, height, depth,
    tile_depth, picture,
):  # fmt: skip
    """Draw listed drips in the streaks' picture, a group of lanes for each.

    Parameters
    ----------
    book, table
        As `drip` left them.
    times : device array of shape (2,), float64 [s]
        When the shutter opens, and for how long. The other arrays are those of `splash.draw_list`.
    """
    here, there = cuda.local.array(3, np.float32), cuda.local.array(3, np.float32)
    time, exposure = times[0], times[1]
    first = cuda.blockIdx.x * cuda.blockDim.y + cuda.threadIdx.y
    for n in range(first, min(book[LISTED], len(table)), cuda.gridDim.x * cuda.blockDim.y):
        begin, end = table[n, 5], table[n, 6]
        if min(end, time + exposure) > max(begin, time):
            x, y, z, vx, vy, vz, diameter = drip_line(
                table[n, 0], table[n, 1], table[n, 2], table[n, 4], begin, end, table[n, 7],
                table[n, 8], time, exposure,
            )  # fmt: skip
            draw_line(
                x, y, z, vx, vy, vz, diameter, exposure, rotation, eye, rotation_end, eye_end,
                lens, near, width, height, depth, tile_depth, here, there, picture,
            )  # fmt: skip


@cuda_kernel
def throw_up_drips(
    book, table, ids, x0, y0, spacing, ground, top, times, rotation, eye, lens, width, height,
    water_depth, film, count_out, lines_out,
):  # fmt: skip
    """List the droplets, crowns and jets of listed drips, a group of lanes for each.

    Parameters
    ----------
    book, table, ids
        As `drip` left them.
    x0, y0, spacing, ground, top
        As `drops.fill_impacts` has them. The other arrays are those of `splash.throw_up`.
    """
    time, exposure = times[0], times[1]
    sharp = max(np.float64(lens[0]), np.float64(lens[1]))
    first = cuda.blockIdx.x * cuda.blockDim.y + cuda.threadIdx.y
    for n in range(first, min(book[LISTED], len(table)), cuda.gridDim.x * cuda.blockDim.y):
        diameter, z = table[n, 4], table[n, 3]
        age = time - table[n, 6]
        if not -exposure < age <= LONGEST_LIFE:
            continue
        x, y, speed = drip_end(
            table[n, 0], table[n, 1], diameter, table[n, 5], table[n, 6], table[n, 7], table[n, 8]
        )
        deep = seen_at(x, y, z, rotation, eye, lens, width, height)
        if not deep > 0.0:
            continue
        row, column, _ = _cell(x, y, x0, y0, spacing, top)
        under = film[0]
        if top[row, column] <= ground[row, column]:
            under += np.float64(water_depth[row, column])
        if splashes_still(diameter, speed, under, age, deep / sharp):
            list_splash(
                ids[n], x, y, z, 0.0, 0.0, speed, diameter, under, age, deep / sharp, exposure,
                count_out, lines_out,
            )  # fmt: skip


class DripList:
    """Drips in the air and those that have just landed, on the device, in no order.

    Parameters
    ----------
    room : int
    stream : cuda.stream

    Attributes
    ----------
    book : device array of shape (BOOK,), int64
    table : device array of shape (room, 9), float64
        See `rainsim.drips.DRIP_COLUMNS`.
    where : device array of shape (room,), int32
    ids : device array of shape (room,), uint64
    """

    def __init__(self, room, stream=0):
        self.room, self._stream = room, stream
        self.book = cuda.to_device(np.zeros(BOOK, np.int64), stream)
        self.table = cuda.device_array((room, len(DRIP_COLUMNS)), np.float64, stream=stream)
        self.where = cuda.device_array(room, np.int32, stream=stream)
        self.ids = cuda.device_array(room, np.uint64, stream=stream)

    @property
    def arrays(self):
        """Account, table, points and ids."""
        return self.book, self.table, self.where, self.ids

    def fill(self, table, ids, where=None, book=None):
        """Bring a list from the host."""
        count = len(ids)
        book = np.zeros(BOOK, np.int64) if book is None else book
        book[LISTED] = count
        self.book.copy_to_device(book, stream=self._stream)
        for array, values in ((self.table, table), (self.ids, ids), (self.where, where)):
            if count and values is not None:
                values = np.ascontiguousarray(values, array.dtype)
                array[:count].copy_to_device(values, stream=self._stream)

    def fetch(self):
        """Return the table and the ids on the host, in the order of the ids; waits for them."""
        count = int(self.book.copy_to_host(stream=self._stream)[LISTED])
        ids = self.ids.copy_to_host(stream=self._stream)[:count]
        order = np.argsort(ids)
        return self.table.copy_to_host(stream=self._stream)[:count][order], ids[order]

    def draw(self, seen, stream):
        """Queue the drawing into the streaks' picture; `seen` as `Streaks.seen` gives it."""
        draw_drips[BLOCKS, GROUPS, stream](self.book, self.table, *seen)

    def gather(self, *splashes, stream):
        """Queue the listing of what they throw up; the rest of `throw_up_drips`' arguments."""
        throw_up_drips[BLOCKS, GROUPS, stream](self.book, self.table, self.ids, *splashes)


class Drips:
    """The water on the objects of a map and the drops that leave them, on a CUDA device.

    Parameters
    ----------
    drips : rainsim.drips.Drips
        Its state is copied; its seed, wind and places are those of the map.
    impacts : Impacts
        What falls on the objects; its lists are settled before `launch`.
    rate : float [m/s]
        Of the heaviest rain.
    interval : float [s]
        Of a step.
    roughness : float [m]
        Of the land.
    stream : cuda.stream

    Attributes
    ----------
    pages : list of DripList
    point : device array of shape (ny, nx), int32
    came : list of device array of shape (points + 1,), int64 [VOLUME_UNIT]
        What has come to each point, by the page of the step that takes it up.
    told : pinned array of shape (BOOK,), int64
        The account at the end of the last step that is done.
    """

    def __init__(self, drips, impacts, rate, interval, roughness, stream=0):
        surfaces = drips._surfaces
        self._maps, self._area = impacts.ground_and_top, surfaces.spacing**2
        sites, ends = _sites_of(drips, roughness)
        longest = sites[:, FALL].max(initial=0.0) + KEPT + interval
        # Wind brings rain to walls too, but hardly more than falls on all of the map.
        most = 2 * rate * surfaces.area * longest / drop_volume(SMALLEST)
        room = int(min(most, MOST)) + 2 * len(sites) + 1024
        self.pages = [DripList(room, stream) for _ in range(2)]
        self._keys, self._sites, self._ends, self.point = (
            cuda.to_device(array, stream) for array in (drips._key, sites, ends, drips.point)
        )
        store, film = (
            np.rint(water / VOLUME_UNIT).astype(np.int64) for water in (drips._store, drips._room)
        )
        self._store, self._room, self._parted = (
            cuda.to_device(array, stream) for array in (store, film, drips._drops)
        )
        self.came = [cuda.to_device(np.zeros(len(ends), np.int64), stream) for _ in range(2)]
        self._blank = cuda.to_device(np.zeros(BOOK, np.int64), stream)
        self._now = Numbers(stream, {"now": ((NOW,), np.float64)})
        self.told = pinned(BOOK, np.int64)
        self.told[HANGING] = store.sum()
        for which, water in ((AIRBORNE, drips.airborne), (FILM, drips._film), (LOST, drips._lost)):
            self.told[which] = round(water / VOLUME_UNIT)
        where = np.concatenate([drips._flight["site"], drips._landed["site"]])
        self.pages[0].fill(*drips.falling(), where, self.told)

    def update(self, start, stop, wind, finer):
        """Say what the next step is: its times [s], the wind [m/s], a depth of finer rain [m]."""
        self._now.update(now=(start, stop, *wind, finer * self._area))

    def launch(self, page, water, ripples, share, stream):
        """Queue a step that writes to a page; see `Impacts.settle`."""
        now, then = self.pages[page], self.pages[1 - page]
        self._now.send(stream)
        now.book.copy_to_device(self._blank, stream=stream)
        drip[_STEP_BLOCKS, THREADS, stream](
            self._now["now"], self._keys, self._sites, self._ends, self.came[page], self._store,
            self._room, self._parted, self.point, *self._maps, *then.arrays, water.first,
            water.width, ripples.size, ripples.steps, ripples.cells, share, self.came[1 - page],
            *now.arrays, water.waiting, ripples.pushes,
        )  # fmt: skip
        now.book.copy_to_host(self.told, stream=stream)

    def check(self):
        """Raise BackendError if a finished step had too little room."""
        if self.told[LISTED] > self.pages[0].room:
            raise BackendError(
                f"{self.told[LISTED]} drips are in the air, which is more than there is room for; "
                "set drips to false, or use backend cpu"
            )


def volumes(book):
    """Return the water [m3] on objects, in the air, come down from them, and come as finer rain."""
    held = sum(int(book[which]) for which in (HANGING, FILM, LOST))
    rest = (int(book[which]) for which in (AIRBORNE, RETURNED, FINE))
    return tuple(water * VOLUME_UNIT for water in (held, *rest))


def _sites_of(drips, roughness):
    """Return `sites` and `ends` of the host's drips, see the module's constants."""
    count = len(drips._from)
    sites, ends = np.zeros((count, SITE)), np.full((count + 1, 4), -2, np.int32)
    height = drips._from - drips._to
    sites[:, X], sites[:, Y], sites[:, TOP], sites[:, BOTTOM] = (
        drips._x, drips._y, drips._from, drips._to
    )  # fmt: skip
    sites[:, DIAMETER], sites[:, WIND] = drips._diameter, wind_at(0.5 * height, roughness)
    sites[:, FALL] = np.where(drips._falls, fall_time(height, drips._diameter), -1.0)
    ends[:count, NEXT], ends[:count, ROW], ends[:count, COLUMN] = (
        drips._next, drips._row, drips._column
    )  # fmt: skip
    point = drips.point
    ends[:count, CELLS] = np.bincount(point[point >= 0], minlength=count)
    ends[count, CELLS] = np.count_nonzero(point == -2)
    return sites, ends
