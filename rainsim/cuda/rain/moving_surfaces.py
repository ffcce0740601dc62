"""Twin of `rain.moving_surfaces`: the map that drops meet on a device, with actors on it.

The host puts the actors onto its map; the windows that they cover, and have covered, are sent.
"""

from __future__ import annotations

import numpy as np

from rainsim.cuda.driver import Staging
from rainsim.cuda.drops import sent_surfaces
from rainsim.cuda.moving_map import MovingMap

ABOVE = 0.01  # m; lines are followed from this far above all that moves
FIELDS = ("top", "underside")
BLOCKS = ("patch_high", "around_high")


class MovingHeights:
    """The height fields of a terrain with the actors on it, on a device.

    Parameters
    ----------
    still : Surfaces
        Without what moves.
    footprints : sequence of Footprint
    stream : numba.cuda.stream

    Attributes
    ----------
    fields : HeightFields
        Of device arrays, at fixed addresses, with a sky above all that the actors ever reach: a
        recorded queue holds them.
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
