"""Shade on the ground, found in the picture of the ground, whatever threw it.

In the shade the sky alone lights the ground: it is darker, and bluer, by one ratio of sun and sky
to sky for each channel, whatever the paint. Edges between paints have all ratios, those of shadows
one. So shade is believed if one such ratio recurs along edges on different paints, and a region if
it is found along most of its border. What paint may have done stays as it is.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from rainsim.jit import get_num_threads
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS
from rainsim.surface.ground_picture import place_on

EDGE = 3  # cells from the middle of an edge to the places on both sides
SMOOTH = 1.2  # cells: deviation of the weights of a place's colour
LEAST_STEP = 0.3  # of the logarithm of luminance at an edge
EVEN = 0.35  # of the step, by which luminance may go on changing beyond the edge
# Steps that sun and blue sky make: logarithms of luminance and of red over blue, and green off the
# middle of both, over the latter, of which LEAST_BLUER counts at least.
STEP, BLUER, GREEN, LEAST_BLUER = (0.35, 2.5), (0.12, 1.4), 0.25, 0.3
ALIKE = 0.2  # logarithm by which steps of one ratio differ, to find it
# Steps of that ratio: shares of it, since half shade steps less, and logarithm off its direction.
SHARES, OFF = (0.5, 1.8), 0.35
# Values that raise the confidence from 0 to 1: edges of one ratio; edges that sun and sky may have
# made, of these and of those that are as much redder in the dark; red over blue of the sun over the
# sky; logarithm by which the tints of the paints beside the edges differ. Of 217 views of dull
# captures none is sure (their second value is .4, .78 at most but for one), of 18 sunny ones all.
EDGES, BLUE = (60, 150), (0.78, 0.9)
RED_OVER_BLUE, PAINTS = (1.5, 1.8), (0.2, 0.35)
LEAK = 0.06  # of a shadow's step, from cell to cell, that hardly lets a state pass
LEAST_PASS, UNSEEDED = 1e-4, 1e-5  # of a link; weight of being lit where nothing is known
# Shares of a border that are the edge of a shadow, from which on it is shade, a little and wholly;
# and cells of that edge.
BORDER, FEWEST = (0.3, 0.5), 12
NEAR_EDGES, PRIOR = 12.0, 3.0  # cells over which the ratio is averaged; edges that the mean counts
BAND = 3  # cells about the edge of a shadow in which the share is that of the brightness
FLECK, PAINT = 5.0, 0.25  # cells about one in the shade, and share that paint may make of a fleck
LARGEST = 12.0  # cells, that a splat of the ground deviates at most
WHOLLY = 4.0  # one over the hidden share from which on a splat is all of the shaded ground
BRIGHTER = 0.25  # logarithm, by which paint may be brighter than the sunlit ground about it
VARIES = 0.15  # logarithm, by which a splat may differ from the picture of the ground
PAINT_OFF = 0.4  # logarithm off the step's direction, that paint may make of a splat
# Of what may be off the ground's level: splats as far above it and below it are still its own.
HIGHEST, LOWEST = 3.0, 4.0
SHARE_OF_WIDTH = 1.0, 1e-3  # of a mean, see `_smoothed`
# Paints are the same within these logarithms of the ratio of two channels and of luminance, and if
# they lie within so many cells.
SAME_TINT, SAME_LIGHT, PAINT_REACH = 0.2, 3.0, 150.0
ALIKE_PLACES, LACKS = 8, (-0.1, 0.5)  # of one paint; logarithms, see `_known_paint`
SURE = 0.5  # confidence from which on shade is believed
MARGIN = 3 * EDGE + 2  # cells around the picture, so that no neighbour is beyond it


class GroundShade(NamedTuple):
    """The shade of a ground picture; maps are (rows, columns)."""

    share: np.ndarray  # of the sun that something hides
    lit: np.ndarray  # (rows, columns, 3), logarithm of light without shade, around a cell
    band: np.ndarray  # bool, about the edges of shadows
    step: np.ndarray  # (rows, columns, 3), logarithm of lit over shaded light
    log: np.ndarray  # (rows, columns, 3) as in `GroundPicture`, as the next
    seen: np.ndarray  # bool; this and the next as in `GroundPicture`
    low: np.ndarray
    ratio: np.ndarray  # (3,) of the sun on level ground over the sky
    cell: float
    reach: float
    confidence: float  # 0 to 1
    area: float  # share of the ground in sight that is in the shade


def ground_shade(picture):
    """Return the `GroundShade` of a `GroundPicture`; None where it is not SURE, or without any."""
    margin = [(MARGIN, MARGIN)] * 2
    log, seen = np.pad(picture.log, [*margin, (0, 0)]), np.pad(picture.seen, margin)
    smooth = _smoothed(log, seen, SMOOTH)
    bright, dark = _edges(smooth, seen)
    step = smooth[bright] - smooth[dark]
    ratio, confidence = _ratio_of(step, smooth[bright])
    if confidence < SURE:
        return None
    used = _of_ratio(step, ratio)
    bright, dark = (tuple(axis[used] for axis in side) for side in (bright, dark))
    shade = _spread(smooth, seen, ratio, bright, dark) > 0.5
    shade = ndimage.median_filter(shade, 5) & seen
    trust, border = _confirmed(smooth, seen, shade, ratio)
    if not trust.any():
        return None
    step = _local_steps(border, seen.shape, ratio)
    known, lacks = _known_paint(smooth, seen & ~shade, trust > 0, step)
    trust, step = trust * known, step + lacks
    if not trust.any():
        return None
    share, lit, band = _shares(log, seen, trust > 0, step)
    inner = (slice(MARGIN, -MARGIN),) * 2
    share *= np.where(trust > 0, trust, ndimage.grey_dilation(trust, size=2 * BAND + 1))
    share, lit, step = (v[inner].astype(np.float32) for v in (share, lit, step))
    area = float(trust.sum() / np.count_nonzero(seen))
    return GroundShade(
        share, lit, band[inner], step, picture.log, picture.seen, picture.low, np.expm1(ratio),
        picture.cell, picture.reach, confidence, area,
    )  # fmt: skip


def hidden_at(shade, position, log):
    """Return how much of the sun is hidden from places, and how far they are of the ground.

    `position` (n, 3) [m] and `log`, the logarithm of their light, are those of the places. At the
    edge of a shadow their own light tells how much of it is shaded, if sun and shade may make it.
    What stands on the ground, higher than what its picture shows as ground, is none of it. Then how
    much their own light counts, and logarithms (n, 3) of lit over shaded light and of lit ground.
    """
    place = place_on(shade, position).T

    def at(values):
        return ndimage.map_coordinates(values, place, np.float32, order=1, mode="nearest")

    maps = shade.step, shade.lit
    step, lit = (np.stack([at(c) for c in np.moveaxis(v, 2, 0)], -1) for v in maps)
    height = position[:, 2] / shade.reach
    ground = (
        np.clip(HIGHEST - height, 0, 1) * (height > -LOWEST) * at(shade.seen.astype(np.float32))
    )
    share = at(shade.share)
    own, off = _hidden(log, lit, step)
    by_own = at(shade.band.astype(np.float32)) * (off < PAINT_OFF)
    return share + by_own * (np.clip(own, 0, 1) - share), ground, by_own, step, lit


def lifted(shade, position, log, size):
    """Return the linear light of splats out of the shade on the ground, and how far they lie in it.

    (n, 4): three channels, and 0 to 1. `size` (n,) [m] are the splats' largest deviations: haze of
    many cells keeps its light. At the edges of shadows `hidden_at` says the light. Within them the
    picture of the ground, lifted, does: single splats make shade as dark ones that hide bright
    ones, of any tint. By what a splat is brighter or darker than the picture it stays so, but for
    more than VARIES.
    """
    share, ground, by_own, step, lit = hidden_at(shade, position, log)
    edge = log + _gain(share, step)
    place = place_on(shade, position).T
    maps = [*np.moveaxis(shade.log, 2, 0), *np.moveaxis(_gain(shade.share, shade.step), 2, 0)]
    maps = np.stack([ndimage.map_coordinates(v, place, order=1, mode="nearest") for v in maps], -1)
    own = np.clip((log - maps[:, :3]) @ LUMINANCE_WEIGHTS, -VARIES, VARIES)
    inside = maps[:, :3] + maps[:, 3:] + own[:, None]
    light = edge + (1 - by_own)[:, None] * (inside - edge)
    light = np.minimum(light, np.maximum(lit + BRIGHTER, log))  # flecks of sun are no darker paint
    within = ground * np.clip(WHOLLY * share, 0, 1) * (size < LARGEST * shade.cell)
    return np.column_stack([np.exp(light), within])


def _gain(share, step):
    """Return the logarithms of lit over captured light of a hidden share (...) and steps."""
    return step - np.log1p((1 - share)[..., None] * np.expm1(step))


def _hidden(log, lit, step):
    """Return the hidden share of the sun that makes `log` of `lit`, and how far off it that is.

    All are logarithms (..., 3) of light, `step` is that of lit over shaded light; the shares are
    not bounded. The second is a logarithm: what sun and shade cannot do is paint.
    """
    sun = np.maximum(np.expm1(step), 1e-3)
    bright = np.exp((log - lit) @ LUMINANCE_WEIGHTS)
    over_sky = np.maximum(np.expm1(step @ LUMINANCE_WEIGHTS), 1e-3)
    shown = (bright * (1 + over_sky) - 1) / over_sky
    by_sun = np.log1p(np.clip(shown, 0, 1)[..., None] * sun) - step
    off = log - lit - by_sun
    off -= (off @ LUMINANCE_WEIGHTS)[..., None]
    return 1 - shown, np.linalg.norm(off, axis=-1)


def _smoothed(values, known, *widths):
    """Return the mean of values (rows, columns, 3) about each cell, of known cells alone.

    Of the widths of the weights later ones count where none is known within the first.
    """
    sums = np.where(known[..., None], values, 0), known[..., None]
    total = 0
    for share, width in zip(SHARE_OF_WIDTH, widths, strict=False):
        total += share * np.concatenate(
            [ndimage.gaussian_filter(v.astype(np.float32), (width, width, 0)) for v in sums], -1
        )
    return total[..., :3] / np.maximum(total[..., 3:], 1e-9)


def _edges(smooth, seen):
    """Return the places of the brighter and of the darker side of edges, as rows and columns."""
    light, sides = smooth @ LUMINANCE_WEIGHTS, ([], [])
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        k = EDGE if down * right == 0 else round(EDGE / 2**0.5)

        def at(values, cells, turn=(-down, -right)):
            return np.roll(values, (cells * turn[0], cells * turn[1]), (0, 1))

        change = at(light, k) - at(light, -k)
        size = np.abs(change)
        edge = seen & (size > LEAST_STEP)
        edge &= size >= np.max([at(size, n) for n in range(-k, k + 1)], axis=0)
        for side in (k, -k):
            edge &= at(seen, side) & at(seen, 2 * side)
            edge &= np.abs(at(light, 2 * side) - at(light, side)) < EVEN * size
        row, column = np.nonzero(edge)
        away = np.where(change[edge] > 0, k, -k)
        for side, one in zip(sides, (away, -away), strict=True):
            side.append((row + one * down, column + one * right))
    return [tuple(np.concatenate(axis) for axis in zip(*side, strict=True)) for side in sides]


def _by_sun(step):
    """Return which steps (n, 3) sun and blue sky may have made."""
    light, bluer = step @ LUMINANCE_WEIGHTS, step[:, 0] - step[:, 2]
    green = np.abs(step[:, 1] - (step[:, 0] + step[:, 2]) / 2)
    found = (light > STEP[0]) & (light < STEP[1]) & (bluer > BLUER[0]) & (bluer < BLUER[1])
    return found & (green < GREEN * np.maximum(bluer, LEAST_BLUER))


def _ratio_of(step, lit):
    """Return the logarithm of the ratio (3,) that recurs among steps, and how sure shade is.

    `lit` is the logarithm of colour on the bright sides, (n, 3).
    """
    likely = _by_sun(step)
    if np.count_nonzero(likely) < EDGES[0]:
        return np.zeros(3), 0.0
    step, lit, other = step[likely], lit[likely], np.count_nonzero(_by_sun(step[:, ::-1]))
    some = step[:: max(1, len(step) // 300)]
    size = (step @ LUMINANCE_WEIGHTS) ** 2  # half shade has smaller steps: large ones count more
    most = np.argmax([size[np.abs(step - one).max(axis=1) < ALIKE].sum() for one in some])
    ratio = some[most]
    for _ in range(8):
        alike = np.abs(step - ratio).max(axis=1) < ALIKE
        ratio = np.median(step[alike], axis=0)
    tint = lit[alike, :2] - lit[alike, 1:]
    paints = np.ptp(np.percentile(tint, [10, 90], axis=0), axis=0).max()
    sun = np.expm1(ratio)
    values = (
        (np.count_nonzero(alike), EDGES),
        (len(step) / (len(step) + other), BLUE), (sun[0] / max(sun[2], 1e-6), RED_OVER_BLUE),
        (paints, PAINTS),
    )  # fmt: skip
    return ratio, float(np.prod([np.clip((v - a) / (b - a), 0, 1) for v, (a, b) in values]))


def _of_ratio(step, ratio):
    """Return which steps (n, 3) are in the direction of a ratio (3,), and about as large."""
    along = step @ ratio / (ratio @ ratio)
    off = np.linalg.norm(step - along[:, None] * ratio, axis=1)
    return (along > SHARES[0]) & (along < SHARES[1]) & (off < OFF)


def _spread(smooth, seen, ratio, lit, shaded):
    """Return how likely each cell is in the shade, 0 to 1, from the sides of edges.

    A random walker, Grady 2006: the state passes from cell to cell but where the colour changes as
    it does at the edge of a shadow, so that it passes from paint to paint.
    """
    count = np.count_nonzero(seen)
    number = np.full(seen.shape, -1)
    number[seen] = np.arange(count)
    size, links = float(ratio @ ratio), []
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        both = seen[a] & seen[b]
        step = (smooth[a] - smooth[b])[both]
        along = step @ ratio / size
        off = np.linalg.norm(step - along[:, None] * ratio, axis=1) / size**0.5
        passed = np.exp(-((np.maximum(np.abs(along) - off, 0) / LEAK) ** 2)) + LEAST_PASS
        links.append((number[a][both], number[b][both], passed))
    first, second, passed = (np.concatenate(part) for part in zip(*links, strict=True))
    dark = np.bincount(number[shaded], minlength=count).astype(float)
    total = dark + np.bincount(number[lit], minlength=count) + UNSEEDED
    total += np.bincount(first, passed, count) + np.bincount(second, passed, count)
    own = np.arange(count)
    place = np.concatenate([own, first, second]), np.concatenate([own, second, first])
    matrix = sparse.csc_array((np.concatenate([total, -passed, -passed]), place))
    symmetric = {"SymmetricMode": True}
    solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
    found = np.zeros(seen.shape)
    found[seen] = solver.solve(dark)
    return found


def _confirmed(smooth, seen, shade, ratio):
    """Return how sure each cell of shade is, 0 to 1, by the ratio along borders, and these.

    A border is places of cells at it in the shade (n, 2), and the steps across it (n, 3).
    """
    slope = np.stack(np.gradient(ndimage.gaussian_filter(shade.astype(np.float32), 1.5)), -1)
    edge = shade & ~ndimage.binary_erosion(shade, np.ones((3, 3)))
    place = np.argwhere(edge)
    out = -slope[edge] / np.maximum(np.linalg.norm(slope[edge], axis=1), 1e-6)[:, None]
    step = np.zeros((len(place), 3))
    known, good = np.zeros((2, len(place)), bool)
    for away in (EDGE, 2 * EDGE, 3 * EDGE):  # a blurred edge is wide: the larger step counts
        lit = tuple(np.rint(place + away * out).astype(int).T)
        dark = tuple(np.rint(place - away * out).astype(int).T)
        fits = seen[lit] & seen[dark] & ~shade[lit]
        known |= fits
        found = smooth[lit] - smooth[dark]
        fits &= shade[dark] & _of_ratio(found, ratio) & (found @ ratio > step @ ratio)
        step[fits] = found[fits]
        good |= fits
    label, count = ndimage.label(shade)
    region = label[edge]
    of_shadow = np.bincount(region[good], minlength=count + 1)
    whole = np.bincount(region[known], minlength=count + 1)
    trust = (shade & ((of_shadow > BORDER[1] * whole) & (of_shadow >= FEWEST))[label]).astype(float)
    # Of a region that has other borders, too, that part counts that lies along those of shadows.
    of_shadow, whole = _around(place, np.stack([good, known]), shade.shape)
    near = (of_shadow / np.maximum(whole, 1e-6) - BORDER[0]) / (BORDER[1] - BORDER[0])
    trust = np.maximum(trust, shade * np.clip(near, 0, 1) * (of_shadow >= FEWEST))
    good &= trust[tuple(place.T)] > 0
    return trust, (place[good], step[good])


def _known_paint(smooth, lit, shade, step):
    """Return how far shade, lifted, has colours that lie in the sun near by, and what it lacks.

    The first is 0 to 1: shaded leaves are no bluer than sunlit ones as the ground is, and would
    become brown. The second, logarithms (rows, columns, 3), is how far sunlit places of such
    colours are from it: far from the edge of a shadow less of the sky may be seen.
    """
    color = np.where(shade[..., None], smooth + step, smooth)
    tint = (color[..., :2] - color[..., 1:]) / SAME_TINT
    paint = [tint, (color @ LUMINANCE_WEIGHTS)[..., None] / SAME_LIGHT]
    place = np.moveaxis(np.indices(shade.shape), 0, -1) / PAINT_REACH
    features = np.concatenate([*paint, place], -1).astype(np.float32)
    known, lacks = np.zeros(shade.shape, bool), np.zeros_like(color)
    some = np.argwhere(lit)[::3]
    if len(some) > ALIKE_PLACES:
        tree = cKDTree(features[tuple(some.T)], compact_nodes=False, balanced_tree=False)
        away, near = tree.query(
            features[shade], ALIKE_PLACES, eps=0.5, distance_upper_bound=1.0,
            workers=get_num_threads(),
        )  # fmt: skip
        known[shade] = np.isfinite(away).all(axis=1)
        of_them = color[tuple(some.T)][np.where(np.isfinite(away), near, 0)].mean(axis=1)
        lacks[shade] = of_them - color[shade]
        known &= lacks @ LUMINANCE_WEIGHTS > -BRIGHTER
    wide = [ndimage.uniform_filter(v.astype(float), 2 * BAND + 1) for v in (known, shade)]
    share = np.clip(3 * wide[0] / np.maximum(wide[1], 1e-6) - 1, 0, 1) * shade
    return share, np.clip(_smoothed(lacks, known, NEAR_EDGES), *LACKS)


def _around(place, values, shape):
    """Return the sums (k, rows, columns) of values (k, n) at places (n, 2) about each cell."""
    flat = np.ravel_multi_index(place.T, shape)
    sums = [np.bincount(flat, v, shape[0] * shape[1]).reshape(shape) for v in values]
    wide = 2 * np.pi * NEAR_EDGES**2
    return np.array([wide * ndimage.gaussian_filter(v, NEAR_EDGES) for v in sums])


def _local_steps(border, shape, ratio):
    """Return the steps (rows, columns, 3) from shade to light, the mean along borders near by.

    They vary along an edge, with how much of the sky is seen.
    """
    place, step = border
    own = (step @ ratio / (ratio @ ratio)) ** 2  # larger steps are less of half shade
    sums = _around(place, np.column_stack([own[:, None] * (step - ratio), own]).T, shape)
    return ratio + np.moveaxis(sums[:3] / (sums[3] + PRIOR), 0, -1)


def _shares(log, seen, shade, step):
    """Return the first three maps of `GroundShade`."""
    # Within the band about an edge the share is what the brightness says, between lit and shaded.
    inside = ndimage.binary_erosion(shade | ~seen, iterations=BAND)
    outside = ndimage.binary_erosion(~shade | ~seen, iterations=BAND)
    sure = seen & (inside | outside)
    lit = _smoothed(log + shade[..., None] * step, sure, 1.5 * BAND, 6 * BAND)
    hidden, _ = _hidden(log, lit, step)
    # Flecks of sun within the shade: what is far brighter than the shade around.
    fleck = np.zeros(log.shape[:2])
    for _ in range(2):
        shaded = _smoothed(log, seen & shade & (fleck < 0.5), FLECK)
        own, off = _hidden(log, shaded + step, step)
        fleck = np.clip((1 - own - off - PAINT) / (1 - PAINT), 0, 1)
    share = np.where(sure, shade, np.clip(hidden, 0, 1)) * (1 - fleck) * seen
    return share, lit, seen & ~sure
