"""Shutter samples, rolling rows and glass on a real GPU, beside the CPU's: `pytest -m gpu`."""

import numpy as np
import pytest

from naive import decibel
from rainsim.config.settings import Config
from rainsim.pipeline import FrameSequence, extract_terrain
from rainsim.sensors.glass import Pane
from rainsim.sensors.optics import Optics
from scenes import moving_scene, tiny_scene, walk

pytestmark = pytest.mark.gpu
CONFIG = Config.from_preset("downpour").replace(
    past=6e-3, extent=1.0, spacing=0.025, scheme="lean", frames=2, fps=24.0, exposure=1 / 48
)
OPTICS = {
    "samples": Optics(samples=3), "rolling": Optics(readout=0.015),
    "glass": Optics(pane=Pane(age=20.0, speed=10.0)),
}  # fmt: skip


def frames(scene, optics, backend):
    """Return the frames of a walk through a scene: pictures and reports."""
    cameras = walk(scene)
    sequence = FrameSequence(
        scene, extract_terrain(scene, CONFIG), cameras, CONFIG, backend, optics=optics
    )
    return [(picture.copy(), report) for picture, report in sequence.frames(range(2))]


@pytest.mark.parametrize(
    ("which", "make"),
    [("samples", tiny_scene), ("rolling", tiny_scene), ("glass", tiny_scene),
     ("samples", moving_scene)],
)  # fmt: skip
def test_a_gpu_draws_what_the_cpu_draws(which, make):
    scene, optics = make(width=160, height=120), OPTICS[which]
    found, wanted, plain = (
        frames(scene, optics, "cuda"), frames(scene, optics, "cpu"), frames(scene, None, "cuda")
    )  # fmt: skip
    apart = [decibel(a, b) for (a, _), (b, _) in zip(found, wanted, strict=True)]
    assert min(apart) > 60, apart
    for (picture, report), (sharp, _), (_, theirs) in zip(found, plain, wanted, strict=True):
        assert decibel(picture, sharp) < 45
        assert report.facts.get("drops_on_glass") == theirs.facts.get("drops_on_glass")
    for (picture, _), (again, _) in zip(found, frames(scene, optics, "cuda"), strict=True):
        np.testing.assert_array_equal(again, picture)
