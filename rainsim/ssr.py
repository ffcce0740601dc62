"""Screen-space reflection: march the mirrored ray through the picture's own depth.

McGuire and Mara 2014 (JCGT 3(4)): a ray that is straight in space is straight in the picture, and
1/z is linear along it, so the march visits each pixel once, perspective-correct (a digital
differential analyser, DDA). Two things differ from the paper (RainyGS): a hit is an overlap of
depth intervals with a thickness in metres, not a point within an epsilon, so that a fast ray cannot
step through a surface; and the end of the ray is bisected. Where a ray passes before or behind all
that some pixels show, it jumps over them. Steps are counted in pixels from the ray's start: u, v
and 1/z are linear in them, so a step is known to a few millionths of a pixel, and every machine
visits the same pixels.

`march` is the whole of it; below it stand the parts that it calls: the ray's line in the picture,
the jumps over blocks of pixels, the bisection, and how the blocks' depths are found.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import cpu_kernel, device_function, inlined_function, lean_function, prange

NEAR = np.float32(0.05)  # m: a ray that comes towards the camera ends here
# px: no surface hits itself; and rays start in the middle of a pixel, many go straight up, so that
# with whole steps rounding would choose the pixel at every step or halving.
FIRST_STEP = np.float32(1 + 1 / 32)
BISECTIONS = 4
BLOCK = 8  # px, side of the blocks whose depths let a march jump
BLOCK_BITS = np.uint32(3)  # of a pixel's place that are within one
JUMP = np.float32(7)  # px: two places no farther apart lie in one block or in neighbours
KINDS = 4  # a block alone, with its eastern neighbour, with its southern one, with all three
PLAIN_STEPS = 4  # that are taken where a jump was not possible, before another is tried
_ONE, _TWO = np.uint32(1), np.uint32(2)


class DepthBlocks(NamedTuple):
    """A picture's depth, and bounds of the depth over blocks of pixels."""

    depth: np.ndarray  # (height, width) float32 [m], along the view axis; infinite: never hit
    bounds: np.ndarray  # `bounds_of(height, width)` float32 [m], see `block_bounds`; saves time


class MarchSettings(NamedTuple):
    """Settings of the march of a ray."""

    thickness: np.float32  # m, how far behind its depth a surface still stops a ray
    stride: np.float32  # px of a step
    farthest: np.float32  # m of ray that are searched


