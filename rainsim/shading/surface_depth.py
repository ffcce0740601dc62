"""The depth of surfaces as labels have it: of the place that `wet_pass` wets, not what is drawn.

Along a wall seen at a slant the mean of the splats' centres lies before the wall. Pictures hardly
show that, labels do.
"""

import math

from rainsim.constants import ONE
from rainsim.jit import cpu_kernel, prange
from rainsim.scene.view import View, column_slope, row_slope
from rainsim.shading.smooth_normals import turn_of
from rainsim.shading.surface_point import GroundMaps, is_surface, seen_surface
from rainsim.shading.wet_pass import NO_DEPTH, DryPicture


@cpu_kernel
def find_surface_depth(dry: DryPicture, view: View, ground: GroundMaps, depth_out):
    """Write the depth at which each pixel's surface is wetted, see `seen_surface`.

    dry : DryPicture
    ground : GroundMaps
    depth_out : float32 array (height, width) [m]. Along the view axis, infinite
        for the sky.
    """
    height, width = depth_out.shape
    turn, normal, unit = turn_of(view.ground_from_camera), dry.normal, dry.meters_per_unit
    for row in prange(height):
        for column in range(width):
            lean = normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]
            depth, plane = dry.depth[row, column] * unit, dry.plane_depth[row, column] * unit
            _, _, sine, _, _, point = seen_surface(
                turn, view, row, column, lean, depth, plane, dry, (height, width), ground
            )
            a, b = column_slope(view, column), row_slope(view, row)
            wetted = point.distance / math.sqrt(a * a + b * b + ONE)
            shown = is_surface(dry.alpha[row, column], sine)
            depth_out[row, column] = wetted if shown else NO_DEPTH
