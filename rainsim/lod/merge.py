"""Coarser levels of splats: those finer than a cell become one a cell, with their moments kept."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.scene.splat_sets import joined
from rainsim.scene.types import Splats
from rainsim.splatting.coarse import HALF_CELLS, merged_rows
from rainsim.splatting.level_kernels import FLAT
from rainsim.splatting.prepared import GEOMETRY, OPACITY, SIGMAS

PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
MATRIX = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]
FAINTEST = 1e-30
WIDEST = 1.0  # of a cell's side: root of the sum of a merged splat's squared deviations
LEAST_SCALE = 1e-4  # of a merged splat's largest deviation: single precision holds no less


def merged_splats(splats, side):
    """Return splats of which those finer than a cell are one for each cell and way they face.

    Mean, covariance and harmonics of a cell's splats are kept, each weighted by the light that it
    stops, and so is their optical depth times their area; see `rainsim.splatting.coarse`. Cells
    with the side `side` [capture units] lie on a grid through the origin. A splat is finer than a
    cell if the squares of its three deviations add up to less than the square of the side. In the
    result come splats as they were first, then merged ones by cell.
    """
    group = cells_of(splats, side)
    together = group >= 0
    if not together.any():
        return splats
    few, alone = splats.take(together), splats.take(~together)
    rows = np.zeros((len(few), GEOMETRY), np.float32)
    rows[:, :3], rows[:, 3:9] = few.position, covariances(few)
    with np.errstate(divide="ignore"):
        rows[:, OPACITY] = np.log2(few.opacity)
    values = few.sh.reshape(len(few), -1)
    rows, values = merged_rows(rows, values, group[together])
    return joined([alone, _from_rows(rows, values)])


def cells_of(splats, side):
    """Return the number of the group that each splat is merged in, from 0 without gaps; -1: none.

    A group lies in one cell and faces one way, see `facings`: where a wall meets a floor, each
    stays flat. A splat that is alone is not merged, nor is one that nothing can be seen of.
    """
    spread = (splats.scale.astype(np.float64) ** 2).sum(axis=1)
    cell = np.floor(splats.position.astype(np.float64) / side)
    fine = (spread < (WIDEST * side) ** 2) & (splats.opacity > FAINTEST)
    fine &= (np.abs(cell) < HALF_CELLS).all(axis=1)
    group = np.full(len(splats), -1, np.int64)
    if not fine.any():
        return group
    place = (cell[fine].astype(np.int64) + HALF_CELLS) @ (2 * HALF_CELLS) ** np.arange(3)
    _, number = np.unique(place, return_inverse=True)
    key = 4 * number + facings(splats)[fine]
    which, count = np.unique(key, return_inverse=True, return_counts=True)[1:]
    several = count > 1
    number = np.where(several, np.cumsum(several) - 1, -1)
    group[fine] = number[which]
    return group


def facings(splats):
    """Return the axis of the capture frame that each flat splat faces, 1 to 3; 0 for others."""
    ordered = np.sort(splats.scale, axis=1)
    thinnest = turns(splats)[np.arange(len(splats)), :, splats.scale.argmin(axis=1)]
    return np.where(ordered[:, 0] < FLAT * ordered[:, 1], 1 + np.abs(thinnest).argmax(axis=1), 0)


def turns(splats):
    """Return the matrices (n, 3, 3), float64, whose columns are the splats' own axes."""
    w, x, y, z = splats.rotation.T.astype(np.float64)
    return np.stack([
        np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    ], 1)  # fmt: skip


def covariances(splats):
    """Return the covariances of splats, (n, 6) float64 as xx, xy, xz, yy, yz, zz."""
    turn = turns(splats) * splats.scale[:, None, :]
    return np.stack([(turn[:, i] * turn[:, j]).sum(axis=1) for i, j in PAIRS], -1)


def reach_box(splats):
    """Return lowest and highest x, y, z that any of the splats reaches, (6,) float64."""
    away = float(SIGMAS) * np.sqrt(covariances(splats)[:, [0, 3, 5]])
    return np.concatenate(
        [(splats.position - away).min(axis=0), (splats.position + away).max(axis=0)]
    )


def _from_rows(rows, values):
    """Return the Splats of merged geometry and harmonics, as `merged_rows` returns them."""
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
