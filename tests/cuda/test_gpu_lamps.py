"""Lamps on wet ground at dusk, on a real GPU: `pytest -m gpu`."""

import dataclasses
import itertools

import numpy as np
import pytest

from naive import decibel
from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.render.renderer import Renderer as OnCpu
from rainsim.scene.cameras import resize_to
from rainsim.scene.library import load_scene
from rainsim.shading import wet_ground_mirror
from scenes import lamp_scene

pytestmark = pytest.mark.gpu
DUSK = Config.from_preset("dusk").replace(film="mirror", width=320)


@pytest.fixture(scope="module")
def on_gpu():
    from rainsim.cuda.render.renderer import Renderer

    return Renderer


def test_a_lamp_over_wet_ground_is_mirrored_as_on_the_cpu(on_gpu, monkeypatch):
    _, scene = lamp_scene()
    settings = DUSK.replace(rate=0.0, past=2e-3, frames=1, extent=1.0, spacing=0.025)
    terrain = pipeline.extract_terrain(scene, settings)
    state = next(iter(pipeline.simulate(terrain, settings)))
    cameras = [camera.resized(320, 240) for camera in scene.cameras]
    cpu, gpu = (make(scene, terrain, settings, cameras[0]) for make in (OnCpu, on_gpu))
    pictures = []
    for camera in (*cameras, cameras[0]):
        wanted, found = cpu.draw(camera, state)[0], gpu.draw(camera, state)[0]
        assert decibel(found, wanted) > 55
        pictures.append(found.copy())
    np.testing.assert_array_equal(pictures[3], pictures[0])
    # The last picture is the first camera's, which sees the lamp.
    assert len(gpu.passes._film._level.lamps) > 0
    film = [picture.copy() for picture, _ in gpu.film([(c, state, None) for c in cameras])]
    np.testing.assert_array_equal(film, pictures[:3])
    monkeypatch.setattr(wet_ground_mirror, "lamps_seen", lambda upright, draw: (draw(upright), ()))
    plain = OnCpu(scene, terrain, settings, cameras[0])
    looked_up = [plain.draw(camera, state)[0].copy() for camera in cameras]
    assert min(map(decibel, looked_up, pictures[:3])) < 50  # the lamp's image is not the look-up's


@pytest.mark.parametrize("name", ["street", "traffic"])
def test_streets_at_dusk_are_those_of_the_cpu(on_gpu, name, capsys):
    scene = load_scene(name)
    settings = DUSK.replace(frames=3, scheme="lean")
    cameras = [resize_to(camera, 320) for camera in scene.cameras]
    terrain = pipeline.extract_terrain(scene, settings)
    states = list(itertools.islice(pipeline.simulate(terrain, settings), settings.frames))
    cpu, gpu = (make(scene, terrain, settings, cameras[0]) for make in (OnCpu, on_gpu))
    for camera, state in zip(cameras, states, strict=False):
        wanted, found = cpu.draw(camera, state)[0], gpu.draw(dataclasses.replace(camera), state)[0]
        with capsys.disabled():
            print(f"\n{name} at dusk: {decibel(found, wanted):.1f} dB")
        assert decibel(found, wanted) > 45
    assert len(gpu.passes._film._level.lamps) > 0
