"""Twin of `rainsim.particles.spray`: the spray of tyres in a picture on a CUDA device.

The host chooses the drops that are drawn one by one and the clouds of all others; the device draws
both, the drops with the streaks of the rain. A thread takes a pixel through all clouds.
"""

from __future__ import annotations

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.cuda.drops import BLOCKS
from rainsim.cuda.graph import new_version
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.particles.splash_pass import draw_list
from rainsim.cuda.warp import GROUPS
from rainsim.numerics.approximations import exp_minus
from rainsim.particles.spray import (
    MOST_DRAWN,
    cloud_of,
    cloud_table,
    cloud_thickness,
    passes_beside,
)

BLOCK = (8, 4) if SIMULATED else (32, 8)  # threads, one a pixel
ROOM = 1024  # clouds that there is room for at first


@cuda_kernel
def lay_clouds(many, clouds, lens, depth, alpha_out):
    """Put clouds before a picture; see the CPU's kernel.

    Parameters
    ----------
    many : device array of shape (1,), int32
    clouds : device array of shape (room, 5), float32
        See `cloud_table`.
    lens : device array of shape (7,), float32
        Whose first four are fx, fy, cx, cy [px].
    depth, alpha_out : device array of shape (height, width), float32
    """
    column, row = cuda.grid(2)
    height, width = alpha_out.shape
    if row >= height or column >= width:
        return
    a = (np.float32(column) + HALF - lens[2]) / lens[0]
    b = (np.float32(row) + HALF - lens[3]) / lens[1]
    deep, optical = depth[row, column], ZERO
    for n in range(many[0]):
        cloud = cloud_of(clouds[n, 0], clouds[n, 1], clouds[n, 2], clouds[n, 3], clouds[n, 4])
        if not passes_beside(a, b, cloud):
            optical += cloud_thickness(a, b, deep, cloud, cloud.nearest < ZERO)
    if optical > ZERO:
        alpha_out[row, column] = ONE - (ONE - alpha_out[row, column]) * exp_minus(optical)


class Spray:
    """The spray of one frame after another.

    Attributes
    ----------
    room : int
        Clouds that there is room for.
    version : int
        Of the list of clouds, see `cuda.graph.new_version`.
    """

    def __init__(self):
        self._count, self._many = (cuda.to_device(np.zeros(1, np.int32)) for _ in range(2))
        self._drops = cuda.device_array((MOST_DRAWN, 7), np.float64)
        self._make_room(ROOM)

    def _make_room(self, room):
        self.room, self._clouds = room, cuda.device_array((room, 5), np.float32)
        self.version = new_version()

    def send(self, drops, puffs, camera):
        """Send the drops and clouds of `spray_seen`; the device must draw nothing meanwhile."""
        clouds = cloud_table(puffs, camera)
        if len(clouds) > self.room:
            self._make_room(2 * len(clouds))
        for rows, array, count in (
            (drops, self._drops, self._count), (clouds, self._clouds, self._many),
        ):  # fmt: skip
            count.copy_to_device(np.array([len(rows)], np.int32))
            if len(rows):
                array[: len(rows)].copy_to_device(np.ascontiguousarray(rows))

    def draw(self, view, scene, picture, stream):
        """Queue the drawing of drops into the streaks' picture."""
        draw_list[BLOCKS, GROUPS, stream](self._count, self._drops, view, scene, picture)

    def lay(self, lens, depth, alpha_out, stream):
        """Queue the clouds before the streaks' picture."""
        height, width = alpha_out.shape
        blocks = -(-width // BLOCK[0]), -(-height // BLOCK[1])
        lay_clouds[blocks, BLOCK, stream](self._many, self._clouds, lens, depth, alpha_out)
