"""Fine splats merged for small pictures."""

import numpy as np
import pytest

import made_captures
from rainsim import raster
from rainsim.scene.types import Camera, Splats
from rainsim.splatting.detail import merge_fine
from rainsim.splatting.prepared import OPACITY, by_splat

SIDE = 0.2


def leaves(count):
    return raster.prepare(made_captures.leaves(count, 0.02, 4, 4))


def rows_of(prepared):
    return by_splat(prepared.geometry.reshape(-1, 13, 256))[: len(prepared)]


def test_moments_and_stopped_light_are_kept():
    fine = leaves(4000)
    merged = merge_fine(fine, SIDE)
    assert 900 < len(merged) < 1600  # cells of the 10 x 10 x 5, three ways to face, and the wall
    before, after = rows_of(fine), rows_of(merged)
    assert np.isfinite(after).all() and (after[:, OPACITY] < 3).all()
    large = before[:, 3] > 1
    assert large.sum() == 1
    np.testing.assert_array_equal(after[after[:, 3] > 1], before[large])
    np.testing.assert_allclose(np.linalg.norm(after[:, 9:12], axis=1), 1, rtol=1e-3)

    def moments(rows):
        rows = rows[rows[:, 3] < 1].astype(float)
        minors = rows[:, 3] * rows[:, 6] - rows[:, 4] ** 2 + rows[:, 6] * rows[:, 8]
        minors += rows[:, 3] * rows[:, 8] - rows[:, 7] ** 2 - rows[:, 5] ** 2
        opacity = np.exp2(rows[:, OPACITY])
        thin = -np.log1p(-opacity.clip(0, 0.5))  # what a merged splat's optical depth was
        depth = np.where(opacity < 0.5, thin, 2 * np.log(2) * opacity)
        depth = np.where(np.isin(rows[:, 0], before[:, 0]), opacity, depth)  # alone in its cell
        weight = depth * np.sqrt(minors)
        mean = (weight[:, None] * rows[:, :3]).sum(0) / weight.sum()
        square = rows[:, [3, 6, 8]] + rows[:, :3] ** 2
        return weight.sum(), *mean, *(weight[:, None] * square).sum(0) / weight.sum()

    np.testing.assert_allclose(moments(after), moments(before), rtol=2e-3, atol=1e-4)


def test_a_small_picture_is_nearer_to_the_mean_of_a_large_one():
    fine = leaves(3000)
    merged = merge_fine(fine, SIDE)

    def drawn(splats, scale):
        camera = Camera(24 * scale, 24 * scale, 36.0 * scale, 36.0 * scale, 12 * scale, 12 * scale,
                        np.eye(4))  # fmt: skip
        picture = raster.rasterize(splats, camera, 0.1).color
        return picture.reshape(24, scale, 24, scale, 3).mean(axis=(1, 3))

    truth = drawn(fine, 16)
    error, plain = (np.sqrt(np.mean((drawn(s, 1) - truth) ** 2)) for s in (merged, fine))
    assert error < 0.8 * plain and truth.std() > 0.05


def test_what_is_not_fine_or_has_no_number_stays():
    splats = leaves(300)
    same = merge_fine(splats, 1e-3)
    np.testing.assert_array_equal(same.geometry, splats.geometry)
    np.testing.assert_array_equal(same.sh, splats.sh)
    np.testing.assert_array_equal(same.order, splats.order)
    broken = raster.prepare(Splats(
        np.full((3, 3), np.nan, np.float32), np.ones((3, 4), np.float32),
        np.ones((3, 3), np.float32), np.ones(3, np.float32), np.zeros((3, 1, 3), np.float32),
    ))  # fmt: skip
    assert len(merge_fine(broken, 1.0)) == 3
    nothing = raster.select(splats, np.zeros(300, bool))
    assert len(merge_fine(nothing, SIDE)) == 0


@pytest.mark.parametrize("side", [0.1, 0.4])
def test_each_cell_keeps_one_for_each_way_to_face(side):
    fine = leaves(2000)
    merged = merge_fine(fine, side)
    rows = rows_of(fine)
    leaf = rows[rows[:, 2] < 5]
    facing = np.abs(leaf[:, 9:12]).argmax(axis=1)
    cell = np.floor(leaf[:, :3] / np.float32(side)).astype(int)
    cells = {(*c, f) for c, f in zip(cell, facing, strict=True)}
    assert len(merged) == len(cells) + 1
    assert len(np.unique(merged.order)) == len(merged)
