"""The water solver on a CUDA device: takes over the state of a `WaterSolver`, a frame at a time.

`launch` only queues work, so that a frame's launches can be captured in a graph. How many steps a
frame needs is decided on the device; `capacity` are launched, and what is left over is counted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rainsim.cuda.driver import fetch, send, to_device
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.water import flow as lean
from rainsim.cuda.water import step_control
from rainsim.errors import DivergedError, ParameterError
from rainsim.grid import DRY_DEPTH
from rainsim.water.conserving import PAD
from rainsim.water.conserving_flow import EDGES
from rainsim.water.sources import drain_cells

CAPACITY = 12  # steps queued for a frame


class Water:
    """Shallow water on a CUDA device, by the scheme "lean".

    Parameters
    ----------
    solver : WaterSolver
        Of scheme "lean" and float32; its state is copied.
    exposure : ndarray of shape (ny, nx), float32, or None
        Share of the rain that falls on each cell; None for 1.
    capacity : int
        Steps queued for a frame.
    stream : cuda.stream

    Attributes
    ----------
    depth : device array of shape (ny, nx), float32 [m]
        Depth above the bed, film included, at the last frame's end: one of `depths`, `page`.
    waiting : device array of shape ((ny + 5) * width,), int64
        Depth of drops that fell since, in `step_control.UNIT`.
    first, width : int
        Where the first cell is in `waiting`, and from one row to the next.

    Raises
    ------
    ParameterError
        If the solver has what this one has not.
    """

    def __init__(self, solver, exposure=None, capacity=CAPACITY, stream=0):
        flow = solver.flow
        _require_lean(solver, flow)
        self.shape, self.spacing = solver.shape, solver.spacing
        self.stream, self.capacity = stream, capacity
        self._ledger = solver.ledger
        ny, nx = flow.h.shape
        self._size = ny, nx
        ones = np.ones(self.shape, np.float32)
        self._exposure = ones if exposure is None else np.asarray(exposure, np.float32)
        self._rate = None
        open_edges = sum(1 << k for k, is_open in enumerate(flow.edge_is_open) if is_open)
        rough = np.zeros_like(flow.h) if flow.roughness is None else flow.roughness
        self._limits = lean.Limits(*map(np.float32, (solver.gravity, flow.rounding, flow.dry)))
        self.width = step_control.pitch(nx)
        self.first = PAD * self.width + PAD + step_control.LEAD
        fields = np.stack([self._framed(a) for a in (flow.h, flow.u, flow.v)])
        self._fields = to_device(np.stack([fields, fields]).reshape(-1), stream)
        takes = _what_the_ground_takes(solver)
        maps = flow.bed, rough, np.pad(self._exposure, PAD), takes, solver.storage
        maps = *maps, flow.remainder, solver.film
        *maps, self._remainder, self._film = (
            to_device(self._framed(field).reshape(-1), stream) for field in maps
        )
        self._maps = lean.Maps(*maps)
        self.waiting = to_device(np.zeros((ny + 1) * self.width, np.int64), stream)
        depth = np.ascontiguousarray(solver.depth)
        self.depths = [to_device(depth, stream) for _ in range(2)]
        self.turn_page(0)
        self._wide = (nx - 2 * PAD + lean.THREADS - 1) // lean.THREADS
        rows = lean.rows_for(ny - 2 * PAD, self._wide)
        self._layout = lean.Layout(ny, nx, self.width, rows, open_edges)
        self._high = -(-(ny - 2 * PAD) // rows)
        side = (nx - 2 * PAD + step_control.SIDE - 1) // step_control.SIDE
        height = (ny - 2 * PAD + step_control.HEIGHT - 1) // step_control.HEIGHT
        self._stripes = (side, -(-height // step_control.STRIPE))
        blocks = max(self._wide * self._high, side * height)
        self._partial = to_device(np.zeros((step_control.PARTIAL, blocks)), stream)
        self._begin(solver, flow)

    def _begin(self, solver, flow):
        numbers = np.zeros(7)
        numbers[step_control.SPACING], numbers[step_control.GRAVITY] = (
            solver.spacing,
            solver.gravity,
        )
        numbers[step_control.VISCOSITY], numbers[step_control.COURANT] = (
            flow.viscosity,
            solver.courant,
        )
        numbers[step_control.FLOOR], numbers[step_control.LOSES] = (
            flow.lowest_bed,
            float(solver.has_losses),
        )
        numbers[step_control.STORES] = float(solver.has_storage)
        control = np.zeros(step_control.CONTROL)
        control[step_control.CAP] = flow.cap
        area, there = solver.spacing**2, self._ledger
        control[step_control.GROUND], control[step_control.FILM] = (
            there.ground / area,
            there.film / area,
        )
        control[step_control.REACH_NOW], control[step_control.SWIFT_NOW] = (
            flow.wave_speed,
            flow.water_speed,
        )
        state = np.zeros(step_control.STATE, np.int32)
        state[step_control.WAITS], state[step_control.SETTLED] = (
            int(flow.is_at_whole_step),
            int(solver.settled),
        )
        self._courant = solver.courant
        self._numbers = to_device(numbers, self.stream)
        self._control = to_device(control, self.stream)
        self._state = to_device(state, self.stream)
        self._numbers_now = FrameUniforms(self.stream, {"now": ((step_control.NOW,), np.float64)})
        self._now = self._numbers_now["now"]

    def _framed(self, field):
        """Return a map as the device has it, (ny + 1, width), float32."""
        framed = np.zeros((self._size[0] + 1, self.width), np.float32)
        framed[: field.shape[0], step_control.LEAD : step_control.LEAD + field.shape[1]] = field
        return framed

    def turn_page(self, page):
        """Let the next frame's depth be that array of `depths`, so that the last one's stays."""
        self.page, self.depth = page, self.depths[page]

    def let_through(self, exposure, rows):
        """Let another share of the rain fall from now on; waits.

        Parameters
        ----------
        exposure : ndarray of shape (ny, nx), float32
        rows : sequence of slice
            That differ from the share before.
        """
        self._exposure, self._rate = exposure, None
        west = step_control.LEAD + PAD
        for part in rows:
            framed = np.zeros((part.stop - part.start, self.width), np.float32)
            framed[:, west : west + self.shape[1]] = exposure[part]
            begin, end = ((n + PAD) * self.width for n in (part.start, part.stop))
            send(self._maps.exposure[begin:end], framed.reshape(-1), self.stream)

    @property
    def cells(self):
        """The arrays of all cells, see `flow.step`: state, control, fields, remainder, film."""
        return self._state, self._control, self._fields, self._remainder, self._film

    def deposit(self, rows, columns, volumes):
        """Store the volumes [m3] of drops by rows and columns until the next frame adds them."""
        depth = np.asarray(volumes, np.float64) / (self.spacing**2 * step_control.UNIT)
        cells = self.places(rows, columns)
        waiting = fetch(self.waiting, self.stream)
        np.add.at(waiting, cells, np.rint(depth).astype(np.int64))
        send(self.waiting, waiting, self.stream)

    def withdraw(self, rows, columns, volumes):
        """Drain up to `volumes` [m3] of free water from cells, none of them named twice; waits."""
        cells, depth = self.places(rows, columns), np.asarray(volumes) / self.spacing**2
        state, control, fields, remainder = (
            fetch(array, self.stream)
            for array in (self._state, self._control, self._fields, self._remainder)
        )
        here = 3 * len(remainder) * state[step_control.PARITY] + cells
        fields[here], remainder[cells], taken = drain_cells(
            fields[here], remainder[cells], depth, DRY_DEPTH
        )
        control[step_control.DRAINED] += taken
        for array, values in (
            (self._control, control), (self._fields, fields), (self._remainder, remainder)
        ):  # fmt: skip
            send(array, values, self.stream)

    def places(self, rows, columns):
        """Return the places of cells in the arrays of `cells`, ndarray of int64."""
        rows, columns = np.asarray(rows, np.int64), np.asarray(columns, np.int64)
        return self.first + rows * self.width + columns

    def update(self, duration, rate=0.0, added=True):
        """Set the next frame's length [s], its rain [m/s] and whether drops fell."""
        now = self._numbers_now.host["now"]
        now[step_control.DURATION], now[step_control.ADDED] = duration, float(added)
        if rate != self._rate:
            rain = np.float32(rate) * self._exposure
            now[step_control.RATE], now[step_control.RAIN_SUM] = rate, rain.sum(dtype=np.float64)
            now[step_control.RAIN_STEP] = np.inf
            if rate > 0.0:
                most = self._numbers_gravity * float(rain.max())
                room = self._courant * self.spacing
                now[step_control.RAIN_STEP] = room ** (2 / 3) / most ** (1 / 3)
            self._rate = rate

    @property
    def _numbers_gravity(self):
        return float(self._limits.gravity)

    def launch(self):
        """Queue a frame: drops, steps, the account. No visit to the host."""
        self._numbers_now.send()
        # Where nothing moves no step writes it.
        self.depth.copy_to_device(self.depths[1 - self.page], stream=self.stream)
        self.take_in()
        self.refresh()
        self.go_on()

    def go_on(self):
        """Queue `capacity` steps and the account; again if time was left over."""
        for _ in range(self.capacity):
            self.step()
        self.close()

    def take_in(self):
        """Queue the launch that gives waiting drops to the film and the water of their cells."""
        step_control.take_in[self._stripes, (step_control.SIDE, step_control.HEIGHT), self.stream](
            self._state, self._now, self.waiting, self._maps.storage, *self._size, self.width,
            DRY_DEPTH, self._fields, self._remainder, self._film, self._partial,
        )  # fmt: skip

    def refresh(self):
        """Queue the plan of a frame's first step."""
        step_control.refresh[self._stripes, (step_control.SIDE, step_control.HEIGHT), self.stream](
            self._control, self._state, self._now, self._numbers, self._fields, self._maps.bed,
            *self._size, self.width,
        )  # fmt: skip

    def step(self):
        """Queue one step of the solver."""
        lean.step[(self._wide, self._high), lean.THREADS, self.stream](
            self._control, self._state, self._now, self._numbers, self._maps, self._layout,
            self._limits, self._fields, self._remainder, self._film, self.depth, self._partial,
        )  # fmt: skip

    def close(self):
        """Queue the summing of the frame's volumes into the account on the device, `control`."""
        step_control.close[step_control.PARTIAL, step_control.CLOSERS, self.stream](
            self._control, self._state, self._partial.shape[1], 1 / self.spacing, self._partial
        )

    def missing(self):
        """Return the time [s] of the frame that the queued steps did not reach; waits for them."""
        return float(fetch(self._control, self.stream)[step_control.LEFT])

    def advance(self, duration, rate=0.0, added=True):
        """Advance by `duration` [s] and wait; return the number of steps.

        Raises
        ------
        DivergedError
            If the water is faster than water on the ground can be, or no longer finite.
        """
        self.update(duration, rate, added)
        self.launch()
        while self.missing() > 0.0:
            self.go_on()
        state = fetch(self._state, self.stream)
        if state[step_control.UNSOUND] or not np.isfinite(self.ledger().ground):
            raise DivergedError(
                "the water on the CUDA device is faster than water can be; use a smaller courant "
                f"than {self._courant:g}"
            )
        return int(state[step_control.SUBSTEPS])

    def control(self):
        """Return the device's account, see `cuda.water.step_control`; waits for it."""
        return fetch(self._control, self.stream)

    def ledger(self, control=None):
        """Return the `Ledger` at the last frame's end, of `control` if it is known."""
        if control is None:
            control = self.control()
        area, before = self.spacing**2, self._ledger
        return replace(
            before,
            rain=before.rain
            + area * float(control[step_control.RAINED] + control[step_control.DROPPED]),
            outflow=before.outflow + area * float(control[step_control.OUTFLOW]),
            infiltrated=before.infiltrated + area * float(control[step_control.INFILTRATED]),
            drained=before.drained + area * float(control[step_control.DRAINED]),
            ground=area * float(control[step_control.GROUND]),
            film=area * float(control[step_control.FILM]),
        )

    def fields(self):
        """Return depth (ny, nx), u (ny, nx + 1) and v (ny + 1, nx) as host arrays; waits."""
        parity = fetch(self._state, self.stream)[step_control.PARITY]
        fields = fetch(self._fields, self.stream)
        _, u, v = fields.reshape(2, 3, -1, self.width)[parity]
        west, depth = step_control.LEAD + PAD, fetch(self.depth, self.stream)
        east = west + self.shape[1]
        return depth, u[PAD : -PAD - 1, west : east + 1], v[PAD:-PAD, west:east]


