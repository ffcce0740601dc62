"""Twin of `rainsim.water.tyres`: actors over water that stays on a CUDA device.

The host knows where tyres roll and what they throw; of the water it needs the cells under them.
Those of a step are read together and written back together, and the water that comes down is added
as drops are. The map that drops meet and the share of the rain that reaches the ground follow the
actors by the rows that they cover.
"""

from __future__ import annotations

import numpy as np

from rainsim.cuda.driver import fetch, send, to_device
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.rain.moving_surfaces import MovingHeights, joined_rows
from rainsim.cuda.water.step_control import DRAINED, DROPPED, PARITY, UNIT
from rainsim.io.states import NO_IDS, NO_THROWS, NO_TRACKS
from rainsim.jit import may_run_beside
from rainsim.rain.moving_surfaces import MovingSurfaces
from rainsim.water.sources import DRY_DEPTH, lift_cells
from rainsim.water.tyres import Tyres
from rainsim.water.window_tyres import tyres_of

THREADS = 8 if SIMULATED else 128
ROOM = 4096  # cells that there is room for at first
H, REMAINDER, FILM, WAITING = range(4)  # rows of the table of cells; drops that wait in UNIT
NOTHING_THROWN = {"tracks": NO_TRACKS, "throws": NO_THROWS, "throw_id": NO_IDS}


@cuda_kernel
def read_cells(cells, count, state, plane, w, remainder, film, waiting, table_out):
    """Read the water of some cells.

    Parameters
    ----------
    cells : device array of shape (room,), int64
        Their places.
    count : int
    state : device array
        See `step_control`.
    plane : int
        Numbers of one map.
    w, remainder, film : device arrays, float32
        As `flow.step` has them.
    waiting : device array, int64
        As `step_control.take_in` has it.
    table_out : device array of shape (4, room), float64
        See H to WAITING.
    """
    n = cuda.grid(1)
    if n < count:
        at = cells[n]
        table_out[H, n] = w[3 * state[PARITY] * plane + at]
        table_out[REMAINDER, n], table_out[FILM, n] = remainder[at], film[at]
        table_out[WAITING, n] = waiting[at]


@cuda_kernel
def write_cells(
    cells, count, table, dropped, taken, state, plane, control_out, w_out, remainder_out, film_out,
    waiting_out,
):  # fmt: skip
    """Write the water of some cells back; no drops wait there any more.

    Parameters
    ----------
    cells, count, state, plane
        As `read_cells` takes them.
    table : device array of shape (4, room), float64
    dropped, taken : float [m]
        Depths of drops that no longer wait, and of water taken, summed over the cells.
    control_out, w_out, remainder_out, film_out, waiting_out : device arrays
    """
    n = cuda.grid(1)
    if n == 0:
        control_out[DROPPED] += dropped
        control_out[DRAINED] += taken
    if n < count:
        at = cells[n]
        w_out[3 * state[PARITY] * plane + at] = table[H, n]
        remainder_out[at], film_out[at] = table[REMAINDER, n], table[FILM, n]
        waiting_out[at] = 0


@cuda_kernel
def put_down(cells, units, count, waiting_out):
    """Let drops wait in some cells, none of them named twice: whole numbers of UNIT."""
    n = cuda.grid(1)
    if n < count:
        waiting_out[cells[n]] += units[n]


