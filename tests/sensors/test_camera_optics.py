"""Lens, glass and shutter of frames: a moving edge is spread over its path, a streak is not."""

from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from rainsim import pipeline
from rainsim.config.settings import Config, mm_per_hour
from rainsim.errors import ParameterError
from rainsim.numerics import srgb
from rainsim.render.aov import AOVS
from rainsim.render.report import FrameReport
from rainsim.scene.types import Camera, GroundFrame
from rainsim.sensors.glass import Pane
from rainsim.sensors.lens import Lens, lens_warp
from rainsim.sensors.optics import Optics, Taking
from scenes import moving_scene, tiny_scene, walk

FRAME = GroundFrame(np.eye(3), 1.0, np.zeros(3), 1.0, ())
BENT = Lens("opencv", (-0.2, 0.05, 0.0, 0.0))


class Moment(NamedTuple):
    """What a state has here."""

    index: int
    time: float

    def shown_at(self, time):
        return self._replace(time=time)


class EdgeRenderer:
    """Draws a white half plane, sharp, whose upright edge is at x = 0, 4 m ahead."""

    def __init__(self, config):
        self.conductor = SimpleNamespace(
            config=config, wet_scene=SimpleNamespace(frame=FRAME), take_settings=self.take
        )
        self.exposures = []

    def take(self, config):
        self.conductor.config = config

    def draw(self, camera, state, camera_end=None, names=()):
        self.exposures.append(self.conductor.config.at(state.time).render.exposure)
        edge = camera.fx * -camera.position[0] / 4 + camera.cx  # px
        right = np.clip(np.arange(camera.width) + 1 - edge, 0, 1)
        light = np.broadcast_to(right[None, :, None], (camera.height, camera.width, 3))
        depth = np.full(light.shape[:2], 4 + state.time, np.float32)
        layers = {"beauty": light.astype(np.float32), "depth": depth}
        picture = np.rint(srgb.display(light) * 255).astype(np.uint8)
        return picture, FrameReport(state.index, state.time, {"draw": 1.0}, {}, (),
                                    {name: layers[name] for name in names})  # fmt: skip


def taken(optics, speed, names=("beauty", "depth")):
    """Return picture, report and renderer of the first frame of a camera that goes to the right."""
    cameras = [Camera(80, 6, 100.0, 100.0, 40.0, 3.0, np.eye(4), "a") for _ in range(2)]
    cameras[1].camera_from_world[0, 3] = -speed / 24
    config = Config().replace(fps=24.0, exposure=1 / 48, frames=2)
    scene = SimpleNamespace(actors=(), ground_frame=FRAME)
    renderer = EdgeRenderer(config)
    taking = Taking(optics, cameras, scene, config, names)
    shot = taking.drawn[0], Moment(0, 0.0), None if speed == 0 else cameras[1]
    return *next(taking.film(renderer, [shot])), renderer


def test_a_moving_edge_is_spread_over_its_path():
    """It covers v e f / z px, and its light goes evenly from 0 to 1 over them."""
    speed, samples = 30.0, 64
    way = speed / 48 * 100 / 4  # px: 15.6
    picture, report, renderer = taken(Optics(samples=samples), speed)
    light = report.aovs["beauty"][3, :, 0]
    columns = np.arange(80) + 0.5
    expected = np.clip((columns - (40 - way)) / way, 0, 1)
    assert np.abs(light - expected).max() < 0.05
    assert light.sum() == pytest.approx(expected.sum(), abs=0.05)
    dark = light < 0.5  # where the tone curve is that of sRGB: the mean is one of light
    assert np.abs(srgb.linear(picture[3, dark, 0] / 255) - light[dark]).max() < 0.01
    assert (report.aovs["depth"] == np.float32(4 + 1 / 96)).all()  # of the middle
    assert np.allclose(renderer.exposures, 1 / 48 / samples)
    assert renderer.conductor.config.render.exposure == 1 / 48  # as it was
    assert report.time == 0.0 and report.milliseconds["draw"] == samples + 1


def film(scene, config, optics, names=(), cameras=None):
    """Return the frames of some cameras, by default of the first."""
    terrain = pipeline.extract_terrain(scene, config)
    frames = pipeline.render_rain(
        scene, cameras or scene.cameras[:1], config, layers=names, terrain=terrain, optics=optics
    )
    return [(picture.copy(), report) for picture, report in frames]


def settings(**changes):
    usual = {"rate": mm_per_hour(60), "past": 4e-3, "extent": 1.0, "spacing": 0.05, "frames": 1}
    return Config.from_preset("downpour").replace(**{**usual, **changes})


def test_a_still_scene_keeps_its_bytes():
    scene, names = tiny_scene(), ("beauty", "rain_alpha", "clean")
    ((picture, report),) = film(scene, settings(), None, names)
    ((again, other),) = film(scene, settings(), Optics(samples=5), names)
    np.testing.assert_array_equal(again, picture)
    for name in names:
        np.testing.assert_array_equal(other.aovs[name], report.aovs[name])


