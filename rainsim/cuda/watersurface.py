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
HIGH_GRASS = np.float32(GRASS_HEIGHT)
CELLS = np.float32(BLOCK)
NO_HEIGHT = np.float32(-1e9)  # m, of the highest water where there is none
FAR = np.int64(1 << 40)


@cuda_device
def wet_cell(depth, mirrors, j, i):
    """Tell whether a cell carries the water surface."""
    d = depth[j, i]
    return d > WET_CELL and (mirrors[j, i] or d > HIGH_GRASS)


@cuda_kernel
def sum_blocks(bed, depth, mirrors, count_out, mean_out, highest):
    """Count the wet cells of each block and take the mean of their levels."""
    i, j = cuda.grid(2)
    if i == 0 and j == 0:
        highest[0] = NO_HEIGHT
    rows, columns = count_out.shape
    if j >= rows or i >= columns:
        return
    ny, nx = bed.shape
    count, total = ZERO, ZERO
    for k in range(j * BLOCK, min(j * BLOCK + BLOCK, ny)):
        for m in range(i * BLOCK, min(i * BLOCK + BLOCK, nx)):
            if wet_cell(depth, mirrors, k, m):
                count += ONE
                total += bed[k, m] + depth[k, m]
    count_out[j, i] = count
    mean_out[j, i] = total / max(count, ONE)


@cuda_kernel
def nearest_blocks(count, mean, far_out):
    """Give each block its own level, or that of the nearest block that has one."""
    i, j = cuda.grid(2)
    rows, columns = count.shape
    if j >= rows or i >= columns:
        return
    if count[j, i] > ZERO:
        far_out[j, i] = mean[j, i]
        return
    best, level = FAR, ZERO
    ring = 1
    # Rings outwards, until none farther out can be nearer.
    while ring < max(rows, columns) and np.int64(ring) * ring <= best:
        for k in range(max(j - ring, 0), min(j + ring + 1, rows)):
            edge = k == j - ring or k == j + ring
            step = 1 if edge else 2 * ring
            m = i - ring
            while m <= i + ring:
                if m >= 0 and m < columns and count[k, m] > ZERO:
                    square = np.int64(k - j) * (k - j) + np.int64(m - i) * (m - i)
                    if square < best:
                        best, level = square, mean[k, m]
                m += step
        ring += 1
    far_out[j, i] = level


@cuda_kernel
def spread_rows(bed, depth, mirrors, wide, weight_out, height_out):
    """Take weighted sums of wet cells along rows."""
    i, j = cuda.grid(2)
    ny, nx = bed.shape
    if j >= ny or i >= nx:
        return
    base = bed[ny // 2, nx // 2]
    weight, height = ZERO, ZERO
    for k in range(max(i - 6, 0), min(i + 7, nx)):
        if wet_cell(depth, mirrors, j, k):
            w = wide[k - i + 6]
            weight += w
            height += w * (bed[j, k] + depth[j, k] - base)
    weight_out[j, i], height_out[j, i] = weight, height


@cuda_device
def wet_near(depth, mirrors, j, i):
    """Tell whether a cell within SURFACE_REACH steps is wet."""
    ny, nx = depth.shape
    for k in range(max(j - SURFACE_REACH, 0), min(j + SURFACE_REACH + 1, ny)):
        reach = SURFACE_REACH - abs(k - j)
        for m in range(max(i - reach, 0), min(i + reach + 1, nx)):
            if wet_cell(depth, mirrors, k, m):
                return True
    return False


@cuda_kernel
def spread_columns(
    bed, depth, mirrors, relief, wide, weight, height, far, surface_out, rough_out
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
        if (mirrors[j, i] or depth[j, i] > HIGH_GRASS) and wet_near(depth, mirrors, j, i):
            rough = max(surface - bed[j, i] - relief[j, i], ZERO)
    else:
        surface = bilinear(
            far, (np.float32(i) + HALF) / CELLS - HALF, (np.float32(j) + HALF) / CELLS - HALF
        )
    surface_out[j, i], rough_out[j, i] = surface, rough


@cuda_kernel
def soften(rough, surface, narrow, over_out, highest):
    """Blur the water's depth a little and find the highest water."""
    i, j = cuda.grid(2)
    ny, nx = rough.shape
    if j >= ny or i >= nx:
        return
    over = ZERO
    for m in range(max(i - 3, 0), min(i + 4, nx)):
        column = ZERO
        for k in range(max(j - 3, 0), min(j + 4, ny)):
            column += narrow[k - j + 3] * rough[k, m]
        over += narrow[m - i + 3] * column
    over_out[j, i] = over
    if over > ZERO and surface[j, i] > highest[0]:
        cuda.atomic.max(highest, 0, surface[j, i])


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
        self.surface, self.over, self._weight, self._height, self._rough = (
            cuda.device_array(shape, np.float32) for _ in range(5)
        )
        coarse = -(-shape[0] // BLOCK), -(-shape[1] // BLOCK)
        self._count, self._mean, self._far = (
            cuda.device_array(coarse, np.float32) for _ in range(3)
        )
        self.highest = cuda.device_array(1, np.float32)

    def launch(self):
        """Queue the surface of the water as it is then."""

        def over(shape):
            across, down = THREADS
            return (-(-shape[1] // across), -(-shape[0] // down)), THREADS, self.stream

        cells, coarse = over(self.surface.shape), over(self._count.shape)
        water = self._bed, self.depth, self._mirrors
        sum_blocks[coarse](*water, self._count, self._mean, self.highest)
        nearest_blocks[coarse](self._count, self._mean, self._far)
        spread_rows[cells](*water, self._wide, self._weight, self._height)
        spread_columns[cells](
            *water, self._relief, self._wide, self._weight, self._height, self._far,
            self.surface, self._rough,
        )  # fmt: skip
        soften[cells](self._rough, self.surface, self._narrow, self.over, self.highest)
