"""Rolling shutters: edges lean as their closed form says, drops shear, nothing else changes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import factories
from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.errors import ParameterError
from rainsim.raster import Rasterizer, prepare
from rainsim.render.renderer import Renderer
from rainsim.scene.types import Camera
from rainsim.scene.view import pixel_rays
from rainsim.sensors.rolling import (
    MOST_SHIFT,
    STILL,
    Motion,
    _speed_in,
    band,
    check_readout,
    draw_rolling,
)
from scenes import looking, moving_scene, tiny_scene


def edge_scene():
    """A bright half plane, its edge upright at x = 0, 4 m ahead, as small splats."""
    x, y = np.meshgrid(np.arange(0.01, 2.4, 0.02), np.arange(-1.6, 1.6, 0.02))
    n = x.size
    position = np.column_stack([x.ravel(), y.ravel(), np.full(n, 4.0)])
    return factories.splats(position, scale=0.012, opacity=0.99, color=1.0)


def edge_of(row):
    """Place of the edge in a row [px]: where the light reaches half."""
    k = int(np.argmax(row > 0.5))
    return k - 0.5 + (0.5 - row[k - 1]) / (row[k] - row[k - 1]) + 0.5


@pytest.mark.parametrize("speed", [1.5, -1.0])
def test_a_moving_upright_edge_leans(speed):
    """dx/dy = -f v T / (z H) px a row, with speed v, distance z, readout T and H rows."""
    camera = Camera(160, 120, 150.0, 150.0, 80.0, 60.0, np.eye(4), "a")
    motion = Motion(np.array([speed, 0, 0]), np.zeros(3))
    readout, rasterizer = 0.1, Rasterizer(prepare(edge_scene()))
    rows = [
        rasterizer.draw(begin, 0.05).color[..., 0]
        for top in range(0, 120, 4)
        for _, begin, _ in [band(camera, motion, readout, 0.001, top, top + 4)]
    ]
    picture = np.concatenate(rows)
    edges = np.array([edge_of(row) for row in picture[4:-4]])
    rows = np.arange(4, 116)
    slope, place = np.polyfit(rows, edges, 1)
    expected = -150 * speed * readout / (4.0 * 120)
    assert slope == pytest.approx(expected, rel=0.02)
    off = np.abs(edges - (slope * rows + place))
    assert off.max() < 0.2  # px: half a band of four rows, and how splats round an edge
    assert place + 60 * slope == pytest.approx(80 + 60 * expected, abs=0.5)


def test_a_band_is_of_its_middle_row():
    camera = Camera(64, 50, 60.0, 60.0, 32.0, 25.0, np.eye(4), "a")
    delay, begin, end = band(camera, STILL, 0.02, 0.01, 48, 50)
    assert (begin.height, begin.cy, end) == (2, 25.0 - 48, None)
    assert delay == pytest.approx(0.02 * 49 / 50)
    moving = Motion(np.array([1.0, 0, 0]), np.array([0, 0.1, 0]))
    delay, begin, end = band(camera, moving, 0.02, 0.01, 16, 32, first_row=-5, height=40)
    assert delay == pytest.approx(0.02 * (24 - 5) / 40)
    np.testing.assert_allclose(begin.position, [delay, 0, 0], atol=1e-12)
    np.testing.assert_allclose(end.position, [delay + 0.01, 0, 0], atol=1e-12)


def test_the_speed_of_a_picture_is_that_of_its_places():
    """By the places of points in the pictures of two cameras a moment apart."""
    camera = looking((0.3, -2.0, 1.0), (0.0, 0.5, 0.2), 40, 30)
    motion, dt = Motion(np.array([2.0, 3.0, -0.5]), np.array([0.3, -0.8, 0.2])), 1e-5
    depth = np.random.default_rng(3).uniform(2, 9, (30, 40)).astype(np.float32)
    depth[:5] = np.inf
    ray, turn = pixel_rays(camera), camera.camera_from_world[:3, :3]
    far = np.where(np.isfinite(depth), depth, 1e9)[..., None]
    place = camera.position + (ray * far) @ turn
    after = motion.at(camera, dt)
    x, y, z = np.moveaxis((place - after.position) @ after.camera_from_world[:3, :3].T, -1, 0)
    shift = np.hypot(camera.fx * (x / z - ray[..., 0]), camera.fy * (y / z - ray[..., 1])) / dt
    found = _speed_in(camera, motion, depth, SimpleNamespace(facts={}))
    assert found == pytest.approx(np.percentile(shift, 99), rel=1e-3)
    faster = _speed_in(camera, Motion(2 * motion.velocity, motion.turning), depth,
                       SimpleNamespace(facts={}))  # fmt: skip
    assert faster > 1.5 * found


def test_bands_are_lower_the_faster_the_camera(monkeypatch):
    """And no row is farther from where it belongs than it may be; a whole picture's are."""
    scene = tiny_scene(64, 96)
    config = Config.from_preset("drizzle").replace(extent=1.0, spacing=0.05, exposure=0.05)
    terrain = pipeline.extract_terrain(scene, config)
    state = next(pipeline.simulate(terrain, config))
    here = scene.ground_frame.camera_in_ground(scene.cameras[0])
    renderer, heights = Renderer(scene, terrain, config, scene.cameras[0]), []
    own = renderer.draw

    def noted(camera, *given):
        picture, report = own(camera, *given)
        heights.append(len(picture))
        return picture, report

    monkeypatch.setattr(renderer, "draw", noted)
    counts, found = [], []
    for speed in (0.0, 2.0, 8.0):
        motion = Motion(np.array([speed, 0.0, 0.0]), np.zeros(3))
        heights.clear()
        picture, report = draw_rolling(renderer, here, state, motion, 0.02, ("depth", "clean"))
        assert picture.shape == (96, 64, 3) and set(report.aovs) == {"depth", "clean"}
        counts.append(len(heights))
        tall = draw_rolling(renderer, here, state, motion, 0.02, ("clean",), rows=8)[1]
        apart = np.abs(tall.aovs["clean"].astype(int) - report.aovs["clean"])
        found.append((_speed_in(here, motion, report.aovs["depth"], report), apart.mean()))
    assert counts[0] <= 5 and counts[0] < counts[1] < counts[2] <= 13
    assert counts[2] >= 12 and max(apart for _, apart in found) < 1
    assert found[1][0] * 0.02 / 2 > 4 * MOST_SHIFT, "one band for all would be too high"


