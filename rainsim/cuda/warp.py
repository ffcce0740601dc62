"""Warps: 32 threads, lanes, that work on one thing together. In the simulator a warp is one lane.

Also the stand-ins, for CUDA, of what `rainsim.marks` leaves open: how a mark in a picture is shared
between lanes, and how numbers are added to a picture that all threads draw in.
"""

from __future__ import annotations

import numpy as np

from rainsim import crowns, marks
from rainsim.cuda.jit import FULL, SIMULATED, cuda
from rainsim.cuda.scalars import bits_of

LANES = 1 if SIMULATED else 32
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
    def from_lane(value, source):
        """Return what the lane `source` has for `value`."""
        return value

    @cuda.jit(device=True)
    def lowest(mask):
        """Return the place of the lowest bit of a mask that is not 0."""
        return 0

    @cuda.jit(device=True)
    def most(value):
        """Return the largest of the values that the lanes of the warp have."""
        return value

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
    def from_lane(value, source):
        """Return what the lane `source` has for `value`."""
        return cuda.shfl_sync(FULL, value, source)

    @cuda.jit(device=True)
    def lowest(mask):
        """Return the place of the lowest bit of a mask that is not 0."""
        return cuda.ffs(mask) - 1

    @cuda.jit(device=True)
    def most(value):
        """Return the largest of the values that the lanes of the warp have."""
        for step in (16, 8, 4, 2, 1):
            value = max(value, cuda.shfl_xor_sync(FULL, value, step))
        return value

    @overload(marks.lane, target="cuda")
    def _lane():
        return lambda: np.int64(cuda.laneid)

    @overload(marks.lanes, target="cuda")
    def _lanes():
        return lambda: 32

    @overload(marks.over_lanes, target="cuda")
    def _over_lanes(part):
        def total(part):
            for step in (16, 8, 4, 2, 1):
                part += cuda.shfl_xor_sync(FULL, part, step)
            return part

        return total

    @overload(crowns.next_row, target="cuda")
    def _next_row(count):
        return lambda count: cuda.atomic.add(count, 0, 1)

    @overload(marks.add, target="cuda")
    def _add(picture, at, alpha, bold):
        def atomic(picture, at, alpha, bold):
            cuda.atomic.add(picture, at, np.int64(marks.added(_NOTHING, alpha, bold)))

        return atomic if picture.dtype == int64 else None


@cuda.jit(device=True)
def raise_to(tops, which, value):
    """Raise a shared int32 to the bits of the largest `value`, from 0 up, of the warp's lanes."""
    value = most(value)
    if lane() == 0:
        cuda.atomic.max(tops, which, bits_of(value))
