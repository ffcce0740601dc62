"""The wetness of the surfaces in a picture, as `wet_pass` wets them: for the layer of that name."""

from __future__ import annotations

from rainsim.constants import FAR_AWAY, HALF, ONE, ZERO
from rainsim.jit import cpu_kernel, prange
from rainsim.scene.view import View, pixel_ray
from rainsim.shading.grading import Look, is_edge, undiluted
from rainsim.shading.smooth_normals import smooth_normal, turned
from rainsim.shading.walls import damp_off_ground
from rainsim.shading.wet_pass import DryPicture
from rainsim.shading.wetness import OffGroundWetness
from rainsim.shading.wetting import (
    FLAT,
    ON_GROUND,
    GroundMaps,
    SurfacePoint,
    body_of,
    on_ground,
    wetted_normal,
)


@cpu_kernel
def find_dampness(
    depth, clearance, dry: DryPicture, look: Look, view: View, ground: GroundMaps,
    rain: OffGroundWetness, damp_out,
):  # fmt: skip
    """Write how wet each pixel's surface is, for the AOV.

    Parameters
    ----------
    depth, clearance : ndarray of shape (height, width), float32 [m]
        As `grade_and_wet` wrote them.
    dry : DryPicture
    look : Look
    view : View
    ground : GroundMaps
    rain : OffGroundWetness
    damp_out : ndarray of shape (height, width), float32
        0 dry to 1 wet through; 0 for the sky.
    """
    height, width = depth.shape
    m, eye, normal = view.ground_from_camera, view.eye, dry.normal
    around = dry.around / dry.meters_per_unit
    for row in prange(height):
        for column in range(width):
            d = depth[row, column]
            damp_out[row, column] = ZERO
            if not d < FAR_AWAY:
                continue
            a, b, c = pixel_ray(view, row, column)
            x, y, z = eye[0] + d * a, eye[1] + d * b, eye[2] + d * c
            n0, n1, n2 = normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]
            upness = m[2, 0] * n0 + m[2, 1] * n1 + m[2, 2] * n2
            if clearance[row, column] < ON_GROUND and upness > FLAT:
                u = (x - ground.origin[0]) / ground.spacing - HALF
                v = (y - ground.origin[1]) / ground.spacing - HALF
                damp_out[row, column] = on_ground(ground, u, v).dampness
            else:
                own = turned(m, n0, n1, n2)
                above = clearance[row, column]
                above = above if above < FAR_AWAY else z
                n0, n1, n2 = smooth_normal(
                    dry.depth, normal, row, column, height, width, view.fx, around
                )
                alpha = dry.alpha[row, column]
                r, g, b = undiluted(
                    dry.color[row, column, 0], dry.color[row, column, 1], dry.color[row, column, 2],
                    alpha if is_edge(alpha, look) else ONE,
                )  # fmt: skip
                lean = wetted_normal(r, g, b, above, own, turned(m, n0, n1, n2))
                point = SurfacePoint(x, y, z, lean[0], lean[1], lean[2], d)
                body = body_of(point, clearance[row, column], ground)
                damp_out[row, column] = damp_off_ground(rain, point, above, body)
