"""Puddles: where rain of the past stands on a terrain, and how more rain or sun moves them."""

from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage
from scipy.special import ndtr

from rainsim.errors import ParameterError, require_not_negative
from rainsim.terrain.types import MEASURED
from rainsim.water.fill_spill_merge import SpillGraph

NOISE_FACTOR = 2.0  # depressions shallower than this times the bed's noise are noise
SMALLEST_PUDDLE = 25e-4  # m2: a hand's breadth across; smaller hollows are the capture's own
WET = 1.5e-3  # m of water that counts as a puddle
ERROR_PER_NOISE = 5.0  # of the bed, over what smoothing leaves of its noise
DOUBTFUL_SHARE = 0.5  # of the rain's depth that the bed may be off
LEAST_MEASURED = 0.6  # of the paving: where less is measured, most puddles stand on an assumed bed


def low_ground(terrain):
    """Return the height of the low ground [m], over which water levels are given."""
    return float(np.percentile(terrain.bed.astype(np.float64), 5))


@dataclass
class Puddles:
    """Standing water on a terrain, and the account of the water that left it.

    graph : SpillGraph. Which depression spills into which; built once.
    volumes : dict of str to float [m3]. painted (stood there at the start), rain,
        outflow, infiltrated, evaporated, drained: since the start.
    """

    graph: SpillGraph
    depth: np.ndarray
    volumes: dict = field(
        default_factory=lambda: dict.fromkeys(
            ("painted", "rain", "outflow", "infiltrated", "evaporated", "drained"), 0.0
        )
    )

    @property
    def cell_area(self):
        """Area of a cell [m2]."""
        return self.graph.spacing**2

    @property
    def volume(self):
        """Water that stands [m3]."""
        return float(self.depth.sum()) * self.cell_area

    @property
    def residual(self):
        """Share of the water that the account does not explain: rounding."""
        came = self.volumes["painted"] + self.volumes["rain"]
        gone = sum(v for name, v in self.volumes.items() if name not in ("painted", "rain"))
        return abs(came - gone - self.volume) / max(came, 1e-12)

    def start(self, water):
        """Begin with `water` [m], the painted water's depth (ny, nx), and let it come to rest."""
        water = np.asarray(water, np.float64)
        self.volumes["painted"] += float(water.sum()) * self.cell_area
        self._settle(self.depth + water)

    def rain(self, rainfall):
        """Let `rainfall` [m] (a number or a map) fall and come to rest."""
        rainfall = np.broadcast_to(np.asarray(rainfall, np.float64), self.depth.shape)
        self.volumes["rain"] += float(rainfall.sum()) * self.cell_area
        self._settle(self.depth + rainfall)

    def evaporate(self, depth):
        """Take `depth` [m] off every water surface."""
        require_not_negative("evaporation", depth, "m")
        left = np.maximum(self.depth - depth, 0.0)
        self.volumes["evaporated"] += float((self.depth - left).sum()) * self.cell_area
        self._settle(left)

    def drain(self, row, column, volume):
        """Take up to `volume` [m3] out of the puddle at a cell; return the volume taken [m3]."""
        require_not_negative("volume to drain", volume, "m3")
        ny, nx = self.depth.shape
        if not (0 <= row < ny and 0 <= column < nx):
            raise ParameterError(f"cell ({row}, {column}) is off the map of {ny} x {nx} cells")
        if not self.depth[row, column] > 0:
            return 0.0
        # A drain takes water as far down as the cell it is in.
        pool = ndimage.label(self.depth > 0)[0]
        inside = pool == pool[row, column]
        depth = self.depth[inside]
        lowest = self.depth[row, column]
        wanted = min(volume / self.cell_area, float(np.minimum(depth, lowest).sum()))
        fall = _fall(depth, wanted)
        left = self.depth.copy()
        left[inside] = np.maximum(depth - fall, 0.0)
        taken = float((depth - left[inside]).sum()) * self.cell_area
        self.volumes["drained"] += taken
        self._settle(left)
        return taken

    def _settle(self, water):
        self.depth, outflow, infiltrated = self.graph.pour(water)
        self.volumes["outflow"] += outflow
        self.volumes["infiltrated"] += infiltrated

    def count(self, wet=WET):
        """Return the number of puddles with water of at least `wet` [m]."""
        return int(ndimage.label(self.depth >= wet)[1])


