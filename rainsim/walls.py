"""How wet walls and things are that are no level ground."""

from __future__ import annotations

import math

import numpy as np

from rainsim.jit import inlined_function
from rainsim.light import exp_minus, smoothstep

ZERO, QUARTER, HALF, ONE, TWO, THREE = (np.float32(v) for v in (0, 0.25, 0.5, 1, 2, 3))
FAINT = np.float32(0.04)  # of dampness, half of it either way: no eye sees it
WALL_SPRAY = np.float32(0.06)  # share of the rain that walls get which no drop meets
SOFFIT = np.float32(0.7)  # share of that which undersides do not get
LEANING = np.float32(0.1)  # cosine to the rain below which captured normals are mostly noise
FOOT_SHARE = np.float32(0.3)  # of the rain, that splashes back on the foot of what stands there
FOOT_STEEP = np.float32(1 / 0.15)  # 1/m: how soon that ends upwards; both by eye
PATHS_ACROSS, PATHS_DOWN = np.float32(1 / 0.07), np.float32(1 / 2.5)  # 1/m, of paths down a wall
STREAKS = np.float32(1.2)  # how much a half wet wall differs along them
STREAK_NEAR, STREAK_FAR = np.float32(8), np.float32(25)  # m, between which paths are seen less
UPRIGHT, SLOPING = np.float32(0.3), np.float32(0.6)  # cosines to the vertical: paths, and none
ONE_AXIS = np.float32(0.38)  # share of a normal below which an axis does not count


@inlined_function
def damp_off_ground(others, nx, ny, nz, x, y, z, height, far):
    """Return how wet a surface with the unit normal n at (x, y, z) is, 0 to 1, seen from `far` [m].

    It catches rain as it faces the slanting drops; walls that they miss get a little spray, and at
    their foot, `height` [m] over the ground, what splashes back. It all adds up to an even
    dampness; a wall that is not wet through differs along the paths in which its water runs down.
    """
    slant = -(nx * others[1] + ny * others[2])
    caught = max(nz + slant, ZERO)
    caught *= caught / (caught + LEANING)
    caught += WALL_SPRAY * (ONE + min(nz, ZERO) * SOFFIT)
    if nz > -HALF:
        caught += FOOT_SHARE * exp_minus(max(height, ZERO) * FOOT_STEEP)
    full = min(others[0] * caught, TWO)
    damp = full * (ONE - QUARTER * full)
    streaks = STREAKS * damp * (ONE - damp)
    if streaks < FAINT or far > STREAK_FAR or abs(nz) > SLOPING:
        return damp
    if far > STREAK_NEAR:  # paths are narrower than pixels there
        streaks *= ONE - smoothstep(STREAK_NEAR, STREAK_FAR, far)
    streaks *= ONE - smoothstep(UPRIGHT, SLOPING, abs(nz))
    # Across the wall: along the axis that it faces less, or a mix of both.
    square = nx * nx + ny * ny
    share = nx * nx / max(square, np.float32(1e-6))
    share = smoothstep(ONE_AXIS, ONE - ONE_AXIS, share)
    path, v = -HALF, z * PATHS_DOWN
    if share > ZERO:
        path += share * _lattice(y * PATHS_ACROSS, v)
    if share < ONE:
        path += (ONE - share) * _lattice(x * PATHS_ACROSS, v)
    return min(max(damp + streaks * path, ZERO), ONE)


@inlined_function
def _lattice(u, v):
    """Return smooth noise of 0 to 1: random numbers on a lattice."""
    i, j = math.floor(u), math.floor(v)
    a, b = u - np.float32(i), v - np.float32(j)
    a, b = a * a * (THREE - TWO * a), b * b * (THREE - TWO * b)
    i, j = int(i), int(j)
    low = _random(i, j) * (ONE - a) + _random(i + 1, j) * a
    high = _random(i, j + 1) * (ONE - a) + _random(i + 1, j + 1) * a
    return low * (ONE - b) + high * b


@inlined_function
def _random(i, j):
    h = (i * 374761393 + j * 668265263) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    return np.float32((h ^ (h >> 16)) & 0xFFFF) * np.float32(1 / 65535)
