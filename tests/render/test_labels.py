"""Labels: flow, range, classes, puddles and boxes mean what they say."""

from dataclasses import replace

import numpy as np
import pytest

from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.io.files import read_json
from rainsim.render import labels
from rainsim.render.frame_files import write_layers
from rainsim.render.labels import NO_FLOW, OCCLUDED, OUTSIDE, SEEN
from rainsim.render.renderer import Renderer
from rainsim.render.shutter import PathMotion, is_too_fast, motion_to_next, moved, next_camera
from rainsim.scene.types import Camera
from rainsim.scene.view import pixel_rays
from scenes import DIP_CENTRE, tiny_scene

CAMERA = Camera(96, 64, 80.0, 82.0, 47.0, 33.0, np.eye(4), "front")


def walls(camera):
    """Depth of a wall at z = 5 m before which a square of 1 m stands at z = 2 m."""
    rays = pixel_rays(camera) @ camera.camera_from_world[:3, :3]
    eye = camera.position
    depth = np.full(rays.shape[:2], np.inf)
    for z, half in ((5.0, 50.0), (2.0, 0.5)):
        way = (z - eye[2]) / rays[..., 2]
        x, y = (eye[k] + way * rays[..., k] for k in (0, 1))
        hit = (way > 0) & (np.abs(x) < half) & (np.abs(y) < half)
        depth = np.where(hit, np.minimum(depth, way), depth)
    return depth.astype(np.float32)


def test_flow_is_that_of_points_projected_one_by_one():
    after = moved(CAMERA, np.array([0.21, -0.05, 0.3]), np.array([0.01, -0.03, 0.02]))
    depth = walls(CAMERA)
    flow, mask = labels.flow_of(depth, CAMERA, after, walls(after))
    for row, column in ((3, 5), (30, 48), (60, 90), (33, 20)):
        u, v, z = column + 0.5, row + 0.5, float(depth[row, column])
        point = np.array([(u - 47) / 80 * z, (v - 33) / 82 * z, z, 1])
        x, y, w, _ = after.camera_from_world @ point
        expected = (80 * x / w + 47 - u, 82 * y / w + 33 - v)
        np.testing.assert_allclose(flow[row, column], expected, atol=1e-4)
    # What the square hides of the wall in the next picture, and nothing else, is occluded.
    assert set(np.unique(mask)) <= {SEEN, OCCLUDED, OUTSIDE}
    hidden = mask == OCCLUDED
    assert hidden.any() and (depth[hidden] == 5).all()
    v, u = np.mgrid[:64, :96] + 0.5
    u, v = u + flow[..., 0], v + flow[..., 1]
    shown = walls(after)[np.clip(v, 0, 63).astype(int), np.clip(u, 0, 95).astype(int)]
    assert (shown[hidden] < 3).all()
    wall = (mask == SEEN) & (depth == 5)
    assert np.mean(shown[wall] > 3) > 0.99


def test_flow_of_the_sky_is_the_turn_and_what_is_behind_has_none():
    turned = moved(CAMERA, np.array([3.0, 0, 0]), np.array([0, 0.02, 0]))
    sky = np.full((64, 96), np.inf, np.float32)
    flow, mask = labels.flow_of(sky, CAMERA, turned, sky)
    still, _ = labels.flow_of(sky, CAMERA, replace(CAMERA), sky)
    assert np.abs(still).max() < 1e-12
    middle = flow[32, 46]
    np.testing.assert_allclose(middle, [80 * np.tan(0.02), 0], atol=0.02)
    assert (mask[:, :-10] == SEEN).all()
    past = moved(CAMERA, np.array([0, 0, 2.5]), np.zeros(3))  # beyond the square
    flow, mask = labels.flow_of(walls(CAMERA), CAMERA, past, walls(past))
    square = walls(CAMERA) == 2
    assert (mask[square] == NO_FLOW).all() and not flow[square].any()


