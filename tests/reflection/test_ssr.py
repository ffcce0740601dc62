"""The march through the depth buffer against rays whose hits are known."""

import numpy as np
import pytest

from rainsim import ssr
from rainsim.jit import serial_kernel
from rainsim.scene.view import View

WIDTH, HEIGHT, FOCAL = 200, 150, 160.0
VIEW = View(
    np.eye(3, dtype=np.float32), np.zeros(3, np.float32),
    *np.float32([FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2]),
)  # fmt: skip


@serial_kernel
def march_once(blocks, view, start, direction, settings):
    return ssr.march(
        blocks, view, (start[0], start[1], start[2]), (direction[0], direction[1], direction[2]),
        settings,
    )  # fmt: skip


def find(depth, start, direction, thickness=0.15, stride=1.0, farthest=30.0):
    start = np.asarray(start, np.float32)
    direction = np.asarray(direction, float)
    direction = (direction / np.linalg.norm(direction)).astype(np.float32)
    settings = ssr.MarchSettings(*np.float32([thickness, stride, farthest]))
    bounds = np.full(ssr.bounds_of(*depth.shape), np.nan, np.float32)
    ssr.block_bounds(depth, bounds)
    found = march_once(ssr.DepthBlocks(depth, bounds), VIEW, start, direction, settings)
    wide = np.zeros_like(bounds)
    wide[..., 1] = np.inf
    steps = march_once(ssr.DepthBlocks(depth, wide), VIEW, start, direction, settings)
    assert found == steps  # a march that never jumps
    return found


def wall(z=5.0):
    return np.full((HEIGHT, WIDTH), z, np.float32)


@pytest.mark.parametrize("direction", [(0, -0.2, 1), (0.3, -0.1, 1), (-0.4, 0.2, 1), (0, -1, 1)])
@pytest.mark.parametrize("stride", [1.0, 2.0, 4.0])
def test_hits_a_wall_at_the_exact_distance(direction, stride):
    start = np.array([0.1, 0.6, 3.0])
    d = np.asarray(direction, float) / np.linalg.norm(direction)
    exact = (5.0 - start[2]) / d[2]
    distance = find(wall(), start, direction, stride=stride)
    end = start + d * exact
    seen = abs(end[0] / end[2]) < 0.6 and abs(end[1] / end[2]) < 0.45
    if seen:
        # One step in the picture is this long in space; bisection leaves a sixteenth of it.
        assert distance == pytest.approx(exact, rel=0.02 * stride)
    else:
        assert distance < 0


def test_mirror_plane_with_a_known_hit():
    """Level water 1.5 m below the camera mirrors the point of a wall that geometry says."""
    for row in (90, 110, 140):
        ray = np.array([0.02, (row + 0.5 - HEIGHT / 2) / FOCAL, 1.0])
        point = ray * (1.5 / ray[1])  # y is down
        if point[2] > 8:
            continue
        mirrored = ray * (1, -1, 1)
        distance = find(wall(8.0), point, mirrored)
        exact = (8.0 - point[2]) * np.linalg.norm(mirrored)
        assert distance == pytest.approx(exact, rel=0.02)


def test_leaves_the_picture_or_meets_nothing():
    assert find(wall(np.inf), (0, 0.5, 3), (0, -0.1, 1)) < 0
    assert find(wall(5.0), (0, 0.5, 3), (0, -5, 0.1)) < 0
    assert find(wall(50.0), (0, 0.5, 3), (0, -0.01, 1), farthest=10.0) < 0


def test_a_ray_towards_the_camera_ends_before_it():
    assert find(wall(np.inf), (0, 0.1, 3), (0, 0, -1)) < 0
    depth = wall(np.inf)
    depth[:, :] = 2.0
    distance = find(depth, (0.4, 0.3, 3.0), (-0.2, -0.1, -1), thickness=5.0)
    assert distance == -1 or distance > 0  # never NaN, never an endless loop


def test_passes_behind_foreground_thinner_than_the_gap():
    """A post stands in front of the ray: the ray goes on behind it and meets the wall."""
    depth = wall(6.0)
    depth[:, 105:115] = 1.0
    start, direction = (-0.3, 0.3, 3.0), (0.35, -0.1, 1)
    assert find(depth, start, direction) == pytest.approx(find(wall(6.0), start, direction))