def _fall(depth, wanted):
    """Return by how much the level must fall to take `wanted` [m summed over the cells]."""
    ordered = np.sort(depth)
    # Taking a fall f removes the sum of min(depth, f).
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    number = len(ordered)
    taken = sums[:-1] + (number - np.arange(number)) * ordered
    k = min(int(np.searchsorted(taken, wanted)), number - 1)
    return (wanted - sums[k]) / (number - k)


def puddles_of(terrain):
    """Return the `Puddles` of a terrain before rain: dry but for water that a user put there.

    Depressions shallower than twice the noise that is left in the smoothed bed, or smaller than a
    hand, are the capture's own and hold no water; the graph counts them as `dropped`.
    """
    graph = SpillGraph(
        terrain.bed, terrain.grid.spacing, permeable=terrain.soaks,
        minimum_depth=NOISE_FACTOR * bed_noise(terrain), minimum_area=SMALLEST_PUDDLE,
    )  # fmt: skip
    puddles = Puddles(graph, np.zeros(terrain.grid.shape))
    for water in (terrain.water, terrain.poured):
        if water is not None and water.any():
            puddles.start(water)
    return puddles


def bed_noise(terrain):
    """Return the noise [m] that smoothing has left in the bed of the paving.

    Neighbouring cells share splats, so the noise falls with the area averaged over in units of the
    splats' own size, some 2 cm, not of the cells'.
    """
    from rainsim.terrain.bed import smoothing_width

    noise = terrain.hard_noise
    width = smoothing_width(noise)
    splat = max(terrain.grid.spacing, 0.02)
    return noise * min(1.0, splat / (2 * np.sqrt(np.pi) * width))


def bed_error(terrain):
    """Return how far the bed of the paving is off [m], root mean square.

    Smoothing leaves slow waves besides what it leaves of the noise: in synthetic captures with 1, 3
    and 10 mm of noise (`benchmarks ground`) the bed is 4.7, 4.9 and 5.0 times that off.
    """
    return ERROR_PER_NOISE * bed_noise(terrain)


def probability(terrain, depth):
    """Return how probable water is where it is shown: the mean over all puddles; None without any.

    Water stands in a cell if the bed is below the water's level. The bed is off by `bed_error`,
    normally distributed, so water of depth h stands there with the probability Phi(h / error).
    """
    shown = depth[depth >= WET]
    if not shown.size:
        return None
    return float(np.mean(ndtr(shown / max(bed_error(terrain), 1e-9))))


def doubt(terrain, rain):
    """Return why the puddles of a rain [m] are not to be believed, or None if they may be."""
    paving = terrain.sealed
    if not paving.any() or terrain.layer.size:  # an assumed bed is said to be one
        return None
    measured = float(np.mean(terrain.source[paving] == MEASURED))
    error, reasons = bed_error(terrain), []
    if error > DOUBTFUL_SHARE * rain > 0:
        reasons.append(f"the bed is some {error * 1e3:.1f} mm off")
    if measured < LEAST_MEASURED:
        reasons.append(f"only {measured:.0%} of the paving is measured")
    if not reasons:
        return None
    why = " and ".join(reasons)
    return f"puddles of up to {rain * 1e3:g} mm of rain are NOT TO BE BELIEVED here: {why}"


def wet_share(depth, mask, wet=WET):
    """Return the share of the masked cells under at least `wet` [m] of water."""
    return float(np.mean(depth[mask] >= wet)) if mask.any() else 0.0
