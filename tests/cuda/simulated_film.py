"""The twin of what a film on wet ground mirrors in the simulator, against the CPU's."""

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.shading import lamp_images as twin_lamps
from rainsim.cuda.shading import wet_ground_mirror as twin
from rainsim.cuda.shading.wet_pass import BLOCK, blocks
from rainsim.numerics.ripmap import ripmap
from rainsim.scene.view import View
from rainsim.shading import lamp_images, microfacet, sky, wet_ground_mirror
from rainsim.shading.fresnel import SCHLICK
from rainsim.shading.lamp_images import LampView
from rainsim.shading.wet_ground_mirror import GroundSlopes, LevelPicture

assert simulated()
F4 = np.float32
# A level camera that looks along y.
TURN = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], F4)
EYE, LENS = np.array([0, 0, 1.5], F4), np.array([30, 30, 15, 4], F4)
HEIGHT, WIDTH, STEP = 20, 30, 5


def launch(kernel, shape, *arguments):
    kernel[blocks(*shape), BLOCK](*arguments)


def test_levels_of_the_ripmap_are_means_of_blocks(rng, poisoned, monkeypatch):
    """With few levels; all of them are held against the CPU's on the device."""
    monkeypatch.setattr(twin, "LEVELS", 3)
    rows, columns, horizon = 7, 14, 2
    picture, atlas = poisoned((8, 16, 3)), poisoned((16, 32, 3))
    picture[:rows, :columns] = rng.uniform(0, 1, (rows, columns, 3))
    launch(twin.halve_widths, (8, 32), picture, F4([columns, rows]), horizon, atlas)
    launch(twin.halve_heights, (8, 32), atlas)
    whole = picture[np.clip(np.arange(8), horizon, rows - 1)][:, np.minimum(range(16), columns - 1)]
    for down, across in ((0, 0), (1, 0), (0, 2), (2, 1)):
        high, wide = 8 >> down, 16 >> across
        means = whole.reshape(high, 1 << down, wide, 1 << across, 3).mean(axis=(1, 3))
        top, left = 2 * (8 - high), 2 * (16 - wide)
        np.testing.assert_allclose(
            atlas[top : top + high, left : left + wide], means, rtol=1e-5, atol=1e-6
        )


@pytest.mark.parametrize("pictured", [True, False])
def test_field_share_and_picture(pictured, rng, poisoned):
    ground = np.zeros((20, 24, 4), F4)
    ground[..., :3], ground[..., 3] = rng.normal(0, 0.02, (20, 24, 3)), 0.2
    ground = GroundSlopes(ground, F4([-12, -4]), F4(1.0), SCHLICK)
    forward, around = F4([0, 1]), sky.overcast(0.5)
    picture = rng.uniform(0, 1, (24, 60, 3)).astype(F4)
    depth = rng.uniform(3, 30, (40, 70)).astype(F4)
    lens = np.array([30, 30, 33, 3], F4)
    atlas, there, size = ripmap(picture, 3), depth[:24, :60], F4([60, 24])
    if not pictured:
        atlas, there, *_ = wet_ground_mirror.NO_LEVEL_PICTURE
        size = F4([0, 0])
    shape = HEIGHT // STEP, WIDTH // STEP
    wanted, found = poisoned((*shape, 3)), poisoned((*shape, 3))
    view = View(TURN, EYE, *LENS)
    lobe = microfacet.LOBE
    level, larger = (LevelPicture(atlas, d, lens, forward) for d in (there, depth))
    wet_ground_mirror.mirrored_field(
        view, STEP, np.ones(shape, bool), ground, lobe, level, around, wanted
    )
    launch(twin.mirrored_field, shape, view, STEP, ground, lobe, larger, size, around, found)
    np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=1e-5)
    assert wanted.std() > 0.01
    if not pictured:
        return
    bare, cover = rng.uniform(0, 1, (HEIGHT, WIDTH, 3)).astype(F4), np.zeros((HEIGHT, WIDTH), F4)
    cover[6:, 5:] = rng.uniform(0, 1, (HEIGHT - 6, WIDTH - 5))
    laid, mine = poisoned(bare.shape), poisoned(bare.shape)
    wet_ground_mirror.add_reflection(bare, cover, wanted, STEP, laid)
    launch(twin.add_reflection, cover.shape, bare, cover, wanted, STEP, mine)
    np.testing.assert_allclose(mine, laid, atol=1e-6)
    assert abs(laid - bare).max() > 0.05


def test_lamps_are_mirrored_as_on_the_cpu(rng):
    slopes = np.zeros((20, 24, 4), F4)
    slopes[..., :3], slopes[..., 3] = rng.normal(0, 0.02, (20, 24, 3)), 0.2
    ground = GroundSlopes(slopes, F4([-12, -4]), F4(1.0), SCHLICK)
    lamps = rng.uniform((-3, 5, 0.5, 0.1, 0.1, 0.1, 1e-4, 1e-4),
                        (3, 12, 2, 1, 1, 1, 1e-2, 1e-2), (3, 8)).astype(F4)  # fmt: skip
    depth = rng.uniform(3, 30, (40, 70)).astype(F4)
    lens, forward = np.array([30, 30, 33, 3], F4), F4([0, 1])
    view = View(TURN, EYE, *LENS)
    shape = HEIGHT // STEP, WIDTH // STEP
    before = rng.uniform(0, 1, (*shape, 3)).astype(F4)
    wanted, found = before.copy(), before.copy()
    exact, larger = (LampView(lamps, d, lens, forward) for d in (depth[:24, :60], depth))
    lamp_images.add_lamps(view, STEP, np.ones(shape, bool), ground, exact, wanted)
    launch(twin_lamps.add_lamps, shape, view, STEP, ground, larger, F4([60, 24]), found)
    np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=1e-5)
    assert (wanted - before).max() > 1e-3
