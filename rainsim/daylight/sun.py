"""The sun of a capture, from the shadows that it cast.

Along each direction the visible share of places is compared with their brightness: pairs of near
places of one surface, alike in colour, tell light from paint. The direction whose shadow edges lie
where brightness changes is the sun's.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.daylight.lit_surface import luminance
from rainsim.daylight.sky_light import hemisphere
from rainsim.daylight.visibility import (
    BATCH,
    COARSER,
    axes_of,
    coarsened,
    draw_heights,
    find_seen,
    resized,
)
from rainsim.numerics.blocks import in_blocks
from rainsim.numerics.places import cells_and_sides, group_means, nearest

CELL = 0.07  # m, of the places that are compared
REACH = 0.5  # m between two of them
NEAR, PARTNERS = 60, 12  # places next to each, and those of them that it is compared with
SAME_PLANE = 0.92  # cosine between their normals
OFF_PLANE = 0.07  # of the distance between two places, that they may be apart along their normals
# Logarithm of red over green, and of green over blue, of the brighter place less the darker one's:
# paint is the same where light may make the difference, and the sun is redder than the sky.
SAME_PAINT = -0.25, 0.9
MOST_CHANGE = 1.6  # of the logarithm of brightness, beyond which it counts as this
DIM = 0.004  # linear light below which noise decides
DIRECTIONS = 240  # of the first search
LEAST_HEIGHT = 0.07  # sine of the elevation: lower suns light no ground
COARSE, FINE = 448, 1024  # px, sides of the maps of the search
AT_ONCE = 32  # directions whose strengths are found together
CANDIDATES = 4  # of the first search that are refined
FIRST_STEP = 0.09  # rad, of the refinement in coarse maps
LEAST_SCORE = 0.08  # of the coarse maps, from which a sun is sought any further
# Radius of the discs of directions that are searched then, of the order of the distance between
# those of the first search, and the distance between their own: the straight edge of a shadow
# agrees with many directions, shadows of leaves only with one that is right to a place's width.
DISC, SPACED = 0.12, 0.03  # rad
GIVEN_DISC = 0.09  # rad: a sun that is read off a map or a clock may be 5 degrees off
TOPS = 4  # of the discs that are refined in fine maps
STEPS = (0.015, 0.015, 0.008, 0.004)  # rad
# The direction is found to less than a degree by sharp shadows alone, each by itself: those of
# leaves are blurred and longer than their outlines say. So places are compared in blocks of this
# size, and a block counts by a power of how well it agrees.
BLOCK, AGREEMENT = 1.0, 4  # m
FAINT = 4.0  # sum of squares of changes of visibility that tells nothing yet
MARGIN = 0.025  # m by which what casts a shadow stands above it


class Places(NamedTuple):
    """Places of a surface and pairs of near places."""

    position: np.ndarray  # (n, 3) float32 [m]
    normal: np.ndarray  # (n, 3) float32
    light: np.ndarray  # (n, 3) float32, linear
    pair: np.ndarray  # (p, 2) int64
    change: np.ndarray  # (p,) float32, of the logarithm of brightness


def places_of(surface, window):
    """Return the `Places` on the flat surfaces within a window."""
    half = 0.5 * window.side * window.pixel
    inside = (np.abs(surface.position - window.middle) < half).all(axis=1)
    which = np.flatnonzero(inside & (surface.flat > 0.5))
    if len(which) < 2:
        none = np.zeros((0, 3), np.float32)
        return Places(none, none, none, np.zeros((0, 2), np.int64), np.zeros(0, np.float32))
    normal = surface.normal[which]
    group = cells_and_sides((surface.position[which] - window.middle + half) / CELL, normal)
    weight = surface.flat[which].astype(np.float64)
    position, normal, light = (
        group_means(group, values, weight).astype(np.float32)
        for values in (surface.position[which], normal, surface.light[which])
    )
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
    pair = _pairs(position, normal, light)
    change = np.log(np.maximum(luminance(light), DIM))
    change = np.clip(change[pair[:, 0]] - change[pair[:, 1]], -MOST_CHANGE, MOST_CHANGE)
    return Places(position, normal, light, pair, change.astype(np.float32))


def _pairs(position, normal, light):
    """Return pairs of near places of one plane and about one colour, each once."""
    _, near, known = nearest(position, position, NEAR, REACH)
    # Every few of the neighbours, so that pairs are of all lengths.
    some = slice(1, None, max(1, near.shape[1] // PARTNERS))
    first, column = np.nonzero(known[:, some])
    second = near[:, some][first, column]
    first, second = first[first != second], second[first != second]
    alike = of_one_paint(position, normal, light, first, second)
    return np.stack([first[alike], second[alike]], -1)


def of_one_paint(position, normal, light, first, second):
    """Return which pairs of places (p,), numbers of them, are of one plane and about one colour."""
    log = np.log(np.maximum(light, DIM / 2))
    tint = log[:, :2] - log[:, 1:]
    alike = np.einsum("ij,ij->i", normal[first], normal[second]) > SAME_PLANE
    step = position[second] - position[first]
    off = np.abs(np.einsum("ij,ij->i", step, normal[first] + normal[second]))
    alike &= off < 2 * OFF_PLANE * np.linalg.norm(step, axis=1)
    bright = luminance(light)
    sign = np.where(bright[first] > bright[second], 1, -1)[:, None]
    redder = (tint[first] - tint[second]) * sign
    alike &= ((redder > SAME_PAINT[0]) & (redder < SAME_PAINT[1])).all(axis=1)
    return alike & (np.maximum(bright[first], bright[second]) > 2 * DIM)


def find_sun(places, solids, plane, window, given=None):
    """Return the unit direction from which light agrees best with the shadows, and how well.

    Of all directions, or of those within GIVEN_DISC of a unit vector that is given: by the horizon
    it comes back with a score of 0. `plane` are the solids `with_plane`; of the window middle and
    width count, the maps have sides of their own. The score is the correlation of brightness with
    visibility over the pairs that it tells apart.
    """
    width = window.side * float(window.pixel)
    coarse, fine = (
        [coarsened(s, COARSER * width / side) for s in (solids, plane)] for side in (COARSE, FINE)
    )
    if given is not None:
        near = _near([given], GIVEN_DISC)
        if not len(near):
            return given, 0.0
    else:
        likely = _likely(places, coarse[0], window)
        if likely[0][1] <= LEAST_SCORE:
            return likely[0]
        near = _near([direction for direction, score in likely if score > LEAST_SCORE], DISC)
    agreement = _Agreement(places, window)
    best = near[np.argsort(-agreement.of(near, coarse, COARSE))[:TOPS]]
    for step in STEPS:
        tried = np.concatenate([_ring(direction, step) for direction in best])
        best = tried[[np.argmax(agreement.of(tried, fine, FINE))]]
    return best[0], float(strengths(places, fine[0], window, best, FINE)[0])


def _likely(places, solids, window):
    """Return directions apart from one another, from the whole sky, and strengths: best first."""
    tried = hemisphere(DIRECTIONS)
    tried = tried[tried[:, 2] > LEAST_HEIGHT]
    strength = strengths(places, solids, window, tried, COARSE)
    best = []
    for k in np.argsort(-strength):
        if all(tried[k] @ other < np.cos(0.2) for other in best):
            best.append(tried[k])
        if len(best) == CANDIDATES:
            break
    best = [_refined(places, solids, window, one) for one in best]
    return sorted(best, key=lambda found: -found[1])


def _ring(direction, step, turned=0.0):
    """Return a direction and six about it, (7, 3), `turned` by a share of their angles."""
    right, up, _ = axes_of(direction)[0].astype(np.float64)
    turn = (np.arange(6) + turned) * np.pi / 3
    ring = direction + step * (np.cos(turn)[:, None] * right + np.sin(turn)[:, None] * up)
    ring = np.concatenate([direction[None], ring])
    return ring / np.linalg.norm(ring, axis=1, keepdims=True)


class _Agreement:
    """How well the sharpest shadows agree with directions of the sun."""

    def __init__(self, places, window):
        self._places, self._window = places, window
        middle = places.position[places.pair].mean(axis=1)
        side = np.argmax(np.abs(places.normal[places.pair[:, 0]]), axis=1)
        key = np.column_stack([np.floor(middle / BLOCK).astype(np.int64), side])
        self._block = np.unique(key, axis=0, return_inverse=True)[1].ravel()
        self._energy = np.bincount(self._block, places.change**2)

    def of(self, directions, sets, side):
        """Return how well each of the directions (m, 3) agrees, by some sets of solids.

        The sum over the blocks, times the strength over all pairs together.
        """
        total, strength = np.zeros(len(directions)), np.zeros(len(directions))
        for start in range(0, len(directions), BATCH):
            part = slice(start, start + BATCH)
            for solids in sets:
                changes = _changes(self._places, solids, self._window, directions[part], side)
                for k, change in enumerate(changes.T, start):
                    product = np.bincount(self._block, self._places.change * change)
                    square = np.bincount(self._block, change * change)
                    strength[k] += product.sum() / np.sqrt(max(square.sum(), 25.0))
                    square += FAINT
                    cosine = product / np.sqrt(np.maximum(self._energy * square, 1e-9))
                    total[k] += self._energy @ np.maximum(cosine, 0) ** AGREEMENT
        return total * np.maximum(strength, 0)


def _changes(places, solids, window, directions, side):
    """Return the change of visibility over each pair, (p, m), from some directions."""
    seen = seen_from(places, solids, window, directions, side)
    seen[places.normal @ directions.T.astype(np.float32) < 0.05] = 0
    change = np.empty((len(places.pair), len(directions)), np.float32)

    def work(part):
        first, second = places.pair[part].T
        np.subtract(seen[first], seen[second], out=change[part])

    in_blocks(work, len(change))
    return change


def _near(directions, disc):
    """Return unit vectors (m, 3) SPACED apart and at most `disc` [rad] from any of directions."""
    rows = int(np.ceil(disc / SPACED * math.sqrt(4 / 3)))
    i, j = np.mgrid[-2 * rows : 2 * rows + 1, -rows : rows + 1].reshape(2, -1)
    x, y = SPACED * (i + 0.5 * j), SPACED * math.sqrt(0.75) * j
    inside = np.hypot(x, y) <= disc
    found = np.zeros((0, 3))
    for direction in directions:
        right, up, _ = axes_of(direction)[0].astype(np.float64)
        about = direction + x[inside, None] * right + y[inside, None] * up
        about /= np.linalg.norm(about, axis=1, keepdims=True)
        new = about[:, 2] > LEAST_HEIGHT / 2
        if len(found):
            new &= (about @ found.T).max(axis=1) < math.cos(0.75 * SPACED)
        found = np.concatenate([found, about[new]])
    return found


def _refined(places, solids, window, direction):
    """Return the best of directions about one, and its strength."""
    strength = 0.0
    for turned in (0.0, 0.5):  # once more from there: the ring may end before the peak
        tried = _ring(direction, FIRST_STEP, turned)
        tried = tried[tried[:, 2] > LEAST_HEIGHT / 2]
        found = strengths(places, solids, window, tried, COARSE)
        k = int(np.argmax(found))
        direction, strength = tried[k], found[k]
        if k == 0:
            break
    return direction, strength


def strengths(places, solids, window, directions, side):
    """Return how well brightness follows the visibility from each direction.

    A matched filter: the sum of brightness changes times changes of visibility, over the root of
    the sum of squares of the latter, in units of the root mean square of the former and of the root
    of the number of pairs: 1 is a change wherever visibility changes and none elsewhere.
    """
    rms = float(np.sqrt(np.mean(places.change**2))) if len(places.change) else 0.0
    found = np.zeros(len(directions))
    if rms == 0:
        return found
    norm = rms * np.sqrt(len(places.change))
    for start in range(0, len(directions), AT_ONCE):
        part = slice(start, start + AT_ONCE)
        change = _changes(places, solids, window, directions[part], side)
        square = np.einsum("ij,ij->j", change, change)
        product = places.change @ change
        found[part] = product / np.sqrt(np.maximum(square, 25.0)) / norm
    return found


def seen_from(places, solids, window, directions, side):
    """Return the share of each place that is seen from each direction, (n, m) float32."""
    window = resized(window, side)
    axes = axes_of(directions)
    heights = np.empty((len(axes), side, side), np.float32)
    draw_heights(solids, axes, window, heights)
    seen = np.empty((len(places.position), len(axes)), np.float32)
    flat = np.ones(len(places.position), np.float32)
    find_seen(heights, axes, window, places.position, places.normal, flat, np.float32(MARGIN), seen)
    return seen
