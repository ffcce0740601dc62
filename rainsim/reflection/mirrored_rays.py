"""The rays that a pixel of water mirrors: one for each of the slopes in it, see `facets`.

Where the mirrored picture can be blurred, the slopes are drawn together and each is looked up in a
picture blurred for the slopes between them.
"""

import numpy as np

from rainsim.constants import ONE, TWO, ZERO
from rainsim.jit import inlined_function
from rainsim.reflection.facets import LEAST_COSINE, RADIUS, normal_of, sample_slopes, view_cosine
from rainsim.scene.view import camera_component

ENVIRONMENT, SCREEN, MIRROR = 0, 1, 2  # where mirrored light was found

SPREAD = np.float32(1.25 / RADIUS)  # of samples in a blurred picture, over that; see docs/light.md
# Deviation of the slopes that each of those samples stands for, so that the variances add up to 1.
BLUR = np.float32(np.sqrt(1 - SPREAD**2))


@inlined_function
def sample_ray(water, a, b, c, sample):
    """Return the unit mirrored ray of one of the slopes in a pixel, see `slope_samples`."""
    gx, gy = sample_slopes(water, a, b, c, sample)
    ux, uy, uz = normal_of(gx, gy)
    return reflected_upwards(water.view_x, water.view_y, water.view_z, ux, uy, uz)


@inlined_function
def reflected_upwards(vx, vy, vz, ux, uy, uz):
    """Return the unit view direction v mirrored at the unit normal u, turned up if it goes down.

    A ripple that faces so far away that its mirrored ray goes down mirrors the ripple before it,
    which mirrors the low sky.
    """
    dot = TWO * (vx * ux + vy * uy + vz * uz)
    rx, ry, rz = vx - dot * ux, vy - dot * uy, vz - dot * uz
    if rz < LEAST_COSINE:
        rz = LEAST_COSINE
        inv = ONE / np.sqrt(rx * rx + ry * ry + rz * rz)
        rx, ry, rz = rx * inv, ry * inv, rz * inv
    return rx, ry, rz


@inlined_function
def sample_blur(view, water):
    """Return how much to blur a mirrored picture of the far for one sample [px].

    The standard deviation along one axis, a mean over the axes. A normal that moves by a solid
    angle w moves the mirrored ray by 4 cos w, cos the cosine of the angle between normal and ray;
    and a solid angle w covers fx fy w / g^3 of the picture, g the cosine of the ray's angle to the
    view axis.

    view : View. Of the mirrored camera.
    water : WaterPixel
    """
    ux, uy, uz = normal_of(water.slope_x, water.slope_y)
    rx, ry, rz = reflected_upwards(water.view_x, water.view_y, water.view_z, ux, uy, uz)
    cosine = view_cosine(water, ux, uy, uz)
    g = max(camera_component(view, 2, rx, ry, rz), np.float32(0.1))
    area = np.float32(4) * cosine * uz * uz * uz * view.fx * view.fy / (g * g * g)
    determinant = water.variance_x * water.variance_y - water.covariance * water.covariance
    return BLUR * np.sqrt(area * np.sqrt(max(determinant, ZERO)))
