"""What the captured sky hides a part of, as it is to look once the sky is left out.

Splats of a sky also hang before things, as a veil. What is behind was trained together with the
veil only: its own colours, with which training made up for it, may be black, white or red.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rainsim.constants import SH_0
from rainsim.numerics.blocks import in_blocks
from rainsim.numerics.srgb import display
from rainsim.raster import Rasterizer, prepare
from rainsim.scene.view import camera_points, image_point
from rainsim.surface.views import NEAR

MOST_PICTURES = 32  # that are asked
EVERY = 2  # px: every so many pixels of every so many rows are asked
LEAST = 0.5  # px, of light from which on a splat counts
HARDLY, HALF = 0.1, 0.5  # of a splat's light, hidden: from which on it is unveiled; wholly so
GREY = np.float32(0.5)  # display-referred, of a splat whose coefficients are 0


class Unveiled(NamedTuple):
    """Splats of a capture that its sky hides a part of."""

    which: np.ndarray  # (m,) int64
    share: np.ndarray  # (m, 1) float32, of their colour that the pictures tell, 0 to 1
    color: np.ndarray  # (m, 3) float32, display-referred, of the pictures, the veil included

    def of(self, splats):
        """Return the capture's splats with these colours, the same from all sides."""
        sh = splats.sh.copy()
        # What is brighter than white made up for a dark veil, or was hardly seen: it is no lamp.
        beyond = sh[self.which, 0].max(axis=1, keepdims=True) * np.float32(SH_0) > 1 - GREY
        share = np.where(beyond, np.float32(1), self.share)
        sh[self.which] *= 1 - share[:, :, None]
        sh[self.which, 0] += share * (np.minimum(self.color, 1) - GREY) / np.float32(SH_0)
        return replace(splats, sh=sh)


def unveiled(scene, sky, seen, pictures):
    """Return which other splats lie bare before the sky without those of it, and `Unveiled`.

    sky : bool array (n,). Splats that are left out.
    seen : float array (n,) [px]. Light that each gives to the pictures, where all
        are drawn.
    pictures : list of (DepthView, Camera, int8 array). The last is what its pixels
        show, see `SkyColors.parts`.
    """
    rest = np.flatnonzero(~sky)
    splats = scene.splats.take(rest)
    alone, near = Rasterizer(prepare(splats)), NEAR / scene.ground_frame.meters_per_unit
    light, color = np.zeros((len(rest), 3)), np.zeros((len(rest), 3))
    for view, camera, part in pictures:
        height, width = part.shape
        camera = camera.resized(width, height)
        weight = alone.weigh(camera, near, part, EVERY)[:, :3]

        def add(some, view=view, camera=camera, weight=weight):
            light[some] += weight[some]
            land = weight[some, 0] + weight[some, 2]
            lit = np.flatnonzero(land)
            column, row = image_point(camera, *camera_points(camera, splats.position[some][lit]).T)
            last_row, last_column = np.array(view.light.shape[:2]) - 1
            pixel = row.astype(int).clip(0, last_row), column.astype(int).clip(0, last_column)
            color[some][lit] += land[lit, None] * view.light[pixel]

        in_blocks(add, len(rest))
    total, land = light.sum(axis=1), light[:, 0] + light[:, 2]
    hidden = np.where(total > LEAST, 1 - seen[rest] / np.maximum(total, LEAST), 0)
    bare = np.zeros(len(sky), bool)
    bare[rest] = (hidden > HALF) & (light[:, 1] > land)
    which = np.flatnonzero((hidden > HARDLY) & (land > 0))
    share = np.clip(hidden[which, None] / HALF, 0, 1).astype(np.float32)
    shown = display(color[which] / land[which, None]).astype(np.float32)
    return bare, Unveiled(rest[which], share, shown)
