"""Drips from edges on a CUDA device: twin of `rain.dripping`.

A thread takes a point from which drops part, or a drop that is in the air. Water is counted in
whole numbers of VOLUME_UNIT, so that the order in which it comes does not matter; lists are in the
order of chance. A step reads one page and writes the other, because the frame before may still
show the one that it reads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rainsim.constants import WATER_DENSITY
from rainsim.cuda.driver import to_device
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel, pinned
from rainsim.cuda.rain.drip_list import (
    AIRBORNE,
    BEGIN,
    BOOK,
    BOTTOM,
    DIAMETER,
    DRIP,
    DRIP_WIND_X,
    DRIP_WIND_Y,
    END,
    FILM,
    FINE,
    HANGING,
    LISTED,
    LOST,
    RETURNED,
    TOP,
    DripList,
    X,
    Y,
    cell_of,
)
from rainsim.cuda.rain.settling import VOLUME_UNIT, ring
from rainsim.cuda.small_copies import copy_small
from rainsim.cuda.warp import THREADS
from rainsim.cuda.water.step_control import UNIT, block_sum
from rainsim.errors import BackendError
from rainsim.numerics.random import subkey, uniform
from rainsim.rain.dripping import (
    _MOST_AT_ONCE,
    KEPT,
    SMALLEST,
    drip_end,
    fall_time,
)
from rainsim.rain.size_distribution import drop_volume
from rainsim.rain.wind import wind_at

MOST = 2**20  # drips that there is ever room for
_STEP_BLOCKS = 2 if SIMULATED else 132 * 2
# A row of `sites`, float64: as the first of DRIP_COLUMNS, then the time [s] that a drop falls
# (negative: the water runs off) and the wind there over that at WIND_HEIGHT.
SITE = 7
FALL, WIND = 5, 6
# A row of `ends`, int32: the point that takes the water that falls there, the foot's cell, and how
# many cells bring water.
NEXT, ROW, COLUMN, CELLS = range(4)
# `now`, float64: the interval [s], the wind [m/s], and a cell's share of the finer rain [m3].
NOW = 5
START, STOP, WIND_X, WIND_Y, FINER = range(NOW)


class Sites(NamedTuple):
    """The points from which drops part.

    keys : uint64 device array (sites,)
    sites : float64 device array (sites, SITE). See X to WIND.
    ends : int32 device array (sites + 1, 4). See NEXT to CELLS; the last row is
        all that reaches no edge.
    point : int32 device array (ny, nx). As `rainsim.rain.dripping.Drips` has it.
    """

    keys: object
    sites: object
    ends: object
    point: object


@cuda_kernel
def drip(
    now, points, surfaces, before, layout, tile, came, store, room, parted, came_out, book_out,
    table_out, where_out, ids_out, waiting_out, pushes_out,
):  # fmt: skip
    """Let drops part, fall and land in an interval, and list those that show after it.

    now : float64 device array (NOW,). See START to FINER.
    points : Sites
    surfaces : HeightFields. Of device arrays.
    before : Page. The drops that the step before has listed.
    layout : CellLayout
    tile : RippleTile
    came : int64 device array (sites + 1,) [VOLUME_UNIT]. Water that has come to
        each point; blanked.
    store, room, parted : device arrays of shape (sites,), int64. Water at each
        edge, how much the films still take [VOLUME_UNIT], drops so far; modified.
    came_out : int64 device array (sites + 1,) [VOLUME_UNIT]. Water that has come
        for the next interval; added to.
    book_out, table_out, where_out, ids_out : device arrays. The page that this
        step writes; `book_out` is blank.
    waiting_out, pushes_out. As in `drops.settle`.
    """
    sums = cuda.shared.array(THREADS, np.int64)
    hanging, flying, taken, lost, returned, finer = _part(
        now, points, surfaces, layout, tile, came, store, room, parted, came_out, book_out,
        table_out, where_out, ids_out, waiting_out, pushes_out,
    )  # fmt: skip
    held, aloft, down = _fall_on(
        now, points, surfaces, before, layout, tile, came_out, book_out, table_out, where_out,
        ids_out, waiting_out, pushes_out,
    )  # fmt: skip
    water = hanging + held, flying + aloft, taken, lost, returned + down, finer
    _add_up(sums, water, before.book, book_out)


@cuda.jit(device=True)
def _part(
    now, points, surfaces, layout, tile, came, store, room, parted, came_out, book_out,
    table_out, where_out, ids_out, waiting_out, pushes_out,
):  # fmt: skip
    """Let drops part; return what became of a thread's water, in the order of `_add_up`."""
    start, stop, count = now[START], now[STOP], len(points.keys)
    sites, ends = points.sites, points.ends
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
                ends, n, ends[n, ROW], ends[n, COLUMN], water, layout, came_out, waiting_out
            )
            returned += down
            hanging += water - down
            store[n] = 0
            continue
        volume = _units(sites[n, DIAMETER])
        drops = min(water // volume, _MOST_AT_ONCE)
        store[n] = water - drops * volume
        hanging += store[n]
        for drop in range(drops):
            word = subkey(points.keys[n], parted[n] + drop + 16)
            begin = start + (stop - start) * ((drop + uniform(word)) / drops)
            flight = Flight(
                word, sites[n, X], sites[n, Y], sites[n, DIAMETER], begin, begin + sites[n, FALL],
                now[WIND_X] * sites[n, WIND], now[WIND_Y] * sites[n, WIND],
            )  # fmt: skip
            if flight.end >= stop:
                flying += volume
            else:
                down = _land(
                    flight, n, now, points, surfaces, layout, tile, came_out, waiting_out,
                    pushes_out,
                )  # fmt: skip
                returned += down
                hanging += volume - down
            if flight.end >= stop - KEPT:
                at = cuda.atomic.add(book_out, LISTED, 1)
                if at < len(ids_out):
                    table_out[at, TOP], table_out[at, BOTTOM] = sites[n, TOP], sites[n, BOTTOM]
                    _write_flight(flight, at, table_out)
                    where_out[at], ids_out[at] = n, word
        parted[n] += drops
    return hanging, flying, taken, lost, returned, finer


@cuda.jit(device=True)
def _fall_on(
    now, points, surfaces, before, layout, tile, came_out, book_out, table_out, where_out,
    ids_out, waiting_out, pushes_out,
):  # fmt: skip
    """Let the drips in the air fall on; return a thread's water that hangs, flies, came down."""
    start, stop = now[START], now[STOP]
    hanging = flying = returned = np.int64(0)
    for n in range(cuda.grid(1), min(before.book[LISTED], len(before.ids)), cuda.gridsize(1)):
        flight = _flight_of(n, before)
        volume = _units(flight.diameter)
        if flight.end >= stop:
            flying += volume
        elif flight.end >= start:
            down = _land(
                flight, before.where[n], now, points, surfaces, layout, tile, came_out,
                waiting_out, pushes_out,
            )  # fmt: skip
            returned += down
            hanging += volume - down
        if flight.end >= stop - KEPT:
            at = cuda.atomic.add(book_out, LISTED, 1)
            if at < len(ids_out):
                for column in range(DRIP):
                    table_out[at, column] = before.table[n, column]
                where_out[at], ids_out[at] = before.where[n], before.ids[n]
    return hanging, flying, returned


@cuda.jit(device=True)
def _add_up(sums, water, before, book_out):
    """Add to a book the water of a block's threads and, once, the account of the book before.

    `water` is in VOLUME_UNIT: what hangs, flies, went to films, got lost, came down, came as finer
    rain.
    """
    thread = cuda.threadIdx.x
    hanging, flying = block_sum(sums, thread, water[0]), block_sum(sums, thread, water[1])
    taken, lost = block_sum(sums, thread, water[2]), block_sum(sums, thread, water[3])
    returned, finer = block_sum(sums, thread, water[4]), block_sum(sums, thread, water[5])
    if thread == 0:
        cuda.atomic.add(book_out, HANGING, hanging)
        cuda.atomic.add(book_out, AIRBORNE, flying)
        begun = 1 if cuda.blockIdx.x == 0 else 0
        cuda.atomic.add(book_out, FILM, taken + begun * before[FILM])
        cuda.atomic.add(book_out, LOST, lost + begun * before[LOST])
        cuda.atomic.add(book_out, RETURNED, returned + begun * before[RETURNED])
        cuda.atomic.add(book_out, FINE, finer + begun * before[FINE])


class Flight(NamedTuple):
    """A drip's fall: its id, where it parted (x, y) [m], diameter [m], times [s], wind [m/s]."""

    word: int
    x: float
    y: float
    diameter: float
    begin: float
    end: float
    wind_x: float
    wind_y: float


@cuda.jit(device=True)
def _flight_of(n, page):
    """Return the `Flight` of drip n of a `Page`."""
    table = page.table
    return Flight(
        page.ids[n], table[n, X], table[n, Y], table[n, DIAMETER], table[n, BEGIN], table[n, END],
        table[n, DRIP_WIND_X], table[n, DRIP_WIND_Y],
    )  # fmt: skip


@cuda.jit(device=True)
def _write_flight(flight, at, table_out):
    """Write a `Flight` to its row of a table; the heights stay as they are."""
    table_out[at, X], table_out[at, Y] = flight.x, flight.y
    table_out[at, DIAMETER] = flight.diameter
    table_out[at, BEGIN], table_out[at, END] = flight.begin, flight.end
    table_out[at, DRIP_WIND_X], table_out[at, DRIP_WIND_Y] = flight.wind_x, flight.wind_y


@cuda.jit(device=True)
def _units(diameter):
    """Return the water of a drop in VOLUME_UNIT."""
    return np.int64(drop_volume(diameter) / VOLUME_UNIT + 0.5)


@cuda.jit(device=True)
def _come_down(ends, site, row, column, water, layout, came_out, waiting_out):
    """Give water [VOLUME_UNIT] to a cell of the ground, or to a lower object; return the former."""
    after = ends[site, NEXT]
    if after != -1:
        cuda.atomic.add(came_out, after if after >= 0 else len(came_out) - 1, water)
        return np.int64(0)
    depth = water * (VOLUME_UNIT / UNIT) / layout.area
    cell = layout.first + row * layout.width + column
    cuda.atomic.add(waiting_out, cell, np.int64(depth + 0.5))
    return water


@cuda.jit(device=True)
def _land(flight, site, now, points, surfaces, layout, tile, came_out, waiting_out, pushes_out):
    """Let a drop come down; return its water [VOLUME_UNIT] if it is on the ground then."""
    x, y, speed = drip_end(
        flight.x, flight.y, flight.diameter, flight.begin, flight.end, flight.wind_x,
        flight.wind_y,
    )  # fmt: skip
    row, column, inside = cell_of(x, y, surfaces)
    if surfaces.top[row, column] <= surfaces.ground[row, column]:
        momentum = WATER_DENSITY * drop_volume(flight.diameter) * speed
        age = (now[STOP] - flight.end) / max(now[STOP] - now[START], 1e-30)
        ring(flight.word, x, y, momentum, age, tile, pushes_out)
    if not (inside and points.point[row, column] == -1):
        row, column = points.ends[site, ROW], points.ends[site, COLUMN]
    return _come_down(
        points.ends, site, row, column, _units(flight.diameter), layout, came_out, waiting_out
    )


class Drips:
    """The water on the objects of a map and the drops that leave them, on a CUDA device.

    drips : rainsim.rain.dripping.Drips. Its state is copied; its seed, wind and
        places are those of the map.
    impacts : Impacts. What falls on the objects; its lists are settled before
        `launch`.
    rate : float [m/s]. Of the heaviest rain.
    interval : float [s]. Of a step.
    roughness : float [m]. Of the land.
    stream : cuda.stream
    pages : list of DripList
    point : int32 device array (ny, nx)
    came : list of int64 device array (points + 1,) [VOLUME_UNIT]. Water that has
        come to each point, by the page of the step that takes it up.
    account : pinned array of shape (BOOK,), int64. The book at the end of the
        last step that is done.
    """

    def __init__(self, drips, impacts, rate, interval, roughness, stream=0):
        surfaces = drips._surfaces
        self._surfaces, self._area = impacts.surfaces, surfaces.spacing**2
        sites, ends = _sites_of(drips, roughness)
        longest = sites[:, FALL].max(initial=0.0) + KEPT + interval
        # Wind brings rain to walls too, but hardly more than falls on all of the map.
        most = 2 * rate * surfaces.area * longest / drop_volume(SMALLEST)
        room = int(min(most, MOST)) + 2 * len(sites) + 1024
        self.pages = [DripList(room, stream) for _ in range(2)]
        self._sites = Sites(
            *(to_device(array, stream) for array in (drips._key, sites, ends, drips.point))
        )
        self.point = self._sites.point
        store, film = (
            np.rint(water / VOLUME_UNIT).astype(np.int64) for water in (drips._store, drips._room)
        )
        self._store, self._room, self._parted = (
            to_device(array, stream) for array in (store, film, drips._drops)
        )
        self.came = [to_device(np.zeros(len(ends), np.int64), stream) for _ in range(2)]
        self._blank = to_device(np.zeros(BOOK, np.int64), stream)
        self._now = FrameUniforms(stream, {"now": ((NOW,), np.float64)})
        self.account = pinned(BOOK, np.int64)
        self.account[HANGING] = store.sum()
        for which, water in ((AIRBORNE, drips.airborne), (FILM, drips._film), (LOST, drips._lost)):
            self.account[which] = round(water / VOLUME_UNIT)
        where = np.concatenate([drips._flight["site"], drips._landed["site"]])
        self.pages[0].fill(*drips.falling(), where, self.account)

    def update(self, start, stop, wind, finer):
        """Set the next step: its times [s], the wind [m/s], a depth of finer rain [m]."""
        self._now.update(now=(start, stop, *wind, finer * self._area))

    def launch(self, page, water, ripples, stream):
        """Queue a step that writes to a page; see `Impacts.settle`."""
        now, before = self.pages[page].page, self.pages[1 - page].page
        self._now.send(stream)
        now.book.copy_to_device(self._blank, stream=stream)
        drip[_STEP_BLOCKS, THREADS, stream](
            self._now["now"], self._sites, self._surfaces, before,
            water.cells, ripples.tile, self.came[page],
            self._store, self._room, self._parted, self.came[1 - page], *now, water.waiting,
            ripples.pushes,
        )  # fmt: skip
        copy_small(now.book, self.account, stream)

    def check(self):
        """Raise BackendError if a finished step had too little room."""
        listed = self.account[LISTED]
        if listed > self.pages[0].room:
            raise BackendError(
                f"{listed} drips are in the air, which is more than there is room for; "
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
