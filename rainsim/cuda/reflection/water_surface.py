"""Twin of `reflection.water_surface`: the smooth surface that pictures show, from solver cells."""

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.cuda.jit import cuda, cuda_device, cuda_kernel
from rainsim.cuda.reflection.puddle_rings import share_wet, spread_rings
from rainsim.errors import ParameterError
from rainsim.numerics.interpolation import bilinear
from rainsim.reflection.puddle_rings import block_shape
from rainsim.reflection.water_surface import (
    BLOCK,
    HIGH_GRASS,
    LEAST_WEIGHT,
    NARROW,
    SURFACE_REACH,
    WET_CELL,
    WIDE,
    is_smooth,
)

THREADS = SIDE, HIGH = 32, 8
CELLS_OF_A_BLOCK = SIDE * HIGH  # threads; a block of them takes a square of SIDE x SIDE cells
LINE = 128  # threads that look along a row or column of blocks of cells
MOST_BLOCKS = 4096  # in a row or column
WIDE_REACH, SOFT_REACH = len(WIDE) // 2, len(NARROW) // 2
SPREAD_SIDE, SOFT_SIDE = SIDE + 2 * WIDE_REACH, SIDE + 2 * SOFT_REACH
CELLS = np.float32(BLOCK)
DRY = np.float32(-1e6)  # m, the level of a cell without a surface
NO_HEIGHT = np.float32(-1e9)  # m, of the highest water where there is none
FAR = np.int64(1 << 40)


@cuda_device
def level_of(bed, depth, mirrors, j, i, base):
    """Return the level of a cell's water over `base` [m]; DRY if it carries no water surface."""
    d = depth[j, i]
    if d > WET_CELL and is_smooth(d, mirrors[j, i]):
        return bed[j, i] - base + d
    return DRY


