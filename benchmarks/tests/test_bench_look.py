"""The bench of light on water: its measures on cases whose answer is known."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage
from skimage.metrics import structural_similarity

from benchmarks import truth as truth_bench
from rainsim.reflection.water_pass import WetPicture
from rainsim.scene.view import View

HEIGHT, WIDTH = 40, 60


@pytest.fixture
def water(rng):
    """Water in the lower half of a picture of a wall 5 m away, camera at the origin."""
    depth = np.full((HEIGHT, WIDTH), 5.0, np.float32)
    clearance = np.full_like(depth, 1.0)
    clearance[:, :10] = 0.0
    turn = np.eye(3, dtype=np.float32)
    lens = (np.float32(n) for n in (50, 50, WIDTH / 2, HEIGHT / 2))
    dark = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    wet = WetPicture(dark, depth, clearance, View(turn, np.zeros(3, np.float32), *lens), dark)
    pixel = np.arange(HEIGHT * WIDTH // 2, HEIGHT * WIDTH)
    return SimpleNamespace(wet=wet, pixel=pixel, coverage=depth)


def test_accuracy_is_that_of_the_masked_pixels(water, rng):
    n = len(water.pixel)
    truth = rng.uniform(0, 1, (n, 3))
    mask = np.zeros(n, bool)
    mask[: n // 2] = True
    same = truth.copy()
    same[~mask] += 0.5
    found = truth_bench.compare(water, same, (truth, truth), mask)
    assert found["psnr"] == pytest.approx(120) and found["pixels"] == n // 2
    off = truth_bench.compare(water, truth + 0.1, (truth, truth), mask)
    assert off["psnr"] == pytest.approx(20.0, abs=1e-6)
    noise = truth_bench.compare(water, rng.uniform(0, 1, (n, 3)), (truth, truth), mask)
    assert noise["ssim"] < 0.2 < 0.9 < off["ssim"] <= 1
    assert truth_bench.compare(water, truth, (truth, truth), ~np.ones_like(mask))["psnr"] is None


def test_what_is_brighter_than_white_counts_as_white_where_it_is_clipped(water, rng):
    n = len(water.pixel)
    light = rng.uniform(0, 0.8, (n, 3))
    lamp = light.copy()
    lamp[::50] = 20.0
    everything = np.ones(n, bool)
    half = np.arange(n) < n // 2
    truth = {"light": (lamp, lamp), "known": everything, "seen": half}
    dimmer = np.where(lamp > 1, 15.0, lamp)
    assert truth_bench.compare(water, dimmer, truth["light"], everything)["psnr"] < 5
    found = truth_bench.clipped(water, dimmer, truth)
    assert found["all"]["psnr"] == pytest.approx(120)
    assert found["seen"]["pixels"] == n // 2
    found = truth_bench.clipped(water, light, truth)  # without lamps
    assert found["all"]["psnr"] < 30


def test_the_measures_are_the_usual_ones_and_free_of_the_truths_own_noise(water, rng):
    n = len(water.pixel)
    picture = ndimage.gaussian_filter(rng.uniform(0, 1, (HEIGHT // 2, WIDTH, 3)), (2, 2, 0))
    truth = (picture - picture.min()) / np.ptp(picture)
    ours = (truth + rng.normal(0, 0.06, truth.shape)).reshape(n, 3)
    truth = truth.reshape(n, 3)
    everything = np.ones(n, bool)
    found = truth_bench.compare(water, ours, (truth, truth), everything)
    whole = np.zeros((2, HEIGHT, WIDTH, 3))
    whole.reshape(2, -1, 3)[:, water.pixel] = ours, truth
    _, similar = structural_similarity(
        *whole, win_size=7, data_range=1.0, channel_axis=-1, full=True
    )
    assert found["ssim"] == pytest.approx(similar[HEIGHT // 2 + 3 : -3, 3:-3].mean(), abs=1e-6)
    noisy = [truth + rng.normal(0, 0.1, truth.shape) for _ in range(2)]
    free = truth_bench.compare(water, ours, noisy, everything)
    assert free["psnr"] == pytest.approx(found["psnr"], abs=0.5)
    assert free["ssim"] == pytest.approx(found["ssim"], abs=0.02)
    once = truth_bench.compare(water, ours, (noisy[0], noisy[0]), everything)
    assert once["psnr"] < found["psnr"] - 3 and once["ssim"] < found["ssim"] - 0.05


def test_why_the_camera_does_not_see_a_traced_end(water):
    ends = {
        "seen": (0.0, 0.0, 5.0), "hidden by something nearer": (0.0, 0.0, 8.0),
        "before what is seen": (0.0, 0.0, 3.0), "outside the picture": (10.0, 0.0, 5.0),
        "behind the camera": (0.0, 0.0, -1.0), "ground": (-2.8, 0.0, 5.0),
    }  # fmt: skip
    causes = truth_bench.why_unseen(water.wet, np.ones(6), np.array(list(ends.values())))
    assert list(causes) == list(ends)
    sky = truth_bench.why_unseen(water.wet, np.zeros(1), np.full((1, 3), np.inf))
    assert list(sky) == ["sky"]


def test_a_process_for_each_method_tells_its_own_memory():
    """Not that of the process that starts it, which is larger here."""
    held = np.ones(80_000_000)  # 640 MB
    code = "from benchmarks import suite; print(suite.peak() / 2**20)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 10 < float(done.stdout) < 400 < held.nbytes / 2**20
