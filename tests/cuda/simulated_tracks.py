"""Tracks of tyres in numba's CUDA simulator, against those of the CPU."""

from types import SimpleNamespace

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.jit import cuda
from rainsim.cuda.water.tracks import FILM, Tracks
from rainsim.shading import wetness
from rainsim.terrain.table import class_table
from rainsim.water.tracks import blur_weights, lay_tracks
from rainsim.water.tyres import LEFT, SHOULDER

assert simulated()
SHAPE, WINDOW = (12, 15), (slice(0, 12), slice(1, 15))


@pytest.fixture
def road():
    """Terrain, water of less than a full film, a map of the ground, and cells passed at first."""
    random = np.random.default_rng(3)
    terrain = SimpleNamespace(ground_class=random.integers(0, 3, SHAPE).astype(np.uint8))
    depth = random.uniform(0, 4e-4, SHAPE).astype(np.float32)
    ground = random.uniform(0.2, 1, (*SHAPE, 4)).astype(np.float32)
    passed = np.zeros(SHAPE, bool)
    passed[0, 6:9] = True
    return terrain, depth, ground, passed


def cpu(terrain, depth, passed):
    tracks = np.full(SHAPE, 255, np.uint8)
    lay_tracks(
        depth[WINDOW], passed[WINDOW], terrain.ground_class[WINDOW],
        class_table().column("storage"), np.float32(LEFT), blur_weights(SHOULDER), tracks[WINDOW],
    )  # fmt: skip
    return tracks


def test_tracks_thin_the_film_as_those_of_the_cpu(road):
    """Each step shows what tyres have passed until then, also when another step has begun."""
    terrain, depth, ground, passed = road
    stream = cuda.stream()
    twin, there = Tracks(terrain, passed, stream), cuda.to_device(depth)
    film, found = cuda.to_device(np.ascontiguousarray(ground[..., FILM])), cuda.to_device(ground)
    later = passed.copy()
    later[4:6, 3:12] = True
    rows, columns = np.nonzero(later & ~passed)
    twin.mark(rows, columns, 2)
    twin.mark(rows[:3], columns[:3], 5)  # those were passed already
    shown = []
    for step, mask in ((1, passed), (2, later), (1, passed)):
        wanted = cpu(terrain, depth, mask)
        assert np.abs(twin.fetch(WINDOW, there, step).astype(int) - wanted).max() <= 1
        twin.thin(WINDOW, there, step, film, found, stream)
        thinned = ground.copy()
        wetness.thin_film(thinned, wanted)
        np.testing.assert_allclose(found.copy_to_host(), thinned, atol=0.005)
        shown.append(found.copy_to_host())
    np.testing.assert_array_equal(shown[0], shown[2])
    assert (shown[0][4:6, 3:12, FILM] > 1.5 * shown[1][4:6, 3:12, FILM]).any()
    assert (shown[0][..., FILM] < ground[..., FILM] - 0.1).any()
