"""Level from the cameras, and how far below them the ground lies."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_captures import patio, ring, splats_at
from rainsim.errors import GroundError
from rainsim.scene.cameras import look_at
from rainsim.scene.ground import estimate_ground_frame, require_known_scale
from rainsim.scene.ground_search import FROM_THE_AIR
from rainsim.scene.level import FEWEST, MISPLACED, GroundBelow, level_of

UP = np.array([0.0, 0.0, 1.0])


def degrees_off(up):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(up, UP)), up @ UP))


def walk(count=20, down=0.25, seed=0, sway=0.02):
    """Cameras along a street that look ahead and down, held with a roll of about a degree."""
    rng = np.random.default_rng(seed)
    found = []
    for n in range(count):
        eye = np.array([n * 1.5, 0.3 * np.sin(n), 1.6 + rng.normal(0, sway)])
        ahead = eye + np.array([1, rng.normal(0, 0.2), -down])
        lean = UP + np.array([0, rng.normal(0, 0.02), 0])
        found.append(look_at(eye, ahead, lean, 60, 64, 48, f"walk{n:02d}"))
    return found


def test_a_walk_is_level_although_all_cameras_look_down():
    level = level_of(walk(), 10.0)
    assert degrees_off(level.up) < 0.5 and np.degrees(level.deviation) < 1.5
    images_up = np.mean([camera.image_up for camera in walk()], axis=0)
    assert degrees_off(images_up / np.linalg.norm(images_up)) > 10  # where the fit starts from


def test_ground_seen_straight_down_from_afar_is_found_and_its_scale_asked_for():
    points = patio()
    cameras = [
        look_at((x, y, 40.0), (x, y, 0.0), (0.0, 1.0, 0.0), 60, 64, 48)
        for x in (-3.0, 0.0, 3.0) for y in (-2.0, 2.0)
    ]  # fmt: skip
    splats = points if hasattr(points, "opacity") else splats_at(points)
    frame = estimate_ground_frame(splats, cameras)
    assert degrees_off(frame.up) < 0.5 and FROM_THE_AIR in frame.notes
    with pytest.raises(GroundError, match="--camera-height M"):
        require_known_scale(frame, cameras)
    given = estimate_ground_frame(splats, cameras, camera_height=80.0)
    require_known_scale(given, cameras)
    assert given.meters_per_unit == pytest.approx(2.0, rel=0.02)
    walked = estimate_ground_frame(splats, ring())
    require_known_scale(walked, ring())  # those were carried
    assert FROM_THE_AIR not in walked.notes


@pytest.mark.parametrize("sideways", [range(20), range(0, 20, 3)])
def test_pictures_taken_with_the_camera_on_its_side(sideways):
    cameras = ring(count=20)
    for n in sideways:
        camera, turn = cameras[n], np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
        matrix = camera.camera_from_world.copy()
        matrix[:3] = turn @ matrix[:3]
        cameras[n] = type(camera)(48, 64, 50, 50, 24, 32, matrix)
    # All on their side, around something, have no up in common: that is for the splats to tell.
    level = level_of(cameras, 3.0)
    assert level is None if len(sideways) == 20 else degrees_off(level.up) < 0.5


def test_a_ring_at_uneven_heights_is_level_in_any_frame_and_none_of_it_is_misplaced():
    for seed in range(40):
        rng, turn = np.random.default_rng(seed), Rotation.random(None, seed).as_matrix()
        angle, away = np.linspace(0, 2 * np.pi, 24, endpoint=False), rng.uniform(4.6, 6.2, 24)
        height = 1.8 + rng.uniform(-0.3, 0.3, 24)
        height[5] += 8 * (seed % 2)
        eyes = np.stack([away * np.cos(angle), away * np.sin(angle), height], 1) @ turn.T
        cameras = [look_at(eye, turn @ (0, 0, 0.2), turn @ UP, 60, 64, 48) for eye in eyes]
        level = level_of(cameras, 6.0)
        assert degrees_off(turn.T @ level.up) < 1.5
        assert np.flatnonzero(level.weight < MISPLACED).tolist() == [5] * (seed % 2)


def test_cameras_on_a_tripod_are_level_by_their_hands_alone():
    jitter = np.random.default_rng(2).normal((0, 0, 1.5), 0.003, (12, 3))
    cameras = [
        look_at(eye, eye + np.array([np.cos(a), np.sin(a), -0.1]), UP, 60, 64, 48)
        for a, eye in zip(np.linspace(0, 6, 12), jitter, strict=True)
    ]
    assert degrees_off(level_of(cameras, 5.0).up) < 0.5


def test_a_survey_from_the_air_is_level_by_its_views_and_its_path():
    cameras = [
        look_at((x, y, 40.0), (x, y + 0.2, 0.0), (0, 1, 0), 60, 64, 48)
        for x in range(0, 40, 10)
        for y in range(0, 60, 10)
    ]
    assert degrees_off(level_of(cameras, 40.0).up) < 0.5


def test_a_front_seen_from_a_straight_path_is_not_the_ground():
    paving = np.stack(np.meshgrid(np.arange(-8, 8, 0.2), np.arange(-4, 4, 0.2)), -1).reshape(-1, 2)
    front = np.stack(np.meshgrid(np.arange(-4, 4, 0.1), np.arange(0, 5, 0.1)), -1).reshape(-1, 2)
    ground = np.column_stack([paving, 0 * paving[:, 0]])
    wall = np.column_stack([front[:, 0], 0 * front[:, 0] + 4, front[:, 1]])
    cameras = [
        look_at((x, -1.5, 1.7), (x + 1.5, 4, 1.2), UP, 60, 64, 48) for x in np.linspace(-5, 5, 14)
    ]
    splats = splats_at(np.concatenate([ground, wall]), scale=0.1)
    assert degrees_off(estimate_ground_frame(splats, cameras).up) < 0.5


def test_a_room_stands_on_its_floor():
    across = np.arange(0.05, 6, 0.1)
    floor = np.stack(np.meshgrid(across, across[:50], 0), -1).reshape(-1, 3)
    side = np.stack(np.meshgrid(across, 0, across[:28]), -1).reshape(-1, 3)
    end = np.stack(np.meshgrid(0, across[:50], across[:28]), -1).reshape(-1, 3)
    x, y, z = np.diag((6, 5, 2.8))
    room = [floor, floor + z, side, side + y, end, end + x]
    cameras = [
        look_at((3 + 1.8 * np.cos(a), 2.5 + 1.4 * np.sin(a), 1.5),
                (3 - 2 * np.cos(a), 2.5 - 2 * np.sin(a), 1.1), UP, 60, 64, 48)
        for a in np.linspace(0, 5.8, 12)
    ]  # fmt: skip
    found = estimate_ground_frame(splats_at(np.concatenate(room)), cameras, camera_height=1.5)
    assert degrees_off(found.up) < 0.5 and abs(found.to_ground(np.zeros(3))[2]) < 0.02


def test_too_few_cameras_tell_nothing():
    assert level_of(walk()[: FEWEST - 1], 5.0) is None
    assert level_of(walk()[:FEWEST], 5.0) is not None


def veiled(cameras, seed=1):
    """Points of ground that lies in veils before cameras, with walls on both sides of a street."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform((-3, -4, 0), (33, 4, 0), (4000, 3))
    ground[:, 2] = rng.normal(0, 0.12, len(ground))
    walls = rng.uniform((-3, 0, 0), (33, 0, 4), (4000, 3))
    walls[:, 1] = np.where(rng.random(4000) < 0.5, -4, 4) + rng.normal(0, 0.05, 4000)
    veils = [
        camera.position + rng.uniform((0.5, -1, -1.5), (4, 1, 1), (200, 3)) for camera in cameras
    ]
    return np.concatenate([ground, walls, *veils])


