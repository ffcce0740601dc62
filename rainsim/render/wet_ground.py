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
    now : Config
        Of the time from which on it is drawn.
    """

    terrain: object
    reach: np.ndarray
    grass: np.ndarray
    now: object

    def wetness(self):
        """Return the wetness of the ground, (ny, nx, 4) float32, see `wetness.ground_wetness`.

        Found when the part is drawn: until then it would only take memory.
        """
        return wetness.ground_wetness(self.terrain, self.grass, self.reach, self.now)


def wet_ground_of(terrain, reach, now):
    """Return the `WetGround` of a terrain with the settings `now` of one time."""
    return WetGround(terrain, reach, blurred_grass(terrain), now)


def blurred_grass(terrain):
    """Return where grass is, 0 to 1, its edges softened by a cell, float32 (ny, nx)."""
    return ndimage.gaussian_filter(terrain.grassy.astype(np.float32), 1)
