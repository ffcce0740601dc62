"""The bed of ground that splats do not tell: how it is found to be such, and what is assumed."""

from types import SimpleNamespace

import numpy as np
import pytest

from made_captures import splats_at
from rainsim.config import Config
from rainsim.scene.cameras import look_at
from rainsim.scene.types import GroundFrame, Scene
from rainsim.terrain import assumed_bed
from rainsim.terrain.extract import extract_terrain
from rainsim.terrain.types import INFERRED, Grid
from rainsim.water.fill_spill_merge import standing_water

GRID = Grid((300, 400), (-8.0, -6.0), 0.04)


def test_roughness_belongs_to_the_place_and_not_to_the_grid():
    whole = assumed_bed.roughness(GRID)
    part = Grid((80, 90), (-8.0 + 50 * 0.04, -6.0 + 120 * 0.04), 0.04)
    np.testing.assert_allclose(
        assumed_bed.roughness(part), whole[120:200, 50:140], atol=1e-6, rtol=0
    )
    assert np.abs(assumed_bed.roughness(GRID, seed=1) - whole).max() > 0.005


def test_roughness_has_the_spectrum_of_an_average_road():
    grid = Grid((1500, 1500), (-30.0, -30.0), 0.04)
    height = assumed_bed.roughness(grid)
    power = np.abs(np.fft.rfft(height - height.mean(axis=1, keepdims=True), axis=1)) ** 2
    waves = np.fft.rfftfreq(1500, 0.04)
    density = (2 * power * 0.04 / 1500).mean(axis=0)
    road = assumed_bed.DENSITY * (waves[1:] / assumed_bed.N0) ** -2
    for low in (0.2, 0.35):
        band = (waves[1:] > low) & (waves[1:] < 1.7 * low)
        assert 0.7 < np.mean(density[1:][band] / road[band]) < 1.4
    assert 0.002 < height.std() < 0.012


def test_stones_have_settled_here_and_there_and_hold_water_on_a_slope():
    deep = assumed_bed.settled(GRID)
    assert 0.1 < np.mean(deep > 0) < 0.25 and 0.02 < deep.max() < 0.08 and deep.min() == 0
    bed = assumed_bed.roughness(GRID) - deep + 0.01 * GRID.centres()[0]
    depth, _, _ = standing_water(bed, 0.01, GRID.spacing)
    assert 0.2e-3 < depth.mean() < 1e-3  # Kidd's law says 0.5 mm


def test_ground_is_lower_along_what_stands_on_it():
    stands = np.zeros((9, 60), bool)
    assert not assumed_bed.foot_drop(stands, 0.05).any()
    stands[:, 10] = True
    drop = assumed_bed.foot_drop(stands, 0.05)[4]
    assert drop[10] == np.float32(assumed_bed.FOOT_DROP) and (np.diff(drop[10:16]) < 0).all()
    assert not drop[16:].any()


def test_mirrors_leave_out_sheets_in_the_open_and_keep_what_stands():
    poor = extract_terrain(poor_scene(0.2), Config.from_preset("moderate").terrain)
    sheets = np.array([(4 + 0.01 * k, 1.0, 0.2) for k in range(30)])
    box = np.array([(8.0, 1.0, 0.1 * k) for k in range(30)])
    places = np.concatenate([sheets, box, [(np.nan, 0, 0)]])
    left_out = assumed_bed.open_sheets(poor, places)
    assert left_out[:30].all() and not left_out[30:].any()
    known = extract_terrain(poor_scene(0.004), Config.from_preset("moderate").terrain)
    assert not assumed_bed.open_sheets(known, places).any()


def test_scatter_is_that_below_the_level_and_none_of_fine_ground():
    rng = np.random.default_rng(0)
    place = rng.uniform(-5, 5, (30_000, 2))
    cover = np.full(30_000, 0.02)
    assert assumed_bed.scatter_of(rng.normal(0, 0.01, 30_000), place, cover, 1.6) == 0
    assert assumed_bed.scatter_of(np.abs(rng.normal(0, 1, 30_000)), place, cover, 1.6) == 0
    found = assumed_bed.scatter_of(rng.normal(0, 0.2, 30_000), place, cover, 1.6)
    assert found == pytest.approx(0.2, rel=0.1)
    assert assumed_bed.scatter_of(np.zeros(0), np.zeros((0, 2)), np.zeros(0), 1.6) == 0


def test_ground_goes_up_and_down_with_a_walk_and_not_with_hands():
    x = np.arange(30.0)
    valley = np.column_stack([2 * x, 0 * x, 1.6 + 0.3 * np.cos(x / 6)])
    level = assumed_bed.level_below(valley)
    rise = valley[:, 2] - valley[:, 2].mean()
    assert np.abs(level(2 * x, 0 * x) - rise).max() < 0.15 and np.ptp(level(2 * x, 0 * x)) > 0.3
    hands = valley.copy()
    hands[:, 2] = np.where(x % 2, 1.3, 1.9)
    assert not assumed_bed.level_below(hands)(2 * x, 0 * x).any()


def test_ground_rises_with_rows_of_cameras_on_a_slope():
    x, row = np.meshgrid(np.arange(-12.0, 13, 1.5), (-6.0, 0.0, 6.0))
    high = np.where(row < 0, 1.2, np.where(row > 0, 2.4, 2.0))
    eyes = np.stack([x.ravel(), row.ravel(), high.ravel()], -1)
    level = assumed_bed.level_below(eyes)
    front, back = (level(np.zeros(1), np.full(1, y)) for y in (-6.0, 6.0))
    assert 0.5 < back - front < 1.2


