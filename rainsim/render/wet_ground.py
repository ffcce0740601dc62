"""How wet a part of the ground is, one time after another."""

from functools import cached_property
from typing import NamedTuple

import numpy as np

from rainsim.io import cache
from rainsim.shading import wetness
from rainsim.shading.bodies import BodyMap, body_map
from rainsim.shading.surface_point import GroundMaps
from rainsim.terrain import filters
from rainsim.water.tracks import NO_TRACKS


class TrackedMap(NamedTuple):
    """How wet each cell of the ground is, before and after tyres have thinned its film.

    untouched, map : float32 array (ny, nx, 4). See `wetness.ground_wetness`.
    rows : slice. In which the two differ.
    """

    untouched: np.ndarray
    map: np.ndarray
    rows: slice


class WetGround:
    """A part of the ground and how wet it is.

    reach : float32 array (ny, nx). Share of the rain that reaches the ground.
    grass : float32 array (ny, nx). See `blurred_grass`.
    tracked : TrackedMap or None. None until `wet` is called; another one whenever
        the map changes.
    bodies : BodyMap or None. None until `stand` is called.
    thickest_layer : float32 [m]. Thickness of the splats about a poorly known
        bed, at most; 0 elsewhere.
    """

    def __init__(self, terrain, reach):
        self.terrain, self.reach, self.grass = terrain, reach, blurred_grass(terrain)
        self.tracked = self.bodies = None
        self.thickest_layer = np.abs(terrain.layer).max(initial=np.float32(0))
        self._tracks = NO_TRACKS

    def stand(self, actors):
        """Find the smooth bodies that stand on the ground, and where `actors` (or None) are."""
        self.bodies = BodyMap(self.terrain, self.standing, actors)

    @cached_property
    def standing(self):
        """The smooth bodies that stand on the ground, see `body_map`."""
        t = self.terrain
        place = t.bed, t.top, t.underside, t.tops.index, t.grid
        return cache.kept_arrays("bodies", lambda: {"map": body_map(t)}, *place)["map"]

    def wet(self, now):
        """Find how wet the ground is at the settings of one time."""
        self._lay_tracks(wetness.ground_wetness(self.terrain, self.grass, self.reach, now))

    def take_tracks(self, tracks):
        """Take over where tyres have thinned the film, see `tracks_of`; return if that is new."""
        if tracks is self._tracks or np.array_equal(tracks, self._tracks):
            return False
        self._tracks = tracks
        self._lay_tracks(self.tracked.untouched)
        return True

    def _lay_tracks(self, untouched):
        """Lay the tracks on a copy of the map, so that the last one stays."""
        ground, rows = untouched, slice(0, 0)
        if self._tracks.size:
            ground = untouched.copy()
            rows = wetness.thin_film(ground, self._tracks)
        self.tracked = TrackedMap(untouched, ground, rows)

    @property
    def map(self):
        """How wet each cell is, see `TrackedMap.map`; None until `wet` is called."""
        return None if self.tracked is None else self.tracked.map

    @property
    def full_film(self):
        """How full the film of each cell is (ny, nx) where no tyre has rolled, 0 to 1."""
        return self.tracked.untouched[..., wetness.Wetness._fields.index("film")]

    @property
    def maps(self):
        """The `GroundMaps` of the present time, as kernels take them."""
        grid = self.terrain.grid
        place = np.array(grid.origin, np.float32), np.float32(grid.spacing)
        layer = self.terrain.layer
        return GroundMaps(
            self.terrain.bed, self.map, *place, self.bodies.now, layer, self.thickest_layer
        )


def blurred_grass(terrain):
    """Return where grass is, 0 to 1, its edges softened by a cell, float32 (ny, nx)."""
    return filters.gaussian_filter(terrain.grassy.astype(np.float32), 1)
