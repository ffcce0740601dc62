"""Twin of `rainsim.water.tyres`: actors over water that stays on a CUDA device.

The host knows where tyres roll and what they throw; of the water it needs the cells under them.
Those of a step are read together and written back together, and the water that comes down is added
as drops are. The map that drops meet and the share of the rain that reaches the ground follow the
actors by the windows that they cover.
"""

from __future__ import annotations

import numpy as np

from rainsim.cuda.driver import Staging, to_device
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.cuda.rain.moving_surfaces import MovingHeights
from rainsim.cuda.water.cells import DEPTH, FILM, REMAINDER, THREADS, WAITING, Cells
from rainsim.cuda.water.step_control import UNIT
from rainsim.cuda.water.tracks import Tracks
from rainsim.io.states import NO_IDS, NO_THROWS, NO_TRACKS
from rainsim.jit import may_run_beside
from rainsim.rain.moving_surfaces import MovingSurfaces
from rainsim.water.sources import DRY_DEPTH, lift_cells
from rainsim.water.tyres import Tyres
from rainsim.water.window_tyres import tyres_of

ROOM = 4096  # cells that there is room for at first
LIFTED = [DEPTH, REMAINDER, FILM]  # rows of the table of cells that tyres change
NOTHING_THROWN = NO_THROWS, NO_IDS


@cuda_kernel
def put_down(cells, units, count, waiting_out):
    """Let drops wait in some cells: whole numbers of UNIT."""
    n = cuda.grid(1)
    if n < count:
        cuda.atomic.add(waiting_out, cells[n], units[n])


class Road:
    """The cells under tyres in one step, as `Tyres` takes a solver.

    Parameters
    ----------
    water : rainsim.cuda.grid.Water

    Attributes
    ----------
    passed : list of tuple of ndarray
        Rows and columns of the cells of which water was taken; who reads it empties it.
    """

    def __init__(self, water):
        self._water, self._area = water, water.cells.area
        self._cells, self._table = Cells(water, ROOM), None  # no table: no cells are held
        self._number = np.zeros(water.waiting.size, np.int32)  # of the cells that are held
        self._make_room(ROOM)
        self._staging, self.passed = Staging(water.stream), []

    def _make_room(self, count):
        """Make room for the cells and the units of so many drops."""
        self._drops = [to_device(np.zeros(count, np.int64), self._water.stream) for _ in range(2)]

    def hold(self, ways):
        """Read the cells of some ways, pairs of rows and columns; waits for them."""
        places = np.concatenate([self._water.places(*way) for way in ways])
        numbers = np.arange(len(places), dtype=np.int32)
        self._number[places] = numbers
        places = places[self._number[places] == numbers]  # each once
        self._number[places] = numbers[: len(places)]
        self._cells.choose(places)
        self._table = self._cells.read()
        self._held = [self._table[k].astype(np.float32) for k in LIFTED]
        waiting = self._table[WAITING] * UNIT
        self._held[LIFTED.index(REMAINDER)] += waiting.astype(np.float32)
        self._dropped, self._taken = float(waiting.sum()), 0.0

    def lift(self, rows, columns, left):
        """Take the water of cells that are held, see `WaterSolver.lift`."""
        self.passed.append((rows, columns))
        at = self._number[self._water.places(rows, columns)]
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
        stream, count = self._water.stream, len(rows)
        units = np.rint(volumes / (self._area * UNIT)).astype(np.int64)
        if len(self._drops[0]) < count:
            stream.synchronize()
            self._make_room(2 * count)
        table = self._water.places(rows, columns), units
        for there, values in zip(self._drops, table, strict=True):
            self._staging.send(there[:count], values)
        put_down[-(-count // THREADS), THREADS, stream](*self._drops, count, self._water.waiting)


class DeviceTyres(Tyres):
    """Tyres that also roll over a `Road`."""

    @property
    def has_cars(self):
        """Whether there is a tyre."""
        return len(self._cars) > 0

    def tracks_on(self, stream):
        """Return the `Tracks` on a device as they are now."""
        return Tracks(self._terrain, self._passed, stream)

    def _step(self, solver, start, stop, weather):
        held = isinstance(solver, Road)
        if held:
            if ways := [(way.rows, way.columns) for *_, way in self._ways(start, stop)]:
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
    tracks : Tracks or None
        None without tyres.
    thrown : list of tuple
        What `Tyres.throws` returned for the last states by their page.
    """

    def __init__(self, terrain, config, wind, exposure):
        speed_and_direction, roughness = wind
        self._moving = MovingSurfaces(terrain, speed_and_direction, roughness)
        self.tyres = tyres_of(terrain, config, kind=DeviceTyres)
        self._footprints, self._exposure = terrain.footprints, exposure
        self._shelters, self._opened = [], exposure.copy()
        self._road = self._heights = self._water = self.tracks = None
        self.thrown = [NOTHING_THROWN, NOTHING_THROWN]

    def roll_over(self, water, impacts):
        """Take over the water of a device and, if it rains, the drops that are listed there."""
        self._road, self._water = Road(water), water
        if self.tyres.has_cars:
            self.tracks = self.tyres.tracks_on(water.stream)
        if impacts is not None:
            self._heights = MovingHeights(self._moving.still, self._footprints, impacts.stream)
            impacts.surfaces, impacts.relisted = self._heights.fields, True

    def cover(self, time, *following):
        """Let the drops that are listed next meet the map as it is at a time [s].

        Those of the `following` times [s] are looked for beside it.
        """
        self._heights.send(self._moving.at(time))
        self._middle = time
        if may_run_beside():
            self._moving.look_ahead(following)

    def thin_rain(self):
        """Let less rain reach the ground in the listed interval."""
        if self._heights is None:
            return
        shelters = self._moving.moment(self._middle)[1]
        if shelters is self._shelters:
            return
        for part, _ in self._shelters:
            self._opened[part] = self._exposure[part]
        for part, let_through in shelters:
            self._opened[part] *= let_through
        if self._shelters or shelters:
            self._water.shelter(self._opened, [part for part, _ in shelters])
        self._shelters = shelters

    def roll(self, step, start, stop, weather):
        """Let tyres roll in a step from `start` to `stop` [s], see `Tyres.roll`; waits."""
        self.tyres.roll(self._road, start, stop, weather)
        if self._road.passed:
            rows, columns = map(np.concatenate, zip(*self._road.passed, strict=True))
            self.tracks.mark(rows, columns, step)
            self._road.passed.clear()

    def look(self, page):
        """Keep throws and their ids at the time of a page's water."""
        self.thrown[page] = self.tyres.throws()

    def tracks_of(self, step):
        """Return the tracks at a step's end on the host, see `Tyres.tracks`; waits."""
        window = self.tyres.passed()
        if window is None:
            return NO_TRACKS
        return self.tracks.fetch(window, self._water.depths[step % 2], step)

    def thin_film(self, step, film, ground_out, stream):
        """Queue the thinning of the film under the tracks at a step's end, see `Tracks.thin`."""
        if (window := self.tyres.passed()) is not None:
            depth = self._water.depths[step % 2]
            self.tracks.thin(window, depth, step, film, ground_out, stream)
