"""Golden frames: both built-in scenes, every preset, against pictures kept here."""

from dataclasses import replace

import imageio.v3 as imageio
import numpy as np
import pytest

from rainsim.config.preset_files import preset_names
from rainsim.config.settings import Config
from regenerate import (
    CASES,
    FOLDER,
    HEIGHT,
    LEAST_DECIBEL,
    MOST_CHANGED,
    WIDTH,
    compared,
    golden_frames,
    path_of,
    read,
)


@pytest.fixture(scope="module")
def scenes(bicycle_scene, street_scene):
    return {"bicycle": bicycle_scene, "street": street_scene}


@pytest.mark.parametrize("name", CASES)
def test_frames_are_as_they_were(scenes, name, tmp_path):
    found, wanted = golden_frames(scenes[CASES[name][0]], name), read(name)
    psnr, changed, (row, column) = compared(found, wanted)
    if psnr < LEAST_DECIBEL or changed > MOST_CHANGED:
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
    brightness = Config.from_preset(CASES[name][2]).render.brightness
    wanted = read(name)
    found = golden_frames(scenes["bicycle"], name, brightness=1.03 * brightness)
    psnr, changed, _ = compared(found, wanted)
    assert psnr < LEAST_DECIBEL and changed > MOST_CHANGED
    assert compared(wanted, wanted)[:2] == (np.inf, 0)


def test_frames_are_not_decided_by_rounding(scenes):
    """Turns of splats that differ in their last bit, as between processors, draw the same."""
    name, scene = "bicycle_drizzle", scenes["bicycle"]
    turns, rng = scene.splats.rotation, np.random.default_rng(1)
    way = np.where(rng.random(turns.shape) < 0.5, -np.inf, np.inf).astype(np.float32)
    other = replace(scene, splats=replace(scene.splats, rotation=np.nextafter(turns, way)))
    assert (other.splats.rotation != turns).all()
    psnr, changed, _ = compared(golden_frames(other, name), golden_frames(scene, name))
    assert psnr > LEAST_DECIBEL and changed < MOST_CHANGED


def test_every_preset_and_both_scenes_are_kept():
    assert {case[2] for case in CASES.values()} == set(preset_names())
    assert {case[0] for case in CASES.values()} == {"bicycle", "street"}
    assert {path.stem for path in FOLDER.glob("*.png")} == set(CASES)
    assert all(read(name).shape == (2 * HEIGHT, WIDTH, 3) for name in CASES)
    assert sum(path_of(name).stat().st_size for name in CASES) < 300_000
