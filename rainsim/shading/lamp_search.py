"""Lamps in the level picture of wet ground: what is brighter than BRIGHT becomes a few sources.

Bright pixels that touch are one source, but no source reaches over a square of TILE x TILE pixels.
"""

import numpy as np
from scipy import ndimage

from rainsim.constants import SH_0
from rainsim.numerics.srgb import linear
from rainsim.scene.view import slopes

BRIGHT = 3.0  # radiance from which on light is a lamp's, in units of the capture's white
TILE = 8  # px
NUMBERS = 8  # of a lamp, see `lamp_images.LampView`
_TOUCH = np.zeros((3, 3, 3), bool)  # of squares, and of rows and columns of pixels within one
_TOUCH[1] = True


def lamps_in(picture, depth, camera):
    """Return the lamps of a level picture as in `LampView`, and the light that they have of all.

    picture : float32 array (height, width, 3). Of the level camera mirrored at
        the ground plane.
    depth : float32 array (height, width) [m]
    camera : Camera. As `level_camera` returns it.
    """
    horizon, nothing = round(camera.cy), (np.empty((0, NUMBERS), np.float32), 0.0)
    bright, low = np.zeros(depth.shape, bool), slice(horizon, None)
    if picture[low].max(initial=0.0) > BRIGHT:
        bright[low] = (brightest_of(picture[low]) > BRIGHT) & np.isfinite(depth[low])
    if not bright.any():
        return nothing
    padded = np.pad(bright, [(0, -n % TILE) for n in bright.shape])
    squares = padded.reshape(len(padded) // TILE, TILE, -1, TILE).swapaxes(1, 2)
    some, label = squares.any(axis=(2, 3)), np.zeros(squares.shape, np.int64)
    label[some], count = ndimage.label(squares[some], _TOUCH)
    row, column = np.nonzero(bright)
    part = label[row // TILE, column // TILE, row % TILE, column % TILE]
    color, far = picture[row, column].astype(np.float64), depth[row, column].astype(np.float64)
    a, b = slopes(camera, column + 0.5, row + 0.5)
    (x, y), eye = camera.forward[:2], camera.position * (1, 1, -1)
    place = eye + far[:, None] * np.stack([x + a * y, y - a * x, b], axis=-1)
    above = 1 - BRIGHT / color.max(axis=1)
    area = far**2 / (camera.fx * camera.fy) / np.sqrt(1 + a * a + b * b)
    flux = (area * above)[:, None] * color
    light = flux.sum(axis=1)

    def summed(values):
        return np.stack([np.bincount(part, v, count + 1)[1:] for v in values.T], axis=-1)

    total = summed(light[:, None])
    middle = summed(light[:, None] * place) / total
    away = place - middle[part - 1]
    spread = np.stack([away[:, 0] * y - away[:, 1] * x, away[:, 2]], axis=-1) ** 2
    spread += (far / camera.fx)[:, None] ** 2 / 12
    lamps = np.hstack([middle, summed(flux), summed(light[:, None] * spread) / total])
    share = (above * color.sum(axis=1)).sum() / picture[horizon:].sum(dtype=np.float64)
    return lamps.astype(np.float32), float(share)


def brightest_of(picture):
    """Return the brightest channel of each pixel of a picture (rows, columns, 3)."""
    return np.maximum(np.maximum(picture[..., 0], picture[..., 1]), picture[..., 2])


def may_shine(splats):
    """Return whether any of splats is as bright as a lamp, seen from all sides alike."""
    shown = splats.sh[:, 0].max(initial=-np.inf)
    return bool(linear(0.5 + SH_0 * np.float64(shown)) > BRIGHT)
