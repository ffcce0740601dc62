"""Mipmaps: a picture at halved sizes, from which a blurred colour is one look-up."""

import numpy as np

from rainsim.constants import HALF, ONE, TWO, ZERO
from rainsim.jit import cpu_kernel, device_function, inlined_function, prange, serial_kernel
from rainsim.numerics.interpolation import bilinear_color, four_colors

QUARTER = np.float32(0.25)

COARSEST = 6  # halvings: cells of 64 pixels
LEAST_CELLS = 2  # along either side of the coarsest mip level that is used
# px, standard deviation of a blur above which mip level 1 is nearer to it than the picture itself.
# Bilinear interpolation of cells of width w blurs by about w / 2, so by 1/2 and 1 px: their
# geometric mean.
FIRST_BLUR = np.float32(np.sqrt(0.5))


@device_function
def top_of(height, level):
    """Return the first row of a mip level, 1 or more, in the array of `coarsened`."""
    return height - (height >> (level - 1))


@device_function
def mean_of_four(cells, j, i, apart, c):
    """Return the mean of channel c over the cells (j, i), (j, i + apart) and the two below them."""
    return QUARTER * (
        (cells[j, i, c] + cells[j, i + apart, c])
        + (cells[j + apart, i, c] + cells[j + apart, i + apart, c])
    )


@cpu_kernel
def _halve(picture, level, coarse_out):
    """Write one mip level, each cell the mean over four cells of the level before."""
    height, width, _ = picture.shape
    top, wide = top_of(height, level), width >> level
    before = top_of(height, level - 1) if level > 1 else 0
    for row in prange(height >> level):
        line = np.empty(6 * wide, np.float32)
        j, out = before + 2 * row, coarse_out[top + row]
        if level == 1:
            _add_rows(picture[j], picture[j + 1], line)
        else:
            _add_rows(coarse_out[j], coarse_out[j + 1], line)
        _add_pairs(line, wide, out)


@serial_kernel
def _add_rows(upper, lower, line_out):
    """Add up two rows of a picture."""
    a, b = upper.reshape(upper.size), lower.reshape(lower.size)
    for k in range(len(line_out)):
        line_out[k] = a[k] + b[k]


@inlined_function
def _add_pairs(line, wide, row_out):
    """Write a quarter of the sums of neighbouring cells in `line`, the sum of two rows."""
    out = row_out.reshape(row_out.size)
    for i in range(wide):
        for c in range(3):
            out[3 * i + c] = QUARTER * (line[6 * i + c] + line[6 * i + 3 + c])


def coarse_shape(height, width):
    """Return the shape of the array that holds the mip levels 1 and up of a picture."""
    return height, width >> 1, 3


def coarsened(picture):
    """Return the mip levels 1 to COARSEST of a picture in one (height, width // 2, 3).

    Level 1 is in the first height // 2 rows, level 2 below it, and so on; a last row or column
    without a partner is left out. Cells beside the levels are not set.
    """
    coarse = np.empty(coarse_shape(*picture.shape[:2]), np.float32)
    for level in range(1, COARSEST + 1):
        _halve(picture, level, coarse)
    return coarse


@inlined_function
def blurred_color(picture, coarse, u, v, blur):
    """Return the colour of a picture at image point (u, v), blurred; the point is clamped to it.

    `coarse` are the levels of `coarsened`. `blur` [px] is the standard deviation along one axis;
    the nearest mip level is used.
    """
    height, width = picture.shape[0], picture.shape[1]
    level = level_of(height, width, blur)
    if level == 0:
        return bilinear_color(picture, u, v)
    j, i, a, b = cell_of(height, width, level, u, v)
    return four_colors(coarse, j, j + 1, i, i + 1, a, b)


@inlined_function
def level_of(height, width, blur):
    """Return the mip level whose blur is nearest to `blur` [px], the standard deviation."""
    level, edge = 0, FIRST_BLUR
    while blur > edge and level < COARSEST and min(height, width) >> (level + 1) >= LEAST_CELLS:
        level += 1
        edge *= TWO
    return level


@inlined_function
def cell_of(height, width, level, u, v):
    """Return row and column of the first of four cells around (u, v) in a level, and weights."""
    rows, columns = height >> level, width >> level
    scale = ONE / np.float32(1 << level)
    u = min(max(u * scale - HALF, ZERO), np.float32(columns - 1))
    v = min(max(v * scale - HALF, ZERO), np.float32(rows - 1))
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    top = top_of(height, level) if level > 0 else 0
    return top + j, i, u - np.float32(i), v - np.float32(j)
