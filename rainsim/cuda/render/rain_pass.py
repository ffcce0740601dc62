"""Twin of `rainsim.render.rain_pass`: streaks, splashes and fog of one frame after another."""

from __future__ import annotations

import math

import numpy as np

from rainsim.cuda.jit import pinned
from rainsim.cuda.particles.splash_pass import Splashes
from rainsim.cuda.particles.streaks import Streaks
from rainsim.cuda.rain.dripping import DripList
from rainsim.cuda.rain.impact_history import RecentImpacts
from rainsim.cuda.small_copies import copy_small
from rainsim.drops import RainField, RainSpectrum
from rainsim.particles.fog import NO_FOG, fog_table
from rainsim.particles.line_raster import NEAR
from rainsim.particles.splash import WET_FILM
from rainsim.render.rain_pass import drawn_reach
from rainsim.shading.composite import RainCover


class RainPass:
    """Draws streaks, splashes, drips and spray before a picture.

    frame : rainsim.cuda.render.device_frame.DeviceFrame
    actors : MovingActors or None
    surface : WaterSurface. Of the water that splashes are thrown from.
    streaks : Streaks or None. None where neither rain falls nor tyres throw
        anything.
    splashes : Splashes or None. None without rain.
    impacts : RecentImpacts or None. What fell in the last moments, for states of
        the host, and where actors move: a frame shows what fell on them as they
        stand at its time.
    drips : DripList or None. For states of the host.
    """

    def __init__(self, frame, actors, surface):
        self._frame, self._actors, self._surface = frame, actors, surface
        self.stream = frame.stream
        self.streaks = self.splashes = self.impacts = self.drips = None
        self._fog_of = None, NO_FOG, None
        self._lines = pinned(1, np.int32)

    def room_for(self, height, width):
        """Allocate the arrays that pictures of a size [px] need."""
        self.streaks = self.splashes = None
        inputs, actors = self._frame.conductor.frame, self._actors
        field, surfaces, depth = inputs["field"], inputs["surfaces"], self._frame["depth"]
        spray = None if actors is None else actors.spray
        if field is None and spray is None:
            return
        field = RainField(RainSpectrum(0.0)) if field is None else field
        self.streaks = Streaks(field, surfaces, width, height, depth, self.stream)
        self._no_rain = field
        if self._moves:
            self.streaks.surfaces = actors.heights.fields
        self.streaks.spray = spray

    def update(self, state, camera_end):
        """Take over rain and shutter of the next frame; return the fog of undrawn drops."""
        if self.streaks is None:
            return NO_FOG
        conductor, simulation = self._frame.conductor, getattr(state, "simulation", None)
        render, camera = conductor.now.render, conductor.ground_camera
        field, shutter = conductor.frame["field"], (camera, state.time, render.exposure)
        lens = camera_end, render.aperture, render.focus
        if field is None:
            self.streaks.update(self._no_rain, *shutter, NEAR, *lens)
            return NO_FOG
        times = render.exposure, render.reach_exposure
        key = field, camera.fx, camera.fy, *times, render.streak_far
        if key != self._fog_of[0]:
            reach = drawn_reach(field, camera, render)
            self._fog_of = key, fog_table(field, reach), reach
        _, fog, reach = self._fog_of
        self.streaks.update(field, *shutter, reach, *lens)
        if self.impacts is None and (simulation is None or self._moves):
            self.impacts = self._recent()
        frame = math.floor(state.time * conductor.config.fps + 1e-6)
        if self.impacts is not None:
            self.impacts.update(frame)
        recent = simulation.impacts if self.impacts is None else self.impacts
        if self.splashes is None:
            self.splashes = Splashes(self.streaks, recent, self._surface.depth)
        film = WET_FILM * conductor.frame["paving"]
        self.splashes.update(field, film, recent.next_list(frame))
        return fog

    @property
    def _moves(self):
        return self._actors is not None and self._actors.heights is not None

    def _recent(self):
        """Return the impacts of states whose times may lie within an interval."""
        conductor, actors = self._frame.conductor, self._actors
        # Two more intervals are to come.
        recent = RecentImpacts(
            conductor.weather, conductor.frame["surfaces"], conductor.config.fps, 2, self.stream
        )
        if self._moves:
            recent.surfaces, recent.relisted = actors.heights.fields, True
        return recent

    def leave_water(self):
        """Drop the impacts and drips of the frames so far: the next shows another simulation."""
        self.splashes = self.impacts = self.drips = None
        if self.streaks is not None:
            self.streaks.drips = None

    def send_drips(self, state):
        """Send the drips of a state of the host; the device must draw nothing meanwhile.

        Room is made here and not before: the frame before may still be drawn again, and a queue
        recorded for that would hold the list without the room.
        """
        count, room = len(state.drip_id), 0 if self.drips is None else self.drips.room
        if self.streaks is not None and count > room:
            self.drips = DripList(2 * count)
        if self.drips is not None:
            self.drips.fill(state.drips, state.drip_id)
            self.streaks.drips = self.drips

    def take_water(self, state):
        """Take over the water that a simulation on the device has for a frame."""
        if self.splashes is not None:
            self.splashes.depth = state.depth
        if self.streaks is not None:
            self.streaks.drips = state.drip_list

    # ---- what is queued

    @property
    def alphas(self):
        """Shares of light that drops and splashes replace, two device arrays."""
        both = self.streaks, self.splashes
        none = self._frame["no_rain"]
        return tuple(none if each is None else each.alpha for each in both)

    def send(self, stream):
        """Queue the copy of camera, shutter and drops of the picture."""
        if self.streaks is not None:
            self.streaks.now.send(stream)

    def draw_streaks(self, stream):
        """Queue the picture of the falling drops."""
        if self.streaks is not None:
            self.streaks.draw(stream)

    def list_splashes(self, stream):
        """Queue the listing of the splashes in view."""
        if self.splashes is not None:
            if self.impacts is not None:
                self.impacts.launch(stream)
            self.splashes.gather(stream)
            copy_small(self.splashes.count, self._lines, stream)

    def draw_splashes(self, stream):
        """Queue the drawing of the listed splashes, after the picture of the falling drops."""
        if self.splashes is not None:
            self.splashes.draw(stream)

    # ---- what comes back

    @property
    def lacks(self):
        """Whether there was too little room for the frame's splashes."""
        if self.splashes is not None and self.impacts is not None:
            self.impacts.check()
        return self.splashes is not None and int(self._lines[0]) > len(self.splashes.lines)

    def grow(self):
        """Make room where the finished frame's splashes lacked it."""
        if self.lacks:
            self.splashes.make_room(2 * int(self._lines[0]))

    def dependencies(self):
        """Return the values that a recorded queue depends on, one for each list that it draws."""
        parts = self.splashes, self.streaks, self.drips
        return tuple(part.version for part in parts if part is not None)

    def cover(self):
        """Return the `RainCover` of the finished frame, on the host."""
        fog = NO_FOG if self.splashes is None else self._fog_of[1]
        return RainCover(*(alpha.copy_to_host() for alpha in self.alphas), fog)
