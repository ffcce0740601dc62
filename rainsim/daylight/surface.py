"""The surfaces that a capture's splats show, in the ground frame: places, normals, colours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from rainsim.constants import SH_0
from rainsim.jit import get_num_threads
from rainsim.numerics.blocks import in_blocks
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS, linear

NEIGHBOURS = 9  # splats about one, itself included, whose planes are compared
RAGGED, SMOOTH = 0.45, 0.75  # mean square of the cosines between their normals: no plane, a plane
FLAT_RATIO = 0.6  # of the two lesser deviations, above which a splat has no plane of its own
MOST_CAMERAS = 24  # that are asked which side of a splat they see


class Surface(NamedTuple):
    """Splats as pieces of surfaces, in the ground frame.

    Attributes
    ----------
    position, normal : ndarray of shape (n, 3), float32
        [m]; unit, towards those who see it.
    flat : ndarray of shape (n,), float32
        How far the splats around lie in one plane, 0 (leaves) to 1 (paving).
    light : ndarray of shape (n, 3), float32
        Linear colour of degree 0, relative to display white.
    weight : ndarray of shape (n,), float32
        Light that the splat stops, 0 to 1.
    neighbours : ndarray of shape (n, NEIGHBOURS), int32
    area : ndarray of shape (n,), float32 [m2]
        That a splat would cover if it were evenly as dense as in its middle.
    """

    position: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    light: np.ndarray
    weight: np.ndarray
    neighbours: np.ndarray
    area: np.ndarray


def luminance(light):
    """Return the luminance of linear light (n, 3)."""
    return light @ LUMINANCE_WEIGHTS.astype(np.float32)


def covariances(splats, frame):
    """Return the covariances (n, 6) [m2] and the thinnest axes (n, 3) in the ground frame.

    Also the deviations [m], sorted. What is no number stays so.
    """
    n = len(splats)
    packed, thin = np.empty((n, 6), np.float32), np.empty((n, 3), np.float32)
    size = np.sort(splats.scale, axis=1) * np.float32(frame.meters_per_unit)
    rotation = frame.rotation.astype(np.float32)

    def work(part):
        q = splats.rotation[part]
        w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
        turn = np.stack([
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ], -1).reshape(-1, 3, 3)  # fmt: skip
        turn = np.matmul(rotation, turn)
        axes = turn * (splats.scale[part] * np.float32(frame.meters_per_unit))[:, None, :]
        full = np.matmul(axes, axes.transpose(0, 2, 1))
        packed[part] = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
        least = np.argmin(splats.scale[part], axis=1)
        thin[part] = np.take_along_axis(turn, least[:, None, None], 2)[..., 0]

    with np.errstate(all="ignore"):
        in_blocks(work, n)
    return packed, thin, size


def surface_of(position, thin, size, opacity, color, cameras):
    """Return the `Surface` of splats of the ground frame.

    Parameters
    ----------
    position, thin : ndarray of shape (n, 3), float32
        Finite; see `covariances`.
    size : ndarray of shape (n, 3), float32 [m]
    opacity : ndarray of shape (n,), float32
    color : ndarray of shape (n, 3), float32
        Coefficients of degree 0.
    cameras : sequence of Camera
        In the ground frame; may be empty.
    """
    neighbours = _nearest(position)
    normal = np.ascontiguousarray(_towards(position, thin, cameras), np.float32)
    alike = np.zeros(len(position), np.float32)
    for k in range(1, neighbours.shape[1]):
        alike += np.einsum("ij,ij->i", normal, normal[neighbours[:, k]]) ** 2
    alike /= max(neighbours.shape[1] - 1, 1)
    flat = np.clip((alike - RAGGED) / (SMOOTH - RAGGED), 0, 1)
    flat[size[:, 0] > FLAT_RATIO * size[:, 1]] = 0
    light = linear(color * np.float32(SH_0) + np.float32(0.5))
    return Surface(
        position, normal, flat.astype(np.float32), light.astype(np.float32),
        opacity.astype(np.float32), neighbours,
        (2 * np.pi * opacity * size[:, 1] * size[:, 2]).astype(np.float32),
    )  # fmt: skip


def _nearest(position):
    """Return the splats nearest to each, itself first, (n, k)."""
    k = min(NEIGHBOURS, len(position))
    if k < 2:
        return np.zeros((len(position), 1), np.int32)
    tree = cKDTree(position, compact_nodes=False, balanced_tree=False)
    found = tree.query(position, k=k, workers=get_num_threads())[1]
    return found.astype(np.int32)


def _towards(position, thin, cameras):
    """Return the thinnest axes towards the cameras, the nearest first; upwards without cameras."""
    if not cameras:
        return np.where(thin[:, 2:] < 0, -thin, thin)
    step = max(1, len(cameras) // MOST_CAMERAS)
    side = np.zeros(len(position), np.float32)
    for camera in cameras[::step]:
        away = camera.position.astype(np.float32) - position
        square = np.einsum("ij,ij->i", away, away) + np.float32(1e-6)
        side += np.einsum("ij,ij->i", away, thin) / square**1.5
    return np.where(side[:, None] < 0, -thin, thin)
