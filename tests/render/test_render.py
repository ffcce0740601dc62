"""Whole frames of the tiny scene: what must change in rain and what must not."""

import dataclasses
import inspect

import numpy as np
import pytest

from naive import decibel
from rainsim import pipeline
from rainsim.config.settings import Config, mm_per_hour
from rainsim.errors import ParameterError
from rainsim.pipeline import extract_terrain, render_rain, simulate
from rainsim.reflection.mirror_choice import mirror_step
from rainsim.render import rain_pass
from rainsim.render.renderer import Renderer
from rainsim.scene.cameras import mirrored_camera
from rainsim.scene.types import GroundFrame
from scenes import tiny_scene

SIZE = (96, 72)


@pytest.fixture(scope="module")
def scene():
    return tiny_scene()


@pytest.fixture(scope="module")
def camera(scene):
    return scene.cameras[0].resized(*SIZE)


def config(**changes):
    base = {
        "rate": mm_per_hour(10.0), "past": 4e-3, "frames": 1, "width": SIZE[0], "extent": 1.0,
        "spacing": 0.025, "wind": (0.0, 0.0),
    }  # fmt: skip
    return Config().replace(**{**base, **changes})


def frame(scene, camera, **changes):
    return next(render_rain(scene, [camera], config(**changes)))


def test_report_names_stages_and_closes_the_ledger(scene, camera):
    picture, report = frame(scene, camera)
    assert picture.shape == (SIZE[1], SIZE[0], 3) and picture.dtype == np.uint8
    assert {"splat", "grade and wet", "mirror", "reflection", "water", "compose"} <= set(
        report.milliseconds
    )
    assert abs(report.ledger["residual"]) < 1e-9
    assert picture.std() > 5
    (told,) = (note for note in report.notes if note.startswith("reflections: "))
    assert "mirrored picture" in told


def test_cameras_must_be_one_for_each_frame_or_one_for_all(scene, camera):
    config = Config().replace(frames=3, extent=1.0, spacing=0.1)
    terrain = extract_terrain(scene, config)
    with pytest.raises(ParameterError, match="2 cameras and the last frame has the number 2"):
        next(pipeline.render(scene, terrain, iter(()), [camera] * 2, config))
    for count in (1, 3):
        assert list(pipeline.render(scene, terrain, iter(()), [camera] * count, config)) == []


def test_no_rain_on_a_clear_day_is_the_capture_itself(scene, camera):
    """Without rain, clouds and puddles only the soft shoulder of the display curve is left."""
    picture, _ = frame(scene, camera, rate=0.0, past=0.0, cloudiness=0.0, sky="capture")
    from rainsim.raster import prepare, rasterize

    layers = rasterize(prepare(scene.splats), camera, 0.05 / scene.ground_frame.meters_per_unit)
    inside = layers.alpha > 0.99
    assert inside.sum() > 1000
    captured = np.clip(layers.color, 0, 1) * 255
    dark = inside & (captured.max(axis=-1) < 180)  # below the shoulder
    assert dark.sum() > 500
    assert np.abs(picture[dark].astype(float) - captured[dark]).max() < 2.5


