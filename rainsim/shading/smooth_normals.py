"""Normals of a neighbourhood: how things lie to the rain, and which way they mirror.

A pixel's own normal is that of a few captured splats and may be off by tens of degrees: on a steep
panel one pixel would be wet beside a dry one. The mean over some centimetres of the same surface is
surer. Ground and leaves keep the normals of their pixels: the ground's map says how wet it is, and
each leaf mirrors by itself.
"""

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.jit import inlined_function, lean_function

AROUND = np.float32(0.05)  # m, radius of the neighbourhood
NO_AROUND = np.float32(0)  # of pictures and rays that keep their own normals: all that is mirrored
STEEPEST = np.float32(2)  # m of depth per m across, beyond which a pixel shows another surface
STEPS = 4  # radii there are: 2, 4, 8 and 16 px
SAMPLES = 9  # pixels that count: the middle and eight around it
EACH = np.float32(1 / SAMPLES)


@inlined_function
def step_of(focal, around, depth):
    """Return which of the STEPS the radius `around` is at a depth, from 0 on; `focal` in px."""
    radius = focal * around / depth
    return int(radius > np.float32(3)) + int(radius > np.float32(6)) + int(radius > np.float32(12))


@inlined_function
def sharpness(focal, step, depth):
    """Return one over the depth by which a pixel of the same surface differs at most."""
    return focal / (STEEPEST * np.float32(2 << step) * depth)


@inlined_function
def likeness(depth, here, sharp):
    """Return the weight of a pixel's normal: 1 at a depth of `here`, 0 from 1 / `sharp` off it."""
    away = (depth - here) * sharp
    return max(ONE - away * away, ZERO)


@inlined_function
def sample(k, step):
    """Return columns and rows [px] from the middle of a neighbourhood to its pixel k."""
    if k < 4:
        x, y = 2 * (k & 1) - 1, (k & 2) - 1
    elif k < 6:
        x, y = 4 * (k & 1) - 2, 0
    else:
        x, y = 0, 4 * (k & 1) - 2
    return (x << step, y << step) if k < 8 else (0, 0)


@inlined_function
def turn_of(m):
    """Return the numbers of a matrix (3, 3): loops that write to arrays keep them in registers."""
    return m[0, 0], m[0, 1], m[0, 2], m[1, 0], m[1, 1], m[1, 2], m[2, 0], m[2, 1], m[2, 2]


@inlined_function
def turned(turn, x, y, z):
    """Return the vector (x, y, z) turned by a matrix of which `turn_of` made the numbers."""
    return (
        turn[0] * x + turn[1] * y + turn[2] * z, turn[3] * x + turn[4] * y + turn[5] * z,
        turn[6] * x + turn[7] * y + turn[8] * z,
    )  # fmt: skip


@lean_function
def smooth_normal(depth, normal, row, column, rows, columns, focal, around):
    """Return the mean normal around a pixel that shows a surface, in the camera's frame.

    The pixel and eight others around it count, the less the more their depths differ.

    depth : float32 array (height, width) [units]
    normal : float32 array (height, width, 3). Unit, in the camera's frame.
    row, column : int
    rows, columns : int. Of the part of the picture that was drawn.
    focal : float32 [px]
    around : float32 [units]. Radius of the neighbourhood.
    Returns x, y, z : float32. Shorter than 1 where they differ, and at the edges
        of surfaces.
    """
    here = depth[row, column]
    step = step_of(focal, around, here)
    sharp = sharpness(focal, step, here)
    x, y, z = ZERO, ZERO, ZERO
    for k in range(SAMPLES):
        across, down = sample(k, step)
        v = min(max(row + down, 0), rows - 1)
        u = min(max(column + across, 0), columns - 1)
        weight = likeness(depth[v, u], here, sharp)
        x += weight * normal[v, u, 0]
        y += weight * normal[v, u, 1]
        z += weight * normal[v, u, 2]
    return x * EACH, y * EACH, z * EACH
