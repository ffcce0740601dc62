"""Twin of `rainsim.simulation`: rain on terrain over time, its water never leaving the device.

A step is a recorded queue on a stream of its own: drops that end, their water and their rings, and
the flow. What draws the frame waits for it on the device; the host is not asked. Steps of the
water that were not reached, and drops that found no room, are counted; the former go on, the latter
end the run with an error, for their list has room for far more than ever fall.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rainsim import simulation as host
from rainsim.cuda import account
from rainsim.cuda.drops import VOLUME_UNIT, Impacts, room_for
from rainsim.cuda.graph import Graph
from rainsim.cuda.jit import cuda, pinned
from rainsim.cuda.ripples import Ripples
from rainsim.cuda.water import Water
from rainsim.errors import BackendError, DivergedError, ParameterError
from rainsim.moments import ripple_moments
from rainsim.ripples import RippleTile, mean_chord
from rainsim.weather import Weather

NO_DRIPS = "backend cuda keeps on objects what falls on them: no drips from their edges"


@dataclass(frozen=True)
class DeviceState:
    """Water at one frame's time, on the device; valid until the next is asked for.

    Attributes
    ----------
    index : int
    time : float [s]
    depth : device array of shape (ny, nx), float32 [m]
    moments : device array of shape (n, n + n // 2, 5), float32
        Of the ripples' slopes, see `rainsim.moments`.
    tile_size : float [m]
    simulation : Simulation
    notes : tuple of str
    """

    index: int
    time: float
    depth: object
    moments: object
    tile_size: float
    simulation: object
    notes: tuple = ()

    @property
    def ledger(self):
        """Volumes in m3, see `rainsim.ledger`; waits for the device."""
        return self.simulation.ledger()


class Simulation:
    """Rain, water and ripples of a configuration on a terrain, frame by frame.

    Parameters
    ----------
    terrain : Terrain
    config : Config
        Water of scheme "auto" is computed by "lean" here.
    """

    def __init__(self, terrain, config):
        if config.water.scheme == "auto":
            config = replace(config, water=replace(config.water, scheme="lean"))
        self.terrain, self.config = terrain, config
        self.stream = cuda.stream()
        self.weather = Weather(config)
        surfaces = host.surfaces_of(terrain)
        exposure = host.rain_exposure(terrain, host.usual_wind(config), config.rain.roughness)
        start = config.at(0.0)
        depth, self.notes = host.initial_water(terrain, start, exposure)
        self._quick = host.quick_rain(terrain, config, exposure)
        if host.moving_level(terrain, config) is not None:
            raise ParameterError(
                "the water level changes in time; backend cuda keeps it; take backend cpu"
            )
        if config.rain.drips:
            self.notes = *self.notes, NO_DRIPS
        solver = host.water_solver(terrain, start)
        solver.set_state(depth)
        tile = RippleTile(
            depth=host.puddle_depth(depth),
            film=config.water.surface_film,
            chord=mean_chord(depth, terrain.grid.spacing, host.RIPPLE_DEPTHS[0]),
            rate=self.weather.mean_rate,
            dtype=np.float32,
        )
        open_area = float(exposure.sum()) * terrain.grid.cell_area
        objects = host.Objects(surfaces, replace(config.rain, drips=False), wet=False)
        host._warm_up(tile, objects, self.weather, surfaces)
        self._first_slopes = tile.slopes()
        interval = 1 / config.fps
        self.water = Water(solver, exposure, stream=self.stream)
        self.ripples = Ripples(tile, interval, self.stream)
        self._share = tile.size**2 / open_area if open_area > 0 else 0.0
        self.impacts = None
        field = self.weather.field(0.0, interval)
        if field is not None:
            room = room_for(field, surfaces, interval)
            self.impacts = Impacts(field, surfaces, room, self.stream)
        self._control = pinned(account.CONTROL, np.float64)
        self._found, self._sought = pinned(1, np.int32), pinned(1, np.int32)
        self._ready = cuda.event()
        self._graph = None
        self._index = -1

    def advance(self):
        """Go on to the next frame and return its `DeviceState`; only queues the work."""
        self._index += 1
        index, time = self._index, self._index / self.config.fps
        if index == 0:
            self._show_first_slopes()
        else:
            self._bring((index - 1) / self.config.fps, time)
            if self._graph is None:
                self.launch()  # compiles; that was the step itself
                self.stream.synchronize()
                self._graph = Graph(self.stream, self.launch)
            else:
                self._graph.launch()
        self._ready.record(self.stream)
        return DeviceState(
            index, time, self.water.depth, self.ripples.moments, self.ripples.size,
            self, self.notes if index == 0 else (),
        )  # fmt: skip

    def _show_first_slopes(self):
        self.ripples.moments.copy_to_device(ripple_moments(self._first_slopes))

    def _bring(self, before, time):
        """Say what falls between two times."""
        field = self.weather.field(before, time)
        fine = 0.0
        if field is not None:
            fine = field.spectrum.fine_rate
            self.impacts.update(field, before, time)
        if self._quick is not None:
            self.water.deposit(*self._quick(before, time))
        self.water.update(time - before, fine)

    def launch(self):
        """Queue a step; nothing here waits, allocates or reads results."""
        if self.impacts is not None:
            self.impacts.launch()
            self.impacts.settle(self.water, self.ripples, self._share)
            self.impacts.found.copy_to_host(self._found, stream=self.stream)
            self.impacts.now["sought"].copy_to_host(self._sought, stream=self.stream)
        self.ripples.launch()
        self.water.launch()
        self.water._control.copy_to_host(self._control, stream=self.stream)

    def before(self, stream):
        """Let what is queued on another stream from now on wait for the step."""
        self._ready.wait(stream)

    def after(self, stream):
        """Let the next step wait for what is queued on another stream."""
        done = cuda.event()
        done.record(stream)
        done.wait(self.stream)

    def lacked(self):
        """Finish a step that had too little room; return whether it had.

        Call it when the step has ended.

        Raises
        ------
        BackendError
            If more drops fell than the list has room for.
        DivergedError
            If the water is no longer finite or faster than water can be.
        """
        if self._index == 0:
            return False
        if self.impacts is not None:
            found, sought = int(self._found[0]), int(self._sought[0])
            if found > len(self.impacts.ids) or sought > len(self.impacts._words):
                raise BackendError(
                    f"{max(found, sought)} drops may end in one frame, which is more than there is "
                    "room for; use more frames per second, or backend cpu"
                )
        more = False
        while self._control[account.LEFT] > 0.0:
            self.water.go_on()
            self.water._control.copy_to_host(self._control, stream=self.stream)
            self.stream.synchronize()
            more = True
        if not np.isfinite(self._control).all():
            raise DivergedError(
                "the water on the CUDA device is no longer finite; use a smaller courant than "
                f"{self.config.water.courant}"
            )
        return more

    def ledger(self):
        """Return the account of the water so far, m3, as `rainsim.simulation` gives it."""
        found = self.water.ledger().as_dict()
        if self.impacts is not None:
            volume = float(self.impacts.obstacles.copy_to_host(stream=self.stream)[0])
            found["rain"] += volume * VOLUME_UNIT
            found["obstacles"] += volume * VOLUME_UNIT
        return found


def simulate(terrain, config, progress=None):
    """Yield the `DeviceState` at the time of each frame, from frame 0 on, without end."""
    run = Simulation(terrain, config)
    while True:
        state = run.advance()
        yield state
