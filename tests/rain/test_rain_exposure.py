"""Exposure: the ways of drops through a map, each followed on its own."""

import math

import numpy as np
import pytest

from rainsim.rain import exposure
from rainsim.rain.moving_surfaces import Heights
from rainsim.rain.size_distribution import terminal_speed
from rainsim.terrain.types import Grid

SPACING = 0.25


def block_map(things):
    """Return uneven ground with a block in the middle and a roof that reaches over the edge."""
    bed = np.random.default_rng(3).uniform(0.0, 0.3, (14, 18)).astype(np.float32)
    top, underside = bed.copy(), bed.copy()
    if things:
        top[5:9, 6:11] = 1.63
        top[8:13, :4], underside[8:13, :4] = 2.41, 1.87
    return Heights(Grid(bed.shape, (0.0, 0.0), SPACING), bed, top, underside)


def is_free(ground, row, column, way):
    """Follow one way up from a cell; tell whether it meets nothing."""
    step = SPACING / max(*np.abs(way), 0.5)
    for k in range(math.ceil((ground.top.max() - ground.bed.min()) / step)):
        z = ground.bed[row, column] + k * step
        i, j = (math.floor(n + k * step * w / SPACING + 0.5)
                for n, w in ((column, way[0]), (row, way[1])))  # fmt: skip
        if not (0 <= j < ground.bed.shape[0] and 0 <= i < ground.bed.shape[1]):
            return True
        if ground.top[j, i] > ground.bed[j, i] and ground.underside[j, i] <= z <= ground.top[j, i]:
            return False
    return True


@pytest.mark.parametrize("wind", [(0.0, 0.0), (5.0, 0.7), (6.0, 3.9)])
def test_every_way_is_followed(monkeypatch, wind):
    """The share of each cell is that of its ways, in which no block and no roof stands."""
    monkeypatch.setattr(exposure, "_blurred", lambda share, _: share)
    ground = block_map(things=True)
    falls = terminal_speed(np.array(exposure.SHELTER_DIAMETERS))
    ways = np.outer(-wind[0] / falls, (math.cos(wind[1]), math.sin(wind[1])))
    wanted = [[np.mean([is_free(ground, row, column, way) for way in ways])
               for column in range(18)] for row in range(14)]  # fmt: skip
    found = exposure.rain_exposure(ground, wind)
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert found.min() == 0 and (found == 1).any()


def test_bare_ground_is_open():
    assert (exposure.rain_exposure(block_map(things=False), (5.0, 0.7)) == 1).all()
