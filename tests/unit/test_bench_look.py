"""The bench of light on water: its measures on cases whose answer is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from rainsim.bench import look
from rainsim.waterview import View

HEIGHT, WIDTH = 40, 60


@pytest.fixture
def water(rng):
    """Water in the lower half of a picture of a wall 5 m away, camera at the origin."""
    depth = np.full((HEIGHT, WIDTH), 5.0, np.float32)
    clearance = np.full_like(depth, 1.0)
    clearance[:, :10] = 0.0
    turn = np.eye(3, dtype=np.float32)
    lens = np.array([50, 50, WIDTH / 2, HEIGHT / 2], np.float32)
    dark = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    view = View(dark, depth, clearance, turn, np.zeros(3, np.float32), lens, dark)  # fmt: skip
    return SimpleNamespace(view=view, pixel=np.arange(HEIGHT * WIDTH // 2, HEIGHT * WIDTH))


def test_accuracy_is_that_of_the_masked_pixels(water, rng):
    n = len(water.pixel)
    truth = rng.uniform(0, 1, (n, 3))
    mask = np.zeros(n, bool)
    mask[: n // 2] = True
    same = truth.copy()
    same[~mask] += 0.5
    found = look.compare(water, same, truth, mask)
    assert found["psnr"] == pytest.approx(120) and found["pixels"] == n // 2
    off = look.compare(water, truth + 0.1, truth, mask)
    assert off["psnr"] == pytest.approx(20.0, abs=1e-6)
    noise = look.compare(water, rng.uniform(0, 1, (n, 3)), truth, mask)
    assert noise["ssim"] < 0.2 < 0.9 < off["ssim"] <= 1
    assert look.compare(water, truth, truth, ~np.ones_like(mask))["psnr"] is None


def test_why_the_camera_does_not_see_a_traced_end(water):
    ends = {
        "seen": (0.0, 0.0, 5.0), "hidden by something nearer": (0.0, 0.0, 8.0),
        "before what is seen": (0.0, 0.0, 3.0), "outside the picture": (10.0, 0.0, 5.0),
        "behind the camera": (0.0, 0.0, -1.0), "ground": (-2.8, 0.0, 5.0),
    }  # fmt: skip
    causes = look.why_unseen(water, np.ones(6), np.array(list(ends.values())))
    assert list(causes) == list(ends)
    sky = look.why_unseen(water, np.zeros(1), np.full((1, 3), np.inf))
    assert list(sky) == ["sky"]
