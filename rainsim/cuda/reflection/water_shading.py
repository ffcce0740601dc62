"""Twin of `reflection.water_shading`: the water in a picture tilted, lit and laid over it.

On the CPU the water's pixels are a list; here each pixel is a thread, which does for its own pixel
what `list_water`, `tilt_water`, `mirror_light` or `march_light`, and `lay_water` do there, by the
same functions of a pixel.
"""

import numpy as np

from rainsim.constants import TWO, ZERO
from rainsim.cuda.jit import cuda, cuda_device, cuda_kernel
from rainsim.cuda.reflection.planar_mirror import mirror_of
from rainsim.reflection.mirror_choice import MIRROR_SPREAD
from rainsim.reflection.planar_mirror import MirrorPicture, mirrored_light
from rainsim.reflection.screen_space import screen_light, surrounding_light
from rainsim.reflection.water_shading import shade_water_pixel, tilted, water_at
from rainsim.reflection.wet_tops import top_below
from rainsim.scene.view import View

SPREAD = np.float32(MIRROR_SPREAD)


@cuda_kernel
def shade_water(
    hit, coverage, distance, background, tall, view, water_map, tops, ripples, environment,
    gloss, settings, mirrors, optics, picture_out,
):  # fmt: skip
    """Write the picture with the water on it: ripples, reflection, refraction, the sun's glint.

    hit, coverage : device arrays of shape (height, width), float32. As
        `ray_water.meet_water` left them.
    distance : float32 device array (height, width) [m]. As
        `screen_space.find_hits` left it.
    tall : float32 device array (height, width) [m]. As `screen_space.keep_tall`
        left it.
    tops : TopMaps
    environment, gloss : float32 device array (rows, columns, 3). The
        surroundings, and blurred, which sloping tops mirror.
    settings : MarchSettings
    mirrors : MirrorArrays
    picture_out : float32 device array (height, width, 3)
    """
    column, row = cuda.grid(2)
    height, width = coverage.shape
    if row >= height or column >= width:
        return
    covers = coverage[row, column]
    if covers == ZERO:
        for c in range(3):
            picture_out[row, column, c] = background.picture[row, column, c]
        return
    water = water_at(view, water_map, tops, row, column, hit[row, column], covers)
    water = tilted(water, ripples, tops)
    mirror = mirror_of(mirrors.range, water.z)
    alone = hit[row, column] < ZERO  # a top that slopes mirrors the surroundings alone
    if mirror >= 0 and abs(water.z - mirrors.range[mirror, 0]) >= SPREAD:
        alone = alone or top_below(tops, water.x, water.y, water.z)[0] >= 0
    if alone:
        red, green, blue = surrounding_light(gloss, water)
    elif mirror >= 0:
        red, green, blue = by_mirror(mirrors, mirror, view, water)
    else:
        red, green, blue, _ = screen_light(
            view,
            background.picture,
            tall,
            environment,
            settings.thickness,
            water,
            distance[row, column],
        )
    r, g, b = shade_water_pixel(water, row, column, (red, green, blue), background, view, optics)
    picture_out[row, column, 0] = r
    picture_out[row, column, 1] = g
    picture_out[row, column, 2] = b


@cuda_device
def by_mirror(mirrors, k, view, water):
    """Return the radiance (r, g, b) that a pixel of water mirrors, by the k-th mirrored picture."""
    window, eye = mirrors.window, view.eye
    columns, rows = int(window[4]), int(window[5])
    mirrored_eye = eye[0], eye[1], TWO * mirrors.range[k, 0] - eye[2]
    mirror_view = View(
        mirrors.ground_from_camera, mirrored_eye, window[0], window[1], window[2], window[3]
    )
    picture = MirrorPicture(
        mirrors.picture[k, :rows, :columns], mirrors.coarse[k], mirrors.depth[k, :rows, :columns]
    )
    return mirrored_light(mirror_view, picture, water)
