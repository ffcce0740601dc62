"""The map that drops hit over time: the still map, with actors over it."""

import math
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from rainsim.actors.footprint import put_on, shadows_on
from rainsim.actors.motion import same_place
from rainsim.jit import set_threads
from rainsim.numerics.windows import placed, widened, window_of
from rainsim.rain.exposure import rain_exposure
from rainsim.rain.heightfield import Surfaces
from rainsim.terrain.types import Grid

# Finds what moves at times that are to come; some of the threads wait for what others find. Their
# kernels are short, and take one core each.
AHEAD = ThreadPoolExecutor(8, initializer=lambda: set_threads(1))
FRAMES_AHEAD = 4  # of which what moves is looked for: it takes longer than a GPU draws two
MARGIN = 0.35  # m around an actor in which it thins the rain, besides what the wind adds: the blur
SLOWEST = 4.0  # m/s: drops of 1 mm, the slowest whose paths the exposure follows


class Heights(NamedTuple):
    """A part of a terrain, as `rain_exposure` takes it."""

    grid: Grid
    bed: np.ndarray
    top: np.ndarray
    underside: np.ndarray


def begun(before, times, kept, find):
    """Return futures by times [s]: those of `before` and `kept`, else `find(time)` begun."""
    there = {time: before[time] for time in kept if time in before}
    return there | {time: before.get(time) or AHEAD.submit(find, time) for time in times}


class MovingSurfaces:
    """The surfaces of a terrain with the actors on it, one moment after another.

    roughness : float [m]. See `rain.wind.wind_shares`.
    """

    def __init__(self, terrain, wind=(0.0, 0.0), roughness=0.0):
        self._terrain, self._wind, self._roughness = terrain, wind, roughness
        grid, heights = terrain.grid, (terrain.bed, terrain.top, terrain.underside)
        self.still = Surfaces(grid.spacing, grid.origin, *heights)
        self._moment, self._coming = None, {}
        self._known = [], None  # poses, and the moment when actors were last found there

    def at(self, time):
        """Return the `Surfaces` at a time [s]."""
        return self.moment(time)[0]

    def moment(self, time):
        """Return the `Surfaces` at a time [s] and the parts of the map that actors shelter.

        Returns surfaces : Surfaces
            shelters : list of (part, share). Rows and columns, two slices, and
                the share of the rain there that the actors let through to the
                ground, float32. Parts may overlap: shares are multiplied.
        """
        if not self._terrain.footprints:
            return self.still, []
        if self._moment is None or self._moment[0] != time:
            ahead = self._coming.get(time)
            self._moment = time, *(self._found(time) if ahead is None else ahead.result())
        return self._moment[1:]

    def look_ahead(self, times, kept=()):
        """Begin to find `moment` at some times on other threads; return the `Future` of each.

        What was begun for other times is let go, but for those in `kept`. The present moment stays
        until another is asked for.
        """
        self._coming = begun(self._coming, times, kept, self._found)
        return [self._coming[time] for time in times]

    def thinned(self, share, time):
        """Return a share of the rain on the map (ny, nx) with that of actors at a time [s]."""
        shelters = self.moment(time)[1]
        if not shelters:
            return share
        share = share.copy()
        for part, let_through in shelters:
            share[part] *= let_through
        return share

    def _found(self, time):
        """Return the moment of a time; that of actors which stand as they stood is the same one."""
        poses = [footprint.motion.at(time) for footprint in self._terrain.footprints]
        known, moment = self._known
        if moment is None or not all(map(same_place, poses, known)):
            moment = self._made(time)
            self._known = poses, moment
        return moment

    def _made(self, time):
        terrain = self._terrain
        shadows = shadows_on(terrain.grid, terrain.footprints, time)
        if not shadows:
            return self.still, []
        top, underside = self.still.top.copy(), self.still.underside.copy()
        there = [s for s in shadows if put_on(terrain.bed, top, underside, s).any()]
        if not there:
            return self.still, []
        surfaces = self.still.changed(top, underside, [shadow.part for shadow in there])
        shelters = map(self._shelter, there)
        return surfaces, [shelter for shelter in shelters if shelter is not None]

    def _shelter(self, shadow):
        """Return the part of the map that an actor shelters and the share let through, or None."""
        terrain, grid = self._terrain, self._terrain.grid
        high = float(np.nanmax(shadow.top)) - float(terrain.bed[shadow.part].min())
        margin = MARGIN + self._wind[0] / SLOWEST * max(high, 0.0)
        margin = math.ceil(margin / grid.spacing)
        part, inner = widened(shadow.part, margin, grid.shape)
        bed = terrain.bed[part].copy()
        own = Heights(Grid(bed.shape, (0.0, 0.0), grid.spacing), bed, bed.copy(), bed.copy())
        put_on(own.bed, own.top, own.underside, shadow._replace(part=inner))
        share = rain_exposure(own, self._wind, self._roughness)
        here = window_of(share < 1)
        return None if here is None else (placed(here, part), share[here])
