"""Normals of a neighbourhood: sure where captured ones are noisy, sharp where surfaces end."""

import numpy as np
import pytest

from rainsim.shading.smooth_normals import AROUND, smooth_normal

F4 = np.float32
SIDE, FOCAL = 80, F4(400)


def smoothed(depth, normal, around=AROUND):
    """Return the normals around all pixels, unit."""
    found = np.array([
        smooth_normal(depth, normal, row, column, SIDE, SIDE, FOCAL, around)
        for row, column in np.ndindex(SIDE, SIDE)
    ]).reshape(SIDE, SIDE, 3)  # fmt: skip
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


@pytest.fixture
def panel(rng):
    """A panel 2 m away whose captured normals scatter by some 20 degrees: depth, normals."""
    normal = F4([0, 0, -1]) + rng.normal(0, 0.25, (SIDE, SIDE, 3)).astype(F4)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.full((SIDE, SIDE), 2, F4), normal.astype(F4)


def test_noise_of_normals_falls_as_the_mean_of_nine_does(panel):
    before = panel[1][..., :2].std()
    after = smoothed(*panel)[..., :2].std()
    assert after == pytest.approx(before / 3, rel=0.15)


def test_what_stands_behind_does_not_count(panel):
    depth, normal = panel
    normal[:], normal[:, SIDE // 2 :] = F4([0, 0, -1]), F4([1, 0, 0])
    depth[:, SIDE // 2 :] += 1
    np.testing.assert_allclose(smoothed(depth, normal), normal, atol=1e-6)
    depth[:] = 2  # a bend of one surface is rounded off
    assert np.abs(smoothed(depth, normal) - normal)[:, SIDE // 2].max() > 0.3


@pytest.mark.parametrize("distance", [0.5, 1.5, 4, 40])
def test_the_neighbourhood_is_as_large_in_metres_near_and_farther_away(distance):
    """How far from a bend normals are mixed, within the steps of the radius."""
    depth, normal = np.full((SIDE, SIDE), distance, F4), np.zeros((SIDE, SIDE, 3), F4)
    normal[:, : SIDE // 2, 0], normal[:, SIDE // 2 :, 1] = 1, 1
    mixed = np.abs(smoothed(depth, normal) - normal).max(axis=-1)[SIDE // 2] > 0.01
    radius = mixed.sum() / 2
    wanted = np.clip(FOCAL * AROUND / distance, 2, 16)
    assert wanted / 1.5 <= radius <= wanted * 1.5
