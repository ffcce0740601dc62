"""Coarser levels of splats: those finer than a cell become one a cell, with their moments kept."""

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.raster import prepare
from rainsim.scene.splat_sets import joined
from rainsim.scene.types import Splats
from rainsim.splatting.detail import coarsest_level
from rainsim.splatting.prepared import OPACITY

MATRIX = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]
LEAST_SCALE = 1e-4  # of a merged splat's largest deviation: single precision holds no less


def merged_splats(splats, side):
    """Return splats of which those finer than a cell are one for each cell and way they face.

    They are merged as levels in memory are, see `rainsim.splatting.detail`; cells with the side
    `side` [capture units] lie on a grid through the origin. In the result come splats as they were
    first, in their order, then merged ones. What nothing can be seen of is left out.
    """
    if not len(splats):
        return splats
    rows, values, order, merged = coarsest_level(prepare(splats), side)
    alone = splats.take(np.sort(order[~merged]))
    return joined([alone, _from_rows(rows[merged], values[merged])]) if merged.any() else alone


def reach_box(splats):
    """Return lowest and highest x, y, z that any of the splats reaches, (6,) float64."""
    box = prepare(splats).box.astype(np.float64)
    return np.concatenate([box[:, :3].min(axis=0), box[:, 3:].max(axis=0)])


def _from_rows(rows, values):
    """Return the Splats of merged geometry and harmonics, see `Detail.coarsest`."""
    variance, axes = np.linalg.eigh(rows[:, 3:9].astype(np.float64)[:, MATRIX])
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    scale = np.sqrt(np.maximum(variance, 0))
    scale = np.maximum(scale, LEAST_SCALE * scale[:, 2:])
    turn = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]]
    arrays = (
        rows[:, :3], turn, scale, np.minimum(np.exp2(rows[:, OPACITY]), 1),
        values.reshape(len(rows), -1, 3),
    )  # fmt: skip
    return Splats(*(np.ascontiguousarray(a, np.float32) for a in arrays))
