"""Rings in puddles: how high they are where shores are near, block by block of the map.

Shores take the waves that run on to them. In a puddle of some centimetres most of a ring's way
ends there, so that its water is calmer than a wide puddle in the same rain.
"""

import math

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.jit import cpu_kernel, inlined_function, prange
from rainsim.reflection.water_surface import BLOCK, is_smooth

RING_CELL = np.float32(1e-3)  # m: cells with more water carry rings; thinner water damps them
CELLS = np.float32(BLOCK * BLOCK)


def block_shape(shape):
    """Return the shape of the blocks of a map of cells; two at least, to interpolate between."""
    return tuple(max(-(-n // BLOCK), 2) for n in shape)


def puddle_rings(depth, mirrors, reach):
    """Return the amplitude of rings in each block over that in a usual puddle, at most 1.

    depth : float32 array (ny, nx) [m]. Of the water.
    mirrors : bool array (ny, nx). See `water_surface`.
    reach : float32 array (2 n + 1, 2 n + 1). See `ripples.block_reach`.
    Returns float32 array (rows, columns). Of blocks of BLOCK x BLOCK cells.
    """
    shape = block_shape(depth.shape)
    wet, rings = np.empty(shape, np.float32), np.empty(shape, np.float32)
    share_wet(depth, mirrors, wet)
    spread_rings(wet, reach, rings)
    return rings


@cpu_kernel
def share_wet(depth, mirrors, wet_out):
    """Write the share of each block's cells that carry rings, see `puddle_rings`."""
    rows, columns = wet_out.shape
    for j in prange(rows):
        for i in range(columns):
            wet_out[j, i] = wet_share(depth, mirrors, np.int64(j), i)


@cpu_kernel
def spread_rings(wet, reach, rings_out):
    """Write the amplitudes of `puddle_rings` from the shares of `share_wet`.

    Twin of `ring_amplitude`: the same sums in the same order, but a row at a time, in vectors.
    """
    (rows, columns), side = wet.shape, reach.shape[0]
    around = side // 2
    for row in prange(rows):
        j = np.int64(row)
        line, energy = np.zeros(columns + side, np.float32), np.zeros(columns, np.float32)
        for m in range(max(j - around, 0), min(j + around + 1, rows)):
            for i in range(columns):
                line[i + around] = wet[m, i]
            for k in range(side):
                share = reach[m - j + around, k]
                for i in range(columns):
                    energy[i] += share * line[i + k]
        for i in range(columns):
            rings_out[j, i] = min(math.sqrt(energy[i]), ONE)


@inlined_function
def wet_share(depth, mirrors, row, column):
    """Return the share of the cells of a block that carry rings."""
    ny, nx = depth.shape
    count = ZERO
    for j in range(row * BLOCK, min(row * BLOCK + BLOCK, ny)):
        for i in range(column * BLOCK, min(column * BLOCK + BLOCK, nx)):
            d = depth[j, i]
            if d > RING_CELL and is_smooth(d, mirrors[j, i]):
                count += ONE
    return count / CELLS


@inlined_function
def ring_amplitude(wet, reach, row, column):
    """Return the amplitude of rings in a block, to which those of the blocks around run."""
    (rows, columns), around = wet.shape, reach.shape[0] // 2
    energy = ZERO
    for j in range(max(row - around, 0), min(row + around + 1, rows)):
        for i in range(max(column - around, 0), min(column + around + 1, columns)):
            energy += reach[j - row + around, i - column + around] * wet[j, i]
    return min(math.sqrt(energy), ONE)