def test_boxes_hold_their_instances():
    ids = np.zeros((8, 9), np.uint16)
    ids[1:3, 2:6], ids[5, 0], ids[7, 8] = 40000, 7, 7
    assert labels.boxes_of(ids) == [
        {"id": 7, "box": [0, 5, 9, 8], "pixels": 2},
        {"id": 40000, "box": [2, 1, 6, 3], "pixels": 8},
    ]
    assert labels.boxes_of(np.zeros((3, 3), np.uint16)) == []


def test_the_next_camera_follows_from_the_shutter():
    path = [moved(CAMERA, k * np.array([0.1, 0.02, 0]), k * np.array([0, 0.03, 0.01]))
            for k in range(3)]  # fmt: skip
    end = PathMotion(path, 24).end(1, 1 / 60)
    found = next_camera(path[1], end, 24 / 60)
    np.testing.assert_allclose(found.camera_from_world, path[2].camera_from_world, atol=1e-9)
    far = moved(CAMERA, np.array([9.0, 0, 0]), np.zeros(3))
    assert is_too_fast(motion_to_next([CAMERA, far], 0), 24)
    assert PathMotion([CAMERA, far], 24).end(0, 1 / 60) is None
    assert not is_too_fast(motion_to_next([CAMERA], 0), 24)
    assert not is_too_fast(motion_to_next([CAMERA, CAMERA], 0), 24)


@pytest.fixture(scope="module")
def wet():
    """Scene, terrain, settings and the states of a small wet scene."""
    scene = tiny_scene()
    config = Config.from_preset("downpour").replace(
        past=6e-3, extent=1.0, spacing=0.025, frames=2, fps=10.0, streak_far=4.0
    )
    ground = pipeline.extract_terrain(scene, config)
    states = pipeline.simulate(ground, config)
    return scene, ground, config, [next(states) for _ in range(2)]


NAMES = ("depth", "range", "flow", "flow_mask", "class_id", "puddle_id", "splash_id", "normal",
         "coverage", "water_depth", "drop_flow")  # fmt: skip


@pytest.fixture(scope="module")
def pair(wet):
    """The reports of two frames of a moving camera, and the cameras in the ground frame."""
    scene, ground, config, states = wet
    first = scene.ground_frame.camera_in_ground(scene.cameras[0].resized(160, 120))
    path = [first, moved(first, np.array([0.05, -0.04, 0.01]), np.array([0.01, 0.02, -0.01]))]
    cameras = [scene.ground_frame.camera_in_capture(camera) for camera in path]
    drawn = pipeline.render(scene, ground, states, cameras, config, NAMES)
    return [report for _, report in drawn], path


def test_depth_and_flow_lead_to_the_same_places(pair):
    """A pixel's flow leads to a pixel of the next frame whose depth leads back, within half a px"""
    (one, two), (camera, after) = pair
    flow, mask = one.aovs["flow"].astype(float), one.aovs["flow_mask"]
    seen = (mask == SEEN) & np.isfinite(one.aovs["depth"])
    assert seen.mean() > 0.4
    v, u = np.mgrid[:120, :160] + 0.5
    u, v = (u + flow[..., 0])[seen], (v + flow[..., 1])[seen]
    column, row = np.clip(u - 0.5, 0, 158.999), np.clip(v - 0.5, 0, 118.999)
    i, j = column.astype(int), row.astype(int)
    a, b = column - i, row - j
    d = two.aovs["depth"].astype(float)
    corners = d[j, i], d[j, i + 1], d[j + 1, i], d[j + 1, i + 1]
    land = np.isfinite(corners).all(axis=0)
    assert land.mean() > 0.95
    c0, c1, c2, c3 = (np.where(land, corner, 1.0) for corner in corners)
    ahead = (c0 * (1 - a) + c1 * a) * (1 - b) + (c2 * (1 - a) + c3 * a) * b
    point = np.stack([(u - after.cx) / after.fx, (v - after.cy) / after.fy, np.ones_like(u)], -1)
    place = (point * ahead[:, None]) @ after.camera_from_world[:3, :3] + after.position
    x, y, z = (place @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]).T
    rows, columns = np.nonzero(seen)
    off = np.hypot(camera.fx * x / z + camera.cx - columns - 0.5,
                   camera.fy * y / z + camera.cy - rows - 0.5)[land]  # fmt: skip
    assert np.median(off) < 0.05
    assert np.mean(off < 0.5) > 0.97  # edges of things between two depths remain
    assert np.abs(flow[seen]).max() > 2  # the camera does move


