"""Whole rainy frames of the twin in the simulator, against the CPU's."""

import dataclasses
from collections import defaultdict

import numpy as np
import pytest

from made_frames import passes_without
from naive import decibel
from rainsim.config.settings import Config, mm_per_hour
from rainsim.cuda import simulated
from rainsim.cuda import simulation as cuda_simulation
from rainsim.cuda.render import renderer as twin
from rainsim.cuda.shading import wet_ground_mirror
from rainsim.daylight import kept_light
from rainsim.daylight.relight import Relight
from rainsim.errors import ParameterError
from rainsim.pipeline import extract_terrain, simulate
from rainsim.reflection.water_pass import choice_of
from rainsim.render import aov
from rainsim.render import renderer as rendering
from rainsim.render.frame import PASSES
from rainsim.render.wet_scene import WetScene
from scenes import lamp_scene, tiny_scene

assert simulated()
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
SIZE = (32, 24)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """The day's sky as surroundings: six pictures are much for the simulator."""
    monkeypatch.setattr(WetScene, "_surroundings", lambda self, position: self.sky.day)


def config(**changes):
    base = {
        "rate": mm_per_hour(6.0), "past": 4e-3, "frames": 2, "width": SIZE[0], "extent": 1.0,
        "spacing": 0.1, "wind": (0.0, 0.0), "reflections": "ssr",
        "film": "environment",
    }  # fmt: skip
    return Config().replace(**{**base, **changes})


def drawn(renderer, scene, camera, states):
    return [renderer.draw(camera, state)[0].copy() for state in states]


# A marched ray that grazes an edge may miss on one side what it hits on the other.
@pytest.mark.parametrize(("reflections", "least"), [("ssr", 40), ("auto", 50)])
def test_frames_are_those_of_the_cpu(reflections, least):
    scene = tiny_scene()
    camera = scene.cameras[0].resized(*SIZE)
    settings = config(level=0.06, reflections=reflections)
    terrain = extract_terrain(scene, settings)
    states = [state for state, _ in zip(simulate(terrain, settings), range(2), strict=False)]
    wanted = drawn(rendering.Renderer(scene, terrain, settings, camera), scene, camera, states)
    renderer = twin.Renderer(scene, terrain, settings, camera)
    assert passes_without(renderer.passes.work) & {p.name for p in PASSES} == {"splat level"}
    splat, launches = renderer.passes.work["splat"], []
    renderer.passes.work["splat"] = lambda camera, capture: (
        launches.append(1) or splat(camera, capture)
    )
    mirrors, mirrored = renderer.passes._mirrors, []
    draw = mirrors._draw
    mirrors._draw = lambda k, *given: mirrored.append(k) or draw(k, *given)
    found = drawn(renderer, scene, camera, states)
    count = len(launches)
    for a, b in zip(found, wanted, strict=True):
        assert decibel(a, b) > least
    assert (wanted[0] != wanted[1]).any()
    # Of the ground's water, and of what lies level above it.
    reach = renderer.conductor.frame["mirrors"].range.copy_to_host()
    assert (reach[:, 1] < reach[:, 2]).sum() == (2 if reflections == "auto" else 0)
    again = renderer.draw(camera, states[0])[0]
    np.testing.assert_array_equal(again, found[0])
    assert len(launches) == count > 0  # a still camera's picture is kept, and what it mirrors
    assert mirrored == ([0, 1] if reflections == "auto" else [])
    again = renderer.draw(dataclasses.replace(camera), states[0])[0]
    np.testing.assert_array_equal(again, found[0])
    assert len(launches) == count + 1 and len(mirrored) == (4 if reflections == "auto" else 0)
    dry = dataclasses.replace(states[0], depth=np.zeros_like(states[0].depth))
    assert decibel(renderer.draw(camera, dry)[0], found[0]) < 40


def test_wet_tops_are_those_of_the_cpu():
    """A table wide enough to carry water; its puddles from states of either backend."""
    scene = tiny_scene(table=0.45)
    camera = scene.cameras[0].resized(*SIZE)
    settings = config(reflections="auto", past=6e-3, spacing=0.05)
    terrain = extract_terrain(scene, settings)
    assert len(terrain.tops) == 1 and terrain.tops.level.all()
    state = next(iter(simulate(terrain, settings)))
    wanted = rendering.Renderer(scene, terrain, settings, camera)
    picture = wanted.draw(camera, state)[0]
    renderer = twin.Renderer(scene, terrain, settings, camera)
    assert decibel(renderer.draw(camera, state)[0], picture) > 50
    assert (wanted.water.top >= 0).mean() > 0.2 and "tops" in choice_of(wanted.water)
    off = settings.replace(tops="off")
    without = rendering.Renderer(scene, terrain, off, camera).draw(camera, state)[0]
    assert decibel(without, picture) < 40
    own = cuda_simulation.Simulation(terrain, cuda_simulation.start_of(terrain, settings))
    np.testing.assert_allclose(own.advance().top_water, state.top_water, rtol=1e-6)


