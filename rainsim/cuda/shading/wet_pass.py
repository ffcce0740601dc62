"""Twin of `rainsim.shading.wet_pass`: the wet picture without water, a thread for each pixel."""

import numpy as np

from rainsim.constants import ZERO
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.scene.view import View
from rainsim.shading.smooth_normals import smooth_normal, turn_of, turned
from rainsim.shading.surface_point import is_surface, seen_surface
from rainsim.shading.wet_pass import NO_DEPTH
from rainsim.shading.wetting import wet_pixel

BLOCK = (32, 8)  # threads: columns, rows


def blocks(height, width):
    """Return the grid of blocks that covers a picture."""
    return -(-width // BLOCK[0]), -(-height // BLOCK[1])


def pixel_grid(size):
    """Return the launch configuration of a thread for each pixel of a picture (height, width)."""
    return blocks(*size), BLOCK


class DeviceView:
    """The camera of one picture after another as kernels take it.

    view : View or None. Of the last picture; its arrays are on the device.
    size : float32 device array (2,). Width and height of its picture [px].
    """

    def __init__(self):
        f4 = np.float32
        self._now = FrameUniforms({
            "turn": ((3, 3), f4), "eye": ((3,), f4), "lens": ((4,), f4), "size": ((2,), f4),
        })  # fmt: skip
        self.view, self.size, self.lens = None, self._now["size"], self._now["lens"]

    def take(self, view, shape):
        """Take over a `View` of the host, of a picture (height, width)."""
        self._now.update(
            turn=view.ground_from_camera, eye=view.eye, lens=view.lens, size=shape[::-1]
        )
        self._now.send()
        self.view = View(self._now["turn"], self._now["eye"], *view[2:])


@cuda_kernel
def grade_and_wet(
    size, dry, view, ground, rain, sky, look, picture_out, depth_out, clearance_out, cover_out
):  # fmt: skip
    """Grade the dry picture, wet it, and measure it against the ground.

    Parameters are those of the CPU's kernel but for this.

    size : float32 device array (2,). Columns and rows [px] of the part that was
        drawn.
    """
    column, row = cuda.grid(2)
    if row >= size[1] or column >= size[0]:
        return
    turn, normal, unit = turn_of(view.ground_from_camera), dry.normal, dry.meters_per_unit
    alpha, color = dry.alpha[row, column], dry.color
    x, y, z, d, _, point = seen_surface(
        turn, view, row, column,
        (normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]),
        dry.depth[row, column] * unit, dry.plane_depth[row, column] * unit, dry,
        (np.int64(size[1]), np.int64(size[0])), ground,
    )  # fmt: skip
    around = point.nx, point.ny, point.nz
    if dry.around > ZERO and is_surface(alpha, z):
        n0, n1, n2 = smooth_normal(
            dry.depth, normal, row, column, np.int64(size[1]), np.int64(size[0]), view.fx,
            dry.around / unit,
        )  # fmt: skip
        around = turned(turn, n0, n1, n2)
    mirror_apart = cover_out.shape[0] > 0
    r, g, b, clearance, cover = wet_pixel(
        (color[row, column, 0], color[row, column, 1], color[row, column, 2]), alpha,
        (x, y, z), point, around, ground, rain, sky, look, mirror_apart,
    )  # fmt: skip
    picture_out[row, column, 0], picture_out[row, column, 1] = r, g
    picture_out[row, column, 2] = b
    depth_out[row, column] = d if is_surface(alpha, z) else NO_DEPTH
    clearance_out[row, column] = clearance
    if mirror_apart:
        cover_out[row, column] = cover
