"""Which share of the rain reaches each cell of the ground, past all that stands in its way."""

import math
from functools import lru_cache

import numpy as np
from scipy import ndimage

from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import cpu_kernel, device_function, prange
from rainsim.numerics.windows import widened, window_of
from rainsim.rain.size_distribution import terminal_speed
from rainsim.rain.wind import wind_shares

SHELTER_BLUR = 0.05  # m: gusts and drops of other sizes soften the edge of a dry patch
SHELTER_DIAMETERS = (1e-3, 2e-3, 3.5e-3)  # m, drops whose paths are followed


def rain_exposure(terrain, wind, roughness=0.0):
    """Return the share of the rain that reaches each ground cell, float32 (ny, nx).

    The paths of drops of three sizes are followed upwards. The result is blurred, because the edge
    of a dry patch is soft in nature.

    terrain : Terrain, or what has its grid, bed, top and underside.
    wind : tuple of float. Speed [m/s] at 10 m and direction [rad].
    roughness : float [m]. See `rain.wind.wind_shares`.
    """
    share = np.empty(terrain.grid.shape, np.float32)
    ceiling, box = np.float32(terrain.top.max()), _box_of(terrain.top > terrain.bed)
    _find_open_share(
        terrain.bed, terrain.top, terrain.underside, np.float32(terrain.grid.spacing),
        _ways(*wind, roughness), ceiling, box, share,
    )  # fmt: skip
    return _blurred(share, SHELTER_BLUR / terrain.grid.spacing)


@lru_cache(8)
def _ways(speed, direction, roughness):
    """Return the ways up of drops in a wind, metres sideways per metre upwards, float32 (n, 2)."""
    falls = terminal_speed(np.array(SHELTER_DIAMETERS))
    slopes = speed * wind_shares(falls, roughness) / falls
    return np.outer(-slopes, (math.cos(direction), math.sin(direction))).astype(np.float32)


def _blurred(share, deviation):
    """Blur the edges of shelters, in place; where all around is open, the share stays as it is."""
    sheltered = window_of(share < 1)
    if sheltered is not None:
        around = 2 * (math.ceil(4 * deviation) + 1)  # the filter ends at 4 deviations
        part, _ = widened(sheltered, around, share.shape)
        share[part] = ndimage.gaussian_filter(share[part], deviation)
    return share.astype(np.float32, copy=False)


def _box_of(mask):
    """Return the first and last column and row of a mask's cells, float32 (4,); NaN of none."""
    window = window_of(mask)
    ends = [(s.start, s.stop - 1) for s in reversed(window)] if window else np.full(4, np.nan)
    return np.array(ends, np.float32).ravel()


@cpu_kernel
def _find_open_share(bed, top, underside, spacing, ways, ceiling, box, share_out):
    """Find the share of some ways up that are free, for each ground cell.

    Ways that begin in one row are at the same place of their cells after each step, so that they
    look at one other row together.

    ways : float32 array (n, 2). Metres sideways per metre upwards.
    ceiling : float32 [m]. Height above which nothing stands.
    box : float32 array (4,). See `_box_of`: the cells with tops. Beside them a
        way is free.
    """
    ny, nx = bed.shape
    first, last, lowest_row, highest_row = box
    for j in prange(ny):  # with loops: operators of arrays take a second to compile
        lowest, free = bed[j, 0], np.empty(nx, np.float32)
        for i in range(nx):
            lowest, share_out[j, i] = min(lowest, bed[j, i]), ZERO
        for n in range(ways.shape[0]):
            dx, dy = ways[n, 0], ways[n, 1]
            # At most a cell sideways, two cells up.
            step = spacing / max(abs(dx), max(abs(dy), HALF))
            free[:] = ONE
            for k in range(math.ceil((ceiling - lowest) / step)):
                rise = np.float32(k) * step
                aside = math.floor(rise * dx / spacing + HALF)
                row = j + math.floor(rise * dy / spacing + HALF)
                if not (row >= lowest_row and row <= highest_row):  # as all rows of no cells
                    continue
                left, right = max(int(first) - aside, 0), min(int(last) + 1 - aside, nx)
                if left < right:
                    there = row, slice(left + aside, right + aside)
                    _stop_ways(
                        bed[j, left:right], rise, bed[there], top[there], underside[there],
                        free[left:right],
                    )  # fmt: skip
            for i in range(nx):
                share_out[j, i] += free[i]
        for i in range(nx):
            share_out[j, i] /= np.float32(ways.shape[0])


@device_function
def _stop_ways(begin, rise, bed, top, underside, free_out):
    """Write 0 for the ways of a row of cells that lie in something that stands or hangs there.

    `begin` is the height [m] at which each way begins, `rise` how much higher it is now; what they
    look at, where they look, see `_find_open_share`.
    """
    for i in range(len(begin)):
        z = begin[i] + rise
        # Without branches, so that a processor does many cells at once.
        stops = (top[i] > bed[i]) & (z >= underside[i]) & (z <= top[i])
        free_out[i] = ZERO if stops else free_out[i]
