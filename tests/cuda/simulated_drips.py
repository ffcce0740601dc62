"""Drips in pictures in numba's CUDA simulator; `tests/cuda/test_cuda.py` runs this file."""

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.particles.splash_pass import Splashes
from rainsim.cuda.particles.streaks import Streaks
from rainsim.cuda.rain.drip_list import DripList
from rainsim.drops import RainField, RainSpectrum, Surfaces
from rainsim.particles.splash_pass import draw_splashes
from rainsim.particles.streaks import draw_streaks
from rainsim.rain.dripping import KEPT, Drips, drip_impacts, drips_seen
from rainsim.scene.types import Camera

assert simulated()
# Plain numpy numbers warn where a GPU's wrap.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
STEP, WIND, ROUGHNESS, RAIN = 1 / 20, (1.5, -0.7), 0.03, 2e-5
FIELD = RainField(RainSpectrum(20.0), seed=4)


def shelves():
    """A board over a lower table, beside a block that stands on the ground."""
    ground = np.zeros((12, 12), np.float32)
    top, under = ground.copy(), ground.copy()
    top[2:9, 3:9], under[2:9, 3:9] = 0.3, 0.25
    top[4:7, 3:6], under[4:7, 3:6] = 0.7, 0.65
    top[9:11, 1:3] = 0.2
    return Surfaces(0.08, (-0.5, -0.4), ground, top, under)


@pytest.fixture(scope="module")
def listed():
    """Surfaces, the table of drips on them after some steps of rain, and their ids."""
    surfaces = shelves()
    drips = Drips(surfaces, seed=3)
    for n in range(-6, 10):
        drips.take_even_rain(RAIN)
        drips.advance(n * STEP, (n + 1) * STEP, WIND, ROUGHNESS)
    return surfaces, *drips.falling()


def test_pictures_are_those_of_the_cpu(listed, poisoned):
    width, height, time, exposure, film = 32, 24, 9 * STEP, 1 / 60, 2e-4
    surfaces, table, ids = listed
    matrix = np.diag([1.0, -1.0, -1.0, 1.0])
    matrix[2, 3] = 1.2  # 1.2 m up, looking down
    camera = Camera(width, height, 40.0, 40.0, width / 2, height / 2, matrix)
    depth = np.full((height, width), 1.2, np.float32)
    water = np.full(surfaces.shape, 0.004, np.float32)
    streaks = Streaks(FIELD, surfaces, width, height)
    streaks.update(FIELD, camera, time, exposure, 0.51)  # hardly any rain
    streaks.drips = DripList()
    for few in (3, len(ids)):  # room is made
        streaks.drips.fill(table[:few], ids[:few])
    streaks.draw(depth)
    wanted, without = poisoned((height, width)), poisoned((height, width))
    more = drips_seen(table, time, exposure)
    draw_streaks(FIELD, surfaces, camera, time, exposure, depth, 0.51, wanted, more=more)
    draw_streaks(FIELD, surfaces, camera, time, exposure, depth, 0.51, without)
    assert np.abs(wanted - without).max() > 0.02
    np.testing.assert_allclose(streaks.alpha.copy_to_host(), wanted, atol=1e-5)

    twin = Splashes(streaks)
    twin.alpha.copy_to_device(poisoned((height, width)))
    shutter = FIELD, surfaces, camera, time, exposure
    twin.draw(*shutter, water, film)
    landed = drip_impacts(table, ids, surfaces, time - 0.12, time + exposure)
    draw_splashes(*shutter, water, film, depth, without)
    draw_splashes(*shutter, water, film, depth, wanted, more=landed)
    assert (wanted - without).max() > 0.02 and (wanted - without > 1e-4).sum() > 10
    np.testing.assert_allclose(twin.alpha.copy_to_host(), wanted, atol=1e-5)


def test_list_that_follows_the_drips_holds_those_that_fall_or_have_just_landed():
    """Each is sent once until there is no more room; those that landed long ago may stay."""
    drips, there, sent = Drips(shelves(), seed=3), DripList(), 0
    sends = there._ids.send
    counts = []
    there._ids.send = lambda ids, first=0: counts.append(len(ids)) or sends(ids, first)
    for n in range(60):
        drips.take_even_rain(RAIN if n < 45 else 0.0)
        drips.advance(n * STEP, (n + 1) * STEP, WIND, ROUGHNESS)
        there.follow(drips.parted)
        table, ids = drips.falling()
        rows = {int(i): tuple(row) for i, row in zip(ids, table, strict=True)}
        listed = there._there
        found = {int(i): tuple(listed.table[k]) for k, i in enumerate(listed.ids[: listed.count])}
        assert rows.items() <= found.items() and listed.count == len(found)
        ended = [row[6] for i, row in found.items() if i not in rows]
        assert all(end < (n + 1) * STEP - KEPT for end in ended)
        sent += sum(len(parted.ids) for parted in drips.parted[-1:])
    assert sent > 100 and max(counts) < sent / 2
    assert sum(counts) < 3 * sent
    there.fill(table, ids)
    assert there._there.count == len(ids)
