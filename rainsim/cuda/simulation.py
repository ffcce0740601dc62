"""Twin of `rainsim.simulation`: rain on terrain over time, its water never leaving the device.

What rings on the tile, and what drips from objects, the host decides as on the CPU, beside the
drawing of the frame before.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rainsim import simulation as host
from rainsim.cuda.driver import one_fault
from rainsim.cuda.grid import GpuWaterSolver
from rainsim.cuda.rain.drip_list import DripList
from rainsim.cuda.rain.moving_surfaces import Shelter
from rainsim.cuda.water.ripples import Ripples
from rainsim.drops import Weather
from rainsim.jit import may_run_beside
from rainsim.rain.dripping import listed
from rainsim.rain.exposure import rain_exposure
from rainsim.rain.moving_surfaces import AHEAD, FRAMES_AHEAD
from rainsim.water.keyframed import moved_water


@dataclass
class DeviceState:
    """Water at one frame's time, on the device.

    depth : float32 device array (ny, nx) [m]. Depth above the bed, film included;
        overwritten by the simulation's next step, as `moments` is.
    moments : device array of shape (n, n + n // 2, 6). Of the ripples' slopes, see
        `reflection.slope_moments`.
    parted : tuple of PartedDrips. Drips on the host; `drip_list` has them here.
    step : int. Of the simulation.
    """

    index: int
    time: float
    depth: object
    moments: object
    tile_size: float
    ledger: dict
    parted: tuple
    top_water: np.ndarray
    notes: tuple
    simulation: object
    step: int

    def shown_by(self, index):
        """Return this state as the one that the frame `index` shows."""
        return replace(self, index=index)

    def shown_at(self, time):
        """Return this state as what a camera sees at a time [s] of the frame: drops move on."""
        return replace(self, time=time)

    @property
    def drips(self):
        """Drips as `SimState` holds them, and some that landed before; made when asked for."""
        return listed(self.parted)[0]

    @property
    def drip_id(self):
        """Ids of `drips`."""
        return listed(self.parted)[1]

    @property
    def drip_list(self):
        """The drips on the device: a `DripList`, or None where nothing drips."""
        return self.simulation.drip_list


class Start(NamedTuple):
    """The water at the start, on the host; all but the device's part of a `Simulation`.

    config : Config. Water of scheme "auto" is computed by "lean" here.
    """

    config: object
    weather: object
    exposure: object
    solver: object
    tile: object
    objects: object
    by_keyframes: object
    notes: tuple


def start_of(terrain, config):
    """Return the `Start` of a simulation; needs no device, so it can be found beside other work."""
    asked = config.water.scheme
    if asked == "auto":
        config = replace(config, water=replace(config.water, scheme="lean"))
    weather, now = Weather(config), config.at(0.0)
    exposure = rain_exposure(terrain, host.usual_wind(config), config.rain.roughness)
    depth, notes = host.initial_water(terrain, now, exposure)
    by_keyframes = moved_water(terrain, config, exposure)
    solver = host.water_solver(terrain, now)
    solver.set_state(depth)
    why = "auto: the scheme of a CUDA device" if asked == "auto" else solver.reason
    notes = (*notes, f"water: scheme {solver.scheme} ({why})")
    tile = host.ripple_tile(config, weather, depth, terrain.grid.spacing)
    objects = host.Objects(host.surfaces_of(terrain), now, *host.tops_of(terrain, config, now))
    host.warm_up(tile, objects, weather)
    objects.open_account()
    return Start(config, weather, exposure, solver, tile, objects, by_keyframes, notes)


class Simulation:
    """Rain, water and ripples on a terrain from a `Start` on, frame by frame.

    drip_list : DripList or None. Drips of the last state; None if nothing drips.
    """

    @one_fault()
    def __init__(self, terrain, start):
        self.config, self.weather, self._objects = start.config, start.weather, start.objects
        self._by_keyframes, self._notes = start.by_keyframes, start.notes
        self.water = GpuWaterSolver(start.solver, start.exposure)
        self.ripples = Ripples(start.tile, 1 / self.config.fps)
        self.drip_list = None if self._objects.drips is None else DripList()
        self._area = self.water.sources.exposed * self.water.spacing**2
        self._shelter, self._ahead = None, None
        if self.weather.rains and terrain.footprints:
            wind = host.usual_wind(self.config), self.config.rain.roughness
            self._shelter = Shelter(terrain, wind, self.water.sources)
        self._index = -1

    def advance(self):
        """Go on to the next frame and return its `DeviceState`."""
        self._index += 1
        index, fps, water, objects = self._index, self.config.fps, self.water, self._objects
        if index > 0:
            self._step(index)
        if self.drip_list is not None:
            self.drip_list.follow(objects.parted)
        state = DeviceState(
            index, index / fps, water.sources.depth, self.ripples.moments, self.ripples.tile.size,
            objects.ledger(None, water).as_dict(), objects.parted, objects.top_water(),
            self._notes if index == 0 else (), self, index,
        )  # fmt: skip
        # The host's part of the next step is done beside the drawing of this frame.
        self._ahead = AHEAD.submit(self._rain_on, index + 1) if may_run_beside() else None
        return state

    def _interval(self, index):
        return (index - 1) / self.config.fps, index / self.config.fps

    def _rain_on(self, index):
        """Return what `rainsim.simulation.rain_on` does for the step to a frame."""
        size = self.ripples.tile.size
        return host.rain_on(self._objects, self.weather, size, self._area, *self._interval(index))

    @one_fault()
    def _step(self, index):
        """Let it rain and flow from the frame before to the one of this number."""
        water, (before, time) = self.water, self._interval(index)
        rate, drips, rings = self._rain_on(index) if self._ahead is None else self._ahead.result()
        water.deposit(*drips)
        if rings is not None:
            if self._shelter is not None:
                frames = range(index, index + 1 + FRAMES_AHEAD)
                self._shelter.move(*(0.5 * sum(self._interval(n)) for n in frames))
            self.ripples.ring(*rings[:2], rings[2] / (time - before))
            self.ripples.advance()
        self._by_keyframes(water, self._objects, before, time)
        water.advance(time - before, rain=rate)


def simulate(terrain, config, start=None):
    """Yield the `DeviceState` at the time of each frame, from frame 0 on, without end.

    `start` returns the `Start` where it is found elsewhere.
    """
    run = Simulation(terrain, start_of(terrain, config) if start is None else start())
    while True:
        yield run.advance()
