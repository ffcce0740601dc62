"""Work on batches of CHUNK pixels: their numbers stay in cache, and loops over them are vectorised.

Such a kernel has a float32 array of some rows of CHUNK numbers and computes one pass over the batch
after the other; only look-ups in tables are done pixel by pixel.
"""

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.jit import inlined_function, serial_kernel

CHUNK = 256  # pixels
CORNERS = 4 * CHUNK  # size of the working memory of `interpolate`
SECOND, THIRD, FOURTH = CHUNK, 2 * CHUNK, 3 * CHUNK


@inlined_function
def held(x, most):
    """Return x clamped to 0 to `most`, and 0 for NaN, because callers use it as an array index."""
    x = x if x > ZERO else ZERO
    return x if x < most else most


# Not inlined: LLVM vectorises these loops only if it compiles them in a function of their own.
@serial_kernel
def interpolate(field, n, s, u, v, place, corner):
    """Replace n columns of places in a field by the field's value there, interpolated bilinearly.

    n : int. At most CHUNK.
    s : float32 array. Columns of the places from index `u` on, which the values
        replace, and their rows from index `v` on, which are overwritten with
        weights.
    place : uint32 array (CHUNK,)
    corner : float32 array (CORNERS,). Working memory, as `place`.
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
    """Write a picture's nearest values at n image points s[u:], s[v:] to s[out:].

    Points beside the picture get the value at its edge. Parameters are as for `interpolate`.
    """
    rows, columns = field.shape
    flat = field.reshape(rows * columns)
    right, bottom, wide = np.float32(columns - 1), np.float32(rows - 1), np.uint32(columns)
    for i in range(n):
        k, m = np.int32(held(s[u + i], right)), np.int32(held(s[v + i], bottom))
        place[i] = np.uint32(m) * wide + np.uint32(k)
    for i in range(n):
        s[out + i] = flat[place[i]]
