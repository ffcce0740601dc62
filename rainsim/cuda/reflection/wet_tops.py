"""Twin of `reflection.wet_tops`: where a picture shows wet tops, a thread for each pixel."""

from rainsim.constants import ZERO
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.reflection.wet_tops import wet_top


@cuda_kernel
def meet_tops(depth, view, tops, rain, hit_out, coverage_out):
    """Add the wet tops to the hits of `ray_water.meet_water`; see `reflection.wet_tops`."""
    column, row = cuda.grid(2)
    height, width = depth.shape
    if row >= height or column >= width or coverage_out[row, column] > ZERO:
        return
    hit, covers = wet_top(view, tops, rain, depth[row, column], row, column)
    if covers > ZERO:
        hit_out[row, column], coverage_out[row, column] = hit, covers
