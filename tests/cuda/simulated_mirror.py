"""How the twin chooses mirrors and what part of them is drawn, in the simulator."""

from dataclasses import replace

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.reflection import mirror_choice as levels
from rainsim.cuda.reflection import planar_mirror as twin
from rainsim.cuda.splatting import project
from rainsim.reflection.mirror_choice import LEVEL_STEP, group_levels
from rainsim.reflection.water_pass import mirror_window
from rainsim.scene.types import Camera
from rainsim.scene.view import view_of_arrays

assert simulated()
HEIGHT, WIDTH = 70, 90
FIRST_BIN = -40


@pytest.fixture(scope="module")
def water():
    """Water at three levels and some at others, seen from straight above: hit, coverage."""
    rng = np.random.default_rng(1)
    z = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    z[10:40, 12:50] = 0.1
    z[20:60, 55:80] = 0.3 + 0.02 * rng.random((40, 25))
    z[45:60, 12:30] = 0.9
    z[50:55, 40] = 0.6
    coverage = np.where(np.isnan(z), 0, 0.5).astype(np.float32)
    return z, coverage


def counted(z, coverage):
    """The twin's counts and extent; rays go straight down from a height of 2 m."""
    down = np.diag([1, -1, -1]).astype(np.float32)
    eye, lens = np.array([0, 0, 2], np.float32), np.array([1e9, 1e9, 0, 0], np.float32)
    count, extent = np.full(levels.BINS, -9, np.int32), np.full(4, -9, np.int32)
    levels.clear_counts[levels.BINS // levels.THREADS, levels.THREADS](count, extent)
    blocks = -(-WIDTH // levels.THREADS), -(-HEIGHT // levels.COUNT_ROWS)
    levels.count_heights[blocks, levels.THREADS](
        (2 - z).astype(np.float32),
        coverage,
        view_of_arrays(down, eye, lens),
        FIRST_BIN,
        count,
        extent,
    )
    return count, extent


@pytest.mark.parametrize("name", ["auto", "mirror"])
def test_levels_are_those_of_the_cpu(water, name):
    z, coverage = water
    count, extent = counted(z, coverage)
    shown = coverage > 0
    assert count.sum() == shown.sum()
    rows, columns = np.nonzero(shown)
    np.testing.assert_array_equal(extent, [columns.min(), rows.min(), columns.max(), rows.max()])
    heights = 2 - (2 - z).astype(np.float32)[shown]
    wanted, _ = group_levels(heights, name)
    most = 3 if name == "auto" else 1
    served, number = np.full((most, 3), np.nan), np.full(1, -9, np.int32)
    levels.choose_levels[1, levels.THREADS](
        count, FIRST_BIN, most, name == "mirror", served, number
    )
    assert number[0] == len(wanted) == most
    np.testing.assert_allclose(served[:, 0], [level for level, _ in wanted], atol=1e-9)
    if name == "auto":
        for (_, low, top), (_, which) in zip(served, wanted, strict=True):
            mine = heights[which]
            assert low <= mine.min() + 1e-6 and mine.max() <= top
        assert served[0, 0] == pytest.approx(0.1, abs=LEVEL_STEP)
    nothing = np.zeros_like(coverage)
    count, extent = counted(z, nothing)
    assert count.sum() == 0 and extent[2] == -1
    levels.choose_levels[1, levels.THREADS](count, FIRST_BIN, most, False, served, number)
    assert number[0] == 0 and (served[:, 1] > served[:, 2]).all()


@pytest.mark.parametrize(("focal", "step"), [(40.0, 1), (900.0, 1), (900.0, 2)])
def test_the_window_is_that_of_the_cpu(water, focal, step):
    _, coverage = water
    camera = Camera(WIDTH, HEIGHT, focal, 1.1 * focal, 44.0, 36.0, np.eye(4))
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    left, top, right, bottom = mirror_window(np.flatnonzero(coverage), coverage.shape, lens)
    rows, columns = np.nonzero(coverage)
    extent = np.array([columns.min(), rows.min(), columns.max(), rows.max()], np.int32)
    numbers = np.zeros((2, project.CAMERA))
    numbers[0, project.LENS : project.PLANE] = lens
    served = np.array([[0.25, 0.2, 0.3]])
    now, eye = np.full(project.CAMERA, np.nan, np.float32), np.full(3, np.nan, np.float32)
    reach, window = np.full((1, 3), np.nan, np.float32), np.full(6, np.nan, np.float32)
    twin.aim[1, 64](
        served, 0, numbers, np.array([float(step)]), np.array([1, 2, 3], np.float32), extent, now,
        eye, reach, window,
    )  # fmt: skip
    whole = replace(
        camera, width=right - left, height=bottom - top, cx=lens[2] - left, cy=lens[3] - top
    )
    drawn = whole.resized(whole.width // step, whole.height // step)
    size = drawn.width, drawn.height
    np.testing.assert_allclose(window, [drawn.fx, drawn.fy, drawn.cx, drawn.cy, *size])
    np.testing.assert_allclose(now[project.NEAR + 1 : project.NEAR + 3], size)
    np.testing.assert_allclose(now[project.LENS : project.PLANE], window[:4])
    np.testing.assert_allclose(reach, served)
    assert eye[2] == pytest.approx(2 * 0.25 - 3)
    high, wide = twin.largest_window(camera)
    assert whole.width <= wide <= whole.width + 128 and whole.height <= high <= whole.height + 128
