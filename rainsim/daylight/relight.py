"""A sunny capture under an overcast sky: what of each splat's light was sun, and a gain instead.

With the clear sky's irradiance on open level ground as the unit, a splat received

    E = A + S V cos(n, sun) + B

in the captured day: A from the part of the sky that it sees, S from the sun where nothing hides it
(V), B from its surroundings. Under an overcast sky it receives the part of this sky that it sees,
and what the surroundings send in that light. The ratio of the two is the gain on its linear light;
open level ground keeps its mean. S is measured for each channel, where the edges of shadows cross
surfaces of one colour.
"""

import math
import warnings
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rainsim.constants import SH_0
from rainsim.daylight.light import (
    about_normal,
    around_of,
    facing,
    light_of,
    received,
    sky_sums,
    sunlit,
    turn_to_the_open,
)
from rainsim.daylight.lit_surface import carried, luminance, surface_of
from rainsim.daylight.shade import NO_EDGES, EdgeShade, edge_shade, factor_in_shade
from rainsim.daylight.sun import DIM, LEAST_SCORE, find_sun, of_one_paint, places_of, seen_from
from rainsim.daylight.surroundings import USUAL_ALBEDO, patches_of, sent_in
from rainsim.daylight.visibility import Window, solids_of, with_plane, with_splats
from rainsim.numerics.blocks import in_blocks
from rainsim.numerics.places import cells_and_sides, group_means, nearest
from rainsim.numerics.srgb import linear
from rainsim.surface.ground_shade import hidden_at, lifted
from rainsim.surface.views import FEWEST_CAMERAS
from rainsim.surface.wall_parts import laid_on_walls

SIDE = 1024  # px of the maps of the sky's light
FAR_HALF = 60.0  # m, of the far window
FEWEST = 100  # places
LEAST_PAIRS = 150  # of places
EDGE_REACH, EDGE_PARTNERS = 0.5, 4  # m, and lit places that a shaded one is compared with
SURE_REACH = 0.06  # m about a place that is surely in the sun or surely not
OPEN = 0.1  # light of the clear sky below which a place tells nothing
ROUNDS = 6  # of the fit of the ratio
LEAST_GAIN, MOST_GAIN = 0.05, 2.0  # over what shaded open ground needs
SURE = 0.5  # confidence from which on the sun is divided out
# Values that raise the confidence from 0 to 1: sun over sky on level ground, share of the changes
# of brightness that are towards where the sun shines, and the score of the search.
OVER_SKY, AGREE, SCORE = (0.15, 0.6), (0.55, 0.75), (0.06, 0.1)
# Red over blue of the sun over the sky, likewise: the shade of a clear day is blue, whereas dark
# paint and the corners of a dull day are darker in all channels.
RED_OVER_BLUE = 1.1, 1.25
PAINT_REACH, PAINT_COUNT, LEAST_PAINT = 3.0, 16, 4  # m; splats that a splat's paint is taken from
SAME_TINT = 0.35  # logarithm of the ratio of two channels, by which splats of one paint differ
# m: cells about a place whose paint is compared with its own; how many, and how far away.
AROUND_CELL, AROUND_COUNT, AROUND_REACH = 0.2, 150, 2.0
REAL = 0.5  # share of the logarithm of a change at an edge, from which a pair is at an edge
WRONG, LEAST_SUN = 0.5, 0.5  # share of what the sun adds, in logarithms, from which maps are wrong
NEAREST = 3  # places, itself included, whose median share smooths what paint does
MOST_VARIED = 0.4  # of a share, that variation may explain
PAINT_VARIES = 0.15  # of the light of one paint, from splat to splat
FOUND_UNSURE, GIVEN_UNSURE = math.radians(1), math.radians(3)  # of a sun's direction
USUAL_RATIO = 6.0, 3.8, 2.0  # of a clear day, see `SunRatio`, where a given sun cannot be measured
LEAST_SINE = 0.1  # of a given sun's elevation, by which level ground's ratio is that of the sun
STAYS = "the light stays as captured"


