"""Cameras under water and underground are told; those above are not."""

from dataclasses import replace

import numpy as np
import pytest

import made_files as made
from rainsim.config.settings import Config
from rainsim.render.sunken import sunken_notes
from rainsim.scene.cameras import look_at


def eye(x, y, z, name="view"):
    return look_at((x, y, z), (x + 1, y, z - 0.2), (0, 0, 1), 60, 64, 48, name)


@pytest.fixture
def ground():
    return made.small_terrain()


def test_a_camera_above_everything_is_no_matter(ground):
    for config in (Config(), Config().replace(level=0.5)):
        assert sunken_notes([eye(0, 0, 1.5)], ground, config) == []
    assert sunken_notes([eye(50, 0, -3)], ground, Config()) == []  # beyond the map nobody knows


def test_a_flood_drowns_a_camera(ground):
    (note,) = sunken_notes([eye(0, 0, 1.5)], ground, Config().replace(level=5.0))
    assert "camera view is up to 3.50 m under water" in note and "--water-level" in note
    (note,) = sunken_notes([eye(50, 0, 1.5)], ground, Config().replace(level=5.0))
    assert "under water" in note


def test_painted_water_and_ground(ground):
    pond = replace(ground, water=np.full(made.SHAPE, 0.3, np.float32))
    (note,) = sunken_notes([eye(0, 0, 0.1)], pond, Config())
    assert "0.20 m under water" in note
    (note,) = sunken_notes([eye(0, 0, -0.4)], ground, Config())
    assert "0.40 m below the ground" in note and "--up" in note


def test_a_rising_flood_reaches_the_later_frames_of_a_path(ground):
    rising = Config().replace(frames=24, level=0.0)
    keyframes = ((0.0, (("level", 0.0),)), (1.0, (("level", 2.0),)))
    rising = replace(rising, keyframes=keyframes)
    path = [eye(0, 0, 1.01, f"{i:02d}") for i in range(24)]
    (note,) = sunken_notes(path, ground, rising)
    assert "the camera of 11 frames" in note and "0.91 m under water" in note
    part = replace(rising, frame_range=(0, 12))
    assert sunken_notes(path, ground, part) == []
