"""The sky behind a scene: leaves before it are mixed with the day's sky, not with the captured."""

import dataclasses

import numpy as np
import pytest

import factories
from benchmarks.traced import RayScene
from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.render import aov
from rainsim.render.renderer import Renderer
from rainsim.scene.splat_sets import joined
from rainsim.shading import backdrop, sky
from rainsim.shading.color import linear_from_display
from rainsim.shading.environment import sample_environment
from rainsim.shading.grading import graded, replaces_sky
from scenes import looking, tiny_scene

BLUE, LEAF, SIZE = (0.45, 0.62, 0.9), (0.1, 0.3, 0.05), 48
LEAF_AT = (0.0, 3.0, 2.5)
RAY = np.array([0, 2, 1], np.float32) / np.sqrt(np.float32(5))  # from (0, 0, 1) to it


@pytest.fixture(scope="module")
def scene():
    """The tiny scene below a blue dome, with a half transparent leaf before it."""
    scene = tiny_scene(SIZE, SIZE)
    frame = scene.ground_frame
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 360, 12)), np.radians(
        np.arange(-2, 90, 8)))  # fmt: skip
    flat = np.cos(elevation)
    dome = 60 * np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1)
    unit = frame.meters_per_unit
    places = frame.to_capture(dome.reshape(-1, 3)), frame.to_capture(np.array([LEAF_AT]))
    added = factories.splats(places[0], scale=6 / unit, opacity=0.97, color=BLUE)
    leaf = factories.splats(places[1], scale=0.5 / unit, opacity=0.5, color=LEAF)
    return dataclasses.replace(scene, splats=joined([scene.splats, added, leaf]))


def drawn(scene, cloudiness=1.0, names=()):
    """Renderer, report and picture of a dry frame: the leaf and the sky above it."""
    camera = scene.ground_frame.camera_in_capture(
        looking((0.0, 0.0, 1.0), LEAF_AT, SIZE, SIZE, name="level")
    )
    config = Config().replace(
        rate=0.0, past=0.0, frames=1, extent=1.0, spacing=0.05, cloudiness=cloudiness,
        width=SIZE,
    )  # fmt: skip
    terrain = pipeline.extract_terrain(tiny_scene(), config)
    renderer = Renderer(scene, terrain, config, camera)
    picture, report = renderer.draw(camera, next(pipeline.simulate(terrain, config)), None, names)
    return renderer, report, picture


@pytest.fixture(scope="module")
def dull(scene):
    """What `drawn` returns under full cloud, with all layers."""
    return drawn(scene, names=tuple(aov.AOVS))


def test_a_leaf_is_mixed_with_the_sky_of_the_day(scene, dull, monkeypatch):
    renderer, report, _ = dull
    assert renderer.conductor.wet_scene.sky.backdrop.count == 360 and any(
        "360 splats" in note for note in report.notes
    )
    middle = SIZE // 2, SIZE // 2
    leaf = graded(
        *(linear_from_display(np.float32(c)) for c in LEAF),
        renderer.conductor.wet_scene.shading.look,
    )
    day = sample_environment(renderer.conductor.wet_scene.sky.day, *RAY)
    wanted = 0.5 * np.array(leaf) + 0.5 * np.array(day)
    np.testing.assert_allclose(renderer.wet.picture[middle], wanted, rtol=0.03)
    # A ray that is traced sees the same.
    eye = np.array([[0, 0, 1]], np.float32)
    light, alpha, _ = RayScene(renderer.conductor.wet_scene).trace(
        eye, RAY[None], np.zeros(1), 0.01
    )
    assert alpha[0] == pytest.approx(0.5, abs=0.02)
    np.testing.assert_allclose(light[0], wanted, rtol=0.05)
    # Laid over the captured sky it is not: that one has lent the leaf's edge its light.
    monkeypatch.setattr(sky, "LEAST_SKY_SEEN", 9.0)
    hard, *_ = drawn(scene)
    assert (
        hard.conductor.wet_scene.sky.backdrop.count == 0 and hard.conductor.wet_scene.scene is scene
    )
    assert np.abs(hard.wet.picture[middle] / wanted - 1).max() > 0.2


def test_clouds_that_cover_half_leave_half_of_the_captured_sky(scene, dull):
    half, *_ = drawn(scene, 0.5)
    own = graded(
        *(linear_from_display(np.float32(c)) for c in BLUE), half.conductor.wet_scene.shading.look
    )
    up = 0.5 * half.conductor.wet_scene.sky.day[20:40] + 0.5 * np.float32(own)
    np.testing.assert_allclose(half.conductor.wet_scene.sky.behind[20:40], up, rtol=0.04)
    wet = dull[0].conductor.wet_scene
    behind, day = wet.sky.behind, wet.sky.day
    np.testing.assert_array_equal(behind[:120], day[:120])  # in haze from there on
    assert (behind[126:130].mean(axis=1) > 1.2 * day[126:130].mean(axis=1)).all()
    config = half.conductor.config
    assert replaces_sky(config) and not replaces_sky(config.replace(cloudiness=0.0))
    assert not replaces_sky(config.replace(sky="capture"))  # so the splats stay


def test_a_needle_in_the_captured_sky_is_not_drawn(dull, monkeypatch):
    own = dull[0].conductor.wet_scene.sky.backdrop
    seen = np.ones((128, 256, 4), np.float32)
    seen[:, 40:42, :3] = 0
    seen[64:] = 0
    monkeypatch.setattr(backdrop.environment, "probe", lambda *_: seen)
    monkeypatch.setattr(own, "_seen", None)
    found = own._panorama(256)
    assert found.shape == (256, 512, 4)
    assert (found[:122] == 1).all() and (found[134:] == 0).all()


def test_layers_tell_the_capture_and_the_sky(dull):
    _, report, picture = dull
    top, middle = (2, SIZE // 2), (SIZE // 2, SIZE // 2)
    np.testing.assert_allclose(report.aovs["clean"][top] / 255, BLUE, atol=0.05)
    assert np.isinf(report.aovs["depth"][top])
    assert report.aovs["depth"][middle] == pytest.approx(np.hypot(3, 1.5), abs=0.05)
    again = aov.recompose(report.aovs, **report.light).astype(int)
    assert np.abs(again - picture).max() <= 1 and picture[top].min() > 150


def test_few_far_splats_are_no_sky(scene):
    bare = tiny_scene()
    found = backdrop.Backdrop(bare, backdrop.sky_of(bare), True)
    assert found.count == 0 and found.scene is bare
    far = backdrop.sky_of(scene)
    assert far.sum() == 360 and backdrop.Backdrop(scene, far, False).scene is scene
    assert 0.5 < backdrop.covered(scene.splats, scene.cameras[0].position, far)
