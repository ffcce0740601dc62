"""What pixels gather of the drops that cross them, against a plain loop over samples."""

import numpy as np
import pytest

from rainsim.particles.drop_paths import DEPTH, DOWN, RIGHT, SAMPLES, WEIGHT, path_sums
from rainsim.particles.line_raster import NEAR
from rainsim.scene.types import Camera
from rainsim.scene.view import camera_points, image_point

FAR, DURATION, OPENED = 6.0, 0.04, 0.5


def camera_at(x, turn=0.0):
    """Return a camera of 24 x 16 px at (x, 0, 0) that looks along y, turned about z."""
    across = np.array([np.cos(turn), np.sin(turn), 0.0])
    along = np.array([-np.sin(turn), np.cos(turn), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = [across, [0, 0, -1], along]
    pose[:3, 3] = -pose[:3, :3] @ [x, 0, 0]
    return Camera(24, 16, 20.0, 21.0, 12.0, 8.0, pose)


def plain_sums(lines, cameras, depth, between):
    """Return what `path_sums` says, sample by sample."""
    sums = np.zeros((4, *depth.shape))
    for line in lines:
        places = line[:3], line[:3] + DURATION * line[3:6]
        seen = [camera_points(c, p[None])[0] for c, p in zip(cameras, places, strict=True)]
        if not all(z > NEAR for _, _, z in seen):
            continue
        first, last = (
            np.array([*image_point(c, *p), p[2]]) for c, p in zip(cameras, seen, strict=True)
        )
        for k in range(SAMPLES):
            u, v, z = first + OPENED * (k + 0.5) / SAMPLES * (last - first)
            inside = 0 <= u < depth.shape[1] and 0 <= v < depth.shape[0]
            if inside and between[0] <= z < min(FAR, between[1]) and z < depth[int(v), int(u)]:
                cover = (line[6] / first[2]) ** 2
                gathered = 1, z, *(last - first)[:2]
                sums[:, int(v), int(u)] += cover * np.array(gathered)
    return sums.reshape(4, -1)


def some_drops(count):
    """Return drops around the camera, also behind it, beyond FAR and beside the view."""
    rng = np.random.default_rng(5)
    place = rng.uniform([-4, -2, -3], [4, 9, 3], (count, 3))
    velocity = rng.normal([0, 0, -6], [1, 1, 2], (count, 3))
    return np.column_stack([place, velocity, rng.uniform(1e-3, 4e-3, count)])


@pytest.mark.parametrize("between", [(0.0, np.inf), (2.0, np.inf), (0.0, 2.0)])
def test_sums_are_those_of_a_plain_loop(between):
    depth = np.full((16, 24), np.inf, np.float32)
    depth[:, 12:] = 3.0  # a wall hides what is behind it
    cameras, lines = (camera_at(0.0), camera_at(0.3, 0.1)), some_drops(2000)
    found = path_sums(lines, DURATION, cameras, OPENED, depth, FAR, between)
    wanted = plain_sums(lines, cameras, depth, between)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-15)
    assert (wanted[WEIGHT] > 0).sum() > 20 and wanted[DOWN].max() > 0
    mean = wanted[DEPTH] / np.where(wanted[WEIGHT] > 0, wanted[WEIGHT], 1)
    behind = mean.reshape(16, 24)[:, 12:]
    assert behind.max() <= 3.0 < mean.max() or between[1] == 2.0


def test_drops_come_into_view_with_a_camera_that_turns():
    depth, beside = np.full((16, 24), np.inf, np.float32), np.array([[1.6, 2, 0, 0, 0, 0, 3e-3]])
    still, turning = camera_at(0.0), camera_at(0.0, -0.5)
    assert not path_sums(beside, DURATION, (still, still), 1.0, depth, FAR).any()
    sums = path_sums(beside, DURATION, (still, turning), 1.0, depth, FAR)
    assert sums[WEIGHT].any() and sums[RIGHT].sum() < 0


def test_what_is_no_number_crosses_nothing():
    depth, lines = np.full((16, 24), np.inf, np.float32), some_drops(30)
    cameras = camera_at(0.0), camera_at(0.0)
    before = path_sums(lines, DURATION, cameras, OPENED, depth, FAR)
    for column in range(6):
        bad = np.vstack([lines, lines[:1]])
        bad[-1, column] = np.nan
        found = path_sums(bad, DURATION, cameras, OPENED, depth, FAR)
        np.testing.assert_array_equal(found, before)
    assert before.any()
    hidden = path_sums(lines, DURATION, cameras, OPENED, np.zeros_like(depth), FAR)
    assert not hidden.any() and not path_sums(lines[:0], DURATION, cameras, 1.0, depth, FAR).any()
