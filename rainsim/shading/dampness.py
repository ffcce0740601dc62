"""The wetness of the surfaces in a picture, as `wet_pass` wets them: for the layer of that name."""

from rainsim.constants import FAR_AWAY, ONE, ZERO
from rainsim.jit import cpu_kernel, prange
from rainsim.scene.view import View
from rainsim.shading.grading import Look, surface_color
from rainsim.shading.smooth_normals import smooth_normal, turn_of, turned
from rainsim.shading.surface_point import (
    NOT_POOR,
    GroundMaps,
    ground_share,
    heights_of,
    seen_surface,
)
from rainsim.shading.wet_pass import DryPicture
from rainsim.shading.wetness import OffGroundWetness
from rainsim.shading.wetting import leaf_share, wet_state, wetted_normal, with_normal


@cpu_kernel
def find_dampness(
    depth, dry: DryPicture, look: Look, view: View, ground: GroundMaps, rain: OffGroundWetness,
    damp_out,
):  # fmt: skip
    """Write how wet each pixel's surface is by `wet_state`, at the place where it is wetted.

    depth : float32 array (height, width) [m]. As `grade_and_wet` wrote it.
    dry : DryPicture
    ground : GroundMaps
    rain : OffGroundWetness
    damp_out : float32 array (height, width). 0 dry to 1 wet through; 0 for the
        sky.
    """
    height, width = depth.shape
    turn, normal, unit = turn_of(view.ground_from_camera), dry.normal, dry.meters_per_unit
    for row in prange(height):
        for column in range(width):
            damp_out[row, column] = ZERO
            if not depth[row, column] < FAR_AWAY:
                continue
            alpha = dry.alpha[row, column]
            _, _, _, _, _, point = seen_surface(
                turn, view, row, column,
                (normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]),
                dry.depth[row, column] * unit, dry.plane_depth[row, column] * unit, dry,
                (height, width), ground,
            )  # fmt: skip
            clearance, above = heights_of(point, True, ground)
            r, g, b = surface_color(
                dry.color[row, column, 0], dry.color[row, column, 1], dry.color[row, column, 2],
                alpha, look,
            )  # fmt: skip
            if ground_share(clearance, point.nz, NOT_POOR) < ONE:
                n0, n1, n2 = smooth_normal(
                    dry.depth, normal, row, column, height, width, view.fx, dry.around / unit
                )
                around = turned(turn, n0, n1, n2)
                lean = wetted_normal(r, g, b, above, point, around, ground.thickest_layer)
                point = with_normal(point, lean)
            level = ground_share(above, point.nz, point.ground)
            leaf = leaf_share(r, g, b)
            wet = wet_state(point, clearance, above, level, leaf, ONE, ground, rain)
            damp_out[row, column] = wet.dampness
