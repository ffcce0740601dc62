"""Pieces that scenes are built of, against closed forms."""

import numpy as np
import pytest

import naive
from rainsim.demo_scenes import build
from rainsim.scene.types import GroundFrame

IDENTITY = GroundFrame(np.eye(3), 1.0, np.zeros(3))


def test_quaternions_give_their_matrices_back(rng):
    half_turns = [build.turn_about(axis, np.pi) for axis in np.eye(3)]
    matrices = [build.turn_about(rng.normal(size=3), rng.uniform(-4, 4)) for _ in range(50)]
    matrices = np.array([np.eye(3), *half_turns, *matrices])
    found = build.quaternions(matrices)
    for matrix, quaternion in zip(matrices, found, strict=True):
        np.testing.assert_allclose(naive.quaternion_matrix(quaternion), matrix, atol=1e-12)


def test_turn_about_turns_counter_clockwise():
    np.testing.assert_allclose(
        build.turn_about((0, 0, 1), np.pi / 2) @ (1, 0, 0), (0, 1, 0), atol=1e-15
    )


def test_cells_fill_the_length():
    for length, spacing in ((1.0, 0.1), (0.05, 0.02), (0.004, 0.02)):
        centre, width = build.cells(length, spacing)
        assert width.sum() == pytest.approx(length)
        np.testing.assert_allclose(centre, np.cumsum(width) - width / 2)
        assert (width > 0).all()


def test_disc_is_thin_along_its_normal(rng):
    normal = rng.normal(size=(20, 3))
    cloud = build.discs(rng.normal(size=(20, 3)), normal, (0.2, 0.3, 0.4), 0.05, along=(0, 0, 1))
    unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(cloud.normal, unit, atol=1e-6)
    product = cloud.axes @ cloud.axes.transpose(0, 2, 1)
    np.testing.assert_allclose(product, np.tile(np.eye(3), (20, 1, 1)), atol=1e-5)
    np.testing.assert_allclose(np.linalg.det(cloud.axes), 1, atol=1e-5)
    assert (cloud.scale[:, 2] < cloud.scale[:, :2].min(axis=1)).all()


def test_disc_whose_direction_is_its_normal_is_still_a_disc():
    cloud = build.discs(
        np.zeros((2, 3)), [(0, 0, 1), (1, 0, 0)], (1, 1, 1), 0.1, along=[(0, 0, 1), (1, 0, 0)]
    )
    np.testing.assert_allclose(np.linalg.det(cloud.axes), 1, atol=1e-6)


def test_tube_has_the_radius_asked_for():
    cloud = build.tube(
        [(0, 0, 0), (0, 0, 1), (0, 0, 2)], (0.1, 0.1, 0.2), (1, 0, 0), piece=0.05, around=12
    )
    radius = np.hypot(cloud.position[:, 0], cloud.position[:, 1])
    expected = np.interp(cloud.position[:, 2], (0, 1, 2), (0.1, 0.1, 0.2))
    np.testing.assert_allclose(radius, expected, atol=2e-3)
    outward = np.sum(cloud.normal[:, :2] * cloud.position[:, :2], axis=1) / radius
    np.testing.assert_allclose(outward, 1, atol=1e-5)


def test_box_faces_point_outwards_and_have_its_area():
    half = np.array([0.5, 0.2, 0.1])
    cloud = build.box((1, 2, 3), half, (1, 1, 1), spacing=0.02)
    local = cloud.position - (1, 2, 3)
    assert (np.abs(local) <= half + 1e-6).all()
    reach = np.sum(local * cloud.normal, axis=1)
    assert (reach > 0).all()
    area = np.sum(cloud.scale[:, 0] * cloud.scale[:, 1]) / 0.64**2
    assert area == pytest.approx(8 * (0.5 * 0.2 + 0.5 * 0.1 + 0.2 * 0.1), rel=1e-3)


def test_line_and_strands_lie_along_their_direction():
    cloud = build.line([(0, 0, 0), (1, 1, 0)], (0, 0, 0), 0.002, piece=0.1)
    np.testing.assert_allclose(
        cloud.axes[:, 0], np.tile([0.5**0.5, 0.5**0.5, 0], (14, 1)), atol=1e-6
    )
    upright = build.strands(np.zeros((3, 3)), (0, 0, 1), (0, 1, 0), 0.03, 0.002)
    np.testing.assert_allclose(np.abs(upright.axes[:, 0, 2]), 1, atol=1e-6)


def test_noise_is_smooth_and_has_no_mean(rng):
    noise = build.Noise(rng)
    points = rng.uniform(-20, 20, (20_000, 3))
    value = noise(points, 1.0, octaves=1)
    assert abs(value.mean()) < 0.02
    assert 0.15 < value.std() < 0.6
    step = noise(points + np.array([0.001, 0, 0]), 1.0, octaves=1) - value
    assert np.abs(step).max() < 0.01
    assert np.abs(step).max() > 0


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


def test_sky_share_beside_a_long_wall_is_half():
    """A wall without end takes half of the sky from the ground at its foot, by symmetry."""
    wall = np.array([[0.001, -1e5, 0, 0.002, 1e5, 1e5, 1.0]])
    share = build.sky_share(np.zeros((1, 3), np.float32), wall, build.sky_directions(2000))
    assert share[0] == pytest.approx(0.5, abs=0.01)


def test_light_scales_linear_colour():
    cloud = build.discs(np.zeros((1, 3)), (0, 0, 1), (0.5, 0.5, 0.5), 0.1)
    half = build.lit(cloud, np.array([0.5]))
    assert half.colour[0, 0] ** 2.2 == pytest.approx(0.5 * 0.5**2.2, rel=1e-5)


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


def colour_seen(splats, s, direction):
    """Colour of splat `s` from the original 3DGS formula for degree 1."""
    x, y, z = direction
    sh = splats.sh[s]
    return (
        0.5
        + 0.28209479177387814 * sh[0]
        + 0.4886025119029199 * (-y * sh[1] + z * sh[2] - x * sh[3])
    )


def test_sheen_brightens_grazing_views_only():
    cloud = build.discs(np.zeros((1, 3)), (0, 0, 1), (0.4, 0.2, 0.1), 0.1, sheen=0.5)
    splats = build.to_splats(cloud, IDENTITY)
    middle = np.array([3**0.5 / 2, 0, -0.5])
    np.testing.assert_allclose(colour_seen(splats, 0, middle), (0.4, 0.2, 0.1), atol=1e-6)
    np.testing.assert_allclose(colour_seen(splats, 0, (1, 0, 0)), (0.5, 0.25, 0.125), atol=1e-6)
    np.testing.assert_allclose(colour_seen(splats, 0, (0, 0, -1)), (0.3, 0.15, 0.075), atol=1e-6)


def test_join_and_moved_keep_order_and_shape():
    one = build.discs(np.zeros((2, 3)), (0, 0, 1), (1, 0, 0), 0.1)
    two = build.moved(one, build.turn_about((1, 0, 0), np.pi / 2), (0, 0, 5))
    both = build.join([one, two])
    assert len(both) == 4
    np.testing.assert_allclose(both.position[2:, 2], 5)
    np.testing.assert_allclose(both.normal[2:], [[0, -1, 0]] * 2, atol=1e-6)
