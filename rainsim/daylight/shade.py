"""What the shade of a capture differs from its model by, measured along the edges of shadows.

The model's sky is that of a usual clear day and its surroundings are coarse; shade beside a hedge
may be bluer and darker than that. Pairs of places on both sides of an edge show by how much, and
splats in the shade around take it over.
"""

from typing import NamedTuple

import numpy as np

from rainsim.numerics.places import cells_and_sides, group_means, nearest

CELL = 0.4  # m, within which the pairs have one mean
SPREAD, REACH = 1.0, 3.0  # m: standard deviation and end of the weight with the distance
NEAR_CELLS = 32
ENOUGH = 6.0  # pairs that count as much as the model does
MOST_PAIRS = 40.0  # of a cell, beyond which more pairs say no more
MOST_CHANGE = 0.8  # of the logarithm
SAME_SIDE = 0.8  # cosine between normals


class EdgeShade(NamedTuple):
    """Mean logarithm of shade by the model over captured shade, by cells with shadows' edges."""

    position: np.ndarray  # (n, 3), float32
    normal: np.ndarray  # (n, 3), float32
    change: np.ndarray  # (n, 3), float64, for each channel
    weight: np.ndarray  # (n,), float64


NO_EDGES = EdgeShade(
    np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros((0, 3)), np.zeros(0)
)


def edge_shade(position, normal, change):
    """Return the `EdgeShade` of pairs: place and normal in the shade, and the change of each."""
    if not len(position):
        return NO_EDGES
    group = cells_and_sides(position / CELL, normal)
    count = np.bincount(group)
    order = np.argsort(group, kind="stable")
    parts = np.split(order, np.cumsum(count)[:-1])
    middle, up = (group_means(group, v).astype(np.float32) for v in (position, normal))
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-6)
    median = np.array([np.median(change[part], axis=0) for part in parts])
    weight = np.minimum(count, MOST_PAIRS).astype(float)
    return EdgeShade(middle, up, np.clip(median, -MOST_CHANGE, MOST_CHANGE), weight)


def factor_in_shade(surface, shares, edges):
    """Return the factor (n, 3), float32, on the gains of splats in the shade.

    `shares` is how much of each splat the sun shines on.
    """
    factor = np.ones((len(shares), 3), np.float32)
    which = np.flatnonzero(shares < 0.99)
    if not len(edges.weight) or not len(which):
        return factor
    away, near, known = nearest(edges.position, surface.position[which], NEAR_CELLS, REACH)
    along = np.einsum("ijk,ik->ij", edges.normal[near], surface.normal[which])
    weight = np.exp(-0.5 * (away / SPREAD) ** 2) * edges.weight[near]
    weight *= known & (along > SAME_SIDE)
    total = np.einsum("ij,ijk->ik", weight, edges.change[near])
    change = total / (weight.sum(axis=1) + ENOUGH)[:, None]
    change *= (surface.flat[which] * (1 - shares[which]))[:, None]
    factor[which] = np.exp(change)
    return factor