def test_where_cameras_went_nothing_stands():
    eyes = np.array([[-6.0, 0, 1.6], [-3, 0, 1.6], [0, 0, 1.6]])
    went = assumed_bed.path_of(eyes, GRID)
    wall = [(x, 4.0, z) for x in np.arange(-6, 6, 0.04) for z in (0.5, 1.0, 2.0)]
    veil = [(-4.5, y, z) for y in np.arange(-0.4, 0.4, 0.04) for z in (0.6, 1.2)]
    eave = [(x, -4.0, 2.5) for x in np.arange(-6, 6, 0.04)]
    top, low = assumed_bed.cover(np.array(wall + veil + eave), GRID, 0.4, 3.0, went)
    row = {y: int((y + 6) / 0.04) for y in (4, 0, -4)}
    assert (top[row[4], 60:340] == 2.0).all() and not low[row[4]].any()  # it stands on the ground
    assert (top[row[-4], 60:340] == 2.5).all() and (low[row[-4], 60:340] == 2.5).all()
    assert not top[row[0]].any()
    layer = assumed_bed.layer_map(top > 0, went, 0.04, 0.15, 1.6)
    assert layer[row[0], 80] > 1.5 > layer[30, 380] > layer[row[4], 200] > 0
    narrow = assumed_bed.path_of(eyes, GRID, assumed_bed.WALKER)
    assert (narrow <= went).all() and narrow.sum() < 0.9 * went.sum()
    car = went & ~narrow  # what stands there was passed closely, and is no haze
    assert assumed_bed.layer_map(car, went, 0.04, 0.15, 1.6)[car].max() < 0.5
    scene = SimpleNamespace(splats=(), cameras=())
    poor = assumed_bed.PoorGround(scene, GRID, 0.15, eyes, lambda x, y: 0 * x)
    # A car that was passed closely stands, a clump of haze at the same distance does not.
    x, y, clump = np.arange(-5, -4, 0.04), np.arange(0.7, 1.7, 0.04), np.arange(0, 0.2, 0.04)
    beside = [(u, v, 0.9) for u in x for v in y]
    beside += [(u - 2, v + 0.7, 0.9) for u in clump for v in clump]
    _, found, _ = poor.cover(np.array(beside), GRID, np.zeros(GRID.shape), 3.0)
    assert (found[169, [87, 152]] > 0.8).tolist() == [True, False]
    # What rises over the layer (0.375 m) by less than the scatter is ground, however wide.
    mounds = [(u, v - 5, 0.5 if u < 0 else 0.6) for u in np.append(x, x + 8) for v in y]
    _, found, _ = poor.cover(np.array(mounds), GRID, np.zeros(GRID.shape), 3.0)
    assert not found[:, :150].any() and found[:, 150:].max() > 0.55
    top[row[4] - 40, 100:120] = 2.0  # a clump
    terrain = SimpleNamespace(grid=GRID, bed=0 * top, top=top, underside=low)
    layer = poor.layer_map(terrain, 0.1)
    assert (layer[row[4], 60:340] < 0).all() and layer[row[-4]].min() > 0
    assert layer[row[4] - 40].min() > 0


def test_a_level_from_the_air_is_smooth_and_has_no_hollows():
    def followed(x, y):
        return 0.05 * x + 0.3 * np.sin(3 * x) - 0.5 * np.exp(-((x - 3) ** 2 + (y - 2) ** 2) / 8)

    grid = Grid((150, 200), (-10.0, -7.0), 0.1)
    level = assumed_bed.smooth_level(followed, grid)
    x = np.arange(-8.0, 9.0, 0.5)
    along = level(x, 0 * x)
    assert 0.4 < along[-1] - along[0] < 1.0 and np.diff(along).min() > -0.02
    assert np.diff(level(x, 0 * x + 2)).min() > -0.02  # where the hollow is
    assert np.diff(followed(x, 0 * x + 2)).min() < -0.2


def poor_scene(scatter):
    """A street whose ground lies in a thick layer of splats, with cameras along it."""
    rng = np.random.default_rng(3)
    ground = rng.uniform((-2, -3, 0), (14, 3, 0), (12_000, 3))
    ground[:, 2] = rng.normal(0, scatter, len(ground))
    cameras = tuple(
        look_at((x, 0.2, 1.6), (x + 3, 0, 0.4), (0, 0, 1), 70, 96, 72, f"{x}") for x in range(8)
    )
    return Scene(
        "poor", splats_at(ground, scale=0.03), cameras, GroundFrame(np.eye(3), 1.0, np.zeros(3))
    )


def test_poor_ground_gets_an_assumed_bed_and_says_so():
    config = Config.from_preset("moderate").terrain
    poor = extract_terrain(poor_scene(0.2), config)
    assert any("PUDDLES ARE ASSUMED" in note for note in poor.notes)
    assert poor.layer.shape == poor.bed.shape and 0.3 < np.median(poor.layer) < 1.2
    assert 0.001 < poor.bed.std() < 0.02  # and no captured noise of 20 cm
    assert np.mean(poor.source == INFERRED) > 0.3 and not poor.noise.any()
    good = extract_terrain(poor_scene(0.004), config)
    assert good.layer.size == 0 and not any("ASSUMED" in note for note in good.notes)
