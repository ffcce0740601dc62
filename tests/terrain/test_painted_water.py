"""Water painted into the class mask: a level body that starts full, without the captured image."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import captures
from rainsim import terrain
from rainsim.config.settings import TerrainConfig
from rainsim.scene.types import Splats
from rainsim.terrain import pond
from rainsim.terrain.table import HARD, WATER
from rainsim.water.puddles import puddles_of

CONFIG = TerrainConfig(spacing=0.04, extent=2.2)
PAINTED = (slice(20, 50), slice(30, 60))  # cells of paving
UNPAINTED = (slice(70, 80), slice(20, 30))
IMAGES = 800  # splats of a mirror image below the painted water


def with_mirror_images(scene):
    """The capture with splats 0.5 to 0.9 m below the ground, as still water leaves them."""
    rng = np.random.default_rng(5)
    splats, frame = scene.splats, scene.ground_frame
    below = rng.uniform((-0.9, -1.3, -0.9), (0.1, -0.3, -0.5), (IMAGES, 3))
    image = replace(
        splats.take(np.arange(IMAGES)), position=frame.to_capture(below).astype(np.float32)
    )
    names = ("position", "rotation", "scale", "opacity", "sh")
    pairs = (np.concatenate([getattr(s, name) for s in (splats, image)]) for name in names)
    return replace(scene, splats=Splats(*pairs))


@pytest.fixture(scope="module")
def capture():
    scene, truth = captures.yard(1, step=0.05)
    return with_mirror_images(replace(scene, ground_frame=truth.frame))


@pytest.fixture(scope="module")
def mask():
    classes = np.full((110, 110), -1)
    classes[PAINTED] = WATER
    return classes


@pytest.fixture(scope="module")
def ground(capture, mask):
    return terrain.extract_terrain(capture, CONFIG, mask)


def test_painted_water_is_level_with_its_low_rim_over_an_assumed_bed(ground, mask):
    np.testing.assert_array_equal(ground.water > 0, mask == WATER)
    np.testing.assert_array_equal(ground.ground_class == WATER, mask == WATER)
    level = (ground.bed + ground.water)[PAINTED]
    around = np.zeros(mask.shape, bool)
    around[18:52, 28:62] = True
    rim = ground.bed[around & (mask != WATER)]
    assert np.ptp(level) < 1e-6 and rim.min() <= level.min() <= np.median(rim)
    assert ground.water.max() == np.float32(pond.DEPTH)
    assert (ground.source[PAINTED] == terrain.INFERRED).all()
    assert "ASSUMED 0.3 m" in " ".join(ground.notes)


def test_nothing_is_water_that_nobody_painted(capture, mask):
    dry = terrain.extract_terrain(capture, CONFIG)
    assert not dry.water.any() and not (dry.ground_class == WATER).any()
    paved = terrain.extract_terrain(capture, CONFIG, np.where(mask == WATER, HARD, -1))
    assert not paved.water.any() and (paved.ground_class[PAINTED] == HARD).all()


def test_two_ponds_have_levels_of_their_own(capture, mask):
    two = mask.copy()
    two[UNPAINTED] = WATER
    found = terrain.extract_terrain(capture, CONFIG, two)
    levels = [np.unique((found.bed + found.water)[part].round(6)) for part in (PAINTED, UNPAINTED)]
    assert all(len(level) == 1 for level in levels) and levels[0][0] != levels[1][0]
    assert "2 bodies" in " ".join(found.notes)


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


def test_the_captured_image_is_removed(capture, ground):
    cleaned = pond.without_images(capture, ground)
    before, after = (
        capture.ground_frame.to_ground(s.splats.position).copy() for s in (capture, cleaned)
    )
    below, left = (
        (np.abs(at[:, :2]).max(axis=1) < 2) & (at[:, 2] < -0.4) for at in (before, after)
    )
    assert below.sum() >= IMAGES and left.sum() == 0
    assert (before[:, 2] > 0.05).sum() == (after[:, 2] > 0.05).sum()
    dry = replace(ground, water=None)
    assert not dry.water.any() and pond.without_images(capture, dry) is capture


def test_it_is_kept_on_disk_and_old_files_are_read(ground, tmp_path):
    terrain.write_terrain(tmp_path / "map", ground)
    np.testing.assert_array_equal(terrain.read_terrain(tmp_path / "map").water, ground.water)
    with np.load(tmp_path / "map" / "terrain.npz") as data:
        old = {name: data[name] for name in data.files if name != "water"}
    np.savez(tmp_path / "old.npz", **old)
    assert not terrain.read_terrain(tmp_path / "old.npz").water.any()
