"""Frames that show other times of the rain than their own, on a real GPU: `pytest -m gpu`."""

import dataclasses

import numpy as np
import pytest

from naive import decibel
from rainsim.config.settings import Config
from rainsim.pipeline import FrameSequence, extract_terrain
from scenes import tiny_scene

pytestmark = pytest.mark.gpu
MOMENTS = 0, 0, 0, 1, 1, 2, 7, 7, 8, 12  # slow motion, then gaps
CONFIG = Config.from_preset("downpour").replace(
    past=6e-3, extent=1.0, spacing=0.025, width=320, scheme="lean", frames=len(MOMENTS)
)


def test_frames_at_other_times_are_those_of_the_cpu_and_those_drawn_alone():
    scene = tiny_scene()
    cameras = [camera.resized(320, 240) for camera in scene.cameras] * len(MOMENTS)
    cameras = cameras[: len(MOMENTS)]
    settings = dataclasses.replace(CONFIG, moments=MOMENTS)
    terrain = extract_terrain(scene, settings)

    def frames(backend, indices):
        sequence = FrameSequence(scene, terrain, cameras, settings, backend)
        return [(picture.copy(), report) for picture, report in sequence.frames(indices)]

    found = frames("cuda", range(len(MOMENTS)))
    for (picture, report), (wanted, theirs) in zip(
        found, frames("cpu", range(len(MOMENTS))), strict=True
    ):
        assert (report.index, report.time) == (theirs.index, theirs.time)
        for name in ("initial", "rain", "ground"):
            assert report.ledger[name] == pytest.approx(theirs.ledger[name], rel=1e-4), name
        assert decibel(picture, wanted) > 45, report.index
    for index in (2, 6, 9):
        ((alone, report),) = frames("cuda", [index])
        np.testing.assert_array_equal(alone, found[index][0])
        assert report.ledger == found[index][1].ledger
    for pair in ((0, 1), (3, 4)):  # of one state and different cameras, or of one picture
        same = cameras[pair[0]] is cameras[pair[1]]
        assert (found[pair[0]][0] == found[pair[1]][0]).all() == same
