"""Layers of the rain: its motion and depth, and the parts that the picture draws together.

The picture has one alpha of all that falls. Drops near the camera, and what tyres throw, are drawn
alone here, by the kernels that draw them all; since alphas combine as products of what is let
through, that of the other drops follows by a division.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.particles.drop_paths import SAMPLES, path_sums
from rainsim.particles.spray import CUT, lay_clouds, spray_seen
from rainsim.particles.streaks import draw_streaks
from rainsim.rain.dripping import drips_seen
from rainsim.render.rain_pass import draw_spray, drawn_reach, lens_of
from rainsim.scene.view import camera_points, corner_rays, image_point

NEAR_DROPS = 2.0  # m: drops nearer than this are an element of their own
AHEAD = 0.3  # m above the view: drops there fall into it while the shutter is open


class Falling(NamedTuple):
    """What a picture draws that falls: rows of place [m], velocity [m/s] and diameter [m]."""

    spray: np.ndarray  # (n, 7) drops that tyres throw
    rain: np.ndarray  # (n, 7) in the order of their own numbers
    drips: np.ndarray  # (n, 7)
    clouds: object  # of spray, see `particles.spray.spray_seen`


def project(points, camera):
    """Return image point and depth of ground-frame points, (n, 3)."""
    x, y, z = camera_points(camera, np.asarray(points, np.float64)).T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([*image_point(camera, x, y, z), z], axis=1)


def near_alpha(depth, ground_camera, ground_camera_end, time, render, field, surfaces):
    """Return the share of light that drops of the rain nearer than `NEAR_DROPS` replace."""
    alpha = np.zeros(depth.shape, np.float32)
    if field is not None and render.streaks != "paper":
        reach = drawn_reach(field, ground_camera, render)
        draw_streaks(
            field, surfaces, ground_camera, time, render.exposure, depth,
            np.minimum(reach, NEAR_DROPS), alpha, *lens_of(ground_camera_end, render),
        )  # fmt: skip
    return alpha


def spray_alpha(depth, ground_camera, ground_camera_end, time, render, field, rolls):
    """Return the share of light that what tyres throw replaces, drops and clouds."""
    alpha = np.zeros(depth.shape, np.float32)
    drops, clouds = _spray(ground_camera, time, render, field, rolls)
    draw_spray(drops, depth, ground_camera, ground_camera_end, time, render, alpha)
    lay_clouds(clouds, ground_camera, depth, alpha)
    return alpha


def _spray(ground_camera, time, render, field, rolls):
    """Return drops and clouds of spray as the picture has them: lines of the paper draw no drop."""
    drops, clouds = spray_seen(rolls, ground_camera, time, render.exposure)
    return drops[:0] if field is not None and render.streaks == "paper" else drops, clouds


def find_falling(ground_camera, ground_camera_end, time, render, field, drips, rolls):
    """Return what a picture draws that falls, `Falling`, and some drops around it."""
    spray, clouds = _spray(ground_camera, time, render, field, rolls)
    if field is None:
        return Falling(spray, spray[:0], spray[:0], clouds)
    far = np.full(len(field.velocity), render.streak_far)
    if render.streaks != "paper":
        far = drawn_reach(field, ground_camera, render)
    # A box for each class around what is seen up to the depth at which it is fog.
    seen = []
    for camera in (ground_camera, ground_camera_end or ground_camera):
        rays = np.concatenate([np.zeros((1, 3)), corner_rays(camera)]) * far[:, None, None]
        seen.append(rays @ camera.camera_from_world[:3, :3] + camera.position)
    box = np.concatenate(seen, axis=1)
    found = field.drops_in_box(time, box.min(axis=1), box.max(axis=1) + np.array([0, 0, AHEAD]))
    size = np.searchsorted(field.spectrum.edges, found.diameter, side="right") - 1
    axis = ground_camera.camera_from_world[2]
    away = found.position @ axis[:3] + axis[3]
    shown = (away < far[np.clip(size, 0, len(far) - 1)]) & (away > 0)
    listed = np.column_stack([found.position, found.velocity, found.diameter])
    dripping = drips_seen(drips[0], time, render.exposure)
    return Falling(spray, listed[shown], dripping, clouds)


def drop_flow(
    rain_alpha, depth, ground_camera, next_ground_camera, render, field, interval, falling
):
    """Return the motion of drops in the picture, the mean over the drops in a pixel.

    The camera's own motion is part of it. Each drop that the picture draws counts with the light
    that it replaces; zero where there are none.
    """
    height, width = depth.shape
    if field is None:
        return np.zeros((height, width, 2), np.float32)
    next_camera = ground_camera if next_ground_camera is None else next_ground_camera
    weight, _, *flow = path_sums(
        falling.rain, interval, (ground_camera, next_camera), render.exposure / interval, depth,
        render.streak_far,
    )  # fmt: skip
    flow = np.stack(flow, axis=-1) / np.maximum(weight, 1e-30)[:, None]
    flow[rain_alpha.ravel() <= 0] = 0
    return flow.reshape(height, width, 2).astype(np.float32)


def rain_depth(
    rain_alpha, splash_alpha, depth, surface_depth, ground_camera, ground_camera_end, render,
    falling,
):  # fmt: skip
    """Return the depth of drops, splashes and spray [m], infinite where there are none.

    The mean by the light that they replace, along the view axis, at most that of the surface behind
    them, which splashes count at. A pixel that a drop touches only with its edge takes the depth of
    the nearest one whose middle is known.
    """
    cameras, lines = (ground_camera, ground_camera_end), np.concatenate(falling[:3])
    weight, total = _gathered(lines, falling.clouds, *cameras, render, depth)
    splashes = -np.log1p(-np.minimum(splash_alpha.ravel(), 0.9999).astype(np.float64))
    splashes[~np.isfinite(depth.ravel())] = 0
    weight += splashes
    total += np.where(splashes > 0, depth.ravel(), 0) * splashes
    return _mean(weight, total, (rain_alpha > 0) | (splash_alpha > 0), surface_depth)


def element_depths(
    rain_alpha, near_alpha, spray_alpha, depth, surface_depth, ground_camera, ground_camera_end,
    render, falling,
):  # fmt: skip
    """Return `rain_depth` of near drops alone, of all other drops, and of spray."""
    rest = ground_camera, ground_camera_end, render, depth
    rounded = 1e-6
    past_both = (1 - near_alpha) * (1 - spray_alpha) - rounded
    near = _gathered(falling.rain, None, *rest, farthest=NEAR_DROPS)
    far = _gathered(falling.rain, None, *rest, nearest=NEAR_DROPS)
    dripped = _gathered(falling.drips, None, *rest)
    return (
        _mean(*near, near_alpha > 0, surface_depth),
        _mean(far[0] + dripped[0], far[1] + dripped[1], 1 - rain_alpha < past_both, surface_depth),
        _mean(*_gathered(falling.spray, falling.clouds, *rest), spray_alpha > 0, surface_depth),
    )


def _gathered(
    lines, clouds, ground_camera, ground_camera_end, render, depth, nearest=0.0, farthest=np.inf
):  # fmt: skip
    """Return the light that drops and clouds replace, and that times its depth, of each pixel.

    Both are flat arrays. Drops count from the depth `nearest` to `farthest` [m].
    """
    cameras = ground_camera, ground_camera_end or ground_camera
    between = nearest, farthest
    weight, total = path_sums(
        lines, render.exposure, cameras, 1.0, depth, render.streak_far, between
    )[:2]
    # A drop's alphas sum to its area in pixels, but for a look.
    area = math.pi / 4 * ground_camera.fx * ground_camera.fy / SAMPLES * render.streak_strength
    # A drop is drawn in the two pixels beside its path, the samples are in one of them.
    weight, total = (_spread(area * a.reshape(depth.shape)).ravel() for a in (weight, total))
    if clouds is not None:
        _add_clouds(clouds, ground_camera, depth, weight, total)
    return weight, total


def _mean(weight, total, shows, depth):
    """Return the mean depth of each pixel [m], infinite but for those that show something.

    It is at most `depth`, of the surfaces.
    """
    known = (weight > 0).reshape(depth.shape)
    out = np.full(depth.shape, np.inf, np.float32)
    if known.any():
        mean = (total / np.maximum(weight, 1e-30)).reshape(depth.shape)
        nearest = ndimage.distance_transform_edt(
            ~known, return_distances=False, return_indices=True
        )
        out[shows] = np.minimum(mean[tuple(nearest)], depth)[shows]
    return out


def _spread(values):
    """Return a picture with each value spread over its neighbours by halves and quarters."""
    for axis in (0, 1):
        values = ndimage.correlate1d(values, [0.25, 0.5, 0.25], axis, mode="constant")
    return values


def _add_clouds(clouds, ground_camera, depth, weight_out, total_out):
    """Add the optical depths of Gaussian clouds, and those times their depths, to flat pictures."""
    height, width = depth.shape
    places = project(clouds.place, ground_camera)
    for (u, v, z), deviation, section in zip(places, clouds.deviation, clouds.section, strict=True):
        if not z > CUT * deviation:
            continue
        spread = ground_camera.fx * deviation / z  # px
        left, right = (int(np.clip(u + s * CUT * spread, 0, width)) for s in (-1, 1))
        top, bottom = (int(np.clip(v + s * CUT * spread, 0, height)) for s in (-1, 1))
        if right <= left or bottom <= top:
            continue
        rows, columns = np.mgrid[top:bottom, left:right] + 0.5
        square = ((columns - u) ** 2 + (rows - v) ** 2) / spread**2
        thickness = section / (2 * math.pi * deviation**2) * np.exp(-square / 2)
        thickness[depth[top:bottom, left:right] < z] = 0
        at = ((rows - 0.5) * width + columns - 0.5).astype(np.int64)
        weight_out[at] += thickness
        total_out[at] += thickness * z
