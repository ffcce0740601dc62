"""Puddles that rain, evaporation and drains move."""

import numpy as np
import pytest

from rainsim.errors import ParameterError
from rainsim.terrain import HARD, MEASURED, UNKNOWN, Grid, Terrain
from rainsim.water.fill_spill_merge import SpillGraph, standing_water
from rainsim.water.puddles import (
    Puddles,
    bed_error,
    doubt,
    probability,
    puddles_of,
    wet_share,
)

SPACING = 0.05


def two_bowls(size=40):
    """A floor with a 20 mm and a 10 mm bowl apart from each other."""
    y, x = np.mgrid[:size, :size]
    bed = np.full((size, size), 0.03)
    for cx, cy, deep in ((11, 20, 0.02), (29, 20, 0.01)):
        r = np.hypot(x - cx, y - cy) / 8
        bed -= np.where(r < 1, deep * (1 - r**2), 0)
    return bed


def made_terrain(bed, noise=0.0):
    shape = bed.shape
    bed = bed.astype(np.float32)
    return Terrain(
        Grid(shape, (0.0, 0.0), SPACING), bed, bed.copy(), bed.copy(),
        np.full(shape, MEASURED, np.uint8), np.full(shape, HARD, np.uint8),
        np.full(shape, noise, np.float32), np.full((*shape, 3), 0.5, np.float32),
    )  # fmt: skip


def puddles():
    bed = two_bowls()
    return Puddles(SpillGraph(bed, SPACING), np.zeros(bed.shape))


def test_rain_in_steps_is_rain_at_once():
    one, many = puddles(), puddles()
    one.rain(3e-3)
    for _ in range(6):
        many.rain(0.5e-3)
    np.testing.assert_allclose(many.depth, one.depth, atol=1e-12)
    at_once = standing_water(two_bowls(), 3e-3, SPACING)[0]
    np.testing.assert_array_equal(one.depth, at_once)
    assert one.volume > 0 and one.residual < 1e-12 and many.residual < 1e-12


def test_resting_water_stays():
    wet = puddles()
    wet.rain(2e-3)
    before = wet.depth.copy()
    wet.rain(0.0)
    np.testing.assert_allclose(wet.depth, before, atol=1e-13)


def test_evaporation_lowers_every_level_and_dries_in_the_end():
    wet = puddles()
    wet.rain(4e-3)
    deepest, count = wet.depth.max(), wet.count()
    wet.evaporate(2e-3)
    assert wet.depth.max() == pytest.approx(deepest - 2e-3, abs=1e-9)
    assert count == 2 and wet.volumes["evaporated"] > 0 and wet.residual < 1e-12
    wet.evaporate(1.0)
    assert wet.volume == 0 and wet.residual < 1e-12


def test_a_drain_takes_what_is_there_and_no_more():
    wet = puddles()
    wet.rain(4e-3)
    other = wet.depth[20, 29]
    taken = wet.drain(20, 11, 1e-3)
    assert taken == pytest.approx(1e-3) and wet.volumes["drained"] == taken
    assert wet.depth[20, 29] == pytest.approx(other)
    rest = wet.drain(20, 11, 1.0)
    assert 0 < rest < 1 and wet.depth[20, 11] < 1e-9 and wet.residual < 1e-12
    assert wet.drain(0, 0, 1.0) == 0.0
    with pytest.raises(ParameterError, match="off the map"):
        wet.drain(40, 0, 1.0)


def test_small_and_shallow_hollows_are_left_out_and_counted():
    bed = two_bowls()
    bed[5, 5] -= 0.01
    bed[2:6, 30:36] -= 0.5e-3
    every = SpillGraph(bed, SPACING)
    some = SpillGraph(bed, SPACING, minimum_depth=1e-3, minimum_area=2.5 * SPACING**2)
    assert every.dropped == 0 and some.dropped == 2 and some.count == every.count
    depth = some.pour(5e-3)[0]
    assert depth[5, 5] == 0 and depth[2:6, 30:36].max() == 0 and depth[20, 11] > 0.01
    assert every.pour(5e-3)[0][5, 5] > 0


def test_noise_of_the_terrain_sets_what_is_left_out():
    bed = two_bowls()
    bed[2:8, 30:38] -= 1.2e-3
    quiet, rough = puddles_of(made_terrain(bed)), puddles_of(made_terrain(bed, noise=4e-3))
    assert quiet.graph.dropped == 0 and rough.graph.dropped == 1
    for wet in (quiet, rough):
        wet.rain(5e-3)
    assert rough.depth[2:8, 30:38].max() == 0 < quiet.depth[2:8, 30:38].max()
    assert 0 < wet_share(rough.depth, np.ones(bed.shape, bool)) < 1
    assert wet_share(rough.depth, np.zeros(bed.shape, bool)) == 0


def test_puddles_on_a_noisy_or_unseen_bed_are_not_to_be_believed():
    quiet, rough = (made_terrain(two_bowls(), noise) for noise in (0.1e-3, 4e-3))
    assert doubt(quiet, 3e-3) is None and bed_error(quiet) < 0.5e-3 < bed_error(rough)
    assert "mm off" in doubt(rough, 1e-3) and doubt(rough, 0.1) is None
    quiet.source[:30] = UNKNOWN
    assert "only 25% of the paving is measured" in doubt(quiet, 3e-3)


def test_water_is_as_probable_as_its_depth_is_beyond_the_beds_error():
    x = np.linspace(-1, 1, 41)
    bowl = 0.02 * (x[:, None] ** 2 + x**2)
    sure, unsure = made_terrain(bowl, noise=1e-4), made_terrain(bowl, noise=6e-3)
    depth = np.maximum(0.01 - bowl, 0)
    assert probability(sure, depth) > 0.999 > 0.95 > probability(unsure, depth) > 0.5
    assert probability(sure, 0 * depth) is None
    # The share of shown water that is there, over beds that are off by the error that is told.
    error = bed_error(unsure)
    rng = np.random.default_rng(1)
    there = [(0.01 - bowl + error * rng.normal(size=bowl.shape))[depth >= 1.5e-3] > 0
             for _ in range(20)]  # fmt: skip
    assert np.mean(there) == pytest.approx(probability(unsure, depth), abs=0.01)
