"""Values between the cells of a field and the pixels of a picture."""

import numpy as np

from rainsim.constants import HALF, ONE, THREE, TWO, ZERO
from rainsim.jit import device_function, inlined_function


@inlined_function
def smoothstep(low, high, x):
    """Return 0 below `low`, 1 above `high` and a smooth cubic between."""
    s = min(max((x - low) / (high - low), ZERO), ONE)
    return s * s * (THREE - TWO * s)


@inlined_function
def map_place(x, y, origin, spacing):
    """Return column and row of a map at (x, y) [m]; cell centres are whole numbers."""
    return (x - origin[0]) / spacing - HALF, (y - origin[1]) / spacing - HALF


@inlined_function
def is_on_map(u, v, field):
    """Tell whether column u and row v of a field lie between its outermost cell centres."""
    right, bottom = np.float32(field.shape[1] - 1), np.float32(field.shape[0] - 1)
    return (u > ZERO) & (v > ZERO) & (u < right) & (v < bottom)


@device_function
def bilinear(field, u, v):
    """Return `field` (rows, columns) at column u, row v, cell centres at whole numbers; clamped."""
    rows, columns = field.shape
    u = min(max(u, ZERO), np.float32(columns - 1))
    v = min(max(v, ZERO), np.float32(rows - 1))
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    a, b = u - np.float32(i), v - np.float32(j)
    upper = field[j, i] * (ONE - a) + field[j, i + 1] * a
    lower = field[j + 1, i] * (ONE - a) + field[j + 1, i + 1] * a
    return upper * (ONE - b) + lower * b


@device_function
def bilinear_color(picture, u, v):
    """Return the colour of `picture` at image point (u, v), interpolated, clamped to the edge."""
    rows, columns = picture.shape[0], picture.shape[1]
    u = min(max(u - HALF, ZERO), np.float32(columns - 1))
    v = min(max(v - HALF, ZERO), np.float32(rows - 1))
    # Unsigned: numba tests each signed index for being negative.
    i, j = np.uint32(u), np.uint32(v)
    k = np.uint32(min(np.float32(i) + ONE, np.float32(columns - 1)))
    m = np.uint32(min(np.float32(j) + ONE, np.float32(rows - 1)))
    return four_colors(picture, j, m, i, k, u - np.float32(i), v - np.float32(j))


@device_function
def four_colors(picture, j, m, i, k, a, b):
    """Return the bilinear mean of the colours at rows j, m and columns i, k; weights b and a."""
    upper, lower = ONE - b, b
    w0, w1, w2, w3 = upper * (ONE - a), upper * a, lower * (ONE - a), lower * a
    return (
        picture[j, i, 0] * w0 + picture[j, k, 0] * w1
        + picture[m, i, 0] * w2 + picture[m, k, 0] * w3,
        picture[j, i, 1] * w0 + picture[j, k, 1] * w1
        + picture[m, i, 1] * w2 + picture[m, k, 1] * w3,
        picture[j, i, 2] * w0 + picture[j, k, 2] * w1
        + picture[m, i, 2] * w2 + picture[m, k, 2] * w3,
    )  # fmt: skip
