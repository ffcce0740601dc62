"""Conditions at edges on a CUDA device: the host decides each step and treats the edges' cells.

A `WaterSolver` of the same map stands on the host. Before each launch it is given the numbers of a
strip along its conditions, and the functions of `rainsim.water.conditions` act on it as on the CPU;
what they change goes back to the device. The rest of the map stays there. The step itself adds the
rain, so a condition finds the rain of its step in its cells, where on the CPU the rain comes after.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.cuda.driver import fetch, send
from rainsim.cuda.water import step_control as at
from rainsim.cuda.water.cells import DEPTH, FILM, REMAINDER, Cells, U, V
from rainsim.grid import SOURCE_PERIOD
from rainsim.water.conditions import apply_conditions, let_in
from rainsim.water.conserving import PAD
from rainsim.water.inputs import EDGES
from rainsim.water.rows import RUN
from rainsim.water.sources import DRY_DEPTH

SPEEDS = [at.REACH_NOW, at.SWIFT_NOW]
FIRST = "west", "south"  # the edges at which rows and columns begin


def walls_at(condition, shape, is_open):
    """Return the walls that a condition's cells touch, its own edge last.

    Returns list of (edge, last, near). The row or column [cells] of the last
        cells before the wall, and the slice of the rows or columns near the
        condition.
    """
    (rows, columns), found = condition.at, []
    for edge in sorted(EDGES, key=lambda edge: edge == condition.edge):
        across, along = (columns, rows) if edge in ("west", "east") else (rows, columns)
        last = PAD if edge in FIRST else shape[edge in ("west", "east")] - PAD - 1
        if last in (across[0], across[-1]) and not is_open[edge]:
            found.append((edge, last, slice(along[0] - PAD, along[-1] + 4)))
    return found


class Edges:
    """The conditions of a solver, for a `Water` of its map.

    water : rainsim.cuda.grid.Water
    solver : WaterSolver. On the host; its conditions are used and changed, and of
        its fields the strip along them.
    came, left : float [m3]. Volumes that the conditions brought and took.
    """

    def __init__(self, water, solver):
        self._water, self._solver = water, solver
        marked = np.zeros(solver.flow.bed.shape, bool)
        for condition in solver.conditions:  # the cells, their ghosts, the cells behind them
            rows, columns = condition.at
            marked[rows[0] - PAD : rows[-1] + 3, columns[0] - PAD : columns[-1] + 3] = True
        self._at = np.nonzero(marked)
        rows, columns = self._at
        self._cells = Cells(water, len(rows))
        self._cells.choose(rows * water.cells.width + columns + at.LEAD)
        wide = RUN - 1
        runs = [
            (c.at[0][0], c.at[0][-1] + 1, west, min(west + wide, c.at[1][-1] + 1))
            for c in solver.conditions for west in range(c.at[1][0], c.at[1][-1] + 1, wide)
        ]  # fmt: skip
        self._tiles, count = np.array(runs, np.int64), np.arange(len(runs))[:, None]
        self._runs = np.hstack([self._tiles, count, count + 1])
        self._walls = [
            wall
            for c in solver.conditions
            for wall in walls_at(c, marked.shape, solver.flow.is_open)
        ]
        self.came = self.left = 0.0
        self._passed = self._late = 0.0  # m, see `book`

    def book(self, ledger):
        """Add what the conditions did to a `Ledger` of the device, in place; return it."""
        area = self._water.cells.area
        ledger.inflow += self.came
        # The device has booked what came in through faces of walls as outflow less than 0.
        ledger.outflow += self.left + area * self._passed
        ledger.ground += area * self._late  # the last step changed the cells after its sums
        return ledger

    def advance(self, end):
        """Step to the time `end` [s]; return the steps.

        A frame of no duration must have begun, see `Water.begin`.
        """
        solver, substeps = self._solver, 0
        self._receive()
        while end > solver.time:
            left = end - solver.time
            steps = max(1, math.ceil(left / solver._stable_step(left)))
            self._step(left / steps, last=steps == 1)
            substeps += 1
            solver.time = end if steps == 1 else solver.time + left / steps
            self._water.require_sound(self._state)
        account = self._water.account
        send(account.control, self._control, self._water.stream)  # with the speeds of what came in
        account.close()
        return substeps

    def _step(self, dt, last):
        """Advance by `dt` [s], as `WaterSolver._step` does."""
        solver, flow, sources, take = self._solver, self._solver.flow, self._solver.sources, -1.0
        let_in(solver, solver.time, solver.time + dt)
        if flow.is_at_whole_step:
            self._launch(0.0, 0.5 * dt)
        if sources.rain_sum > 0.0 or sources.has_storage or sources.has_losses:
            sources.unbooked_time += dt
            if last or sources.unbooked_time >= SOURCE_PERIOD:
                take, sources.unbooked_time = sources.unbooked_time, 0.0
        moves = flow.moves
        if moves:
            flow._note_entries(dt / solver.spacing, flow.bed.dtype)
            if flow.open_edges():
                self._passed += sum(float(c.passes.sum()) for c in solver.conditions)
            self._launch(dt, dt, take, last)
        deep = self._standing()
        came, left = apply_conditions(solver, solver.time, solver.time + dt, DRY_DEPTH)
        self.came, self.left = self.came + came, self.left + left
        if moves:
            self._late = self._standing() - deep
            self._send()
        else:
            self._late = 0.0
            if take >= 0.0:
                self._launch(0.0, 0.0, take)
            self._launch(0.0, dt, last=last)

    def _standing(self):
        """Return the depths of the conditions' cells, summed [m], float64."""
        water = self._solver.flow.water
        return sum(
            float(water.h[c.at].sum(dtype=np.float64) + water.remainder[c.at].sum(dtype=np.float64))
            for c in self._solver.conditions
        )

    def _launch(self, move, push, take=-1.0, last=False):
        """Queue one launch that moves, pushes and takes sources over these times [s]; wait."""
        solver, control, state = self._solver, self._control, self._state
        self._send()
        # With no time left the device plans no step of its own after this one.
        control[[at.LEFT, at.PENDING, at.MOVE, at.PUSH, at.TAKE]] = 0.0, 0.0, move, push, take
        control[at.CAP] = max(control[at.CAP], solver.flow.cap)
        if take >= 0.0:
            control[at.RAINED] += take * solver.sources.rain_sum
        state[[at.RUNS, at.LAST, at.WAITS, at.SETTLED]] = 1, last, 0, 1
        account, stream = self._water.account, self._water.stream
        send(account.control, control, stream)
        send(account.state, state, stream)
        self._water.step()
        # The device leaves out the faces of walls, through which the conditions let water in.
        waves, faces = solver.flow.speeds_of(move, push, self._runs, self._tiles)
        self._receive(waves, faces)

    def _mirror(self):
        """Mirror the water in the ghosts beyond the conditions, as at all walls of the CPU."""
        h, _, u, v = self._solver.flow.water
        fields = [
            (u, v, h) if edge in ("west", "east") else (v.T, u.T, h.T) for edge, *_ in self._walls
        ]
        for (edge, last, near), (across, *_) in zip(self._walls, fields, strict=True):
            face, out = (last, -1) if edge in FIRST else (last + 1, 1)
            across[near, face], across[near, face + out] = 0, -across[near, face - out]
        for (edge, last, near), (_, *along) in zip(self._walls, fields, strict=True):
            out = -1 if edge in FIRST else 1
            for k in range(1, PAD + 1):
                for field in along:
                    field[near, last + k * out] = field[near, last + (1 - k) * out]

    def _send(self):
        """Write the strip to the device, with what comes in through its faces."""
        self._mirror()
        self._solver.flow._set_entries()
        h, remainder, u, v = self._solver.flow.water
        for k, field in ((DEPTH, h), (U, u), (V, v), (REMAINDER, remainder)):
            self._table[k] = field[self._at]
        self._cells.write(self._table)

    def _receive(self, waves=0.0, faces=0.0):
        """Take the strip, the speeds, at least those given [m/s], and the account."""
        water, flow = self._water, self._solver.flow
        account, (h, remainder, u, v) = water.account, flow.water
        self._table = self._cells.read()
        film = self._solver.sources.film
        for k, field in ((DEPTH, h), (U, u), (V, v), (REMAINDER, remainder), (FILM, film)):
            field[self._at] = self._table[k]
        self._control, self._state = (
            fetch(array, water.stream) for array in (account.control, account.state)
        )
        speeds = np.maximum(self._control[SPEEDS], (waves, faces))
        flow.wave_speed, flow.water_speed = self._control[SPEEDS] = speeds.tolist()
        flow.cap = max(flow.cap, float(self._control[at.CAP]))
        flow.is_at_whole_step = self._state[at.WAITS] == 1
