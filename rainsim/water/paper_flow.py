"""The owner of the fields of the scheme "paper"."""

from __future__ import annotations

import math

import numpy as np

from rainsim.water.bundles import Ground, StepNumbers
from rainsim.water.paper import BLOCK, accelerate, accelerate_rough, extrapolate, flow
from rainsim.water.paper_sills import find_sills

ROUNDINGS = 2  # rounding units of bed and depth within which levels are equal
CAP = 0.5  # cells per step, the most a face may be sped up to (Chentanez and Mueller 2010)
ROUNDING_ROOM = 1 - 1e-6  # of a step, so that float32 factors keep its promise too


class PaperFlow:
    """Depth and velocity on the MAC grid, and the step of "paper" (see `rainsim.water.paper`).

    Parameters and attributes are those of `ConservingFlow`; the paper has no viscosity.
    """

    pad, inner = 0, np.s_[:, :]

    def __init__(self, bed, spacing, gravity, is_open, roughness, dry):
        (ny, nx), dtype = bed.shape, bed.dtype.type
        self._type, self._spacing, self._gravity = dtype, spacing, gravity
        self._rounding = dtype(ROUNDINGS * np.finfo(dtype).eps)
        self._dry = dtype(dry)
        self._open, self.roughness = is_open, roughness
        self.bed = bed
        self.h, self._h_spare = np.zeros((ny, nx), dtype), np.zeros((ny, nx), dtype)
        self.u, self._u_spare = np.zeros((ny, nx + 1), dtype), np.zeros((ny, nx + 1), dtype)
        self.v, self._v_spare = np.zeros((ny + 1, nx), dtype), np.zeros((ny + 1, nx), dtype)
        self.remainder = np.zeros((ny, nx), dtype)
        self._signals = np.zeros((-(-ny // BLOCK), nx), dtype)
        south = np.arange(0, ny, BLOCK)
        north = np.minimum(south + BLOCK, ny)
        self._sills = find_sills(bed, is_open)
        self._tiles = np.stack([south, north, 0 * south, 0 * south + nx], axis=1).astype(np.int64)

    def start(self, u, v):
        """Set the inner face velocities, (ny, nx - 1) and (ny - 1, nx); `h` must be set before."""
        self.u[:, 1:-1], self.v[1:-1] = u, v
        for sill in self._sills:
            sill.note(0 * self.u, 0 * self.v)
        self._set_edges()
        self.refresh()

    def refresh(self):
        """Measure the speeds that limit the step from depths and velocities."""
        self.water_speed = self.largest_speed()
        self.moves = self.water_speed > 0.0
        wave = math.sqrt(self._gravity * float(self.h.max()))
        self.wave_speed = self.water_speed + max(wave, self.water_speed)

    def largest_speed(self):
        """Largest face speed [m/s]."""
        return float(max(self.u.max(), -self.u.min(), self.v.max(), -self.v.min()))

    def faces(self):
        """Return `u` (ny, nx + 1) and `v` (ny + 1, nx) [m/s] themselves, not copies."""
        return self.u, self.v

    def stable_step(self, courant):
        """Longest step [s] at which waves and flow stay within their limits."""
        return (
            ROUNDING_ROOM * courant * self._spacing / self.wave_speed
            if self.wave_speed
            else math.inf
        )

    def advance_depth(self, dt):
        """Advance the depth from n to n+1; return the volume [m3] that left through open edges."""
        k = self._type(dt / self._spacing)
        self._before = self.u, self.v
        for sill in self._sills:
            sill.note(self.u, self.v)
        if not self.moves:
            self._swap_velocity()  # pressure and friction read the velocity at n beside the new
            self.u[:], self.v[:] = 0, 0
            return 0.0
        left = self._outflow() * float(k) * self._spacing
        flow(
            self.h, self.u, self.v, k, self._dry,
            self.remainder, self._h_spare, self._u_spare, self._v_spare,
        )  # fmt: skip
        self.h, self._h_spare = self._h_spare, self.h  # h at n+1
        self._swap_velocity()  # carried, not yet pushed
        for sill in self._sills:
            sill.give_back(float(k), self._h_spare, self.h, self.remainder, self._dry)
        return left

    def advance_velocity(self, dt):
        """Advance the face velocities from step n to n+1 by `dt` [s]."""
        dtype, spacing, gravity = self._type, self._spacing, self._gravity
        numbers = StepNumbers(
            k=dtype(dt / spacing), kg=dtype(gravity * dt / spacing),
            wave=dtype(gravity * (dt / spacing) ** 2), gravity=dtype(gravity),
            cap=dtype(CAP * spacing / dt), rounding=self._rounding, dry=self._dry,
        )  # fmt: skip
        if self.roughness is None:
            accelerate(self.h, self.bed, numbers, self.u, self.v, self._signals)
        else:
            ground, drag = Ground(self.bed, self.roughness), dtype(gravity * dt)
            accelerate_rough(
                self.h, ground, *self._before, drag, numbers, self.u, self.v, self._signals
            )
        self.wave_speed = float(self._signals.max())
        self.moves = bool(self.u.any() or self.v.any())
        if self.moves:
            extrapolate(self.h, self.u, self.v, self._u_spare, self._v_spare)
            self._swap_velocity()
        self._set_edges()  # u at n+1
        self.water_speed = self.largest_speed() if self.moves else 0.0

    def tiles(self, everywhere):
        """Return the tiles to which sources are applied: all of them."""
        return self._tiles

    def changed_tiles(self):
        """Return the numbers of the tiles whose depths may have changed since the last call."""
        return np.arange(len(self._tiles))

    def note_sources(self, everywhere):
        """Take note that sources have changed depths: nothing to do here."""

    def note_cells(self, edge, rows, columns, rise, dt):
        """Take note that last cells of an edge rose, see `ConservingFlow.note_cells`."""
        deepest = float(self.h[rows, columns].max())
        if deepest > 0.0:
            wave = math.sqrt(self._gravity * deepest)
            self.wave_speed = max(self.wave_speed, self.water_speed + max(wave, self.water_speed))

    def saved(self):
        """Return the arrays that make up the state, by name."""
        numbers = np.array([self.wave_speed, self.water_speed, float(self.moves)])
        fields = {"h": self.h, "remainder": self.remainder, "u": self.u, "v": self.v}
        return {**fields, "numbers": numbers}

    def restore(self, arrays):
        """Take over the arrays that `saved` returned."""
        for name in ("h", "remainder", "u", "v"):
            getattr(self, name)[:] = arrays[name]
        self.wave_speed, self.water_speed, moves = arrays["numbers"].tolist()
        self.moves = bool(moves)

    def _swap_velocity(self):
        self.u, self._u_spare = self._u_spare, self.u
        self.v, self._v_spare = self._v_spare, self.v

    def _outflow(self):
        sides = (
            ("west", -self.u[:, 0], self.h[:, 0]), ("east", self.u[:, -1], self.h[:, -1]),
            ("south", -self.v[0], self.h[0]), ("north", self.v[-1], self.h[-1]),
        )  # fmt: skip
        flows = (speed.astype(np.float64) * h for edge, speed, h in sides if self._open[edge])
        return sum(float(q.sum()) for q in flows) * self._spacing

    def _set_edges(self):
        """Edge faces: zero at walls, as `conserving.speed_out` has it at open edges."""
        u, v, edges = self.u, self.v, self._open
        u[:, 0] = np.minimum(u[:, 1], 0) if edges["west"] else 0
        u[:, -1] = np.maximum(u[:, -2], 0) if edges["east"] else 0
        v[0] = np.minimum(v[1], 0) if edges["south"] else 0
        v[-1] = np.maximum(v[-2], 0) if edges["north"] else 0
        for sill in self._sills:
            sill.speed_up(u, v)
