"""Water that falls before a camera: streaks, splashes, and fog of drops too small to draw."""

import numpy as np

from rainsim.drops import RainField, RainSpectrum
from rainsim.particles import paper
from rainsim.particles.fog import NO_FOG, fog_table
from rainsim.particles.line_raster import NEAR
from rainsim.particles.splash import LONGEST_LIFE, WET_FILM
from rainsim.particles.splash_pass import draw_splashes
from rainsim.particles.spray import lay_clouds, spray_seen
from rainsim.particles.streaks import draw_streaks, streak_reach
from rainsim.rain.dripping import drip_impacts, drips_seen


def draw_falling(
    depth, ground_camera, ground_camera_end, time, render, field, surfaces, drips, rolls
):  # fmt: skip
    """Return the share of light that falling drops replace, and the fog of those not drawn.

    depth : float32 array (height, width) [m]. Of the picture.
    ground_camera, ground_camera_end : Camera. In the ground frame, as the shutter
        opens and closes; None at the end: it stands still.
    time : float [s]
    render : RenderConfig. Of that time.
    field : RainField or None. None without rain.
    surfaces : Surfaces. What drops land on.
    drips, rolls. Drips in the air with their numbers; the `Rolls` of tyres or
        None.
    Returns alpha : float32 array (height, width)
        fog : ndarray. See `fog_table`.
    """
    alpha, camera, camera_end = np.zeros(depth.shape, np.float32), ground_camera, ground_camera_end
    drops, clouds = spray_seen(rolls, camera, time, render.exposure)
    lens = lens_of(camera_end, render)
    if field is None:  # tyres on a wet road throw water while no rain falls
        draw_spray(drops, depth, camera, camera_end, time, render, alpha)
        fog = NO_FOG
    elif render.streaks == "paper":
        paper.draw_lines(field, surfaces, camera, time, render.streak_far, depth, alpha)
        fog = NO_FOG
    else:
        reach = drawn_reach(field, camera, render)
        seen = drips_seen(drips[0], time, render.exposure)
        more = np.concatenate([seen, drops]) if len(drops) else seen
        draw_streaks(
            field, surfaces, camera, time, render.exposure, depth, reach, alpha, *lens, more=more
        )
        fog = fog_table(field, reach)
    lay_clouds(clouds, camera, depth, alpha)
    return alpha, fog


def lens_of(camera_end, render):
    """Return the parameters of `draw_streaks` from `camera_end` to `strength`."""
    return camera_end, render.aperture, render.focus, render.streak_strength


def drawn_reach(field, camera, render):
    """Return the depth of each class up to which its drops are drawn, see `streak_reach`."""
    return streak_reach(field, camera, render.reach_exposure or render.exposure, render.streak_far)


def draw_spray(drops, depth, camera, camera_end, time, render, alpha_out):
    """Draw the drops of `spray_seen` alone; the other parameters are those of `draw_falling`."""
    if len(drops):
        draw_streaks(
            RainField(RainSpectrum(0.0)), None, camera, time, render.exposure, depth, NEAR,
            alpha_out, *lens_of(camera_end, render), more=drops,
        )  # fmt: skip


def draw_landing(
    depth, ground_camera, ground_camera_end, time, interval, render, field, surfaces, drips, water,
    paving,
):  # fmt: skip
    """Return the share of light that splashes replace, ndarray of shape (height, width), float32.

    interval : float [s]. From frame to frame.
    water : float32 array (ny, nx) [m]. Depth on the ground.
    paving : float. How wet open paving is, 0 to 1.
    The others are those of `draw_falling`.
    """
    alpha = np.zeros(depth.shape, np.float32)
    if field is None:
        return alpha
    shutter = field, surfaces, ground_camera
    if render.splashes == "paper":
        paper.draw_gaussians(*shutter, time - interval, time, depth, alpha)
        return alpha
    impacts = drip_impacts(*drips, surfaces, time - LONGEST_LIFE, time + render.exposure)
    draw_splashes(
        *shutter, time, render.exposure, water, WET_FILM * paving, depth, alpha,
        *lens_of(ground_camera_end, render), more=impacts,
    )  # fmt: skip
    return alpha
