"""Twin of `rain.moving_surfaces`: the map that drops meet on a device, with actors on it.

The host puts the actors onto its map; the windows that they cover, and have covered, are sent.
"""

import numpy as np

from rainsim.cuda.driver import send
from rainsim.cuda.drops import sent_surfaces
from rainsim.cuda.moving_map import MovingMap
from rainsim.jit import may_run_beside
from rainsim.rain.moving_surfaces import MovingSurfaces

ABOVE = 0.01  # m; lines are followed from this far above all that moves
FIELDS = ("top", "underside")
BLOCKS = ("patch_high", "around_high")


class MovingHeights:
    """The height fields of a terrain with the actors on it, on a device; `still` is without."""

    def __init__(self, still, footprints):
        fields = sent_surfaces(still)
        highest = max((footprint.highest for footprint in footprints), default=-np.inf)
        self.fields = fields._replace(sky=max(fields.sky, highest + ABOVE))
        self._maps = {name: MovingMap(getattr(self.fields, name)) for name in FIELDS}
        self._there = still

    def send(self, surfaces):
        """Queue the sending of those of `MovingSurfaces.moment`."""
        if surfaces is self._there:
            return
        found = surfaces.height_fields()
        for name, there in self._maps.items():
            there.send(getattr(found, name), surfaces.changes)
        if surfaces.changes or self._there.changes:
            for name in BLOCKS:
                send(getattr(self.fields, name), getattr(found, name))
        self._there = surfaces


class Shelter:
    """What moves over the water of a device keeps the rain off it."""

    def __init__(self, terrain, wind, sources):
        self._moving, self._sources = MovingSurfaces(terrain, *wind), sources
        self._shelters, self._opened = [], sources.exposure.copy()

    def move(self, time, *following):
        """Let less rain reach the ground below what is there at a time [s].

        Those of the `following` times [s] are looked for beside what is done next.
        """
        _, shelters = self._moving.moment(time)
        if may_run_beside():
            self._moving.look_ahead(following)
        if shelters is self._shelters:
            return
        exposure = self._sources.exposure
        for part, _ in self._shelters:
            self._opened[part] = exposure[part]
        for part, let_through in shelters:
            self._opened[part] *= let_through
        if self._shelters or shelters:
            self._sources.shelter(self._opened, [part for part, _ in shelters])
        self._shelters = shelters