def test_interval_test_cannot_step_through_a_thin_sheet():
    """At grazing angles one pixel of march is more than the point test's 3 cm."""
    depth = wall(np.inf)
    depth[76:83] = 9.0
    start = np.array([0.0, 1.5, 4.0])
    d = np.array([0.0, -0.25, 1.0])
    hit = find(depth, start, d, thickness=0.03, stride=4.0)
    assert hit == pytest.approx(5.0 * np.linalg.norm(d), rel=0.1)


def test_nan_depth_is_no_hit():
    assert find(wall(np.nan), (0, 0.5, 3), (0, -0.1, 1)) < 0


def test_jumps_end_where_steps_do(rng):
    """Posts of many widths on ground that cannot be hit, seen along many rays; see `find`."""
    depth = wall(np.inf)
    for column, width, far in zip(range(8, 190, 14), (1, 2, 3, 5) * 4, (4, 6, 9) * 5, strict=False):
        depth[20:95, column : column + width] = far
    found = [
        find(depth, (x, 0.8, 3.0), (dx, -0.15 - dy, 1), stride=stride)
        for x, dx, dy, stride in zip(
            rng.uniform(-1, 1, 200), rng.normal(0, 0.4, 200), rng.uniform(0, 0.4, 200),
            (1.0, 1.35, 3.0, 20.0) * 50, strict=True,
        )
    ]  # fmt: skip
    assert 0.1 < np.mean(np.array(found) > 0) < 0.9


def test_rounding_does_not_choose_the_pixel(rng):
    """Level water mirrors straight up: what a ray starts from may be off in the last digit."""
    depth = wall(np.inf)
    depth[20:60] = rng.uniform(3.5, 9, (40, WIDTH)).astype(np.float32)
    shares = 1 + 1e-6 * rng.normal(size=(4, 3))
    for column, row in rng.integers((20, 90), (180, 140), (100, 2)):
        ray = np.array([(column + 0.5) / FOCAL - 0.625, (row + 0.5) / FOCAL - 0.46875, 1.0])
        start = 3 * ray
        found = [find(depth, start * share, ray * (1, -1, 1), thickness=5.0) for share in shares]
        np.testing.assert_allclose(found, found[0], rtol=1e-4)


def test_edge_fade():
    w = np.float32(200)
    share = np.float32(0.1)
    values = [ssr.edge_fade(np.float32(u), np.float32(75), w, np.float32(150), share)
              for u in (0, 10, 20, 100, 190, 200)]  # fmt: skip
    np.testing.assert_allclose(values, [0, 0.5, 1, 1, 0.5, 0], atol=1e-6)


def floor_and_wall(far=8.0):
    """Depth of level ground 1.5 m below the camera up to a wall."""
    row = np.arange(HEIGHT)[:, None] + 0.5
    with np.errstate(divide="ignore"):
        ground = 1.5 * FOCAL / (row - HEIGHT / 2)
    depth = np.where((ground > 0) & (ground < far), ground, far)
    return np.ascontiguousarray(np.broadcast_to(depth, (HEIGHT, WIDTH)), np.float32)


def test_a_grazing_ray_leaves_the_ground_it_starts_from():
    depth = floor_and_wall()
    for slope in (0.2, 0.05, 0.02):
        found = find(depth, (0.1, 1.5, 4.0), (0, -slope, 1), thickness=0.03)
        assert found == pytest.approx(4.0 * np.hypot(1, slope), rel=0.02)  # the wall
    down = find(depth, (0.1, 1.3, 4.0), (0, 0.1, 1), thickness=0.03)
    assert down == pytest.approx(2.0 * np.hypot(1, 0.1), rel=0.05)  # the ground


def test_a_ray_along_the_picture_plane_meets_what_stands_at_its_depth():
    depth = wall(np.inf)
    depth[:, 140:150] = 3.0
    exact = (140 - WIDTH / 2) / FOCAL * 3.0
    assert find(depth, (0, 0.2, 3.0), (1, 0, 0)) == pytest.approx(exact, rel=0.02)
    depth[:, 140:150] = 4.0
    assert find(depth, (0, 0.2, 3.0), (1, 0, 0)) < 0
    assert find(depth, (0, 0.2, 3.0), (-1, 0, 0)) < 0


