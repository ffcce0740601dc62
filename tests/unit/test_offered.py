"""What is offered for captures that do not say where up is, how long a metre is or what to see."""

from dataclasses import replace

import numpy as np
import pytest

from made_captures import patio, ring, splats_at
from rainsim.commands.choose import scene_of, scene_to_look_at
from rainsim.errors import GroundError
from rainsim.scene.offered import offered_cameras, offered_ground_frame
from rainsim.scene.types import GroundFrame, Scene
from rainsim.shading.calibration import fixed_camera
from rainsim.terrain.types import Grid

TURN = np.array([[0.0, 0.6, -0.8], [1.0, 0.0, 0.0], [0.0, -0.8, -0.6]])  # ground from capture


def capture(points, units=0.25):
    """Splats in a frame of their own, `units` to a metre."""
    return splats_at(points @ TURN * units, scale=0.02 * units)


def degrees(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


def test_a_bare_capture_gets_a_level_ground_a_scale_and_views_of_it():
    splats = capture(patio())
    frame = offered_ground_frame(splats)
    assert degrees(frame.up, TURN[2]) < 0.5 and frame.scale_assumed
    assert frame.meters_per_unit * 0.25 == pytest.approx(1.1, abs=0.4)  # the patio is 10 m wide
    assert "ASSUMED" in frame.notes[0] and "10 m wide" in frame.notes[0]
    heights = frame.to_ground(splats.position)[:, 2]
    assert abs(np.median(heights)) < 0.15
    cameras = offered_cameras(splats, frame)
    eyes = frame.to_ground(np.array([camera.position for camera in cameras]))
    np.testing.assert_allclose(eyes[:, 2], 1.6, atol=1e-9)
    away = np.linalg.norm(eyes[:, :2], axis=1)
    assert 4 < away.min() and away.max() < 11
    ahead = [frame.rotation @ camera.forward for camera in cameras]
    assert (np.einsum("ni,ni->n", ahead, -eyes / np.linalg.norm(eyes, axis=1)[:, None]) > 0.9).all()


def test_what_is_given_counts_and_cameras_tell_the_scale():
    splats = capture(patio())
    given = offered_ground_frame(splats, up=TURN[2] + 0.1, meters_per_unit=4.0)
    assert given.meters_per_unit == 4.0 and degrees(given.up, TURN[2]) < 0.5
    cameras = [
        GroundFrame(TURN, 4.0, np.zeros(3)).camera_in_capture(camera) for camera in ring(height=1.5)
    ]
    assert offered_ground_frame(splats, cameras).meters_per_unit == pytest.approx(4.0, rel=0.1)


def test_without_any_flat_surface_the_usual_up_is_offered():
    rng = np.random.default_rng(3)
    ball = rng.normal(size=(4000, 3))
    frame = offered_ground_frame(splats_at(ball))
    np.testing.assert_array_equal(frame.up, (0, -1, 0))
    assert frame.confidence == 0 and "no flat surface" in frame.notes[0]
    assert np.mean(frame.to_ground(ball)[:, 2] > 0) == pytest.approx(0.98, abs=0.005)
    with pytest.raises(GroundError, match="2 of the capture's 2 splats"):
        offered_ground_frame(splats_at(ball[:2]))


def test_a_scene_is_offered_a_frame_only_where_its_own_cannot_be_found(tmp_path):
    from made_formats import splat_records

    path = tmp_path / "bare.splat"
    path.write_bytes(splat_records(capture(patio())))
    with pytest.raises(GroundError, match="no cameras"):
        scene_of(path, {})
    scene, is_offered = scene_to_look_at(path, {})
    assert is_offered and not scene.cameras and degrees(scene.ground_frame.up, TURN[2]) < 0.5
    given = {"up": tuple(TURN[2]), "meters_per_unit": 4.0}
    scene, is_offered = scene_to_look_at(path, given)
    assert not is_offered and scene.ground_frame.meters_per_unit == 4.0


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
