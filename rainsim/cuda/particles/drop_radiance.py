"""Twin of `rainsim.particles.drop_radiance`: a block of threads for each cell and each place."""

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.particles.drop_radiance import (
    CELLS,
    GRID,
    RINGS,
    THROWN_BACK,
    TURNS,
    Behind,
    cell_edges,
    drop_depth,
    line_of_sight,
    refracted,
    sheet_light,
)

_RAYS = RINGS * TURNS
_SHARE = np.float32(1 / _RAYS)
_SUMMERS = 64  # threads that add up the pixels of a cell


class DropLight:
    """The light of drops and of sheets over a picture, (9, 13, 3), see `falling_light`."""

    def __init__(self):
        self.drops, self.sheets = (cuda.device_array((*GRID, 3), np.float32) for _ in range(2))
        self._behind = Behind(
            cuda.device_array((*CELLS, 3), np.float32), cuda.device_array(CELLS, np.float32)
        )

    def find(self, picture, depth, tables):
        """Queue the field over a picture and its depth; return it as drops and sheets."""
        view, camera = tables.view, tables.camera
        coarsen[CELLS[0] * CELLS[1], _SUMMERS](picture, depth, *self._behind)
        fill_field[GRID[0] * GRID[1], _RAYS](
            tables["gloss"], self._behind, tables["around"], view.ground_from_camera, camera.lens,
            camera.size, self.drops, self.sheets,
        )  # fmt: skip
        return self.drops, self.sheets


@cuda_kernel
def coarsen(picture, depth, radiance_out, nearness_out):
    """Write the means of a picture's cells, a block for each; see the CPU's `coarse_picture`."""
    parts = cuda.shared.array((_SUMMERS, 4), np.float32)
    rows, columns = nearness_out.shape
    j, i = cuda.blockIdx.x // columns, cuda.blockIdx.x % columns
    top, end = cell_edges(j, rows, depth.shape[0])
    left, right = cell_edges(i, columns, depth.shape[1])
    summer, wide = cuda.threadIdx.x, right - left
    red, green, blue, near = ZERO, ZERO, ZERO, ZERO
    for pixel in range(summer, (end - top) * wide, _SUMMERS):
        row, column = top + pixel // wide, left + pixel % wide
        red += picture[row, column, 0]
        green += picture[row, column, 1]
        blue += picture[row, column, 2]
        near += ONE / depth[row, column]
    parts[summer, 0], parts[summer, 1], parts[summer, 2] = red, green, blue
    parts[summer, 3] = near
    cuda.syncthreads()
    if summer < 4:
        total = ZERO
        for other in range(_SUMMERS):
            total += parts[other, summer]
        mean = total / np.float32((end - top) * wide)
        if summer < 3:
            radiance_out[j, i, summer] = mean
        else:
            nearness_out[j, i] = mean


@cuda_kernel
def fill_field(
    environment, behind, everywhere, ground_from_camera, lens, size, drops_out, sheets_out
):
    """Write the light of drops and splashes over a picture, a thread for each ray of a drop.

    drops_out, sheets_out : float32 device array (9, 13, 3)
    """
    light = cuda.shared.array((_RAYS, 3), np.float32)
    columns = drops_out.shape[1]
    j, i = cuda.blockIdx.x // columns, cuda.blockIdx.x % columns
    ray = cuda.threadIdx.x
    sight = line_of_sight(lens, size, j, i)
    z = drop_depth(behind.nearness, sight, lens, size)
    light[ray, 0], light[ray, 1], light[ray, 2] = refracted(
        environment, behind, ground_from_camera, lens, size, sight, z, ray // TURNS, ray % TURNS
    )
    cuda.syncthreads()
    if ray < 3:
        total = np.float32(0.0)
        for other in range(_RAYS):
            total += light[other, ray]
        drop = total * _SHARE + THROWN_BACK * everywhere[ray]
        drops_out[j, i, ray] = drop
        sheets_out[j, i, ray] = sheet_light(ground_from_camera, sight, drop, everywhere[ray])
