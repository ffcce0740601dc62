"""The wetness of the surfaces in a picture, as `wet_pass` wets them: for the layer of that name."""

from __future__ import annotations

import math

from rainsim.constants import FAR_AWAY, ZERO
from rainsim.jit import cpu_kernel, prange
from rainsim.scene.view import View, pixel_ray
from rainsim.shading.grading import Look, surface_color
from rainsim.shading.smooth_normals import smooth_normal, turned
from rainsim.shading.wet_pass import DryPicture, depth_of_surface
from rainsim.shading.wetness import OffGroundWetness
from rainsim.shading.wetting import (
    GroundMaps,
    SurfacePoint,
    heights_of,
    is_ground,
    wet_state,
    wetted_normal,
    with_normal,
)


@cpu_kernel
def find_dampness(
    depth, dry: DryPicture, look: Look, view: View, ground: GroundMaps, rain: OffGroundWetness,
    damp_out,
):  # fmt: skip
    """Write how wet each pixel's surface is by `wet_state`, at the place where it is wetted.

    Parameters
    ----------
    depth : ndarray of shape (height, width), float32 [m]
        As `grade_and_wet` wrote it.
    dry : DryPicture
    look : Look
    view : View
    ground : GroundMaps
    rain : OffGroundWetness
    damp_out : ndarray of shape (height, width), float32
        0 dry to 1 wet through; 0 for the sky.
    """
    height, width = depth.shape
    m, eye, normal, unit = view.ground_from_camera, view.eye, dry.normal, dry.meters_per_unit
    for row in prange(height):
        for column in range(width):
            damp_out[row, column] = ZERO
            if not depth[row, column] < FAR_AWAY:
                continue
            a, b, c = pixel_ray(view, row, column)
            own = turned(m, normal[row, column, 0], normal[row, column, 1], normal[row, column, 2])
            _, d = depth_of_surface(
                dry.depth[row, column] * unit, dry.plane_depth[row, column] * unit, own[2]
            )
            x, y, z = eye[0] + d * a, eye[1] + d * b, eye[2] + d * c
            away = d * math.sqrt(a * a + b * b + c * c)
            point = SurfacePoint(x, y, z, own[0], own[1], own[2], away)
            clearance, above = heights_of(point, True, ground)
            if not is_ground(clearance, own[2]):
                n0, n1, n2 = smooth_normal(
                    dry.depth, normal, row, column, height, width, view.fx, dry.around / unit
                )
                r, g, b = surface_color(
                    dry.color[row, column, 0], dry.color[row, column, 1], dry.color[row, column, 2],
                    dry.alpha[row, column], look,
                )  # fmt: skip
                lean = wetted_normal(r, g, b, above, own, turned(m, n0, n1, n2))
                point = with_normal(point, lean)
            damp_out[row, column] = wet_state(point, clearance, above, ground, rain).dampness
