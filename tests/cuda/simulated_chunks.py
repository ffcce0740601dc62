"""Captures in chunks drawn by the twin in the simulator, against the CPU's pictures."""

from dataclasses import replace

import numpy as np
import pytest

import rainsim.scene.pages
from factories import splats as made_splats
from naive import decibel
from rainsim.actors.actor import Actor, box_of, with_actors
from rainsim.actors.motion import Track
from rainsim.config.settings import Config, mm_per_hour
from rainsim.cuda import raster as twin_raster
from rainsim.cuda import simulated
from rainsim.cuda.render import renderer as twin
from rainsim.lod import cut as cutting
from rainsim.lod.cut import cut
from rainsim.lod.numbers import FinestNumbers
from rainsim.lod.paged import rasterizer_of_scene
from rainsim.lod.room import ChunkRoom
from rainsim.pipeline import extract_terrain, simulate
from rainsim.raster import Rasterizer, prepare
from rainsim.render import renderer as rendering
from rainsim.render.wet_scene import WetScene
from rainsim.scene.folder import import_scene, write_scene
from scenes import tiny_scene

assert simulated()
pytest.importorskip("gsply")
pytest.importorskip("imagecodecs")
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
SIZE = (32, 24)
CHUNK_BYTES = 13 * 256 * 4 + 8 * 256 * 2 + 6 * 4  # geometry, harmonics of degree 0, box


@pytest.fixture(autouse=True, scope="module")
def quick():
    """The day's sky as surroundings: six pictures are much for the simulator. A coarse overview."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(WetScene, "_surroundings", lambda self, position: self.sky.day)
        patch.setattr(rainsim.scene.pages, "OVERVIEW", 1500)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The tiny scene in small chunks, as a scene folder."""
    out, whole = tmp_path_factory.mktemp("chunks") / "tiny", tiny_scene()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cutting, "CHUNK", 1500)
        patch.setattr(cutting, "LEAST", 300)
        counts = cut(out, lambda: iter([whole.splats]), leaf=300)
    assert len(counts) > 2, counts
    scene = import_scene(out, cameras=whole.cameras, ground_frame=whole.ground_frame)
    write_scene(out, scene)
    return out


def config(**changes):
    base = {
        "rate": mm_per_hour(6.0), "past": 4e-3, "frames": 3, "width": SIZE[0], "extent": 1.0,
        "spacing": 0.1, "wind": (0.0, 0.0), "reflections": "auto", "film": "mirror",
        "detail": 1.5, "relight": "off", "level": 0.06,
    }  # fmt: skip
    return Config().replace(**{**base, **changes})


def test_pictures_and_hits_of_chunks_are_those_of_the_cpu(folder):
    """Levels that change with the camera; only what was not there before is sent."""
    scene, other = import_scene(folder), import_scene(folder)
    render, numbers = config().render, FinestNumbers(scene.pages)
    mine = rasterizer_of_scene(scene, render, twin_raster.Rasterizer, numbers.of_run)
    theirs = rasterizer_of_scene(other, render, numbers_of=numbers.of_run)
    far = scene.cameras[1]
    away = far.camera_from_world.copy()
    away[2, 3] += 6 * far.camera_from_world[2, 3]
    cameras = [scene.cameras[0], scene.cameras[1], replace(far, camera_from_world=away)]
    used, sent, first = [], [], None
    for camera in (*cameras, cameras[0]):
        camera = camera.resized(*SIZE)
        found, wanted = (each.draw(camera, 0.02, hit=True) for each in (mine, theirs))
        assert mine.used == theirs.used
        used.append(mine.wanted(camera, 0.02))
        sent.append(mine._rasterizer.splats.sent)
        assert wanted.alpha.max() > 0.9 and decibel(found.color, wanted.color, 1.0) > 60
        assert np.mean(found.hit == wanted.hit) > 0.99 and wanted.hit.max() > 0
        first = found if first is None else first
    assert len({tuple(each) for each in used}) > 2  # the choice changes
    assert 0 < sent[0] < sent[2] == sent[3]
    assert sent[3] == CHUNK_BYTES * len(mine.room.prepared.written.nonzero()[0])
    np.testing.assert_array_equal(found.color, first.color)


def test_chunks_that_were_let_go_are_sent_again(folder):
    """Memory for hardly a page: places are written anew, and the room grows while it is drawn."""
    scene = import_scene(folder)
    plain = rasterizer_of_scene(import_scene(folder), config().render)
    drawer = rasterizer_of_scene(scene, config().render, twin_raster.Rasterizer)
    drawer.pages.kept.most = drawer.room._most = 1.0
    drawer.room._chunks = 2
    sent, places = [], set()
    for narrow, threshold in ((8.0, 1.5), (1.0, 0.0), (8.0, 1.5)):
        camera = scene.cameras[0].resized(*SIZE)
        camera = replace(camera, fx=narrow * camera.fx, fy=narrow * camera.fy)
        wanted = plain.draw(camera, 0.02, threshold=threshold).color
        found = drawer.draw(camera, 0.02, threshold=threshold).color
        assert decibel(found, wanted, 1.0) > 60
        sent.append(drawer._rasterizer.splats.sent)
        places.add(drawer._rasterizer.splats.chunks)
    assert drawer.room.prepared.written.max() > 1 and len(places) > 1
    assert sent[0] < sent[1] < sent[2]


