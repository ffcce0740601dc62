"""Scenes with actors on a real GPU: `pytest -m gpu tests/cuda/test_gpu_actors.py`."""

import dataclasses
import itertools

import numpy as np
import pytest

from benchmarks.traced import trace_reflections
from naive import decibel
from rainsim import pipeline
from rainsim.actors.footprint import with_footprints
from rainsim.config.settings import Config
from rainsim.render.renderer import Renderer as OnCpu
from rainsim.scene.cameras import resize_to
from rainsim.scene.library import load_scene
from scenes import moving_scene

pytestmark = pytest.mark.gpu
CONFIG = Config.from_preset("downpour").replace(past=6e-3, extent=1.0, spacing=0.025, width=320)
BEHIND = 12  # frame at whose time, 0.5 s, the box stands behind the puddle
LABELS = ("actor_id", "flow", "flow_mask", "depth", "class_id")
STREET = Config.from_preset("downpour").replace(width=320, frames=6)


@pytest.fixture(scope="module")
def on_gpu():
    from rainsim.cuda.render.renderer import Renderer

    return Renderer


@pytest.fixture(scope="module")
def scene():
    return moving_scene()


@pytest.fixture(scope="module")
def terrain(scene):
    return with_footprints(pipeline.extract_terrain(scene, CONFIG), scene)


@pytest.fixture(scope="module")
def states(terrain):
    """The water up to the frame BEHIND."""
    return list(itertools.islice(pipeline.simulate(terrain, CONFIG), BEHIND + 1))


@pytest.fixture(scope="module")
def camera(scene):
    return scene.cameras[0].resized(320, 240)


