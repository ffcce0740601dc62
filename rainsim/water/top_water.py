"""Water on level tops: thin puddles that the relief, the gaps and the edge bound.

Each top is one more small height map. Water runs down it, stands in its hollows and, held back by
its surface tension, up to PINNED over a gap or the edge; what is more runs off to where the top
drips. A shower takes minutes to fill it, and a film seconds pass: so the puddles are worked out for
some amounts of rain, once, and the water on a top says which of them shows.
"""

import numpy as np
from scipy import ndimage

from rainsim.constants import GRAVITY, WATER_VISCOSITY
from rainsim.io import cache
from rainsim.water.fill_spill_merge import SpillGraph

# Water stands over an edge up to 2 sqrt(tension / (density gravity)) sin(angle / 2), 5.4 mm times
# .37 for a contact angle of 43 degrees: between varnished and weathered wood, a guess.
PINNED = 2e-3  # m
ROUGHNESS = 0.7e-3  # m, standard deviation of the relief that a capture does not show; by eye
ROUGHNESS_WIDTHS = (0.02, 0.06)  # m
SHEET_WAY, SHEET_SLOPE = 0.3, 0.01  # m and slope of the way to an edge: usual ones
RAINS = (0.0, 1e-4, 2e-4, 4e-4, 8e-4, 1.6e-3, 3.2e-3, 6.4e-3, 12.8e-3, 0.1)  # m
KIND = "tops"


class TopWater:
    """How water stands on the level tops of a terrain.

    depths : float32 array (k, rows, columns) [m]. Of the puddles after each of
        RAINS, on the tops' patches.
    drawn : float32 array (k, rows, columns) [m]. The same for pictures, see
        `over_gaps`.
    volumes : float64 array (k, n) [m3]. What stands on each top then; the last is
        all that it holds.
    """

    def __init__(self, terrain):
        self.tops, self._grid = terrain.tops, terrain.grid
        if self.tops.level.any():
            found = cache.kept_arrays(KIND, self._fill, self.tops)
            self.depths, self.volumes = found["depths"], found["volumes"]
            self.drawn = np.array([over_gaps(self.tops, depth) for depth in self.depths])
        else:
            self.depths = self.drawn = np.zeros((1, 1, 1), np.float32)
            self.volumes = np.zeros((1, len(self.tops)))

    @property
    def capacity(self):
        """The volume that each top holds when full [m3], ndarray of shape (n,)."""
        return self.volumes[-1]

    def _fill(self):
        tops = self.tops
        bed, open_ = bed_of(tops), ~tops.holds
        graph = SpillGraph(bed, tops.spacing, permeable=open_)
        depths = [np.where(open_, 0, graph.pour(rain)[0]) for rain in RAINS]
        return {
            "depths": np.array(depths, np.float32),
            "volumes": np.array([volumes_of(tops, depth) for depth in depths]),
        }

    def after(self, rain, evaporated=0.0):
        """Return the water [m3] on each top after `rain` [m] and `evaporated` [m], (n,)."""
        if not self.tops.level.any():
            return np.zeros(len(self.tops))
        after = np.interp(rain, RAINS, np.arange(len(RAINS)))
        low = min(int(after), len(RAINS) - 2)
        depth = self.depths[low] + (after - low) * (self.depths[low + 1] - self.depths[low])
        return volumes_of(self.tops, np.maximum(depth - evaporated, 0.0))

    def stage(self, volume):
        """Return which of `depths` shows at a `volume` [m3] on each top, (n,); parts mix two."""
        places = np.arange(len(self.volumes))
        each = [np.interp(v, own, places) for v, own in zip(volume, self.volumes.T, strict=True)]
        return np.array(each, np.float32)

    def room(self):
        """Return the room [m3] of tops above each cell of the terrain, and the top's number, both
        (ny, nx).
        """
        room, top = np.zeros(self._grid.shape), np.full(self._grid.shape, -1)
        for k in np.flatnonzero(self.tops.level):
            x, y = np.meshgrid(*patch_centres(self.tops, k))
            row, column, inside = self._grid.cells(x, y)
            held = self.depths[-1][self.tops.cells_of(k)] * self.tops.spacing**2
            np.add.at(room, (row[inside], column[inside]), held[inside])
            top[row[inside], column[inside]] = k
        return room, top


def sheet_depth(rate):
    """Return the depth [m] of the water that runs off a level top in a rain of `rate` [m/s].

    A laminar sheet carries what falls on its way: h^3 = 3 nu rate way / (g slope) (Nusselt 1916).
    """
    return (3 * WATER_VISCOSITY * rate * SHEET_WAY / (GRAVITY * SHEET_SLOPE)) ** (1 / 3)


def patch_centres(tops, k):
    """Return x (columns,) and y (rows,) of the cells of a top's patch [m]."""
    _, rows, columns = tops.patch[k]
    x, y = tops.corner[k]
    return (x + (np.arange(columns) + 0.5) * tops.spacing,
            y + (np.arange(rows) + 0.5) * tops.spacing)  # fmt: skip


def volumes_of(tops, depth):
    """Return the volume [m3] of a depth [m] on the patches of each top, (n,)."""
    return np.array(
        [float(depth[tops.cells_of(k)].sum(dtype=np.float64)) for k in range(len(tops))]
    ) * (tops.spacing**2)


def over_gaps(tops, depth):
    """Return a depth of water that goes on over gaps and edges, (rows, columns) float32 [m].

    A picture finds a top's gaps where the pixel's own depth puts them, and the depth of its water
    where the ray meets the fitted surface, some millimetres or centimetres beside: gaps in the
    depth would show a second time, as a line of thin film along each.
    """
    drawn = np.zeros(depth.shape, np.float32)
    for k in np.flatnonzero(tops.level):
        cells = tops.cells_of(k)
        if tops.holds[cells].any():
            nearest = ndimage.distance_transform_edt(
                ~tops.holds[cells], return_distances=False, return_indices=True
            )
            drawn[cells] = depth[cells][tuple(nearest)]
    return drawn


def bed_of(tops):
    """Return the heights on which water stands, (rows, columns) [m]: gaps and edges hold it back.

    The relief and, finer than a capture shows, a made-up roughness; what holds no water stands
    PINNED higher, since water leaves over it only from there on.
    """
    rng = np.random.Generator(np.random.PCG64(0))
    rough = np.zeros(tops.relief.shape)
    for width in ROUGHNESS_WIDTHS:
        part = ndimage.gaussian_filter(rng.normal(size=rough.shape), width / tops.spacing)
        rough += part / max(part.std(), 1e-12)
    bed = tops.relief + ROUGHNESS / np.sqrt(len(ROUGHNESS_WIDTHS)) * rough
    return np.where(tops.holds, bed, tops.relief + PINNED)
