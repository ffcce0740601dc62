"""The wetness of the surfaces in a picture and what of it they cover, as `wet_pass` draws them."""

from rainsim.constants import FAR_AWAY, ONE, ZERO
from rainsim.jit import cpu_kernel, prange
from rainsim.scene.view import View
from rainsim.shading.grading import Look, covered_share, surface_color
from rainsim.shading.smooth_normals import smooth_normal, turn_of, turned
from rainsim.shading.surface_point import GroundMaps, seen_surface
from rainsim.shading.wet_pass import DryPicture
from rainsim.shading.wetness import OffGroundWetness
from rainsim.shading.wetting import leaf_share, wet_surface


@cpu_kernel
def find_dampness(
    depth, dry: DryPicture, look: Look, view: View, ground: GroundMaps, rain: OffGroundWetness,
    damp_out, matte_out,
):  # fmt: skip
    """Write how wet each pixel's surface is by `wet_state`, and what of the pixel it covers.

    depth : float32 array (height, width) [m]. As `grade_and_wet` wrote it.
    damp_out : float32 array (height, width). 0 dry to 1 wet through; 0: sky.
    matte_out : float32 array (height, width). As `grading.covered_share`.
    """
    height, width = depth.shape
    turn, normal, unit = turn_of(view.ground_from_camera), dry.normal, dry.meters_per_unit
    for row in prange(height):
        for column in range(width):
            color, alpha = dry.color[row, column], dry.alpha[row, column]
            leaf = leaf_share(*surface_color(color[0], color[1], color[2], alpha, look))
            _, _, sine, _, _, point = seen_surface(
                turn, view, row, column,
                (normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]),
                dry.depth[row, column] * unit, dry.plane_depth[row, column] * unit, dry,
                (height, width), ground,
            )  # fmt: skip
            damp_out[row, column] = ZERO
            matte_out[row, column] = covered_share(alpha, leaf, sine)
            if not depth[row, column] < FAR_AWAY:
                continue
            n0, n1, n2 = smooth_normal(
                dry.depth, normal, row, column, height, width, view.fx, dry.around / unit
            )
            _, _, _, _, _, _, level, wet = wet_surface(
                (color[0], color[1], color[2]), alpha, sine, point, turned(turn, n0, n1, n2),
                ground, rain, look,
            )  # fmt: skip
            damp_out[row, column] = wet.dampness
            matte_out[row, column] = covered_share(alpha, (ONE - level) * leaf, sine)
