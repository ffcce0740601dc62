"""Which splats each tile shows, and in which order."""

import numpy as np

from rainsim import jit
from rainsim.jit import prange
from rainsim.splatting.prepared import LANES
from rainsim.splatting.project import BLOCKS, TILE_SHIFT

FEW = 48  # entries up to which insertion beats the radix sort
MANY = 1 << 14  # entries from which on each bit of the depths is sorted by
DIGIT_BITS = 8
LAST_BIT = np.uint64(63)
DIGITS = 1 << DIGIT_BITS
DIGIT = np.uint64(DIGITS - 1)
# An entry of a tile's list: the depth's highest 38 bits as float64, without its sign, then the
# record's number. With fewer, splats a millionth of their depth apart would change places.
RECORD_BITS = 26
RECORD_SHIFT = np.uint64(RECORD_BITS)
RECORD_MASK = np.uint64((1 << RECORD_BITS) - 1)


@jit.serial_kernel
def tile_starts(count):
    """Turn counts per block and tile into places; return the first place of each tile."""
    blocks, tiles = count.shape
    start = np.empty(tiles + 1, np.int64)
    place = 0
    for tile in range(tiles):
        start[tile] = place
        for block in range(blocks):
            n = count[block, tile]
            count[block, tile] = place
            place += n
    start[tiles] = place
    return start


@jit.cpu_kernel
def list_tiles(depth, box, visible, across, place, entry_out):
    """Write (depth bits, record) of each splat into the list of each tile that it meets.

    depth : float64 array (256 n,). Of the records.
    box : int16 array (256 n, 4)
    visible : int64 array (n,). As `project_chunks` writes them.
    across : int. Tiles across the picture.
    place : int64 array (BLOCKS, tiles). The next free place of each block's
        share; modified in place.
    entry_out : uint64 array
    """
    n = len(visible)
    bits = depth.view(np.uint64)  # positive floats sort like their bits
    taken = jit.none_taken()
    for _ in prange(jit.TAKERS):
        block = jit.take_next(taken)
        while block < BLOCKS:
            mine = place[block]
            for k in range(block * n // BLOCKS, (block + 1) * n // BLOCKS):
                for o in range(k * LANES, k * LANES + visible[k]):
                    key = bits[o] << np.uint64(1) & ~RECORD_MASK | np.uint64(o)
                    for j in range(box[o, 2] >> TILE_SHIFT, (box[o, 3] >> TILE_SHIFT) + 1):
                        for i in range(box[o, 0] >> TILE_SHIFT, (box[o, 1] >> TILE_SHIFT) + 1):
                            tile = j * across + i
                            entry_out[mine[tile]] = key
                            mine[tile] += 1
            block = jit.take_next(taken)


@jit.device_function
def sort_keys(key, spare, histogram, n):
    """Sort key[:n]: by insertion if few, else by radix and a final pass of insertion.

    The radix passes look at the highest 16 bits of the depths' span, two digits of a byte: after
    them hardly a key is more than a place or two from where it belongs. Of MANY keys they look at
    all bits: millions of splats in one place may share the highest, and insertion takes the square
    of their number. Whole keys are compared at the end, so ties in depth end in the order of the
    records.
    """
    if n >= FEW:
        low, high = key[0], key[0]
        for i in range(n):
            low, high = min(low, key[i]), max(high, key[i])
        span = (high - low) >> RECORD_SHIFT
        shift = RECORD_SHIFT
        while n < MANY and span >> np.uint64(2 * DIGIT_BITS):
            span >>= np.uint64(1)
            shift += np.uint64(1)
        is_left = True
        while is_left:
            scatter(key, spare, histogram, n, low, shift)
            scatter(spare, key, histogram, n, low, min(shift + np.uint64(DIGIT_BITS), LAST_BIT))
            span >>= np.uint64(2 * DIGIT_BITS)
            shift += np.uint64(2 * DIGIT_BITS)
            is_left = span > 0
    for i in range(1, n):
        k = key[i]
        j = i - 1
        while j >= 0 and key[j] > k:
            key[j + 1] = key[j]
            j -= 1
        key[j + 1] = k


@jit.device_function
def scatter(source, target, histogram, n, low, shift):
    """Sort source[:n] into `target` by one digit, keeping the order of equal ones."""
    histogram[:] = 0
    for i in range(n):
        histogram[((source[i] - low) >> shift) & DIGIT] += 1
    place = 0
    for d in range(DIGITS):
        number = histogram[d]
        histogram[d] = place
        place += number
    for i in range(n):
        d = ((source[i] - low) >> shift) & DIGIT
        target[histogram[d]] = source[i]
        histogram[d] += 1