class SunRatio(NamedTuple):
    """Irradiance of the sun on what faces it over the clear sky's on open level ground."""

    ratio: np.ndarray = np.zeros(3)
    pairs: int = 0
    agree: float = 0.0  # share of all changes of brightness that are towards where the sun shines
    edges: EdgeShade = NO_EDGES


@dataclass(frozen=True)
class Relight:
    """The gain that takes each splat's light from the captured day to an overcast one."""

    gain: np.ndarray | None  # (n, 3), float16, on linear light; None: nothing is changed
    note: str
    sun: np.ndarray | None = None  # (3,), unit, ground frame, to the sun that was found or given
    ratio: tuple | None = None  # see `SunRatio`
    confidence: float = 0.0
    # (n, 4), float16, where the ground alone is lifted out of the shade: each splat's linear light
    # under an overcast sky, and how far it is of the shaded ground, see `kept_light.under_clouds`.
    ground: np.ndarray | None = None


def find_relight(scene, found, sun=None, white=USUAL_ALBEDO, shone=True):
    """Return the `Relight` of a capture.

    `found` is what its cameras show, None if there are too few splats. `sun`, azimuth and elevation
    [rad], is taken as it is, unless the shadows surely show where within 5 degrees of it the sun
    stood; without it the sun is found. `white` is the albedo that a captured linear colour of 1
    stands for, on open level ground. `shone` tells whether it is known that the given sun shone: a
    clock says where it stood, and shadows must show that it shone. Where what was captured explains
    no shadows, they are looked for in the picture of the ground.
    """
    if found is None:
        return Relight(None, f"relight: too few splats to find a sun; {STAYS}")
    if sun is not None and sun[1] <= 0:
        return Relight(None, f"relight: the given sun is below the horizon; {STAYS}")
    relight = _by_casters(scene, found, sun, white, shone)
    if relight.gain is not None or found.shade is None:
        return relight
    return _by_ground(scene, found.shade)


def _by_ground(scene, shade):
    """Return the `Relight` that lifts the shade found in a picture of the ground."""
    position, good = _placed(scene)
    light = linear(scene.splats.sh[good, 0] * np.float32(SH_0) + np.float32(0.5))
    ground = np.zeros((len(good), 4), np.float16)
    size = scene.splats.scale[good].max(axis=1) * scene.ground_frame.meters_per_unit
    ground[good] = lifted(shade, position[good], np.log(np.maximum(light, DIM)), size)
    note = (
        f"relight: shade on {shade.area:.0%} of the ground in sight, where the sun gave "
        f"{luminance(shade.ratio[None])[0]:.1f} times the sky's light, goes as clouds cover the "
        "sky; what threw it was not captured, so that light and shade of all else stay"
    )
    facts = tuple(map(float, shade.ratio)), shade.confidence
    return Relight(None, note, None, *facts, ground)


