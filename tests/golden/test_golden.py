"""Golden frames: both built-in scenes, every preset, against pictures kept here."""

from dataclasses import replace

import imageio.v3 as imageio
import numpy as np
import pytest

import regenerate
from rainsim.config.preset_files import preset_names
from rainsim.config.settings import Config


@pytest.fixture(scope="module")
def scenes(bicycle_scene, street_scene):
    return {"bicycle": bicycle_scene, "street": street_scene}


@pytest.mark.parametrize("name", regenerate.CASES)
def test_frames_are_as_they_were(scenes, name, tmp_path):
    found, wanted = (
        regenerate.golden_frames(scenes[regenerate.CASES[name][0]], name),
        regenerate.read(name),
    )
    psnr, changed, (row, column) = regenerate.compared(found, wanted)
    if psnr < regenerate.LEAST_DECIBEL or changed > regenerate.MOST_CHANGED:
        picture = tmp_path / f"{name}.png"
        imageio.imwrite(picture, np.concatenate([wanted, found], axis=1))
        raise AssertionError(
            f"{psnr:.1f} dB, {changed:.2%} of the pixels changed, most at row {row}, column "
            f"{column}; before and after stand side by side in {picture}; if the change is meant, "
            f"run `python tests/golden/regenerate.py {name}`"
        )


def test_a_small_change_is_found(scenes):
    """Three hundredths more light than the preset's is outside the tolerance."""
    name = "bicycle_drizzle"
    brightness = Config.from_preset(regenerate.CASES[name][2]).render.brightness
    wanted = regenerate.read(name)
    found = regenerate.golden_frames(scenes["bicycle"], name, brightness=1.03 * brightness)
    psnr, changed, _ = regenerate.compared(found, wanted)
    assert psnr < regenerate.LEAST_DECIBEL and changed > regenerate.MOST_CHANGED
    assert regenerate.compared(wanted, wanted)[:2] == (np.inf, 0)


def test_frames_are_not_decided_by_rounding(scenes):
    """Turns of splats that differ in their last bit, as between processors, draw the same."""
    name, scene = "bicycle_drizzle", scenes["bicycle"]
    turns, rng = scene.splats.rotation, np.random.default_rng(1)
    way = np.where(rng.random(turns.shape) < 0.5, -np.inf, np.inf).astype(np.float32)
    other = replace(scene, splats=replace(scene.splats, rotation=np.nextafter(turns, way)))
    assert (other.splats.rotation != turns).all()
    psnr, changed, _ = regenerate.compared(
        regenerate.golden_frames(other, name), regenerate.golden_frames(scene, name)
    )
    assert psnr > regenerate.LEAST_DECIBEL and changed < regenerate.MOST_CHANGED


def test_every_preset_and_both_scenes_are_kept():
    assert {case[2] for case in regenerate.CASES.values()} == set(preset_names())
    assert {case[0] for case in regenerate.CASES.values()} == {"bicycle", "street"}
    assert {path.stem for path in regenerate.FOLDER.glob("*.png")} == set(regenerate.CASES)
    assert all(
        regenerate.read(name).shape == (2 * regenerate.HEIGHT, regenerate.WIDTH, 3)
        for name in regenerate.CASES
    )
    assert sum(regenerate.path_of(name).stat().st_size for name in regenerate.CASES) < 300_000
