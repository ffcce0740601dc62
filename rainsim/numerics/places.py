"""Places in space: groups of them in cells, the means of groups, and those nearest to others."""

import numpy as np
from scipy.spatial import cKDTree

from rainsim.jit import get_num_threads


def cells_and_sides(place, normal):
    """Return the group of each place, (n,): those of one cell and side are one.

    `place` (n, 3) [cells]; the side is the axis and the sense that its normal (n, 3) is nearest to.
    """
    cell = np.floor(place).astype(np.int64)
    side = np.argmax(np.abs(normal), axis=1)
    side += 3 * (np.take_along_axis(normal, side[:, None], 1)[:, 0] < 0)
    return groups_of(cell, side)


def groups_of(cell, side):
    """Return the group of each place, (n,), by its cell (n, 3) and side (n,), whole numbers."""
    cell = cell - cell.min(axis=0, initial=0)
    key = ((cell[:, 0] << 40) | (cell[:, 1] << 20) | cell[:, 2]) * 7 + side
    return np.unique(key, return_inverse=True)[1].ravel()


def group_means(group, values, weight=None):
    """Return the means (m, k), float64, of values (n, k) over the groups (n,) they belong to."""
    total = np.bincount(group, weight)
    sums = [np.bincount(group, v if weight is None else weight * v) for v in values.T]
    return np.stack(sums, axis=-1) / total[:, None]


def nearest(places, at, most, reach):
    """Return the places (m, 3) next to each of others (n, 3), at most so many within a reach.

    Returns away : array (n, k). Distances; infinite where there is none.
        near : int64 array (n, k). Their numbers, 0 where there is none.
        known : bool array (n, k)
    """
    tree = cKDTree(places, compact_nodes=False, balanced_tree=False)
    away, near = tree.query(
        at, k=range(1, min(most, len(places)) + 1), distance_upper_bound=reach,
        workers=get_num_threads(),
    )  # fmt: skip
    known = np.isfinite(away)
    return away, np.where(known, near, 0), known