def _by_casters(scene, found, sun, white, shone):
    """Return the `Relight` by shadows that what was captured throws; see `find_relight`."""
    if len(found.surface.position) < FEWEST:
        return Relight(None, f"relight: too little that its cameras agree on; {STAYS}")
    near = Window(found.middle, SIDE, np.float32(2 * found.half / SIDE))
    surface, plane, solids = _seen(found.surface, found.solid, near)
    places = places_of(surface, near)
    if sun is None and len(places.pair) < LEAST_PAIRS:
        return Relight(None, f"relight: too few flat surfaces to find a sun; {STAYS}")
    given = None if sun is None else _unit(*sun)
    direction, score, shade = given, 0.0, None
    if len(places.pair) >= LEAST_PAIRS:
        direction, score = find_sun(places, solids, plane, near, given)
    if given is None and score <= LEAST_SCORE:
        shown = _unsure(0.0, len(scene.cameras), sun)
        return Relight(None, f"relight: {shown}; {STAYS}", direction, (0.0, 0.0, 0.0))
    patches = patches_of(surface, near)
    sent = sent_in(surface, patches, white)
    measured, confidence = _measured(places, solids, plane, near, direction, score, sent)
    if given is None or not shone:
        confidence *= _raised(measured.ratio[0] / max(measured.ratio[2], 1e-6), RED_OVER_BLUE)
    elif confidence < SURE:  # shadows name no better one
        direction = given
        measured, confidence = _measured(places, solids, plane, near, direction, 1.0, sent)
        if confidence < SURE:
            ratio = np.array(USUAL_RATIO)
            if (shade := found.shade) is not None:  # its ratio is that on level ground
                ratio = shade.ratio / max(direction[2], LEAST_SINE)
            measured = SunRatio(ratio, measured.pairs, measured.agree)
    facts = direction, tuple(map(float, measured.ratio)), confidence
    if confidence < SURE and (sun is None or not shone):
        shown = _unsure(confidence, len(scene.cameras), sun)
        return Relight(None, f"relight: {shown}; {STAYS}", *facts)
    # Of the sun only those places tell whose plane the cameras agree on; light falls on the others
    # as on the walls that they belong to.
    if (laid := laid_on_walls(found.surface)) is not found.surface:
        surface, plane, solids = _seen(laid, found.solid, near)
        patches = patches_of(surface, near)
        sent = sent_in(surface, patches, white)
    windows = near, Window(near.middle, SIDE, np.float32(2 * FAR_HALF / SIDE))
    light = received(surface, solids, windows, direction, sent)
    unsure = GIVEN_UNSURE if direction is given else FOUND_UNSURE
    lit = sunlit(surface, solids, windows, direction, unsure)
    by_plane, _ = sunlit(surface, plane, windows, direction)
    lit = by_color(surface, lit, by_plane, light, direction, measured.ratio)
    if shade is not None:
        log = np.log(np.maximum(surface.light, DIM))
        hidden, ground = hidden_at(shade, surface.position, log)[:2]
        lit += ground * (1 - hidden - lit)
    gain = gains(surface, light, lit, direction, measured, light.around)
    later = sent_in(surface, patches, white, gain)
    later = later.at(surface.position, surface.normal, surface.flat)
    gain = gains(surface, light, lit, direction, measured, around_of(light.blocked, later))
    note = _note(direction, measured, confidence, given)
    return Relight(_on_splats(scene, surface, gain), note, *facts)


def _seen(surface, solid, window):
    """Return a `Surface` turned to the open, what of it lies in planes, and all that stops light.

    `surface` is a `CaptureSurface`, `solid` that of `Found`.
    """
    surface = surface_of(surface)
    plane = with_plane(solids_of(surface), surface)
    solids = with_splats(plane, solid)
    turn_to_the_open(surface, solids, window)
    return surface, plane, solids


def _on_splats(scene, surface, gain):
    """Return the gain (n, 3), float16, of a scene's splats of that of its surface."""
    position, good = _placed(scene)
    light = linear(scene.splats.sh[good, 0] * np.float32(SH_0) + np.float32(0.5))
    size = math.sqrt(np.median(surface.area))
    found, near = carried(surface, size, gain.astype(np.float32), position[good], light)
    result = np.ones((len(good), 3), np.float16)
    result[np.flatnonzero(good)[near]] = found[near]
    return result


def _placed(scene):
    """Return the places of a scene's splats (n, 3), float32 [m], and which splats are good (n,)."""
    with np.errstate(all="ignore"):
        position = scene.ground_frame.to_ground(scene.splats.position).astype(np.float32)
        good = scene.splats.opacity > 0
        for values in (position, scene.splats.sh[:, 0]):
            good &= np.isfinite(values).all(axis=1)
    return position, good


def _unit(azimuth, elevation):
    flat = math.cos(elevation)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])


