"""Twin of `rainsim.particles.drop_radiance`: the picture behind drops, a block for each cell.

The host reads the cells and finds the light of the drops by them, as for the CPU.
"""

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.cuda.driver import fetch, send
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.particles.drop_radiance import CELLS, GRID, Behind, cell_edges, light_before

_SUMMERS = 64  # threads that add up the pixels of a cell


class DropLight:
    """The light of drops and of sheets over a picture, (9, 13, 3), see `falling_light`."""

    def __init__(self):
        self._behind = Behind(
            cuda.device_array((*CELLS, 3), np.float32), cuda.device_array(CELLS, np.float32)
        )
        self._light = tuple(cuda.device_array((*GRID, 3), np.float32) for _ in range(2))

    def find(self, picture, depth, environment, everywhere, view):
        """Return the fields of drops and sheets over a picture, device arrays; waits.

        environment, everywhere, view. Of the host, see `falling_light`.
        """
        coarsen[CELLS[0] * CELLS[1], _SUMMERS](picture, depth, *self._behind)
        behind = Behind(*(fetch(part) for part in self._behind))
        pose = view.ground_from_camera, view.lens, depth.shape
        for there, light in zip(
            self._light, light_before(behind, environment, everywhere, *pose), strict=True
        ):
            send(there, light)
        return self._light


@cuda_kernel
def coarsen(picture, depth, radiance_out, nearness_out):
    """Write the means of a picture's cells, a block for each; see `Behind`."""
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
