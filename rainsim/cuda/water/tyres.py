"""Twin of `rainsim.water.tyres`: actors over water that stays on a CUDA device.

The host knows where tyres roll and what they throw; of the water it needs the cells under them.
Those of a step are read together and written back together, and the water that comes down is added
as drops are. The map that drops meet and the share of the rain that reaches the ground follow the
actors by the rows that they cover.
"""

from __future__ import annotations

import numpy as np

from rainsim.cuda.driver import fetch, send, to_device
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.cuda.rain.moving_surfaces import MovingHeights, joined_rows
from rainsim.cuda.water.cells import DEPTH, FILM, REMAINDER, WAITING, Cells
from rainsim.cuda.water.step_control import UNIT
from rainsim.io.states import NO_IDS, NO_THROWS, NO_TRACKS
from rainsim.jit import may_run_beside
from rainsim.rain.moving_surfaces import MovingSurfaces
from rainsim.water.sources import DRY_DEPTH, lift_cells
from rainsim.water.tyres import Tyres
from rainsim.water.window_tyres import tyres_of

ROOM = 4096  # cells that there is room for at first
LIFTED = [DEPTH, REMAINDER, FILM]  # rows of the table of cells that tyres change
NOTHING_THROWN = {"tracks": NO_TRACKS, "throws": NO_THROWS, "throw_id": NO_IDS}


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
        self._water, self._area = water, water.cells.area
        self._cells, self._table = Cells(water, ROOM), None  # no table: no cells are held
        self._units = to_device(np.zeros(ROOM, np.int64), water.stream)

    def hold(self, ways):
        """Read the cells of some ways, pairs of rows and columns; waits for them."""
        self._cells.choose(np.unique(np.concatenate([self._water.places(*way) for way in ways])))
        self._table = self._cells.read()
        self._held = [self._table[k].astype(np.float32) for k in LIFTED]
        waiting = self._table[WAITING] * UNIT
        self._held[LIFTED.index(REMAINDER)] += waiting.astype(np.float32)
        self._dropped, self._taken = float(waiting.sum()), 0.0

    def lift(self, rows, columns, left):
        """Take the water of cells that are held, see `WaterSolver.lift`."""
        at = np.searchsorted(self._cells.places, self._water.places(rows, columns))
        *kept, taken = lift_cells(
            *(values[at] for values in self._held), left, self._area, DRY_DEPTH
        )
        for values, new in zip(self._held, kept, strict=True):
            values[at] = new
        self._taken += taken / self._area
        return taken

    def let_go(self):
        """Write the cells that are held back to the device."""
        if self._table is None:
            return
        self._table[LIFTED], self._table[WAITING] = self._held, 0.0
        self._cells.write(self._table, self._dropped, self._taken)
        self._table = None

    def deposit(self, rows, columns, volumes):
        """Add drops: `volumes` [m3] into the cells (`rows`, `columns`)."""
        if not len(rows):
            return
        self.let_go()  # no cell that is held may lose them
        stream = self._water.stream
        cells, which = np.unique(self._water.places(rows, columns), return_inverse=True)
        depth = np.bincount(which.ravel(), volumes) / (self._area * UNIT)
        self._cells.choose(cells)
        room, count = len(self._cells.on_device), len(cells)
        if len(self._units) < room:
            stream.synchronize()
            self._units = to_device(np.zeros(room, np.int64), stream)
        send(self._units[:count], np.rint(depth).astype(np.int64), stream)
        put_down[self._cells.grid()](self._cells.on_device, self._units, count, self._water.waiting)


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
        self._rows, self._opened = [], exposure.copy()
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
        """Let less rain reach the ground in the listed interval."""
        if self._heights is None:
            return
        shelters = self._moving.moment(self._middle)[1]
        rows = [part[0] for part, _ in shelters]
        changed = joined_rows([*self._rows, *rows])
        for part in changed:
            self._opened[part] = self._exposure[part]
        for part, let_through in shelters:
            self._opened[part] *= let_through
        if changed:
            self._water.let_through(self._opened, changed)
        self._rows = rows

    def roll(self, start, stop, weather):
        """Let tyres roll from `start` to `stop` [s], see `Tyres.roll`; waits for the device."""
        self.tyres.roll(self._road, start, stop, weather)

    def look(self, page, time):
        """Keep throws, their ids and tracks at the time [s] of a page's water; waits for it."""
        part, depth = self.tyres.passed(), self._water.depths[page]
        if part is not None:
            self._depth[part[0]] = fetch(depth[part[0].start : part[0].stop], self._water.stream)
        self.thrown[page] = self.tyres.state(self._depth, time)
