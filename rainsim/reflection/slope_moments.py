"""Ripples as a pixel sees them: mean and covariance of their slopes over the pixel's footprint.

A picture shows the mean of what all facets in a pixel mirror, so it needs the spread of their
slopes, not only the slope in the pixel's middle. Slopes and their products are averaged over ever
larger cells of the ripple tile (Olano and Baker 2010, LEAN mapping, I3D 2010, 181-188): the mean
of a product less the product of the means is the covariance over any footprint. Two things differ
from the paper: the footprint of a pixel seen at a slant is put together from several cells in a
row, and the covariance serves to draw mirrored rays (`mirrored_rays`), not a highlight.
"""

import math

import numpy as np
import scipy.fft

from rainsim.constants import HALF, ONE, TWO, ZERO
from rainsim.jit import cpu_kernel, device_function, prange

QUARTER = np.float32(0.25)

MOMENTS = 6  # of slopes a, b along x, y and height h: a, b, a^2, b^2, a b, h over the tile's size
# Width c of a cell over the width w of the part of the footprint that the cell stands for. A mean
# over a cell (variance c^2 / 12), interpolated between neighbours (c^2 / 6), weights places with a
# variance of c^2 / 4; an even weight over w has w^2 / 12. The two are equal for c = w / sqrt(3).
CELL_SHARE = np.float32(1 / math.sqrt(3))
FINER = np.float32(0.78)  # of that width: a finer mip level is used from here on; levels double
LEAST_STEP = np.float32(1.4)  # cells of the finest resolution between two that are averaged
MOST_SLANT = np.float32(40)  # of the pixel's footprint on the water over its width
MOST_CELLS = np.float32(16)  # in a row over a slanted footprint
ROOT_TWO = np.float32(math.sqrt(2))


@device_function
def place_of(n, level):
    """Return the first row and column of a level of the moments of n x n cells."""
    return (n - (n >> (level - 1)), n) if level > 0 else (0, 0)


@device_function
def mean_of_four(moments, n, level, row, column, c):
    """Return a moment of a cell of `level`, from 1 up, as the mean over the level before."""
    top, left = place_of(n, level - 1)
    j, i = top + 2 * row, left + 2 * column
    return QUARTER * (
        (moments[j, i, c] + moments[j, i + 1, c])
        + (moments[j + 1, i, c] + moments[j + 1, i + 1, c])
    )


