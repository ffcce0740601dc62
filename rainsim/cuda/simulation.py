"""Twin of `rainsim.simulation`: rain on terrain over time, its water never leaving the device.

A step is a recorded queue on a stream of its own: the water of drops that ended, their rings, and
the flow. Beside it, on another, the drops are listed that end in the interval that follows: this
frame's splashes show some of them already.
What draws the frame waits for both on the device; the host is not asked. Steps of the water that
were not reached, and drops that found no room, are counted; the former go on, the latter end the
run with an error, for their list has room for far more than ever fall.

`advance` only says what the next step is; it begins with `begin`, at the latest when its results
are asked for. So the host can make ready one frame while the device works on the one before, and
since depth and rings have two pages, the device can take a step while it draws the one before.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np

from rainsim import simulation as host
from rainsim.config.settings import mm_per_hour
from rainsim.cuda.driver import Event, fetch, one_fault, send
from rainsim.cuda.graph import Repeated
from rainsim.cuda.grid import Water
from rainsim.cuda.jit import cuda
from rainsim.cuda.rain.dripping import Drips, volumes
from rainsim.cuda.rain.impact_history import RecentImpacts
from rainsim.cuda.rain.moving_surfaces import Shelter
from rainsim.cuda.rain.settling import VOLUME_UNIT
from rainsim.cuda.water.ripples import Ripples
from rainsim.cuda.water.step_control import LEFT
from rainsim.drops import Weather
from rainsim.errors import DivergedError
from rainsim.io.states import NO_DRIPS, NO_IDS
from rainsim.rain.exposure import rain_exposure
from rainsim.rain.moving_surfaces import FRAMES_AHEAD
from rainsim.reflection.slope_moments import ripple_moments
from rainsim.water.keyframed import moved_water
from rainsim.water.ripples import LAYERS

ACCOUNTS = 3  # of steps: a picture comes when up to two more steps have begun


class DeviceState:
    """Water at one frame's time, on the device.

    The device keeps two states: this one's arrays are overwritten when the next but one begins.

    index : int. Of the frame that shows it.
    step : int. Of the simulation.
    time : float [s]
    simulation : Simulation. Whose arrays the properties read.
    tile_size : float [m]. Side of the periodic tile of ripples.
    notes : tuple of str
    top_water : float64 array (n,) [m3]. Water on each top of the terrain, on the
        host. It comes from the mean rain; the ledger adds up the drops that fell
        on the device, and differs from it by their chance.
    """

    def __init__(self, index, time, simulation, notes=()):
        self.index = self.step = index
        self.time, self.simulation, self.notes = time, simulation, notes
        self.tile_size, self.page = simulation.ripples.tile.size, index % 2
        self.top_water = simulation.top_water()

    def shown_by(self, index):
        """Return this state as the one that the frame `index` shows."""
        shown = copy.copy(self)
        shown.index = index
        return shown

    def shown_at(self, time):
        """Return this state as what a camera sees at a time [s] of the frame: drops move on."""
        shown = copy.copy(self)
        shown.time = time
        return shown

    def _there(self):
        self.simulation.begin(self.step)
        return self.simulation

    @property
    def depth(self):
        """Depth above the bed, film included: device array of shape (ny, nx), float32 [m]."""
        return self._there().water.depths[self.page]

    @property
    def moments(self):
        """Moments of the ripples' slopes, device array of shape (n, n + n // 2, 6).

        See `reflection.slope_moments`.
        """
        return self._there().ripples.pages[self.page]

    @property
    def drip_list(self):
        """Drips in the air and just landed: a `cuda.drips.DripList`, or None without any."""
        drips = self._there().drips
        return None if drips is None else drips.pages[self.page]

    @property
    def drips(self):
        """The table of `drip_list` on the host, as `SimState` has it; waits for the device."""
        return self._drips()[0]

    @property
    def drip_id(self):
        """The ids of `drips`."""
        return self._drips()[1]

    def _drips(self):
        listed = self.drip_list
        return (NO_DRIPS, NO_IDS) if listed is None else listed.fetch()

    @property
    def ledger(self):
        """Volumes in m3, see `rainsim.ledger`; waits for the device."""
        return self._there().ledger(self.step)


class Simulation:
    """Rain, water and ripples of a configuration on a terrain, frame by frame.

    config : Config. Water of scheme "auto" is computed by "lean" here.
    is_shown : bool. Whether a frame of the last step may still have to be drawn
        again; `advance` begins no step meanwhile.
    """

    @one_fault()
    def __init__(self, terrain, config):
        asked = config.water.scheme
        if asked == "auto":
            config = replace(config, water=replace(config.water, scheme="lean"))
        self.config, self.weather, stream = config, Weather(config), cuda.stream()
        surfaces = host.surfaces_of(terrain)
        wind = host.usual_wind(config), config.rain.roughness
        exposure = rain_exposure(terrain, *wind)
        start, interval = config.at(0.0), 1 / config.fps
        depth, notes = host.initial_water(terrain, start, exposure)
        self._by_keyframes = moved_water(terrain, config, exposure)
        solver = host.water_solver(terrain, start)
        solver.set_state(depth)
        why = "auto: the scheme of a CUDA device" if asked == "auto" else solver.reason
        self.notes = (*notes, f"water: scheme {solver.scheme} ({why})")
        tile = host.ripple_tile(config, self.weather, (depth, terrain.grid.spacing))
        self._objects = host.Objects(surfaces, start, *host.tops_of(terrain, config, start))
        host.warm_up(tile, self._objects, self.weather)
        self._objects.open_account()
        self.water = Water(solver, exposure, stream=stream)
        self.ripples = Ripples(tile, interval, cuda.stream(), self._ringing(tile.size))
        send(self.ripples.moments, ripple_moments(tile.slopes()))
        self.impacts = self.drips = None
        if self.weather.rains:
            # An exposure is no longer than a frame: it sees one interval that is still to come.
            self.impacts = RecentImpacts(self.weather, surfaces, config.fps, 1, cuda.stream())
        if self.weather.rains and config.rain.drips:
            rate = self.weather.field(0.0, interval).listed.rate
            self.drips = Drips(
                self._objects.drips, self.impacts, rate, interval, config.rain.roughness,
                stream,
            )  # fmt: skip
        self._shelter = None
        if terrain.footprints:
            self._shelter = Shelter(terrain, wind, exposure, self.water, self.impacts)
        self._ready, self._drawn = Event(), (Event(), Event())  # a step; what draws either page
        self._queues, self._accounts = {}, [None] * ACCOUNTS  # steps by page
        self._index = self._begun = self._complete = self._late = -1
        self._fallen = 0.0  # m of rain since the start
        self.is_shown = False

    def _ringing(self, size):
        """Return the share of the drops on a map's ground that ring on a tile of a size [m]."""
        area = self.water.account.exposed * self.water.cells.area
        return size**2 / area / LAYERS if area > 0 else 0.0

    def top_water(self):
        """Return the water on each top [m3] (n,) at the time of the last state."""
        return self._objects.top_water_after(self._fallen)

    @one_fault()
    def advance(self):
        """Go on to the next frame and return its `DeviceState`; see `begin`."""
        if not self.is_shown:
            self.begin(self._index)
        self._index += 1
        index, time = self._index, self._index / self.config.fps
        if index > 0:
            middle = time - 0.5 / self.config.fps
            self._fallen += mm_per_hour(self.weather.rate(middle)) / self.config.fps
        return DeviceState(index, time, self, self.notes if index == 0 else ())

    @property
    def is_idle(self):
        """Whether the step that has begun is done, so that `begin` need not wait."""
        return self._ready.is_past

    def follows(self, index):
        """Return whether a step is at most one after the last that has begun.

        Steps beyond overwrite the arrays of the state that is shown.
        """
        return index <= self._begun + 1

    def _interval(self, index):
        return (index - 1) / self.config.fps, index / self.config.fps

    def begin(self, index):
        """Queue the steps up to that number, none beyond the one that `advance` has said last."""
        for step in range(self._begun + 1, index + 1):
            self._begin(step)

    def _begin(self, index):
        if index > 0 and self._shelter is not None:
            self.complete()
            self._shelter.thin_rain()
            self.ripples.let_ring(self._ringing(self.ripples.tile.size))
        if index > 0:
            self._bring(*self._interval(index))
        if self.impacts is not None:
            self.impacts.update(index)
        self.complete()
        page, stream, self._begun = index % 2, self.water.stream, index
        self.water.page = page
        self.ripples.turn_page(page)
        if index > 0:
            self._by_keyframes(self.water, self._objects, *self._interval(index))
            if self.impacts is not None:
                self.impacts.listed.wait(stream)
            self._drawn[page].wait(stream)
            if page not in self._queues:
                self._queues[page] = Repeated(stream, self.launch)
            self._queues[page].launch()
        self._ready.record(stream)
        if self.impacts is None:
            return
        if self._shelter is not None:
            self.impacts.listed.synchronize()
            coming = range(index + 1, index + 2 + FRAMES_AHEAD)
            middles = (0.5 * sum(self._interval(n)) for n in coming)
            self._shelter.cover(*middles)
        self._drawn[page].wait(self.impacts.stream)  # the last frame that sees what it overwrites
        self.impacts.list_beside()

    def complete(self):
        """Wait for the step that has begun, and let it go on if it was not at its end.

        Raises DivergedError if the water is no longer finite or faster than water
            can be.
        """
        if self._complete == self._begun:
            return
        self._complete = index = self._begun
        account = self.water.account
        self._ready.synchronize()
        if index == 0:
            control = account.fetch()
        else:
            while account.seen[LEFT] > 0.0:
                self.water.go_on()
                account.copy()
                self.water.stream.synchronize()
                self._late = index
            if not np.isfinite(account.seen).all():
                raise DivergedError(
                    "the water on the CUDA device is no longer finite; use a smaller courant than "
                    f"{self.config.water.courant}"
                )
            control = account.seen.copy()
        fallen = 0 if self.impacts is None else int(self.impacts.fallen[0])
        drips = None if self.drips is None else self.drips.account.copy()
        self._accounts[index % ACCOUNTS] = control, fallen, drips, self._objects.inflow

    def host_depth(self, index):
        """Return the depth [m] of a step on the host, at the earliest the last but one; waits."""
        self.begin(index)
        if index == self._begun:
            self.complete()
        return fetch(self.water.depths[index % 2], self.water.stream)

    def _bring(self, before, time):
        """Set the rain that falls between two times."""
        field = self.weather.field(before, time)
        finer = 0.0 if field is None else field.spectrum.fine_rate
        self.water.account.update(time - before, finer, True)
        if self.drips is not None:
            wind = self.weather.wind(0.5 * (before + time))
            self.drips.update(before, time, wind, finer * (time - before))

    def launch(self):
        """Queue a step: the water of the drops that ended, their rings, the flow and the account.

        Nothing here waits, allocates or reads results.
        """
        land = self.water, self.ripples, self.water.stream
        self.ripples.send(self.water.stream)
        if self.drips is not None:
            page = self.water.page
            self.impacts.settle(*land, (self.drips.point, self.drips.came[page]))
            self.drips.launch(page, *land)
        elif self.impacts is not None:
            self.impacts.settle(*land)
        self.ripples.fork(self.water.stream)
        self.water.launch()
        self.water.account.copy()
        self.ripples.join(self.water.stream)

    def before(self, stream, falls=True):
        """Let another stream wait for the step that has begun and, if it `falls`, the impacts."""
        self._ready.wait(stream)
        if falls and self.impacts is not None:
            self.impacts.listed.wait(stream)

    def after(self, stream, page):
        """Let the next step that writes to the `page` wait for work queued on another stream."""
        self._drawn[page].record(stream)

    def lacked(self, index):
        """Finish a step; return whether it had too little room, so that its picture is wrong.

        Raises BackendError if more drops fell than the list has room for.
        """
        if index == self._begun:
            self.complete()
        if self.impacts is not None:
            self.impacts.check()
        if self.drips is not None:
            self.drips.check()
        late, self._late = self._late == index, -1
        return late

    @one_fault()
    def ledger(self, index):
        """Return the account of the water up to a frame, m3, as `rainsim.simulation` gives it.

        It must be one of the last three frames that have begun.
        """
        if index == self._begun:
            self.complete()
        control, fallen, drips, inflow = self._accounts[index % ACCOUNTS]
        came = fallen * VOLUME_UNIT
        returned, held, airborne = 0.0, came + self._objects.initial, 0.0
        if drips is not None:
            held, airborne, returned, fine = volumes(drips)
            came += fine
        ledger = self.water.account.ledger(control)
        own = came, returned, held, airborne, inflow
        return self._objects.with_objects(ledger, *own).as_dict()


def simulate(terrain, config):
    """Yield the `DeviceState` at the time of each frame, from frame 0 on, without end."""
    run = Simulation(terrain, config)
    while True:
        state = run.advance()
        yield state
