"""Drips in the air and those that have just landed, as a list on a CUDA device, and as pictures."""

import math
from typing import NamedTuple

import numpy as np

from rainsim.cuda.driver import SentRows
from rainsim.cuda.drops import BLOCKS
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.cuda.particles.streaks import view_of
from rainsim.cuda.warp import GROUPS
from rainsim.io.states import DRIP_COLUMNS, NO_DRIPS, NO_IDS
from rainsim.particles.splash import LONGEST_LIFE, Impact
from rainsim.particles.splash_pass import list_splash, seen_at
from rainsim.particles.streaks import Line, draw_line
from rainsim.rain.dripping import drip_end, drip_line, listed

# A row of `table`, float64: DRIP_COLUMNS.
DRIP = len(DRIP_COLUMNS)
X, Y, TOP, BOTTOM, DIAMETER, BEGIN, END, DRIP_WIND_X, DRIP_WIND_Y = range(DRIP)


class ListedDrips(NamedTuple):
    """Listed drips: their number, the `DRIP_COLUMNS` of each, and their ids."""

    count: int
    table: object
    ids: object


@cuda.jit(device=True)
def cell_of(x, y, surfaces):
    """Return the cell of a place, or the nearest one, and whether it is on the map."""
    ny, nx = surfaces.top.shape
    row = np.int64(math.floor((y - surfaces.y0) / surfaces.spacing))
    column = np.int64(math.floor((x - surfaces.x0) / surfaces.spacing))
    inside = 0 <= row < ny and 0 <= column < nx
    return min(max(row, 0), ny - 1), min(max(column, 0), nx - 1), inside


@cuda_kernel
def draw_drips(drips, sent, scene, picture):
    """Draw listed drips in the streaks' picture, a group of lanes for each."""
    time, exposure, table, view = sent.time[0], sent.exposure[0], drips.table, view_of(sent)
    first = cuda.blockIdx.x * cuda.blockDim.y + cuda.threadIdx.y
    for n in range(first, drips.count, cuda.gridDim.x * cuda.blockDim.y):
        if min(table[n, END], time + exposure) > max(table[n, BEGIN], time):
            x, y, z, vx, vy, vz, diameter = drip_line(
                table[n, X], table[n, Y], table[n, TOP], table[n, DIAMETER], table[n, BEGIN],
                table[n, END], table[n, DRIP_WIND_X], table[n, DRIP_WIND_Y], time, exposure,
            )  # fmt: skip
            draw_line(Line(x, y, z, vx, vy, vz, diameter), view, scene, picture)


@cuda_kernel
def list_drip_splashes(drips, surfaces, sent, scene, water, count_out, lines_out):
    """List the marks of drips that have landed, as `splash_pass.list_splashes` does."""
    time, exposure, table = sent.time[0], sent.exposure[0], drips.table
    first = cuda.blockIdx.x * cuda.blockDim.y + cuda.threadIdx.y
    for n in range(first, drips.count, cuda.gridDim.x * cuda.blockDim.y):
        diameter, z, age = table[n, DIAMETER], table[n, BOTTOM], time - table[n, END]
        if not -exposure < age <= LONGEST_LIFE:
            continue
        x, y, speed = drip_end(
            table[n, X], table[n, Y], diameter, table[n, BEGIN], table[n, END],
            table[n, DRIP_WIND_X], table[n, DRIP_WIND_Y],
        )  # fmt: skip
        seen, pixel = seen_at(x, y, z, sent, scene)
        if not seen:
            continue
        row, column, _ = cell_of(x, y, surfaces)
        under = water.film[0]
        if surfaces.top[row, column] <= surfaces.ground[row, column]:
            under += np.float64(water.ground[row, column])
        impact = Impact(drips.ids[n], x, y, z, 0.0, 0.0, speed, diameter, under, age)
        list_splash(impact, pixel, exposure, count_out, lines_out)


class DripList:
    """Drips in the air and those that have just landed, on the device."""

    def __init__(self):
        self._table, self._ids = SentRows((DRIP,), np.float64), SentRows((), np.uint64)
        self._sent = ()  # what `follow` was given last
        self.fill(NO_DRIPS, NO_IDS)

    def fill(self, table, ids):
        """Copy a list of drips from the host to the device, as `SimState` has it."""
        self._count = 0
        self._append(table, ids)

    def follow(self, parted):
        """Copy to the device those of a simulation's `PartedDrips` that are not there yet.

        Those that have landed since stay, which kernels pass over, until there is no room for more.
        """
        sent = set(map(id, self._sent))
        new = listed([each for each in parted if id(each) not in sent])
        if not sent or self._count + len(new[1]) > len(self._table.array):
            self.fill(*listed(parted))
        elif len(new[1]):
            self._append(*new)
        self._sent = parted

    def _append(self, table, ids):
        places = self._table.send(table, self._count), self._ids.send(ids, self._count)
        self._count += len(ids)
        self._there = ListedDrips(self._count, *places)

    def draw(self, view, scene, picture):
        """Queue the drawing into the streaks' picture; see `draw_drips`."""
        draw_drips[BLOCKS, GROUPS](self._there, view, scene, picture)

    def gather(self, surfaces, view, scene, water, count, lines):
        """Queue the listing of their splashes; see `list_drip_splashes`."""
        drawn = view, scene, water, count, lines
        list_drip_splashes[BLOCKS, GROUPS](self._there, surfaces, *drawn)
