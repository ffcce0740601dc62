"""How wet a part of the ground is at one time, as a `WetScene` takes it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.shading import wetness


class WetGround(NamedTuple):
    """A part of the ground and how wet it is.

    Attributes
    ----------
    terrain : Terrain
    reach : ndarray of shape (ny, nx), float32
        Share of the rain that reaches the ground.
    grass : ndarray of shape (ny, nx), float32
        See `blurred_grass`.
    wetness : ndarray of shape (ny, nx, 4), float32
        See `wetness.ground_wetness`.
    """

    terrain: object
    reach: np.ndarray
    grass: np.ndarray
    wetness: np.ndarray


def wet_ground_of(terrain, reach, now):
    """Return the `WetGround` of a terrain with the settings `now` of one time."""
    grass = blurred_grass(terrain)
    return WetGround(terrain, reach, grass, wetness.ground_wetness(terrain, grass, reach, now))


def blurred_grass(terrain):
    """Return where grass is, 0 to 1, its edges softened by a cell, float32 (ny, nx)."""
    return ndimage.gaussian_filter(terrain.grassy.astype(np.float32), 1)