@pytest.mark.slow
def test_a_still_scene_is_the_same_and_drops_shear():
    scene = tiny_scene()
    config = Config.from_preset("downpour").replace(past=6e-3, extent=1.0, spacing=0.05)
    terrain = pipeline.extract_terrain(scene, config)
    state = next(pipeline.simulate(terrain, config))
    camera = scene.cameras[0].resized(96, 72)
    here = scene.ground_frame.camera_in_ground(camera)
    renderer = Renderer(scene, terrain, config, camera)
    names = ("depth", "rain_alpha", "class_id", "puddle_id", "coverage")
    _, whole = renderer.draw(camera, state, None, names)
    _, now = draw_rolling(renderer, here, state, STILL, 0.0, names)
    _, later = draw_rolling(renderer, here, state, STILL, 0.05, names)
    for report in (now, later):
        near = np.isclose(report.aovs["depth"], whole.aovs["depth"], rtol=1e-3)
        assert near.mean() > 0.995
        assert (report.aovs["class_id"] == whole.aovs["class_id"]).mean() > 0.99
    drops = [r.aovs["rain_alpha"] for r in (whole, now, later)]
    np.testing.assert_allclose(drops[1], drops[0], atol=0.02)  # drops in fog's far end by depth
    # The first band is as before, below the drops have moved on by their band's time.
    assert np.abs(drops[2] - drops[0])[64:].max() > 10 * np.abs(drops[1] - drops[0])[64:].max()
    assert {p["id"] for p in now.facts["puddles"]} == {p["id"] for p in whole.facts["puddles"]}


def test_an_actor_that_moves_leans_as_its_rows_are_read():
    """The box is in each band where it is at the band's time, and so are its labels."""
    scene = moving_scene()
    config = Config.from_preset("drizzle").replace(extent=1.0, spacing=0.05)
    terrain = pipeline.extract_terrain(scene, config)
    state = replace(next(pipeline.simulate(terrain, config)), time=0.4)
    camera = scene.cameras[0].resized(96, 72)
    here, names = scene.ground_frame.camera_in_ground(camera), ("actor_id", "clean")
    renderer = Renderer(scene, terrain, config, camera)
    readout = 0.2
    _, rolling = draw_rolling(renderer, here, state, STILL, readout, names, rows=24)
    chosen = draw_rolling(renderer, here, state, STILL, 0.02, ("clean",))[1]
    assert set(chosen.aovs) == {"clean"} and "actors" not in chosen.facts
    number, drawn = rolling.aovs["actor_id"], []
    for top in (0, 24, 48):
        rows = slice(top, top + 24)
        at = replace(state, time=0.4 + readout * (top + 12) / 72)
        _, whole = renderer.draw(camera, at, None, names)
        drawn.append(whole)
        assert (number[rows] == whole.aovs["actor_id"][rows]).mean() > 0.99
        apart = np.abs(rolling.aovs["clean"][rows].astype(int) - whole.aovs["clean"][rows])
        assert apart.mean() < 1
    assert (number != drawn[0].aovs["actor_id"]).sum() > 10  # it moves meanwhile
    (facts,) = rolling.facts["actors"]
    assert facts["pixels"] == (number == 1).sum() > 100
    left, top, right, bottom = facts["box2d"]
    seen = facts["box2d_seen"]
    assert left <= seen[0] and top <= seen[1] and seen[2] <= right and seen[3] <= bottom
    middle = int((top + bottom) / 2 // 24)
    assert facts["box3d"] == drawn[middle].facts["actors"][0]["box3d"]


def test_readouts_are_checked():
    check_readout(0.02)
    for readout, message in ((-0.1, "readout is -0.1"), (1.0, "at most 200 ms")):
        with pytest.raises(ParameterError, match=message):
            check_readout(readout)
