"""How wet walls and things are that are no level ground."""

from __future__ import annotations

import math

import numpy as np

from rainsim.jit import device_function
from rainsim.light import smoothstep

ZERO, HALF, ONE, TWO, THREE = (np.float32(v) for v in (0, 0.5, 1, 2, 3))
WALL_SPRAY = np.float32(0.06)  # share of the rain that walls get which no drop meets
SOFFIT = np.float32(0.7)  # share of that which undersides do not get
STREAK_WIDTH, STREAK_LENGTH = np.float32(0.11), np.float32(1.7)  # m, of paths down a wall
STREAK_SOFT = np.float32(0.30)  # of the edge of a path
STREAK_NEAR, STREAK_FAR = np.float32(8), np.float32(25)  # m, between which paths are seen less


@device_function
def damp_off_ground(others, nx, ny, nz, x, y, z, far):
    """Return how wet a surface with the unit normal n at (x, y, z) is, 0 to 1, seen from `far` [m].

    It catches rain as it faces the slanting drops; walls that they miss get a little spray. A
    wall that is not wet through is wet in streaks, for what it catches runs down in paths.
    """
    slant = -(nx * others[1] + ny * others[2])
    caught = max(max(nz + slant, ZERO), WALL_SPRAY * (ONE + min(nz, ZERO) * SOFFIT))
    full = others[0] * caught
    if full >= ONE or nz > HALF:
        return min(full, ONE)
    # Across the wall: along the axis that it faces less; a normal's noise does not matter then.
    across = y if abs(nx) > abs(ny) else x
    path = _streak_noise(across / STREAK_WIDTH, z / STREAK_LENGTH)
    wet = smoothstep(
        path - STREAK_SOFT, path + STREAK_SOFT, full * (ONE + TWO * STREAK_SOFT) - STREAK_SOFT
    )
    # From afar paths are narrower than pixels.
    return wet + (full - wet) * smoothstep(STREAK_NEAR, STREAK_FAR, far)


@device_function
def _streak_noise(u, v):
    """Return smooth noise of 0 to 1: octaves of random numbers on a lattice."""
    return (TWO * _lattice(u, v) + _lattice(u * THREE + HALF, v * TWO)) / THREE


@device_function
def _lattice(u, v):
    i, j = math.floor(u), math.floor(v)
    a, b = u - np.float32(i), v - np.float32(j)
    a, b = a * a * (THREE - TWO * a), b * b * (THREE - TWO * b)
    i, j = int(i), int(j)
    low = _random(i, j) * (ONE - a) + _random(i + 1, j) * a
    high = _random(i, j + 1) * (ONE - a) + _random(i + 1, j + 1) * a
    return low * (ONE - b) + high * b


@device_function
def _random(i, j):
    h = (i * 374761393 + j * 668265263) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    return np.float32((h ^ (h >> 16)) & 0xFFFF) * np.float32(1 / 65535)
