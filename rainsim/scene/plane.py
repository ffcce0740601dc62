"""The dominant, lowest plane in a cloud of weighted points: random sampling, then least squares."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

HYPOTHESES = 2048  # with a plane that holds 15 % of the weight some 7 of them lie all in it
SCORED_POINTS = 6000  # a plane's score is then known to about 1 %
THRESHOLD = 0.005  # of the search radius: 1 cm for a capture that is walked in a 2 m circle
ROUGHER = (0.015, 0.04)  # thresholds for lawns and meadows, once nothing flat was found
ABOVE_SHARE = 0.95  # of the viewpoints must stand above the ground; a few may be badly placed
LOWER_SHARE = 0.3  # of the best plane's score is what a lower one needs to be preferred
ROUNDS = 30  # of a refinement, at most
RIVAL_ANGLE = np.radians(3.0)  # planes that lean more apart are two; a street's camber has 2.9
RIVAL_SHARE = 0.65  # of the best plane's score from which another is as good
# A plane is a roof or a ramp and not the ground if more than ABOVE_MOST of its weight lies above
# the other plane and less than ABOVE_LEAST of the other plane's weight lies above it.
ABOVE_MOST, ABOVE_LEAST = 0.9, 0.6
SPREAD_CELLS = 16  # the support's spread is counted on a grid of this many cells across

# Values of support, peak and spread that give full confidence. Points that fill a ball evenly have
# a support of 0.008, a peak of 0.5 and little spread.
FULL_SUPPORT, MOST_SUPPORT = (
    0.05,
    0.4,
)  # FULL_SUPPORT at THRESHOLD; a thicker slab holds more points
LEAST_PEAK, FULL_PEAK = 0.5, 0.8
FULL_SPREAD = 0.15

# Walls, in units of the distance to what the cameras look at: half thickness, and width of a place,
# which votes once however many splats are in it; how far off they may be; how tall they must be.
WALL_THICKNESS, WALLS_WITHIN, TALL = 0.01, 3.0, 0.25
MOST_WALLS, DRAWS, TRIED, MOST_PLACES = 4, 4, 400, 30_000
LEANING = np.radians(6.0)  # from upright by the cameras; what leans more is no wall
# Least share of the places, and `Plane.peak`. Walls of four captures have .05 to .21 and .65 to
# .78; upright planes in a garden and on a beach .01 to .03 and .5 to .83.
WALL_SHARE, WALL_PEAK = 0.04, 0.62


@dataclass(frozen=True, slots=True)
class Plane:
    """Points p with normal @ p + offset = 0; above it the sum is the height.

    normal : float64 array (3,). Unit, pointing up.
    offset : float [capture units]
    confidence : float. 0 to 1: product of support, peak and spread, each relative
        to its value for full confidence.
    threshold : float [capture units]. Half thickness of the slab whose points
        count as on the plane.
    support : float. Share of the weight in that slab.
    peak : float. 0.5 if the slab holds no more weight than equal space beside it,
        1 if that is empty.
    spread : float. Share of the region across which the points in the slab lie.
    rival : Plane or None. Another plane with as much support and another normal,
        if there is one.
    by_cameras : bool. Whether it is level by the cameras, and only its height is
        that of splats.
    """

    normal: np.ndarray
    offset: float
    confidence: float
    threshold: float = 0.0
    support: float = 0.0
    peak: float = 0.0
    spread: float = 0.0
    rival: Plane | None = None
    by_cameras: bool = False

    def height(self, points):
        """Height of `points` of shape (..., 3) above the plane [capture units]."""
        return points @ self.normal + self.offset


def find_plane(points, weights, eyes, up, max_angle, radius, seed=0, thickness=THRESHOLD):
    """Find the lowest well-supported plane among weighted points.

    points : float64 array (n, 3) [capture units]
    up : float64 array (3,), or None. Roughly up, unit length. Without it and
        without eyes most points lie above the plane.
    max_angle : float [radians]. How far the normal may lean from `up`.
    radius : float [capture units]. Size of the region that holds the points;
        lengths are measured by it.
    seed : int. Of the random triplets; the answer is the same for the same seed.
    thickness : float. Half thickness of the slab about a plane whose points count
        as on it, in units of `radius`.
    Returns Plane or None. None if no triplet of points spans a plane that is
        allowed.
    """
    if len(points) < 3:
        return None
    origin = points.mean(axis=0)  # keeps rounding small when the capture lies far from zero
    points, eyes = points - origin, eyes - origin
    rng = np.random.default_rng(seed)
    chance = np.cumsum(weights) / weights.sum()
    normals, offsets = _hypotheses(points, chance, rng)
    normals, offsets = _allowed(normals, offsets, eyes, up, max_angle)
    if not len(normals):
        return None
    threshold = thickness * radius
    sample = points[_draw(chance, SCORED_POINTS, rng)]
    score = _scores(normals, offsets, sample, threshold)
    if up is not None:
        score *= normals @ up  # of equally good planes the one that leans less is taken
    cloud = _Slab(points, weights, eyes, up, max_angle, threshold, radius)
    best = cloud.settle(normals[np.argmax(score)], offsets[np.argmax(score)])
    if best is None:
        return None
    along = normals @ best.normal
    leaning = (along if len(eyes) or up is not None else np.abs(along)) < np.cos(RIVAL_ANGLE)
    rival, second = None, np.where(leaning, score, 0)
    if (
        second.max() >= 0.5 * RIVAL_SHARE * score.max()
    ):  # triplets fit less well than refined planes
        rival = cloud.settle(normals[np.argmax(second)], offsets[np.argmax(second)])
    if rival is not None:
        best, rival = _compared(best, rival, sample, cloud)
    if rival is not None:
        rival = replace(rival, offset=float(rival.offset - rival.normal @ origin))
    return replace(best, offset=float(best.offset - best.normal @ origin), rival=rival)


class _Slab:
    """Weighted points, and the conditions that a plane through them must fulfil."""

    def __init__(self, points, weights, eyes, up, max_angle, threshold, radius):
        self.points, self.weights, self.eyes, self.up = points, weights, eyes, up
        self.max_angle, self.threshold, self.radius = max_angle, threshold, radius

    def settle(self, normal, offset):
        """Refine a hypothesis to a Plane; None if the refined plane breaks the conditions."""
        points, weights, threshold = self.points, self.weights, self.threshold
        normal, offset = _refine(points, weights, normal, offset, threshold)
        if not len(self.eyes) and self.up is None:
            away = points @ normal + offset
            if weights[away > threshold].sum() < weights[away < -threshold].sum():
                normal, offset = -normal, -offset
        normal, offset = _go_down(points, weights, normal, offset, threshold)
        normal, offset = _sharpen(points, weights, normal, offset, threshold)
        allowed = _allowed(normal[None], np.array([offset]), self.eyes, self.up, self.max_angle)[0]
        if not len(allowed):
            return None
        return _judged(points, weights, normal, offset, threshold, self.radius)


def _compared(best, rival, sample, cloud):
    """Return the better plane, and as its rival the other one if that is as good, else None."""
    if best.normal @ rival.normal > np.cos(RIVAL_ANGLE):  # both were refined to the same plane
        return best, None
    normals = np.stack([best.normal, rival.normal])
    share = _scores(normals, np.array([best.offset, rival.offset]), sample, cloud.threshold)
    if share[1] < RIVAL_SHARE * share[0]:
        return best, None
    over = [_share_above(one, other, cloud) for one, other in ((best, rival), (rival, best))]
    if over[0] > ABOVE_MOST and over[1] < ABOVE_LEAST:
        return rival, None
    if over[1] > ABOVE_MOST and over[0] < ABOVE_LEAST:
        return best, None
    return best, rival


def _share_above(one, other, cloud):
    """Return the share of the weight on the plane `one` that lies above the plane `other`."""
    weights = cloud.weights * (np.abs(one.height(cloud.points)) < cloud.threshold)
    return weights[other.height(cloud.points) > 0].sum() / max(weights.sum(), 1e-300)


def _draw(chance, size, rng):
    drawn = np.searchsorted(chance, rng.random(size), side="right")
    return np.minimum(drawn, len(chance) - 1)


def _hypotheses(points, chance, rng):
    """Return unit normals (n, 3) and offsets (n,) of planes through random triplets."""
    a, b, c = (points[_draw(chance, HYPOTHESES, rng)] for _ in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    sides = np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    fine = length > 0.05 * sides  # slivers span no plane
    normals = normals[fine] / length[fine, None]
    return normals, -np.einsum("nj,nj->n", normals, a[fine])


def _allowed(normals, offsets, eyes, up, max_angle):
    """Turn the normals upwards and keep the planes that lie below the eyes and lean little."""
    heights = normals @ eyes.T + offsets[:, None]
    rising = normals @ up if up is not None else (heights > 0).sum(axis=1) - len(eyes) / 2
    sign = np.where(rising < 0, -1.0, 1.0)
    normals, offsets, heights = normals * sign[:, None], offsets * sign, heights * sign[:, None]
    keep = np.ones(len(normals), bool)
    if up is not None:
        keep &= normals @ up >= np.cos(max_angle)
    if len(eyes):
        keep &= (heights > 0).mean(axis=1) >= ABOVE_SHARE
    return normals[keep], offsets[keep]


def _scores(normals, offsets, sample, threshold):
    """Share of the sample on each plane, with weights that fall linearly to 0 at the threshold."""
    normals, offsets = normals.astype(np.float32), offsets.astype(np.float32)
    sample, scale = sample.T.astype(np.float32), np.float32(1 / threshold)
    score = np.empty(len(normals))
    for start in range(0, len(normals), 128):  # 3 MB at a time stays in the cache
        part = slice(start, start + 128)
        away = np.abs(normals[part] @ sample + offsets[part, None])
        np.subtract(np.float32(1), away * scale, out=away)
        score[part] = np.maximum(away, 0, out=away).mean(axis=1)
    return score


def _refine(points, weights, normal, offset, threshold):
    """Fit the plane by least squares with Tukey's biweight until it stands still."""
    for _ in range(ROUNDS):
        away = (points @ normal + offset) / threshold
        near = np.abs(away) < 1
        share = weights[near] * (1 - away[near] ** 2) ** 2
        total = share.sum()
        if np.count_nonzero(near) < 3 or not total > 0:
            break
        centre = share @ points[near] / total
        spread = points[near] - centre
        _, axes = np.linalg.eigh((spread * share[:, None]).T @ spread)
        before, normal = normal, axes[:, 0] * (1 if axes[:, 0] @ normal > 0 else -1)
        offset = -normal @ centre
        if np.linalg.norm(normal - before) < 1e-9:
            break
    return normal, offset


