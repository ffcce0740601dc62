"""Frames of scenes with actors in numba's CUDA simulator, against the CPU's."""

import dataclasses
import functools

import numpy as np
import pytest

from naive import decibel
from rainsim import simulation
from rainsim.actors.footprint import with_footprints
from rainsim.config.settings import Config
from rainsim.cuda import simulated
from rainsim.cuda.rain.moving_surfaces import MovingHeights
from rainsim.cuda.render import renderer as twin
from rainsim.cuda.splatting.prepared import DeviceSplats
from rainsim.pipeline import FrameSequence, extract_terrain, simulate
from rainsim.rain.moving_surfaces import MovingSurfaces
from rainsim.render import renderer as rendering
from rainsim.render.wet_scene import WetScene
from scenes import moving_scene, rolling_scene

assert simulated()
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
SIZE = (32, 24)
LAYERS = ("actor_id", "flow", "flow_mask", "depth")
FRAMES = 0, 2
CONFIG = Config.from_preset("downpour").replace(
    rate=8 / 3.6e6, past=6e-3, frames=3, width=SIZE[0], extent=1.0, spacing=0.1, fps=4.0,
    wind=(0.0, 0.0), drips=False,
)  # fmt: skip


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """The day's sky as surroundings: six pictures are much for the simulator."""
    monkeypatch.setattr(WetScene, "_surroundings", lambda self, position: self.sky.day)


@pytest.fixture(scope="module")
def scene():
    return moving_scene()


@pytest.fixture(scope="module")
def terrain(scene):
    return with_footprints(extract_terrain(scene, CONFIG), scene)


def test_the_map_follows_what_moves_over_it(terrain):
    moving, (footprint,) = MovingSurfaces(terrain), terrain.footprints
    heights = MovingHeights(moving.still, terrain.footprints)
    # The box is 0.28 m high, on cells of 0.1 m, and may turn any way.
    assert 0.28 < footprint.highest < 1.0 and heights.fields.sky >= moving.still.sky
    shown = []
    for time in (0.0, 0.4, 9.0):
        surfaces = moving.at(time)
        heights.send(surfaces)
        for name in ("top", "underside", "patch_high", "around_high", "around_low"):
            found = getattr(heights.fields, name).copy_to_host()
            np.testing.assert_array_equal(found, getattr(surfaces.height_fields(), name))
        assert heights.fields.sky >= surfaces.sky
        shown.append(heights.fields.top.copy_to_host())
    assert (shown[0] != shown[1]).any() and (shown[1] != shown[2]).any()
    heights.send(moving.still)
    np.testing.assert_array_equal(heights.fields.top.copy_to_host(), terrain.top)


def test_frames_and_labels_are_those_of_the_cpu(scene, terrain, monkeypatch):
    """Each frame; the static set is sent once, and moments in any order."""
    camera = scene.cameras[0].resized(*SIZE)
    states = [s for s, _ in zip(simulate(terrain, CONFIG), range(FRAMES[-1] + 1), strict=False)]
    states = [states[n] for n in FRAMES]
    cpu = rendering.Renderer(scene, terrain, CONFIG, camera)
    wanted = [cpu.draw(camera, state, None, LAYERS) for state in states]
    assert (wanted[0][0] != wanted[1][0]).any(axis=-1).mean() > 0.05
    gpu, sent = twin.Renderer(scene, terrain, CONFIG, camera), []
    gpu.draw(camera, states[1])  # which sends the static sets
    send = DeviceSplats._send_harmonics
    monkeypatch.setattr(
        DeviceSplats, "_send_harmonics",
        lambda self, *args: (sent.append(args), send(self, *args)),
    )  # fmt: skip
    pictures = []
    for (picture, report), state in zip(wanted, states, strict=True):
        found, labels = gpu.draw(camera, state, None, LAYERS)
        assert decibel(found, picture) > 45
        for name in ("actor_id", "flow_mask"):
            assert (labels.aovs[name] == report.aovs[name]).mean() > 0.99
        same = np.abs(labels.aovs["flow"] - report.aovs["flow"]).max(axis=-1) < 0.1
        assert same.mean() > 0.99 and np.abs(report.aovs["flow"]).max() > 0.5
        assert (report.aovs["actor_id"] == 1).sum() > 10
        (mine,), (theirs,) = labels.facts["actors"], report.facts["actors"]
        assert mine["box2d"] == theirs["box2d"] and mine["box3d"] == theirs["box3d"]
        pictures.append(found.copy())
    assert not sent  # the actors were, once, and are posed on the device
    again = gpu.draw(dataclasses.replace(camera), states[0])[0]
    np.testing.assert_array_equal(again, pictures[0])


def test_frames_with_the_water_on_the_device_are_those_of_the_cpu(monkeypatch):
    """A box on wheels: its shelter, and tracks and spray over the device's own water."""
    small = functools.partial(simulation.RippleTile, cells=16, size=0.5)
    monkeypatch.setattr(simulation, "RippleTile", small)
    own = rolling_scene()
    settings = CONFIG.replace(scheme="lean", fps=12.0, past=8e-3, reflections="ssr")
    ground, pictures = extract_terrain(own, settings), {}
    for backend in ("cpu", "cuda"):
        sequence = FrameSequence(own, ground, [own.cameras[0].resized(*SIZE)], settings, backend)
        pictures[backend] = [picture.copy() for picture, _ in sequence.frames(range(3))]
    for found, wanted in zip(pictures["cuda"], pictures["cpu"], strict=True):
        assert decibel(found, wanted) > 40
    assert (pictures["cpu"][0] != pictures["cpu"][2]).any()
    state = sequence._state
    assert state.simulation.drip_list is None
