"""Water that falls before a camera: streaks, splashes, and fog of drops too small to draw."""

from __future__ import annotations

import numpy as np

from rainsim.drops import RainField, RainSpectrum, Weather
from rainsim.particles import paper
from rainsim.particles.fog import NO_FOG, fog_table
from rainsim.particles.line_raster import NEAR
from rainsim.particles.splash import LONGEST_LIFE, WET_FILM
from rainsim.particles.splash_pass import draw_splashes
from rainsim.particles.spray import lay_clouds, spray_seen
from rainsim.particles.streaks import draw_streaks, streak_reach
from rainsim.rain.dripping import drip_impacts, drips_seen
from rainsim.shading.composite import RainCover


class RainPass:
    """Draws the rain of one scene, a moment after another.

    Parameters
    ----------
    surfaces : Surfaces
        What drops land on.
    config : Config

    Attributes
    ----------
    weather : Weather
    """

    def __init__(self, surfaces, config):
        self.surfaces, self.interval = surfaces, config.frame_interval
        self.weather = Weather(config)

    def field(self, time, exposure):
        """Return the drops whose streaks or splashes a frame shows, a RainField; None: no rain."""
        return self.weather.field(time - LONGEST_LIFE, time + exposure)

    def draw(self, camera, camera_end, state, render, paving, depth, timer):
        """Return the `RainCover` before a picture.

        Parameters
        ----------
        camera : Camera
            In the ground frame, as the shutter opens.
        camera_end : Camera or None
            As it closes; None: the camera stands still.
        state : SimState
        render : RenderConfig
            Of the state's time.
        paving : float
            How wet open paving is, 0 to 1.
        depth : ndarray of shape (height, width), float32 [m]
            Of the picture.
        timer : Timer
        """
        rain = np.zeros((camera.height, camera.width), np.float32)
        splash, field = np.zeros_like(rain), self.field(state.time, render.exposure)
        drops, clouds = spray_seen(
            state.throws, state.throw_id, camera, state.time, render.exposure
        )
        if field is None:
            self._draw_spray_alone(camera, camera_end, state, render, depth, drops, rain)
            lay_clouds(clouds, camera, depth, rain)
            return RainCover(rain, splash, NO_FOG)
        shutter = field, self.surfaces, camera, state.time
        lens = camera_end, render.aperture, render.focus
        reach = streak_reach(field, camera, render.exposure, render.streak_far)
        if render.streaks == "paper":
            paper.draw_lines(*shutter, render.streak_far, depth, rain)
            fog = NO_FOG
        else:
            drips = drips_seen(state.drips, state.time, render.exposure)
            more = np.concatenate([drips, drops]) if len(drops) else drips
            draw_streaks(*shutter, render.exposure, depth, reach, rain, *lens, more=more)
            fog = fog_table(field, reach)
        lay_clouds(clouds, camera, depth, rain)
        timer.mark("streaks")
        if render.splashes == "paper":
            begin = state.time - self.interval
            paper.draw_gaussians(*shutter[:3], begin, state.time, depth, splash)
        else:
            impacts = drip_impacts(
                state.drips, state.drip_id, self.surfaces, state.time - LONGEST_LIFE,
                state.time + render.exposure,
            )  # fmt: skip
            draw_splashes(
                *shutter, render.exposure, state.depth, WET_FILM * paving, depth, splash, *lens,
                more=impacts,
            )  # fmt: skip
        timer.mark("splashes")
        return RainCover(rain, splash, fog)

    def _draw_spray_alone(self, camera, camera_end, state, render, depth, drops, alpha_out):
        """Draw the spray of tyres on a wet road while no rain falls."""
        if len(drops):
            none = RainField(RainSpectrum(0.0))
            draw_streaks(
                none, None, camera, state.time, render.exposure, depth, NEAR, alpha_out,
                camera_end, render.aperture, render.focus, more=drops,
            )  # fmt: skip
