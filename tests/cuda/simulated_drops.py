"""Impacts and splashes in numba's CUDA simulator; `tests/cuda/test_cuda.py` runs this file."""

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.drops import Impacts
from rainsim.cuda.particles.splash_pass import Splashes
from rainsim.cuda.particles.streaks import Streaks
from rainsim.drops import GROUND, OBSTACLE, RainField, RainSpectrum, Surfaces, impacts
from rainsim.particles.crown import LONGEST_CROWN
from rainsim.particles.line_raster import NEAR
from rainsim.particles.splash import LONGEST_LIFE, WET_FILM
from rainsim.particles.splash_pass import (
    Windows,
    draw_splashes,
    seen_splashes,
    smallest_drop,
)
from rainsim.rain.poisson_cells import swept_cubes
from rainsim.rain.size_distribution import CLASSES
from rainsim.scene.types import Camera

assert simulated()
# Plain numpy numbers warn where a GPU's wrap.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
START, STOP = 3.0, 3.004
SMALLEST = 2.5e-3  # m; few classes are quicker
WIDTH, HEIGHT = 32, 24


def roofed(spacing=0.08):
    """Level ground with a roof over part of it."""
    ground = np.full((16, 16), -0.5, np.float32)
    top, under = ground.copy(), ground.copy()
    top[:6], under[:6] = -0.1, -0.2
    return Surfaces(spacing, (-6.25 * spacing, -7.5 * spacing), ground, top, under)


def looking_down(x, y, focal):
    """A camera at height 0."""
    matrix = np.diag([1.0, -1.0, -1.0, 1.0])
    matrix[:3, 3] = -x, y, 0.0
    return Camera(WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, matrix)


def set_up(streaks, field, camera, time=START, exposure=1e-3):
    streaks.update(field, camera, time, exposure, NEAR)
    streaks.draw(np.full((HEIGHT, WIDTH), np.inf, np.float32))
    return streaks


def test_the_list_is_that_of_the_cpu(monkeypatch):
    """Also where it had too little room at first; what the camera sees no air of is left out."""
    field, surfaces, rooms = RainField(RainSpectrum(900.0), (1.0, 2.0), seed=4), roofed(), []
    wanted, make_room = impacts(field, surfaces, START, STOP, SMALLEST), Impacts._make_room
    assert len(wanted) > 10 and {GROUND, OBSTACLE} == set(wanted.kind)

    def short(self, room):
        rooms.append(room)
        make_room(self, 5 if len(rooms) == 1 else room)

    monkeypatch.setattr(Impacts, "_make_room", short)
    stops = np.where(field.spectrum.edges[1:] > SMALLEST, STOP, START)
    starts = np.full(CLASSES, START)
    first, last, _, _ = swept_cubes(field, surfaces, starts, stops)
    first, last = (np.tile(corner, (2, 1)) for corner in (first, last))
    windows = Windows(np.tile(starts, 2), np.append(stops, starts), first, last)
    twin, streaks = Impacts(), Streaks(field, surfaces, WIDTH, HEIGHT)
    twin.list(field, windows, set_up(streaks, field, looking_down(0.0, 0.0, 4.0)))
    assert len(rooms) == 2 and twin.room == rooms[1] >= len(wanted)
    count = int(twin.listed.found.copy_to_host()[0])
    assert count == len(wanted)
    ids = twin.listed.ids.copy_to_host()[:count]
    order = np.argsort(ids)
    values = twin.listed.values.copy_to_host()[:count][order]
    labels = twin.listed.labels.copy_to_host()[:count][order]
    np.testing.assert_array_equal(ids[order], wanted.id)
    np.testing.assert_allclose(values[:, :3], wanted.position, atol=1e-9)
    np.testing.assert_allclose(values[:, 3], wanted.diameter, rtol=1e-9)
    np.testing.assert_allclose(values[:, 4], wanted.time, atol=1e-9)
    np.testing.assert_array_equal(labels[:, 1], wanted.kind)
    np.testing.assert_array_equal(labels[:, 2:], np.stack([wanted.row, wanted.column], axis=1))
    twin.list(field, windows, set_up(streaks, field, looking_down(9.0, 0.0, 400.0)))
    assert twin.listed.found.copy_to_host()[0] == 0


@pytest.mark.parametrize("film", [WET_FILM, 0.0])
def test_splashes_are_those_of_all_impacts(poisoned, film):
    """Of impacts of any place and size, as long ago as one may show; the camera moves."""
    field, surfaces = RainField(RainSpectrum(400.0), (1.0, 0.5), seed=4), roofed(0.03)
    exposure, dry, size = 8e-3, RainField(RainSpectrum(0.0)), (HEIGHT, WIDTH)
    water, depth = np.full(surfaces.shape, 0.004, np.float32), np.full(size, np.inf, np.float32)
    streaks = Streaks(field, surfaces, WIDTH, HEIGHT)
    twin = Splashes(streaks)
    for time, x in ((3.0, -0.1), (3.1, 0.1)):
        camera = looking_down(x, 0.0, 90.0)
        set_up(streaks, field, camera, time, exposure)
        twin.alpha.copy_to_device(poisoned(size))
        twin.draw(field, surfaces, camera, time, exposure, water, film)
        fell = impacts(field, surfaces, time - LONGEST_LIFE, time + exposure)
        there, wanted = (dry, surfaces, camera, time, exposure, water, film, depth), poisoned(size)
        draw_splashes(*there, wanted, more=fell)
        np.testing.assert_allclose(twin.alpha.copy_to_host(), wanted, atol=2e-5)
        _, seen = seen_splashes(*there, more=fell)
        old = fell.time < time - LONGEST_CROWN
        listed = twin.impacts.listed
        ids = listed.ids.copy_to_host()[: listed.found.copy_to_host()[0]]
        assert np.isin(seen, ids).all()
        assert np.isin(fell.id[old], seen).sum() > 3 < np.isin(fell.id[~old], seen).sum()
        assert len(ids) < (fell.diameter > smallest_drop(film)).sum()
