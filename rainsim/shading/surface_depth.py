"""The depth of surfaces as labels have it: of the place that `wet_pass` wets, not what is drawn.

Along a wall seen at a slant the mean of the splats' centres lies before the wall. Pictures hardly
show that, labels do.
"""

from __future__ import annotations

from rainsim.constants import SURFACE_ALPHA
from rainsim.jit import cpu_kernel, prange
from rainsim.scene.view import View
from rainsim.shading.smooth_normals import turn_of, turned
from rainsim.shading.wet_pass import NO_DEPTH, DryPicture, depth_of_surface


@cpu_kernel
def find_surface_depth(dry: DryPicture, view: View, depth_out):
    """Write the depth at which each pixel's surface is wetted, see `depth_of_surface`.

    Parameters
    ----------
    dry : DryPicture
    view : View
    depth_out : ndarray of shape (height, width), float32 [m]
        Along the view axis, infinite for the sky.
    """
    height, width = depth_out.shape
    turn, normal, unit = turn_of(view.ground_from_camera), dry.normal, dry.meters_per_unit
    for row in prange(height):
        for column in range(width):
            _, _, upness = turned(
                turn, normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]
            )
            _, wetted = depth_of_surface(
                dry.depth[row, column] * unit, dry.plane_depth[row, column] * unit, upness
            )
            solid = dry.alpha[row, column] >= SURFACE_ALPHA
            depth_out[row, column] = wetted if solid else NO_DEPTH
