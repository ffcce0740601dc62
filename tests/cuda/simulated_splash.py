"""The splashes' twin in numba's CUDA simulator; `tests/cuda/test_cuda.py` runs this file."""

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.particles.splash_pass import Splashes
from rainsim.cuda.particles.streaks import Streaks
from rainsim.cuda.rain.impact_history import RecentImpacts
from rainsim.drops import RainField, RainSpectrum, flat_surfaces
from rainsim.particles.splash_pass import draw_splashes
from rainsim.scene.types import Camera

assert simulated()
# Plain numpy numbers warn where a GPU's wrap.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
WIDTH, HEIGHT, TIME, EXPOSURE, FILM = 32, 24, 3.0, 1 / 120, 2e-4
RATE = 50  # Hz


class Weather:
    """One steady rain."""

    def __init__(self, field):
        self.field = lambda start, stop: field


def test_a_picture_is_that_of_the_cpu(poisoned):
    field = RainField(RainSpectrum(200.0), (0.5, 0.0), seed=5)
    surfaces = flat_surfaces(0.25, 0.2, 0.05, (-0.1, -0.1))
    matrix = np.diag([1.0, -1.0, -1.0, 1.0])
    matrix[2, 3] = 0.8  # 0.8 m up, looking down
    camera = Camera(WIDTH, HEIGHT, 80.0, 80.0, WIDTH / 2, HEIGHT / 2, matrix)
    depth = np.full((HEIGHT, WIDTH), 0.8, np.float32)
    water = np.zeros(surfaces.shape, np.float32)
    water[:, 2:] = 0.008
    wanted = poisoned((HEIGHT, WIDTH))
    draw_splashes(field, surfaces, camera, TIME, EXPOSURE, water, FILM, depth, wanted)
    streaks = Streaks(field, surfaces, WIDTH, HEIGHT, depth)
    streaks.update(field, camera, TIME, EXPOSURE, 0.31)  # hardly any streaks
    streaks.launch()
    recent = RecentImpacts(Weather(field), surfaces, RATE, 2)
    recent.update(int(TIME * RATE))
    recent.launch()
    recent.check()
    twin = Splashes(streaks, recent, water)
    twin.alpha.copy_to_device(poisoned((HEIGHT, WIDTH)))
    twin.update(field, FILM)
    twin.launch()
    assert wanted.max() > 0.02 and (wanted > 1e-4).sum() > 20
    assert twin.missing() == 0 and int(twin.count.copy_to_host()[0]) > 10
    np.testing.assert_allclose(twin.alpha.copy_to_host(), wanted, atol=1e-5)
    # A list that the next step is filling may hold anything.
    closed, count = recent.next_list(int(TIME * RATE)), int(twin.count.copy_to_host()[0])
    found, labels = recent.lists.found.copy_to_host(), recent.lists.labels.copy_to_host()
    found[closed], labels[closed] = recent.room, 2**30
    recent.lists.found.copy_to_device(found)
    recent.lists.labels.copy_to_device(labels)
    twin.update(field, FILM, closed)
    streaks.launch()
    twin.launch()
    assert int(twin.count.copy_to_host()[0]) == count
