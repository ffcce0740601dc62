"""Cameras that move while the shutter is open, and lenses that focus: rain as they show it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rainsim.drops import RainField, RainSpectrum
from rainsim.errors import ParameterError
from rainsim.particles.line_raster import NEAR
from rainsim.particles.shutter_view import seen_air, shutter_view
from rainsim.particles.streaks import draw_streaks
from rainsim.rain.size_distribution import CLASSES, LARGEST
from rainsim.render.shutter import PathMotion, is_too_fast, motion_to_next, moved
from rainsim.scene.types import Camera
from rainsim.scene.view import corner_rays

FOCAL = 500.0
DRY = RainField(RainSpectrum(0.0))


def looking(eye=(0.0, 0.0, 0.0), yaw=0.0, size=200):
    """A camera that looks along x, turned by `yaw` [rad] to the left."""
    turn = (
        np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]]) @ Rotation.from_euler("z", -yaw).as_matrix()
    )
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, -turn @ np.array(eye, dtype=np.float64)
    return Camera(size, size, FOCAL, FOCAL, size / 2, size / 2, matrix)


def drop(position, velocity, camera, exposure=1 / 60, diameter=1e-3, **lens):
    lines = np.array([[*position, *velocity, diameter]], np.float64)
    return listed(lines, camera, exposure, **lens)


def listed(lines, camera, exposure, **lens):
    alpha = np.full((camera.height, camera.width), np.nan, np.float32)
    depth = np.full_like(alpha, np.inf)
    draw_streaks(DRY, None, camera, 0.0, exposure, depth, NEAR, alpha, more=lines, **lens)
    return alpha


def project(camera, point):
    p = camera.camera_from_world[:3] @ np.append(point, 1.0)
    return camera.fx * p[0] / p[2] + camera.cx, camera.fy * p[1] / p[2] + camera.cy


def test_all_frames_of_a_path_move_as_each_of_them():
    """One stands still and one ends in a cut."""
    places = (0.0, 0.1, 0.1, 0.3, 50.0, 50.1)
    path = [looking((x, 0.02 * x, 0), yaw=0.1 * min(x, 1.0)) for x in places]
    along = PathMotion(path, 24.0)
    assert along.cuts == [is_too_fast(motion_to_next(path, k), 24.0) for k in range(len(path))]
    assert along.cuts.index(True) == 3 and sum(along.cuts) == 1
    for k in range(len(path)):
        found = along.end(k, 1 / 48)
        assert (found is None) == (k in (1, 3))
        if found is not None:
            wanted = moved(path[k], *(0.5 * part for part in motion_to_next(path, k)))
            np.testing.assert_allclose(found.camera_from_world, wanted.camera_from_world)
    longer = along.end(0, 1 / 24)
    np.testing.assert_allclose(longer.camera_from_world, path[1].camera_from_world, atol=1e-12)


def world_points(camera, far):
    """Where the eye and the corners of the picture are at each depth, (len(far), 5, 3)."""
    rays = np.concatenate([np.zeros((1, 3)), corner_rays(camera)])
    return far[:, None, None] * (rays @ camera.camera_from_world[:3, :3]) + camera.position


@pytest.mark.parametrize("lens", [(0.0, np.inf), (0.02, 1.5)])
def test_the_seen_air_is_the_least_that_holds_what_the_cameras_see(lens):
    field = RainField(RainSpectrum(2.0), (0.5, -1.0), seed=4, offset=(0.3, 0.2))
    path = [looking((0.3, 0.1, 1.6)), looking((0.35, 0.1, 1.7), yaw=0.06)]
    time, exposure, far = 3.0, 1 / 48, np.linspace(2.0, 12.0, CLASSES)
    around = LARGEST + lens[0] * np.maximum(far / lens[1], 1.0)
    found = {}
    for end in (None, PathMotion(path, 24.0).end(0, exposure)):
        view = shutter_view(path[0], time, exposure, end, *lens)
        air = found[end is None] = seen_air(field, path[0], view, far, *lens)
        begin = world_points(path[0], far)
        close = begin if end is None else world_points(end, far)
        both = np.concatenate([begin, close], axis=1)
        moves = np.linalg.norm(close - begin, axis=2).max(axis=1)
        slack = air.slack - around
        assert (slack >= moves - 1e-12).all() and (slack <= 2 * moves + 1e-12).all()
        # The air comes along with the drops, from where they are as the shutter opens.
        fall = field.velocity * exposure
        for cube, edge, way in ((air.first, both.min(axis=1), -1), (air.last, both.max(axis=1), 1)):
            edge = edge + way * (around[:, None] + np.maximum(-way * fall, 0.0))
            frame = np.zeros((CLASSES, 3))
            frame[:, :2] = 0.3, 0.2
            wanted = np.floor((edge - field.velocity * time - frame) / field.cube[:, None])
            np.testing.assert_array_equal(cube, wanted)
    assert (found[True].slack < found[False].slack).all()
    assert (found[True].last < found[False].last).any()


def test_a_streak_begins_and_ends_where_the_moving_camera_sees_the_drop():
    """Both ends within half a pixel, for a camera that moves and turns; so in two such cameras."""
    exposure, velocity = 1 / 60, np.array([0.5, 0.3, -6.0])
    start = np.array([3.0, 0.04, 0.05])
    for path in (
        [looking((0, 0, 0)), looking((0.1, 0.05, 0.0), yaw=0.02)],
        [looking((0.2, 0.1, -0.05), yaw=0.03), looking((0.2, 0.16, 0.0), yaw=0.01)],
    ):
        end = PathMotion(path, 24.0).end(0, exposure)
        alpha = drop(start, velocity, path[0], exposure, camera_end=end)
        ends = np.array([project(path[0], start), project(end, start + velocity * exposure)])
        v, u = (np.indices(alpha.shape) + 0.5) * alpha.astype(float) / alpha.sum()
        middle = ends.mean(axis=0)
        assert u.sum() == pytest.approx(middle[0], abs=0.1)
        assert v.sum() == pytest.approx(middle[1], abs=0.1)
        in_row = alpha.sum(axis=1)
        rows = np.flatnonzero(in_row > 0.5 * np.median(in_row[in_row > 0]))
        assert rows[0] + 0.5 == pytest.approx(ends[:, 1].min(), abs=1.0)
        assert rows[-1] + 0.5 == pytest.approx(ends[:, 1].max(), abs=1.0)
        still = drop(start, velocity, path[0], exposure)
        assert np.abs(alpha - still).max() > 0.2 * still.max()


def test_a_field_seen_by_a_turning_camera_is_the_field_of_drawn_drops():
    field = RainField(RainSpectrum(2.0), (0.5, 1.0), seed=4)
    path = [looking(), looking((0.05, 0.0, 0.1), yaw=0.06)]
    end = PathMotion(path, 24.0).end(0, 1 / 60)
    drops = field.drops_in_box(3.0, (-1, -3, -3), (4.0, 3, 3))
    z = drops.position[:, 0]
    seen = (z > 0.3) & (z < 3.0)
    alpha = np.full((200, 200), np.nan, np.float32)
    depth = np.full_like(alpha, np.inf)
    draw_streaks(field, None, path[0], 3.0, 1 / 60, depth, 3.0, alpha, end)
    lines = np.column_stack([drops.position, drops.velocity, drops.diameter])[seen]
    single = listed(lines, path[0], 1 / 60, camera_end=end)
    np.testing.assert_allclose(alpha, single, atol=2e-5)
    assert alpha.max() > 1e-3


# ---- lenses


@pytest.mark.parametrize("velocity", [(0, 0, 0), (0, 0, -6.0), (0, 5.0, -5.0)])
@pytest.mark.parametrize("aperture", [0.0, 2e-3, 10e-3])
def test_blur_keeps_the_summed_alpha(velocity, aperture):
    camera, z = looking(size=400), 0.9
    middle = np.array([z, 0.013, 0.007]) - np.array(velocity) / 120
    alpha = drop(middle, velocity, camera, aperture=aperture, focus=3.0)
    assert alpha.sum() == pytest.approx(np.pi / 4 * (FOCAL * 1e-3 / z) ** 2, rel=0.02)


def test_a_still_drop_out_of_focus_is_the_circle_of_confusion():
    for z, focus in ((0.8, 4.0), (4.0, 1.0), (2.0, np.inf)):
        alpha = drop((z, 0, 0), (0, 0, 0), looking(), aperture=20e-3, focus=focus)
        circle = 20e-3 * FOCAL * abs(1 / z - 1 / focus)
        wide = np.hypot(circle, FOCAL * 1e-3 / z)
        assert np.sqrt((alpha > 0).sum() * 4 / np.pi) == pytest.approx(wide, rel=0.12)
        assert (alpha > 0.95 * alpha.max()).sum() > 0.4 * (alpha > 0).sum()  # an even disc


def test_what_is_in_focus_is_as_sharp_as_through_a_pinhole():
    sharp = drop((2.0, 0, 0.05), (0, 0, -6.0), looking())
    focused = drop((2.0, 0, 0.05), (0, 0, -6.0), looking(), aperture=20e-3, focus=2.0)
    np.testing.assert_allclose(focused, sharp, atol=1e-6)


def test_blurred_drops_reach_into_the_picture_from_outside_and_rain_keeps_its_extinction():
    field, camera = RainField(RainSpectrum(100), seed=4), looking()
    depth = np.full((200, 200), np.inf, np.float32)
    means = []
    for aperture in (0.0, 15e-3):
        total = 0.0
        for time in np.arange(8) * 0.6:
            alpha = np.full_like(depth, np.nan)
            draw_streaks(
                field, None, camera, time, 1 / 60, depth, 2.0, alpha, aperture=aperture, focus=2.0
            )
            total += -np.log1p(-alpha.astype(float)).mean()
        means.append(total / 8)
    assert means[1] == pytest.approx(means[0], rel=0.1) and means[0] > 1e-3
    outside = drop((0.5, 0.12, 0), (0, 0, 0), looking(), aperture=50e-3, focus=4.0)
    assert outside.sum() > 0 == drop((0.5, 0.12, 0), (0, 0, 0), looking()).sum()


def test_bad_lenses_are_told():
    with pytest.raises(ParameterError, match="aperture"):
        drop((1, 0, 0), (0, 0, 0), looking(), aperture=-1.0)
    with pytest.raises(ParameterError, match="focus"):
        drop((1, 0, 0), (0, 0, 0), looking(), aperture=1e-3, focus=0.0)


def test_a_camera_keeps_its_lens_and_size_through_the_exposure():
    path = [replace(looking(), fx=400.0), looking((0.1, 0, 0))]
    assert PathMotion(path, 24.0).end(0, 1 / 60).fx == 400.0
