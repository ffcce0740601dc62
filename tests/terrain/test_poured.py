"""Water that a user puts on the ground: masks, dents that hold it, and water that runs off."""

import dataclasses

import numpy as np
import pytest

from rainsim import simulation
from rainsim.config.settings import Config
from rainsim.errors import InputError, ParameterError
from rainsim.io import images
from rainsim.terrain import map_files
from rainsim.terrain.poured import (
    DRAINS,
    STAYS,
    WaterMask,
    painted_water,
    read_water_mask,
    with_water,
    write_water_mask,
)
from rainsim.terrain.table import HARD
from rainsim.terrain.types import MEASURED, Grid, Terrain

GRID = Grid((40, 50), (0.0, 0.0), 0.02)


def ground(slope=0.0, dip=0.0):
    """Return paving that rises along x by a slope, with a dip in the middle of a depth [m]."""
    x, y = GRID.centres()
    bed = slope * x[None, :] + 0 * y[:, None]
    bed = bed - dip * np.exp(-((x[None, :] - 0.3) ** 2 + (y[:, None] - 0.4) ** 2) / 0.02)
    bed, shape = bed.astype(np.float32), GRID.shape
    return Terrain(
        GRID, bed, bed.copy(), bed.copy(), np.full(shape, MEASURED, np.uint8),
        np.full(shape, HARD, np.uint8), np.zeros(shape, np.float32),
        np.full((*shape, 3), 0.5, np.float32),
    )  # fmt: skip


def start(terrain):
    settings = Config().replace(past=0.0, rate=0.0)
    return simulation.initial_water(terrain, settings, np.ones(GRID.shape, np.float32))[0]


def disc(depth, stays, point=(0.6, 0.4)):
    return painted_water(None, GRID, point, 0.15, depth, stays)


def test_water_that_stays_fills_its_dent_to_the_brim_and_does_not_flow():
    terrain = with_water(ground(), disc(8e-3, True))
    wet = GRID.disc((0.6, 0.4), 0.15)
    np.testing.assert_allclose(start(terrain)[wet], 8e-3, atol=1e-6)
    assert start(terrain)[~wet].max() == 0 and terrain.bed[wet].max() < -7.9e-3
    assert (terrain.top == terrain.bed).all()
    settings = Config().replace(past=0.0, rate=0.0, fps=5.0)
    states = simulation.simulate(terrain, settings)
    first, *_, last = (next(states) for _ in range(4))
    assert last.depth[wet].sum() == pytest.approx(first.depth[wet].sum(), rel=1e-3)


def test_a_dent_on_a_slope_holds_what_is_below_its_low_rim():
    terrain = with_water(ground(slope=0.05), disc(8e-3, True))
    depth, level = start(terrain), None
    wet = depth > 0
    level = (depth + terrain.bed)[wet]
    assert 0.1 < wet.sum() / GRID.disc((0.6, 0.4), 0.15).sum() < 0.9
    assert np.ptp(level) < 1e-6 and "hold" in terrain.notes[-1]


def test_water_that_drains_comes_to_rest_where_the_ground_dips_and_none_is_lost():
    dry, poured = ground(dip=0.02), disc(1e-3, False, (0.3, 0.4))
    terrain = with_water(dry, poured)
    assert terrain.bed is dry.bed and start(dry).max() == 0
    depth = start(terrain)
    assert depth.sum() == pytest.approx(poured.depth.sum(), rel=1e-5)
    assert depth.max() > 2e-3 and not np.allclose(depth, poured.depth)
    away = with_water(ground(slope=0.2), disc(1e-3, False))
    assert start(away).sum() < 1e-9  # it left over the edge


def test_masks_come_back_from_pictures_and_terrains_from_files(tmp_path):
    mask = disc(12e-3, True)
    write_water_mask(tmp_path / "w.png", mask)
    again = read_water_mask(tmp_path / "w.png", STAYS)
    np.testing.assert_allclose(again.depth, mask.depth, atol=1e-7)
    assert again.stays and not read_water_mask(tmp_path / "w.png", DRAINS).stays
    for stays in (True, False):
        terrain = with_water(ground(slope=0.05), mask._replace(stays=stays))
        map_files.write_terrain(tmp_path / "t", terrain)
        read = map_files.read_terrain(tmp_path / "t")
        for name in ("bed", "standing", "poured"):
            ours, theirs = getattr(terrain, name), getattr(read, name)
            assert (ours is None and theirs is None) or (ours == theirs).all()


def test_painting_again_takes_water_away_and_none_changes_nothing():
    two = painted_water(disc(5e-3, True), GRID, (0.6, 0.4), 0.2, 0.0, True)
    terrain = ground()
    assert two.depth.max() == 0 and with_water(terrain, two) is terrain is with_water(terrain, None)


def test_masks_that_do_not_fit_are_refused(tmp_path):
    with pytest.raises(ParameterError, match="has 3 x 2 cells; the map has 50 x 40"):
        with_water(ground(), WaterMask(np.ones((2, 3), np.float32), True))
    images.write_png(tmp_path / "c.png", np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(InputError, match="must be grey"):
        read_water_mask(tmp_path / "c.png")
    images.write_png16(tmp_path / "deep.png", np.full((4, 4), 20000))
    with pytest.raises(InputError, match="0 to 10000"):
        read_water_mask(tmp_path / "deep.png")


def test_a_terrain_without_a_mask_holds_no_such_map():
    terrain = ground()
    assert terrain.standing is None and terrain.poured is None
    assert dataclasses.replace(terrain, standing=np.zeros(GRID.shape)).standing is not None
