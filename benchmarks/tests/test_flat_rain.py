"""The flat baseline: the same streaks, and none of the consistency."""

import numpy as np
import pytest

from benchmarks.flat_rain import flat_rain, partners, streaks_in
from rainsim.errors import ParameterError


def rain(rng, shift=0, count=60, shape=(200, 300)):
    """Streaks of many lengths and tilts; `shift` moves each to the left by its own disparity."""
    alpha = np.zeros(shape, np.float32)
    for k in range(count):
        row, column = rng.integers(5, 150), rng.integers(70, 280)
        length, tilt, bright = rng.integers(12, 40), rng.uniform(-0.3, 0.3), rng.uniform(0.1, 0.6)
        away = shift * (5 + k) // 10
        for step in range(length):
            at = int(column + tilt * step) - away
            alpha[row + step, at : at + 2] = bright * np.sin(np.pi * (step + 1) / (length + 1))
    return alpha


def test_flat_rain_has_the_same_streaks_elsewhere():
    alpha = rain(np.random.default_rng(1), count=20)
    flat = flat_rain(alpha, 3)
    assert flat.sum() == pytest.approx(
        sum(alpha[b][own].sum() for b, own in streaks_in(alpha)), rel=0.1
    )
    assert 0.5 < len(streaks_in(flat)) / len(streaks_in(alpha)) <= 1.05
    assert (np.minimum(flat, alpha).sum() / alpha.sum()) < 0.2
    np.testing.assert_array_equal(flat, flat_rain(alpha, 3))


def test_partners_are_found_where_they_are():
    left, right = (rain(np.random.default_rng(1), shift, 25) for shift in (0, 8))
    share, count = partners(left, right, 60)
    assert count > 18 and share > 0.85
    other, _ = partners(flat_rain(left, 1), flat_rain(right, 2), 60)
    assert other < 0.2 * share
    assert partners(left, np.zeros_like(right), 60)[0] == 0


def test_pictures_of_two_sizes_are_refused():
    with pytest.raises(ParameterError, match="equal in size"):
        partners(np.zeros((4, 5)), np.zeros((4, 6)), 2)