def measure(places, solids, plane, window, direction, sent):
    """Return the `SunRatio` from pairs of places on both sides of the edges of shadows.

    `solids` are all, `plane` those `with_plane`: between the leaves of a crown the sun reaches
    places that maps have in its shade, so these count only where there are no others. `direction`
    is the unit vector to the sun, `sent` what the surroundings send.
    """
    cosine = places.normal @ direction.astype(np.float32)
    seen = _sure_share(places, solids, window, direction)
    facing_it = cosine > 0.1
    lit, shade = facing_it & (seen > 0.98), facing_it & (seen < 0.02)
    firm = shade & (seen_from(places, plane, window, direction[None], 2 * SIDE)[:, 0] == 0)
    pairs = _across_edges(places, lit, firm)
    if len(pairs) < LEAST_PAIRS:
        pairs = _across_edges(places, lit, shade)
    lit, shaded = pairs.T
    which, back = np.unique(np.concatenate([lit, shaded]), return_inverse=True)
    position, normal = places.position[which], places.normal[which]
    flat = np.ones(len(which), np.float32)
    sums = sky_sums(position, normal, flat, solids, window, direction)
    light = light_of(sums, normal, flat, sent.at(position, normal, flat))
    a, b = np.split(back, 2)
    clear = luminance(light.clear)
    fit = (clear[a] > OPEN) & (clear[b] > OPEN) & (luminance(places.light[shaded]) > DIM)
    lit, shaded, a, b = lit[fit], shaded[fit], a[fit], b[fit]
    if len(lit) < LEAST_PAIRS:
        return SunRatio(pairs=len(lit))
    change = np.maximum(places.light[lit], 1e-4) / np.maximum(places.light[shaded], 1e-4)
    # Where maps have an edge of a shadow that is not there, brightness hardly changes: the pairs
    # that change most say about what the edges do, and then those count that do half of it.
    weight = np.abs(np.log(luminance(change)))
    ratio = np.zeros(3)
    for _ in range(ROUNDS):  # what the surroundings send depends on the ratio, but weakly
        shade = shade_of(light, direction, ratio)
        found = (change * shade[b] - shade[a]) / cosine[lit][:, None]
        ratio = np.maximum([_weighted_median(channel, weight) for channel in found.T], 0)
        wanted = np.log((shade[a] + cosine[lit][:, None] * ratio) / shade[b])
        real = np.log(luminance(change)) > REAL * luminance(wanted)
        if luminance(ratio[None])[0] > LEAST_SUN and real.sum() > LEAST_PAIRS / 3:
            ratio = np.maximum(np.median(found[real], axis=0), 0)
    expected = (shade[a] + cosine[lit][:, None] * ratio) / shade[b]
    place = places.position[shaded], places.normal[shaded]
    off = np.log(change / np.maximum(expected, 1e-4))
    edges = edge_shade(*(values[real] for values in (*place, off)))
    shade = luminance(shade)
    brighter = np.log(luminance(places.light[lit]) * shade[b])
    brighter -= np.log(luminance(places.light[shaded]) * shade[a])
    agree = np.maximum(brighter, 0).sum() / max(float(np.abs(brighter).sum()), 1e-6)
    return SunRatio(ratio, len(lit), float(agree), edges)


def _across_edges(places, lit, shaded):
    """Return pairs (p, 2) of a lit and a near shaded place, of one paint; both bool (n,)."""
    lit, shaded = np.flatnonzero(lit), np.flatnonzero(shaded)
    if not len(lit) or not len(shaded):
        return np.zeros((0, 2), np.int64)
    of_lit, of_shaded = places.position[lit], places.position[shaded]
    _, near, known = nearest(of_lit, of_shaded, EDGE_PARTNERS, EDGE_REACH)
    pairs = np.stack([lit[near[known]], shaded[np.nonzero(known)[0]]], -1)
    return pairs[of_one_paint(*places[:3], *pairs.T)]


