"""How wet a part of the ground is, one time after another."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from rainsim.io.states import NO_TRACKS
from rainsim.shading import wetness
from rainsim.shading.bodies import BodyMap
from rainsim.shading.wetting import GroundMaps


class WetGround:
    """A part of the ground and how wet it is.

    Parameters
    ----------
    terrain : Terrain
    reach : ndarray of shape (ny, nx), float32
        Share of the rain that reaches the ground.

    Attributes
    ----------
    grass : ndarray of shape (ny, nx), float32
        See `blurred_grass`.
    map : ndarray of shape (ny, nx, 4), float32, or None
        See `wetness.ground_wetness`; None until `wet` is called.
    bodies : BodyMap or None
        None until `stand` is called.
    """

    def __init__(self, terrain, reach):
        self.terrain, self.reach, self.grass = terrain, reach, blurred_grass(terrain)
        self.map = self._untouched = self.bodies = None
        self._tracks = NO_TRACKS

    def stand(self, actors):
        """Find the smooth bodies that stand on the ground, and where `actors` (or None) are."""
        self.bodies = BodyMap(self.terrain, actors)

    def wet(self, now):
        """Find how wet the ground is at the settings of one time."""
        self._untouched = wetness.ground_wetness(self.terrain, self.grass, self.reach, now)
        self.map = wetness.with_tracks(self._untouched, self._tracks)

    def take_tracks(self, tracks):
        """Take over where tyres have thinned the film, see `Tyres.tracks`; return if that is new.

        Parameters
        ----------
        tracks : ndarray of shape (ny, nx) or (0, 0), uint8
        """
        if np.array_equal(tracks, self._tracks):
            return False
        self._tracks = tracks
        self.map = wetness.with_tracks(self._untouched, tracks)
        return True

    @property
    def maps(self):
        """The `GroundMaps` of the present time, as kernels take them."""
        grid = self.terrain.grid
        place = np.array(grid.origin, np.float32), np.float32(grid.spacing)
        return GroundMaps(self.terrain.bed, self.map, *place, self.bodies.now)


def blurred_grass(terrain):
    """Return where grass is, 0 to 1, its edges softened by a cell, float32 (ny, nx)."""
    return ndimage.gaussian_filter(terrain.grassy.astype(np.float32), 1)
