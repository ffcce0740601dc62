"""What rasterizing needs of a scene and no camera changes: prepared once, used for all pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rainsim.jit import cpu_kernel, prange

ONE = np.float32(1)
TWO = np.float32(2)


@dataclass(frozen=True)
class PreparedSplats:
    """What rasterizing needs of a scene and no camera changes; splats in Morton order.

    Attributes
    ----------
    position : ndarray of shape (n, 3), float32 [capture units]
    covariance : ndarray of shape (n, 6), float32 [capture units^2]
        xx, xy, xz, yy, yz, zz.
    normal : ndarray of shape (n, 3), float32
        The splat's thinnest axis, sign free.
    opacity_log2 : ndarray of shape (n,), float32
    sh : ndarray of shape (n, 3 k), float32
    order : ndarray of shape (n,), int64
        Index of each prepared splat in the scene it came from.
    """

    position: np.ndarray
    covariance: np.ndarray
    normal: np.ndarray
    opacity_log2: np.ndarray
    sh: np.ndarray
    order: np.ndarray


def prepare(splats):
    """Return the `PreparedSplats` of `splats`: Morton order, covariances and normals."""
    order = _morton_order(splats.position)
    n = len(order)
    covariance = np.empty((n, 6), np.float32)
    normal = np.empty((n, 3), np.float32)
    _covariances(splats.scale, splats.rotation, order, covariance, normal)
    with np.errstate(divide="ignore"):
        opacity_log2 = np.log2(splats.opacity[order], dtype=np.float32)
    sh = splats.sh.reshape(n, -1) if n else np.zeros((0, 3), np.float32)
    position = splats.position[order]
    return PreparedSplats(position, covariance, normal, opacity_log2, sh[order], order)


def select(prepared, keep):
    """Return those of the prepared splats that the mask `keep` (in prepared order) selects."""
    return PreparedSplats(
        prepared.position[keep],
        prepared.covariance[keep],
        prepared.normal[keep],
        prepared.opacity_log2[keep],
        prepared.sh[keep],
        prepared.order[keep],
    )


def _morton_order(position):
    """Return the order of `position` (n, 3) along a Morton curve: near in space, near in memory."""
    if len(position) == 0:
        return np.zeros(0, np.int64)
    low, high = np.percentile(position[:: max(1, len(position) // 100_000)], (0.5, 99.5), axis=0)
    cell = (position - low) / np.maximum(high - low, np.finfo(np.float32).tiny) * 1023
    cell = np.clip(np.nan_to_num(cell), 0, 1023).astype(np.uint32)
    code = _spread_bits(cell[:, 0])
    code |= _spread_bits(cell[:, 1]) << np.uint32(1)
    code |= _spread_bits(cell[:, 2]) << np.uint32(2)
    return np.argsort(code, kind="stable")


def _spread_bits(x):
    """Put two zero bits between the ten bits of each x."""
    for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
        x = (x | x << np.uint32(shift)) & np.uint32(mask)
    return x


@cpu_kernel
def _covariances(scale, rotation, order, covariance_out, normal_out):
    for s in prange(len(order)):
        o = order[s]
        w, x, y, z = rotation[o, 0], rotation[o, 1], rotation[o, 2], rotation[o, 3]
        r00, r01, r02 = ONE - TWO * (y * y + z * z), TWO * (x * y - w * z), TWO * (x * z + w * y)
        r10, r11, r12 = TWO * (x * y + w * z), ONE - TWO * (x * x + z * z), TWO * (y * z - w * x)
        r20, r21, r22 = TWO * (x * z - w * y), TWO * (y * z + w * x), ONE - TWO * (x * x + y * y)
        s0, s1, s2 = scale[o, 0], scale[o, 1], scale[o, 2]
        a, b, c = s0 * s0, s1 * s1, s2 * s2
        covariance_out[s, 0] = a * r00 * r00 + b * r01 * r01 + c * r02 * r02
        covariance_out[s, 1] = a * r00 * r10 + b * r01 * r11 + c * r02 * r12
        covariance_out[s, 2] = a * r00 * r20 + b * r01 * r21 + c * r02 * r22
        covariance_out[s, 3] = a * r10 * r10 + b * r11 * r11 + c * r12 * r12
        covariance_out[s, 4] = a * r10 * r20 + b * r11 * r21 + c * r12 * r22
        covariance_out[s, 5] = a * r20 * r20 + b * r21 * r21 + c * r22 * r22
        if s0 <= s1 and s0 <= s2:
            normal_out[s, 0], normal_out[s, 1], normal_out[s, 2] = r00, r10, r20
        elif s1 <= s2:
            normal_out[s, 0], normal_out[s, 1], normal_out[s, 2] = r01, r11, r21
        else:
            normal_out[s, 0], normal_out[s, 1], normal_out[s, 2] = r02, r12, r22
