"""Which share of the rain reaches each cell of the ground, past all that stands in its way."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from rainsim.constants import HALF, ONE, ZERO
from rainsim.io import cache
from rainsim.jit import cpu_kernel, prange
from rainsim.rain.size_distribution import terminal_speed
from rainsim.rain.wind import wind_shares

LEAST_KEPT = 1 << 18  # cells of a map whose exposure is kept; a smaller one takes .1 s
SHELTER_BLUR = 0.05  # m: gusts and drops of other sizes soften the edge of a dry patch
SHELTER_DIAMETERS = (1e-3, 2e-3, 3.5e-3)  # m, drops whose paths are followed


def rain_exposure(terrain, wind, roughness=0.0):
    """Return the share of the rain that reaches each ground cell, float32 (ny, nx).

    The paths of drops of three sizes are followed upwards. The result is blurred, because the edge
    of a dry patch is soft in nature. The exposure of a large map is kept for the next run, see
    `rainsim.io.cache`.

    Parameters
    ----------
    terrain : Terrain
    wind : tuple of float
        Speed [m/s] at 10 m and direction [rad].
    roughness : float [m]
        See `rain.wind.wind_shares`.
    """
    if terrain.bed.size < LEAST_KEPT:
        return computed_exposure(terrain, wind, roughness)
    return cache.kept_arrays(
        "exposure", "rain", lambda: {"share": computed_exposure(terrain, wind, roughness)},
        terrain.bed, terrain.top, terrain.underside, terrain.grid, wind, roughness,
    )["share"]  # fmt: skip


def computed_exposure(terrain, wind, roughness=0.0):
    """Return the exposure of a terrain, or of an object with its grid, bed, top and underside.

    See `rain_exposure`, which keeps it.
    """
    total = np.zeros(terrain.grid.shape, np.float32)
    speed, direction = wind
    ceiling = np.float32(terrain.top.max())
    falls = terminal_speed(np.array(SHELTER_DIAMETERS))
    for slope in speed * wind_shares(falls, roughness) / falls:  # m sideways per m of fall
        open_out = np.full(terrain.grid.shape, np.nan, np.float32)
        _mark_open_cells(
            terrain.bed, terrain.top, terrain.underside, np.float32(terrain.grid.spacing),
            np.float32(-slope * math.cos(direction)), np.float32(-slope * math.sin(direction)),
            ceiling, open_out,
        )  # fmt: skip
        total += open_out
    blur = SHELTER_BLUR / terrain.grid.spacing
    return ndimage.gaussian_filter(total / len(SHELTER_DIAMETERS), blur).astype(np.float32)


@cpu_kernel
def _mark_open_cells(bed, top, underside, spacing, dx, dy, ceiling, open_out):
    """Mark the ground cells from which the way up along (dx, dy, 1) is free.

    Parameters
    ----------
    bed, top, underside : ndarray of shape (ny, nx), float32 [m]
    spacing : float32 [m]
    dx, dy : float32
        Metres sideways per metre upwards.
    ceiling : float32 [m]
        Height above which nothing stands.
    open_out : ndarray of shape (ny, nx), float32
        1 where the way is free, else 0.
    """
    ny, nx = bed.shape
    step = spacing / max(abs(dx), max(abs(dy), HALF))  # at most a cell sideways, two cells up
    for j in prange(ny):
        for i in range(nx):
            z = bed[j, i]
            x, y = np.float32(i), np.float32(j)
            free = ONE
            while z < ceiling:
                k, m = int(x + HALF), int(y + HALF)
                if k < 0 or m < 0 or k >= nx or m >= ny:
                    break
                if top[m, k] > bed[m, k] and z >= underside[m, k] and z <= top[m, k]:
                    free = ZERO
                    break
                z += step
                x += dx * step / spacing
                y += dy * step / spacing
            open_out[j, i] = free
