"""The water solver alone on a CUDA device, without a scene."""

from __future__ import annotations

import numpy as np

from rainsim.cuda import require
from rainsim.errors import require_not_negative
from rainsim.water.inputs import field
from rainsim.water.series import rain_pieces


class GpuWaterSolver:
    """The water of a `WaterSolver` on a CUDA device; it begins with that solver's state.

    Parameters
    ----------
    solver : WaterSolver
        Of scheme "lean" and float32, without conditions at edges. It stays as it is.
    exposure : array_like of shape (ny, nx), optional
        Share of the rain that falls on each cell; 1 by default.
    capacity : int
        Steps that are queued before the host looks whether time is left.

    Attributes
    ----------
    time : float [s]
    water : rainsim.cuda.grid.Water
        Owner of the fields on the device.

    Examples
    --------
    >>> solver = rainsim.WaterSolver(np.zeros((64, 64)), 0.1, scheme="lean", manning=0.02)
    >>> gpu = rainsim.GpuWaterSolver(solver)  # doctest: +SKIP
    >>> steps = gpu.advance(60.0, rain=50 / 3.6e6)  # doctest: +SKIP
    >>> gpu.depth.mean(), gpu.ledger.residual  # doctest: +SKIP
    """

    def __init__(self, solver, exposure=None, capacity=64):
        require()
        from rainsim.cuda.grid import Water  # where there is no device these cannot be imported
        from rainsim.cuda.jit import cuda

        self.water = Water(solver, exposure, capacity, cuda.stream())
        self.time = solver.time
        ones = np.ones(solver.shape, np.float32)
        self._exposure = ones if exposure is None else np.asarray(exposure, np.float32)
        self._falls = self._exposure  # the share of each cell that the device has now

    def advance(self, duration, rain=0.0, progress=None):
        """Advance by `duration` [s] under `rain` [m/s]; return the steps.

        `rain` is a rate, a map of rates of shape (ny, nx) or a `Series`.

        `progress` is called with the time [s] wherever a series changes and at the end; where it
        returns False the solver stops.
        """
        end, steps = self.time + require_not_negative("duration", duration, "s"), 0
        for stop, rate in rain_pieces(rain, self.time, end):
            steps += self.water.advance(stop - self.time, self._let_fall(rate))
            self.time = stop
            if progress is not None and progress(stop) is False:
                break
        return steps

    def _let_fall(self, rain):
        """Set each cell's share of the rain, a rate or a map [m/s]; return the largest rate."""
        shape = self.water.shape
        field("rain", rain, shape)  # checks it
        rain = np.asarray(rain, np.float64)  # one rate stays one number
        most = float(rain.max())
        share = self._exposure
        if most > 0.0 and rain.min() < most:
            share = (rain / most * share).astype(np.float32)
        if share is not self._falls:
            self.water.let_through(share, [slice(0, shape[0])])
            self._falls = share
        return most

    def deposit(self, rows, columns, volumes):
        """Add drops: `volumes` [m3] into the cells (`rows`, `columns`), arrays of one length."""
        self.water.deposit(rows, columns, volumes)

    @property
    def depth(self):
        """Depth above the bed, film included, ndarray of shape (ny, nx) [m]; a copy."""
        return self.water.fields()[0]

    @property
    def ledger(self):
        """The `Ledger` of the account so far."""
        return self.water.ledger()
