"""The march through the depth buffer against rays whose hits are known."""

import numpy as np
import pytest

from rainsim.jit import serial_kernel
from rainsim.ssr import block_bounds, bounds_of, edge_fade, march

WIDTH, HEIGHT, FOCAL = 200, 150, 160.0
LENS = np.array([FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2], np.float32)


@serial_kernel
def march_once(depth, bounds, lens, start, direction, thickness, stride, farthest):
    return march(
        depth, bounds, lens, start[0], start[1], start[2], direction[0], direction[1], direction[2],
        thickness, stride, farthest,
    )  # fmt: skip


def find(depth, start, direction, thickness=0.15, stride=1.0, farthest=30.0):
    start = np.asarray(start, np.float32)
    direction = np.asarray(direction, float)
    direction = (direction / np.linalg.norm(direction)).astype(np.float32)
    rest = LENS, start, direction, np.float32(thickness), np.float32(stride), np.float32(farthest)
    bounds = np.full(bounds_of(*depth.shape), np.nan, np.float32)
    block_bounds(depth, bounds)
    found = march_once(depth, bounds, *rest)
    wide = np.zeros_like(bounds)
    wide[..., 1] = np.inf
    assert found == march_once(depth, wide, *rest)  # which never jumps
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
    values = [edge_fade(np.float32(u), np.float32(75), w, np.float32(150), share)
              for u in (0, 10, 20, 100, 190, 200)]  # fmt: skip
    np.testing.assert_allclose(values, [0, 0.5, 1, 1, 0.5, 0], atol=1e-6)
