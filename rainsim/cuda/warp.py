"""Warps: 32 threads, lanes, that work on one thing together. In the simulator a warp is one lane.

Most marks in a picture are short: a quarter of a warp, a group, draws one; a whole warp draws a
large one. A block of threads is a row of lanes by as many groups. This module also replaces, on
CUDA, the functions of `particles.line_raster` and `particles.crown` by which threads share a mark
and add to a picture that all threads draw in.
"""

import numpy as np

from rainsim.cuda.jit import FULL, SIMULATED, cuda
from rainsim.cuda.scalars import bits_of
from rainsim.particles import crown, line_raster

GROUP = 1 if SIMULATED else 8  # lanes that share a mark, or a cube's drops
THREADS = 4 if SIMULATED else 128  # of a block
GROUPS = GROUP, THREADS // GROUP  # shape of a block of groups
_NOTHING = np.int32(0)

if SIMULATED:

    @cuda.jit(device=True)
    def lane():
        """Return the thread's place in its warp."""
        return 0

    @cuda.jit(device=True)
    def ballot(flag):
        """Return a bit for each lane of the warp: whether its `flag` is true."""
        return 1 if flag else 0

    @cuda.jit(device=True)
    def most(value):
        """Return the largest of the values that the lanes of the warp have."""
        return value

    @cuda.jit(device=True)
    def least(value):
        """Return the smallest of the values that the lanes of the warp have."""
        return value

    @cuda.jit(device=True)
    def claim_row(counter, which, wants):
        """Count the lanes of the warp that want a place in a list; return the lane's place."""
        return cuda.atomic.add(counter, which, 1) if wants else 0

else:
    from numba import int64
    from numba.extending import overload

    @cuda.jit(device=True)
    def lane():
        """Return the thread's place in its warp."""
        return cuda.laneid

    @cuda.jit(device=True)
    def ballot(flag):
        """Return a bit for each lane of the warp: whether its `flag` is true."""
        # As a number that is not negative: as an int32 the last lane's bit would be a sign.
        return np.int64(cuda.ballot_sync(FULL, flag)) & FULL

    @cuda.jit(device=True)
    def most(value):
        """Return the largest of the values that the lanes of the warp have."""
        for step in (16, 8, 4, 2, 1):
            value = max(value, cuda.shfl_xor_sync(FULL, value, step))
        return value

    @cuda.jit(device=True)
    def least(value):
        """Return the smallest of the values that the lanes of the warp have."""
        for step in (16, 8, 4, 2, 1):
            value = min(value, cuda.shfl_xor_sync(FULL, value, step))
        return value

    @cuda.jit(device=True)
    def claim_row(counter, which, wants):
        """Count the lanes of the warp that want a place in a list; return the lane's place."""
        mask = np.uint32(ballot(wants))
        first = 0
        if cuda.laneid == 0 and mask != 0:
            first = cuda.atomic.add(counter, which, cuda.popc(mask))
        first = cuda.shfl_sync(FULL, first, 0)
        before = np.uint32((np.int64(1) << np.int64(cuda.laneid)) - 1)
        return first + cuda.popc(mask & before)

    @overload(line_raster.lane, target="cuda")
    def _lane():
        return lambda: np.int64(cuda.threadIdx.x)

    @overload(line_raster.lanes, target="cuda")
    def _lanes():
        return lambda: np.int64(cuda.blockDim.x)

    @overload(line_raster.over_lanes, target="cuda")
    def _over_lanes(part):
        def total(part):
            step = cuda.blockDim.x >> 1
            group = FULL if step == 16 else np.int64(255) << (np.int64(cuda.laneid) & 24)
            while step > 0:
                part += cuda.shfl_xor_sync(group, part, step)
                step >>= 1
            return part

        return total

    @overload(crown.next_row, target="cuda")
    def _next_row(count):
        def together(count):
            # One lane counts for all that are here; one by one they would wait for each other.
            here = np.uint32(cuda.activemask())
            leader = cuda.ffs(here) - 1
            row = 0
            if cuda.laneid == leader:
                row = cuda.atomic.add(count, 0, cuda.popc(here))
            row = cuda.shfl_sync(here, row, leader)
            before = np.uint32((np.int64(1) << np.int64(cuda.laneid)) - 1)
            return row + cuda.popc(here & before)

        return together

    @overload(line_raster.add, target="cuda")
    def _add(picture, at, alpha, bold):
        def atomic(picture, at, alpha, bold):
            cuda.atomic.add(picture, at, np.int64(line_raster.added(_NOTHING, alpha, bold)))

        return atomic if picture.dtype == int64 else None


@cuda.jit(device=True)
def raise_to(tops, which, value):
    """Raise a shared int32 to the bits of the largest `value`, from 0 up, of the warp's lanes."""
    value = most(value)
    if lane() == 0:
        cuda.atomic.max(tops, which, bits_of(value))


@cuda.jit(device=True)
def lower_to(bottoms, which, value):
    """Lower a shared int32 to the bits of the smallest `value`, from 0 up, of the warp's lanes."""
    value = least(value)
    if lane() == 0:
        cuda.atomic.min(bottoms, which, bits_of(value))
