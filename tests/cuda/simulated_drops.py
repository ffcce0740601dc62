"""The impacts' twin in numba's CUDA simulator; `tests/cuda/test_cuda.py` runs this file."""

from types import SimpleNamespace

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.drops import Impacts, room_for
from rainsim.cuda.rain.impact_history import RecentImpacts
from rainsim.drops import GROUND, OBSTACLE, RainField, RainSpectrum, Surfaces, impacts

assert simulated()
# Plain numpy numbers warn where a GPU's wrap.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
START, STOP = 3.0, 3.004
SMALLEST = 2.5e-3  # m; few classes are quicker


def roofed():
    """Level ground with a roof over part of it."""
    ground = np.full((16, 16), -0.5, np.float32)
    top, under = ground.copy(), ground.copy()
    top[:6], under[:6] = -0.1, -0.2
    return Surfaces(0.08, (-0.5, -0.6), ground, top, under)


@pytest.fixture(scope="module")
def listed():
    field, surfaces = RainField(RainSpectrum(900.0), (1.0, 2.0), seed=4), roofed()
    wanted = impacts(field, surfaces, START, STOP, SMALLEST)
    assert len(wanted) > 10 and {GROUND, OBSTACLE} == set(wanted.kind)
    twin = Impacts(field, surfaces, room_for(field, surfaces, STOP - START))
    twin.list(field, START, STOP, SMALLEST)
    return field, surfaces, wanted, twin


def test_the_list_is_that_of_the_cpu(listed):
    _, _, wanted, twin = listed
    count = int(twin.lists.found.copy_to_host()[0])
    assert count == len(wanted) and twin.lacking() == 0
    order = np.argsort(twin.lists.ids.copy_to_host()[0, :count])
    values = twin.lists.values.copy_to_host()[0, :count][order]
    labels = twin.lists.labels.copy_to_host()[0, :count][order]
    np.testing.assert_array_equal(twin.lists.ids.copy_to_host()[0, :count][order], wanted.id)
    np.testing.assert_allclose(values[:, :3], wanted.position, atol=1e-9)
    np.testing.assert_allclose(values[:, 3], wanted.diameter, rtol=1e-9)
    np.testing.assert_allclose(values[:, 4], wanted.time, atol=1e-9)
    np.testing.assert_array_equal(labels[:, 1], wanted.kind)
    np.testing.assert_array_equal(labels[:, 2:], np.stack([wanted.row, wanted.column], axis=1))


def test_a_short_list_is_made_longer(listed):
    field, surfaces, wanted, _ = listed
    twin = Impacts(field, surfaces, 5)
    twin.list(field, START, STOP, SMALLEST)
    assert twin.room >= len(wanted) == twin.lists.found.copy_to_host()[0]
    assert np.sort(twin.lists.ids.copy_to_host()[0, : len(wanted)]).tolist() == wanted.id.tolist()


def test_each_interval_of_the_last_moments_is_listed_once():
    field, surfaces, listed = RainField(RainSpectrum(40.0), seed=4), roofed(), []

    class Recent(RecentImpacts):
        def _queue(self, field, start, stop, smallest=0.0, slot=0):
            listed.append(round(start * 20))
            super()._queue(field, start, stop, 3e-3, slot)

    recent = Recent(SimpleNamespace(field=lambda start, stop: field), surfaces, 20.0, 1)
    count = len(recent.lists.found)
    for frame, lacking in ((9, count), (9, 0), (10, 1), (8, 2), (50, count)):
        del listed[:]
        recent.update(frame)
        assert len(listed) == lacking, frame
    assert sorted(listed) == list(range(51 - count, 51))
    recent.forget()
    recent.update(50)
    assert sorted(listed[count:]) == sorted(listed[:count])
    ids = recent.lists.ids.copy_to_host()
    for number in range(51 - count, 51):
        wanted = impacts(field, surfaces, number / 20, (number + 1) / 20, 3e-3).id
        found = ids[number % count, : recent.lists.found.copy_to_host()[number % count]]
        assert np.sort(found).tolist() == wanted.tolist()