def test_a_ray_towards_the_camera_meets_a_sheet_from_behind_or_ends_at_the_near_plane():
    depth = wall(np.inf)
    depth[:, 60:100] = 1.5
    start, towards = np.array([0.3, 0.3, 3.0]), np.array([-0.25, -0.1, -1.0])
    exact = 1.5 * np.linalg.norm(towards)
    assert find(depth, start, towards) == pytest.approx(exact, abs=0.2)  # its thickness, a step
    assert find(depth, start, towards * (-1, 1, 1)) < 0  # beside it
    assert find(wall(np.inf), start, towards) < 0
    assert find(wall(0.06), (0.01, 0.01, 3.0), (0, -0.001, -1)) < 3.0  # NEAR: ends there


@pytest.mark.parametrize("column, row", [(0.01, 75), (199.99, 75), (100, 0.01), (100, 149.99)])
def test_a_ray_that_starts_on_the_edge_of_the_picture(column, row):
    point = 3 * np.array([(column - WIDTH / 2) / FOCAL, (row - HEIGHT / 2) / FOCAL, 1.0])
    inward = np.array([0.0, 0.0, 0.6]) - 0.2 * point * (1, 1, 0)
    exact = (5 - 3) / 0.6 * np.linalg.norm(inward)
    assert find(wall(), point, inward) == pytest.approx(exact, rel=0.03)
    outward = inward * (-1, -1, 1) + 2 * point * (1, 1, 0)
    assert find(wall(), point, outward) < 0
    assert find(wall(), point * (1.5, 1.5, 1), inward) < 0  # it starts outside: nothing is known


def test_a_thin_post_is_met_and_a_step_in_depth_is_no_surface():
    depth = wall(np.inf)
    depth[:, 120:122] = 4.0  # a step may pass within one pixel before the ray gets there
    start = np.array([0.0, 0.4, 3.0])
    towards = np.array([(120.5 - WIDTH / 2) / FOCAL * 4 - start[0], -0.1, 1.0])
    exact = np.linalg.norm(towards)
    assert find(depth, start, towards) == pytest.approx(exact, rel=0.03)
    assert find(wall(np.inf), start, towards) < 0
    step = wall(8.0)
    step[:, :110] = 4.0  # a near wall on the left, whose edge the ray passes behind
    start, across = np.array([0.1, 0.4, 5.0]), np.array([0.6, -0.1, 1.0])
    assert find(step, start, across) == pytest.approx(3 * np.linalg.norm(across), rel=0.02)
    assert find(step, start, across, thickness=2.0) < 1.5  # so thick that it is met there


@pytest.mark.parametrize("hole", [np.nan, np.inf])
def test_holes_in_the_depth_stop_no_ray(hole):
    depth = wall(5.0)
    direction = np.array([0.5, -0.1, 1])
    exact = 2 * np.linalg.norm(direction)
    assert find(depth, (0.1, 0.3, 3), direction) == pytest.approx(exact, rel=0.02)
    depth[:, 105:150] = hole  # where it would meet the wall
    behind = find(depth, (0.1, 0.3, 3), direction)
    assert behind < 0 or behind > 1.05 * exact
    assert find(depth, (0.1, 0.3, 3), direction, thickness=3.0) > 1.05 * exact  # past the hole


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (1, 40), (40, 1)])
def test_pictures_of_next_to_nothing(shape):
    for direction in ((0, -0.2, 1), (1, 0, 0), (0, 0, -1)):
        distance = find(np.full(shape, 5.0, np.float32), (0.1, 0.3, 3.0), direction)
        assert distance == -1 or distance > 0


@pytest.mark.parametrize("z", [0.0, -2.0, np.nan, 1e-30])
def test_a_start_that_the_camera_cannot_see_finds_nothing(z):
    for direction in ((0.1, -0.2, 1), (1, 0, 0), (0.1, 0.2, -1)):
        assert find(wall(), (0.1, 0.3, z), direction) < 0
    assert find(wall(), (0.1, 0.3, 3.0), (0.1, -0.2, 1)) > 0
    with np.errstate(invalid="ignore"):
        assert find(wall(), (0.1, 0.3, 3.0), (np.nan, 0, 1)) < 0
