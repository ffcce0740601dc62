"""The drawn water surface: level over pools, soft at the rim, over grass from its tips on."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage

from rainsim.reflection.water_surface import (
    GRASS_HEIGHT,
    NARROW,
    SPAN,
    WIDE,
    fine_relief,
    water_surface,
)
from rainsim.terrain.types import Grid

SHAPE = (60, 60)


def bowl():
    """A bowl 4 cm deep in its middle, in metres."""
    y, x = np.mgrid[0:60, 0:60] - 29.5
    return (0.04 * (x * x + y * y) / 30**2).astype(np.float32)


def drawn(depth, mirrors=True, bed=None):
    bed = bowl() if bed is None else bed
    mirrors = np.broadcast_to(np.asarray(mirrors), SHAPE).copy()
    none = np.zeros(SHAPE, np.float32)
    return water_surface(SimpleNamespace(bed=bed), depth.astype(np.float32), none, mirrors)


def test_a_pool_is_level_and_falls_to_nothing_at_its_rim():
    bed = bowl()
    depth = np.maximum(0.02 - bed, 0)
    surface, over, highest = drawn(depth)
    assert highest == surface[over > 0].max()
    np.testing.assert_allclose(surface[depth > 0], 0.02, atol=1e-4)
    np.testing.assert_allclose(over[depth > 0.003], depth[depth > 0.003], atol=5e-4)
    assert not over[depth == 0].max() > 1e-3 and over.max() > 0.015
    assert np.abs(np.diff(over, axis=0)).max() < 2e-3  # no step at the rim
    dry, none, highest = drawn(np.zeros(SHAPE))
    assert highest is None and not none.any() and np.isfinite(dry).all()


def test_a_lawn_is_covered_from_its_tips_on_without_a_step():
    """Water 6 cm deep stands 1 cm over grass of 5 cm; at 5 cm it is just not seen."""
    flat = np.zeros(SHAPE, np.float32)
    lawn = np.zeros(SHAPE, bool)
    values = [drawn(flat + d, lawn, flat)[1][30, 30] for d in (0.049, 0.0501, 0.052, 0.06)]
    assert values[0] == 0
    assert values[1] == pytest.approx(0.0501 - GRASS_HEIGHT, abs=1e-5)
    assert values[3] == pytest.approx(0.01, abs=1e-5)
    paved = drawn(flat + 0.049, True, flat)[1][30, 30]
    assert paved == pytest.approx(0.049, abs=1e-5)


def test_spans_of_cells_do_not_show():
    """Puddles far apart, at the edges and across spans, against Gaussian means of the whole map."""
    rng = np.random.default_rng(3)
    shape = 50, 5 * SPAN + 7
    bed = rng.normal(0, 1e-3, shape).astype(np.float32)
    depth = np.zeros(shape, np.float32)
    for rows, columns in (
        (slice(0, 4), slice(0, 3)), (slice(10, 20), slice(SPAN - 2, SPAN + 1)),
        (slice(44, 50), slice(5 * SPAN, None)), (slice(30, 31), slice(3 * SPAN, 3 * SPAN + 1)),
    ):  # fmt: skip
        depth[rows, columns] = 0.02
    mirrors, relief = np.ones(shape, bool), np.zeros(shape, np.float32)
    surface, over, _ = water_surface(SimpleNamespace(bed=bed), depth, relief, mirrors)

    def mean(values, weight):
        for axis in (0, 1):
            values = ndimage.correlate1d(values, weight.astype(float), axis, mode="constant")
        return values

    wet = (depth > 0).astype(float)
    weight = mean(wet, WIDE)
    near = weight > 2e-4
    level = mean(wet * (bed + depth), WIDE)[near] / weight[near]
    np.testing.assert_allclose(surface[near], level, atol=1e-6)
    rough = np.zeros(shape)
    rough[near] = np.maximum(level - bed[near], 0)
    reach = ndimage.generate_binary_structure(2, 1)
    rough *= ndimage.binary_dilation(depth > 0, reach, 2)
    np.testing.assert_allclose(over, mean(rough, NARROW), atol=1e-6)
    assert 0.02 < (over > 0).mean() < 0.2


def test_maps_of_one_size_have_one_relief():
    first, same, finer = (
        SimpleNamespace(grid=Grid((40, 60), (x, 0.0), spacing))
        for x, spacing in ((0.0, 0.02), (7.0, 0.02), (0.0, 0.01))
    )
    relief = fine_relief(first)
    assert (fine_relief(same) == relief).all() and relief.dtype == np.float32
    assert (fine_relief(finer) != relief).any()
    assert relief.std() == pytest.approx(0.5e-3, rel=0.2)