def _what_the_ground_takes(solver):
    """Return the rate [m/s] at which each cell's ground takes water; negative: its drain does.

    Raises
    ------
    ParameterError
        If a drain lies in ground that takes water by itself.
    """
    takes = solver.infiltration.copy()
    for row, column, rate in zip(*solver.drains, strict=True):
        if takes[row + PAD, column + PAD] > 0:
            raise ParameterError(
                f"the drain in cell ({row}, {column}) lies in ground that takes water by itself; a "
                'CUDA device has no such drains; use backend "cpu"'
            )
        takes[row + PAD, column + PAD] -= rate / solver.spacing**2
    return takes


def _require_lean(solver, flow):
    """Raise ParameterError for a scheme or float type that the device's solver does not have."""
    if not getattr(flow, "is_lean", False) or flow.h.dtype != np.float32:
        raise ParameterError(
            f"the water scheme is {solver.scheme!r} in {flow.h.dtype}; on a CUDA device it must be "
            '"lean" in float32, which "auto" takes; give that, or backend "cpu"'
        )
    if solver.conditions:
        raise ParameterError(
            f"the solver has {len(solver.conditions)} conditions of edges; a CUDA device has none; "
            'leave them out, or take backend "cpu"'
        )


assert EDGES == ("west", "east", "south", "north")  # the order of the bits in `open_edges`
