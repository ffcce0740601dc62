"""The account of the water on a CUDA device: its arrays, and the host's side of it.

`rainsim.cuda.water.step_control` says what stands where in the arrays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rainsim.cuda.driver import fetch, to_device
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.jit import pinned
from rainsim.cuda.moving_map import joined
from rainsim.cuda.small_copies import copy_small
from rainsim.cuda.water import step_control
from rainsim.cuda.water.step_control import (
    ADDED,
    CAP,
    COURANT,
    DRAINED,
    DROPPED,
    DURATION,
    FILM,
    FLOOR,
    GRAVITY,
    GROUND,
    INFILTRATED,
    LOSES,
    OUTFLOW,
    RAIN_STEP,
    RAIN_SUM,
    RAINED,
    RATE,
    REACH_NOW,
    SETTLED,
    SPACING,
    STORES,
    SWIFT_NOW,
    VISCOSITY,
    WAITS,
)


class Account:
    """Volumes, speeds and times of a `Water`, which the device keeps.

    solver : WaterSolver. Whose account goes on here.
    exposure : float32 array (ny, nx). Share of the rain that falls on each cell.
    blocks : int. Most blocks of a launch.
    stream : cuda.stream
    control, state, now, numbers, partial : device arrays. See the constants of
        `step_control`.
    courant : float
    open : float32 array (ny, nx). Share of the rain that falls on each cell where
        nothing that moves shelters it.
    exposed : float. Sum over the cells of the share of the rain that falls on
        each.
    seen : float64 array (CONTROL,). `control` as the host has it since the last
        `copy` was done.
    """

    def __init__(self, solver, exposure, blocks, stream):
        flow, sources, ledger = solver.flow, solver.sources, solver.ledger
        self._before, self._area, self._stream = ledger, solver.spacing**2, stream
        self._rate, self.courant = None, solver.courant
        self.let_through(exposure)
        self._spacing, self._gravity = solver.spacing, float(np.float32(solver.gravity))
        numbers, state = np.zeros(7), np.zeros(step_control.STATE, np.int32)
        control = np.zeros(step_control.CONTROL)
        for array, values in (
            (numbers, {
                SPACING: solver.spacing, GRAVITY: solver.gravity, VISCOSITY: flow.viscosity,
                COURANT: solver.courant, FLOOR: flow.lowest_bed, LOSES: sources.has_losses,
                STORES: sources.has_storage,
            }),
            (control, {
                CAP: flow.cap, GROUND: ledger.ground / self._area, FILM: ledger.film / self._area,
                REACH_NOW: flow.wave_speed, SWIFT_NOW: flow.water_speed,
            }),
            (state, {WAITS: flow.is_at_whole_step, SETTLED: solver.settled}),
        ):  # fmt: skip
            array[list(values)] = list(values.values())
        self.numbers, self.control, self.state = (
            to_device(array, stream) for array in (numbers, control, state)
        )
        self.partial = to_device(np.zeros((step_control.PARTIAL, blocks)), stream)
        self.seen = pinned(step_control.CONTROL, np.float64)
        self._uniforms = FrameUniforms(stream, {"now": ((step_control.NOW,), np.float64)})
        self.now = self._uniforms["now"]

    def update(self, duration, rate, added):
        """Set the next frame's length [s], its rain [m/s] and whether drops fell."""
        now = self._uniforms.host["now"]
        now[DURATION], now[ADDED] = duration, float(added)
        if rate != self._rate:
            rain = np.float32(rate)
            now[RATE], now[RAIN_SUM], now[RAIN_STEP] = rate, float(rain) * self.exposed, np.inf
            if rate > 0.0:
                most = self._gravity * float(rain * self._falls.flat[self._at])
                now[RAIN_STEP] = (self.courant * self._spacing) ** (2 / 3) / most ** (1 / 3)
            self._rate = rate

    def let_through(self, exposure):
        """Let another share (ny, nx), float32, of the rain fall on the cells, from `update` on."""
        self.open, self._whole = exposure, _sum_of(exposure)
        self._at = int(exposure.argmax())
        self._most = exposure.flat[self._at]
        self.shelter(exposure, [])

    def shelter(self, exposure, windows):
        """Let less of the rain fall on windows, and on no other cells, see `Water.shelter`.

        `exposure` is read until it is given again.
        """
        kept_off = sum(
            _sum_of(self.open[part]) - _sum_of(exposure[part]) for part in joined(windows)
        )
        self.exposed, self._rate, self._falls = self._whole - kept_off, None, exposure
        if exposure.flat[self._at] < self._most:  # the cell of the largest share is sheltered now
            self._at = int(exposure.argmax())

    def send(self):
        """Queue the sending of what `update` has set."""
        self._uniforms.send()

    def close(self):
        """Queue the summing of a frame's volumes into `control`."""
        step_control.close[step_control.PARTIAL, step_control.CLOSERS, self._stream](
            self.control, self.state, self.partial.shape[1], 1 / self._spacing, self.partial
        )

    def copy(self):
        """Queue the copy of `control` to `seen`."""
        copy_small(self.control, self.seen, self._stream)

    def fetch(self):
        """Return `control` on the host; waits for it."""
        return fetch(self.control, self._stream)

    def ledger(self, control):
        """Return the `Ledger` at the last frame's end from `control` on the host."""
        before, volume = self._before, [self._area * float(depth) for depth in control]
        return replace(
            before,
            rain=before.rain + self._area * float(control[RAINED] + control[DROPPED]),
            outflow=before.outflow + volume[OUTFLOW],
            infiltrated=before.infiltrated + volume[INFILTRATED],
            drained=before.drained + volume[DRAINED], ground=volume[GROUND], film=volume[FILM],
        )  # fmt: skip


def _sum_of(share):
    return float(share.sum(dtype=np.float64))
