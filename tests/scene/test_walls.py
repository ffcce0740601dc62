"""Walls are upright: what they tell of up where the cameras' path misleads."""

import numpy as np
import pytest

from made_captures import splats_at
from rainsim.scene.cameras import look_at
from rainsim.scene.ground_search import angle_between, ground_below
from rainsim.scene.level import level_of
from rainsim.scene.plane import upright_planes

UP = np.array([0.0, 0.0, 1.0])
CLIMB = 0.09  # 5 degrees


def climbing():
    """Cameras that come nearer to a front, rise as they come, and are pitched up at it."""
    near, side = np.meshgrid(np.linspace(-3, 1, 6), [-1.0, 0.0, 1.0])
    eyes = np.column_stack([side.ravel(), near.ravel(), 1.5 + CLIMB * near.ravel()])
    return [
        look_at(eye, eye + np.array([0, 5, 1]), UP, 60, 64, 48, f"walk{i:02d}")
        for i, eye in enumerate(eyes)
    ]


def ground(count, rng):
    x, y = rng.uniform(-4, 4, count), rng.uniform(-4, 5, count)
    return np.column_stack([x, y, CLIMB * y + rng.normal(0, 0.03, count)])


def front(count, rng):
    x, z = rng.uniform(-4, 4, count), rng.uniform(0, 5, count)
    return np.column_stack([x, 5 + rng.normal(0, 0.01, count), z])


def bush(count, rng):
    return rng.uniform((-4, 2, 0), (4, 8, 5), (count, 3))


def up_of(*parts):
    points = np.concatenate(parts)
    plane, *_ = ground_below(splats_at(points), climbing(), None, 0)
    return plane.normal


def test_a_front_is_upright_though_the_path_before_it_climbs():
    rng = np.random.default_rng(0)
    path = level_of(climbing(), 5.0)
    assert angle_between(path.up, UP) > max(np.radians(3), 3 * path.deviation)
    points = front(8000, rng)
    walls = upright_planes(points, np.zeros(3), path.up, 5.0)
    both = level_of(climbing(), 5.0, path.up, walls)
    assert np.degrees(angle_between(both.up, UP)) < 0.5
    assert both.deviation < np.radians(1)
    assert np.degrees(angle_between(up_of(ground(3000, rng), points), UP)) < 0.5


@pytest.mark.parametrize("thing", [bush, ground], ids=["bush", "slope"])
def test_what_is_no_wall_tells_nothing(thing):
    points = thing(8000, np.random.default_rng(1))
    path = level_of(climbing(), 5.0)
    assert not len(upright_planes(points, np.zeros(3), path.up, 5.0))
    assert len(upright_planes(front(8000, np.random.default_rng(1)), np.zeros(3), path.up, 5.0))


def test_a_front_that_leans_is_no_wall():
    points = front(8000, np.random.default_rng(2))
    points[:, 1] += 0.25 * points[:, 2]
    assert not len(upright_planes(points, np.zeros(3), UP, 5.0))


def test_no_points_are_no_wall():
    assert upright_planes(np.zeros((0, 3)), np.zeros(3), UP, 5.0).shape == (0, 3)
    assert upright_planes(np.zeros((50, 3)), np.zeros(3), UP, 5.0).shape == (0, 3)
