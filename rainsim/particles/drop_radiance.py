"""The light of water in the air: what a drop shows of its surroundings, seen from anywhere.

A drop is a lens of short focus. A ray that meets it at the share r of its radius, at the angle
i = asin(r), is bent at both faces, by 2 (i - t) in all, sin(i) = n sin(t): a quarter of a drop's
disc shows what lies within 16 degrees of the line of sight behind it, half within 26, all within
83 (half of Garg and Nayar's 165 degrees, 2007, IJCV 75(1), section 3). So a drop is nearly as
bright as the mean of what lies far around and behind it, and hardly as what is right behind it:
before the sky it is as bright as the sky, before dark ground it still shows some sky. What a face
throws back comes from everywhere. Crowns and droplets of splashes are taken for drops, too.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.jit import serial_kernel
from rainsim.shading.environment import directions, sample_environment
from rainsim.shading.fresnel import fresnel

GRID = (7, 9)  # places over a picture, from edge to edge, between which the light is interpolated
RINGS, TURNS = 8, 12  # of a drop's disc, of equal area, and places on each

_RADIUS = np.sqrt((np.arange(RINGS) + 0.5) / RINGS)
_BEND = 2 * (np.arcsin(_RADIUS) - np.arcsin(_RADIUS / 1.333))
THROUGH = np.array([(1 - fresnel(math.sqrt(1 - r * r))) ** 2 for r in _RADIUS], np.float32)
BEND_COSINE, BEND_SINE = np.cos(_BEND).astype(np.float32), np.sin(_BEND).astype(np.float32)
_TURN = 2 * np.pi * (np.arange(TURNS) + 0.5) / TURNS
TURN_COSINE, TURN_SINE = np.cos(_TURN).astype(np.float32), np.sin(_TURN).astype(np.float32)


def mean_radiance(environment):
    """Return the mean of a map over all directions, float32 (3,)."""
    area = np.sqrt(1 - directions(*environment.shape[:2])[..., 2] ** 2)
    return (np.einsum("ij,ijc->c", area, environment) / area.sum()).astype(np.float32)


def drop_field(environment, everywhere, ground_from_camera, lens, width, height):
    """Return the radiance of drops over a camera's picture, float32 (7, 9, 3).

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
    """
    field = np.empty((*GRID, 3), np.float32)
    size = np.array([width, height], np.float32)
    _fill(environment, everywhere, ground_from_camera, lens, size, field)
    return field


def even(radiance):
    """Return the field of drops that are equally bright everywhere."""
    return np.tile(np.asarray(radiance, np.float32), (*GRID, 1))


@serial_kernel
def _fill(environment, everywhere, ground_from_camera, lens, size, field_out):
    """See `drop_field`; so little work that threads would take longer to start."""
    m = ground_from_camera
    rows, columns = field_out.shape[0], field_out.shape[1]
    for k in range(rows * columns):
        j, i = k // columns, k % columns
        a = (size[0] * np.float32(i) / np.float32(columns - 1) - lens[2]) / lens[0]
        b = (size[1] * np.float32(j) / np.float32(rows - 1) - lens[3]) / lens[1]
        inv = ONE / math.sqrt(ONE + a * a + b * b)
        # Across the line of sight (a, b, 1): two unit vectors of the camera frame.
        flat = ONE / math.sqrt(ONE + a * a)
        px, pz = flat, -a * flat
        qx, qy, qz = -a * b * flat * inv, (ONE + a * a) * flat * inv, -b * flat * inv
        r, g, bl = ZERO, ZERO, ZERO
        back = ZERO
        for ring in range(RINGS):
            c, s = BEND_COSINE[ring] * inv, BEND_SINE[ring]
            through = THROUGH[ring]
            back += ONE - through
            for turn in range(TURNS):
                p, q = s * TURN_COSINE[turn], s * TURN_SINE[turn]
                u, v, w = c * a + p * px + q * qx, c * b + q * qy, c + p * pz + q * qz
                e0, e1, e2 = sample_environment(
                    environment,
                    m[0, 0] * u + m[0, 1] * v + m[0, 2] * w,
                    m[1, 0] * u + m[1, 1] * v + m[1, 2] * w,
                    m[2, 0] * u + m[2, 1] * v + m[2, 2] * w,
                )  # fmt: skip
                r, g, bl = r + through * e0, g + through * e1, bl + through * e2
        back *= np.float32(TURNS)
        inv = ONE / np.float32(RINGS * TURNS)
        field_out[j, i, 0] = (r + back * everywhere[0]) * inv
        field_out[j, i, 1] = (g + back * everywhere[1]) * inv
        field_out[j, i, 2] = (bl + back * everywhere[2]) * inv