def _weighted_median(values, weight):
    """Return the value below which half of the weight lies."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return values[order[np.searchsorted(total, 0.5 * total[-1])]]


def _sure_share(places, solids, window, direction):
    """Return the sunlit share of places, the mean of each and of places SURE_REACH around it."""
    steps = np.stack([np.zeros_like(places.normal), *about_normal(places.normal)])
    moved = (places.position + np.float32(SURE_REACH) * steps).reshape(-1, 3)
    moved = places._replace(position=moved, normal=np.tile(places.normal, (len(steps), 1)))
    seen = seen_from(moved, solids, window, direction[None], 2 * SIDE)
    return seen.reshape(len(steps), -1).mean(axis=0)


def shade_of(light, direction, ratio):
    """Return what places receive in the captured day without the sun, (n, 3) float32."""
    open_ground = 1 + ratio * max(direction[2], 0.0)
    return (light.clear + light.around * open_ground).astype(np.float32)


def _measured(places, solids, plane, window, direction, score, sent):
    """Return the `SunRatio` of a direction of some score, and how sure it is."""
    measured = SunRatio()
    if score > LEAST_SCORE and len(places.pair):
        measured = measure(places, solids, plane, window, direction, sent)
    return measured, _confidence(measured, score, direction)


def _confidence(measured, score, direction):
    """Return how sure it is, 0 to 1, that the capture was taken in sunshine from there."""
    if measured.pairs < LEAST_PAIRS or direction[2] <= 0:
        return 0.0
    values = _over_sky(measured, direction), measured.agree, score
    limits = zip(values, (OVER_SKY, AGREE, SCORE), strict=True)
    return float(np.prod([_raised(value, limit) for value, limit in limits]))


def _raised(value, limits):
    """Return 0 to 1, as a value lies between limits."""
    return float(np.clip((value - limits[0]) / (limits[1] - limits[0]), 0, 1))


def _over_sky(measured, direction):
    """Return the sun's light on level ground over the sky's."""
    return float(luminance(measured.ratio[None])[0]) * max(direction[2], 0.0)


def _unsure(confidence, cameras, sun=None):
    """Return the note that no sun is sure in a capture with this number of cameras.

    `sun`, azimuth and elevation [rad], is where it stood if it shone.
    """
    shown = f"no sure sign of sunshine in the capture (confidence {confidence:.2f})"
    if 0 < cameras < FEWEST_CAMERAS:
        shown += f"; too few cameras to see what throws shadows: {cameras} of the {FEWEST_CAMERAS} "
        shown += "it takes (or give --captured-sun)"
    if sun is not None:
        shown += "; if it did shine, --captured-sun={:.0f},{:.0f}".format(*map(math.degrees, sun))
    return shown


def _note(direction, measured, confidence, given):
    """Return the note on a sun that is divided out; `given` is None or the given direction."""
    from_where = f"sun {'found' if given is None else 'given'} at {_shown(direction)}"
    if given is not None and direction is not given:
        from_where = f"the given sun, {_shown(given)}, is at {_shown(direction)} by the shadows"
    return (
        f"relight: {from_where}, {_over_sky(measured, direction):.1f} times the sky's light on "
        f"level ground (confidence {confidence:.2f}); it goes as clouds cover the sky"
    )


def _shown(direction):
    """Return azimuth and elevation of a direction as text."""
    azimuth = math.degrees(math.atan2(direction[1], direction[0]))
    elevation = math.degrees(math.asin(np.clip(direction[2], -1, 1)))
    return f"azimuth {azimuth:.0f}, elevation {elevation:.0f} degrees"


def by_color(surface, lit, plane, light, direction, ratio):
    """Return the sunlit share of each splat, by its own brightness where maps are not sure of it.

    They are not near the edges of shadows, nor below a crown, whose gaps no capture holds as they
    were. A splat's paint is that of splats around whose state is sure. Where its light lies between
    what they would have in shade and in the sun is its sunlit share. `lit` is the pair of `sunlit`,
    `plane` the first of it, if only what has a plane stopped light.
    """
    shares, about = lit[0].copy(), lit[1]
    cosine = facing(surface, direction)
    plain = (surface.flat > 0.3) & (cosine > 0.1)
    sure = (np.abs(shares - about) < 1e-4) & ((shares == 0) | (shares == 1))
    sure &= (shares == 1) | (plane == 0)
    if np.count_nonzero(plain & sure) < PAINT_COUNT:
        return shares
    shade = shade_of(light, direction, ratio)
    lamp = (cosine[:, None] * ratio).astype(np.float32)
    color = np.maximum(surface.light, 1e-4)
    paint = np.log(color / (shade + shares[:, None] * lamp))
    which = np.flatnonzero(plain & sure)
    sure[which] &= ~_contradicted(surface, which, paint[which], shares, shade, lamp)
    band, sure = np.flatnonzero(plain & ~sure), np.flatnonzero(plain & sure)
    if not len(band) or len(sure) < PAINT_COUNT:
        return shares
    paint = paint[sure]
    of_sure, of_band = surface.position[sure], surface.position[band]
    _, near, known = nearest(of_sure, of_band, PAINT_COUNT, PAINT_REACH)
    known &= np.einsum("ijk,ik->ij", surface.normal[sure][near], surface.normal[band]) > 0.85
    share, enough = np.zeros(len(band), np.float32), np.zeros(len(band), bool)

    def work(part):
        own = band[part]
        painted = np.exp(paint[near[part]])
        found = luminance(color[own])[:, None] - luminance(painted * shade[own, None])
        found /= luminance(painted * lamp[own, None])
        # Where the colour cannot come about by sun and shade on the paint, it is another paint.
        between = shade[own, None] + np.clip(found, 0, 1)[..., None] * lamp[own, None]
        left = np.log(color[own, None] / (painted * between))
        alike = known[part] & (np.abs(left[..., :2] - left[..., 1:]) < SAME_TINT).all(axis=2)
        count = alike.sum(axis=1)
        share[part] = (alike * found).sum(axis=1) / np.maximum(count, 1)
        enough[part] = count >= LEAST_PAINT

    in_blocks(work, len(band))
    # What paint may do in the shade counts as none of the sun, what it may do in the sun as all.
    low = PAINT_VARIES * luminance(shade[band]) / np.maximum(luminance(lamp[band]), 1e-6)
    high = 1 - np.minimum(PAINT_VARIES + low, MOST_VARIED)
    low = np.minimum(low, MOST_VARIED)
    shares[band[enough]] = np.clip((share - low) / (high - low), 0, 1)[enough]
    # Paint varies from splat to splat; the median keeps the edge where it is.
    median = np.median(shares[surface.neighbours[band[enough], :NEAREST]], axis=1)
    # A splat that is bright itself is not in the shade: its gain would make it a white dot.
    shares[band[enough]] = np.maximum(median, np.clip(share - low, 0, 1)[enough])
    return shares


def _contradicted(surface, which, paint, shares, shade, lamp):
    """Return which places have another state than maps say, by the paint around them, bool (n,).

    Maps put the edge of a shadow as far off as its edge was captured. A place that is called shaded
    and is sunlit would have paint that is as much brighter than what is around it as the sun is.
    `which` are the numbers of n places, `paint` the logarithm of their colour over their light;
    `shares`, `shade` and `lamp` are those of all places, see `by_color`.
    """
    position, normal = surface.position[which], surface.normal[which]
    group = cells_and_sides(position / AROUND_CELL, normal)
    middle, up, own = (group_means(group, values) for values in (position, normal, paint))
    _, near, known = nearest(middle, middle, AROUND_COUNT, AROUND_REACH)
    known &= np.einsum("ijk,ik->ij", up[near], up) > 0.85
    tint = own[:, :2] - own[:, 1:]
    known &= (np.abs(tint[near] - tint[:, None]) < 2 * SAME_TINT).all(axis=2)
    bright = np.where(known, own.mean(axis=1)[near], np.nan)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a place without any around it
        usual = np.nan_to_num(np.nanmedian(bright, axis=1), nan=np.inf)[group]
    off = paint.mean(axis=1) - usual
    sun = np.log1p(luminance(lamp[which]) / np.maximum(luminance(shade[which]), 1e-6))
    wrong = np.where(shares[which] > 0.5, -off, off) > WRONG * sun
    return wrong & np.isfinite(off) & (sun > LEAST_SUN)


def gains(surface, light, lit, direction, measured, around):
    """Return the gain (n, 3), float16, on each splat's linear light.

    `around` is the light of the surroundings under the overcast sky, float32 (n, 3).
    """
    ratio = measured.ratio
    sun = (lit * facing(surface, direction))[:, None] * ratio
    captured = shade_of(light, direction, ratio) + sun
    rainy = light.overcast[:, None] + around
    open_ground = 1 + ratio * max(direction[2], 0.0)
    gain = np.maximum(rainy * open_ground / np.maximum(captured, 1e-3), 1e-3)
    gain *= factor_in_shade(surface, lit, measured.edges)
    # Shade under a blue sky needs most in red: a bound on each channel would leave it blue-green.
    bright = luminance(gain / open_ground)[:, None]
    return (gain * np.clip(bright, LEAST_GAIN, MOST_GAIN) / bright).astype(np.float16)