def test_range_and_depth_agree(pair):
    (one, _), _ = pair
    depth, far = one.aovs["depth"], one.aovs["range"]
    land = np.isfinite(depth)
    assert (np.isfinite(far) == land).all() and (far[land] >= depth[land]).all()


def test_puddles_have_names_boxes_and_water(pair, wet):
    (one, two), _ = pair
    puddles, coverage = one.aovs["puddle_id"], one.aovs["coverage"]
    shown = puddles > 0
    assert shown.mean() > 0.005
    assert (coverage[shown] >= 0.5).all() and (one.aovs["water_depth"][shown] > 1e-3).all()
    assert set(np.unique(puddles[shown])) == {p["id"] for p in one.facts["puddles"]}
    # The dip's puddle is there, with the same id in both frames.
    ids, known = labels.puddle_map(wet[1], wet[3][0].depth)
    row, column, _ = wet[1].grid.cells(*DIP_CENTRE)
    dip = int(ids[row, column])
    assert dip in known and known[dip]["depth_m"] < 0.015
    assert dip in {p["id"] for p in one.facts["puddles"]} & {p["id"] for p in two.facts["puddles"]}


def test_classes_are_named_and_hold_water(pair):
    (one, _), _ = pair
    ids, names = one.aovs["class_id"], one.facts["classes"]
    assert {str(v) for v in np.unique(ids)} <= set(names)
    by_name = {name: ids == int(number) for number, name in names.items()}
    assert by_name["paving"].mean() > 0.1 and by_name["water"].any() and by_name["other"].any()
    assert (one.aovs["puddle_id"][by_name["water"]] > 0).mean() > 0.9
    assert "object" not in names and names["255"] == "other"


def test_the_weather_is_noted(pair, tmp_path):
    (one, _), _ = pair
    weather = one.facts["weather"]
    assert weather["rain_mm_per_hour"] == pytest.approx(50)
    assert weather["past_rain_mm"] == pytest.approx(6)
    assert 500 < weather["optical_range_m"] < 5000
    write_layers(tmp_path, one)
    noted = read_json(tmp_path / "layers/00000.json", "labels")
    assert noted["weather"] == weather and noted["rainsim_layers"] == 1


def test_a_cut_has_no_flow_and_a_still_camera_none_either(wet):
    scene, ground, config, states = wet
    cameras = [scene.cameras[0], scene.cameras[2]]
    cut = [r for _, r in pipeline.render(scene, ground, states, cameras, config.replace(fps=60.0),
                                         ("flow", "flow_mask"))]  # fmt: skip
    assert not cut[0].aovs["flow_mask"].any() and not cut[0].aovs["flow"].any()
    renderer = Renderer(scene, ground, config, cameras[0])
    _, report = renderer.draw(cameras[0], states[1], None, ("flow", "flow_mask"))
    assert not report.aovs["flow"].any() and (report.aovs["flow_mask"] == SEEN).all()


@pytest.mark.slow
def test_drops_move_with_the_camera(wet):
    scene, ground, config, states = wet
    first = scene.ground_frame.camera_in_ground(scene.cameras[0].resized(160, 120))
    renderer = Renderer(scene, ground, config, scene.cameras[0].resized(160, 120))
    camera = scene.cameras[0].resized(160, 120)
    _, still = renderer.draw(camera, states[1], None, ("drop_flow",))
    turned = moved(first, np.zeros(3), np.array([0, 0, 0.002]))
    _, turning = renderer.draw(camera, states[1], turned, ("drop_flow",))
    a, b = still.aovs["drop_flow"], turning.aovs["drop_flow"]
    both = np.abs(a).any(-1) & np.abs(b).any(-1)
    assert both.any() and np.abs(a - b)[both].max() > 0.05