def test_the_height_of_a_path_over_ground_that_is_hidden_in_veils():
    cameras = walk()
    points = veiled(cameras)
    eyes = np.array([camera.position for camera in cameras])
    below = GroundBelow(points, np.ones(len(points)), eyes, UP)
    found = below.best(5.0)
    assert found.height == pytest.approx(1.6, rel=0.1) and found.sigmas > 4
    empty = GroundBelow(points + np.array([0, 0, 50.0]), np.ones(len(points)), eyes, UP)
    assert empty.best(5.0).sigmas < 1  # nothing lies below


def test_where_a_walk_shows_no_ground_the_plane_below_it_is_taken_and_said():
    rng = np.random.default_rng(5)
    cameras = walk()
    veils = [c.position + rng.uniform((0.5, -1.5, -2.5), (4, 1.5, 1), (300, 3)) for c in cameras]
    found = estimate_ground_frame(splats_at(np.concatenate(veils)), cameras, camera_height=1.6)
    assert degrees_off(found.up) < 1


def test_a_capture_in_veils_stands_on_the_ground_below_its_cameras():
    cameras = walk()
    found = estimate_ground_frame(splats_at(veiled(cameras)), cameras, camera_height=1.6)
    assert degrees_off(found.up) < 1 and found.meters_per_unit == pytest.approx(1, rel=0.12)
    # Where the ground is seen well the plane of its splats is the better level.
    patio_frame = estimate_ground_frame(splats_at(patio()), ring())
    assert "fitted to splats" in patio_frame.notes[0]
