"""The owner of the fields of the scheme "paper"."""

import math

import numpy as np

from rainsim.water.bundles import Ground
from rainsim.water.paper import BLOCK, accelerate_rough, extrapolate, flow
from rainsim.water.paper_sills import find_sills
from rainsim.water.staggered import StaggeredFlow

CAP = 0.5  # cells per step, the most a face may be sped up to (Chentanez and Mueller 2010)
ROUNDING_ROOM = 1 - 1e-6  # of a step, so that float32 factors keep its promise too


class PaperFlow(StaggeredFlow):
    """The step of "paper" (see `rainsim.water.paper`), without ghost cells or viscosity."""

    def __init__(self, bed, spacing, gravity, is_open, roughness, dry):
        super().__init__(bed, spacing, gravity, is_open, roughness, dry, roundings=2)
        self._ground = Ground(bed, np.zeros_like(bed) if roughness is None else roughness)
        ny, nx = bed.shape
        self._signals = np.zeros((-(-ny // BLOCK), nx), bed.dtype)
        south = np.arange(0, ny, BLOCK)
        north = np.minimum(south + BLOCK, ny)
        self._sills = find_sills(bed, is_open)
        self._tiles = np.stack([south, north, 0 * south, 0 * south + nx], axis=1).astype(np.int64)

    def start(self, u, v):
        """Set the inner face velocities, (ny, nx - 1) and (ny - 1, nx); `h` must be set before."""
        now = self.water
        now.u[:, 1:-1], now.v[1:-1] = u, v
        for sill in self._sills:
            sill.note(0 * now.u, 0 * now.v)
        self._set_edges()
        self.refresh()

    def refresh(self):
        """Measure the speeds that limit the step from depths and velocities."""
        self.water_speed = self.largest_speed()
        self.moves = self.water_speed > 0.0
        wave = math.sqrt(self._gravity * float(self.water.h.max()))
        self.wave_speed = self.water_speed + max(wave, self.water_speed)

    def stable_step(self, courant):
        """Longest step [s] at which waves and flow stay within their limits."""
        return (
            ROUNDING_ROOM * courant * self._spacing / self.wave_speed
            if self.wave_speed
            else math.inf
        )

    def advance_depth(self, dt):
        """Advance the depth from n to n+1; return the volume [m3] that left through open edges."""
        k = self.bed.dtype.type(dt / self._spacing)
        before, new = self.water, self._spare
        for sill in self._sills:
            sill.note(before.u, before.v)
        if not self.moves:
            self._swap_velocity()  # pressure and friction read the velocity at n beside the new
            self.water.u[:], self.water.v[:] = 0, 0
            return 0.0
        self._note_entries(float(k), np.float64)
        left = sum(self.leaving(edge) for edge in self.open_edges()) * self._spacing
        flow(before.h, before.u, before.v, k, self.dry, new.remainder, new.h, new.u, new.v)
        self.water, self._spare = new, before  # h at n+1; u carried, not yet pushed
        for sill in self._sills:
            sill.give_back(float(k), before.h, new.h, new.remainder, self.dry)
        return left * float(k) * self._spacing

    def advance_velocity(self, dt):
        """Advance the face velocities from step n to n+1 by `dt` [s]."""
        numbers = self.numbers(dt, dt, CAP * self._spacing / dt)
        (h, _, u, v), before = self.water, self._spare
        drag = u.dtype.type(self._gravity * dt)
        accelerate_rough(h, self._ground, before.u, before.v, drag, numbers, u, v, self._signals)
        self.wave_speed = float(self._signals.max())
        self.moves = bool(u.any() or v.any())
        if self.moves:
            extrapolate(h, u, v, before.u, before.v)
            self._swap_velocity()
        self._set_edges()  # u at n+1
        self.water_speed = self.largest_speed() if self.moves else 0.0

    def tiles(self, everywhere):
        """Return the tiles to which sources are applied: all of them."""
        return self._tiles

    def note_sources(self, everywhere):
        """Take note that sources have changed depths: nothing to do here."""

    def note_cells(self, edge, rows, columns, rise, dt):
        """Take note that last cells of an edge rose, see `ConservingFlow.note_cells`."""
        deepest = float(self.water.h[rows, columns].max())
        if deepest > 0.0:
            wave = math.sqrt(self._gravity * deepest)
            self.wave_speed = max(self.wave_speed, self.water_speed + max(wave, self.water_speed))

    def saved(self):
        """Return the arrays that make up the state, by name."""
        numbers = np.array([self.wave_speed, self.water_speed, float(self.moves)])
        return {**self.water._asdict(), "numbers": numbers}

    def restore(self, arrays):
        """Take over the arrays that `saved` returned."""
        for name, array in self.water._asdict().items():
            array[:] = arrays[name]
        self.wave_speed, self.water_speed, moves = arrays["numbers"].tolist()
        self.moves = bool(moves)

    def _swap_velocity(self):
        """Swap the copies of the velocity; the depth is only in one."""
        now, spare = self.water, self._spare
        self.water = now._replace(u=spare.u, v=spare.v)
        self._spare = spare._replace(u=now.u, v=now.v)

    def _set_edges(self):
        """Edge faces: zero at walls, as `conserving.speed_out` has it at open edges."""
        (_, _, u, v), edges = self.water, self.is_open
        u[:, 0] = np.minimum(u[:, 1], 0) if edges["west"] else 0
        u[:, -1] = np.maximum(u[:, -2], 0) if edges["east"] else 0
        v[0] = np.minimum(v[1], 0) if edges["south"] else 0
        v[-1] = np.maximum(v[-2], 0) if edges["north"] else 0
        for sill in self._sills:
            sill.speed_up(u, v)