def _go_down(points, weights, normal, offset, threshold):
    """Return the plane moved down to the lowest well-supported layer: the paving, not the lawn."""
    bin_size = threshold / 2
    height = points @ normal + offset
    bins = np.floor(height / bin_size).astype(np.int64)
    lowest = max(bins.min(), -10_000)
    inside = (bins >= lowest) & (bins <= 4)
    mass = np.bincount(bins[inside] - lowest, weights[inside], minlength=5 - lowest)
    window = np.convolve(mass, [0.5, 1, 1, 0.5], mode="same")
    peak = window[-10:].max()  # of the plane itself
    inner = window[1:-1]
    peaks = (inner >= window[:-2]) & (inner >= window[2:]) & (inner >= LOWER_SHARE * peak)
    layers = (np.flatnonzero(peaks) + 1 + lowest) * bin_size
    layers = layers[layers < -2 * threshold]
    if not len(layers):
        return normal, offset
    return _refine(points, weights, normal, offset - layers[0], threshold)


def _sharpen(points, weights, normal, offset, threshold):
    """Fit once more with a threshold that follows from the points' own roughness."""
    away = np.abs(points @ normal + offset)
    near = away < threshold
    if not near.any():
        return normal, offset
    order = np.argsort(away[near])
    total = np.cumsum(weights[near][order])
    middle = away[near][order][np.searchsorted(total, total[-1] / 2)]
    wanted = np.clip(6 * middle, threshold / 4, threshold)  # 4 standard deviations
    return _refine(points, weights, normal, offset, wanted)


