"""Twin of `rainsim.particles.drop_radiance`: a block of threads for each place of the grid."""

from __future__ import annotations

import numpy as np

from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.particles.drop_radiance import (
    GRID,
    RINGS,
    THROWN_BACK,
    TURNS,
    line_of_sight,
    refracted,
    sheet_light,
)

_RAYS = RINGS * TURNS
_SHARE = np.float32(1 / _RAYS)


class DropLight:
    """The light of drops over a picture.

    Parameters
    ----------
    frame : DeviceFrame

    Attributes
    ----------
    drops, sheets : device array of shape (7, 9, 3), float32
        See `rainsim.particles.drop_radiance.falling_light`.
    """

    def __init__(self, frame):
        self._frame = frame
        self.drops, self.sheets = (cuda.device_array((*GRID, 3), np.float32) for _ in range(2))

    def launch(self, stream=None):
        """Queue the field of the present camera, on another stream than the frame's if given."""
        frame = self._frame
        now, stream = frame.uniforms, frame.stream if stream is None else stream
        fill_field[GRID[0] * GRID[1], _RAYS, stream](
            frame.gloss, now["around"], now["turn"], now["lens"], now["size"], self.drops,
            self.sheets,
        )  # fmt: skip


@cuda_kernel
def fill_field(environment, everywhere, ground_from_camera, lens, size, drops_out, sheets_out):
    """Write the light of drops and splashes over a picture, a thread for each ray of a drop.

    Parameters
    ----------
    environment : device array of shape (rows, columns, 3), float32
    everywhere : device array of shape (3,), float32
    ground_from_camera : device array of shape (3, 3), float32
    lens : device array of shape (4,), float32 [px]
    size : device array of shape (2,), float32 [px]
        Width and height of the picture.
    drops_out, sheets_out : device array of shape (7, 9, 3), float32
    """
    light = cuda.shared.array((_RAYS, 3), np.float32)
    columns = drops_out.shape[1]
    j, i = cuda.blockIdx.x // columns, cuda.blockIdx.x % columns
    ray = cuda.threadIdx.x
    sight = line_of_sight(lens, size, j, i)
    light[ray, 0], light[ray, 1], light[ray, 2] = refracted(
        environment, ground_from_camera, sight, ray // TURNS, ray % TURNS
    )
    cuda.syncthreads()
    if ray < 3:
        total = np.float32(0.0)
        for other in range(_RAYS):
            total += light[other, ray]
        drop = total * _SHARE + THROWN_BACK * everywhere[ray]
        drops_out[j, i, ray] = drop
        sheets_out[j, i, ray] = sheet_light(ground_from_camera, sight, drop, everywhere[ray])
