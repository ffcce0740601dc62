"""The light that places receive: of the sky that they see, of their surroundings, of the sun.

The unit is the irradiance of the same sky on open level ground.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.daylight import sky_light, visibility

SKY_DIRECTIONS = 96
SKIES = 5  # see `sky_radiance`
SIDE_DIRECTIONS, SIDE = 24, 512  # and px, of the maps that show which side of a splat is open
BLIND, OPEN = 0.06, 0.15  # light of an even sky on a side that is closed, and on an open one
SUN_SIDE = 3072  # px of the near map of the sun
MARGIN, FAR_MARGIN = 0.025, 0.15  # m by which what hides a place stands above it
BAND = 0.05  # m about the edge of a shadow within which its place is not sure
SUNS = 4  # about the sun, that are looked at where its place is not sure
AROUND = 6  # places that are looked at about one
ANY_FACE = np.float32(0.25)  # mean cosine, not below 0, to a direction over all ways to face


class Light(NamedTuple):
    """What places receive, float32."""

    clear: np.ndarray  # (n, 3): from the clear sky, for each channel
    overcast: np.ndarray  # (n,): from the overcast sky
    blocked: np.ndarray  # (n, 2): shares of the view that are no sky, below the horizon and above
    around: np.ndarray  # (n, 3): from their surroundings in the captured day


def maps_along(solids, window, directions):
    """Yield slices of the directions, their axes and the maps of heights along them."""
    solids = visibility.coarsened(solids, visibility.COARSER * float(window.pixel))
    for start in range(0, len(directions), visibility.BATCH):
        part = slice(start, min(start + visibility.BATCH, len(directions)))
        axes = visibility.axes_of(directions[part])
        heights = np.empty((len(axes), window.side, window.side), np.float32)
        visibility.draw_heights(solids, axes, window, heights)
        yield part, axes, heights


def turn_to_the_open(surface, solids, window):
    """Turn the normals of splats whose side towards the cameras is closed and whose other is not.

    They are the backs of walls, which no camera saw; `surface.normal` is modified in place.
    """
    directions, window = sky_light.hemisphere(SIDE_DIRECTIONS), visibility.resized(window, SIDE)
    plane, sides = np.ones_like(surface.flat), np.zeros((2, len(surface.flat)), np.float32)
    for _, axes, heights in maps_along(solids, window, directions):
        cosine = surface.normal @ axes[:, 2].T
        seen = np.empty_like(cosine)
        place = surface.position, surface.normal, plane, np.float32(MARGIN)
        visibility.find_seen(heights, axes, window, *place, seen)
        sides += [(np.maximum(c, 0) * seen).sum(axis=1) for c in (cosine, -cosine)]
    sides /= SIDE_DIRECTIONS / 2  # what open level ground receives
    surface.normal[(sides[0] < BLIND) & (sides[1] > OPEN)] *= -1


def sky_radiance(sun):
    """Return directions (m, 3) and the radiance of skies in each, (m, 5) float32.

    A clear one for each channel, an overcast one and an even one; open level ground receives 1 of
    each.
    """
    directions = sky_light.hemisphere(SKY_DIRECTIONS)
    clear = sky_light.clear(directions, sun)
    skies = np.column_stack([clear, sky_light.overcast(directions), np.ones(SKY_DIRECTIONS)])
    skies /= (skies * directions[:, 2:]).sum(axis=0)
    return directions, skies.astype(np.float32)


def received(surface, solids, windows, sun, sent):
    """Return the `Light` on each splat.

    A splat takes the first of the windows, the near and the far one, that shows it. `sun` is the
    unit vector to the sun of the clear sky, `sent` what the surroundings send.
    """
    total = np.zeros((len(surface.position), SKIES), np.float32)
    for part, window, margin in _parts(surface, windows):
        place = surface.position[part], surface.normal[part], surface.flat[part]
        total[part] = sky_sums(*place, solids, window, sun, margin)
    place = surface.position, surface.normal, surface.flat
    return light_of(total, surface.normal, surface.flat, sent.at(*place))


def sky_sums(position, normal, flat, solids, window, sun, margin=MARGIN):
    """Return what places receive of the skies of `sky_radiance`, (n, SKIES) float32."""
    total = np.zeros((len(position), SKIES), np.float32)
    if len(position):
        directions, skies = sky_radiance(sun)
        for part, axes, heights in maps_along(solids, window, directions):
            visibility.add_light(
                heights, axes, window, position, normal, flat, np.float32(margin), skies[part],
                total,
            )  # fmt: skip
    return total


def light_of(sums, normal, flat, sent):
    """Return the `Light` of the sums that `sky_sums` returns: what is no sky is surroundings.

    `sent` is the mean radiosity of these below the horizon and above, float32 (n, 2, 3).
    """
    below = flat * 0.5 * (1 - normal[:, 2]) + (1 - flat) * 0.5
    above = np.maximum(1 - sums[:, 4] - below, 0)
    blocked = np.stack([below, above], axis=-1).astype(np.float32)
    return Light(sums[:, :3], sums[:, 3], blocked, around_of(blocked, sent))


def around_of(blocked, sent):
    """Return the light of the surroundings (n, 3) of shares (n, 2) and radiosities (n, 2, 3)."""
    return np.einsum("ij,ijk->ik", blocked, sent)


def facing(surface, direction):
    """Return the cosine to a direction, its mean over all ways to face for what has no plane."""
    cosine = np.maximum(surface.normal @ direction.astype(np.float32), 0)
    return surface.flat * cosine + (1 - surface.flat) * ANY_FACE


def sunlit(surface, solids, windows, sun, unsure=0.0):
    """Return how much of each place nothing hides from the sun, and of the places about it.

    The second is the mean over places BAND away, and over suns `unsure` [rad] away: where it is
    another, the edge of a shadow is near or may be.
    """
    axes = visibility.axes_of(sun)
    others = []
    if unsure:
        turn = np.arange(SUNS) * 2 * np.pi / SUNS
        moved = np.cos(turn)[:, None] * axes[0, 0] + np.sin(turn)[:, None] * axes[0, 1]
        moved = sun + math.tan(unsure) * moved
        others = visibility.axes_of(moved / np.linalg.norm(moved, axis=1, keepdims=True))
    own, about = (np.zeros(len(surface.position), np.float32) for _ in range(2))
    for part, window, margin in _parts(surface, windows):
        if window is windows[0]:
            window = visibility.resized(window, SUN_SIDE)
        heights = np.empty((1, window.side, window.side), np.float32)
        visibility.draw_heights(solids, axes, window, heights)
        position, normal = surface.position[part], surface.normal[part]
        rest = normal, surface.flat[part], np.float32(margin)
        own[part] = _seen(heights, axes, window, position, *rest)
        for step in about_normal(normal):
            moved = position + np.float32(BAND) * step
            about[part] += _seen(heights, axes, window, moved, *rest) / AROUND
        for other in others:
            visibility.draw_heights(solids, other[None], window, heights)
            change = _seen(heights, other[None], window, position, *rest) - own[part]
            about[part] += change / len(others)
    return own, about


def _seen(heights, axes, window, *places):
    """Return what `find_seen` finds along one direction."""
    seen = np.empty((len(places[0]), 1), np.float32)
    visibility.find_seen(heights, axes, window, *places, seen)
    return seen[:, 0]


def about_normal(normal):
    """Return AROUND unit vectors across each normal (n, 3), a list of float32 (n, 3)."""
    across = np.cross(normal, [0.31, 0.54, 0.78]).astype(np.float32)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-6)
    along = np.cross(normal, across)
    turns = np.arange(AROUND) * 2 * np.pi / AROUND
    return [np.float32(np.cos(t)) * across + np.float32(np.sin(t)) * along for t in turns]


def _parts(surface, windows):
    """Yield the splats that each window is the first to show, the window and its margin."""
    left = np.ones(len(surface.position), bool)
    for window, margin in zip(windows, (MARGIN, FAR_MARGIN), strict=True):
        half = 0.5 * window.side * float(window.pixel)
        # Along any direction a map shows the sphere that is as wide as its window.
        inside = left & (np.linalg.norm(surface.position - window.middle, axis=1) < half)
        left &= ~inside
        if inside.any():
            yield np.flatnonzero(inside), window, margin