def _judged(points, weights, normal, offset, threshold, radius):
    """Return the Plane with its confidence: support x sharpness x spread, each 0 to 1."""
    away = np.abs(points @ normal + offset)
    on_it, around = away < threshold, (away >= threshold) & (away < 3 * threshold)
    inner, ring = weights[on_it].sum(), weights[around].sum()
    if not inner > 0:
        return Plane(normal, offset, 0.0, threshold)
    support = inner / weights.sum()
    peak = inner / (inner + ring / 2)
    across = np.linalg.svd(normal[None])[2][1:]
    cells = np.floor(points[on_it] @ across.T / (2 * radius / SPREAD_CELLS)).astype(np.int64)
    # A cell counts when it holds a tenth of an even share, so that strays do not.
    _, which = np.unique(cells, axis=0, return_inverse=True)
    mass = np.bincount(which.ravel(), weights[on_it])
    filled = np.count_nonzero(mass > 0.1 * inner / SPREAD_CELLS**2)
    spread = filled / SPREAD_CELLS**2
    full = min(MOST_SUPPORT, FULL_SUPPORT * threshold / (THRESHOLD * radius))
    shares = support / full, (peak - LEAST_PEAK) / (FULL_PEAK - LEAST_PEAK), spread / FULL_SPREAD
    confidence = float(np.prod(np.clip(shares, 0, 1)))
    return Plane(normal, offset, confidence, threshold, float(support), float(peak), spread)


