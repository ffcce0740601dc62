"""Ripmaps: a picture at all combinations of halved widths and heights, in one array."""

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import cpu_kernel, inlined_function, prange

LEVELS = 7  # of widths and of heights, each half of the one before


def ripmap(picture, horizon):
    """Return a picture at all combinations of halved widths and heights (a ripmap).

    Level i of the widths begins at column 2 width (1 - 2^-i), heights in the same way; LEVELS
    each, sides rounded up to whole numbers of the coarsest. Rows above the `horizon` show nothing
    and are filled with that.
    """
    coarsest = 1 << (LEVELS - 1)
    height, width = (-(-n // coarsest) * coarsest for n in picture.shape[:2])
    atlas = np.empty((2 * height, 2 * width, 3), np.float32)
    _fill_ripmap(picture, horizon, height, width, atlas)
    return atlas


@cpu_kernel
def _fill_ripmap(picture, horizon, height, width, atlas_out):
    rows, columns = picture.shape[:2]
    flat = atlas_out.reshape(2 * height, 6 * width)
    for j in prange(height):
        source = picture[min(max(np.int64(j), horizon), rows - 1)]
        line = flat[j]
        for i in range(width):
            at = i if i < columns else columns - 1
            line[3 * i], line[3 * i + 1] = source[at, 0], source[at, 1]
            line[3 * i + 2] = source[at, 2]
        start, wide = 0, width
        for _ in range(LEVELS - 1):
            fine, coarse = line[3 * start :], line[3 * (start + wide) :]
            for i in range(wide // 2):
                for c in range(3):
                    coarse[3 * i + c] = HALF * (fine[6 * i + c] + fine[6 * i + 3 + c])
            start += wide
            wide //= 2
    start, high = 0, height
    for _ in range(LEVELS - 1):
        for j in prange(high // 2):
            upper, lower = flat[start + 2 * j], flat[start + 2 * j + 1]
            mean = flat[start + high + j]
            for i in range(6 * width):  # in vectors
                mean[i] = HALF * (upper[i] + lower[i])
        start += high
        high //= 2


@inlined_function
def sample_ripmap(atlas, u, v, across, down):
    """Return the colour at (u, v) [px] of level `across` of the widths, `down` of the heights."""
    height, width = atlas.shape[0] // 2, atlas.shape[1] // 2
    wide, high = width >> across, height >> down
    left, top = 2 * (width - wide), 2 * (height - high)
    u = min(max(u / np.float32(1 << across) - HALF, ZERO), np.float32(wide - 1))
    v = min(max(v / np.float32(1 << down) - HALF, ZERO), np.float32(high - 1))
    i, j = max(min(int(u), wide - 2), 0), max(min(int(v), high - 2), 0)
    k, m = min(i + 1, wide - 1), min(j + 1, high - 1)
    a, b = u - np.float32(i), v - np.float32(j)
    w0, w1, w2, w3 = (ONE - a) * (ONE - b), a * (ONE - b), (ONE - a) * b, a * b
    j, m, i, k = top + j, top + m, left + i, left + k
    p = atlas
    return (
        p[j, i, 0] * w0 + p[j, k, 0] * w1 + p[m, i, 0] * w2 + p[m, k, 0] * w3,
        p[j, i, 1] * w0 + p[j, k, 1] * w1 + p[m, i, 1] * w2 + p[m, k, 1] * w3,
        p[j, i, 2] * w0 + p[j, k, 2] * w1 + p[m, i, 2] * w2 + p[m, k, 2] * w3,
    )
