"""The light of water in the air: what a drop shows of its surroundings, seen from anywhere.

A drop is a lens of short focus. A ray that meets it at the share r of its radius, at the angle
i = asin(r), is bent at both faces, by 2 (i - t) in all, sin(i) = n sin(t): a quarter of a drop's
disc shows what lies within 16 degrees of the line of sight behind it, half within 26, all within
83 (half of Garg and Nayar's 165 degrees, 2007, IJCV 75(1), section 3). So a drop is nearly as
bright as the mean of what lies far around and behind it, and hardly as what is right behind it:
before the sky it is as bright as the sky, before dark ground it still shows some sky. What a face
throws back comes from everywhere.

Half of a splash is taken for drops: its rim and droplets. The other half is sheets, whose faces
stand up: seen from the side they mirror and let through the light of the sky and of all around,
seen from above the dark ground beside them.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.jit import inlined_function, serial_kernel
from rainsim.shading.environment import directions, sample_environment
from rainsim.shading.fresnel import fresnel

GRID = (7, 9)  # places over a picture, from edge to edge, between which the light is interpolated
# Of the light of a splash's sheets: what makes the drawn splash add as much light as path-traced
# crowns do, seen 8 to 75 degrees from above. Six of them, 3 to 9 ms old, of drops of 2.5 and 4 mm,
# over beds from a thirtieth to a third as bright as the zenith; see tests/unit/test_mitsuba_rain.
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


def falling_light(environment, everywhere, ground_from_camera, lens, width, height):
    """Return the radiance of drops and of the sheets of splashes over a camera's picture.

    At places from edge to edge; between them it is interpolated, see `shading.composite.compose`.

    Parameters
    ----------
    environment : ndarray of shape (rows, columns, 3), float32
        What lies around, blurred by some degrees: it is sampled sparsely.
    everywhere : ndarray of shape (3,), float32
        Its mean, see `mean_radiance`.
    ground_from_camera : ndarray of shape (3, 3), float32
    lens : ndarray of shape (4,), float32 [px]
    width, height : int [px]

    Returns
    -------
    drops, sheets : ndarray of shape (7, 9, 3), float32
    """
    drops, sheets = np.empty((2, *GRID, 3), np.float32)
    size = np.array([width, height], np.float32)
    _fill(environment, everywhere, ground_from_camera, lens, size, drops, sheets)
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

    Parameters
    ----------
    m : array of shape (3, 3), float32
        See `refracted`, as for `sight`.
    sight
    drop, everywhere : float32
        Radiance of drops there, and the mean.
    """
    a, b, inv = sight
    sine = min(max(-(m[2, 0] * a + m[2, 1] * b + m[2, 2]) * inv, ZERO), ONE)
    return drop + (SEEN_LEVEL - SEEN_ABOVE * sine) * (everywhere - drop)


@inlined_function
def refracted(environment, m, sight, ring, turn):
    """Return the light (r, g, b) that leaves a drop's disc at a ring and a turn of it.

    `m` is ground_from_camera, `sight` the drop's `line_of_sight`.
    """
    a, b, inv = sight
    # Across the line of sight: two unit vectors of the camera frame.
    flat = ONE / math.sqrt(ONE + a * a)
    px, pz = flat, -a * flat
    qx, qy, qz = -a * b * flat * inv, (ONE + a * a) * flat * inv, -b * flat * inv
    c, s, through = BEND_COSINE[ring] * inv, BEND_SINE[ring], THROUGH[ring]
    p, q = s * TURN_COSINE[turn], s * TURN_SINE[turn]
    u, v, w = c * a + p * px + q * qx, c * b + q * qy, c + p * pz + q * qz
    red, green, blue = sample_environment(
        environment,
        m[0, 0] * u + m[0, 1] * v + m[0, 2] * w,
        m[1, 0] * u + m[1, 1] * v + m[1, 2] * w,
        m[2, 0] * u + m[2, 1] * v + m[2, 2] * w,
    )
    return through * red, through * green, through * blue


@serial_kernel
def _fill(environment, everywhere, ground_from_camera, lens, size, drops_out, sheets_out):
    """See `falling_light`; so little work that threads would take longer to start."""
    rows, columns = GRID
    share = ONE / np.float32(RINGS * TURNS)
    for k in range(rows * columns):
        j, i = k // columns, k % columns
        sight = line_of_sight(lens, size, j, i)
        red, green, blue = ZERO, ZERO, ZERO
        for ring in range(RINGS):
            for turn in range(TURNS):
                light = refracted(environment, ground_from_camera, sight, ring, turn)
                red, green, blue = red + light[0], green + light[1], blue + light[2]
        drops_out[j, i, 0] = red * share + THROWN_BACK * everywhere[0]
        drops_out[j, i, 1] = green * share + THROWN_BACK * everywhere[1]
        drops_out[j, i, 2] = blue * share + THROWN_BACK * everywhere[2]
        for c in range(3):
            sheets_out[j, i, c] = sheet_light(
                ground_from_camera, sight, drops_out[j, i, c], everywhere[c]
            )
