"""The built-in scene: the same every time, sound splats, a true frame, dips that hold water."""

import time

import numpy as np
import pytest
from skimage.morphology import reconstruction

from rainsim.demo_scenes import bicycle
from rainsim.demo_scenes.bicycle import bench, bike, make_bicycle
from rainsim.demo_scenes.bicycle.paving import FAR_EDGE, NEAR_EDGE, bed_height
from rainsim.demo_scenes.build import Noise
from rainsim.scene.types import Scene


@pytest.fixture(scope="module")
def scene(bicycle_scene):
    return bicycle_scene


@pytest.fixture(scope="module")
def ground(scene):
    """Positions of all splats in the ground frame [m]."""
    return scene.ground_frame.to_ground(scene.splats.position.astype(np.float64))


@pytest.fixture(scope="module")
def noise():
    return Noise(np.random.Generator(np.random.PCG64(bicycle.SEED)))


def to_path(points):
    """Take ground-frame points to the frame along the path in which the scene was built."""
    away = bicycle.TARGET - bicycle._eyes()[0]
    length = np.hypot(*away[:2])
    cos, sin = away[:2] / length
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y, points[..., 2]], axis=-1)


def test_same_arrays_every_time_and_quickly(scene):
    start = time.process_time()
    again = make_bicycle()
    assert time.process_time() - start < 6  # about 1 s when the machine has nothing else to do
    for name in ("position", "rotation", "scale", "opacity", "sh"):
        np.testing.assert_array_equal(getattr(scene.splats, name), getattr(again.splats, name))
    assert again.source_hash == scene.source_hash
    assert len(scene.source_hash) == 64


def test_splats_are_sound(scene):
    splats = scene.splats
    n = len(splats)
    assert isinstance(scene, Scene)
    assert 250_000 < n < 400_000
    shapes = {"position": (n, 3), "rotation": (n, 4), "scale": (n, 3), "opacity": (n,)}
    shapes["sh"] = (n, 4, 3)
    for name, shape in shapes.items():
        array = getattr(splats, name)
        assert array.shape == shape
        assert array.dtype == np.float32
        assert array.flags.c_contiguous
        assert np.isfinite(array).all()
    np.testing.assert_allclose(np.linalg.norm(splats.rotation, axis=1), 1, atol=1e-5)
    assert splats.scale.min() > 0
    assert splats.opacity.min() > 0.3
    assert splats.opacity.max() < 1
    base = 0.5 + 0.28209479177387814 * splats.sh[:, 0]
    assert base.min() > -0.05
    assert base.max() < 1.1
    assert base.std() > 0.1


def test_capture_frame_is_tilted_and_not_metric(scene):
    frame = scene.ground_frame
    np.testing.assert_allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame.rotation) == pytest.approx(1)
    assert frame.up[1] < -0.9  # y points down
    assert frame.up[1] > -0.999  # but not quite
    assert frame.meters_per_unit == 0.6
    assert not frame.scale_assumed


def test_paving_lies_at_height_zero(ground, noise):
    path = to_path(ground)
    x, y, z = path.T
    near = (np.abs(x) < 4) & (y > NEAR_EDGE + 0.2) & (y < FAR_EDGE - 0.2) & (np.abs(z) < 0.03)
    assert near.sum() > 40_000
    assert abs(np.median(z[near])) < 0.005
    error = z[near] - bed_height(x[near], y[near], noise)
    assert np.quantile(np.abs(error), 0.7) < 0.004  # the rest is joints, 6 mm down, and leaves


def test_paving_splats_are_flat_and_level(scene, ground):
    """The thin axis of a paving splat is the normal: plane depth rests on it."""
    path = to_path(ground)
    x, y, z = path.T
    on = (np.abs(x) < 3) & (y > -2.5) & (y < -0.9) & (np.abs(z) < 0.03)
    w, i, j, k = scene.splats.rotation[on].T.astype(np.float64)
    third = np.stack([2 * (i * k + w * j), 2 * (j * k - w * i), 1 - 2 * (i * i + j * j)], axis=1)
    level = np.abs(third @ scene.ground_frame.up)
    assert np.quantile(level, 0.02) > np.cos(np.radians(12))
    thickness = scene.splats.scale[on, 2] * scene.ground_frame.meters_per_unit
    assert thickness.max() <= 1e-3
    assert (scene.splats.scale[on, 2] == scene.splats.scale[on].min(axis=1)).mean() > 0.99


def test_dips_hold_water(noise):
    """A full fill of the bed with open edges finds several puddles of the wanted size."""
    spacing = 0.02
    x = np.arange(-4, 4, spacing)
    y = np.arange(NEAR_EDGE, FAR_EDGE, spacing)
    bed = bed_height(*np.meshgrid(x, y), noise)
    rim = np.full_like(bed, bed.max())
    for edge in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        rim[edge] = bed[edge]
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]])
    depth = reconstruction(rim, bed, method="erosion", footprint=cross) - bed
    assert 0.005 < depth.max() < 0.020
    share = np.mean(depth > 0.002)
    assert 0.05 < share < 0.40  # puddles, not a flood
    before_bicycle = depth[(y > -1.5) & (y < -0.8)][:, (x > -1.2) & (x < 0.5)]
    assert before_bicycle.max() > 0.005


def test_bicycle_stands_on_the_ground(noise):
    cloud = bike.bike_cloud(noise, lambda x, y: bed_height(x, y, noise))
    tyre = cloud.position[:, 2] < 0.02
    lowest = cloud.position[:, 2].min()
    assert abs(lowest) < 0.012
    for contact in bike.contacts():
        distance = np.linalg.norm(cloud.position[tyre, :2] - contact, axis=1)
        assert distance.min() < 0.06
    assert cloud.position[:, 2].max() == pytest.approx(1.05, abs=0.12)


def test_cameras_stand_round_the_bench(scene):
    names = [camera.name for camera in scene.cameras]
    assert names == [f"{k:02d}" for k in range(24)]
    cameras = [scene.ground_frame.camera_in_ground(camera) for camera in scene.cameras]
    eyes = np.array([camera.position for camera in cameras])
    assert eyes[:, 2].mean() == pytest.approx(1.5, abs=0.01)
    centre = to_ground_xy(bench.CENTRE)
    distance = np.linalg.norm(eyes[:, :2] - centre, axis=1)
    assert distance.min() > 2.5
    assert distance.max() < 5.0
    first = cameras[0].forward
    assert first[0] > 0.9  # x is the first camera's direction on the ground
    assert abs(first[1]) < 1e-9
    for camera in cameras:
        assert camera.image_up[2] > 0.9
        assert (camera.width, camera.height) == (648, 432)


def to_ground_xy(point):
    """Inverse of `to_path` for one point: its x and y in the ground frame."""
    away = bicycle.TARGET - bicycle._eyes()[0]
    cos, sin = away[:2] / np.hypot(*away[:2])
    return np.array([cos * point[0] + sin * point[1], cos * point[1] - sin * point[0]])


def test_every_camera_sees_a_closed_picture(scene):
    """No hole shows what lies behind all splats, and the pictures differ from each other."""
    from rainsim.raster import prepare, rasterize

    prepared = prepare(scene.splats)
    means = []
    for camera in scene.cameras[::6]:
        layers = rasterize(prepared, camera.resized(324, 216))
        assert np.mean(layers.alpha < 0.9) < 0.002
        means.append(layers.color.mean())
        assert layers.color.std() > 0.1
    assert np.ptp(means) > 0.001
