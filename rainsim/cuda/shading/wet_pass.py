"""Twin of `rainsim.shading.wet_pass`: the wet picture without water, a thread for each pixel.

Numbers that change from frame to frame are device arrays, which a recorded frame reads each time.
"""

from __future__ import annotations

import numpy as np

from rainsim.constants import SURFACE_ALPHA, ZERO
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.scene.view import column_slope, row_slope, view_from, view_of_arrays
from rainsim.shading.grading import look_from
from rainsim.shading.smooth_normals import AROUND, NO_AROUND, smooth_normal, turn_of, turned
from rainsim.shading.surface_point import GroundMaps, seen_surface
from rainsim.shading.wet_pass import NO_DEPTH, DryPicture
from rainsim.shading.wetness import off_ground_from
from rainsim.shading.wetting import SkyMaps, wet_pixel

BLOCK = (32, 8)  # threads: columns, rows


def blocks(height, width):
    """Return the grid of blocks that covers a picture."""
    return -(-width // BLOCK[0]), -(-height // BLOCK[1])


def pixel_grid(size, stream):
    """Return the launch configuration of a thread for each pixel of a picture (height, width)."""
    return blocks(*size), BLOCK, stream


def grade_layers(
    frame, rasterizer, shape, turn, eye, picture, depth, clearance, cover, stream, mirrored=True
):
    """Queue the grading and wetting of the layers of a rasterizer.

    frame : DeviceFrame
    rasterizer : rainsim.cuda.raster.Rasterizer
    shape : tuple of int. Height and width of its picture [px].
    turn, eye : device array. Of its camera, in the ground frame.
    picture, depth, clearance, cover : device array. What is written.
    stream : numba.cuda.stream
    mirrored : bool
    """
    layers = rasterizer.layers
    layer = frame.conductor.wet_scene.ground.thickest_layer
    dry = DryPicture(
        layers.color.reshape(*shape, 3), layers.alpha.reshape(shape), layers.depth.reshape(shape),
        layers.plane_depth.reshape(shape), layers.normal.reshape(*shape, 3),
        np.float32(frame.conductor.wet_scene.frame.meters_per_unit),
        NO_AROUND if mirrored else max(AROUND, layer),
    )  # fmt: skip
    ground = GroundMaps(
        frame["bed"], frame["ground_map"], *frame.place, frame["bodies"], frame["layer"],
        layer,
    )  # fmt: skip
    sky = SkyMaps(frame["gloss"], frame["coat"], frame["behind_mirrored" if mirrored else "behind"])
    grade_and_wet[pixel_grid(shape, stream)](
        rasterizer.size, dry, view_of_arrays(turn, eye, rasterizer.lens), ground,
        frame.uniforms["off_ground"], sky, frame.uniforms["look"], picture, depth, clearance, cover,
    )  # fmt: skip


@cuda_kernel
def grade_and_wet(
    size, dry, camera, ground, rain, sky, look, picture_out, depth_out, clearance_out, cover_out
):  # fmt: skip
    """Grade the dry picture, wet it, and measure it against the ground.

    Parameters are those of the CPU's kernel but for these.

    size : float32 device array (2,). Columns and rows [px] of the part that was
        drawn.
    camera : View
    rain : float32 device array (fields,). An `OffGroundWetness`, see
        `off_ground_from`.
    look : float32 device array (fields,). A `Look`, see `look_from`.
    """
    column, row = cuda.grid(2)
    if row >= size[1] or column >= size[0]:
        return
    view = view_from(camera)
    turn, normal, unit = turn_of(view.ground_from_camera), dry.normal, dry.meters_per_unit
    alpha, color = dry.alpha[row, column], dry.color
    x, y, z, d, _, point = seen_surface(
        turn, view.eye, column_slope(view, column), row_slope(view, row),
        (normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]),
        dry.depth[row, column] * unit, dry.plane_depth[row, column] * unit, alpha, ground,
    )  # fmt: skip
    around = point.nx, point.ny, point.nz
    if dry.around > ZERO and alpha >= SURFACE_ALPHA:
        n0, n1, n2 = smooth_normal(
            dry.depth, normal, row, column, np.int64(size[1]), np.int64(size[0]), view.fx,
            dry.around / unit,
        )  # fmt: skip
        around = turned(turn, n0, n1, n2)
    mirror_apart = cover_out.shape[0] > 0
    r, g, b, clearance, cover = wet_pixel(
        (color[row, column, 0], color[row, column, 1], color[row, column, 2]), alpha,
        (x, y, z), point, around, ground, off_ground_from(rain),
        sky, look_from(look), mirror_apart,
    )  # fmt: skip
    picture_out[row, column, 0], picture_out[row, column, 1] = r, g
    picture_out[row, column, 2] = b
    depth_out[row, column] = d if alpha >= SURFACE_ALPHA else NO_DEPTH
    clearance_out[row, column] = clearance
    if mirror_apart:
        cover_out[row, column] = cover
