"""Twin of `rainsim.shading.lamp_images`: the light of lamps in wet ground on a CUDA device.

The host finds the lamps in the level picture, as for the CPU; scenes without any fetch none.
"""

from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.shading.ground_slopes import block_ray
from rainsim.shading.lamp_images import LampView, lamp_light
from rainsim.shading.lamp_search import may_shine


@cuda_kernel
def add_lamps(view, step, ground, seen, level_size, field_out):
    """Add the light of lamps that wet ground mirrors to each block; see the CPU's kernel.

    level_size : float32 device array (2,). Columns and rows of the level picture,
        whose arrays may be larger.
    """
    i, j = cuda.grid(2)
    if j >= field_out.shape[0] or i >= field_out.shape[1]:
        return
    x, y, z = block_ray(view, step, j, i)
    depth = seen.depth[: int(level_size[1]), : int(level_size[0])]
    shown = LampView(seen.lamps, depth, seen.lens, seen.forward)
    red, green, blue = lamp_light(x, y, z, view.eye, ground, shown)
    field_out[j, i, 0] += red
    field_out[j, i, 1] += green
    field_out[j, i, 2] += blue


def shines(scene):
    """Return whether a scene or one of its actors has splats as bright as lamps."""
    return any(may_shine(part.splats) for part in (scene, *scene.actors))
