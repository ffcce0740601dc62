"""Captures that hardly are any: the right answer, or one line that says what to give."""

import numpy as np
import pytest

from made_captures import ring, splats_at
from rainsim.config.settings import TerrainConfig
from rainsim.errors import GroundError
from rainsim.scene.ground import estimate_ground_frame
from rainsim.scene.types import Scene
from rainsim.terrain import MEASURED, extract_terrain
from rainsim.water.puddles import puddles_of

CONFIG = TerrainConfig(spacing=0.1)


def floor(count=8000, half=3.0, rough=0.0):
    rng = np.random.default_rng(7)
    height = rng.normal(0, rough, count) if rough else np.zeros(count)
    return np.column_stack([rng.uniform(-half, half, (count, 2)), height])


def wall():
    rng = np.random.default_rng(8)
    return np.column_stack([rng.uniform(-4, 4, 8000), np.full(8000, 4.0), rng.uniform(0, 3, 8000)])


def with_bad(value):
    points = floor(rough=0.003)
    points[::7] = value
    return points


def far_and_wide():
    rng = np.random.default_rng(9)
    return np.concatenate([floor(rough=0.003), rng.uniform(-5000, 5000, (4000, 3))])


@pytest.mark.parametrize("cameras", [True, False])
@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((0, 3)), "0 of the capture's 0 splats"),
        (np.zeros((1, 3)), "1 of the capture's 1 splats"),
        (np.eye(3), "cannot be found"),
        (np.zeros((500, 3)), "cannot be found"),
        (np.linspace(-3, 3, 500)[:, None] * [1, 0, 0], "cannot be found"),
        (wall(), "cannot be found"),
        (np.full((500, 3), np.nan), "0 of the capture's 500 splats"),
    ],
    ids=["empty", "one splat", "three splats", "one place", "line", "wall", "not a number"],
)
def test_no_ground_is_told_in_one_line(points, message, cameras):
    given = {} if cameras else {"up": (0, 0, 1), "meters_per_unit": 1.0}
    with pytest.raises(GroundError, match=message) as told:
        estimate_ground_frame(splats_at(points, scale=0.06), ring() if cameras else (), **given)
    assert "\n" not in str(told.value)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("cameras", [True, False])
@pytest.mark.parametrize(
    "points",
    [floor(), with_bad(np.nan), with_bad(np.inf), far_and_wide(), floor() + 1e4],
    ids=["all in one plane", "NaN among them", "inf among them", "10 km", "far from zero"],
)
def test_odd_captures_have_ground_nevertheless(points, cameras):
    views, given = ring(), {}
    if not cameras:
        views, given = (), {"up": (0, 0, 1), "meters_per_unit": 1.0}
    elif points[np.isfinite(points)].min() > 100:
        pytest.skip("the ring stands at zero")
    splats = splats_at(points, scale=0.06)
    frame = estimate_ground_frame(splats, views, **given)
    assert np.degrees(np.arccos(min(frame.up[2], 1.0))) < 0.1
    ground = extract_terrain(Scene("odd", splats, tuple(views), frame), CONFIG)
    middle = tuple(slice(n // 2 - 10, n // 2 + 10) for n in ground.grid.shape)
    assert max(ground.grid.size) < 13
    assert (ground.source[middle] == MEASURED).mean() > 0.9
    assert np.abs(ground.bed[middle]).max() < 0.01
    puddles = puddles_of(ground)
    puddles.rain(3e-3)
    assert np.isfinite(puddles.depth).all() and puddles.residual < 1e-9
