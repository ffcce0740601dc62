"""Water that a capture itself shows: told by its mirror image, never where there is none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rainsim import terrain
from rainsim.bench import ponds
from rainsim.bench.ground import measure_water
from rainsim.config import TerrainConfig
from rainsim.puddles import puddles_of
from rainsim.terrain import pond
from rainsim.terrain.table import HARD, WATER

CONFIG = TerrainConfig(spacing=0.04, extent=2.2)
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"


def few_views(scene, truth):
    return replace(scene, cameras=scene.cameras[::3]), truth


@pytest.fixture(scope="module")
def capture():
    return few_views(*ponds.pond(1, ponds.VIRTUAL, step=0.05))


@pytest.fixture(scope="module")
def ground(capture):
    return terrain.extract_terrain(capture[0], CONFIG)


def test_mirror_images_below_the_ground_are_water_and_a_pit_is_none(capture, ground):
    scene, truth = capture
    wet = truth.wet(*np.meshgrid(*ground.grid.centres()))
    found = ground.ground_class == WATER
    assert (wet & found).sum() > 0.8 * (wet | found).sum()
    level = (ground.bed + ground.water)[found]
    assert np.ptp(level) < 1e-5 and abs(level[0] - truth.level) < 0.03
    assert ground.water.max() == np.float32(pond.DEPTH) and not ground.water[~found].any()
    told = " ".join(ground.notes)
    assert "mirror image" in told and "ASSUMED 0.3 m" in told
    pit = terrain.extract_terrain(few_views(*ponds.pond(1, ponds.PIT, step=0.05))[0], CONFIG)
    assert not (pit.ground_class == WATER).any() and not pit.water.any()
    assert "mirror nothing" in " ".join(pit.notes)
    blind = terrain.extract_terrain(replace(scene, cameras=()), CONFIG)
    assert not blind.water.any() and "--class-mask" in " ".join(blind.notes)


def test_a_surface_that_changes_with_the_view_is_water():
    found = measure_water(*ponds.pond(2, ponds.GLOSSY, step=0.04), spacing=0.04)
    assert found["missed"] == 0 and found["false_water"] == 0
    assert found["outline"] > 0.8 and found["level_mm"] < 20


def test_a_mask_overrides_both_ways(capture, ground):
    scene, _ = capture
    mask = np.full(ground.grid.shape, -1)
    mask[ground.ground_class == WATER] = HARD
    mask[5:20, 5:20] = WATER
    painted = terrain.extract_terrain(scene, CONFIG, mask)
    np.testing.assert_array_equal(painted.water > 0, mask == WATER)
    level = (painted.bed + painted.water)[5:20, 5:20]
    rim = painted.bed[3:22, 3:22][mask[3:22, 3:22] != WATER]
    assert np.ptp(level) < 1e-6 and rim.min() <= level.min() <= np.median(rim)


def test_it_starts_full_and_runs_over(ground):
    puddles = puddles_of(ground)
    before = puddles.volume
    assert before == pytest.approx(float(ground.water.sum()) * ground.grid.cell_area, rel=1e-6)
    np.testing.assert_allclose(puddles.depth, ground.water, atol=1e-6)
    puddles.rain(0.2)
    level = (ground.bed + puddles.depth)[ground.ground_class == WATER]
    assert np.ptp(level) < 1e-6  # it rose to its lowest rim and no higher
    assert before < puddles.volume < before + puddles.volumes["rain"] / 2
    assert puddles.residual < 1e-9


def test_the_captured_image_is_taken_out(capture, ground):
    scene, _ = capture
    cleaned = pond.without_images(scene, ground)
    before, after = (scene.ground_frame.to_ground(s.splats.position) for s in (scene, cleaned))
    below, left = (
        (np.abs(at[:, :2]).max(axis=1) < 3) & (at[:, 2] < -0.4) for at in (before, after)
    )
    assert below.sum() > 500 and left.sum() == 0
    assert (before[:, 2] > 0.05).sum() == (after[:, 2] > 0.05).sum()
    dry = replace(ground, water=None)
    assert not dry.water.any() and pond.without_images(scene, dry) is scene


def test_it_is_kept_on_disk_and_old_files_are_read(ground, tmp_path):
    terrain.write_terrain(tmp_path / "map", ground)
    np.testing.assert_array_equal(terrain.read_terrain(tmp_path / "map").water, ground.water)
    with np.load(tmp_path / "map" / "terrain.npz") as data:
        old = {name: data[name] for name in data.files if name != "water"}
    np.savez(tmp_path / "old.npz", **old)
    assert not terrain.read_terrain(tmp_path / "old.npz").water.any()


@pytest.mark.slow
@pytest.mark.parametrize("kind", [ponds.VIRTUAL, ponds.GLOSSY, ponds.MIXED, ponds.PIT])
def test_ponds_of_many_kinds(kind):
    rows = [measure_water(*ponds.pond(seed, kind)) for seed in range(10, 18)]
    assert max(row["false_water"] for row in rows) == 0
    if kind != ponds.PIT:
        assert max(row["missed"] for row in rows) == 0
        assert min(row["outline"] for row in rows) > 0.85
        assert max(row["level_mm"] for row in rows) < 30


@pytest.mark.slow
@pytest.mark.parametrize("name", ["garden", "truck.splat", "flowers_sog", "bicycle", "street"])
def test_no_water_in_captures_that_have_none(name, tmp_path):
    from rainsim.scene.library import load_scene

    given = {"truck.splat": 5.5, "flowers_sog": 4.0}
    hints = {"up": (0, -1, 0), "meters_per_unit": given[name]} if name in given else {}
    path = name if name in ("bicycle", "street") else SHARED / name
    if name == "garden":
        unpack = SHARED / "unpack.py"
        if not unpack.is_file():
            pytest.skip("the garden is not here")
        import subprocess
        import sys

        path = tmp_path / "garden"
        subprocess.run([sys.executable, str(unpack), str(path)], check=True)
    elif name in given and not path.exists():
        pytest.skip(f"{name} is not here")
    ground = terrain.extract_terrain(load_scene(str(path), **hints), TerrainConfig())
    assert not (ground.ground_class == WATER).any()
