"""Twin of `rainsim.particles.spray`: the spray of tyres in a picture on a CUDA device.

The host finds the drops and the clouds, as for frames of the CPU. The drops are drawn with the
streaks of the rain; of the clouds a thread takes a pixel through all.
"""

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.cuda.driver import SentRows
from rainsim.cuda.drops import BLOCKS
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.particles.splash_pass import draw_list
from rainsim.cuda.warp import GROUPS
from rainsim.numerics.approximations import exp_minus
from rainsim.particles.spray import cloud_table, cloud_thickness

BLOCK = (8, 4) if SIMULATED else (32, 8)  # threads, one a pixel


@cuda_kernel
def lay_clouds(count, clouds, boxes, lens, depth, alpha_out):
    """Put `count` clouds before a picture; their arrays are those of `spray.cloud_table`."""
    column, row = cuda.grid(2)
    height, width = alpha_out.shape
    if row >= height or column >= width:
        return
    a = (np.float32(column) + HALF - lens[2]) / lens[0]
    b = (np.float32(row) + HALF - lens[3]) / lens[1]
    deep, optical = depth[row, column], ZERO
    for n in range(count):
        if boxes[n, 0] <= column < boxes[n, 1] and boxes[n, 2] <= row < boxes[n, 3]:
            optical += cloud_thickness(
                a, b, deep, clouds[n, 0], clouds[n, 1], clouds[n, 2], clouds[n, 3], clouds[n, 4]
            )
    if optical > ZERO:
        alpha_out[row, column] = ONE - (ONE - alpha_out[row, column]) * exp_minus(optical)


class Spray:
    """The spray of one frame after another."""

    def __init__(self):
        self._count, self._drops = SentRows((), np.int32), SentRows((7,), np.float64)
        self._clouds, self._boxes = SentRows((5,), np.float32), SentRows((4,), np.int32)
        self._many = 0  # clouds

    def send(self, drops, puffs, camera):
        """Send what `spray_seen` returns."""
        self._count.send([len(drops)])
        self._drops.send(drops)
        clouds, boxes = cloud_table(puffs, camera)
        self._clouds.send(clouds)
        self._boxes.send(boxes)
        self._many = len(clouds)

    def draw(self, view, scene, picture):
        """Queue the drawing of drops into the streaks' picture."""
        draw_list[BLOCKS, GROUPS](self._count.array, self._drops.array, view, scene, picture)

    def lay(self, lens, depth, alpha_out):
        """Queue the clouds before the streaks' picture."""
        height, width = alpha_out.shape
        blocks = -(-width // BLOCK[0]), -(-height // BLOCK[1])
        clouds = self._many, self._clouds.array, self._boxes.array
        lay_clouds[blocks, BLOCK](*clouds, lens, depth, alpha_out)
