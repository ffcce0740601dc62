"""Twin of `reflection.screen_space`: the depth that water can mirror, and hits of its rays."""

import numpy as np

from rainsim.constants import ZERO
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.reflection.planar_mirror import mirror_of
from rainsim.reflection.screen_space import NOT_GROUND, level_hit
from rainsim.reflection.water_shading import surface_at
from rainsim.ssr import BLOCK, DepthBlocks, joined_at

NOWHERE = np.float32(np.inf)
WIDE = 32  # threads of a row of `keep_tall`; BLOCK such rows are a block of them
PATCH = (8, 4) if SIMULATED else (8, 32)  # threads of a block of `find_hits`: a warp has 8 x 4
JOINERS = 32 if SIMULATED else 128  # threads of a block of `join_bounds`


@cuda_kernel
def keep_tall(depth, clearance, tall_out, bounds_out):
    """Keep the depth of all but the ground; see `reflection.screen_space`, `ssr.block_bounds`.

    A block of threads takes a row of blocks of pixels.
    """
    lows = cuda.shared.array((BLOCK, WIDE), np.float32)
    highs = cuda.shared.array((BLOCK, WIDE), np.float32)
    column, row = cuda.grid(2)
    x, y = cuda.threadIdx.x, cuda.threadIdx.y
    height, width = depth.shape
    low, high = NOWHERE, -NOWHERE
    if row < height and column < width:
        value = NOWHERE if clearance[row, column] < NOT_GROUND else depth[row, column]
        tall_out[row, column] = value
        if value < NOWHERE:
            low, high = value, value
    lows[y, x], highs[y, x] = low, high
    cuda.syncthreads()
    if y == 0:
        for k in range(1, BLOCK):
            low, high = min(low, lows[k, x]), max(high, highs[k, x])
        lows[0, x], highs[0, x] = low, high
    cuda.syncthreads()
    if y == 0 and x % BLOCK == 0 and row < height and column < width:
        for k in range(1, BLOCK):
            low, high = min(low, lows[0, x + k]), max(high, highs[0, x + k])
        at = (row // BLOCK) * ((width + BLOCK - 1) // BLOCK) + column // BLOCK
        bounds_out[at, 0], bounds_out[at, 1] = low, high


@cuda_kernel
def join_bounds(height, width, bounds_out):
    """Write the bounds of blocks with their neighbours: see `block_bounds`."""
    rows, columns = (height + BLOCK - 1) // BLOCK, (width + BLOCK - 1) // BLOCK
    at = rows * columns + cuda.grid(1)
    if at < bounds_out.shape[0]:
        low, high = joined_at(bounds_out, rows, columns, at)
        bounds_out[at, 0], bounds_out[at, 1] = low, high


@cuda_kernel
def find_hits(hit, coverage, tall, bounds, view, settings, mirror_range, distance_out):
    """March from the water that no mirror serves; see `reflection.screen_space.march_light`.

    In a kernel of its own, so that many threads are there to wait for memory.

    settings : MarchSettings
    mirror_range : float32 device array (k, 3) [m]. See `MirrorArrays`.
    distance_out : float32 array (height, width) [m]. What `rainsim.ssr.march`
        returns; only where it was asked.
    """
    column, row = cuda.grid(2)
    height, width = coverage.shape
    if row >= height or column >= width or not coverage[row, column] > ZERO:
        return
    if hit[row, column] < ZERO:  # on a top that slopes
        return
    water = surface_at(view, row, column, hit[row, column])
    if mirror_of(mirror_range, water.z) < 0:
        distance_out[row, column] = level_hit(view, DepthBlocks(tall, bounds), settings, water)
