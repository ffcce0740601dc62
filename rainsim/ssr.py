"""Screen-space reflection: march the mirrored ray through the picture's own depth.

McGuire and Mara 2014 (JCGT 3(4)): a ray that is straight in space is straight in the picture, and
1/z is linear along it, so the march visits each pixel once, perspective-correct. Two things differ
from the paper (RainyGS): a hit is an overlap of depth intervals with a thickness in metres, not a
point within an epsilon, so that a fast ray cannot step through a surface; and the end of the ray
is bisected. Where a ray passes before or behind all that some pixels show, it jumps over them.
"""

from __future__ import annotations

import math

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
BLOCK_BITS = np.uint32(3)
BLOCK = 8  # px, side of the blocks whose depths let a march jump
JUMP = np.float32(7)  # px: two places no farther apart lie in one block or in neighbours
PLAIN_STEPS = 8  # that are taken where a jump was not possible, before another is tried


def bounds_of(height, width):
    """Return the shape of a picture's `bounds_out`, see `block_bounds`."""
    return -(-height // BLOCK), -(-width // BLOCK), 2


@cpu_kernel
def block_bounds(depth, bounds_out):
    """Write the least and the greatest depth of each block of pixels, for `march`.

    Parameters
    ----------
    depth : ndarray of shape (height, width), float32 [m]
        Infinite where nothing can be hit: that does not count.
    bounds_out : ndarray of shape `bounds_of(height, width)`, float32 [m]
    """
    height, width = depth.shape
    rows, columns, _ = bounds_out.shape
    for j in prange(rows):
        for i in range(columns):
            low, high = np.float32(np.inf), np.float32(-np.inf)
            for row in range(j * BLOCK, min(j * BLOCK + BLOCK, height)):
                for column in range(i * BLOCK, min(i * BLOCK + BLOCK, width)):
                    value = depth[row, column]
                    if value < np.float32(np.inf):
                        low, high = min(low, value), max(high, value)
            bounds_out[j, i, 0], bounds_out[j, i, 1] = low, high


@device_function
def is_free(bounds, i, j, k, m, nearest, farthest, thickness):
    """Tell whether a ray cannot hit anything between pixels (i, j) and (k, m).

    They are not farther apart than JUMP; `nearest` and `farthest` are 1/z of the ray there.
    """
    i, j, k, m = i >> BLOCK_BITS, j >> BLOCK_BITS, k >> BLOCK_BITS, m >> BLOCK_BITS
    low = min(min(bounds[j, i, 0], bounds[m, k, 0]), min(bounds[j, k, 0], bounds[m, i, 0]))
    high = max(max(bounds[j, i, 1], bounds[m, k, 1]), max(bounds[j, k, 1], bounds[m, i, 1]))
    return low * farthest > ONE or (high + thickness) * nearest < ONE


@device_function
def march(depth, bounds, lens, x, y, z, dx, dy, dz, thickness, stride, farthest):
    """Find where a ray first meets the picture.

    Steps are counted in pixels from the ray's start: u, v and 1/z are linear in them. So a step is
    known to a few millionths of a pixel, and every machine visits the same pixels.

    Parameters
    ----------
    depth : ndarray of shape (height, width), float32 [m]
        Depth along the camera's z axis; infinite where nothing can be hit.
    bounds : ndarray of shape `bounds_of(height, width)`, float32 [m]
        See `block_bounds`; only saves time.
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
    jump = np.float32(math.floor(JUMP / stride))
    right, bottom = w - ONE, h - ONE
    before = iz + diz * FIRST_STEP  # 1/z, as all that follows
    step, stay = ONE, 0  # a float32: it is exact, and a graphics processor converts none
    while True:
        t = FIRST_STEP + stride * step
        u, v = u0 + du * t, v0 + dv * t
        if not (t < end and u > -ONE and v > -ONE and u < w and v < h):
            return -ONE
        # Without a sign: negative places would count from the end, which costs a test at each.
        i, j = np.uint32(max(u, ZERO)), np.uint32(max(v, ZERO))
        if stay <= 0 and jump > ZERO:
            last = t + stride * jump
            k = np.uint32(min(max(u0 + du * last, ZERO), right))
            m = np.uint32(min(max(v0 + dv * last, ZERO), bottom))
            last = iz + diz * last
            near, away = max(before, last), min(before, last)
            # Beyond the ray's end 1/z may have passed through zero.
            if away > ZERO and is_free(bounds, i, j, k, m, near, away, thickness):
                before = last
                step += jump + ONE
                continue
            stay = PLAIN_STEPS
        now = iz + diz * t
        surface = depth[j, i]
        if min(before, now) * surface <= ONE and max(before, now) * (surface + thickness) >= ONE:
            break
        before = now
        step += ONE
        stay -= 1
    a, b = t - stride, t
    for _ in range(BISECTIONS):
        middle = HALF * (a + b)
        i, j = np.uint32(u0 + du * middle), np.uint32(v0 + dv * middle)
        if (iz + diz * middle) * depth[j, i] <= ONE:
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
