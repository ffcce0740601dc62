"""How full the film of a road is where tyres have passed."""

from __future__ import annotations

import math

import numpy as np

from rainsim.jit import cpu_kernel, inlined_function, prange

REACH = 4  # deviations, after which the blur ends


def blur_weights(deviation):
    """Return the weights of a Gaussian of a deviation [cells], ndarray (n,), the middle first."""
    cells = np.arange(math.ceil(REACH * deviation) + 1)
    weights = np.exp(-0.5 / deviation**2 * cells**2)
    return weights / (weights[0] + 2 * weights[1:].sum())


@inlined_function
def mirrored(k, n):
    """Return the cell of a row of n that a cell k beside it repeats: b a | a b c d | d c."""
    while k < 0 or k >= n:
        k = -1 - k if k < 0 else 2 * n - 1 - k
    return k


@cpu_kernel
def lay_tracks(depth, passed, classes, holds, least, weights, tracks_out):
    """Write how full the film is, of 255, its edges blurred; 255 where no tyre has passed.

    Parameters
    ----------
    depth : ndarray of shape (ny, nx) [m]
        Of the water.
    passed : ndarray of shape (ny, nx), bool
    classes : ndarray of shape (ny, nx)
        Ground classes.
    holds : ndarray of shape (classes,), float32 [m]
        Depth of a full film on each.
    least : float32 [m]
        Such a depth at least.
    weights : ndarray of shape (n,), float64
        See `blur_weights`.
    tracks_out : ndarray of shape (ny, nx), uint8
    """
    (ny, nx), reach = depth.shape, len(weights) - 1
    share, touched = np.empty((ny, nx), np.float32), np.zeros(ny, np.bool_)
    for j in prange(ny):
        for i in range(nx):
            share[j, i] = 1
            if passed[j, i]:
                full = depth[j, i] / max(holds[classes[j, i]], least)
                share[j, i] = min(max(full, 0), 1)
                touched[j] = True
    for j in prange(ny):
        if not touched[max(j - reach, 0) : j + reach + 1].any():
            tracks_out[j] = 255
            continue
        total, line = np.empty(nx), np.empty(nx + 2 * reach)
        for i in range(nx):
            total[i] = weights[0] * share[j, i]
        for k in range(reach, 0, -1):
            before, after = share[mirrored(j - k, ny)], share[mirrored(j + k, ny)]
            for i in range(nx):
                total[i] += weights[k] * (np.float64(before[i]) + np.float64(after[i]))
        for i in range(nx):
            line[reach + i] = np.float32(total[i])
        for k in range(reach):
            line[k] = line[reach + mirrored(k - reach, nx)]
            line[reach + nx + k] = line[reach + mirrored(nx + k, nx)]
        for i in range(nx):
            total[i] = weights[0] * line[reach + i]
        for k in range(reach, 0, -1):
            for i in range(nx):
                total[i] += weights[k] * (line[reach + i - k] + line[reach + i + k])
        for i in range(nx):
            tracks_out[j, i] = np.uint8(np.rint(np.float32(255) * np.float32(total[i])))