@cuda_kernel
def sum_blocks(bed, depth, mirrors, count_out, mean_out, highest):
    """Count the wet cells of each block and take the mean of their levels."""
    i, j = cuda.grid(2)
    if i == 0 and j == 0:
        highest[0] = NO_HEIGHT
    ny, nx = bed.shape
    room = cuda.shared.array(THREADS, np.float32)  # rows of a block of threads: one block high
    x, y = cuda.threadIdx.x, cuda.threadIdx.y
    eta, base = DRY, bed[ny // 2, nx // 2]
    if j < ny and i < nx:
        eta = level_of(bed, depth, mirrors, j, i, base)
    room[x, y] = eta
    cuda.syncthreads()
    count, total = ZERO, ZERO
    if y == 0:
        for k in range(BLOCK):
            eta = room[x, k]
            if eta > DRY:
                count += ONE
                total += eta
        room[x, 0], room[x, 1] = count, total
    cuda.syncthreads()
    rows, columns = count_out.shape
    block_j, block_i = j // BLOCK, i // BLOCK
    if x % BLOCK == 0 and y == 0 and block_j < rows and block_i < columns:
        for k in range(1, BLOCK):
            count += room[x + k, 0]
            total += room[x + k, 1]
        count_out[block_j, block_i] = count
        mean_out[block_j, block_i] = base + total / max(count, ONE)


@cuda_kernel
def nearest_rows(count, row_out):
    """Find, within each block's column, the row of the nearest block that has water; -1 if none.

    A block of threads takes a column.
    """
    wet = cuda.shared.array(MOST_BLOCKS, np.float32)
    rows, i = count.shape[0], cuda.blockIdx.x
    for j in range(cuda.threadIdx.x, rows, cuda.blockDim.x):
        wet[j] = count[j, i]
    cuda.syncthreads()
    for j in range(cuda.threadIdx.x, rows, cuda.blockDim.x):
        found, away = -1, 0
        while found < 0 and away < rows:
            if j + away < rows and wet[j + away] > ZERO:
                found = j + away
            if j - away >= 0 and wet[j - away] > ZERO:
                found = j - away
            away += 1
        row_out[j, i] = found


@cuda_kernel
def nearest_blocks(row, mean, far_out):
    """Write for each block the level of the nearest block that has one.

    A block of threads takes a row.
    """
    nearest = cuda.shared.array(MOST_BLOCKS, np.int32)
    columns, j = row.shape[1], cuda.blockIdx.x
    for i in range(cuda.threadIdx.x, columns, cuda.blockDim.x):
        nearest[i] = row[j, i]
    cuda.syncthreads()
    for i in range(cuda.threadIdx.x, columns, cuda.blockDim.x):
        best, at = FAR, -1
        away = 0
        while away < columns and away * away < best:
            for side in range(2):
                m = i - away if side == 0 else i + away
                if m >= 0 and m < columns:
                    k = nearest[m]
                    square = away * away + (k - j) * (k - j)
                    if k >= 0 and square < best:
                        best, at = square, m
            away += 1
        far_out[j, i] = mean[nearest[at], at] if at >= 0 else ZERO


@cuda_device
def wet_near(eta, j, i):
    """Tell whether a cell within SURFACE_REACH steps of (j, i) is wet, that is `eta` is above DRY.

    The cell (j, i) must lie SURFACE_REACH from the edges of `eta`, a block's levels, or farther.
    """
    for k in range(-SURFACE_REACH, SURFACE_REACH + 1):
        reach = SURFACE_REACH - abs(k)
        for m in range(-reach, reach + 1):
            if eta[j + k, i + m] > DRY:
                return True
    return False


@cuda_kernel
def spread(bed, depth, mirrors, relief, wide, far, surface_out, rough_out):
    """Take Gaussian means of the wet cells' levels; write the surface, and the water over ground.

    A block of threads takes a square of SIDE x SIDE cells and all that is within the mean's reach.
    """
    eta = cuda.shared.array((SPREAD_SIDE, SPREAD_SIDE), np.float32)
    weight = cuda.shared.array((SPREAD_SIDE, SIDE), np.float32)
    height = cuda.shared.array((SPREAD_SIDE, SIDE), np.float32)
    x, y = cuda.threadIdx.x, cuda.threadIdx.y
    ny, nx = bed.shape
    base = bed[ny // 2, nx // 2]
    left, top = cuda.blockIdx.x * SIDE, cuda.blockIdx.y * SIDE
    wet = 0
    for row in range(y, SPREAD_SIDE, HIGH):
        for column in range(x, SPREAD_SIDE, SIDE):
            j, i = top + row - WIDE_REACH, left + column - WIDE_REACH
            level = DRY
            if j >= 0 and i >= 0 and j < ny and i < nx:
                level = level_of(bed, depth, mirrors, j, i, base)
            if level > DRY:
                wet = 1
            eta[row, column] = level
    wet = cuda.syncthreads_or(wet)
    if wet:
        for row in range(y, SPREAD_SIDE, HIGH):
            total, mean = ZERO, ZERO
            for m in range(2 * WIDE_REACH + 1):
                level = eta[row, x + m]
                if level > DRY:
                    total += wide[m]
                    mean += wide[m] * level
            weight[row, x], height[row, x] = total, mean
    cuda.syncthreads()
    for row in range(y, SIDE, HIGH):
        j, i = top + row, left + x
        if j >= ny or i >= nx:
            continue
        total, mean = ZERO, ZERO
        if wet:
            for m in range(2 * WIDE_REACH + 1):
                total += wide[m] * weight[row + m, x]
                mean += wide[m] * height[row + m, x]
        rough = ZERO
        if total > LEAST_WEIGHT:
            surface = base + mean / total
            if is_smooth(depth[j, i], mirrors[j, i]):
                # Depth counts from the tips of the grass.
                lift = relief[j, i] + (ZERO if mirrors[j, i] else HIGH_GRASS)
                if wet_near(eta, row + WIDE_REACH, x + WIDE_REACH):
                    rough = max(surface - bed[j, i] - lift, ZERO)
        else:
            surface = bilinear(
                far, (np.float32(i) + HALF) / CELLS - HALF, (np.float32(j) + HALF) / CELLS - HALF
            )
        surface_out[j, i], rough_out[j, i] = surface, rough


@cuda_kernel
def soften(rough, surface, narrow, over_out, highest):
    """Blur the water's depth a little and find the highest water; squares as in `spread`."""
    around = cuda.shared.array((SOFT_SIDE, SOFT_SIDE), np.float32)
    means = cuda.shared.array((SIDE, SOFT_SIDE), np.float32)
    tops = cuda.shared.array(CELLS_OF_A_BLOCK, np.float32)
    x, y = cuda.threadIdx.x, cuda.threadIdx.y
    tid = y * SIDE + x
    ny, nx = rough.shape
    left, top = cuda.blockIdx.x * SIDE, cuda.blockIdx.y * SIDE
    any_water = 0
    for row in range(y, SOFT_SIDE, HIGH):
        for column in range(x, SOFT_SIDE, SIDE):
            j, i = top + row - SOFT_REACH, left + column - SOFT_REACH
            value = ZERO
            if j >= 0 and i >= 0 and j < ny and i < nx:
                value = rough[j, i]
            if value > ZERO:
                any_water = 1
            around[row, column] = value
    any_water = cuda.syncthreads_or(any_water)
    if any_water:
        for row in range(y, SIDE, HIGH):
            for column in range(x, SOFT_SIDE, SIDE):
                value = ZERO
                for m in range(2 * SOFT_REACH + 1):
                    value += narrow[m] * around[row + m, column]
                means[row, column] = value
    cuda.syncthreads()
    highest_here = NO_HEIGHT
    for row in range(y, SIDE, HIGH):
        j, i = top + row, left + x
        if j < ny and i < nx:
            over = ZERO
            if any_water:
                for m in range(2 * SOFT_REACH + 1):
                    over += narrow[m] * means[row, x + m]
            over_out[j, i] = over
            if over > ZERO:
                highest_here = max(highest_here, surface[j, i])
    tops[tid] = highest_here
    cuda.syncthreads()
    half = CELLS_OF_A_BLOCK // 2
    while half > 0:
        if tid < half:
            tops[tid] = max(tops[tid], tops[tid + half])
        cuda.syncthreads()
        half //= 2
    if tid == 0 and tops[0] > highest[0]:
        cuda.atomic.max(highest, 0, tops[0])


class WaterSurface:
    """The surface over a device's water.

    bed, relief : float32 array (ny, nx) [m]
    mirrors : bool array (ny, nx). See
        `rainsim.reflection.water_surface.water_surface`.
    reach : float32 array (2 n + 1, 2 n + 1). See
        `rainsim.water.ripples.block_reach`.
    surface, over : device arrays of shape (ny, nx), float32 [m]. Height of the
        surface, depth of the water that pictures show.
    highest : float32 device array (1,) [m]. Of the surface where there is water;
        NO_HEIGHT if there is none.
    shores : float32 device array (rows, columns). See
        `rainsim.reflection.puddle_rings`.
    """

    def __init__(self, bed, relief, mirrors, reach):
        shape = bed.shape
        self._bed, self._relief = cuda.to_device(bed), cuda.to_device(relief)
        self._mirrors = cuda.to_device(np.ascontiguousarray(mirrors))
        self._wide, self._narrow = cuda.to_device(WIDE), cuda.to_device(NARROW)
        self.surface, self.over, self._rough = (
            cuda.device_array(shape, np.float32) for _ in range(3)
        )
        coarse = -(-shape[0] // BLOCK), -(-shape[1] // BLOCK)
        if max(coarse) > MOST_BLOCKS:
            raise ParameterError(
                f"the map has {shape} cells; backend cuda takes at most {MOST_BLOCKS * BLOCK} in a "
                "row; take a coarser --spacing or backend cpu"
            )
        self._count, self._mean, self._far = (
            cuda.device_array(coarse, np.float32) for _ in range(3)
        )
        self._row = cuda.device_array(coarse, np.int32)
        self.highest = cuda.device_array(1, np.float32)
        self._reach = cuda.to_device(reach)
        self._wet_share, self.shores = (
            cuda.device_array(block_shape(shape), np.float32) for _ in range(2)
        )

    def draw(self, depth):
        """Queue the making of the surface of water of a depth, device array (ny, nx) [m]."""
        rows, columns = self.surface.shape
        cells = (-(-columns // SIDE), -(-rows // HIGH)), THREADS
        squares = (-(-columns // SIDE), -(-rows // SIDE)), THREADS
        rows, columns = self._count.shape
        water = self._bed, depth, self._mirrors
        sum_blocks[cells](*water, self._count, self._mean, self.highest)
        nearest_rows[columns, LINE](self._count, self._row)
        nearest_blocks[rows, LINE](self._row, self._mean, self._far)
        spread[squares](*water, self._relief, self._wide, self._far, self.surface, self._rough)
        soften[squares](self._rough, self.surface, self._narrow, self.over, self.highest)
        rows, columns = self.shores.shape
        blocks = (-(-columns // SIDE), -(-rows // HIGH)), THREADS
        share_wet[blocks](depth, self._mirrors, self._wet_share)
        spread_rings[blocks](self._wet_share, self._reach, self.shores)
