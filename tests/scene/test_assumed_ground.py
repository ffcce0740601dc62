"""What is assumed of captures that do not say where up is, how long a metre is or what to see."""

import re
from dataclasses import replace

import numpy as np
import pytest

from made_captures import patio, ring, splats_at
from rainsim.commands.given import named_camera, scene_of, scene_to_look_at
from rainsim.errors import GroundError, ParameterError
from rainsim.scene.assumed_ground import assumed_ground_frame, ground_extent
from rainsim.scene.splat_sets import joined
from rainsim.scene.types import GroundFrame, Scene
from rainsim.shading.calibration import fixed_camera
from rainsim.surface import offered_views
from rainsim.surface.offered_views import offered_cameras
from rainsim.terrain.types import Grid

TURN = np.array([[0.0, 0.6, -0.8], [1.0, 0.0, 0.0], [0.0, -0.8, -0.6]])  # ground from capture


def capture(points, units=0.25):
    """Splats in a frame of their own, `units` to a metre."""
    return splats_at(points @ TURN * units, scale=0.02 * units)


def degrees(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


def test_a_bare_capture_gets_a_level_ground_a_scale_and_views_of_it():
    splats = capture(patio())
    frame = assumed_ground_frame(splats)
    assert degrees(frame.up, TURN[2]) < 0.5 and frame.scale_assumed
    assert frame.meters_per_unit * 0.25 == pytest.approx(0.85, abs=0.3)  # the patio is 10 m wide
    up, scale = frame.notes
    assert "UP IS ASSUMED" in up and "--up" in up
    assert "SCALE IS ASSUMED" in scale and "--meters-per-unit" in scale
    middle, width = ground_extent(splats, frame)
    assert re.search(r"the ground is [\d.]+ m by [\d.]+ m", scale) and (np.abs(width - 8) < 3).all()
    heights = frame.to_ground(splats.position)[:, 2]
    assert abs(np.median(heights)) < 0.15
    cameras = offered_cameras(Scene("bare", splats, (), frame))
    eyes = frame.to_ground(np.array([camera.position for camera in cameras]))
    assert 1 <= len(cameras) <= 8 and cameras[0].name == "view_00"
    assert (1.0 < eyes[:, 2]).all() and (eyes[:, 2] < 2.7).all()
    away = np.linalg.norm(eyes[:, :2] - middle, axis=1)
    assert 2 < away.min() and away.max() < 9
    ahead = [frame.rotation @ camera.forward for camera in cameras]
    to = np.append(middle, 0.0) - eyes
    assert (np.einsum("ni,ni->n", ahead, to / np.linalg.norm(to, axis=1)[:, None]) > 0.9).all()


@pytest.fixture(scope="module")
def one():
    """What is assumed of a capture in metres."""
    return assumed_ground_frame(capture(patio(), 1.0))


@pytest.mark.parametrize("units", [100.0, 0.01])
def test_what_is_assumed_does_not_depend_on_the_captures_unit(one, units):
    other = assumed_ground_frame(capture(patio(), units))
    assert other.meters_per_unit * units == pytest.approx(one.meters_per_unit, rel=1e-3)
    assert degrees(one.up, other.up) < 0.1
    assert one.notes[1].split("the ground is")[1] == other.notes[1].split("the ground is")[1]


def test_a_wall_is_no_ground_and_a_lawn_alone_is_level_by_the_usual_up():
    rng = np.random.default_rng(2)
    across, high = rng.uniform(-4, 4, 3000), rng.uniform(0, 3, 3000)
    wall = np.column_stack([across, 4 + rng.normal(size=3000) * 0.01, high])
    street = np.concatenate([patio(9000), wall])
    frame = assumed_ground_frame(capture(street))
    assert degrees(frame.up, TURN[2]) < 1
    lawn = rng.uniform(-4, 4, (9000, 3)) * (1, 0, 1) + rng.normal(size=(9000, 3)) * (0, 0.03, 0)
    frame = assumed_ground_frame(splats_at(lawn))  # nothing is above it nor below
    assert degrees(frame.up, np.array([0, -1, 0])) < 2 and frame.confidence > 0


def test_a_front_is_no_ground_where_that_is_hardly_captured():
    rng = np.random.default_rng(4)
    for wide, level in ((3, False), (12, True)):
        front = rng.uniform(-1, 1, (5000, 3)) * (wide, wide, 0)
        front += rng.normal(size=(5000, 3)) * 0.005
        before = rng.uniform(-1, 1, (5000, 3)) * (12, 12, 6) + (0, 0, 6)  # haze and things
        frame = assumed_ground_frame(splats_at(np.concatenate([front, before]) @ TURN))
        assert (degrees(frame.up, TURN[2]) < 1) == level
        assert ("no flat surface" in frame.notes[0]) == (not level)


def test_views_with_something_before_them_or_of_blurred_splats_are_not_offered():
    splats = capture(patio())
    frame = assumed_ground_frame(splats)
    scene = Scene("bare", splats, (), frame)
    tried = offered_views.tried_cameras(scene)
    clear = offered_views.scores(scene, tried)
    assert (clear > 0).all() and (clear <= 1).all()
    first = int(np.argmax(clear))
    camera = tried[first]
    middle = frame.to_capture(np.append(ground_extent(splats, frame)[0], 0.0))
    hangs = camera.position + 0.2 * (middle - camera.position)
    curtain = hangs + np.random.default_rng(0).normal(size=(300, 3)) * 0.02
    color = np.full((300, 1, 3), 1.5, np.float32)
    veil = replace(splats_at(curtain, scale=0.05, opacity=0.3), sh=color)
    hidden = replace(scene, splats=joined([splats, veil]))
    assert offered_views.scores(hidden, [camera])[0] < 0.3 * clear[first]
    coarse = replace(scene, splats=replace(splats, scale=8 * splats.scale))
    assert offered_views.scores(coarse, [camera])[0] < 0.8 * clear[first]


def test_what_is_given_counts_and_cameras_tell_the_scale():
    splats = capture(patio())
    given = assumed_ground_frame(splats, up=TURN[2] + 0.1, meters_per_unit=4.0)
    assert given.meters_per_unit == 4.0 and degrees(given.up, TURN[2]) < 0.5
    cameras = [
        GroundFrame(TURN, 4.0, np.zeros(3)).camera_in_capture(camera) for camera in ring(height=1.5)
    ]
    assert assumed_ground_frame(splats, cameras).meters_per_unit == pytest.approx(4.8, rel=0.1)


def test_without_any_flat_surface_the_usual_up_is_offered():
    rng = np.random.default_rng(3)
    ball = rng.normal(size=(4000, 3))
    frame = assumed_ground_frame(splats_at(ball))
    np.testing.assert_array_equal(frame.up, (0, -1, 0))
    assert frame.confidence == 0 and "no flat surface" in frame.notes[0]
    assert np.mean(frame.to_ground(ball)[:, 2] > 0) == pytest.approx(0.98, abs=0.005)
    with pytest.raises(GroundError, match="2 of the capture's 2 splats"):
        assumed_ground_frame(splats_at(ball[:2]))


def test_a_bare_file_is_read_with_what_is_assumed(tmp_path):
    from made_formats import splat_records

    path = tmp_path / "bare.splat"
    path.write_bytes(splat_records(capture(patio())))
    scene = scene_of(path, {})
    assert not scene.cameras and scene.ground_frame.scale_assumed
    assert degrees(scene.ground_frame.up, TURN[2]) < 0.5
    given = {"up": tuple(TURN[2]), "meters_per_unit": 4.0}
    known, is_offered = scene_to_look_at(path, given)
    assert not is_offered and known.ground_frame.meters_per_unit == 4.0
    assert not known.ground_frame.scale_assumed
    assert named_camera(scene, None).name == "view_00"
    with pytest.raises(ParameterError, match="view_00"):
        named_camera(scene, "elsewhere")


def test_a_capture_without_cameras_is_metered_from_its_surroundings_place():
    class Map:
        grid = Grid((100, 100), (-1.0, -1.0), 0.02)

    from rainsim.config.settings import Config

    frame = GroundFrame(TURN, 4.0, np.array([0.0, 0.0, 0.5]))
    scene = Scene("bare", capture(patio()), (), frame)
    config = Config().replace(surroundings=(0.4, 0.3, -0.2))
    camera = fixed_camera(scene, Map, config)
    np.testing.assert_allclose(camera.position, (0.4, 0.3, -0.2), atol=1e-9)
    seen = frame.camera_in_ground(camera)
    assert seen.forward @ -seen.position / np.linalg.norm(seen.position) > 0.999
    assert fixed_camera(scene, Map, Config()) is None
    assert fixed_camera(replace(scene, cameras=tuple(ring())), Map, config) is None
