"""The light of water in the air: the surroundings that a drop shows, seen from anywhere.

A drop is a lens of short focus. A ray that meets it at the share r of its radius, at the angle
i = asin(r), is bent at both faces, by 2 (i - t) in all, sin(i) = n sin(t): a quarter of a drop's
disc shows what lies within 16 degrees of the line of sight behind it, half within 26, all within
83 (half of Garg and Nayar's 165 degrees, 2007, IJCV 75(1), section 3). So a drop is nearly as
bright as the mean of what lies far around and behind it, and hardly as what is right behind it:
before the sky it is as bright as the sky, before dark ground it still shows some sky. What a face
throws back comes from everywhere.

Where a drop hangs decides what it shows: under a table it shows legs and paving. The frame's own
picture and its depth, coarsened, tell where a ray that leaves the drop ends; rays that leave the
picture show the surroundings of the first camera. The drops of a pixel hang at all depths; they
count as halfway to what the pixel shows.

Half of a splash is taken for drops: its rim and droplets. The other half is sheets, whose faces
stand up: seen from the side they mirror and let through the light of the sky and of all around,
seen from above the dark ground beside them.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import cpu_kernel, inlined_function, prange, serial_kernel
from rainsim.numerics.interpolation import bilinear, bilinear_color
from rainsim.shading.environment import directions, sample_environment
from rainsim.shading.fresnel import fresnel

GRID = (9, 13)  # places over a picture, from edge to edge, between which the light is interpolated
CELLS = (20, 30)  # of the coarse picture that rays from drops end in; finer ones gain nothing
MIDST = np.float32(4.0)  # m, mean depth of drops before what is far: they are drawn up to 8 m
AHEAD = np.float32(0.05)  # cosine to the view axis from which on a ray may end in the picture
# Of the light of a splash's sheets: what makes the drawn splash add as much light as path-traced
# crowns do, seen 8 to 75 degrees from above. Six of them, 3 to 9 ms old, of drops of 2.5 and 4 mm,
# over beds from a thirtieth to a third as bright as the zenith
# (tests/particles/test_mitsuba_rain.py).
SEEN_LEVEL, SEEN_ABOVE = np.float32(1.09), np.float32(0.96)
RINGS, TURNS = 8, 12  # of a drop's disc, of equal area, and places on each

_RADIUS = np.sqrt((np.arange(RINGS) + 0.5) / RINGS)
_BEND = 2 * (np.arcsin(_RADIUS) - np.arcsin(_RADIUS / 1.333))
THROUGH = np.array([(1 - fresnel(math.sqrt(1 - r * r))) ** 2 for r in _RADIUS], np.float32)
THROWN_BACK = np.float32(np.mean(1 - THROUGH))  # share of the light that a drop's face throws back
BEND_COSINE, BEND_SINE = np.cos(_BEND).astype(np.float32), np.sin(_BEND).astype(np.float32)
_TURN = 2 * np.pi * (np.arange(TURNS) + 0.5) / TURNS
TURN_COSINE, TURN_SINE = np.cos(_TURN).astype(np.float32), np.sin(_TURN).astype(np.float32)


def mean_radiance(environment):
    """Return the mean of a map over all directions, float32 (3,)."""
    area = np.sqrt(1 - directions(*environment.shape[:2])[..., 2] ** 2)
    return (np.einsum("ij,ijc->c", area, environment) / area.sum()).astype(np.float32)


class Behind(NamedTuple):
    """The scene that a camera sees behind its drops, in `CELLS` cells; read-only."""

    radiance: np.ndarray  # (20, 30, 3) float32, mean of each cell
    nearness: np.ndarray  # (20, 30) float32 [1/m], mean of one over the depth


def falling_light(environment, everywhere, ground_from_camera, lens, picture, depth):
    """Return the radiance of drops and of the sheets of splashes over a camera's picture.

    At places from edge to edge; between them it is interpolated, see `shading.composite.compose`.

    environment : float32 array (rows, columns, 3). What lies around, blurred by
        some degrees: it is sampled sparsely.
    everywhere : float32 array (3,). Its mean, see `mean_radiance`.
    ground_from_camera : float32 array (3, 3)
    lens : float32 array (4,) [px]
    picture : float32 array (height, width, 3). Radiance of what the camera sees
        without rain.
    depth : float32 array (height, width) [m]
    Returns drops, sheets : float32 array (9, 13, 3)
    """
    behind = Behind(np.empty((*CELLS, 3), np.float32), np.empty(CELLS, np.float32))
    _coarsen(picture, depth, *behind)
    return light_before(behind, environment, everywhere, ground_from_camera, lens, depth.shape)


def light_before(behind, environment, everywhere, ground_from_camera, lens, shape):
    """Return what `falling_light` does before a `Behind` of a picture (height, width)."""
    drops, sheets = np.empty((2, *GRID, 3), np.float32)
    size = np.array(shape[::-1], np.float32)
    _fill(environment, behind, everywhere, ground_from_camera, lens, size, drops, sheets)
    return drops, sheets


def even(radiance):
    """Return the field of drops that are equally bright everywhere."""
    return np.tile(np.asarray(radiance, np.float32), (*GRID, 1))


@inlined_function
def line_of_sight(lens, size, j, i):
    """Return the line of sight (a, b, 1) at a place of the grid, and one over its length."""
    rows, columns = GRID
    a = (size[0] * np.float32(i) / np.float32(columns - 1) - lens[2]) / lens[0]
    b = (size[1] * np.float32(j) / np.float32(rows - 1) - lens[3]) / lens[1]
    return a, b, ONE / math.sqrt(ONE + a * a + b * b)


@inlined_function
def sheet_light(m, sight, drop, everywhere):
    """Return one channel of the radiance of the sheets of splashes along a line of sight.

    Between that of drops and the mean of all around: the share of the mean falls from SEEN_LEVEL by
    SEEN_ABOVE with the sine of the angle at which a splash is seen from above.

    m : array of shape (3, 3), float32. See `refracted`, as for `sight`.
    sight
    drop, everywhere : float32. Radiance of drops there, and the mean.
    """
    a, b, inv = sight
    sine = min(max(-(m[2, 0] * a + m[2, 1] * b + m[2, 2]) * inv, ZERO), ONE)
    return drop + (SEEN_LEVEL - SEEN_ABOVE * sine) * (everywhere - drop)


@inlined_function
def cell_edges(number, cells, pixels):
    """Return the first pixel of a cell and the one after its last; no cell is empty."""
    first = number * pixels // cells
    return first, max((number + 1) * pixels // cells, first + 1)


@inlined_function
def cell_place(a, b, lens, size):
    """Return the column and row of the coarse picture, cells whole, where tangents (a, b) lie."""
    rows, columns = CELLS
    u = (a * lens[0] + lens[2]) / size[0] * np.float32(columns)
    v = (b * lens[1] + lens[3]) / size[1] * np.float32(rows)
    return u, v


@inlined_function
def drop_depth(nearness, sight, lens, size):
    """Return the depth [m] at which the drops before a place of the grid count as hanging."""
    u, v = cell_place(sight[0], sight[1], lens, size)
    return HALF / max(bilinear(nearness, u - HALF, v - HALF), HALF / MIDST)


@inlined_function
def ray_end(nearness, sight, lens, size, z, u, v, w):
    """Return where in the coarse picture a ray ends, and whether it does at all.

    The ray leaves a drop at depth z on the line of sight `sight` in the direction (u, v, w) of
    the camera frame. Were what it meets infinitely far, it would end where (u, v, w) vanishes; how
    near that place is says by which share of the way to it the ray comes.
    """
    a, b = sight[0], sight[1]
    w = max(w, AHEAD)
    x, y = u / w, v / w
    column, row = cell_place(x, y, lens, size)
    share = max(ONE - z * bilinear(nearness, column - HALF, row - HALF), ZERO)
    column, row = cell_place(a + (x - a) * share, b + (y - b) * share, lens, size)
    rows, columns = CELLS
    ends = w > AHEAD and ZERO < column < np.float32(columns) and ZERO < row < np.float32(rows)
    return column, row, ends


@inlined_function
def refracted(environment, behind, m, lens, size, sight, z, ring, turn):
    """Return the light (r, g, b) that leaves a drop's disc at a ring and a turn of it.

    `m` is ground_from_camera, `sight` the drop's `line_of_sight`, z its `drop_depth` [m].
    """
    a, b, inv = sight
    # Across the line of sight: two unit vectors of the camera frame.
    flat = ONE / math.sqrt(ONE + a * a)
    px, pz = flat, -a * flat
    qx, qy, qz = -a * b * flat * inv, (ONE + a * a) * flat * inv, -b * flat * inv
    c, s, through = BEND_COSINE[ring] * inv, BEND_SINE[ring], THROUGH[ring]
    p, q = s * TURN_COSINE[turn], s * TURN_SINE[turn]
    u, v, w = c * a + p * px + q * qx, c * b + q * qy, c + p * pz + q * qz
    column, row, ends = ray_end(behind.nearness, sight, lens, size, z, u, v, w)
    if ends:
        red, green, blue = bilinear_color(behind.radiance, column, row)
    else:
        red, green, blue = sample_environment(
            environment,
            m[0, 0] * u + m[0, 1] * v + m[0, 2] * w,
            m[1, 0] * u + m[1, 1] * v + m[1, 2] * w,
            m[2, 0] * u + m[2, 1] * v + m[2, 2] * w,
        )
    return through * red, through * green, through * blue


@cpu_kernel
def _coarsen(picture, depth, radiance_out, nearness_out):
    """Write mean radiance and mean nearness [1/m] of each cell, see `Behind`."""
    height, width = depth.shape
    rows, columns = CELLS
    for j in prange(rows):
        top, end = cell_edges(j, rows, height)
        for i in range(columns):
            left, right = cell_edges(i, columns, width)
            red, green, blue, near = ZERO, ZERO, ZERO, ZERO
            for row in range(top, end):
                for column in range(left, right):
                    red += picture[row, column, 0]
                    green += picture[row, column, 1]
                    blue += picture[row, column, 2]
                    near += ONE / depth[row, column]
            share = ONE / np.float32((end - top) * (right - left))
            radiance_out[j, i, 0] = red * share
            radiance_out[j, i, 1] = green * share
            radiance_out[j, i, 2] = blue * share
            nearness_out[j, i] = near * share


@serial_kernel
def _fill(environment, behind, everywhere, ground_from_camera, lens, size, drops_out, sheets_out):
    """See `falling_light`; so little work that threads would take longer to start."""
    rows, columns = GRID
    share = ONE / np.float32(RINGS * TURNS)
    for k in range(rows * columns):
        j, i = k // columns, k % columns
        sight = line_of_sight(lens, size, j, i)
        z = drop_depth(behind.nearness, sight, lens, size)
        red, green, blue = ZERO, ZERO, ZERO
        for ring in range(RINGS):
            for turn in range(TURNS):
                light = refracted(
                    environment, behind, ground_from_camera, lens, size, sight, z, ring, turn
                )
                red, green, blue = red + light[0], green + light[1], blue + light[2]
        drops_out[j, i, 0] = red * share + THROWN_BACK * everywhere[0]
        drops_out[j, i, 1] = green * share + THROWN_BACK * everywhere[1]
        drops_out[j, i, 2] = blue * share + THROWN_BACK * everywhere[2]
        for c in range(3):
            sheets_out[j, i, c] = sheet_light(
                ground_from_camera, sight, drops_out[j, i, c], everywhere[c]
            )
