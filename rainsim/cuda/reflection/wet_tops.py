"""Twin of `reflection.wet_tops`: where a picture shows wet tops, a thread for each pixel."""

from __future__ import annotations

from rainsim.constants import ZERO
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.reflection.wet_tops import wet_top
from rainsim.scene.view import view_from
from rainsim.shading.wetness import off_ground_from


@cuda_kernel
def meet_tops(depth, camera, tops, rain, hit_out, coverage_out):
    """Add the wet tops to the hits of `ray_water.meet_water`; see `reflection.wet_tops`.

    camera : View
    rain : device array of shape (fields,), float32
        An `OffGroundWetness`.
    """
    column, row = cuda.grid(2)
    height, width = depth.shape
    if row >= height or column >= width or coverage_out[row, column] > ZERO:
        return
    hit, covers = wet_top(
        view_from(camera), tops, off_ground_from(rain), depth[row, column], row, column
    )
    if covers > ZERO:
        hit_out[row, column], coverage_out[row, column] = hit, covers
