"""Light from what stands around: gathered from patches that are lit as the capture shows them."""

import numpy as np
import pytest

from rainsim.daylight import surroundings
from rainsim.daylight.surface import Surface
from rainsim.daylight.surroundings import gather, patches_of, sent_in
from rainsim.daylight.visibility import Window

F4 = np.float32
WINDOW = Window(np.zeros(3, F4), 256, F4(0.1))
STEP = 0.1  # m


def surface_of(position, normal, light, flat):
    n = len(position)
    grey = np.repeat(np.asarray(light, F4)[:, None], 3, axis=1)
    return Surface(
        np.asarray(position, F4), np.asarray(normal, F4), np.asarray(flat, F4), grey,
        np.ones(n, F4), np.zeros((n, 1), np.int32), np.full(n, STEP**2, F4),
    )  # fmt: skip


def ground_and_wall(wall_light, ground_light=lambda x: 0.5 + 0 * x):
    """Level ground and a wall at x = 0 that faces it."""
    line = np.arange(-5, 5, STEP)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(STEP, 5, STEP), line))
    v, z = (a.ravel() for a in np.meshgrid(line, np.arange(0, 3, STEP)))
    position = np.concatenate([np.stack([x, y, 0 * x], -1), np.stack([0 * v, v, z], -1)])
    normal = np.repeat(F4([[0, 0, 1], [1, 0, 0]]), [len(x), len(v)], axis=0)
    light = np.concatenate([ground_light(x), wall_light + 0 * v])
    return surface_of(position, normal, light, np.ones(len(light)))


def at_wall(sent, height):
    place = F4([[0, 0, height]])
    return sent.at(place, F4([[1, 0, 0]]), np.ones(1, F4))[0]


def test_a_wall_sees_ground_of_one_light_as_that_light():
    surface = ground_and_wall(0.2)
    sent = sent_in(surface, patches_of(surface, WINDOW), 0.6)
    below, above = at_wall(sent, 1.5)
    assert below == pytest.approx(0.6 * 0.5, rel=1e-4)  # albedo of the open ground
    assert above == 0  # nothing of the capture stands there
    # The ground sees nothing below itself, and above it the wall.
    place, up = F4([[1, 0, 0]]), F4([[0, 0, 1]])
    low, high = sent.at(place, up, np.ones(1, F4))[0]
    assert high == pytest.approx(0.6 * 0.2, rel=0.02) and low == 0


def test_shaded_ground_before_a_wall_sends_less_than_lit_ground():
    surface = ground_and_wall(0.2, lambda x: np.where(x < 1.5, 0.1, 0.5))
    sent = sent_in(surface, patches_of(surface, WINDOW), 0.6)
    foot, high = at_wall(sent, 0.4)[0], at_wall(sent, 2.6)[0]
    assert 0.06 < foot < 0.5 * 0.3
    assert high > 1.3 * foot  # from up there more of the lit ground is seen
    even = sent_in(surface, patches_of(surface, WINDOW), 0.6, gain=gain_to_even(surface))
    assert at_wall(even, 0.4)[0] == pytest.approx(at_wall(even, 2.6)[0], rel=0.01)


def gain_to_even(surface):
    return np.where(surface.normal[:, 2:] > 0.5, 0.5 / surface.light, 1)


def test_what_has_no_plane_sees_itself():
    place = np.random.default_rng(3).uniform(-1, 1, (4000, 3))
    half = place[:, 0] > 0
    surface = surface_of(place, np.tile([0, 0, 1.0], (4000, 1)), np.where(half, 0.4, 0.1), 0 * half)
    sent = sent_in(surface, patches_of(surface, WINDOW), 0.6)
    up = F4([[0, 0, 1]])
    lit, dark = (sent.at(F4([[x, 0, 0]]), up, np.zeros(1, F4))[0].mean() for x in (0.8, -0.8))
    assert 0.6 * 0.1 < dark < 0.8 * lit < 0.8 * 0.6 * 0.4


def test_places_away_from_all_patches_get_their_mean():
    surface = ground_and_wall(0.2)
    sent = sent_in(surface, patches_of(surface, WINDOW), 0.6)
    far = sent.at(F4([[90, 0, 0]]), F4([[0, 0, 1]]), np.ones(1, F4))
    np.testing.assert_allclose(far[0], sent.light.mean(axis=0), rtol=1e-5)


def test_large_captures_have_larger_patches(monkeypatch):
    surface = ground_and_wall(0.2)
    fine = patches_of(surface, WINDOW)
    monkeypatch.setattr(surroundings, "MOST_PATCHES", len(fine.area) // 2)
    coarse = patches_of(surface, WINDOW)
    assert len(coarse.area) <= len(fine.area) // 2 and coarse.cell > fine.cell
    assert coarse.area.sum() == pytest.approx(fine.area.sum(), rel=0.15)


def test_two_discs_see_each_other_by_their_form_factors(poisoned):
    """A level patch between two leaning ones: each counts by its cosine and its solid angle."""
    place = F4([[0, 0, 0], [3, 0, 3], [-1, 0, 2]])
    normal = F4([[0, 0, 1], [0, 0, -1], [0, 0, -1]])
    radiosity, area = F4([0, 1, 2]), F4([0.5, 0.4, 0.3])
    found = poisoned((3, 2))
    gather(place, normal, np.ones(3, F4), area, radiosity, found)
    square = (place.astype(float) ** 2).sum(axis=1)[1:]
    cosine = place[1:, 2] / np.sqrt(square)
    weight = cosine**2 * area[1:] / (np.pi * square + area[1:])
    wanted = (weight * radiosity[1:]).sum() / weight.sum()
    assert found[0, 1] == pytest.approx(wanted, rel=1e-5) and found[0, 0] == 0
    assert (found[1:] == 0).all()  # those see only the first, which is dark
