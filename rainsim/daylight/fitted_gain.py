"""Gains on the light of splats, fitted in the pictures of the cameras.

Splats of sparse photographs are no surface: sunlit ones reach into the shade, dark ones hide them,
haze hangs before both. So the gains by place are fitted until the cameras' pictures show the ground
without its shade, and all else as it was.
"""

from __future__ import annotations

import numpy as np

from rainsim.daylight.clouds import under_clouds
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS, linear
from rainsim.raster import Rasterizer, prepare
from rainsim.surface.ground_shade import gain_of_pixels
from rainsim.surface.views import NEAR, depth_views

MOST_CAMERAS = 24  # that the gains are fitted in
CHANNELS = (0, 1, 2), (0, 1, 2), (0,), (2,)  # that each round fits, by their luminance
MOST_CHANGE = 1.0  # of a logarithm, of a pixel and round
EVERY = 2  # px, of the pictures whose pixels are asked
FEW = 0.5  # px of a splat, that hardly tell
DARK = 0.004  # linear light below which noise decides
LEAST_GAIN, MOST_GAIN = 0.7, 200.0


def fitted(scene, cameras, shade, gain):
    """Return gains (n, 3), fitted in pictures of the ground without its shade.

    `cameras` (capture frame) are those that the `GroundShade` was found from, `gain` (n, 3) are
    those by place.
    """
    cameras = cameras[:: -(-len(cameras) // MOST_CAMERAS)]
    rasterizer, near = Rasterizer(prepare(scene.splats)), NEAR / scene.ground_frame.meters_per_unit
    views, wanted = depth_views(scene, cameras, rasterizer), []
    for view in views:
        wanted.append(np.log(np.maximum(view.light, DARK)) + gain_of_pixels(shade, view))
    for channels in CHANNELS:
        weight = LUMINANCE_WEIGHTS * np.isin(range(3), channels)
        weight /= weight.sum()
        drawer, total = Rasterizer(prepare(under_clouds(scene.splats, gain, 1.0))), 0.0
        for view, camera, want in zip(views, cameras, wanted, strict=True):
            height, width = view.depth.shape
            camera = camera.resized(width, height)
            layers = drawer.draw(camera, near)
            light = linear(layers.color / np.maximum(layers.alpha, np.float32(0.5))[..., None])
            off = (want - np.log(np.maximum(light, DARK))) @ weight / MOST_CHANGE
            row, column = np.arange(height)[:, None], np.arange(width)
            dither = (0.5698 * row + 0.7549 * column) % 1  # an even sequence, Roberts 2018
            part = (np.sign(off) * (np.abs(off) > dither)).astype(np.int8)
            total = total + rasterizer.weigh(camera, near, part, EVERY)
        less, more, same, _ = total.T
        change = MOST_CHANGE * (more - less) / (less + more + same + FEW)
        gain[:, channels] *= np.exp(change)[:, None]
        gain = np.clip(gain, LEAST_GAIN, MOST_GAIN)
    return gain