def test_rain_wets_and_darkens_the_ground(scene, camera):
    dry, _ = frame(scene, camera, rate=0.0, past=0.0, metering="off")
    wet, _ = frame(scene, camera, rate=0.0, past=2e-3, metering="off")
    lower = slice(SIZE[1] // 2, None)
    assert wet[lower].mean() < 0.95 * dry[lower].mean()
    metered, _ = frame(scene, camera, rate=0.0, past=2e-3)  # a camera opens for it
    assert metered[lower].mean() > wet[lower].mean()


@pytest.mark.parametrize("reflections", ["mirror", "ssr", "paper"])
def test_water_shows_only_where_it_stands(scene, camera, reflections):
    dry, _ = frame(scene, camera, rate=0.0, past=2e-3, reflections=reflections)
    flood, _ = frame(scene, camera, rate=0.0, past=2e-3, level=0.03, reflections=reflections)
    changed = np.abs(flood.astype(int) - dry).max(axis=-1) > 3
    assert 0.05 < changed.mean() < 0.95


def test_march_and_mirror_tell_much_the_same(scene, camera):
    mirror, _ = frame(scene, camera, rate=0.0, level=0.03, reflections="mirror")
    march, _ = frame(scene, camera, rate=0.0, level=0.03, reflections="ssr")
    assert decibel(mirror, march) > 25
    assert (mirror != march).any()


def test_half_mirrors_show_much_the_same_and_small_pictures_have_full_ones(scene, camera):
    drawn = {
        size: frame(scene, camera, rate=mm_per_hour(10.0), level=0.03, mirror_size=size)[0]
        for size in ("auto", "full", "half")
    }
    assert (drawn["auto"] == drawn["full"]).all()
    assert (drawn["half"] != drawn["full"]).any()
    assert decibel(drawn["half"], drawn["full"]) > 30


@pytest.mark.parametrize(
    ("name", "rate", "focal", "film", "step"),
    [("full", 50, 2000, 0, 1), ("half", 0, 50, 0, 2), ("auto", 10, 400, 0, 2),
     ("auto", 0, 600, 0, 1), ("auto", 10, 60, 0, 1), ("auto", 10, 400, 1, 1),
     ("auto", 50, 600, 1, 2)],
)  # fmt: skip
def test_mirrors_have_half_the_size_where_rings_blur_them(name, rate, focal, film, step):
    lens = np.full(4, focal, np.float32)
    assert mirror_step(name, mm_per_hour(rate), film, lens) == step


@pytest.mark.parametrize(
    "setting", [{"refraction": "shift"}, {"fresnel": "schlick"}, {"coverage": "hard"},
                {"water_geometry": "spheres"}, {"highlight": "blinn-phong"}],
)  # fmt: skip
def test_each_of_the_papers_choices_makes_another_picture(scene, camera, setting):
    light = {"rate": 0.0, "past": 4e-3, "sun": (0.0, 0.6), "cloudiness": 0.3, "level": 0.002}
    ours, _ = frame(scene, camera, **light)
    papers, _ = frame(scene, camera, **light, **setting)
    assert (ours != papers).any() and decibel(ours, papers) > 10


def test_streaks_change_with_time(scene, camera):
    heavy = {"rate": mm_per_hour(50.0), "past": 0.0, "frames": 2}
    frames = [p for p, _ in render_rain(scene, [camera], config(**heavy))]
    assert (frames[0] != frames[1]).any()


def test_rescaled_and_turned_capture_gives_the_same_frame(scene, camera):
    """SH of the tiny scene is of degree 0, so turning needs no rotation of colours."""
    picture, _ = frame(scene, camera, level=0.03)
    size, shift = 2.7, np.array([3.0, -1.0, 0.5])
    c, s = np.cos(0.7), np.sin(0.7)  # about y
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    splats = scene.splats
    w, x, y, z = splats.rotation.T
    c, s = np.cos(0.35), np.sin(0.35)
    rotation = np.stack([c * w - s * y, c * x + s * z, c * y + s * w, c * z - s * x], axis=1)
    moved = dataclasses.replace(
        splats, position=(splats.position @ turn.T * size + shift).astype(np.float32),
        rotation=rotation.astype(np.float32), scale=splats.scale * np.float32(size),
    )  # fmt: skip
    old = scene.ground_frame
    unit = old.meters_per_unit / size
    new = GroundFrame(
        old.rotation @ turn.T, unit, old.translation - unit * old.rotation @ turn.T @ shift
    )

    def move(camera):
        matrix = np.eye(4)
        matrix[:3, :3] = camera.camera_from_world[:3, :3] @ turn.T
        matrix[:3, 3] = -matrix[:3, :3] @ (turn @ camera.position * size + shift)
        return dataclasses.replace(camera, camera_from_world=matrix)

    turned = dataclasses.replace(
        scene, splats=moved, ground_frame=new, cameras=tuple(map(move, scene.cameras))
    )
    again, _ = frame(turned, move(camera), level=0.03)
    assert decibel(picture, again) > 50


def test_a_still_camera_is_splatted_once_and_a_moving_one_each_time(scene, camera):
    other = scene.cameras[1].resized(*SIZE)
    reports = [r for _, r in render_rain(scene, [camera], config(frames=3))]
    assert "splat" in reports[0].milliseconds
    assert "splat" not in reports[1].milliseconds and "splat" not in reports[2].milliseconds
    reports = [r for _, r in render_rain(scene, [camera, other], config(frames=2))]
    assert all("splat" in r.milliseconds for r in reports)


def test_no_camera_and_unknown_backend_are_told(scene, camera):
    ground = extract_terrain(scene, config())
    with pytest.raises(ParameterError, match="camera"):
        next(pipeline.render(scene, ground, simulate(ground, config()), [], config()))
    with pytest.raises(ParameterError, match="backend"):
        next(render_rain(scene, [camera], config(), backend="abacus"))


def test_the_mirrored_camera_sees_a_point_where_its_mirror_image_is(scene):
    frame_, camera = scene.ground_frame, scene.cameras[0]
    level = 0.04
    plane, mirrored = mirrored_camera(camera, frame_, level)
    point = np.array([0.3, 0.2, 0.5])
    image = np.array([0.3, 0.2, 2 * level - 0.5])
    seen = mirrored.camera_from_world @ np.append(frame_.to_capture(point), 1)
    expected = camera.camera_from_world @ np.append(frame_.to_capture(image), 1)
    np.testing.assert_allclose(seen, expected, atol=1e-9)
    above = frame_.to_capture(np.array([1.0, -2.0, level + 0.02])) @ plane[:3] - plane[3]
    below = frame_.to_capture(np.array([1.0, -2.0, level + 0.01])) @ plane[:3] - plane[3]
    assert above > 0 > below


def test_streaks_are_drawn_with_the_pose_at_the_shutters_close(scene, camera, monkeypatch):
    seen = []
    names = inspect.signature(rain_pass.draw_streaks)

    def draw_streaks(*given, **named):
        seen.append(names.bind(*given, **named).arguments["camera_end"])

    monkeypatch.setattr(rain_pass, "draw_streaks", draw_streaks)
    near = scene.ground_frame.camera_in_ground(camera)
    matrix = near.camera_from_world.copy()
    matrix[0, 3] -= 0.05  # m to its right
    moved = scene.ground_frame.camera_in_capture(
        dataclasses.replace(near, camera_from_world=matrix)
    )
    list(render_rain(scene, [camera, moved], config(frames=2, rate=mm_per_hour(50.0))))
    list(render_rain(scene, [camera], config(frames=1, rate=mm_per_hour(50.0))))
    first, second, still = seen
    way = first.position - near.position
    share = config().render.exposure * config().fps
    np.testing.assert_allclose(np.linalg.norm(way), 0.05 * share, rtol=1e-6)
    assert second.position @ way > first.position @ way and still is None


def test_wet_ground_mirrors_what_stands_on_it(scene, camera):
    """The mirrored picture of the film, and not the blurred surroundings only."""
    pictures = {}
    for name in ("mirror", "environment", "auto"):
        pictures[name], report = frame(scene, camera, rate=0.0, film=name)
        told = [note for note in report.notes if note.startswith("film")]
        assert bool(told) == (name == "auto")
    assert 20 < decibel(pictures["mirror"], pictures["environment"]) < 45
    np.testing.assert_array_equal(pictures["auto"], pictures["mirror"])
    dry = {
        name: frame(scene, camera, rate=0.0, past=0.0, film=name)[0] for name in ("mirror", "auto")
    }
    np.testing.assert_array_equal(dry["mirror"], dry["auto"])


def test_no_frame_decides_what_another_one_mirrors(scene, camera):
    """A camera that sees a strip of wet ground, before and after one that sees much of it."""
    strip = dataclasses.replace(camera, cy=1.1 * camera.height)
    settings = config(rate=0.0)
    terrain = extract_terrain(scene, settings)
    state = next(iter(simulate(terrain, settings)))
    drawn = []
    for order in ((strip, camera), (camera, strip)):
        renderer = Renderer(scene, terrain, settings, camera)
        pictures = [renderer.draw(view, state)[0] for view in order]
        drawn.append(pictures[:: 1 if order[0] is strip else -1])
    np.testing.assert_array_equal(drawn[0][0], drawn[1][0])
    np.testing.assert_array_equal(drawn[0][1], drawn[1][1])
    plain = Renderer(scene, terrain, config(rate=0.0, film="environment"), camera)
    assert (plain.draw(strip, state)[0] != drawn[0][0]).any()  # the strip mirrors something


def test_a_camera_that_stops_shows_the_frame_that_it_showed_in_motion(scene, camera):
    """Nothing flickers: the rain alone knows that the camera moved while the shutter was open."""
    settings = config(frames=2)
    terrain = extract_terrain(scene, settings)
    states = simulate(terrain, settings)
    before, state = next(states), next(states)
    renderer = Renderer(scene, terrain, settings, camera)
    near = scene.ground_frame.camera_in_ground(camera)
    matrix = near.camera_from_world.copy()
    matrix[0, 3] -= 0.02  # m to its right while the shutter is open
    end = dataclasses.replace(near, camera_from_world=matrix)
    renderer.draw(scene.cameras[1].resized(*SIZE), before)
    moving, _ = renderer.draw(camera, state, end)
    passing, _ = renderer.draw(dataclasses.replace(camera), state)
    renderer.draw(camera, before)
    held, _ = renderer.draw(camera, state)
    np.testing.assert_array_equal(passing, held)
    assert (moving != held).any() and decibel(moving, held) > 40
