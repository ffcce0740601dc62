"""The surface of a capture as the search for its light takes it, and the carry-over to splats."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from rainsim.jit import get_num_threads
from rainsim.numerics.blocks import in_blocks
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS

NEIGHBOURS = 9  # places about one, itself included
# Of the places that a splat takes its values from: how many, their reach and the deviation of their
# weights [voxels], and the deviation over which they may differ in the logarithm of luminance.
TAKEN, REACH, SPREAD, ALIKE = 12, 4.0, 1.2, 0.3
FARTHEST = 1.5  # m from the surface: haze that is farther belongs to nothing
DIM = 0.004  # linear light below which noise decides


class Surface(NamedTuple):
    """Places on the surface of a capture, in the ground frame."""

    position: np.ndarray  # (n, 3), float32, m
    normal: np.ndarray  # (n, 3), float32, unit, towards those who see it
    flat: np.ndarray  # (n,), float32: places around lie in one plane, 0 (leaves) to 1 (paving)
    light: np.ndarray  # (n, 3), float32, linear captured colour, relative to display white
    neighbours: np.ndarray  # (n, NEIGHBOURS), int32
    area: np.ndarray  # (n,), float32, m2, that a place stands for


def luminance(light):
    """Return the luminance of linear light (n, 3)."""
    return light @ LUMINANCE_WEIGHTS.astype(np.float32)


def surface_of(found):
    """Return the `Surface` of a `surface.fuse.CaptureSurface`."""
    count = len(found.position)
    k = min(NEIGHBOURS, count)
    neighbours = np.zeros((count, 1), np.int32)
    if k > 1:
        tree = cKDTree(found.position, compact_nodes=False, balanced_tree=False)
        neighbours = tree.query(found.position, k=k, workers=get_num_threads())[1].astype(np.int32)
    return Surface(
        found.position, found.normal.copy(), found.flat, found.light, neighbours, found.size**2
    )


def carried(surface, size, values, position, light):
    """Return values (m, k) of a surface's places at splats, and which splats have some (m,).

    A splat takes the mean of the places around it, the less of one the farther it is and the more
    its brightness differs: at the edge of a shadow dark splats follow dark places. `size` [m] is
    that of the voxels of most places. `values`, (n, k), are positive; their logarithms are
    averaged.
    """
    found = np.ones((len(position), values.shape[1]), np.float32)
    near = np.zeros(len(position), bool)
    count = min(TAKEN, len(surface.position))
    if not count:
        return found, near
    tree = cKDTree(surface.position, compact_nodes=False, balanced_tree=False)
    own = np.log(np.maximum(luminance(surface.light), DIM))
    log = np.log(values)
    bright = np.log(np.maximum(luminance(light), DIM))

    def work(part):
        away, which = tree.query(
            position[part], k=range(1, count + 1), distance_upper_bound=FARTHEST
        )
        known = np.isfinite(away)
        which = np.where(known, which, 0)
        away = np.where(known, away, FARTHEST)
        # What floats before the surface has the nearest places at its own distance.
        spread = SPREAD * size + 0.5 * away[:, :1]
        weight = np.exp(-0.5 * (away / spread) ** 2 + 0.5 * (away[:, :1] / spread) ** 2)
        weight *= np.exp(-0.5 * ((own[which] - bright[part, None]) / ALIKE) ** 2) + 1e-3
        weight[~known] = 0
        total = weight.sum(axis=1, keepdims=True)
        mean = np.einsum("ij,ijk->ik", weight, log[which]) / np.maximum(total, 1e-12)
        near[part] = known[:, 0]
        found[part] = np.where(known[:, :1], np.exp(mean), 1)

    in_blocks(work, len(position), 1 << 14)
    return found, near