@lean_function
def march(blocks, view, start, direction, settings):
    """Find the first hit of a ray with the surfaces that a picture shows.

    Returns distance : float32 [m]. Along the ray; negative if nothing was met
        within the picture.
    """
    depth, bounds = blocks.depth, blocks.bounds
    thickness, stride = settings.thickness, settings.stride
    height, width = depth.shape
    w, h = np.float32(width), np.float32(height)
    u0, v0, iz, du, dv, diz, inv, end = screen_line(view, w, h, start, direction, settings.farthest)
    if not end >= ONE:
        return -ONE
    rows, columns = np.uint32(-(-height // BLOCK)), np.uint32(-(-width // BLOCK))
    jump = np.float32(math.floor(JUMP / stride))
    right, bottom = w - ONE, h - ONE
    before = iz + diz * FIRST_STEP  # 1/z, as all depths of the ray that follow
    step, t = ONE, FIRST_STEP + stride  # a float32: exact, and a graphics processor converts none
    u, v = u0 + du * t, v0 + dv * t
    # A jump, or where none is possible a few steps. No branch leaves the loop's body: the lanes of
    # a graphics processor come together again after each turn.
    met = False
    while not met and t < end and u > -ONE and v > -ONE and u < w and v < h:
        is_free_here = False
        last = FIRST_STEP + stride * (step + jump)
        far = iz + diz * last
        near, away = max(before, far), min(before, far)
        # Beyond the ray's end 1/z may have passed through zero.
        if jump > ZERO and away > ZERO:
            # Without a sign: negative places would count from the end, tested for at each.
            i, j = np.uint32(max(u, ZERO)), np.uint32(max(v, ZERO))
            k = np.uint32(min(max(u0 + du * last, ZERO), right))
            m = np.uint32(min(max(v0 + dv * last, ZERO), bottom))
            is_free_here = is_free(bounds, rows, columns, i, j, k, m, near, away, thickness)
        if is_free_here:
            before = far
            step += jump + ONE
            t = FIRST_STEP + stride * step
            u, v = u0 + du * t, v0 + dv * t
        else:
            stay = PLAIN_STEPS
            while stay > 0 and t < end and u > -ONE and v > -ONE and u < w and v < h:
                surface = depth[np.uint32(max(v, ZERO)), np.uint32(max(u, ZERO))]
                now = iz + diz * t
                low, high = min(before, now), max(before, now)
                met = low * surface <= ONE and high * (surface + thickness) >= ONE
                if met:
                    stay = 0
                else:
                    before, stay = now, stay - 1
                    step += ONE
                    t = FIRST_STEP + stride * step
                    u, v = u0 + du * t, v0 + dv * t
    if not met:
        return -ONE
    b = bisected(depth, u0, v0, iz, du, dv, diz, t - stride, t)
    return b * inv * start[2] / (iz + diz * b)


@inlined_function
def screen_line(view, w, h, start, direction, farthest):
    """Return a ray's line in a picture of w by h pixels, as a march steps along it.

    At length s, with q = s / (z (z + s dz)), the picture shows the ray (du, dv) q from its start.

    Returns u0, v0, iz : float32. Image point [px] and 1/z [1/m] of the start.
        du, dv, diz : float32. What each pixel of way adds to them; the larger of
            |du| and |dv| is 1.
        inv : float32. q over the way.
        end : float32 [px]. Of the line: where the search, the picture or the near
            plane ends it; below 1 if the picture shows next to nothing of the
            ray.
    """
    x, y, z = start
    dx, dy, dz = direction
    iz = ONE / z
    du, dv = view.fx * (dx * z - x * dz), view.fy * (dy * z - y * dz)
    far = z + dz * farthest
    length = farthest * iz / far
    if far < NEAR:
        length = (iz - ONE / NEAR) / dz
    span = max(abs(du), abs(dv))
    end = span * length
    if not end >= ONE:
        return ZERO, ZERO, iz, ZERO, ZERO, ZERO, ZERO, -ONE
    inv = ONE / span
    du, dv, diz = du * inv, dv * inv, -dz * inv
    u0, v0 = view.fx * x * iz + view.cx, view.fy * y * iz + view.cy
    if du > ZERO:
        end = min(end, (w - u0) / du)
    elif du < ZERO:
        end = min(end, -u0 / du)
    if dv > ZERO:
        end = min(end, (h - v0) / dv)
    elif dv < ZERO:
        end = min(end, -v0 / dv)
    return u0, v0, iz, du, dv, diz, inv, end


@inlined_function
def bisected(depth, u0, v0, iz, du, dv, diz, a, b):
    """Return the way [px] between a and b at which a ray passes behind the picture's surface."""
    for _ in range(BISECTIONS):
        middle = HALF * (a + b)
        i, j = np.uint32(u0 + du * middle), np.uint32(v0 + dv * middle)
        if (iz + diz * middle) * depth[j, i] <= ONE:
            b = middle
        else:
            a = middle
    return b


@device_function
def is_free(bounds, rows, columns, i, j, k, m, nearest, farthest, thickness):
    """Tell whether a ray cannot hit anything between pixels (i, j) and (k, m).

    They lie in one block or in neighbours. `nearest` and `farthest` are 1/z of the ray there.
    """
    i, j, k, m = i >> BLOCK_BITS, j >> BLOCK_BITS, k >> BLOCK_BITS, m >> BLOCK_BITS
    kind = ((i ^ k) & _ONE) + ((j ^ m) & _ONE) * _TWO
    at = np.uint32((kind * rows + min(j, m)) * columns + min(i, k))
    return bounds[at, 0] * farthest > ONE or (bounds[at, 1] + thickness) * nearest < ONE


def bounds_of(height, width):
    """Return the shape of a picture's `bounds_out`, see `block_bounds`."""
    return KINDS * -(-height // BLOCK) * -(-width // BLOCK), 2


@cpu_kernel
def block_bounds(depth, bounds_out):
    """Write the least and the greatest depth of blocks of pixels, for `march`.

    First of the blocks, row by row, then of each with its neighbours, kind by kind.

    depth : float32 array (height, width) [m]. Infinite where nothing can be hit:
        that does not count.
    bounds_out : ndarray of shape `bounds_of(height, width)`, float32 [m]
    """
    height, width = depth.shape
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    for j in prange(rows):
        for i in range(columns):
            low, high = np.float32(np.inf), np.float32(-np.inf)
            for row in range(j * BLOCK, min(j * BLOCK + BLOCK, height)):
                for column in range(i * BLOCK, min(i * BLOCK + BLOCK, width)):
                    value = depth[row, column]
                    if value < np.float32(np.inf):
                        low, high = min(low, value), max(high, value)
            at = j * columns + i
            bounds_out[at, 0], bounds_out[at, 1] = low, high
    blocks = rows * columns
    for n in prange(len(bounds_out) - blocks):
        at = blocks + n
        low, high = joined_at(bounds_out, rows, columns, at)
        bounds_out[at, 0], bounds_out[at, 1] = low, high


@device_function
def joined_at(bounds, rows, columns, at):
    """Return the value that `block_bounds` writes at place `at`, beyond the blocks themselves."""
    kind, at = at // (rows * columns), at % (rows * columns)
    j, i = at // columns, at % columns
    low, most = np.float32(np.inf), np.float32(-np.inf)
    for row in range(j, min(j + 1 + kind // 2, rows)):
        for column in range(i, min(i + 1 + kind % 2, columns)):
            at = row * columns + column
            low, most = min(low, bounds[at, 0]), max(most, bounds[at, 1])
    return low, most


@device_function
def edge_fade(u, v, width, height, share):
    """Return 1 inside the picture, falling to 0 at its edge within `share` of its size."""
    from_side = min(u, np.float32(width) - u) / (share * np.float32(width))
    from_end = min(v, np.float32(height) - v) / (share * np.float32(height))
    return min(max(min(from_side, from_end), ZERO), ONE)
