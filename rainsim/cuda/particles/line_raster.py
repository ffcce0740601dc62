"""The picture of optical depths that rain is drawn in, on a CUDA device: depth in, alpha out.

Twins of `particles.line_raster.read_depth` and `resolve_band`; the marks themselves are the CPU's,
see `cuda.warp`.
"""

import numpy as np

from rainsim.constants import ZERO
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.cuda.scalars import bits_of, float_of
from rainsim.cuda.warp import lower_to, raise_to
from rainsim.particles.line_raster import DEPTH_TILE, alpha_of

TILE = 32  # px, side of what a block of `resolve` turns into alpha
# From row to row in shared memory, so that a column does not lie in one bank.
_DEPTH_PITCH, _PITCH = DEPTH_TILE + 1, TILE + 1
_MOST = np.float32(np.inf)


@cuda_kernel
def read_depth(depth, columns_out, tile_depth_out):
    """Copy a depth picture column by column, and find each tile's greatest and least depth.

    tile_depth_out : float32 device array (2, rows, columns) [m]. One block of
        threads for each tile.
    """
    room = cuda.shared.array((DEPTH_TILE, _DEPTH_PITCH), np.float32)
    ends = cuda.shared.array(2, np.int32)
    height, width = depth.shape
    left, top = cuda.blockIdx.x * DEPTH_TILE, cuda.blockIdx.y * DEPTH_TILE
    wide, high = min(DEPTH_TILE, width - left), min(DEPTH_TILE, height - top)
    x, y = cuda.threadIdx.x, cuda.threadIdx.y
    if x == 0 and y == 0:
        ends[0], ends[1] = 0, bits_of(_MOST)
    cuda.syncthreads()
    most, least = ZERO, _MOST
    for row in range(y, high, cuda.blockDim.y):
        for column in range(x, wide, cuda.blockDim.x):
            z = depth[top + row, left + column]
            room[row, column] = z
            most, least = max(most, z), min(least, z)
    raise_to(ends, 0, most)
    lower_to(ends, 1, least)
    cuda.syncthreads()
    for column in range(y, wide, cuda.blockDim.y):
        for row in range(x, high, cuda.blockDim.x):
            columns_out[(left + column) * height + top + row] = room[row, column]
    if x == 0 and y == 0:
        tile_depth_out[0, cuda.blockIdx.y, cuda.blockIdx.x] = float_of(ends[0])
        tile_depth_out[1, cuda.blockIdx.y, cuda.blockIdx.x] = float_of(ends[1])


@cuda_kernel
def resolve(picture, alpha_out):
    """Turn summed optical depths (width * height,) into alpha (height, width), and blank them."""
    room = cuda.shared.array((TILE, _PITCH), np.float32)
    height, width = alpha_out.shape
    left, top = cuda.blockIdx.x * TILE, cuda.blockIdx.y * TILE
    wide, high = min(TILE, width - left), min(TILE, height - top)
    x, y = cuda.threadIdx.x, cuda.threadIdx.y
    for column in range(y, wide, cuda.blockDim.y):
        for row in range(x, high, cuda.blockDim.x):
            at = (left + column) * height + top + row
            units = picture[at]
            if units != 0:
                picture[at] = 0
            room[row, column] = alpha_of(units)
    cuda.syncthreads()
    for row in range(y, high, cuda.blockDim.y):
        for column in range(x, wide, cuda.blockDim.x):
            alpha_out[top + row, left + column] = room[row, column]
