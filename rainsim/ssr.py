"""Screen-space reflection: march the mirrored ray through the picture's own depth.

McGuire and Mara 2014 (JCGT 3(4)): a ray that is straight in space is straight in the picture, and
1/z is linear along it, so the march visits each pixel once, perspective-correct. Two things differ
from the paper (RainyGS): a hit is an overlap of depth intervals with a thickness in metres, not a
point within an epsilon, so that a fast ray cannot step through a surface; and the end of the ray
is bisected. Where nothing within some pixels is as near as the ray, the march jumps over them.
"""

from __future__ import annotations

import numpy as np

from rainsim.jit import cpu_kernel, device_function, prange

ZERO = np.float32(0)
ONE = np.float32(1)
HALF = np.float32(0.5)
NEAR = np.float32(0.05)  # m: a ray that comes towards the camera ends here
# px: no surface hits itself; and rays start in the middle of a pixel, many go straight up, so that
# with whole steps rounding would choose the pixel at every step or halving.
FIRST_STEP = np.float32(1 + 1 / 32)
BISECTIONS = 4
BLOCK = 16  # px, side of the blocks whose least depth lets a march jump
JUMP = np.float32(15)  # px: a march that is in a block stays in its neighbours so far
PLAIN_STEPS = 4  # that are taken where something is near, before a jump is tried again


def blocks_of(height, width):
    """Return how many rows and columns of blocks cover a picture, see `nearest_blocks`."""
    return -(-height // BLOCK), -(-width // BLOCK)


@cpu_kernel
def nearest_blocks(depth, near_out):
    """Write the least depth of each block and its eight neighbours, for `march`.

    Parameters
    ----------
    depth : ndarray of shape (height, width), float32 [m]
    near_out : ndarray of shape `blocks_of(height, width)`, float32 [m]
    """
    height, width = depth.shape
    rows, columns = near_out.shape
    least = np.empty((rows, columns), np.float32)
    for j in prange(rows):
        least[j] = np.inf
        for row in range(j * BLOCK, min(j * BLOCK + BLOCK, height)):
            for i in range(columns):
                for column in range(i * BLOCK, min(i * BLOCK + BLOCK, width)):
                    least[j, i] = min(least[j, i], depth[row, column])
    for j in prange(rows):
        for i in range(columns):
            near_out[j, i] = least_around(least, j, i)


@device_function
def least_around(least, j, i):
    """Return the least of a block and its eight neighbours."""
    rows, columns = least.shape
    found = least[j, i]
    for m in range(max(j - 1, 0), min(j + 2, rows)):
        for k in range(max(i - 1, 0), min(i + 2, columns)):
            found = min(found, least[m, k])
    return found


@device_function
def march(depth, near, lens, x, y, z, dx, dy, dz, thickness, stride, farthest):
    """Find where a ray first meets the picture.

    Steps are counted in pixels from the ray's start: u, v and 1/z are linear in them. So a step is
    known to a few millionths of a pixel, and every machine visits the same pixels.

    Parameters
    ----------
    depth : ndarray of shape (height, width), float32 [m]
        Depth along the camera's z axis; infinite where nothing can be hit.
    near : ndarray of shape `blocks_of(height, width)`, float32 [m]
        See `nearest_blocks`; only saves time.
    lens : ndarray of shape (4,), float32
        fx, fy, cx, cy [px].
    x, y, z, dx, dy, dz : float32
        Origin [m] and unit direction in the camera frame.
    thickness : float32 [m]
        How far behind its depth a surface still stops a ray.
    stride : float32 [px]
    farthest : float32 [m]
        Length of ray that is searched.

    Returns
    -------
    distance : float32 [m]
        Along the ray; negative if nothing was met within the picture.
    """
    height, width = depth.shape
    w, h = np.float32(width), np.float32(height)
    iz = ONE / z
    # At length s, with q = s / (z (z + s dz)), the picture shows the ray (du, dv) q from its start.
    du, dv = lens[0] * (dx * z - x * dz), lens[1] * (dy * z - y * dz)
    far = z + dz * farthest
    length = farthest * iz / far
    if far < NEAR:
        length = (iz - ONE / NEAR) / dz
    span = max(abs(du), abs(dv))
    end = span * length  # px
    if not end >= ONE:
        return -ONE
    inv = ONE / span
    du, dv, diz = du * inv, dv * inv, -dz * inv
    u0, v0 = lens[0] * x * iz + lens[2], lens[1] * y * iz + lens[3]
    if du > ZERO:
        end = min(end, (w - u0) / du)
    elif du < ZERO:
        end = min(end, -u0 / du)
    if dv > ZERO:
        end = min(end, (h - v0) / dv)
    elif dv < ZERO:
        end = min(end, -v0 / dv)
    jump = int(JUMP / stride)
    before = ONE / (iz + diz * FIRST_STEP)
    step, stay = 1, 0
    while True:
        t = FIRST_STEP + stride * np.float32(step)
        if not t < end:
            return -ONE
        i, j = int(u0 + du * t), int(v0 + dv * t)
        if i < 0 or j < 0 or i >= width or j >= height:
            return -ONE
        if stay <= 0 and jump > 1:
            last = ONE / (iz + diz * (t + stride * np.float32(jump - 1)))
            # Beyond the ray's end 1 / z may have passed through zero.
            if last > ZERO and max(before, last) < near[j // BLOCK, i // BLOCK]:
                before = last
                step += jump
                continue
            stay = PLAIN_STEPS
        now = ONE / (iz + diz * t)
        low, high = min(before, now), max(before, now)
        surface = depth[j, i]
        if high >= surface and low <= surface + thickness:
            break
        before = now
        step += 1
        stay -= 1
    a, b = t - stride, t
    for _ in range(BISECTIONS):
        middle = HALF * (a + b)
        i, j = int(u0 + du * middle), int(v0 + dv * middle)
        if ONE / (iz + diz * middle) >= depth[j, i]:
            b = middle
        else:
            a = middle
    return b * inv * z / (iz + diz * b)


@device_function
def edge_fade(u, v, width, height, share):
    """Return 1 inside the picture, falling to 0 at its edge within `share` of its size."""
    from_side = min(u, np.float32(width) - u) / (share * np.float32(width))
    from_end = min(v, np.float32(height) - v) / (share * np.float32(height))
    return min(max(min(from_side, from_end), ZERO), ONE)
