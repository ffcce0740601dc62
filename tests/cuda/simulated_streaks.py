"""The streaks' twin in numba's CUDA simulator; `tests/cuda/test_cuda.py` runs this file."""

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.particles import spray, streaks
from rainsim.cuda.particles.streaks import Streaks
from rainsim.drops import RainField, RainSpectrum, Surfaces
from rainsim.errors import ParameterError
from rainsim.particles.line_raster import NEAR
from rainsim.particles.spray import lay_clouds
from rainsim.particles.streaks import draw_streaks
from rainsim.rain.throws import Puffs
from rainsim.scene.types import Camera

assert simulated()
# Plain numpy numbers warn where a GPU's wrap.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
WIDTH, HEIGHT = 32, 24


def looking_ahead(eye):
    matrix = np.eye(4)
    matrix[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    matrix[:3, 3] = -matrix[:3, :3] @ np.array(eye)
    return Camera(WIDTH, HEIGHT, 200.0, 200.0, WIDTH / 2, HEIGHT / 2, matrix)


def roofed():
    """Level ground 0.5 m below the camera with a roof over part of it."""
    ground = np.full((16, 16), -0.5, np.float32)
    top, under = ground.copy(), ground.copy()
    top[:6], under[:6] = 1.1, 1.0
    return Surfaces(0.25, (-0.5, -2.0), ground, top, under)


@pytest.mark.parametrize("room", [None, 8])
def test_a_picture_is_that_of_the_cpu(poisoned, monkeypatch, room):
    """Also where there was room for few drops at first."""
    monkeypatch.setattr(streaks, "ROOM", room or streaks.ROOM)
    field = RainField(RainSpectrum(200.0), (1.0, 2.0), seed=4)
    camera, surfaces = looking_ahead((0.0, 0.0, 0.0)), roofed()
    later = looking_ahead((0.01, 0.02, 0.0))
    depth = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    depth[12:, :9] = 0.9
    wanted = poisoned((HEIGHT, WIDTH))
    options = {"camera_end": later, "aperture": 0.002, "focus": 2.0, "strength": 1.5}
    draw_streaks(field, surfaces, camera, 3.0, 1 / 1000, depth, 1.3, wanted, **options)
    twin = Streaks(field, surfaces, WIDTH, HEIGHT)
    twin.update(field, camera, 3.0, 1 / 1000, 1.3, **options)
    assert (twin.room == streaks.ROOM) == (room is None)
    for _ in range(2):  # the second time over what the first left behind
        twin.alpha.copy_to_device(poisoned((HEIGHT, WIDTH)))
        twin.draw(depth)
        found = twin.alpha.copy_to_host()
        assert wanted.max() > 0.1 and (wanted > 0).sum() > 60
        np.testing.assert_allclose(found, wanted, atol=2e-5)
    twin.update(field, camera, 3.1, 1 / 1000, 1.3)
    twin.draw(depth)
    assert np.abs(twin.alpha.copy_to_host() - wanted).max() > 0.1


def test_spray_is_that_of_the_cpu(poisoned):
    """Drops that are drawn and clouds; then none."""
    camera, time, exposure = looking_ahead((0.0, 0.0, 0.0)), 3.0, 1 / 1000
    depth = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    depth[:, :12] = 2.0
    rng = np.random.default_rng(2)
    place = rng.uniform((0.4, -0.05, -0.05), (3.0, 0.05, 0.05), (16, 3))
    drops = np.column_stack([place, np.tile((0.3, 0.2, -3.0, 2e-3), (16, 1))])
    puffs = Puffs(rng.uniform((0.1, -0.2, -0.1), (3.0, 0.2, 0.1), (9, 3)),
                  rng.uniform(0.02, 0.3, 9), np.full(9, 2e-3))  # fmt: skip
    none, wanted = RainField(RainSpectrum(0.0)), poisoned((HEIGHT, WIDTH))
    draw_streaks(none, None, camera, time, exposure, depth, NEAR, wanted, more=drops)
    assert 0.05 < wanted.max()
    before = wanted.copy()
    lay_clouds(puffs, camera, depth, wanted)
    assert (wanted > before + 0.01).mean() > 0.2
    twin = Streaks(none, roofed(), WIDTH, HEIGHT)
    twin.spray = spray.Spray()
    twin.update(none, camera, time, exposure, NEAR)
    for _ in range(2):
        twin.spray.send(drops, puffs, camera)
        twin.draw(depth)
        np.testing.assert_allclose(twin.alpha.copy_to_host(), wanted, atol=2e-4)
    twin.spray.send(drops[:0], Puffs(*(part[:0] for part in puffs)), camera)
    twin.draw(depth)
    assert (twin.alpha.copy_to_host() == 0).all()


def test_more_drops_than_any_device_should_list_are_refused(monkeypatch):
    monkeypatch.setattr(streaks, "MOST_ROOM", 16)
    field = RainField(RainSpectrum(200.0), (1.0, 2.0), seed=4)
    twin = Streaks(field, roofed(), WIDTH, HEIGHT)
    with pytest.raises(ParameterError, match="streak_far"):
        twin.update(field, looking_ahead((0.0, 0.0, 0.0)), 3.0, 1 / 1000, 1.3)
