"""Twin of `rain.moving_surfaces`: the map that drops meet on a device, with actors on it.

The host puts the actors onto its map; the windows that they cover, and have covered, are sent.
"""

from __future__ import annotations

import numpy as np

from rainsim.cuda.driver import Staging
from rainsim.cuda.drops import sent_surfaces
from rainsim.cuda.moving_map import MovingMap
from rainsim.jit import may_run_beside
from rainsim.rain.moving_surfaces import MovingSurfaces

ABOVE = 0.01  # m; lines are followed from this far above all that moves
FIELDS = ("top", "underside")
BLOCKS = ("patch_high", "around_high")


class MovingHeights:
    """The height fields of a terrain with the actors on it, on a device.

    still : Surfaces. Without what moves.
    footprints : sequence of Footprint
    stream : numba.cuda.stream
    fields : HeightFields. Of device arrays, at fixed addresses, with a sky above
        all that the actors ever reach: a recorded queue holds them.
    """

    def __init__(self, still, footprints, stream):
        fields = sent_surfaces(still, stream)
        highest = max((footprint.highest for footprint in footprints), default=-np.inf)
        self.fields = fields._replace(sky=max(fields.sky, highest + ABOVE))
        self._staging = Staging(stream)
        self._maps = {name: MovingMap(getattr(self.fields, name), self._staging) for name in FIELDS}
        self._there = still

    def send(self, surfaces):
        """Send those of `MovingSurfaces.moment`; the device must draw nothing meanwhile."""
        if surfaces is self._there:
            return
        found = surfaces.height_fields()
        for name, there in self._maps.items():
            there.send(getattr(found, name), surfaces.changes)
        if surfaces.changes or self._there.changes:
            for name in BLOCKS:
                self._staging.send(getattr(self.fields, name), getattr(found, name))
        self._there = surfaces


class Shelter:
    """What moves over the water of a device keeps the rain off it.

    terrain : Terrain. With footprints.
    wind : tuple. As `MovingSurfaces` takes it, and the roughness.
    exposure : float32 array (ny, nx). Share of the rain that reaches the ground,
        without what moves.
    water : rainsim.cuda.grid.Water
    impacts : RecentImpacts or None. The drops that are listed there, if it rains.
    """

    def __init__(self, terrain, wind, exposure, water, impacts):
        self._moving, self._water, self._heights = MovingSurfaces(terrain, *wind), water, None
        self._exposure, self._shelters, self._opened = exposure, [], exposure.copy()
        if impacts is not None:
            self._heights = MovingHeights(self._moving.still, terrain.footprints, impacts.stream)
            impacts.surfaces, impacts.relisted = self._heights.fields, True

    def cover(self, time, *following):
        """Let the drops that are listed next meet the map as it is at a time [s].

        Those of the `following` times [s] are looked for beside it.
        """
        self._heights.send(self._moving.at(time))
        self._middle = time
        if may_run_beside():
            self._moving.look_ahead(following)

    def thin_rain(self):
        """Let less rain reach the ground in the listed interval."""
        if self._heights is None:
            return
        shelters = self._moving.moment(self._middle)[1]
        if shelters is self._shelters:
            return
        for part, _ in self._shelters:
            self._opened[part] = self._exposure[part]
        for part, let_through in shelters:
            self._opened[part] *= let_through
        if self._shelters or shelters:
            self._water.shelter(self._opened, [part for part, _ in shelters])
        self._shelters = shelters
