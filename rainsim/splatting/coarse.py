"""Splats for small pictures: those finer than a cell are merged to one splat a cell.

A small picture of a dense scene spends its time on splats far smaller than its pixels, and shows
them too large, for each is widened to a pixel. Here those of a cell become one Gaussian of their
mean, covariance and colour (moments are kept, as where mixtures are reduced; Runnalls 2007, IEEE
Trans. Aerosp. Electron. Syst. 43(3)), each weighted by the light that it stops, and the new one
stops as much: optical depth times area is kept.

An optical depth d e^-q at the place q stops 1 - exp(-d e^-q), which is flat in the middle where d
is large, as in a wall. A Gaussian of opacity d / (2 ln 2), which blending bounds at one, stops a
half at the same places. With no more than 1 - exp(-d) a wall of merged splats lets a third of the
light through between them. Opacities above one are also what Kerbl et al. 2024 (A Hierarchical 3D
Gaussian Representation, ACM Trans. Graph. 43(4)) give to merged splats.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rainsim.splatting.prepared import GEOMETRY, LANES, OPACITY, by_splat, laid_out

LEAST = 1e-30
HALF_STOPPED = 1 / (2 * math.log(2))  # opacity over optical depth, where a half is stopped
HALF_CELLS = 1 << 20  # along an axis: three such numbers fit into one


def merge_fine(prepared, side):
    """Return prepared splats of which those finer than a cell are one a cell.

    Parameters
    ----------
    prepared : PreparedSplats
    side : float [world units]
        Of the cells. A splat is fine if the squares of its deviations along its three axes add up
        to less than the square of half of it.

    Returns
    -------
    PreparedSplats
        `order` names one of the splats that each stands for.
    """
    rows = by_splat(prepared.geometry.reshape(-1, GEOMETRY, LANES))[: len(prepared)]
    values = by_splat(prepared.harmonics())[: len(prepared)]
    spread = rows[:, 3] + rows[:, 6] + rows[:, 8]
    fine = (spread < (side / 2) ** 2) & (rows[:, OPACITY] > -20) & np.isfinite(values).all(axis=1)
    cell = np.floor(rows[:, :3] / side)
    fine &= (np.abs(cell) < HALF_CELLS).all(axis=1)
    key = (cell[fine].astype(np.int64) + HALF_CELLS) @ (2 * HALF_CELLS) ** np.arange(3)
    _, first, which = np.unique(key, return_index=True, return_inverse=True)
    place = np.flatnonzero(fine)
    alone = np.bincount(which) == 1
    together = ~alone[which]
    group = (np.cumsum(~alone) - 1)[which[together]]
    new_rows, new_values = merged_rows(rows[place[together]], values[place[together]], group)
    kept = np.concatenate([np.flatnonzero(~fine), place[first[alone]]])
    source = np.concatenate([kept, place[first[~alone]]])
    rows = np.concatenate([rows[kept], new_rows])
    values = np.concatenate([values[kept], new_values])
    order = np.argsort(source, kind="stable")  # near in space stays near
    found = laid_out(rows[order], values, order.astype(np.int32), prepared.order[source[order]])
    return replace(found, compensate=prepared.compensate)


def merged_rows(rows, values, group):
    """Return geometry and harmonics of the splats that stand for groups of splats.

    Parameters
    ----------
    rows : ndarray of shape (n, 13), float32
        Geometry of the splats, as in `laid_out`.
    values : ndarray of shape (n, 3 k), float32
        Their harmonics.
    group : ndarray of shape (n,), int
        Number of each splat's group, from 0 without gaps.

    Returns
    -------
    rows, values : ndarray of shape (groups, 13) and (groups, 3 k), float32
    """
    if not len(rows):
        return rows, values
    weight = np.exp2(rows[:, OPACITY].astype(np.float64))
    weight = weight * _area(rows[:, 3:9])
    count = group.max() + 1

    def mean(value):
        return np.bincount(group, weight * value, count) / total

    total = np.maximum(np.bincount(group, weight, count), LEAST)
    out = np.zeros((count, GEOMETRY), np.float32)
    middle = np.stack([mean(rows[:, k].astype(np.float64)) for k in range(3)], -1)
    away = rows[:, :3] - middle[group]
    covariance = np.stack([
        mean(rows[:, 3 + k] + away[:, i] * away[:, j])
        for k, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    ], -1)  # fmt: skip
    out[:, :3], out[:, 3:9] = middle, covariance
    axes = np.linalg.eigh(covariance[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]])[1]
    out[:, 9:12] = axes[..., 0]
    depth = total / np.maximum(_area(covariance), LEAST)
    opacity = np.maximum(-np.expm1(-depth), HALF_STOPPED * depth)
    out[:, OPACITY] = np.log2(np.maximum(opacity, LEAST))
    light = np.stack([mean(values[:, k]) for k in range(values.shape[1])], -1)
    return out, light.astype(np.float32)


def _area(covariance):
    """Return a measure of the splats' mean shadow over all directions, shape (n,).

    It is the root of the sum of the principal 2 x 2 minors of `covariance`, (n, 6) as xx, xy, xz,
    yy, yz, zz.
    """
    xx, xy, xz, yy, yz, zz = covariance.T.astype(np.float64)
    minors = xx * yy - xy * xy + yy * zz - yz * yz + xx * zz - xz * xz
    return np.sqrt(np.maximum(minors, 0))