def test_streaks_are_as_long_as_without_samples():
    """Something moves, the camera does not: as many pixels have a streak, and as much light is
    replaced. Streaks of twice the exposure cover far more."""
    scene, names = moving_scene(), ("rain_alpha", "actor_id")
    scene = replace(scene, cameras=(scene.cameras[0].resized(192, 144),))
    config = settings(exposure=1 / 60, fps=24.0)
    covered, replaced = [], []
    for optics, exposure in ((None, 1 / 60), (Optics(samples=6), 1 / 60), (None, 1 / 30)):
        ((_, report),) = film(
            scene, config.replace(exposure=exposure, reach_exposure=1 / 60), optics, names
        )
        assert (report.aovs["actor_id"] > 0).sum() > 100
        alpha = report.aovs["rain_alpha"][report.aovs["actor_id"] == 0]
        covered.append((alpha > 1e-4).sum())
        replaced.append(alpha.sum())
    assert covered[1] == pytest.approx(covered[0], rel=0.06)
    assert replaced[1] == pytest.approx(replaced[0], rel=0.06)
    assert covered[2] > 1.4 * covered[0] > 3000


def test_files_of_a_moving_camera_hold_the_mean(tmp_path):
    """The beauty is the mean; the rain laid over the scene gives it but for what they share."""
    exr_frame = pytest.importorskip("rainsim.render.exr_frame")
    scene, config = tiny_scene(), settings(frames=2, exposure=1 / 48, fps=24.0)
    exr = exr_frame.ExrFormat(24.0)
    cameras = walk(scene)
    terrain = pipeline.extract_terrain(scene, config)
    sequence = pipeline.FrameSequence(
        scene, terrain, cameras, config, layers=exr_frame.LAYERS, exr=exr, optics=Optics(samples=3)
    )
    picture, report = next(sequence.frames([0]))
    parts = exr_frame.parts_of(report)
    assert tuple(parts) == exr_frame.PARTS
    beauty = np.stack([parts["beauty"][c] for c in "RGB"], axis=-1).astype(np.float64)
    np.testing.assert_allclose(beauty, report.aovs["beauty"], rtol=2e-3, atol=1e-4)
    sharp = pipeline.FrameSequence(scene, terrain, cameras, config, layers=("beauty", "depth"))
    still = next(sharp.frames([0]))[1].aovs["beauty"]
    assert np.abs(still - beauty).mean() > 0.005  # it is blurred
    assert report.facts["weather"]["exposure_s"] == 1 / 48
    assert np.isfinite(parts["depth"]["Z"]).any() and parts["ids"]["class"].any()
    assert picture.shape == beauty.shape


def test_a_lens_bends_frames_and_layers_alike():
    scene, names = tiny_scene(), ("depth", "class_id", "range", "clean")
    ((picture, report),) = film(scene, settings(), Optics(lens=BENT), names)
    camera = scene.cameras[0]
    warp = lens_warp(camera, BENT)
    ((plain, wide),) = film(scene, settings(), None, names, [warp.wide])
    assert picture.shape == (camera.height, camera.width, 3) != plain.shape
    np.testing.assert_array_equal(picture, warp.colors(plain))
    np.testing.assert_array_equal(report.aovs["class_id"], warp.nearest(wide.aovs["class_id"]))
    np.testing.assert_array_equal(report.aovs["clean"], warp.colors(wide.aovs["clean"]))
    assert (report.aovs["range"] >= report.aovs["depth"])[np.isfinite(report.aovs["depth"])].all()


def test_glass_is_before_frames_and_not_before_layers():
    scene, names = tiny_scene(128, 96), ("clear_air", "depth")
    ((picture, report),) = film(scene, settings(), None, names)
    optics = Optics(pane=Pane(age=20.0, speed=15.0))
    ((behind, other),) = film(scene, settings(), optics, names)
    assert other.facts["drops_on_glass"] > 5
    assert 0.01 < (behind != picture).any(axis=-1).mean() < 1
    for name in names:
        np.testing.assert_array_equal(other.aovs[name], report.aovs[name])


def test_rolling_rows_are_those_of_their_time():
    scene, config = tiny_scene(), settings(frames=2, rate=0.0)
    shots = [film(scene, config, optics, (), walk(scene))[0][0]
             for optics in (None, Optics(readout=0.04))]  # fmt: skip
    change = np.abs(shots[1].astype(int) - shots[0]).mean(axis=(1, 2))
    assert change[:8].mean() < 0.5 * change[-8:].mean()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Optics(samples=0), "shutter samples is 0"),
        (lambda: Optics(readout=1.0), "at most 200 ms"),
        (
            lambda: Optics(readout=0.04).check("cuda", (), None, settings(fps=24.0)),
            "--rolling and exposure take .* within a frame, 41.7 ms",
        ),
        (
            lambda: Optics(readout=0.01).check("cpu", (), "exr", settings()),
            "leave out --exr or --rolling",
        ),
        (lambda: Optics(readout=0.01).check("cpu", ("flow",), None, settings()), "no layer flow"),
    ],
)
def test_what_cannot_be_had_is_one_line(make, message):
    with pytest.raises(ParameterError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_all_layers_are_a_mean_or_of_the_middle():
    from rainsim.sensors.optics import is_mean

    of_the_middle = {name for name in AOVS if not is_mean(name)}
    assert {"depth", "flow", "class_id", "rain_depth", "normal", "water_depth"} <= of_the_middle
    assert not of_the_middle & {"beauty", "dry", "glare", "rain_alpha", "fresnel", "clean"}
