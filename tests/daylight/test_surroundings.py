"""Light from what stands around: gathered from patches that are lit as the capture shows them."""

import numpy as np
import pytest

from rainsim.daylight import surroundings
from rainsim.daylight.lit_surface import Surface
from rainsim.daylight.sky_light import hemisphere
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
        np.zeros((n, 1), np.int32), np.full(n, STEP**2, F4),
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
    np.testing.assert_allclose(below, 0.6 * 0.5, rtol=1e-4)  # albedo of the open ground
    assert (above == 0).all()  # nothing of the capture stands there
    # The ground sees nothing below itself, and above it the wall.
    place, up = F4([[1, 0, 0]]), F4([[0, 0, 1]])
    low, high = sent.at(place, up, np.ones(1, F4))[0]
    np.testing.assert_allclose(high, 0.6 * 0.2, rtol=0.02)
    assert (low == 0).all()


def test_shaded_ground_before_a_wall_sends_less_than_lit_ground():
    surface = ground_and_wall(0.2, lambda x: np.where(x < 1.5, 0.1, 0.5))
    sent = sent_in(surface, patches_of(surface, WINDOW), 0.6)
    foot, high = at_wall(sent, 0.4)[0, 1], at_wall(sent, 2.6)[0, 1]
    assert 0.06 < foot < 0.5 * 0.3
    assert high > 1.3 * foot  # from up there more of the lit ground is seen
    even = sent_in(surface, patches_of(surface, WINDOW), 0.6, gain=gain_to_even(surface))
    assert at_wall(even, 0.4)[0, 1] == pytest.approx(at_wall(even, 2.6)[0, 1], rel=0.01)


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


def sheets(*heights_and_light):
    """Level squares of 2 m above one another, which face down but the lowest."""
    line = np.arange(-0.95, 1, STEP)
    x, y = (a.ravel() for a in np.meshgrid(line, line))
    height = np.repeat([h for h, _ in heights_and_light], len(x))
    light = np.repeat([v for _, v in heights_and_light], len(x))
    count = len(heights_and_light)
    place = np.stack([np.tile(x, count), np.tile(y, count), height], -1)
    normal = np.where(height[:, None] == 0, [0, 0, 1], [0, 0, -1.0])
    return surface_of(place, normal, light, np.ones(len(height)))


def test_what_stands_behind_something_is_not_seen():
    """A dark sheet hides a bright one above it: the ground below sees the dark one alone."""
    place, up = F4([[0, 0, 0]]), F4([[0, 0, 1]])
    seen = {}
    for name, pair in {"far": [(1.3, 0.8)], "both": [(0.5, 0.1), (1.3, 0.8)]}.items():
        surface = sheets((0.0, 0.5), *pair)
        sent = sent_in(surface, patches_of(surface, WINDOW), 0.6)
        seen[name] = sent.at(place, up, np.ones(1, F4))[0, 1]
    np.testing.assert_allclose(seen["far"], 0.6 * 0.75, rtol=0.02)  # MOST_BRIGHT times the ground
    assert (0.6 * 0.1 < seen["both"] + 1e-6).all() and (seen["both"] < 0.3 * seen["far"]).all()


def test_light_keeps_its_color():
    """A wall sees red ground as red light, and a grey one as grey."""
    surface = ground_and_wall(0.2)
    level = surface.normal[:, 2:] > 0.5
    red = surface._replace(light=surface.light * np.where(level, F4([1.4, 0.9, 0.4]), F4(1)))
    found = {
        name: at_wall(sent_in(one, patches_of(one, WINDOW), 0.6), 1.5)[0]
        for name, one in (("grey", surface), ("red", red))
    }
    np.testing.assert_allclose(found["grey"], found["grey"][1], rtol=1e-5)
    np.testing.assert_allclose(found["red"] / found["red"][1], [1.4 / 0.9, 1, 0.4 / 0.9], rtol=1e-3)


def test_two_sheets_share_what_is_seen_by_their_form_factors(poisoned):
    """A patch below two others of its size sees of each what solid angle and cosine give it."""
    place = F4([[0.5, 0.5, 0.5], [0.5, 0.5, 3.5], [3.5, 0.5, 3.5]])
    normal = F4([[0, 0, 1], [0, 0, -1], [0, 0, -1]])
    radiosity = F4([[0, 0, 0], [1, 0, 3], [0, 2, 3]])
    low, first, order = surroundings._lists(place, 1.0)
    assert low == pytest.approx([0, 0, 0]) and first.shape == (4, 1, 4, 2)
    rays = np.concatenate([hemisphere(20000), -hemisphere(20000)]).astype(F4)
    found = np.zeros((3, 2, 3), F4)
    gather(
        place, normal, np.ones(3, F4), np.full(3, 20, F4), radiosity, low, F4(1), first, order,
        rays, found,
    )  # fmt: skip
    # Planes reach OVERLAP beyond their cells along a ray: shares, not squares of a metre.
    near, far = form_factor((0, 0, 3)), form_factor((3, 0, 3))
    assert found[0, 1, 2] == pytest.approx(3, rel=1e-4)
    assert found[0, 1, 1] / (2 * found[0, 1, 0]) == pytest.approx(far / near, rel=0.15)
    assert (found[0, 0] == 0).all() and (found[1:] == 0).all()  # those see only what is dark


def form_factor(move):
    """Return that of a level square metre moved so [m], seen from a level place, but for 1 / pi."""
    line = np.linspace(-0.5, 0.5, 41)
    x, y = np.meshgrid(line + move[0], line + move[1])
    square = x * x + y * y + move[2] ** 2
    return (move[2] ** 2 / square**2).mean()
