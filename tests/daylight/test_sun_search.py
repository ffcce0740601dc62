"""The sun of a capture: found to a fraction of a degree where the shadows of leaves fix it."""

import numpy as np
import pytest

from rainsim.daylight import sun
from rainsim.daylight.visibility import Solids, Window, axes_of

LEAF = 0.09  # m, radius
TOP = np.array([-2.0, -1.5, 0.7])  # m, of a round table
TOP_RADIUS = 0.7  # m


def court(azimuth, elevation, lit_over_shade, seed=4):
    """A ground under loose leaves beside a wall, with a low table.

    Straight shadows agree with many suns, those of leaves with one.

    Returns the places, the solids, the window and the direction of the sun.
    """
    rng = np.random.default_rng(seed)
    flat = np.cos(elevation)
    towards = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    wall_y, wall_z = np.mgrid[-2:1.3:0.2, 0.1:1.0:0.2].reshape(2, -1)
    wall = np.stack([np.full(wall_y.size, 2.5), wall_y, wall_z], -1)
    leaves = np.array([0.6, 0.4, 3.6]) + rng.uniform(-1, 1, (70, 3)) * [1.9, 1.9, 0.9]
    discs = np.concatenate([leaves, TOP[None]])
    radius = np.append(np.full(len(leaves), LEAF), TOP_RADIUS)
    position = np.concatenate([wall, discs]).astype(np.float32)
    covariance = np.zeros((len(position), 6), np.float32)  # xx, xy, xz, yy, yz, zz
    covariance[: len(wall), [3, 5]] = 0.14**2
    covariance[len(wall) :, [0, 3]] = (radius**2 / (2 * np.log(0.99 / 0.5)))[:, None]
    covariance[:, [0, 3, 5]] += 1e-6
    reach = np.full(len(position), 2 * np.log(0.99 / 0.3), np.float32)
    solids = Solids(position, covariance, reach)

    x, y = np.mgrid[-4:2.4:0.07, -3:3:0.07].reshape(2, -1)
    ground = np.stack([x, y, np.zeros_like(x)], -1).astype(np.float32)
    along = (discs[:, 2] / towards[2])[:, None] * towards
    foot = (discs - along)[:, :2]  # where the shadow of a level disc falls
    away = (2.5 - x) / towards[0]  # along a ray to the sun, as far as the wall's plane
    shaded = (away * towards[2] < 1.1) & (np.abs(y + away * towards[1] + 0.4) < 1.7)
    for place, far in zip(foot, radius, strict=True):
        shaded |= np.hypot(x - place[0], y - place[1]) < far
    light = np.where(shaded, 0.05, 0.05 * lit_over_shade) * rng.uniform(0.85, 1.15, x.size)
    light = np.repeat(light[:, None], 3, axis=1).astype(np.float32)
    normal = np.tile(np.float32([0, 0, 1]), (len(ground), 1))
    pair = sun._pairs(ground, normal, light)
    change = np.log(light[pair[:, 0], 0] / light[pair[:, 1], 0]).astype(np.float32)
    window = Window(np.zeros(3, np.float32), 1024, np.float32(14 / 1024))
    return sun.Places(ground, normal, light, pair, change), solids, window, towards


def search(places, solids, window):
    """Return what is found where all that stops light has a plane."""
    return sun.find_sun(places, solids, solids, window)


def degrees_between(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


@pytest.mark.parametrize("seed", [4, 6])
def test_shadows_of_leaves_fix_the_sun(seed):
    *yard, towards = court(0.3, 0.9, 5.0, seed)
    found, score = search(*yard)
    assert degrees_between(found, towards) < 0.5 and score > 0.4


def test_light_without_shadows_has_no_score():
    *yard, _ = court(0.3, 0.9, 1.0)
    assert search(*yard)[1] < sun.LEAST_SCORE


def test_the_discs_cover_what_the_first_search_leaves_open():
    middles = [np.array([0.6, 0.0, 0.8]), np.array([0.55, 0.1, np.sqrt(1 - 0.55**2 - 0.1**2)])]
    near = sun._near(middles, sun.DISC)
    np.testing.assert_allclose(np.linalg.norm(near, axis=1), 1)
    assert (
        len(near)
        == len(np.unique(near.round(6), axis=0))
        < 2 * len(sun._near(middles[:1], sun.DISC))
    )
    rng = np.random.default_rng(0)
    for middle in middles:
        radius, turn = 0.95 * sun.DISC * np.sqrt(rng.random(200)), 2 * np.pi * rng.random(200)
        right, up, _ = axes_of(middle)[0].astype(float)
        some = middle + np.outer(radius * np.cos(turn), right) + np.outer(radius * np.sin(turn), up)
        some /= np.linalg.norm(some, axis=1, keepdims=True)
        nearest = np.arccos(np.clip((some @ near.T).max(axis=1), -1, 1))
        assert nearest.max() < sun.SPACED
