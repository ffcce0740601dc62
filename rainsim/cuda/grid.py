"""The water solver on a CUDA device: `rainsim.grid.WaterSolver` with fields that lie there."""

import copy

import numpy as np

from rainsim.cuda import require
from rainsim.errors import ParameterError
from rainsim.grid import WaterSolver
from rainsim.water.conserving_flow import LeanFlow
from rainsim.water.inputs import require_drops

MOST_PLACES = 1 << 32  # of the numbers of both copies of depth and velocities


class GpuWaterSolver(WaterSolver):
    """The water of a `WaterSolver` on a CUDA device; it begins with that solver's state.

    It is a `WaterSolver` itself: the host decides each step, and the device takes it.

    Parameters
    ----------
    solver : WaterSolver
        Of scheme "lean" and float32. It stays as it is.
    exposure : array_like of shape (ny, nx), optional
        Share of the rain that falls on each cell; 1 by default.

    Attributes
    ----------
    time : float [s]
    steps : int
        Taken so far.
    conditions : list of Stage, Discharge or Rating
        Copies of the solver's, each with its `volume` [m3] and `flow` [m3/s].

    Examples
    --------
    >>> solver = rainsim.WaterSolver(np.zeros((64, 64)), 0.1, scheme="lean", manning=0.02)
    >>> gpu = rainsim.GpuWaterSolver(solver)  # doctest: +SKIP
    >>> steps = gpu.advance(60.0, rain=50 / 3.6e6)  # doctest: +SKIP
    >>> gpu.depth.mean(), gpu.ledger.residual  # doctest: +SKIP
    """

    def __init__(self, solver, exposure=None):
        require()
        _require_lean(solver)
        # Where there is no device these cannot be imported.
        from rainsim.cuda.water.conditions import Strip
        from rainsim.cuda.water.conserving_flow import DeviceLeanFlow
        from rainsim.cuda.water.flow import pitch
        from rainsim.cuda.water.sources import DeviceSources

        ny, nx = solver.flow.bed.shape
        if 6 * (ny + 1) * pitch(nx) > MOST_PLACES:  # places are numbers of 32 bits
            raise ParameterError(
                f"the map has {solver.shape[0]} x {solver.shape[1]} cells; a CUDA device takes "
                f'some {MOST_PLACES // 6 // 10**6} million; take larger cells, or backend "cpu"'
            )
        vars(self).update(vars(solver))
        self._given, self.steps = solver, 0
        self.conditions = copy.deepcopy(solver.conditions)
        self.flow = DeviceLeanFlow(solver.flow)
        self.sources = DeviceSources(self.flow, solver.sources, exposure)
        if self.conditions:
            self.flow.strip = Strip(self.conditions, self.flow, self.sources)
        self._restore(solver._saved())

    # -- state ---------------------------------------------------------------------------------

    def set_state(self, depth, u=None, v=None):
        """Set depth and velocity as `WaterSolver.set_state` does."""
        host = self.on_host()
        host.set_state(depth, u, v)
        self._restore(host._saved())

    def on_host(self):
        """Return a `WaterSolver` with the present state."""
        host = copy.deepcopy(self._given)
        host.sources.exposure = self.sources.exposure
        host._restore(self._saved())
        return host

    def _saved(self):
        self._take_in()
        return super()._saved()

    def deposit(self, rows, columns, volumes):
        """Add drops as `WaterSolver.deposit` does; the ledger has them once they are taken in."""
        rows, columns, volumes = map(np.atleast_1d, (rows, columns, volumes))
        require_drops(rows, columns, volumes, self.shape)
        if len(rows):
            self.sources.deposit(rows, columns, volumes)
            self._has_deposits = True

    @property
    def depth(self):
        """Depth above the bed, film included, ndarray of shape (ny, nx) [m]; a copy."""
        self.sources.standing()
        return self.sources.depth.copy_to_host()

    # -- time ----------------------------------------------------------------------------------

    def advance(self, duration, rain=0.0, progress=None):
        """Advance as `WaterSolver.advance` does; return the steps."""
        steps = super().advance(duration, rain, progress).substeps
        self.steps += steps
        return steps

    def _stable_step(self, left):
        with self.flow.by_strip():
            return super()._stable_step(left)

    def _step(self, dt, last):
        with self.flow.by_strip():
            super()._step(dt, last)

    def _choose_scheme(self):
        """Leave it at "lean"."""

    def _book_standing_water(self):
        area = self.spacing**2
        ground, film = self.sources.standing()
        self._ledger.ground, self._ledger.film = ground * area, film * area
        self._standing = np.zeros((3, 1))  # the least depth is not looked for


def _require_lean(solver):
    """Raise ParameterError for a scheme or float type that the device's solver does not have."""
    dtype = solver.flow.bed.dtype
    if not isinstance(solver.flow, LeanFlow) or dtype != np.float32:
        raise ParameterError(
            f"the water scheme is {solver.scheme!r} in {dtype}; on a CUDA device it must be "
            '"lean" in float32, which "auto" takes; give that, or backend "cpu"'
        )
