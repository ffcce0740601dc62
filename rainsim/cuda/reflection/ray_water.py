"""Twin of `reflection.ray_water`: where view rays meet the water, a thread for each pixel."""

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.reflection.ray_water import LEAST_DIP, NOTHING, SPECK, covered, meet_surface
from rainsim.scene.view import pixel_ray


@cuda_kernel
def meet_water(depth, view, water_map, highest, cover, hit_out, coverage_out):
    """Find where each pixel's ray meets the water and how much it covers; see `ray_water`.

    highest : device array of shape (1,), float32 [m]
    """
    column, row = cuda.grid(2)
    height, width = depth.shape
    if row >= height or column >= width:
        return
    top, (ny, nx) = highest[0], water_map.surface.shape
    coverage_out[row, column] = ZERO
    x, y, z = pixel_ray(view, row, column)
    behind = depth[row, column]
    if z > LEAST_DIP or not behind < NOTHING or view.eye[2] + behind * z > top + SPECK:
        return
    t, u, v = meet_surface(view, water_map, x, y, z, top)
    if not (t > ZERO and u > ONE and v > ONE):
        return
    if u > np.float32(nx - 2) or v > np.float32(ny - 2):
        return
    covers = covered(depth, view, water_map, row, column, (x, y, z), t, cover)
    coverage_out[row, column], hit_out[row, column] = covers, t