def test_film_gets_a_mirrored_picture_where_it_is_worth_one():
    """Chosen with the first frame, said once, and kept."""
    scene = tiny_scene()
    camera = scene.cameras[0].resized(*SIZE)
    settings = config(reflections="auto", film="auto", rate=0.0)
    terrain = extract_terrain(scene, settings)
    state = next(iter(simulate(terrain, settings)))
    pictures, notes = [], []
    for theirs in (rendering.Renderer, twin.Renderer):
        renderer = theirs(scene, terrain, settings, camera)
        for _ in range(2):
            picture, report = renderer.draw(camera, state)
            pictures.append(picture.copy())
            notes.append([note for note in report.notes if note.startswith("film")])
    assert notes[0] == notes[2] and "a mirrored picture" in notes[2][0] and notes[3] == []
    assert renderer.conductor.ground.film.drawn
    assert decibel(pictures[2], pictures[0]) > 50
    np.testing.assert_array_equal(pictures[2], pictures[3])
    plain = config(reflections="auto", film="environment", rate=0.0)
    without = rendering.Renderer(scene, terrain, plain, camera).draw(camera, state)[0]
    assert decibel(pictures[2], without) < 45


def test_lamps_on_wet_ground_are_those_of_the_cpu(monkeypatch):
    """A lamp over wet paving at dusk, with its halo; its image is that of a source."""
    dark, scene = lamp_scene()
    camera = scene.cameras[0].resized(*SIZE)
    settings = config(
        film="mirror", reflections="auto", rate=0.0, past=2e-3, daylight=0.04, brightness=0.35,
        glare="spencer",
    )  # fmt: skip
    terrain = extract_terrain(scene, settings)
    state = next(iter(simulate(terrain, settings)))
    wanted = rendering.Renderer(scene, terrain, settings, camera).draw(camera, state)[0]
    renderer = twin.Renderer(scene, terrain, settings, camera)
    found = renderer.draw(camera, state)[0].copy()
    assert decibel(found, wanted) > 50
    assert len(renderer.passes._film._level.lamps) > 0
    clear = rendering.Renderer(scene, terrain, settings.replace(glare="off"), camera)
    assert decibel(clear.draw(camera, state)[0], wanted) < decibel(found, wanted) - 6
    monkeypatch.setattr(wet_ground_mirror, "add_lamps", defaultdict(lambda: lambda *_: None))
    without = twin.Renderer(scene, terrain, settings, camera).draw(camera, state)[0]
    assert decibel(without, wanted) < decibel(found, wanted) - 6
    plain = twin.Renderer(dark, terrain, settings, camera)
    plain.draw(camera, state)
    assert plain.passes._film._level.lamps is None


def test_colors_follow_clouds_that_come_and_go(monkeypatch, tmp_path):
    """A captured sun that is divided out frame by frame, and the layer of the capture itself."""

    def relight(scene, *_):
        gain = np.linspace(0.4, 3, 3 * len(scene.splats)).reshape(-1, 3).astype(np.float16)
        return Relight(gain, "made for a test")

    monkeypatch.setattr(kept_light, "find_relight", relight)
    scene = dataclasses.replace(tiny_scene(), source=tmp_path)
    camera = scene.cameras[0].resized(*SIZE)
    keys = ((0.0, (("cloudiness", 1.0),)), (1 / 24, (("cloudiness", 0.2),)))
    settings = config(reflections="auto", film="mirror", rate=0.0)
    settings = dataclasses.replace(settings, keyframes=keys)
    terrain = extract_terrain(scene, settings)
    states = [state for state, _ in zip(simulate(terrain, settings), range(2), strict=False)]
    pictures, clean = [], []
    for theirs in (rendering.Renderer, twin.Renderer):
        renderer = theirs(scene, terrain, settings, camera)
        for state in states:
            picture, report = renderer.draw(camera, state, None, ("clean",))
            pictures.append(picture.copy())
            clean.append(report.aovs["clean"])
    for n in range(2):
        assert decibel(pictures[2 + n], pictures[n]) > 50
        assert np.abs(clean[2 + n].astype(int) - clean[n]).max() <= 1
    assert decibel(pictures[0], pictures[1]) < 30
    np.testing.assert_array_equal(clean[0], clean[1])


def test_layers_are_those_of_the_cpu():
    """They make the frame again, and each is the CPU's."""
    scene = tiny_scene()
    camera = scene.cameras[0].resized(*SIZE)
    settings = config(level=0.06, reflections="auto", sun=(0.5, 0.8), film="mirror")
    terrain = extract_terrain(scene, settings)
    state = next(iter(simulate(terrain, settings)))
    names = tuple(aov.AOVS)
    _, wanted = rendering.Renderer(scene, terrain, settings, camera).draw(
        camera, state, None, names
    )
    renderer = twin.Renderer(scene, terrain, settings, camera)
    plain = renderer.draw(camera, state)[0].copy()
    picture, found = renderer.draw(camera, state, None, names)
    np.testing.assert_array_equal(picture, plain)
    again = aov.recompose(found.aovs, **found.light)
    assert decibel(again, picture) > 50
    for name, layer in wanted.aovs.items():
        far = np.isfinite(layer)
        np.testing.assert_array_equal(np.isfinite(found.aovs[name]), far)
        difference = np.abs(found.aovs[name][far].astype(float) - layer[far])
        most = max(np.abs(layer[far]).max(initial=0), 1e-6)
        assert not far.any() or np.mean(difference > 1e-2 * most) < 0.02, name
    assert found.aovs["coverage"].max() > 0.5 and found.aovs["rain_alpha"].max() > 0
    np.testing.assert_array_equal(renderer.draw(camera, state)[0], plain)


def test_looks_that_only_the_cpu_draws_are_refused():
    scene = tiny_scene()
    settings = config(streaks="paper")
    with pytest.raises(ParameterError, match=r"streaks is 'paper'.*backend cpu"):
        twin.Renderer(scene, None, settings, scene.cameras[0])
