"""The owner of the fields of the scheme "paper"; its methods name the phases."""

from __future__ import annotations

import math

import numpy as np

from rainsim.grid.paper import BLOCK, extrapolate, flow, push, push_rough

CAP = 0.5  # cells per step, the most a face may be sped up to (Chentanez and Mueller 2010)
ROUNDING_ROOM = 1 - 1e-6  # of a step, so that float32 factors keep its promise too


class PaperFlow:
    """Depth and velocity on the MAC grid, and the step of "paper" (see `rainsim.grid.paper`).

    The parameters are those of `ConservingFlow`; inflow and viscosity are not in the paper.
    """

    pad = 0

    def __init__(self, bed, spacing, gravity, is_open, roughness, rest, dry):
        (ny, nx), dtype = bed.shape, bed.dtype.type
        self._type, self._spacing, self._gravity = dtype, spacing, gravity
        self._rest, self._dry = rest, dry
        self._open, self._roughness = is_open, roughness
        self.bed = bed
        self.h, self._h_spare = np.zeros((ny, nx), dtype), np.zeros((ny, nx), dtype)
        self.u, self._u_spare = np.zeros((ny, nx + 1), dtype), np.zeros((ny, nx + 1), dtype)
        self.v, self._v_spare = np.zeros((ny + 1, nx), dtype), np.zeros((ny + 1, nx), dtype)
        self.damp = np.zeros((ny, nx), dtype)
        self._reaches = np.zeros((-(-ny // BLOCK), nx), dtype)
        south = np.arange(0, ny, BLOCK)
        north = np.minimum(south + BLOCK, ny)
        self._tiles = np.stack([south, north, 0 * south, 0 * south + nx], axis=1).astype(np.int64)

    def start(self, u, v):
        """Set the inner face velocities, shapes (ny, nx - 1) and (ny - 1, nx), after `h`."""
        self.u[:, 1:-1], self.v[1:-1] = u, v
        self._set_edges()
        self.refresh()

    def refresh(self):
        """Measure anew what the step follows, from depths and velocities."""
        self.swift = self.fastest()
        self.moves = self.swift > 0.0
        wave = math.sqrt(self._gravity * float(self.h.max()))
        self.reach = self.swift + max(wave, self.swift)

    def fastest(self):
        """Largest face speed [m/s]."""
        return float(max(self.u.max(), -self.u.min(), self.v.max(), -self.v.min()))

    def faces(self):
        """Velocities of all faces, shapes (ny, nx + 1) and (ny + 1, nx) [m/s]."""
        return self.u, self.v

    def stable_step(self, courant):
        """Longest step [s] at which waves and flow stay within their limits."""
        return ROUNDING_ROOM * courant * self._spacing / self.reach if self.reach else math.inf

    def flow(self, dt):
        """Bring depth from n to n+1; return the volumes [m3] that left and came in."""
        k = self._type(dt / self._spacing)
        self._before = self.u, self.v
        if not self.moves:
            self._swap_velocity()  # pressure and friction read the velocity at n beside the new
            self.u[:], self.v[:] = 0, 0
            return 0.0, 0.0
        left = self._outflow() * float(k) * self._spacing
        flow(
            self.h, self.u, self.v, k, self._dry,
            self.damp, self._h_spare, self._u_spare, self._v_spare,
        )  # fmt: skip
        self.h, self._h_spare = self._h_spare, self.h  # h at n+1
        self._swap_velocity()  # carried, not yet pushed
        return left, 0.0

    def turn(self, dt):
        """Bring velocity from n to n+1."""
        dtype, kg = self._type, self._type(self._gravity * dt / self._spacing)
        cap = dtype(CAP * self._spacing / dt)
        scalars = cap, dtype(self._gravity), self._rest, self._dry
        if self._roughness is None:
            push(self.h, self.bed, kg, *scalars, self.u, self.v, self._reaches)
        else:
            push_rough(
                self.h, self.bed, self._roughness, *self._before, kg,
                dtype(self._gravity * dt), *scalars, self.u, self.v, self._reaches,
            )  # fmt: skip
        self.reach = float(self._reaches.max())
        self.moves = bool(self.u.any() or self.v.any())
        if self.moves:
            extrapolate(self.h, self.u, self.v, self._u_spare, self._v_spare)
            self._swap_velocity()
        self._set_edges()  # u at n+1
        self.swift = self.fastest() if self.moves else 0.0

    def tiles(self, everywhere):
        """Return the tiles to which rain and losses go: all of them."""
        return self._tiles

    def changed(self):
        """Return the numbers of the tiles in which depths may have changed since last asked."""
        return np.arange(len(self._tiles))

    def touched(self, everywhere):
        """Take note that depths were changed from outside."""

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
        """Edge faces: zero at walls, the outward part of the next face at open edges."""
        u, v, edges = self.u, self.v, self._open
        u[:, 0] = np.minimum(u[:, 1], 0) if edges["west"] else 0
        u[:, -1] = np.maximum(u[:, -2], 0) if edges["east"] else 0
        v[0] = np.minimum(v[1], 0) if edges["south"] else 0
        v[-1] = np.maximum(v[-2], 0) if edges["north"] else 0
