"""The water solver alone on a CUDA device, without a scene."""

from __future__ import annotations

import copy

import numpy as np

from rainsim.cuda import require
from rainsim.errors import require_not_negative
from rainsim.grid import span_of_call
from rainsim.water.inputs import field
from rainsim.water.series import rain_pieces


class GpuWaterSolver:
    """The water of a `WaterSolver` on a CUDA device; it begins with that solver's state.

    Parameters
    ----------
    solver : WaterSolver
        Of scheme "lean" and float32. It stays as it is.
    exposure : array_like of shape (ny, nx), optional
        Share of the rain that falls on each cell; 1 by default.
    capacity : int
        Steps that are queued before the host looks whether time is left. With conditions at edges
        the host decides each step.

    Attributes
    ----------
    time : float [s]
    steps : int
        Taken so far.
    water : rainsim.cuda.grid.Water
        Owner of the fields on the device.
    conditions : list of Stage, Discharge or Rating
        Copies of the solver's, each with its `volume` [m3] and `flow` [m3/s].

    Examples
    --------
    >>> solver = rainsim.WaterSolver(np.zeros((64, 64)), 0.1, scheme="lean", manning=0.02)
    >>> gpu = rainsim.GpuWaterSolver(solver)  # doctest: +SKIP
    >>> steps = gpu.advance(60.0, rain=50 / 3.6e6)  # doctest: +SKIP
    >>> gpu.depth.mean(), gpu.ledger.residual  # doctest: +SKIP
    """

    def __init__(self, solver, exposure=None, capacity=64):
        require()
        ones = np.ones(solver.shape, np.float32)
        self._exposure = ones if exposure is None else np.asarray(exposure, np.float32)
        self._exposed = exposure is None  # wholly
        self._capacity, self.steps, self.shape = capacity, 0, solver.shape
        # Copied when it is first needed: large maps take gigabytes.
        self._host, self._is_own = solver, False
        if solver.conditions or solver._has_deposits or solver.sources.unbooked_time:
            self._own()
        self._begin()

    def _own(self):
        """Return the solver on the host, a copy of the one that was given."""
        if not self._is_own:
            self._host, self._is_own = copy.deepcopy(self._host), True
        return self._host

    def _begin(self):
        """Put the state of the solver on the host on the device."""
        from rainsim.cuda.grid import Water  # where there is no device these cannot be imported
        from rainsim.cuda.jit import cuda
        from rainsim.cuda.water.conditions import Edges

        host = self._host
        if host._has_deposits or host.sources.unbooked_time:
            host._apply_sources(host.sources.unbooked_time)
            host.sources.unbooked_time = 0.0
            if host._has_deposits:
                host.flow.refresh()
                host._has_deposits = host.settled = False
            host._book_standing_water()
        exposure = None if self._exposed else self._exposure
        self.water = Water(host, exposure, self._capacity, cuda.stream())
        self.time, self._planned, self._rain = host.time, host._planned, None
        self.conditions = host.conditions
        self._edges = Edges(self.water, host) if host.conditions else None
        self._falls = self._exposure  # the share of each cell that the device has now
        self._has_deposits, self._is_new = False, not self._is_own  # newer than the host's

    def advance(self, duration, rain=0.0, progress=None):
        """Advance by `duration` [s] under `rain` [m/s]; return the steps.

        `rain` is a rate, a map of rates of shape (ny, nx) or a `Series`.

        `progress` is called with the time [s] wherever a series changes and at the end; where it
        returns False the solver stops. The next call goes on from there: to the same bytes as if it
        had not stopped, if it has the same end and the same rain.
        """
        begin, end = span_of_call(
            self._planned, self.time, self.time + require_not_negative("duration", duration, "s")
        )
        if end > self.time:
            self._planned = begin, end
        steps = 0
        for stop, rate in rain_pieces(rain, begin, end):
            if stop <= self.time < end:
                continue
            steps += self._advance_to(stop, rate)
            if progress is not None and progress(stop) is False:
                break
        self.steps += steps
        return steps

    def _advance_to(self, stop, rain):
        most, added = self._let_fall(rain), self._has_deposits
        self._rain, self._has_deposits, self._is_new = rain, False, True
        if self._edges is None:
            steps = self.water.advance(stop - self.time, most, added)
        else:
            self._host.sources.set_rain(self._rates())
            self.water.account.update(0.0, most, added)
            self.water.begin()
            steps = self._edges.advance(stop)
        self.time = stop
        return steps

    def _rates(self):
        """Return the rain that reaches each cell [m/s], a rate or a map."""
        return self._rain if self._exposed else self._rain * self._exposure

    def _let_fall(self, rain):
        """Set each cell's share of the rain, a rate or a map [m/s]; return the largest rate."""
        field("rain", rain, self.shape)  # checks it
        rain = np.asarray(rain, np.float64)  # one rate stays one number
        most = float(rain.max())
        share = self._exposure
        if most > 0.0 and rain.min() < most:
            share = (rain / most * share).astype(np.float32)
        if share is not self._falls:
            self.water.let_through(share)
            self._falls = share
        return most

    def deposit(self, rows, columns, volumes):
        """Add drops: `volumes` [m3] into the cells (`rows`, `columns`), arrays of one length."""
        self.water.deposit(rows, columns, volumes)
        self._has_deposits = self._is_new = True

    @property
    def depth(self):
        """Depth above the bed, film included, ndarray of shape (ny, nx) [m]; a copy."""
        depth = self.water.fields()[0]
        if self._edges is not None:  # after the step that wrote it their cells have changed
            (h, remainder, _, _), film = self._host.flow.water, self._host.sources.film
            for condition in self.conditions:
                at = condition.at
                depth[condition.rows, condition.columns] = film[at] + (h[at] + remainder[at])
        return depth

    @property
    def ledger(self):
        """The `Ledger` of the account so far."""
        ledger = self.water.ledger()
        return ledger if self._edges is None else self._edges.book(ledger)

    # -- the state on the host -----------------------------------------------------------------

    def on_host(self):
        """Return a `WaterSolver` with the present state; the next call changes the same one."""
        if self._is_new:
            host = self._own()
            self.water.bring_to(host)
            if self._rain is not None:
                host.sources.set_rain(self._rates())
            host.time, host._planned, host._ledger = self.time, self._planned, self.ledger
            host._has_deposits = False
            if self._has_deposits:
                host.deposit(*self.water.undelivered())
            self._is_new = False
        return self._host

    def save(self, path):
        """Write the state to a file (.npz) as `WaterSolver.save` does; either solver loads it."""
        self.on_host().save(path)

    def load(self, path):
        """Take the state of a solver that was made as this one was, with the same exposure.

        Depths and velocities go on to the same bytes, volumes of the ledger but for rounding.
        """
        self._own().load(path)
        self._begin()

    @property
    def flow(self):
        """The flow of `on_host`."""
        return self.on_host().flow

    @property
    def sources(self):
        """The sources of `on_host`."""
        return self.on_host().sources

    @property
    def velocity(self):
        """Velocity (u, v) at cell centres, two ndarrays of shape (ny, nx) [m/s]; copies."""
        return self.on_host().velocity

    @property
    def choice(self):
        """Scheme and Courant number, and why, as a sentence."""
        return self._host.choice

    @property
    def scheme(self):
        """The scheme's name."""
        return self._host.scheme

    def discharge(self, edge):
        """Return the flow that leaves through `edge` now [m3/s]."""
        return self.on_host().discharge(edge)
