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
    streaks = Streaks(field, surfaces, WIDTH, HEIGHT)
    streaks.update(field, camera, TIME, EXPOSURE, 0.31)  # hardly any streaks
    recent = RecentImpacts(Weather(field), surfaces, RATE, 2)
    recent.update(int(TIME * RATE))
    twin = Splashes(streaks, recent)
    for room in (None, 4):  # the second time room is made
        if room is not None:
            twin.lines = twin.lines[:room]
        streaks.draw(depth)
        twin.alpha.copy_to_device(poisoned((HEIGHT, WIDTH)))
        twin.update(field, FILM)
        twin.draw(water)
        assert wanted.max() > 0.02 and (wanted > 1e-4).sum() > 20
        assert len(twin.lines) > 10
        np.testing.assert_allclose(twin.alpha.copy_to_host(), wanted, atol=1e-5)
