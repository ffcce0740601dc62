"""Fine splats merged for small pictures."""

import numpy as np
import pytest

import made_captures
from rainsim import raster
from rainsim.scene.types import Splats
from rainsim.splatting.detail import merge_fine
from rainsim.splatting.prepared import by_splat

SIDE = 0.2


def leaves(count):
    return raster.prepare(made_captures.leaves(count, 0.02, 4, 4))


def rows_of(prepared):
    return by_splat(prepared.geometry.reshape(-1, 13, 256))[: len(prepared)]


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
