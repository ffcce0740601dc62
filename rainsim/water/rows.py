"""Tiles, the runs that they form, and rows of numbers on a kernel's stack.

The compiler takes many cells at once only where it knows that a loop does not read what it writes.
Of arrays it must ask that at run time, pair by pair, and above eight pairs it gives up. Of numbers
on the stack it knows. They also cost no allocation.
"""

import functools

import numpy as np

from rainsim import jit
from rainsim.jit import prange

ROWS, COLUMNS = 16, 64  # cells of a tile, whatever the number of threads
RUN = 1024  # columns, the most that a kernel takes at once
ROOM = RUN + 4  # of a row on the stack: a run's columns and what lies beside them


@jit.intrinsic
def stack_row(typingctx, like, count):
    """Return an uninitialised ndarray of shape (count,) of the type of `like`, on the stack.

    It must not leave the kernel, nor the turn of a parallel loop that made it.
    """
    if not isinstance(count, jit.types.IntegerLiteral):
        return None
    row = jit.types.Array(like.dtype, 1, "C")

    def codegen(context, builder, signature, arguments):
        item, length = context.get_data_type(like.dtype), count.literal_value
        number = functools.partial(context.get_constant, jit.types.intp)
        array = context.make_array(row)(context, builder)
        array.data = jit.cgutils.alloca_once(builder, item, size=length)
        array.nitems, array.itemsize = number(length), number(context.get_abi_sizeof(item))
        array.shape = jit.cgutils.pack_array(builder, [array.nitems])
        array.strides = jit.cgutils.pack_array(builder, [array.itemsize])
        for owner in ("meminfo", "parent"):
            setattr(array, owner, jit.cgutils.get_null_value(getattr(array, owner).type))
        return array._getvalue()

    return row(like, count), codegen


def runs_of(tiles, numbers, across):
    """Join neighbouring tiles of a row of tiles into runs of up to `RUN` columns.

    A kernel takes a run row by row: long rows keep vector lanes and memory streams full.

    numbers : int64 array (tiles,). Places of these in all of the map's tiles, row
        by row, in rising order.
    across : int. Tiles that the map has in a row.
    Returns int64 array (runs, 6). First and last row + 1, first and last column +
        1, first and last tile + 1 of each run.
    """
    place, row = numbers % across, numbers // across
    first = np.ones(len(numbers), bool)
    # Cut where a tile does not follow the last, and at fixed columns of the map.
    first[1:] = (np.diff(numbers) != 1) | (np.diff(row) != 0) | (place[1:] % (RUN // COLUMNS) == 0)
    begin = np.flatnonzero(first)
    end = np.append(begin[1:], len(numbers))
    runs = np.empty((len(begin), 6), np.int64)
    if len(begin):
        runs[:, :3], runs[:, 3] = tiles[begin, :3], tiles[end - 1, 3]
    runs[:, 4], runs[:, 5] = begin, end
    return runs


@jit.inlined_function
def copy_row(a, n, a_out):
    """Copy n numbers of `a`."""
    for c in range(n):
        a_out[c] = a[c]


@jit.device_function
def tile_maxima(run, tiles, tops, top_out):
    """Find the largest of the columns `tops` of each tile of a run."""
    for m in range(run[4], run[5]):
        top = tops[tiles[m, 2] - run[2]]
        for c in range(tiles[m, 2] - run[2], tiles[m, 3] - run[2]):
            top = max(top, tops[c])
        top_out[m] = top


@jit.cpu_kernel
def tile_peaks(tiles, h, bed, deepest_out, highest_out):
    """Find each tile's largest depth and highest level [m]; 0 and -infinity where all is dry."""
    for t in prange(tiles.shape[0]):
        west, east = tiles[t, 2], tiles[t, 3]
        deep, high = stack_row(h, COLUMNS), stack_row(h, COLUMNS)
        for c in range(east - west):
            deep[c], high[c] = 0.0, -np.inf
        for j in range(tiles[t, 0], tiles[t, 1]):
            d, b = h[j, west:east], bed[j, west:east]
            for c in range(east - west):
                deep[c] = max(deep[c], d[c])
                level = b[c] + d[c]
                high[c] = max(high[c], level) if d[c] > 0.0 else high[c]
        deepest_out[t], highest_out[t] = deep[: east - west].max(), high[: east - west].max()
