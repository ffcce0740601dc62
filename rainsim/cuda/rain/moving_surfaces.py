"""Twin of `rain.moving_surfaces`: the map that drops meet on a device, with actors on it.

The host puts the actors onto its map; the rows that they cover, and have covered, are sent.
"""

from __future__ import annotations

import numpy as np

from rainsim.cuda.driver import Staging
from rainsim.cuda.drops import sent_surfaces

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
        self._rows = []  # that actors cover on the device

    def send(self, surfaces, shelters):
        """Send the map of `MovingSurfaces.moment`; the device must draw nothing meanwhile."""
        found, rows = surfaces.height_fields(), [part[0] for part, _ in shelters]
        for part in joined_rows([*self._rows, *rows]):
            for name in FIELDS:
                self._staging.send(getattr(self.fields, name)[part], getattr(found, name)[part])
        if self._rows or rows:
            for name in BLOCKS:
                self._staging.send(getattr(self.fields, name), getattr(found, name))
        self._rows = rows


def joined_rows(parts):
    """Return slices of rows that cover the same rows as `parts`, each once, in their order."""
    found = []
    for part in sorted(parts, key=lambda part: part.start):
        if found and part.start <= found[-1].stop:
            found[-1] = slice(found[-1].start, max(found[-1].stop, part.stop))
        else:
            found.append(part)
    return found
