"""A road with hollows, a drive along it, and legs of some metres."""

import math

import numpy as np
import pytest

from rainsim import pipeline
from rainsim.config.settings import Config, mm_per_hour
from rainsim.scene.cameras import look_at
from rainsim.scene.types import GroundFrame, Scene, Splats
from rainsim.terrain import path_ground

LENGTH, WIDE, GAP, SPACING = 24.0, 2.0, 0.08, 0.05  # m
DIPS, DEEP, ROUND = 3.0, 0.02, 0.5  # m between hollows of the road, their depth and radius
CONFIG = Config.from_preset("moderate").replace(
    past=4e-3, rate=mm_per_hour(30.0), frames=16, fps=10.0, width=64, spacing=SPACING,
    ground_map="path", wind=(0.0, 0.0),
)  # fmt: skip


def camera(x, y=0.0, heading=0.0):
    ahead = x + 3 * math.cos(heading), y + 3 * math.sin(heading), 0.0
    return look_at((x, y, 1.0), ahead, (0, 0, 1), 60, 64, 48, f"{x:g}")


def road(cameras, seed=3):
    """A road along x with a hollow every DIPS metres and a low kerb on either side."""
    x, y = np.meshgrid(np.arange(0, LENGTH, GAP), np.arange(-WIDE, WIDE, GAP))
    away = np.minimum(x % DIPS, DIPS - x % DIPS) ** 2 + y**2
    z = -DEEP * np.exp(-away / (ROUND / 2) ** 2 / 2) + 0.1 * (np.abs(y) > WIDE - 0.2)
    places = np.stack([x, y, z], -1).reshape(-1, 3)
    n = len(places)
    sh = np.zeros((n, 1, 3), np.float32)
    sh[:, 0] = 0.2 * np.random.default_rng(seed).normal(size=(n, 1))
    size = np.tile(np.float32([0.7 * GAP, 0.7 * GAP, 1e-3]), (n, 1))
    turn = np.tile(np.float32([1, 0, 0, 0]), (n, 1))
    splats = Splats(places.astype(np.float32), turn, size, np.full(n, 0.97, np.float32), sh)
    return Scene("road", splats, tuple(cameras), GroundFrame(np.eye(3), 1.0, np.zeros(3)), None,
                 "0" * 64)  # fmt: skip


@pytest.fixture(autouse=True, scope="module")
def small():
    """Legs of some metres instead of tens."""
    with pytest.MonkeyPatch.context() as patch:
        small = {
            "BEHIND": 0.5, "AHEAD": 2.5, "ASIDE": 1.0, "STEP": 0.5, "LEG_CELLS": 5000,
            "PIECE": 15000, "GROWN": 2.0, "OVERLAP": 0.3,
        }  # fmt: skip
        for name, value in small.items():
            patch.setattr(path_ground, name, value)
        patch.setenv("RAINSIM_CACHE", "off")  # no name of an entry tells of these
        yield


DRIVE = [camera(2.0 + 0.6 * n) for n in range(CONFIG.frames)]


@pytest.fixture(scope="module")
def scene():
    return road(DRIVE)


@pytest.fixture(scope="module")
def ground(scene):
    return pipeline.ground_of(scene, CONFIG, DRIVE)


def frames(scene, ground, indices, cameras=DRIVE, config=CONFIG):
    """Bytes of frames by a new sequence, by their indices."""
    sequence = pipeline.FrameSequence(scene, ground, cameras, config)
    return {report.index: picture.tobytes() for picture, report in sequence.frames(indices)}


@pytest.fixture(scope="module")
def drive(scene, ground):
    """All frames of the drive in one go."""
    return frames(scene, ground, range(CONFIG.frames))