def test_equal_depths_are_taken_in_the_order_of_the_choice_wherever_chunks_lie():
    """A wall that faces the camera, in two chunks whose places were used before."""
    rng, camera = np.random.default_rng(1), tiny_scene().cameras[0].resized(*SIZE)
    camera = replace(camera, camera_from_world=np.eye(4))
    place = np.concatenate([rng.uniform(-1, 1, (300, 2)), np.full((300, 1), 2.0)], axis=1)
    wall = prepare(made_splats(place, color=rng.uniform(0, 1, (300, 3)), scale=0.2))
    room = ChunkRoom(1e6, 4)
    room.free(room.put(wall)[::-1])
    chunks = room.put(wall)
    assert (np.diff(chunks) < 0).any()
    wanted = Rasterizer(wall).draw(camera, 0.02).color
    found = twin_raster.Rasterizer(room.prepared).draw(camera, 0.02, among=chunks).color
    assert decibel(found, wanted, 1.0) > 60
    swapped = twin_raster.Rasterizer(room.prepared).draw(camera, 0.02, among=chunks[::-1]).color
    assert decibel(swapped, wanted, 1.0) < 50


@pytest.fixture(scope="module")
def rain(folder):
    """A map of the ground and the states of two frames."""
    terrain = extract_terrain(import_scene(folder), config())
    return terrain, [state for state, _ in zip(simulate(terrain, config()), "ab", strict=False)]


def shots(scene, states):
    """Shots of two cameras and of the first again."""
    cameras = [scene.cameras[n].resized(*SIZE) for n in (0, 2, 0)]
    shown = zip(cameras, [*states, states[0]], strict=True)
    return [(camera, state, None) for camera, state in shown]


def test_rainy_frames_of_chunks_are_those_of_the_cpu(folder, rain):
    """With mirrors, the wet-ground mirror, and a frame by itself as in sequence."""
    terrain, states = rain
    shown, renderers = [], []
    for backend in (rendering.Renderer, twin.Renderer):
        scene = import_scene(folder)
        each = backend(scene, terrain, config(), scene.cameras[0].resized(*SIZE))
        shown.append([p.copy() for p, _ in each.film(shots(scene, states))])
        renderers.append(each)
    for found, wanted in zip(shown[1], shown[0], strict=True):
        assert decibel(found, wanted) > 60
    frame = renderers[1].conductor.frame
    assert frame["field_on_ground"] is not None and len(frame["mirrors"].range)
    np.testing.assert_array_equal(shown[1][0], shown[1][2])
    sent = renderers[1].conductor.wet_scene.capture.paged.drawer.splats.sent
    scene = import_scene(folder)
    camera, state, _ = shots(scene, states)[1]
    alone = twin.Renderer(scene, terrain, config(), camera)
    np.testing.assert_array_equal(alone.draw(camera, state)[0], shown[1][1])
    camera = shots(scene, states)[0][0]
    renderers[1].draw(camera, states[1])
    drawer = renderers[1].conductor.wet_scene.capture.paged.drawer
    assert drawer.splats.sent == sent  # all of it is there


def test_layers_and_actors_among_chunks_are_those_of_the_cpu(folder, rain):
    terrain, states = rain
    whole = tiny_scene()
    place = whole.ground_frame.to_ground(whole.splats.position.astype(float))
    body = whole.splats.take(np.flatnonzero(place[:, 2] > 0.2)[::3])
    body = replace(body, position=body.position - body.position.mean(axis=0))
    turn, middle = np.array([[1.0, 0, 0, 0]] * 2), whole.ground_frame.to_capture((0.0, 0.0, 0.3))
    track = Track(np.array([0.0, 1.0]), np.array([middle, middle + 0.5]), turn, np.ones(2, bool))
    actor = Actor("box", "cart", body, box_of(body), track)
    found = []
    for backend in (rendering.Renderer, twin.Renderer):
        scene = with_actors(import_scene(folder), (actor,))
        camera = scene.cameras[1].resized(*SIZE)
        each = backend(scene, terrain, config(), camera)
        for state in states:
            picture, report = each.draw(camera, state, None, ("actor_id", "clean", "depth"))
            found.append((picture.copy(), report.aovs))
    for n, (picture, layers) in enumerate(found[2:]):
        wanted, theirs = found[n]
        assert decibel(picture, wanted) > 60
        assert theirs["actor_id"].any() and np.mean(layers["actor_id"] == theirs["actor_id"]) > 0.99
        assert np.abs(layers["clean"].astype(int) - theirs["clean"]).max() <= 2