def heights_of(slopes):
    """Return the heights of a periodic tile over its size, (n, n), from slopes (2, n, n)."""
    n = slopes.shape[1]
    kx = 2 * np.pi * np.arange(n // 2 + 1, dtype=np.float32)
    ky = 2 * np.pi * scipy.fft.fftfreq(n, 1 / n).astype(np.float32)[:, None]
    if n % 2 == 0:  # the shortest waves have no slope
        kx[-1] = ky[n // 2] = 0
    square = kx * kx + ky * ky
    square[square == 0] = 1  # nor has the mean height
    along_x, along_y = scipy.fft.rfft2(slopes.astype(np.float32, copy=False))
    return scipy.fft.irfft2(-1j * (kx * along_x + ky * along_y) / square, s=(n, n))


@cpu_kernel
def _lay(slopes, height, moments_out):
    """Write the moments of the cells, then those of all halved resolutions."""
    n = slopes.shape[1]
    for j in prange(n):
        for i in range(n):
            a, b = slopes[0, j, i], slopes[1, j, i]
            m = moments_out[j, i]
            m[0], m[1], m[2], m[3], m[4], m[5] = a, b, a * a, b * b, a * b, height[j, i]
    level, cells = 1, n >> 1
    while cells > 0 and 2 * cells == n >> (level - 1):
        top, left = place_of(n, level)
        for j in prange(cells):
            for i in range(cells):
                for c in range(MOMENTS):
                    value = mean_of_four(moments_out, n, level, j, i, c)
                    moments_out[top + j, left + i, c] = value
        level, cells = level + 1, cells >> 1


def ripple_moments(slopes):
    """Return the moments of a tile of slopes (2, n, n) at all resolutions.

    Returns float32 array (n, n + n // 2, MOMENTS). Full resolution in the first n
        columns; half of that in the first n / 2 rows of the others, a quarter
        below it, and so on for as long as the number of cells can be halved.
    """
    slopes = np.ascontiguousarray(slopes, dtype=np.float32)
    n = slopes.shape[1]
    moments = np.zeros((n, n + n // 2, MOMENTS), np.float32)
    _lay(slopes, heights_of(slopes).astype(np.float32, copy=False), moments)
    return moments


@device_function
def _level_of(n, size, cell):
    """Return the level of a tile of n x n cells and some size [m] for cells of a width [m]."""
    level, edge = 0, ROOT_TWO * size / np.float32(n)
    while FINER * cell > edge and 2 * (n >> (level + 1)) == n >> level:
        level += 1
        edge *= TWO
    return level


@device_function
def tile_height(moments, size, x, y, width):
    """Return the height [m] of a tile's ripples as a pixel of some width [m] holds it."""
    n = moments.shape[0]
    level = _level_of(n, size, CELL_SHARE * width)
    u, v = x / size, y / size
    i, j, k, m, a, b = _between(n >> level, u - np.floor(u), v - np.floor(v))
    top, left = place_of(n, level)
    upper = moments[top + j, left + i, 5] * (ONE - a) + moments[top + j, left + k, 5] * a
    lower = moments[top + m, left + i, 5] * (ONE - a) + moments[top + m, left + k, 5] * a
    return size * (upper * (ONE - b) + lower * b)


@device_function
def pixel_slopes(moments, size, x, y, vx, vy, vz, width):
    """Return mean and covariance of the ripples' slopes over a pixel's footprint on level water.

    moments : float32 array (n, n + n // 2, MOMENTS). Of a periodic tile, see
        `ripple_moments`.
    size : float32 [m]. Of the tile.
    x, y : float32 [m]. Where the middle of the pixel meets the water.
    vx, vy, vz : float32. Unit view direction, downward.
    width : float32 [m]. Of the pixel there, across the view.
    Returns a, b, aa, bb, ab : float32. Mean slopes along x and y, their variances
        and their covariance.
    """
    n = moments.shape[0]
    slant = min(ONE / max(-vz, np.float32(1e-3)), MOST_SLANT)
    apart = max(HALF * width, LEAST_STEP * size / np.float32(n))
    # np.ceil and np.floor stay in float32. The integers of math.ceil and math.floor have 64 bits,
    # and what they meet becomes float64: that took twice as long.
    count = min(max(np.ceil(slant * width / apart), ONE), MOST_CELLS)
    step = slant * width / count
    cell = max(width, step) * CELL_SHARE
    level = _level_of(n, size, cell)
    inv = ONE / (size * math.sqrt(max(vx * vx + vy * vy, np.float32(1e-9))))
    du, dv = step * vx * inv, step * vy * inv
    back = HALF * (count - ONE)
    u, v = x / size - back * du, y / size - back * dv
    # A footprint smaller than a cell sees only a part of the slope's change over the cell.
    small = min(cell * np.float32(n) / size, ONE)
    small *= small
    a, b, aa, bb, ab = ZERO, ZERO, ZERO, ZERO, ZERO
    for _ in range(int(count)):
        m0, m1, m2, m3, m4 = _mixed(moments, n, level, u - np.floor(u), v - np.floor(v))
        a, b = a + m0, b + m1
        aa += m0 * m0 + small * (m2 - m0 * m0)
        bb += m1 * m1 + small * (m3 - m1 * m1)
        ab += m0 * m1 + small * (m4 - m0 * m1)
        u, v = u + du, v + dv
    share = ONE / count
    a, b = a * share, b * share
    return (
        a, b, max(aa * share - a * a, ZERO), max(bb * share - b * b, ZERO), ab * share - a * b
    )  # fmt: skip


@device_function
def _between(cells, u, v):
    """Return columns i, k and rows j, m about (u, v), and how far it lies from the first ones."""
    u, v = u * np.float32(cells) - HALF, v * np.float32(cells) - HALF
    i, j = int(u + ONE) - 1, int(v + ONE) - 1  # the floor: both are above -1
    a, b = u - np.float32(i), v - np.float32(j)
    k, m = i + 1 if i + 1 < cells else 0, j + 1 if j + 1 < cells else 0
    return i if i >= 0 else cells - 1, j if j >= 0 else cells - 1, k, m, a, b


@device_function
def _mixed(moments, n, level, u, v):
    """Return the moments of a level at (u, v), shares of the tile from 0 to 1, interpolated."""
    i, j, k, m, a, b = _between(n >> level, u, v)
    top, left = place_of(n, level)
    w0, w1, w2, w3 = (ONE - a) * (ONE - b), a * (ONE - b), (ONE - a) * b, a * b
    p, q = moments[top + j, left + i], moments[top + j, left + k]
    r, s = moments[top + m, left + i], moments[top + m, left + k]
    return (
        p[0] * w0 + q[0] * w1 + r[0] * w2 + s[0] * w3,
        p[1] * w0 + q[1] * w1 + r[1] * w2 + s[1] * w3,
        p[2] * w0 + q[2] * w1 + r[2] * w2 + s[2] * w3,
        p[3] * w0 + q[3] * w1 + r[3] * w2 + s[3] * w3,
        p[4] * w0 + q[4] * w1 + r[4] * w2 + s[4] * w3,
    )


@device_function
def root_of(xx, yy, xy):
    """Return the lower triangle (a; b, c) whose product with its transpose is a covariance."""
    a = math.sqrt(max(xx, np.float32(1e-12)))
    b = xy / a
    return a, b, math.sqrt(max(yy - b * b, ZERO))
