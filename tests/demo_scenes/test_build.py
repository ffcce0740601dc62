"""Pieces that scenes are built of, against closed forms."""

import numpy as np
import pytest

import naive
from rainsim.demo_scenes import build
from rainsim.scene.types import GroundFrame


def test_quaternions_give_their_matrices_back(rng):
    half_turns = [build.turn_about(axis, np.pi) for axis in np.eye(3)]
    matrices = [build.turn_about(rng.normal(size=3), rng.uniform(-4, 4)) for _ in range(50)]
    matrices = np.array([np.eye(3), *half_turns, *matrices])
    found = build.quaternions(matrices)
    for matrix, quaternion in zip(matrices, found, strict=True):
        np.testing.assert_allclose(naive.quaternion_matrix(quaternion), matrix, atol=1e-12)


def test_sky_share_of_open_ground_and_under_a_roof():
    directions = build.sky_directions(400)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-6)
    points = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]], np.float32)
    roof = np.array([[-1000, -1000, 1, 50, 1000, 2, 1.0]])
    share = build.sky_share(points, roof, directions)
    assert share[0] < 0.02
    assert share[1] > 0.95
    half = build.sky_share(
        points[:1], np.array([[-1000, -1000, 1, 1000, 1000, 2, 0.5]]), directions
    )
    assert half[0] == pytest.approx(0.5, abs=1e-5)


def test_to_splats_takes_place_size_and_axes_to_the_capture_frame(rng):
    rotation = build.turn_about(rng.normal(size=3), 1.1)
    frame = GroundFrame(rotation, 0.6, np.array([1.0, -2.0, 0.5]))
    cloud = build.discs(rng.normal(size=(9, 3)), rng.normal(size=(9, 3)), (0.3, 0.5, 0.7), 0.06)
    splats = build.to_splats(cloud, frame)
    np.testing.assert_allclose(frame.to_ground(splats.position), cloud.position, atol=1e-5)
    np.testing.assert_allclose(splats.scale * 0.6, cloud.scale, rtol=1e-5)
    for quaternion, axes in zip(splats.rotation, cloud.axes, strict=True):
        turned = rotation @ naive.quaternion_matrix(quaternion)
        np.testing.assert_allclose(turned, axes.T, atol=1e-5)