class Road:
    """The cells under tyres in one step, as `Tyres` takes a solver.

    Parameters
    ----------
    water : rainsim.cuda.grid.Water
    """

    def __init__(self, water):
        self._water, self._area, self._plane = water, water.cells.area, len(water.waiting)
        self._make_room(ROOM)
        self._cells = np.zeros(0, np.int64)

    def _make_room(self, room):
        stream = self._water.stream
        self._places = to_device(np.zeros(room, np.int64), stream)
        self._units = to_device(np.zeros(room, np.int64), stream)
        self._table = to_device(np.zeros((4, room)), stream)

    def _room_for(self, count):
        if count > len(self._places):
            self._water.stream.synchronize()
            self._make_room(2 * count)

    def _launch(self, kernel, count):
        return kernel[-(-count // THREADS), THREADS, self._water.stream]

    def hold(self, ways):
        """Read the cells of some ways, pairs of rows and columns; waits for them."""
        water, stream = self._water, self._water.stream
        self._cells = np.unique(np.concatenate([water.places(*way) for way in ways]))
        count = len(self._cells)
        self._room_for(count)
        send(self._places[:count], self._cells, stream)
        self._launch(read_cells, count)(
            self._places, count, water.account.state, self._plane, *water.arrays, water.waiting,
            self._table,
        )  # fmt: skip
        h, remainder, film, waiting = fetch(self._table, stream)[:, :count]
        self._held = [values.astype(np.float32) for values in (h, remainder, film)]
        self._held[REMAINDER] += (waiting * UNIT).astype(np.float32)
        self._dropped, self._taken = float(waiting.sum()) * UNIT, 0.0

    def lift(self, rows, columns, left):
        """Take the water of cells that are held, see `WaterSolver.lift`."""
        at = np.searchsorted(self._cells, self._water.places(rows, columns))
        *kept, taken = lift_cells(
            *(values[at] for values in self._held), left, self._area, DRY_DEPTH
        )
        for values, new in zip(self._held, kept, strict=True):
            values[at] = new
        self._taken += taken / self._area
        return taken

    def let_go(self):
        """Write the cells that are held back to the device."""
        water, stream, count = self._water, self._water.stream, len(self._cells)
        if not count:
            return
        table = np.zeros(self._table.shape)
        table[:WAITING, :count] = self._held
        send(self._table, table, stream)
        account = water.account
        self._launch(write_cells, count)(
            self._places, count, self._table, self._dropped, self._taken, account.state,
            self._plane, account.control, *water.arrays, water.waiting,
        )  # fmt: skip
        self._cells = self._cells[:0]

    def deposit(self, rows, columns, volumes):
        """Add drops: `volumes` [m3] into the cells (`rows`, `columns`)."""
        if not len(rows):
            return
        self.let_go()  # no cell that is held may lose them
        stream = self._water.stream
        cells, which = np.unique(self._water.places(rows, columns), return_inverse=True)
        depth = np.bincount(which.ravel(), volumes) / (self._area * UNIT)
        count = len(cells)
        self._room_for(count)
        send(self._places[:count], cells, stream)
        send(self._units[:count], np.rint(depth).astype(np.int64), stream)
        self._launch(put_down, count)(self._places, self._units, count, self._water.waiting)


class DeviceTyres(Tyres):
    """Tyres that also roll over a `Road`."""

    def _step(self, solver, start, stop, weather):
        held = isinstance(solver, Road)
        if held:
            ways = [
                self._cells_under(begin, end, car.motion.wheels[k, 3])
                for _, car, k, begin, end, _ in self._ways(start, stop)
                if (begin != end)[:2].any()
            ]
            if ways := [way for way in ways if len(way[0])]:
                solver.hold(ways)
        super()._step(solver, start, stop, weather)
        if held:
            solver.let_go()


class Traffic:
    """What moves over the water of a device: shelter from the rain, and tyres.

    Parameters
    ----------
    terrain : Terrain
        With footprints.
    config : Config
    wind : tuple
        As `MovingSurfaces` takes it.
    exposure : ndarray of shape (ny, nx), float32
        Share of the rain that reaches the ground, without what moves.

    Attributes
    ----------
    tyres : DeviceTyres
    thrown : list of dict
        What `Tyres.state` returned for the last states by their page.
    """

    def __init__(self, terrain, config, wind, exposure):
        speed_and_direction, roughness = wind
        self._moving = MovingSurfaces(terrain, speed_and_direction, roughness)
        self.tyres = tyres_of(terrain, config, kind=DeviceTyres)
        self._footprints, self._exposure = terrain.footprints, exposure
        self._depth = np.zeros(terrain.grid.shape, np.float32)
        self._rows, self._opened = [], exposure
        self._road = self._heights = self._water = None
        self.thrown = [NOTHING_THROWN, NOTHING_THROWN]

    def roll_over(self, water, impacts):
        """Take over the water of a device and, if it rains, the drops that are listed there."""
        self._road, self._water = Road(water), water
        if impacts is not None:
            self._heights = MovingHeights(self._moving.still, self._footprints, impacts.stream)
            impacts.surfaces, impacts.relisted = self._heights.fields, True

    def cover(self, time, *following):
        """Let the drops that are listed next meet the map as it is at a time [s].

        Those of the `following` times [s] are looked for beside it.
        """
        self._heights.send(*self._moving.moment(time))
        self._middle = time
        if may_run_beside():
            self._moving.look_ahead(*following)

    def thin_rain(self):
        """Let less rain reach the ground in the listed interval; return the share that does."""
        if self._heights is not None:
            self._opened = self._moving.thinned(self._exposure, self._middle)
            rows = [part[0] for part, _ in self._moving.moment(self._middle)[1]]
            if rows or self._rows:
                self._water.let_through(self._opened, joined_rows([*self._rows, *rows]))
            self._rows = rows
        return self._opened

    def roll(self, start, stop, weather):
        """Let tyres roll from `start` to `stop` [s], see `Tyres.roll`; waits for the device."""
        self.tyres.roll(self._road, start, stop, weather)

    def look(self, page, time):
        """Keep throws, their ids and tracks at the time [s] of a page's water; waits for it."""
        part, depth = self.tyres.passed(), self._water.depths[page]
        if part is not None:
            self._depth[part[0]] = fetch(depth[part[0].start : part[0].stop], self._water.stream)
        self.thrown[page] = self.tyres.state(self._depth, time)
