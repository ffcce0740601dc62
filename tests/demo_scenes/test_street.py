"""The street: the same every time, sound splats, a true frame, gutters that run to drains."""

import time

import numpy as np
import pytest

from rainsim.config.settings import Config
from rainsim.demo_scenes.build import Noise
from rainsim.demo_scenes.street import CAMERAS, SEED, make_street, road
from rainsim.simulation import drains_of, water_solver
from rainsim.terrain.table import DRAIN
from rainsim.terrain.types import MEASURED, Grid, Terrain
from rainsim.water.puddles import puddles_of


@pytest.fixture(scope="module")
def scene(street_scene):
    return street_scene


@pytest.fixture(scope="module")
def noise():
    return Noise(np.random.Generator(np.random.PCG64(SEED)))


def test_same_arrays_every_time_and_quickly(scene):
    start = time.process_time()
    again = make_street()
    assert time.process_time() - start < 8  # about 2 s when the machine has nothing else to do
    assert again.source_hash == scene.source_hash
    np.testing.assert_array_equal(again.splats.position, scene.splats.position)


def test_splats_are_sound(scene):
    splats = scene.splats
    assert 250_000 < len(splats) < 500_000
    for name in ("position", "rotation", "scale", "opacity", "sh"):
        array = getattr(splats, name)
        assert array.dtype == np.float32 and np.isfinite(array).all()
    np.testing.assert_allclose(np.linalg.norm(splats.rotation, axis=1), 1, atol=1e-5)
    assert splats.scale.min() > 0
    metres = splats.scale.max(axis=1) * scene.ground_frame.meters_per_unit
    x, y, z = scene.ground_frame.to_ground(splats.position).T
    near = (x > 0) & (x < 15) & (np.abs(y) < 8) & (z < 8)
    assert near.sum() > 100_000 and metres[near].max() < 0.5  # no spikes


def test_the_drive_is_ten_metres_a_second_at_eye_height(scene):
    eyes = np.array([scene.ground_frame.to_ground(c.position) for c in scene.cameras])
    assert len(eyes) == CAMERAS
    step = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    np.testing.assert_allclose(step * 24, 10.0, rtol=1e-9)
    np.testing.assert_allclose(eyes[:, 2] - road.CROWN, 1.5, atol=1e-9)
    forward = scene.ground_frame.camera_in_ground(scene.cameras[0]).forward
    assert forward[0] > 0.99 and abs(forward[1]) < 1e-9  # x is the first camera's direction


def test_camber_kerb_and_drains(noise):
    x = np.linspace(0, 20, 200)
    height = {
        y: road.bed_height(x, np.full(x.size, y), noise).mean() for y in (0, -1.5, -3.3, -3.7)
    }
    assert height[0] > height[-1.5] > height[-3.3]
    assert 0.08 < height[-3.7] - height[-3.3] < 0.15
    dx, dy = road.DRAINS[0]
    beside = road.bed_height(np.array([dx - 8, dx - 0.4, dx + 8]), np.full(3, dy), noise)
    assert beside[1] < beside[0] and beside[1] < beside[2]


def test_scene_drains_lie_on_the_ground(scene, noise):
    drains = scene.ground_frame.to_ground(np.array(scene.drains))
    np.testing.assert_allclose(drains[:, :2], road.DRAINS, atol=1e-9)
    np.testing.assert_allclose(drains[:, 2], road.bed_height(*road.DRAINS.T, noise), atol=1e-9)


def gutter(noise, drain=True):
    """A strip of the street about the drain nearest to the drive."""
    grid = Grid((70, 280), (5.5, -3.8), 0.04)
    bed = road.bed_height(*np.meshgrid(*grid.centres()), noise).astype(np.float32)
    classes = np.zeros(grid.shape, np.uint8)
    x, y = grid.centres()
    if drain:
        away = np.hypot(x[None] - road.DRAINS[0, 0], y[:, None] - road.DRAINS[0, 1])
        classes[away < 0.16] = DRAIN
    source = np.full(grid.shape, MEASURED, np.uint8)
    zero = np.zeros(grid.shape, np.float32)
    return Terrain(
        grid, bed, bed, bed, source, classes, zero, np.zeros((*grid.shape, 3), np.float32)
    )


def test_water_gathers_at_the_kerb_and_spares_the_crown(noise):
    terrain = gutter(noise)
    puddles = puddles_of(terrain)
    puddles.rain(np.full(terrain.grid.shape, 5e-3))
    depth = puddles.depth
    _, y = terrain.grid.centres()
    beside_kerb = depth[(y > -3.44) & (y < -2.9)].mean()
    assert beside_kerb > 0.5e-3 > 10 * depth[y > -2.0].mean()
    assert puddles.volumes["infiltrated"] > 0.7 * puddles.volumes["rain"]  # the drain took it


def test_running_water_leaves_through_the_drain(noise):
    config = Config().replace(courant=None)
    drained = {}
    for drain in (True, False):
        terrain = gutter(noise, drain)
        solver = water_solver(terrain, config)
        y = terrain.grid.centres()[1][:, None]
        depth = np.where((y > -3.44) & (y < -3.0), 0.01, 0.0)
        solver.set_state(np.broadcast_to(depth, terrain.grid.shape).copy())
        drained[drain] = solver.advance(1.0, rain=0.0).ledger.as_dict()["drained"]
    assert drained[False] == 0.0 and len(drains_of(gutter(noise))) > 20
    assert drained[True] > 1e-3  # litres of the 25 that stand in the gutter
