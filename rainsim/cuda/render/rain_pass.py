"""Twin of `rainsim.render.rain_pass`: streaks, splashes and fog of one frame after another."""

import numpy as np

from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.jit import cuda
from rainsim.cuda.particles.splash_pass import Splashes
from rainsim.cuda.particles.spray import Spray
from rainsim.cuda.particles.streaks import Streaks
from rainsim.cuda.rain.drip_list import DripList
from rainsim.cuda.rain.moving_surfaces import MovingHeights
from rainsim.drops import RainField, RainSpectrum
from rainsim.particles.fog import FOG_STEPS, NO_FOG, fog_table
from rainsim.particles.line_raster import NEAR
from rainsim.particles.splash import WET_FILM
from rainsim.particles.spray import spray_seen
from rainsim.render.rain_pass import drawn_reach, lens_of

NO_RAIN = RainField(RainSpectrum(0.0))


class RainPass:
    """Draws streaks, splashes, drips and spray before a picture."""

    def __init__(self, conductor):
        self._conductor, ground = conductor, conductor.ground
        footprints = ground.terrain.footprints
        self._heights = self._spray = None
        if footprints:
            self._heights = MovingHeights(ground.moving.still, footprints)
            self._spray = Spray() if conductor.cars else None
        self._streaks = self._splashes = self._drips = None
        self._fog, self._fog_of = FrameUniforms({"fog": ((FOG_STEPS + 3,), np.float32)}), ()
        self._none = None  # a picture without rain

    def see(self, ground_camera, ground_camera_end, time, render, field):
        """Take over camera, shutter and rain of a picture; return its streaks, or None."""
        if field is None and self._fog_of is not None:  # that of rain that has ended must go
            self._send_fog(None, NO_FOG)
        if field is None and self._spray is None:
            return None
        camera, size = ground_camera, (ground_camera.height, ground_camera.width)
        if self._streaks is None or self._streaks.alpha.shape != size:
            self._streaks = self._splashes = None  # freed before more is asked for
            surfaces = self._conductor.frame["surfaces"]
            if self._heights is not None:
                surfaces = self._heights.fields
            rain = NO_RAIN if field is None else field
            self._streaks = Streaks(rain, surfaces, camera.width, camera.height)
            self._streaks.spray = self._spray
        shutter = camera, time, render.exposure
        lens = lens_of(ground_camera_end, render)
        if field is None:
            self._streaks.update(NO_RAIN, *shutter, NEAR, *lens)
            return self._streaks
        times = render.exposure, render.reach_exposure
        key = field, camera.fx, camera.fy, *times, render.streak_far
        if key != self._fog_of:
            self._reach = drawn_reach(field, camera, render)
            self._send_fog(key, fog_table(field, self._reach))
        self._streaks.update(field, *shutter, self._reach, *lens)
        return self._streaks

    def _send_fog(self, key, table):
        self._fog_of = key
        self._fog.update(fog=table)
        self._fog.send()

    def fall(self, drops, depth, ground_camera, time, render, surfaces, drips, rolls):
        """Queue what `draw_falling` draws; return it as a device array, and the fog."""
        if drops is None:
            return self._nothing(depth.shape), self._fog["fog"]
        if self._heights is not None:
            self._heights.send(surfaces)
        if self._spray is not None:
            seen = spray_seen(rolls, ground_camera, time, render.exposure)
            self._spray.send(*seen, ground_camera)
        drops.drips = self._on_device(drips)
        drops.draw(depth)
        return drops.alpha, self._fog["fog"]

    def land(self, drops, depth, ground_camera, time, render, field, surfaces, water, paving):
        """Queue what `draw_landing` draws; return it as a device array; waits."""
        if field is None:
            return self._nothing(depth.shape)
        if self._splashes is None:
            self._splashes = Splashes(drops)
        shutter = ground_camera, time, render.exposure
        self._splashes.draw(field, surfaces, *shutter, water, WET_FILM * paving)
        return self._splashes.alpha

    def _on_device(self, drips):
        """Return the `DripList` of a state's drips, which are there or on the host."""
        if drips is None or isinstance(drips, DripList):
            return drips
        if not len(drips[1]):
            return None
        if self._drips is None:
            self._drips = DripList()
        self._drips.fill(*drips)
        return self._drips

    def _nothing(self, shape):
        if self._none is None or self._none.shape != shape:
            self._none = cuda.to_device(np.zeros(shape, np.float32))
        return self._none
