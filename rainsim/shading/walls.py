"""How wet walls and things are: all surfaces that are no mapped ground."""

import math

import numpy as np

from rainsim.constants import HALF, ONE, THREE, TWO, ZERO
from rainsim.jit import inlined_function
from rainsim.numerics.approximations import exp_minus
from rainsim.numerics.interpolation import smoothstep

QUARTER = np.float32(0.25)
# Cosines of normals to the vertical between which a surface gets wet: captured walls lean by up to
# the first where they are plain, a roof of 45 degrees catches all. Rough surfaces have facets of
# many slopes, so there is no edge between; nor has the cosine of a wall to the rain's slant.
LEANING, PITCHED, FACING = np.float32(0.2), np.float32(0.7), np.float32(0.4)
LEAF_WET = HALF  # of a leaf: it has two sides, and rain wets the upper one
UNDER_LOW, UNDER_HIGH = np.float32(-0.8), np.float32(-0.2)  # cosines of undersides, of sides
# Of the rain, what splashes back on the foot of a wall, and its decay upwards [1/m]. An estimate: a
# tenth of the rain is thrown 10 cm, half of it away from the wall, and lands on 8 cm of height.
FOOT_SHARE, FOOT_STEEP = np.float32(0.03), np.float32(1 / 0.08)
RUN_OFF = np.float32(0.3)  # of the rain, that runs down the sides of a smooth body; by eye
PATHS_ACROSS, PATHS_DOWN = np.float32(1 / 0.07), np.float32(1 / 2.5)  # 1/m, of paths down a wall
PATHS = np.float32(1.2)  # variation of the dampness of a half wet wall along its paths
FAINT = np.float32(0.04)  # variation of dampness that no eye sees
PATH_NEAR, PATH_FAR = np.float32(8), np.float32(25)  # m, between which paths fade out
UPRIGHT, SLOPING = np.float32(0.3), np.float32(0.6)  # cosines to the vertical: paths, no paths
ONE_AXIS = np.float32(0.38)  # share of a normal's square below which an axis does not count


@inlined_function
def _damp_of(supply):
    """Return the dampness of a surface that has got so many full films of rain."""
    full = min(supply, TWO)
    return full * (ONE - QUARTER * full)


@inlined_function
def damp_off_ground(rain, point, height, body):
    """Return the dampness of a surface that is no mapped ground, 0 dry to 1 wet through.

    A surface catches rain as it faces the slanting drops; the foot of a wall gets what splashes
    back from the ground, and the sides of smooth bodies get what runs down them. Walls in the lee,
    and all walls in calm air, stay dry above that. The sum is an even dampness. A wall that is not
    wet through varies along the paths of the water that runs down.

    rain : wetness.OffGroundWetness
    point : surface_point.SurfacePoint. Its distance decides whether the paths are
        seen.
    height : float32 [m]. Over the ground.
    body : float32. How surely it belongs to a smooth body, see `bodies`.
    """
    nx, ny, nz, far = point.nx, point.ny, point.nz, point.distance
    slant = -(nx * rain.slant_x + ny * rain.slant_y)
    level = smoothstep(LEANING, PITCHED, nz + min(slant, ZERO))
    upright = nz if nz > ZERO else min(nz + LEANING, ZERO)  # what leans over a little is a wall
    share = max(level, smoothstep(ZERO, FACING, slant + min(upright, ZERO)))
    damp = share * _damp_of(rain.supply * max(upright + slant, ZERO))
    if nz > UNDER_LOW:  # undersides get neither; normals of haze are noise, so the edge is soft
        splashed = FOOT_SHARE * exp_minus(max(height, ZERO) * FOOT_STEEP)
        foot, sides = _damp_of(rain.supply * splashed), body * _damp_of(rain.supply * RUN_OFF)
        damp = max(damp, max(foot, sides) * smoothstep(UNDER_LOW, UNDER_HIGH, nz))
    variation = PATHS * damp * (ONE - damp)
    if variation < FAINT or far > PATH_FAR or abs(nz) > SLOPING:
        return damp
    if far > PATH_NEAR:  # farther paths are narrower than pixels
        variation *= ONE - smoothstep(PATH_NEAR, PATH_FAR, far)
    variation *= ONE - smoothstep(UPRIGHT, SLOPING, abs(nz))
    # Paths are numbered across the wall: along the axis that it faces less, or by both mixed.
    square = nx * nx + ny * ny
    share = nx * nx / max(square, np.float32(1e-6))
    share = smoothstep(ONE_AXIS, ONE - ONE_AXIS, share)
    path, v = -HALF, point.z * PATHS_DOWN
    if share > ZERO:
        path += share * _lattice(point.y * PATHS_ACROSS, v)
    if share < ONE:
        path += (ONE - share) * _lattice(point.x * PATHS_ACROSS, v)
    return min(max(damp + variation * path, ZERO), ONE)


@inlined_function
def damp_leaf(rain):
    """Return the dampness of leaves, which lie at all angles: their normals do not tell it."""
    return LEAF_WET * _damp_of(rain.supply)


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
    """Return a random number of 0 to 1 for a lattice point."""
    h = (i * 374761393 + j * 668265263) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    return np.float32((h ^ (h >> 16)) & 0xFFFF) * np.float32(1 / 65535)
