"""Twin of `rainsim.watersurface`: the smooth surface that pictures show, from solver cells."""

from __future__ import annotations

import numpy as np

from rainsim.cuda.jit import cuda, cuda_device, cuda_kernel
from rainsim.light import bilinear
from rainsim.watersurface import (
    BLOCK,
    GRASS_HEIGHT,
    HALF,
    LEAST_WEIGHT,
    NARROW,
    ONE,
    SURFACE_REACH,
    WET_CELL,
    WIDE,
    ZERO,
)

THREADS = (32, 8)
CELLS_OF_A_BLOCK = 256
HIGH_GRASS = np.float32(GRASS_HEIGHT)
CELLS = np.float32(BLOCK)
DRY = np.float32(-1e6)  # m, the level of a cell without a surface
NO_HEIGHT = np.float32(-1e9)  # m, of the highest water where there is none
FAR = np.int64(1 << 40)


@cuda_kernel
def sum_blocks(bed, depth, mirrors, eta_out, count_out, mean_out, highest):
    """Write the levels of wet cells, count those of each block and take the mean of their levels.

    Levels are relative to the middle of the map; DRY where a cell carries no water surface.
    """
    i, j = cuda.grid(2)
    if i == 0 and j == 0:
        highest[0] = NO_HEIGHT
    ny, nx = bed.shape
    room = cuda.shared.array(THREADS, np.float32)  # rows of a block of threads: one block high
    x, y = cuda.threadIdx.x, cuda.threadIdx.y
    eta, base = DRY, bed[ny // 2, nx // 2]
    if j < ny and i < nx:
        d = depth[j, i]
        if d > WET_CELL and (mirrors[j, i] or d > HIGH_GRASS):
            eta = bed[j, i] - base + d
        eta_out[j, i] = eta
    room[x, y] = eta
    cuda.syncthreads()
    rows, columns = count_out.shape
    block_j, block_i = j // BLOCK, i // BLOCK
    if x % BLOCK == 0 and y == 0 and block_j < rows and block_i < columns:
        count, total = ZERO, ZERO
        for k in range(BLOCK):
            for m in range(BLOCK):
                eta = room[x + m, k]
                if eta > DRY:
                    count += ONE
                    total += eta
        count_out[block_j, block_i] = count
        mean_out[block_j, block_i] = base + total / max(count, ONE)


@cuda_kernel
def nearest_rows(count, row_out):
    """Find, within each block's column, the row of the nearest block that has water; -1 if none."""
    i, j = cuda.grid(2)
    rows, columns = count.shape
    if j >= rows or i >= columns:
        return
    row_out[j, i] = -1
    for away in range(rows):
        if j - away >= 0 and count[j - away, i] > ZERO:
            row_out[j, i] = j - away
            return
        if j + away < rows and count[j + away, i] > ZERO:
            row_out[j, i] = j + away
            return


@cuda_kernel
def nearest_blocks(row, mean, far_out):
    """Give each block the level of the nearest block that has one."""
    i, j = cuda.grid(2)
    rows, columns = row.shape
    if j >= rows or i >= columns:
        return
    best, level = FAR, ZERO
    away = 0
    while away < columns and away * away < best:
        for side in range(2):
            m = i - away if side == 0 else i + away
            if m >= 0 and m < columns:
                k = row[j, m]
                if k >= 0:
                    square = away * away + (k - j) * (k - j)
                    if square < best:
                        best, level = square, mean[k, m]
        away += 1
    far_out[j, i] = level


@cuda_kernel
def spread_rows(eta, wide, weight_out, height_out):
    """Take weighted sums of wet cells along rows."""
    i, j = cuda.grid(2)
    ny, nx = eta.shape
    if j >= ny or i >= nx:
        return
    weight, height = ZERO, ZERO
    for k in range(max(i - 6, 0), min(i + 7, nx)):
        level = eta[j, k]
        if level > DRY:
            w = wide[k - i + 6]
            weight += w
            height += w * level
    weight_out[j, i], height_out[j, i] = weight, height


@cuda_device
def wet_near(eta, j, i):
    """Tell whether a cell within SURFACE_REACH steps is wet."""
    ny, nx = eta.shape
    for k in range(max(j - SURFACE_REACH, 0), min(j + SURFACE_REACH + 1, ny)):
        reach = SURFACE_REACH - abs(k - j)
        for m in range(max(i - reach, 0), min(i + reach + 1, nx)):
            if eta[k, m] > DRY:
                return True
    return False


@cuda_kernel
def spread_columns(
    bed, depth, mirrors, relief, wide, eta, weight, height, far, surface_out, rough_out
):  # fmt: skip
    """Finish the means along columns; write the surface, and the water over the ground."""
    i, j = cuda.grid(2)
    ny, nx = bed.shape
    if j >= ny or i >= nx:
        return
    base = bed[ny // 2, nx // 2]
    total, mean = ZERO, ZERO
    for k in range(max(j - 6, 0), min(j + 7, ny)):
        w = wide[k - j + 6]
        total += w * weight[k, i]
        mean += w * height[k, i]
    rough = ZERO
    if total > LEAST_WEIGHT:
        surface = base + mean / total
        if (mirrors[j, i] or depth[j, i] > HIGH_GRASS) and wet_near(eta, j, i):
            rough = max(surface - bed[j, i] - relief[j, i], ZERO)
    else:
        surface = bilinear(
            far, (np.float32(i) + HALF) / CELLS - HALF, (np.float32(j) + HALF) / CELLS - HALF
        )
    surface_out[j, i], rough_out[j, i] = surface, rough


@cuda_kernel
def soften(rough, surface, narrow, over_out, highest):
    """Blur the water's depth a little and find the highest water."""
    room = cuda.shared.array(CELLS_OF_A_BLOCK, np.float32)
    i, j = cuda.grid(2)
    tid = cuda.threadIdx.y * cuda.blockDim.x + cuda.threadIdx.x
    ny, nx = rough.shape
    top = NO_HEIGHT
    if j < ny and i < nx:
        over = ZERO
        for m in range(max(i - 3, 0), min(i + 4, nx)):
            column = ZERO
            for k in range(max(j - 3, 0), min(j + 4, ny)):
                column += narrow[k - j + 3] * rough[k, m]
            over += narrow[m - i + 3] * column
        over_out[j, i] = over
        if over > ZERO:
            top = surface[j, i]
    room[tid] = top
    cuda.syncthreads()
    half = CELLS_OF_A_BLOCK // 2
    while half > 0:
        if tid < half:
            room[tid] = max(room[tid], room[tid + half])
        cuda.syncthreads()
        half //= 2
    if tid == 0 and room[0] > highest[0]:
        cuda.atomic.max(highest, 0, room[0])


class WaterSurface:
    """The surface over a device's water.

    Parameters
    ----------
    bed, relief : ndarray of shape (ny, nx), float32 [m]
    mirrors : ndarray of shape (ny, nx), bool
        See `rainsim.watersurface.water_surface`.
    depth : device array of shape (ny, nx), float32 [m]
        Of the water; read at each launch.
    stream : numba.cuda.stream

    Attributes
    ----------
    surface, over : device arrays of shape (ny, nx), float32 [m]
        Height of the surface, depth of the water that pictures show.
    highest : device array of shape (1,), float32 [m]
        Of the surface where there is water; NO_HEIGHT if there is none.
    """

    def __init__(self, bed, relief, mirrors, depth, stream):
        shape = bed.shape
        self.depth, self.stream = depth, stream
        self._bed, self._relief = cuda.to_device(bed), cuda.to_device(relief)
        self._mirrors = cuda.to_device(np.ascontiguousarray(mirrors))
        self._wide, self._narrow = cuda.to_device(WIDE), cuda.to_device(NARROW)
        self.surface, self.over, self._weight, self._height, self._rough, self._eta = (
            cuda.device_array(shape, np.float32) for _ in range(6)
        )
        coarse = -(-shape[0] // BLOCK), -(-shape[1] // BLOCK)
        self._count, self._mean, self._far = (
            cuda.device_array(coarse, np.float32) for _ in range(3)
        )
        self._row = cuda.device_array(coarse, np.int32)
        self.highest = cuda.device_array(1, np.float32)

    def launch(self):
        """Queue the surface of the water as it is then."""

        def over(shape):
            across, down = THREADS
            return (-(-shape[1] // across), -(-shape[0] // down)), THREADS, self.stream

        cells, coarse = over(self.surface.shape), over(self._count.shape)
        water = self._bed, self.depth, self._mirrors
        sum_blocks[cells](*water, self._eta, self._count, self._mean, self.highest)
        nearest_rows[coarse](self._count, self._row)
        nearest_blocks[coarse](self._row, self._mean, self._far)
        spread_rows[cells](self._eta, self._wide, self._weight, self._height)
        spread_columns[cells](
            *water, self._relief, self._wide, self._eta, self._weight, self._height, self._far,
            self.surface, self._rough,
        )  # fmt: skip
        soften[cells](self._rough, self.surface, self._narrow, self.over, self.highest)