def upright_planes(points, eye, up, reach, seed=0):
    """Return unit normals (n, 3) of the sure walls among points, at most four."""
    rng, threshold, walls = np.random.default_rng(seed), WALL_THICKNESS * reach, []
    left = _places(points - eye, WALLS_WITHIN * reach, threshold)
    left = left[:: max(1, math.ceil(len(left) / MOST_PLACES))]
    least = max(WALL_SHARE * len(left), 3)
    while len(walls) < MOST_WALLS and len(left) > least:
        chance = np.arange(1, len(left) + 1) / len(left)
        drawn = [_hypotheses(left, chance, rng) for _ in range(DRAWS)]
        normals, offsets = (np.concatenate(part) for part in zip(*drawn, strict=True))
        upright = np.flatnonzero(np.abs(normals @ up) < np.sin(LEANING))[:TRIED]
        if not len(upright):
            break
        normals, offsets = normals[upright], offsets[upright]
        sample = left[_draw(chance, SCORED_POINTS, rng)]
        best = np.argmax(_scores(normals, offsets, sample, threshold))
        normal, offset = _refine(left, np.ones(len(left)), normals[best], offsets[best], threshold)
        away = np.abs(left @ normal + offset)
        inner = np.count_nonzero(away < threshold)
        ring = np.count_nonzero(away < 3 * threshold) - inner
        if inner < least or inner < WALL_PEAK * (inner + ring / 2):
            break
        low, high = np.quantile(left[away < threshold] @ up, [0.05, 0.95])
        if high - low > TALL * reach and abs(normal @ up) < np.sin(LEANING):
            walls.append(normal)
        left = left[away >= 2 * threshold]
    return np.array(walls).reshape(-1, 3)


def _places(points, within, width):
    """Return the mean of the points (n, 3) in each cell of space, of those that are near enough."""
    points = points[np.einsum("nj,nj->n", points, points) < within**2]
    if not len(points):
        return points
    cells = np.floor((points - points.min(axis=0)) / width).astype(np.int64)
    number = np.ravel_multi_index(cells.T, cells.max(axis=0) + 1)
    _, which, count = np.unique(number, return_inverse=True, return_counts=True)
    return np.stack([np.bincount(which, axis) / count for axis in points.T], axis=1)
