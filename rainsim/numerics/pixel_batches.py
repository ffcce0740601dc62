"""Pixels by the chunk: rows of numbers that stay in cache, so that loops over them run in vectors.

A kernel that works so has a float32 array of some rows of CHUNK numbers and loops over one pass
after the other; only loads from tables are done pixel by pixel.
"""

from __future__ import annotations

import numpy as np

from rainsim.jit import inlined_function, serial_kernel

CHUNK = 256  # pixels
CORNERS = 4 * CHUNK  # numbers that `interpolate` needs to work with
ZERO, ONE = np.float32(0), np.float32(1)
SECOND, THIRD, FOURTH = CHUNK, 2 * CHUNK, 3 * CHUNK


@inlined_function
def held(x, most):
    """Return x, held between 0 and `most`; 0 for NaN: what is made of it is a place in memory."""
    x = x if x > ZERO else ZERO
    return x if x < most else most


# Not inlined: LLVM sees that its loops can run in vectors only when it looks at them alone.
@serial_kernel
def interpolate(field, n, s, u, v, place, corner):
    """Put a field's value, interpolated as by `light.bilinear`, in place of n columns of the field.

    Parameters
    ----------
    field : ndarray of shape (rows, columns), float32
    n : int
        At most CHUNK.
    s : ndarray of float32
        From `u` on the columns, which are overwritten, from `v` on the rows, which are lost.
    u, v : int
    place : ndarray of shape (CHUNK,), uint32
    corner : ndarray of shape (CORNERS,), float32
        Working memory, as `place`.
    """
    rows, columns = field.shape
    flat = field.reshape(rows * columns)
    right, bottom = np.float32(columns - 1), np.float32(rows - 1)
    last, lowest = np.float32(columns - 2), np.float32(rows - 2)
    wide, next_ = np.uint32(columns), np.uint32(1)
    for i in range(n):
        x, y = held(s[u + i], right), held(s[v + i], bottom)
        k, m = np.int32(min(x, last)), np.int32(min(y, lowest))
        place[i] = np.uint32(m) * wide + np.uint32(k)
        s[u + i], s[v + i] = x - np.float32(k), y - np.float32(m)
    for i in range(n):
        k = place[i]
        corner[i], corner[SECOND + i] = flat[k], flat[k + next_]
    for i in range(n):
        k = place[i] + wide
        corner[THIRD + i], corner[FOURTH + i] = flat[k], flat[k + next_]
    for i in range(n):
        a, b = s[u + i], s[v + i]
        upper = corner[i] * (ONE - a) + corner[SECOND + i] * a
        lower = corner[THIRD + i] * (ONE - a) + corner[FOURTH + i] * a
        s[u + i] = upper * (ONE - b) + lower * b


@serial_kernel
def nearest(field, n, s, u, v, out, place):
    """Put a picture's values at n image points s[u:], s[v:], or at its edge beside, to s[out:].

    Parameters are those of `interpolate`.
    """
    rows, columns = field.shape
    flat = field.reshape(rows * columns)
    right, bottom, wide = np.float32(columns - 1), np.float32(rows - 1), np.uint32(columns)
    for i in range(n):
        k, m = np.int32(held(s[u + i], right)), np.int32(held(s[v + i], bottom))
        place[i] = np.uint32(m) * wide + np.uint32(k)
    for i in range(n):
        s[out + i] = flat[place[i]]
