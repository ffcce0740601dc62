"""How the twin chooses mirrors, in the simulator."""

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.reflection import mirror_choice as levels
from rainsim.reflection.mirror_choice import LEVEL_STEP, group_levels
from rainsim.scene.view import View

assert simulated()
HEIGHT, WIDTH = 70, 90
LOWEST = -0.06


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


@pytest.mark.parametrize("name", ["auto", "mirror"])
def test_levels_and_extent_are_those_of_the_cpu(water, name):
    """Rays go straight down from a height of 2 m."""
    z, coverage = water
    down = np.diag([1, -1, -1]).astype(np.float32)
    eye, lens = np.array([0, 0, 2], np.float32), np.array([1e9, 1e9, 0, 0], np.float32)
    view, hit = View(down, eye, *lens), (2 - z).astype(np.float32)
    choice = levels.LevelChoice(LOWEST)
    served, extent = choice.choose(hit, coverage, view, name)
    shown = coverage > 0
    rows, columns = np.nonzero(shown)
    assert extent == (columns.min(), rows.min(), columns.max(), rows.max())
    heights = 2 - hit[shown]
    wanted, _ = group_levels(heights, name)
    assert len(wanted) == (3 if name == "auto" else 1)
    np.testing.assert_allclose([level for level, *_ in served], [z for z, _ in wanted], atol=1e-9)
    for (_, low, top), (_, which) in zip(served, wanted, strict=True):
        mine = heights[which]
        assert low <= mine.min() + 1e-6 and mine.max() <= top
    if name == "auto":
        assert served[0][0] == pytest.approx(0.1, abs=LEVEL_STEP)
    assert choice.choose(hit, np.zeros_like(coverage), view, name)[0] == []
