"""Prepared splats of a static set with those of actors before them.

The static set is prepared and copied once; for each moment only the actors' chunks are written,
into the room that lies before it. The actors come first because pictures can leave out the last
chunks.
"""

from dataclasses import replace

import numpy as np

from rainsim.splatting.prepared import LANES, NOBODY

_ARRAYS = ("geometry", "sh", "fine", "step", "box")


class Merger:
    """Puts actors before a static set, one moment after another.

    static : PreparedSplats
    most : int. Splats of all actors together, at most.
    static : PreparedSplats. The static set, in the memory that merged sets share.
    """

    def __init__(self, static, most):
        self._room = -(-most // LANES)
        self._arrays = {}
        for name in _ARRAYS:
            own = getattr(static, name)
            array = np.zeros((self._room + len(own), *own.shape[1:]), own.dtype)
            array[self._room :] = own
            self._arrays[name] = array
        self.static = replace(static, **{n: a[self._room :] for n, a in self._arrays.items()})

    def recolor(self, static):
        """Take over other colours of the static set, see `prepared.recolored`."""
        for name in ("sh", "fine", "step"):
            self._arrays[name][self._room :] = getattr(static, name)
        self.static = replace(self.static)  # another set, for those who ask whether it is the same

    def merged(self, actors, first):
        """Return the static set with prepared actors before it; overwritten by the next call.

        actors : PreparedSplats or None. Harmonics of the same degree as the
            static set's.
        first : int. Index that the actors' first splat has in the merged scene:
            the static set's length.
        """
        if actors is None or not len(actors):
            return self.static
        begin = self._room - len(actors.box)
        for name in _ARRAYS:
            self._arrays[name][begin : self._room] = getattr(actors, name)
        order = np.full(len(actors.box) * LANES + len(self.static), NOBODY, np.int32)
        order[: len(actors)] = actors.order + np.int32(first)
        order[len(actors.box) * LANES :] = self.static.order
        leading = self.static.leading
        return replace(
            self.static, **{name: self._arrays[name][begin:] for name in _ARRAYS}, order=order,
            leading=None if leading is None else leading + len(actors.box),
        )  # fmt: skip
