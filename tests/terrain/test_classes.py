"""Ground classes: the table, the mask that a user paints, lawns and moss; slopes and floaters."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import captures
from benchmarks import ground as suite
from rainsim import terrain
from rainsim.config.settings import TerrainConfig
from rainsim.errors import InputError, ParameterError
from rainsim.io import cache, images
from rainsim.scene.ground import scale_from_length, with_fall
from rainsim.scene.painted import PaintedClasses
from rainsim.scene.types import GroundFrame
from rainsim.terrain import extract, tops
from rainsim.terrain.classify import classify
from rainsim.terrain.kept_terrain import inputs_of

SPACING = 0.04


def test_the_table_is_si_and_complete():
    table = terrain.class_table()
    assert table.names == ("paving", "grass", "soil", "object", "water", "drain")
    assert table.column("infiltration")[terrain.GRASS] == pytest.approx(3e-5)
    assert table.column("storage")[terrain.HARD] == pytest.approx(0.3e-3)
    assert table.column("soaks")[terrain.GRASS] and not table.column("mirrors")[terrain.GRASS]
    assert len({tuple(c) for c in table.colors}) == len(table.names)


def made_ground(lawn_height):
    """Paving with a green speck in the west, a lawn in the east; 4 x 4 m."""
    n = round(4 / SPACING)
    x = (np.arange(n) + 0.5) * SPACING - 2 + np.zeros((n, 1))
    y = x.T
    lawn, moss = x > 0.5, np.hypot(x + 1, y) < 0.12
    bed = np.where(lawn, lawn_height, 0).astype(np.float32)
    green = np.where(lawn | moss, 0.3, 0.0).astype(np.float32)
    source = np.full((n, n), terrain.MEASURED, np.uint8)
    color = np.full((n, n, 3), 0.5, np.float32)
    return x, bed, source, np.full((n, n), 5e-4, np.float32), color, green, moss


@pytest.mark.parametrize("height", [0.0, 0.06])
def test_moss_lies_on_paving_and_a_lawn_does_not(height):
    x, bed, source, noise, color, green, moss = made_ground(height)
    classes = classify(bed, bed, source, noise, color, green, SPACING)
    assert (classes[moss] == terrain.HARD).all()
    assert (classes[(x > 0.6)] == terrain.GRASS).all()
    assert (classes[(x < 0.4)] == terrain.HARD).all()


def test_rough_brown_ground_is_soil_and_a_hidden_one_object():
    x, bed, source, noise, color, green, _ = made_ground(0.0)
    patch = x < -1
    noise[patch], color[patch] = 5e-3, (0.5, 0.35, 0.2)
    source[:20, :20] = terrain.UNKNOWN
    top = bed + np.where(source == terrain.UNKNOWN, np.float32(1), 0)
    classes = classify(bed, top, source, noise, color, green, SPACING)
    assert (classes[40:60, 5:20] == terrain.SOIL).all()
    assert (classes[:18, :18] == terrain.OBJECT).all()
    assert (classes[40:60, 40:55] == terrain.HARD).all()


@pytest.fixture(scope="module")
def yard():
    scene, truth = captures.yard(3, step=0.04)
    config = TerrainConfig(spacing=SPACING, extent=3.0)
    return scene, truth, config, terrain.extract_terrain(scene, config)


def test_a_painted_mask_wins_and_the_rest_is_told(yard, tmp_path):
    scene, _, config, plain = yard
    paint = np.zeros((*plain.grid.shape, 3), np.uint8)
    paint[:10] = terrain.class_table().colors[terrain.WATER]  # the picture's top is north
    images.write_png(tmp_path / "mask.png", paint)
    mask = terrain.read_mask(tmp_path / "mask.png")
    painted = terrain.extract_terrain(scene, config, mask)
    assert (painted.ground_class[-10:] == terrain.WATER).all()
    np.testing.assert_array_equal(painted.ground_class[:-10], plain.ground_class[:-10])
    with pytest.raises(ParameterError, match="the map has 150 x 150"):
        terrain.extract_terrain(scene, config, mask[1:])
    paint[0, 3] = (255, 0, 255)
    images.write_png(tmp_path / "mask.png", paint)
    with pytest.raises(InputError, match=r"pixel \(3, 0\)"):
        terrain.read_mask(tmp_path / "mask.png")


def test_classes_painted_in_the_scene_are_taken_by_maps_of_any_cell(yard, tmp_path):
    scene, _, config, plain = yard
    names = terrain.class_table().names
    cells = np.full((4, 4), -1, np.int16)
    cells[3] = 0  # y from 0 to 0.5
    painted = PaintedClasses((names[terrain.WATER],), cells, (-1.0, -1.5), 0.5)
    scene = replace(scene, painted=painted)
    ground = terrain.extract_terrain(scene, config)
    x, y = np.meshgrid(*ground.grid.centres())
    inside = (np.abs(x) < 1.0) & (y > 0.0) & (y < 0.5)
    assert (ground.ground_class[inside] == terrain.WATER).all()
    assert (plain.ground_class[inside] != terrain.WATER).any()
    np.testing.assert_array_equal(ground.ground_class[~inside], plain.ground_class[~inside])
    blank = np.full(ground.grid.shape, -1, np.int16)  # a mask that is given wins over all of them
    given = terrain.extract_terrain(scene, config, blank)
    np.testing.assert_array_equal(given.ground_class, plain.ground_class)
    assert cache.name_of(inputs_of(scene, config)) != cache.name_of(inputs_of(yard[0], config))
    scene = replace(scene, painted=replace(painted, name=("lava",)))
    with pytest.raises(InputError, match="lava"):
        terrain.extract_terrain(scene, config)


def test_soil_below_the_lawn_paving_below_the_table(yard):
    _, truth, _, ground = yard
    x, y = np.meshgrid(*ground.grid.centres())
    lawn = np.maximum(np.abs(x), np.abs(y)) > truth.half + 0.6
    assert (ground.ground_class[lawn] == terrain.GRASS).all()
    soil = ground.bed[lawn] - truth.bed(x[lawn], y[lawn])
    assert abs(np.median(soil)) < 0.012 < captures.LAWN_HEIGHT / 2
    tx, ty, half, height = captures.TABLE
    under = (np.abs(x - tx) < half - 0.1) & (np.abs(y - ty) < half - 0.1)
    assert ground.covered[under].all() and (ground.source[under] == terrain.MEASURED).all()
    np.testing.assert_allclose(ground.bed[under], truth.bed(x[under], y[under]), atol=0.005)
    # A third of the splats float: they neither raise the table nor shelter the open ground.
    rise = ground.top[under] - truth.bed(x[under], y[under]) - height
    assert np.percentile(np.abs(rise), 95) < 0.015
    beside = np.maximum(np.abs(x - tx), np.abs(y - ty)) > half + 0.15
    assert (ground.top > ground.bed)[beside].mean() < 0.01


def test_dips_are_found_in_the_yard_among_floaters():
    found = suite.measure_bed(*captures.yard(101), spacing=0.03)
    assert found["dips_missed"] <= 0.13 and found["false_puddles"] < 0.03
    assert found["bed_mm"] < 1.5 and found["bias_mm"] < 0.5
    assert found["under_table_mm"] < 5 and found["under_table_unknown"] == 0


def test_a_kerb_is_sharp_and_in_its_place():
    scene, truth = captures.yard(105, 3e-3, kerb=True)  # was 1.1 cells off unstraightened
    found = suite.measure_bed(scene, truth, spacing=0.02)
    assert found["kerb_cells"] <= 0.8
    scene, truth = captures.yard(101, kerb=True)
    found = suite.measure_bed(scene, truth, spacing=0.02)
    assert found["kerb_cells"] <= 1 and found["bed_mm"] < 0.5
    ground = terrain.extract_terrain(
        replace(scene, ground_frame=truth.frame), TerrainConfig(spacing=0.02, extent=1.5)
    )
    x, y = ground.grid.centres()
    low, high = (np.abs(x - captures.KERB_X - side * 0.03) < 0.011 for side in (-1, 1))
    rows = np.abs(y) < 1
    for columns, level in ((low, 0.0), (high, captures.KERB_HEIGHT)):
        height = ground.bed[np.ix_(rows, columns)] - level
        assert np.percentile(np.abs(height), 80) < 0.02  # no ramp


def test_blades_at_the_rim_of_paving_dam_no_water():
    found = suite.measure_bed(*captures.yard(100), spacing=0.04)
    assert found["false_puddles"] < 0.01
    height = np.zeros((20, 20), np.float32)
    grass = np.zeros((20, 20), bool)
    grass[:, 12:], height[:, 11:] = True, 0.02  # blades in the last column of paving
    lowered = terrain.bed.lower_rim(height, ~grass, grass, 0.02)
    assert (lowered[:, :12] == 0).all() and (lowered[:, 12:] == height[:, 12:]).all()
    assert (terrain.bed.lower_rim(-height, ~grass, grass, 0.02) == -height).all()


def test_a_hilly_street_is_followed_in_tiles(monkeypatch):
    monkeypatch.setattr("rainsim.terrain.extract.PIECE", 40_000)
    found = suite.measure_street(spacing=0.2)
    assert found["length_m"] > 250 and found["measured"] > 0.97
    assert found["bed_mm"] < 10  # it rises and falls by 1.4 m and its camber is 100 mm


def test_parts_of_a_map_fit_together(yard, monkeypatch):
    scene, _, config, whole = yard
    monkeypatch.setattr(extract, "PIECE", 20_000)
    monkeypatch.setattr(extract, "MARGIN", 1.0)
    parts = list(extract.pieces(whole.grid))
    covered = np.zeros(whole.grid.shape, int)
    for core, inner, _, part in parts:
        covered[core] += 1
        x, y = whole.grid.centres()
        np.testing.assert_allclose(part.centres()[0][inner[1]], x[core[1]], atol=1e-9)
        np.testing.assert_allclose(part.centres()[1][inner[0]], y[core[0]], atol=1e-9)
    assert len(parts) > 1 and (covered == 1).all()
    found = terrain.extract_terrain(scene, config)
    measured = whole.source == terrain.MEASURED
    assert np.percentile(np.abs(found.bed - whole.bed)[measured], 99) < 2e-4
    assert (found.ground_class != whole.ground_class).mean() < 0.005


def test_memory_grows_only_with_what_is_kept(monkeypatch):
    monkeypatch.setattr(extract, "PIECE", 16_000)
    monkeypatch.setattr(extract, "MARGIN", 0.3)
    monkeypatch.setattr(tops, "SMALLEST", 1e9)  # their patches grow with the tops, not the map
    scene, truth = captures.yard(0, floaters=0.0, step=0.15)
    scene, peaks = replace(scene, ground_frame=truth.frame), []
    terrain.extract_terrain(scene, TerrainConfig(spacing=0.06, extent=3.0))  # compiles
    for spacing in (0.04, 0.02):
        tracemalloc.start()
        cells = terrain.extract_terrain(scene, TerrainConfig(spacing=spacing, extent=3.0)).bed.size
        peaks.append((cells, tracemalloc.get_traced_memory()[1]))
        tracemalloc.stop()
    (few, low), (many, high) = peaks
    assert (
        20 < (high - low) / (many - few) < 60
    )  # bytes per cell; it was 160 before there were parts


def test_fall_turns_the_frame_about_its_origin():
    frame = GroundFrame(np.eye(3), 2.0, np.array([0.0, 0.0, 0.0]))
    tilted = with_fall(frame, 0.02, np.pi / 2)
    low, high = tilted.to_ground([[0, 5, 0], [0, -5, 0]])[:, 2]
    assert low == pytest.approx(-0.2, rel=1e-3) and high == pytest.approx(0.2, rel=1e-3)
    assert tilted.to_ground([5.0, 0, 0])[2] == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(tilted.rotation @ tilted.rotation.T, np.eye(3), atol=1e-12)
    assert "2 %" in tilted.notes[-1]
    with pytest.raises(ParameterError, match="30%"):
        with_fall(frame, 0.5, 0.0)


def test_scale_from_a_known_length():
    assert scale_from_length((0, 0, 0), (3, 4, 0), 2.5) == pytest.approx(0.5)
    with pytest.raises(ParameterError, match="same point"):
        scale_from_length((1, 1, 1), (1, 1, 1), 2.5)
