"""Where the water begins: of the whole ground, and of a window of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Begin(NamedTuple):
    """Where the water of a window of the ground begins, see `simulation.steady_water`.

    Attributes
    ----------
    number : int
        Of the state.
    depth : ndarray of shape (ny, nx), float64 [m]
    velocity : ndarray of shape (2, ny, nx), float32 [m/s]
    notes : tuple of str
    exposure : ndarray of shape (ny, nx), float32
        Share of the rain that reaches the ground.
    """

    number: int
    depth: np.ndarray
    velocity: np.ndarray
    notes: tuple
    exposure: np.ndarray

    def within(self, window):
        """Return the part of this start within a window (slices of rows and columns)."""
        return self._replace(  # copied: the whole need not stay in memory
            depth=self.depth[window].copy(), exposure=self.exposure[window].copy(),
            velocity=self.velocity[(slice(None), *window)].copy(),
        )  # fmt: skip


def low_ground(terrain):
    """Return the height of the low ground [m], over which water levels are given."""
    return float(np.percentile(terrain.bed.astype(np.float64), 5))