def test_frames_of_a_moving_box_are_those_of_the_cpu(on_gpu, scene, terrain, states, camera):
    cpu, gpu = (make(scene, terrain, CONFIG, camera) for make in (OnCpu, on_gpu))
    first = None
    for index in (0, BEHIND // 2, BEHIND):
        wanted, report = cpu.draw(camera, states[index], None, LABELS)
        found, labels = gpu.draw(camera, states[index], None, LABELS)
        first = found.copy() if first is None else first
        assert decibel(found, wanted) > 45
        mine, theirs = labels.aovs, report.aovs
        assert (mine["actor_id"] == theirs["actor_id"]).mean() > 0.999
        assert (theirs["actor_id"] == 1).sum() > 1000
        assert (mine["class_id"] == theirs["class_id"]).mean() > 0.995
        seen = (mine["flow_mask"] == 1) & (theirs["flow_mask"] == 1) & (theirs["actor_id"] == 1)
        error = np.linalg.norm(mine["flow"] - theirs["flow"], axis=-1)
        assert seen.sum() > 1000 and np.percentile(error[seen], 99) < 0.5
        assert np.linalg.norm(theirs["flow"], axis=-1)[seen].min() > 1
        (a,), (b,) = labels.facts["actors"], report.facts["actors"]
        np.testing.assert_allclose(a["box2d_seen"], b["box2d_seen"], atol=1.0)
        assert a["box2d"] == b["box2d"] and a["box3d"] == b["box3d"]
    assert decibel(first, found) < 30  # it has moved
    again = gpu.draw(dataclasses.replace(camera), states[0])[0]
    np.testing.assert_array_equal(again, first)  # nothing of other moments is left


def test_a_boxs_mirror_image_lies_where_the_traced_one_does(on_gpu, scene, terrain, states, camera):
    """At the CPU's limits: 28 dB over the pixels of water, and over those of the image."""
    calm = CONFIG.replace(rate=0.0)
    state = dataclasses.replace(states[BEHIND], slopes=np.zeros_like(states[BEHIND].slopes))
    bare = dataclasses.replace(scene, actors=())
    light = {}
    for name, one, make in (
        ("gpu", scene, on_gpu), ("traced", scene, OnCpu), ("without", bare, OnCpu)
    ):  # fmt: skip
        own = terrain if one is scene else dataclasses.replace(terrain, footprints=())
        renderer = make(one, own, calm, camera)
        if name == "traced":
            trace_reflections(renderer)
        _, report = renderer.draw(camera, state, None, ("reflection", "coverage"))
        light[name], water = report.aovs["reflection"], report.aovs["coverage"] > 0.5
    image = water & (np.abs(light["traced"] - light["without"]).max(axis=-1) > 0.05)
    assert image.sum() > 500
    for where in (water, image):
        assert decibel(light["gpu"][where], light["traced"][where], 1) > 28
    assert decibel(light["without"][image], light["traced"][image], 1) < 15


def test_actors_that_are_away_change_no_byte(on_gpu, scene, terrain, states, camera):
    pictures = []
    for one in (dataclasses.replace(scene, actors=()), moving_scene(visible=(False, False)), scene):
        own = with_footprints(dataclasses.replace(terrain, footprints=()), one)
        renderer = on_gpu(one, own, CONFIG, camera)
        pictures.append(renderer.draw(camera, states[BEHIND])[0].copy())
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert (pictures[0] != pictures[2]).any(axis=-1).sum() > 1500


def test_a_parked_boxs_water_stays_on_the_device(on_gpu, terrain, camera):
    """It is sent once; the simulation is the device's."""
    from rainsim.cuda.simulation import DeviceState, simulate

    parked = moving_scene(way=((0.3, 0.35, 0.4),), visible=(True,))
    ground = pipeline.extract_terrain(dataclasses.replace(parked, actors=()), CONFIG)
    ground = with_footprints(ground, parked)
    assert ground.footprints == () and (ground.top - terrain.top).max() > 0.2
    cpu, gpu = (make(parked, ground, CONFIG, camera) for make in (OnCpu, on_gpu))
    state = next(iter(pipeline.simulate(ground, CONFIG)))
    assert decibel(gpu.draw(camera, state)[0], cpu.draw(camera, state)[0]) > 45
    own, renderer = simulate(ground, CONFIG), on_gpu(parked, ground, CONFIG, camera)
    states = list(itertools.islice(own, 1))
    assert isinstance(states[0], DeviceState)
    shots = ((camera, state, None) for state in itertools.chain(states, itertools.islice(own, 3)))
    pictures = [picture.copy() for picture, _ in renderer.film(shots)]
    assert decibel(pictures[0], cpu.draw(camera, state)[0]) > 40
    assert (pictures[2] != pictures[3]).any()


def test_the_streets_traffic_and_its_spray_are_those_of_the_cpu(on_gpu):
    """A downpour on the flooded street, a moving camera: cars, labels, drops and clouds."""
    scene = load_scene("traffic")
    settings = STREET.replace(level=0.08)
    cameras = [resize_to(camera, 320) for camera in scene.cameras]
    terrain = with_footprints(pipeline.extract_terrain(scene, settings), scene)
    names = (*LABELS, "rain_alpha", "splash_alpha")
    wanted = []
    states = list(itertools.islice(pipeline.simulate(terrain, settings), settings.frames))
    for name, make in (("cpu", OnCpu), ("gpu", on_gpu)):
        renderer = make(scene, terrain, settings, cameras[0])
        path = list(zip(cameras, states, strict=False))
        for index, (camera, state) in enumerate(path):
            picture, report = renderer.draw(camera, state, None, names)
            if name == "cpu":
                wanted.append((picture.copy(), report))
                continue
            other, theirs = wanted[index]
            assert decibel(picture, other) > 40, index
            mine, theirs = report.aovs, theirs.aovs
            assert (mine["actor_id"] == theirs["actor_id"]).mean() > 0.999, index
            assert (theirs["actor_id"] > 0).sum() > 300
            for layer in ("rain_alpha", "splash_alpha"):
                assert decibel(mine[layer], theirs[layer], 1) > 40, (index, layer)
    # The spray is in these pictures.
    plain = OnCpu(scene, terrain, settings.replace(spray="off"), cameras[0])
    _, report = plain.draw(*path[-1], None, ("rain_alpha",))
    without = report.aovs["rain_alpha"]
    assert decibel(without, wanted[-1][1].aovs["rain_alpha"], 1) < 35


def test_moving_things_leave_the_water_on_the_device():
    """The flooded street from the device's own simulation: water and frames."""
    from rainsim.cuda.simulation import simulate

    scene = load_scene("traffic")
    settings = STREET.replace(level=0.08, scheme="lean")
    cameras = [resize_to(camera, 320) for camera in scene.cameras]
    terrain = with_footprints(pipeline.extract_terrain(scene, settings), scene)
    own, theirs = simulate(terrain, settings), pipeline.simulate(terrain, settings)
    for _ in range(settings.frames):
        mine, wanted = next(own), next(theirs)
        depth = mine.depth.copy_to_host()
        assert np.abs(depth - wanted.depth).max() < 2e-4
        assert np.abs(depth - wanted.depth).mean() < 1e-7
        for name, volume in wanted.ledger.items():
            assert mine.ledger[name] == pytest.approx(volume, rel=1e-3, abs=1e-6), name
        assert abs(mine.ledger["residual"]) < 1e-6
    frames = {}
    for backend in ("cpu", "cuda"):
        sequence = pipeline.FrameSequence(scene, terrain, cameras, settings, backend)
        frames[backend] = [p.copy() for p, _ in sequence.frames(range(settings.frames))]
    for index, (found, picture) in enumerate(zip(frames["cuda"], frames["cpu"], strict=True)):
        assert decibel(found, picture) > 40, index
    again = pipeline.FrameSequence(scene, terrain, cameras, settings, "cuda")
    ((alone, _),) = again.frames([settings.frames - 1])
    np.testing.assert_array_equal(alone, frames["cuda"][-1])
