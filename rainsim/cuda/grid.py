"""The water solver on a CUDA device: takes over the state of a `WaterSolver`, a frame at a time.

`launch` only queues work, so that a frame's launches can be captured in a graph. How many steps a
frame needs is decided on the device; `capacity` are launched, and what is left over is counted.
"""

from __future__ import annotations

import numpy as np

from rainsim.cuda.driver import Staging, fetch, send, to_device
from rainsim.cuda.graph import Graph
from rainsim.cuda.moving_map import MovingMap
from rainsim.cuda.rain.settling import CellLayout
from rainsim.cuda.water import flow as lean
from rainsim.cuda.water import step_control
from rainsim.cuda.water.account import Account
from rainsim.errors import DivergedError, ParameterError
from rainsim.water.conserving import PAD
from rainsim.water.conserving_flow import LeanFlow
from rainsim.water.inputs import EDGES
from rainsim.water.sources import DRY_DEPTH, drain_cells

CAPACITY = 12  # steps queued for a frame
MOST_PLACES = 1 << 32  # of the numbers of both copies of depth and velocities


class Water:
    """Shallow water on a CUDA device, by the scheme "lean".

    solver : WaterSolver. Of scheme "lean" and float32; its state is copied.
    exposure : float32 array (ny, nx), or None. Share of the rain that falls on
        each cell; None for 1.
    capacity : int. Steps queued for a frame.
    stream : cuda.stream
    depths : list of float32 device array (ny, nx) [m]. Depth above the bed, film
        included, at the ends of the last frames by `page`.
    waiting : device array of shape ((ny + 5) * width,), int64. Depth of drops
        that fell since, in `step_control.UNIT`.
    cells : CellLayout. Of `waiting`.
    account : Account
    Raises ParameterError if the solver has what this one has not.
    """

    def __init__(self, solver, exposure=None, capacity=CAPACITY, stream=0):
        _require_lean(solver)
        _require_room(solver)
        self.shape, self.stream, self.capacity = solver.shape, stream, capacity
        flow, sources, water = solver.flow, solver.sources, solver.flow.water
        ny, nx = flow.bed.shape
        ones = np.ones(self.shape, np.float32)
        exposure = ones if exposure is None else np.asarray(exposure, np.float32)
        wide = step_control.pitch(nx)
        columns = -(-(nx - 2 * PAD) // lean.THREADS)
        rows = lean.rows_for(ny - 2 * PAD, columns)
        kinds = sum(1 << k for k, is_open in enumerate(flow.edge_is_open) if is_open)
        kinds |= 0 if flow.roughness is None else step_control.RUBS
        self._layout = lean.Layout(ny, nx, wide, rows, kinds)
        self._limits = lean.Limits(*map(np.float32, (solver.gravity, flow.rounding, flow.dry)))
        self.cells = CellLayout(PAD * wide + PAD + step_control.LEAD, wide, solver.spacing**2)
        fields = [
            self._framed(a) for copy in (water, flow._spare) for a in (copy.h, copy.u, copy.v)
        ]
        self._fields = to_device(np.stack(fields).reshape(-1), stream)
        rough = np.zeros_like(flow.bed) if flow.roughness is None else flow.roughness
        takes = _what_the_ground_takes(solver)
        maps = flow.bed, rough, np.pad(exposure, PAD), takes, sources.storage
        *maps, self._remainder, self._film = (
            to_device(self._framed(field).reshape(-1), stream)
            for field in (*maps, water.remainder, sources.film)
        )
        self._maps = lean.Maps(*maps)
        self.waiting = to_device(np.zeros((ny + 1) * wide, np.int64), stream)
        depth = np.ascontiguousarray(solver.depth)
        self.depths, self.page = [to_device(depth, stream) for _ in range(2)], 0
        self._blocks = columns, -(-(ny - 2 * PAD) // rows)
        side = -(-(nx - 2 * PAD) // step_control.SIDE)
        height = -(-(ny - 2 * PAD) // step_control.HEIGHT)
        self._stripes = side, -(-height // step_control.STRIPE)
        most = max(self._blocks[0] * self._blocks[1], side * height)
        self.account = Account(solver, exposure, most, stream)
        shares = self._maps.exposure.reshape(ny + 1, wide)
        west = step_control.LEAD + PAD
        rows, columns = slice(PAD, PAD + self.shape[0]), slice(west, west + self.shape[1])
        self._exposure = MovingMap(shares[rows, columns], Staging(stream), exposure)
        self._recorded = {}  # launches of `advance` by name and page

    def _framed(self, field):
        """Return a map as the device has it, (ny + 1, width), float32."""
        framed = np.zeros((self._layout.ny + 1, self._layout.pitch), np.float32)
        framed[: field.shape[0], step_control.LEAD : step_control.LEAD + field.shape[1]] = field
        return framed

    def let_through(self, exposure):
        """Let another share (ny, nx), float32, of the rain fall from what is queued next on."""
        self.account.let_through(exposure)
        self._exposure.send(exposure, [], exposure)

    def shelter(self, exposure, windows):
        """Let less rain than `let_through` has said fall on some windows, and on no other cells.

        exposure : float32 array (ny, nx)
        windows : list of tuple of slice. Rows and columns.
        """
        self.account.shelter(exposure, windows)
        self._exposure.send(exposure, windows, self.account.open)

    @property
    def arrays(self):
        """The water of all cells, see `flow.step`: fields, remainder, film."""
        return self._fields, self._remainder, self._film

    def deposit(self, rows, columns, volumes):
        """Store the volumes [m3] of drops by rows and columns until the next frame adds them."""
        depth = np.asarray(volumes, np.float64) / (self.cells.area * step_control.UNIT)
        cells = self.places(rows, columns)
        waiting = fetch(self.waiting, self.stream)
        np.add.at(waiting, cells, np.rint(depth).astype(np.int64))
        send(self.waiting, waiting, self.stream)

    def undelivered(self):
        """Return rows, columns and volumes [m3] of drops that no frame has taken in; waits."""
        waiting = fetch(self.waiting, self.stream)
        cells = np.flatnonzero(waiting)
        rows, columns = np.divmod(cells - self.cells.first, self.cells.width)
        return rows, columns, waiting[cells] * (step_control.UNIT * self.cells.area)

    def withdraw(self, rows, columns, volumes):
        """Drain up to `volumes` [m3] of free water from cells, none of them named twice; waits."""
        cells, depth = self.places(rows, columns), np.asarray(volumes) / self.cells.area
        kept = self.account.control, self._fields, self._remainder
        control, fields, remainder = (fetch(array, self.stream) for array in kept)
        state = fetch(self.account.state, self.stream)
        here = 3 * len(remainder) * state[step_control.PARITY] + cells
        fields[here], remainder[cells], taken = drain_cells(
            fields[here], remainder[cells], depth, DRY_DEPTH
        )
        control[step_control.DRAINED] += taken
        for array, values in zip(kept, (control, fields, remainder), strict=True):
            send(array, values, self.stream)

    def places(self, rows, columns):
        """Return the places of cells in `arrays`, ndarray of int64."""
        rows, columns = np.asarray(rows, np.int64), np.asarray(columns, np.int64)
        return self.cells.first + rows * self.cells.width + columns

    def launch(self):
        """Queue a frame: drops, steps, the account. No visit to the host."""
        self.begin()
        self.go_on()

    def begin(self):
        """Queue what stands before the steps of a frame."""
        self.account.send()
        # Where nothing moves no step writes it.
        depth, before = self.depths[self.page], self.depths[1 - self.page]
        depth.copy_to_device(before, stream=self.stream)
        self.take_in()
        self.refresh()

    def go_on(self):
        """Queue `capacity` steps and the account; again if time was left over."""
        for _ in range(self.capacity):
            self.step()
        self.account.close()

    def take_in(self):
        """Queue the launch that gives waiting drops to the film and the water of their cells."""
        account, layout = self.account, self._layout
        step_control.take_in[self._stripes, (step_control.SIDE, step_control.HEIGHT), self.stream](
            account.state, account.now, self.waiting, self._maps.storage, layout.ny, layout.nx,
            layout.pitch, DRY_DEPTH, self._fields, self._remainder, self._film, account.partial,
        )  # fmt: skip

    def refresh(self):
        """Queue the plan of a frame's first step."""
        account, layout = self.account, self._layout
        step_control.refresh[self._stripes, (step_control.SIDE, step_control.HEIGHT), self.stream](
            account.control, account.state, account.now, account.numbers, self._fields,
            self._maps.bed, layout.ny, layout.nx, layout.pitch,
        )  # fmt: skip

    def step(self):
        """Queue one step of the solver."""
        account = self.account
        lean.step[self._blocks, lean.THREADS, self.stream](
            account.control, account.state, account.now, account.numbers, self._maps, self._layout,
            self._limits, self._fields, self._remainder, self._film, self.depths[self.page],
            account.partial,
        )  # fmt: skip

    def advance(self, duration, rate=0.0, added=True):
        """Advance by `duration` [s] and wait; return the number of steps.

        Raises DivergedError if the water is faster than water on the ground can
            be, or no longer finite.
        """
        self.account.update(duration, rate, added)
        self._run(self.launch)
        while self.account.fetch()[step_control.LEFT] > 0.0:
            self._run(self.go_on)
        state = fetch(self.account.state, self.stream)
        self.require_sound(state, self.ledger().ground)
        return int(state[step_control.SUBSTEPS])

    def require_sound(self, state, ground=0.0):
        """Raise DivergedError if `state` says that the water is too fast, or `ground` is no number.

        `ground` is the ledger's volume on the ground [m3].
        """
        if state[step_control.UNSOUND] or not np.isfinite(ground):
            raise DivergedError(
                "the water on the CUDA device is faster than water can be; use a smaller courant "
                f"than {self.account.courant:g}"
            )

    def _run(self, queue):
        """Queue the work of a method: launch by launch at first, then as one recorded launch.

        A step takes a device less time than its launch takes the host. The default stream cannot be
        recorded.
        """
        key = queue.__name__, self.page
        if key in self._recorded:
            self._recorded[key].launch()
            return
        queue()
        if self.stream != 0:
            self._recorded[key] = Graph(self.stream, queue)

    def ledger(self):
        """Return the `Ledger` at the last frame's end; waits for it."""
        return self.account.ledger(self.account.fetch())

    def bring_to(self, solver):
        """Give a `WaterSolver` of the same map the present water and its speeds; waits."""
        flow, layout, state = solver.flow, self._layout, fetch(self.account.state, self.stream)
        control, parity = self.account.fetch(), state[step_control.PARITY]
        copies = fetch(self._fields, self.stream).reshape(2, 3, -1, layout.pitch)
        rest = (
            fetch(array, self.stream).reshape(-1, layout.pitch)
            for array in (self._remainder, self._film)
        )
        spare, water = flow._spare, flow.water
        for field, framed in zip(
            (water.h, water.u, water.v, spare.h, spare.u, spare.v, water.remainder,
             solver.sources.film),
            (*copies[parity], *copies[1 - parity], *rest), strict=True,
        ):  # fmt: skip
            rows, columns = field.shape
            framed = framed[:rows, step_control.LEAD : step_control.LEAD + columns]
            field[:] = 0  # the device does not keep all ghosts
            field[flow.inner] = framed[flow.inner]
        flow.cap, flow.wave_speed, flow.water_speed = control[
            [step_control.CAP, step_control.REACH_NOW, step_control.SWIFT_NOW]
        ].tolist()
        flow.is_at_whole_step = state[step_control.WAITS] == 1
        solver.settled = bool(state[step_control.SETTLED])
        flow._tiles.wake()
        flow._fill_ghosts()

    def fields(self):
        """Return depth (ny, nx), u (ny, nx + 1) and v (ny + 1, nx) as host arrays; waits."""
        parity = fetch(self.account.state, self.stream)[step_control.PARITY]
        fields = fetch(self._fields, self.stream)
        _, u, v = fields.reshape(2, 3, -1, self._layout.pitch)[parity]
        west, depth = step_control.LEAD + PAD, fetch(self.depths[self.page], self.stream)
        east = west + self.shape[1]
        return depth, u[PAD : -PAD - 1, west : east + 1], v[PAD:-PAD, west:east]


def _what_the_ground_takes(solver):
    """Return the rate [m/s] at which each cell's ground takes water; negative: its drain does.

    Raises ParameterError if a drain lies in ground that takes water by itself.
    """
    takes = solver.sources.infiltration.copy()
    for row, column, rate in zip(*solver.sources.drains, strict=True):
        if takes[row + PAD, column + PAD] > 0:
            raise ParameterError(
                f"the drain in cell ({row}, {column}) lies in ground that takes water by itself; a "
                'CUDA device has no such drains; use backend "cpu"'
            )
        takes[row + PAD, column + PAD] -= rate / solver.spacing**2
    return takes


def _require_room(solver):
    """Raise ParameterError for a map whose numbers have places of more than 32 bits."""
    ny, nx = solver.flow.bed.shape
    if 6 * (ny + 1) * step_control.pitch(nx) > MOST_PLACES:
        raise ParameterError(
            f"the map has {solver.shape[0]} x {solver.shape[1]} cells; a CUDA device takes some "
            f'{MOST_PLACES // 6 // 10**6} million; take larger cells, or backend "cpu"'
        )


def _require_lean(solver):
    """Raise ParameterError for a scheme or float type that the device's solver does not have."""
    dtype = solver.flow.bed.dtype
    if not isinstance(solver.flow, LeanFlow) or dtype != np.float32:
        raise ParameterError(
            f"the water scheme is {solver.scheme!r} in {dtype}; on a CUDA device it must be "
            '"lean" in float32, which "auto" takes; give that, or backend "cpu"'
        )


assert EDGES == ("west", "east", "south", "north")  # the order of the bits in `kinds`
