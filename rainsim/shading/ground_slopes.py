"""The ground as the wet-ground mirror takes it: where a ray of view meets it, and its slopes."""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import inlined_function
from rainsim.numerics.interpolation import is_on_map, map_place
from rainsim.scene.view import image_ray
from rainsim.shading.fresnel import EXACT
from rainsim.shading.microfacet import LEAST_DIP
from rainsim.terrain import filters

SLOPE_WIDTH = 0.25  # m, over which the ground's height and slope are averaged


class GroundSlopes(NamedTuple):
    """The ground as the wet-ground mirror takes it; read-only."""

    # (ny, nx, 4) float32: height [m], slopes d/dx and d/dy, rms slope of the water film
    slopes: np.ndarray
    origin: np.ndarray  # (2,) float32 [m], corner of the first cell
    spacing: np.float32  # m
    law: int = EXACT  # of the film's reflectance, a number of `fresnel.LAWS`


def ground_slopes(terrain):
    """Return the `GroundSlopes` of a terrain: its bed is averaged over SLOPE_WIDTH."""
    cell, bed = terrain.grid.spacing, terrain.bed.astype(np.float64)
    smooth = filters.gaussian_filter(bed, SLOPE_WIDTH / cell)
    slopes = np.empty((*bed.shape, 4), np.float32)
    slopes[..., 0] = smooth
    slopes[..., 1] = np.gradient(smooth, cell, axis=1)
    slopes[..., 2] = np.gradient(smooth, cell, axis=0)
    slopes[..., 3] = filters.gaussian_filter(terrain.by_class("film_slope"), 1)
    return GroundSlopes(slopes, np.array(terrain.grid.origin, np.float32), np.float32(cell))


@inlined_function
def block_ray(view, step, j, i):
    """Return the ray (x, y, z) through the middle of a block of pixels, 1 along the view axis."""
    u, v = (np.float32(i) + HALF) * np.float32(step), (np.float32(j) + HALF) * np.float32(step)
    return image_ray(view.ground_from_camera, view.fx, view.fy, view.cx, view.cy, u, v)


@inlined_function
def ground_met(x, y, z, eye, ground):
    """Return where a ray of view meets the ground, which is nearly level.

    Returns ux, uy, dip : float32. Its level direction, a unit vector, and how
        fast it falls.
        span, height : float32 [m]. Its level length to the ground, whose height
            is there.
        gx, gy, slope : float32. Slopes of the ground, zero off the map, and rms
            slope of the film.
    """
    origin, spacing, slopes = ground.origin, ground.spacing, ground.slopes
    flat = max(math.sqrt(x * x + y * y), np.float32(1e-4))
    ux, uy = x / flat, y / flat
    dip = max(-z / flat, LEAST_DIP)
    here = ZERO
    span = ZERO
    u, v, gx, gy, slope = ZERO, ZERO, ZERO, ZERO, ONE
    for _ in range(3):
        span = max(eye[2] - here, np.float32(0.02)) / dip
        u, v = map_place(eye[0] + span * ux, eye[1] + span * uy, origin, spacing)
        here, gx, gy, slope = slopes_at(slopes, u, v)
    if not is_on_map(u, v, slopes):
        gx, gy = ZERO, ZERO
    return ux, uy, dip, span, here, gx, gy, slope


@inlined_function
def slopes_at(slopes, u, v):
    """Return the four numbers of `GroundSlopes.slopes` at column u and row v, interpolated.

    Off the map they are those at its border.
    """
    rows, columns = slopes.shape[0], slopes.shape[1]
    u = min(max(u, ZERO), np.float32(columns - 1))
    v = min(max(v, ZERO), np.float32(rows - 1))
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    k, m = i + 1, j + 1
    a, b = u - np.float32(i), v - np.float32(j)
    w0, w1, w2, w3 = (ONE - a) * (ONE - b), a * (ONE - b), (ONE - a) * b, a * b
    g = slopes
    return (
        g[j, i, 0] * w0 + g[j, k, 0] * w1 + g[m, i, 0] * w2 + g[m, k, 0] * w3,
        g[j, i, 1] * w0 + g[j, k, 1] * w1 + g[m, i, 1] * w2 + g[m, k, 1] * w3,
        g[j, i, 2] * w0 + g[j, k, 2] * w1 + g[m, i, 2] * w2 + g[m, k, 2] * w3,
        g[j, i, 3] * w0 + g[j, k, 3] * w1 + g[m, i, 3] * w2 + g[m, k, 3] * w3,
    )
