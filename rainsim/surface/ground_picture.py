"""The captured ground from straight above: the cameras' pictures laid on it, and their median.

Splats of sparse photographs are no surface, but what a camera sees of the ground lies where its ray
meets the ground. So pictures are laid on the ground by their rays, if the depth is about right.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.numerics.blocks import of_each

SIDE = 384  # cells of the longer side
# Of the cameras' height over the ground, by which what they see of it may be off it, at least and
# at most: between them SCATTERS times the deviation of what is seen. And of a depth, by which the
# ray's end may first be moved to meet the ground, where it is off as much as it may.
LEAST_OFF, MOST_OFF, SCATTERS, OFF_DEPTH = 0.03, 0.1, 2.0, 0.15
LONGEST = 4.0  # cells that a pixel may be long on the ground
MOST_SAMPLES = 2_500_000  # pixels of all cameras together
DARK = 0.004  # linear light below which noise decides
ROBUST, ROUNDS = 0.15, 4  # logarithm of a channel off the mean: half the weight; rounds
BOX = 1, 99  # percentiles of what is seen that the map spans
SHORT = 30  # percentile of the pixels' lengths, that a cell is long at least
FEWEST = 1000  # cells, below which there is no picture


class GroundPicture(NamedTuple):
    """The captured colour of the ground on a square grid, in the ground frame."""

    log: np.ndarray  # (rows, columns, 3) float32, logarithm of linear light; rows along y
    seen: np.ndarray  # (rows, columns) bool
    low: np.ndarray  # (2,) float64 [m], corner of the first cell
    cell: float  # m
    reach: float  # m over the ground, up to which what is seen is taken for ground


def place_on(grid, position):
    """Return rows and columns (n, 2), with fractions, of places [m] on a `low` and a `cell`."""
    return ((position[:, :2] - grid.low) / grid.cell - 0.5)[:, ::-1]


def ground_picture(views):
    """Return the `GroundPicture` of `DepthView`s without their sky; None if they show no ground.

    Cameras expose each picture by itself: what a camera's picture is off the others', as one factor
    for each channel, is taken out.
    """
    pixels = sum(view.depth.size for view in views)
    step = max(1, round((pixels / MOST_SAMPLES) ** 0.5))
    reach = _reach(views, step)
    samples = of_each(lambda view: ground_of(view, step, reach), views)
    where = np.concatenate([one[0] for one in samples]) if samples else np.zeros((0, 2))
    if len(where) < FEWEST:
        return None
    lengths = np.concatenate([one[3] for one in samples])
    length = float(np.percentile(lengths, SHORT))
    low, high = np.percentile(where, BOX, axis=0)
    cell = max(float((high - low).max()) / SIDE, length)
    columns, rows = np.ceil((high - low) / cell).astype(int) + 1
    count = int(rows * columns)
    keys, logs, weights, standing = [], [], [], np.zeros(count)

    def cells(place, good):
        column, row = np.floor((place - low) / cell).astype(int).T
        good = good & (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return (row * columns + column)[good], good

    for place, _, log, long, things in samples:
        key, near = cells(place, long < LONGEST * cell)
        total = np.bincount(key, minlength=count)
        found = np.flatnonzero(total)
        mean = [np.bincount(key, log[near, k], count)[found] / total[found] for k in range(3)]
        long = np.bincount(key, long[near], count)[found] / total[found]
        keys.append(found)
        logs.append(np.stack(mean, -1))
        weights.append(1 / np.maximum(long, cell))
        key, _ = cells(things, np.ones(len(things), bool))
        standing += np.bincount(key, minlength=count) - total
    camera = np.repeat(np.arange(len(views)), [len(key) for key in keys])
    key, log, own = np.concatenate(keys), np.concatenate(logs), np.concatenate(weights)
    exposure, weight = np.zeros((len(views), 3)), own
    for _ in range(ROUNDS):
        level = log - exposure[camera]
        mean = _means(key, weight, level, count)
        off = level - mean[key]
        weight = own / (1 + (np.abs(off).mean(axis=1) / ROBUST) ** 2)
        exposure += _means(camera, weight, off, len(views))
        exposure -= np.median(exposure, axis=0)
    seen = (np.bincount(key, minlength=count) > 0).reshape(rows, columns)
    stands = ndimage.binary_opening((standing > 0).reshape(rows, columns))
    seen &= ~ndimage.binary_dilation(stands)
    return _filled(mean.reshape(rows, columns, 3), seen, low, cell, reach)


def _rays(view, step):
    """Return the rays (n, 3) of pixels that look down on something, a unit deep, and depths (n,).

    And which pixels these are, of every `step`-th.
    """
    depth = view.depth[::step, ::step]
    fx, fy, cx, cy = view.lens
    row, column = (np.arange(0, size, step) + 0.5 for size in view.depth.shape)
    ray = np.empty((*depth.shape, 3))
    ray[..., 0], ray[..., 1], ray[..., 2] = (column - cx) / fx, ((row - cy) / fy)[:, None], 1
    ray = ray @ view.matrix[:, :3]
    shown = np.isfinite(depth) & (ray[..., 2] < 0) & (view.eye[2] > 0)
    return ray[shown], depth[shown], shown


def _reach(views, step):
    """Return how far off its level [m] the ground is seen."""
    height = float(np.median([view.eye[2] for view in views])) if views else 0.0

    def near(view):
        ray, depth, _ = _rays(view, 2 * step)
        off = view.eye[2] + depth * ray[:, 2]
        return off[np.abs(off) < MOST_OFF * height]

    found = of_each(near, views)
    # A quarter of a normal distribution lies within .32 deviations; crowns are half of some views.
    off = np.percentile(np.abs(np.concatenate(found)), 25) if any(map(len, found)) else 0.0
    return float(np.clip(SCATTERS * off / 0.32, LEAST_OFF * height, MOST_OFF * height))


def ground_of(view, step, reach):
    """Return what every `step`-th pixel of a view shows of the ground, and what stands on it.

    Places (n, 2) [m] on the ground, which pixels show these, the logarithms of their light (n, 3)
    and lengths (n,) [m], and the places (m, 2) of what stands.
    """
    ray, depth, shown = _rays(view, step)
    loose = (reach / max(view.eye[2], 1e-6) - LEAST_OFF) / (MOST_OFF - LEAST_OFF)
    off = OFF_DEPTH * min(max(loose, 0), 1) * depth
    along = np.clip(-view.eye[2] / ray[:, 2], depth - off, depth + off)
    place = view.eye + along[:, None] * ray
    long = along * (ray**2).sum(axis=1) / (view.lens[0] * -ray[:, 2])  # away from the camera
    ground = np.abs(place[:, 2]) < reach
    things = view.eye + depth[:, None] * ray
    things = things[things[:, 2] > 2 * reach, :2]
    shown[shown] = ground
    light = np.log(np.maximum(view.light[::step, ::step][shown], DARK))
    return place[ground, :2], shown, light, long[ground], things


def _means(group, weight, values, count):
    """Return the weighted means (count, 3) of values (n, 3) by group; 0 of an empty group."""
    total = np.maximum(np.bincount(group, weight, count), 1e-9)
    return np.stack([np.bincount(group, weight * v, count) for v in values.T], -1) / total[:, None]


def _filled(log, seen, *place):
    """Return the `GroundPicture` without holes of a cell or two and without lone cells."""
    wide = ndimage.gaussian_filter(seen.astype(np.float32), 0.7)
    smooth = [ndimage.gaussian_filter(np.where(seen, c, 0), 0.7) for c in np.moveaxis(log, 2, 0)]
    log = np.stack(smooth, -1) / np.maximum(wide, 1e-3)[..., None]
    whole = ndimage.binary_closing(np.pad(seen, 3), iterations=2)[3:-3, 3:-3]
    whole = ndimage.binary_opening(whole, iterations=2) & (wide > 0.02)
    if np.count_nonzero(whole) < FEWEST:
        return None
    return GroundPicture(log.astype(np.float32), whole, *place)
