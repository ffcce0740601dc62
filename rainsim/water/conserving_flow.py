"""The owners of depth and velocity of the momentum-conserving schemes, and their step.

`advance_depth` and `advance_velocity` are the two halves of a step; the solver applies the sources
between them. "lean" does both in one pass over memory, within `advance_depth`.
"""

import math

import numpy as np

from rainsim.water import conserving
from rainsim.water.bundles import Flux, FrictionNumbers, Ground
from rainsim.water.friction import apply_friction
from rainsim.water.inputs import EDGES
from rainsim.water.lean import step
from rainsim.water.moving_tiles import Tiles
from rainsim.water.rows import tile_peaks
from rainsim.water.staggered import StaggeredFlow

MAX_STEP = 0.25  # cells that water may cross in a step: four faces then take what a cell holds
ROUNDING_ROOM = 1 - 1e-6  # of a step, so that float32 factors keep that promise too
CAP_STEPS = 64  # steps from one update of the speed cap to the next


class ConservingFlow(StaggeredFlow):
    """Depth and velocity with `PAD` ghost cells around, and what "accurate" and "lean" share.

    viscosity : float [m2/s]. Kinematic; 0 is no laminar drag.
    edge_is_open : int64 array (4,). 1 where the west, east, south, north edge is
        open, 0 where it is a wall.
    cap : float [m/s]. Speed that no face may exceed: all energy there is.
    is_at_whole_step : bool. Whether velocity is known at n, like depth; the first
        step takes it to n + 1/2.
    """

    pad = conserving.PAD
    inner = np.s_[conserving.PAD : -conserving.PAD, conserving.PAD : -conserving.PAD]

    def __init__(self, bed, spacing, gravity, is_open, roughness, dry, viscosity):
        if roughness is None and viscosity > 0.0:
            roughness = np.zeros_like(bed)
        rough, framed = (
            None if roughness is None else np.pad(roughness, conserving.PAD),
            np.pad(bed, conserving.PAD),
        )
        self.edge_is_open = np.array([is_open[edge] for edge in EDGES], np.int64)
        conserving.fill_depth(self.edge_is_open, framed)
        super().__init__(framed, spacing, gravity, is_open, rough, dry)
        self.viscosity, self.lowest_bed = viscosity, float(bed.min())
        self._tiles = Tiles(*framed.shape, bed.dtype)

    # -- state -------------------------------------------------------------------------------------

    def start(self, u, v):
        """Set the inner face velocities, (ny, nx - 1) and (ny - 1, nx); `h` must be set before."""
        for water in (self.water, self._spare):
            water.u[:], water.v[:] = 0, 0
        self.water.u[conserving.PAD : -conserving.PAD, conserving.PAD + 1 : -conserving.PAD - 1] = u
        self.water.v[conserving.PAD + 1 : -conserving.PAD - 1, conserving.PAD : -conserving.PAD] = v
        self._spare.h[:] = self.water.h
        self._steps, self.cap = 0, 0.0
        # `_lead` is twice the time [s] by which velocity is ahead of depth.
        self.is_at_whole_step, self._lead = True, 0.0
        self._tiles.wake()
        self._fill_ghosts()
        self.refresh()

    @property
    def moves(self):
        """Whether any water flows."""
        return self.water_speed > 0.0

    def _fill_ghosts(self):
        now, before = self.water, self._spare
        conserving.fill_depth(self.edge_is_open, now.h)
        conserving.fill_velocity(self.edge_is_open, self.bed, before.u, before.v, now.u, now.v)
        self._set_entries()

    def refresh(self):
        """Measure the speeds that limit step and cap from depths and velocities."""
        h, level = self.water.h[self.inner], (self.water.h + self.bed)[self.inner]
        self.water_speed = self.largest_speed()
        # Where the surface differs between cells, a step of pressure makes some of that speed.
        falls = [0.0]
        for a, b in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
            falls.append(float(((level[a] - level[b]) * (h[a] > 0)).max()))
            falls.append(float(((level[b] - level[a]) * (h[b] > 0)).max()))
        drop = max(float(h.max()), *falls)
        self.wave_speed = self.water_speed + math.sqrt(self._gravity * drop)
        self._raise_cap()

    def _raise_cap(self):
        """Raise the cap to a dam break on the deepest water plus a fall from the highest [m/s]."""
        peaks = np.empty((2, len(self._tiles.all)), self.bed.dtype)
        tile_peaks(self._tiles.all, self.water.h, self.bed, *peaks)
        deepest, highest = (float(peak) for peak in peaks.max(axis=1))
        if deepest <= 0.0:
            return
        self._raise_cap_to(deepest, highest)
        self.cap = max(self.cap, self.water_speed if self._steps == 0 else 0.0)

    def _raise_cap_to(self, deepest, highest):
        """Raise the cap for water of that depth and that level [m]."""
        if deepest > 0.0:
            fall = max(highest - self.lowest_bed, 0.0)
            bound = 2 * math.sqrt(self._gravity * deepest) + math.sqrt(2 * self._gravity * fall)
            self.cap = max(self.cap, bound)

    # -- step --------------------------------------------------------------------------------------

    def stable_step(self, courant):
        """Longest step [s] at which waves and flow stay within their limits."""
        step = courant * self._spacing / max(self.wave_speed, 1e-30)
        return ROUNDING_ROOM * min(step, MAX_STEP * self._spacing / max(self.water_speed, 1e-30))

    def advance_depth(self, dt):
        """Advance the depth from n to n+1; return the volume [m3] that left through open edges."""
        if self.is_at_whole_step:  # half a step of pressure brings velocity from n to n+1/2
            self.is_at_whole_step, self._lead = False, dt
            self._push(0.5 * dt, 0.5 * dt)
        if not self.moves:
            return 0.0
        self._note_entries(dt / self._spacing, self.bed.dtype)
        left = sum(float(q.sum(dtype=np.float64)) for q in self._move(dt))
        return left * dt * self._spacing

    def advance_velocity(self, dt):
        """Advance the velocity from step n+1/2 to n+3/2."""
        self._steps += 1
        if self._steps % CAP_STEPS == 0:
            self._raise_cap()

    def _finish(self, dt, speeds):
        """Take the new copy, slow it by friction over `dt` [s], fill ghosts, measure speeds."""
        self.water, self._spare = self._spare, self.water
        self._slow(dt, self._tiles.runs, self._tiles.active, self._spare, self.water, speeds)
        self._fill_ghosts()
        self.wave_speed, self.water_speed = (float(top.max(initial=0)) for top in speeds)
        self._tiles.let_sleep(speeds[1])

    def _slow(self, dt, runs, tiles, before, now, speeds):
        """Slow the velocities of `now` by friction over `dt` [s], and measure speeds again."""
        if self.roughness is not None:
            dtype = self.bed.dtype.type
            numbers = FrictionNumbers(
                drag=dtype(self._gravity * dt), laminar=dtype(3 * self.viscosity * dt),
                gravity=dtype(self._gravity), dry=self.dry,
            )  # fmt: skip
            apply_friction(
                runs, tiles, now._replace(u=before.u, v=before.v),
                Ground(self.bed, self.roughness), numbers, now.u, now.v, *speeds,
            )  # fmt: skip

    # -- file -----------------------------------------------------------------------------------

    def _arrays(self):
        """Return the arrays that make up the state, by name."""
        now, spare = self.water, self._spare
        return {
            "h": now.h, "remainder": now.remainder, "u": now.u, "u_spare": spare.u, "v": now.v,
            "v_spare": spare.v, "still_steps": self._tiles.still_steps,
        }  # fmt: skip

    def saved(self):
        """Return the arrays that make up the state, by name, and its numbers."""
        numbers = (
            self.cap, self._steps, self.is_at_whole_step, self._lead, self.wave_speed,
            self.water_speed, self.moves,
        )  # fmt: skip
        return {**self._arrays(), "numbers": np.array(numbers, np.float64)}

    def restore(self, arrays):
        """Take over the arrays that `saved` returned."""
        for name, array in self._arrays().items():
            array[:] = arrays[name]
        self.cap, steps, is_at_whole_step, *speeds, _ = arrays["numbers"].tolist()
        self._steps, self.is_at_whole_step = int(steps), bool(is_at_whole_step)
        self._lead, self.wave_speed, self.water_speed = speeds
        self._tiles.restore(arrays["still_steps"])

    # -- tiles -------------------------------------------------------------------------------------

    def tiles(self, everywhere):
        """Return the tiles to which sources are applied: all, or those where water moves."""
        return self._tiles.all if everywhere else self._tiles.active

    def note_sources(self, everywhere):
        """Take note that sources have changed depths: all over, or where water moves."""
        if everywhere:
            self._tiles.wake_wet(self.water.h[self.inner] > 0)
        conserving.fill_depth(self.edge_is_open, self.water.h)
        if not self.moves:
            self._raise_cap()  # that of dry ground would hold what fell on it

    def note_cells(self, edge, rows, columns, rise, dt):
        """Take note that last cells of an edge rose by `rise` [m] within a step `dt` [s]."""
        h, at = self.water.h, (rows + conserving.PAD, columns + conserving.PAD)
        self._tiles.wake_cells(rows, columns)
        conserving.fill_depth(self.edge_is_open, h)
        self._raise_cap_to(float(h[at].max()), float((h[at] + self.bed[at]).max()))


class AccurateFlow(ConservingFlow):
    """The step of "accurate": parameters and attributes are those of `ConservingFlow`."""

    def __init__(self, *given):
        super().__init__(*given)
        self._spare = self._spare._replace(h=self.water.h)  # depth moves in place
        self._flux = Flux(np.zeros_like(self.water.u), np.zeros_like(self.water.v))

    def start(self, u, v):
        """Set the inner face velocities, see `ConservingFlow.start`."""
        for q in self._flux:
            q[:] = 0
        super().start(u, v)

    def _arrays(self):
        return {**super()._arrays(), **self._flux._asdict()}

    def _move(self, dt):
        """Move the depth by `dt` [s]; return the volume flux [m2/s] out of each open edge."""
        (h, remainder, u, v), (qu, qv) = self.water, self._flux
        conserving.volume_flux(self._tiles.runs, h, self.bed, u, v, qu, qv)
        conserving.fill_edge_flux(self.edge_is_open, h, self.bed, u, v, qu, qv)
        k = dt / self._spacing
        conserving.move_depth(self._tiles.runs, qu, qv, k, float(self.dry), h, remainder)
        conserving.fill_depth(self.edge_is_open, h)
        return [self.outward(edge, qu, qv) for edge in self.open_edges()]

    def advance_velocity(self, dt):
        """Advance the velocity from step n+1/2 to n+3/2."""
        super().advance_velocity(dt)
        # Velocity was half of the last step ahead of the depth and must be half of this one.
        # After a step three times as long it waits instead: friction does not run backwards.
        pressure_time = max(dt + 0.5 * (dt - self._lead), 0.0)
        self._lead += 2 * (pressure_time - dt)
        self._push(dt, pressure_time)

    def _push(self, dt, pressure_time):
        """Carry momentum over the `dt` [s] in which the depth moved; press for `pressure_time`."""
        speeds = self._tiles.speeds()
        conserving.accelerate(
            self._tiles.runs, self._tiles.active, self.water, self.bed, self._flux,
            self.numbers(dt, pressure_time, self.cap), self._spare.u, self._spare.v, *speeds,
        )  # fmt: skip
        self._finish(pressure_time, speeds)


class LeanFlow(ConservingFlow):
    """The step of "lean": parameters and attributes are those of `ConservingFlow`."""

    def _arrays(self):
        return {**super()._arrays(), "h_spare": self._spare.h}

    def _move(self, dt):
        """Move the depth by `dt` [s] and the velocity with it; return the flux [m2/s] as above."""
        u, v = self.water.u, self.water.v
        through = [
            np.maximum(self.outward(edge, u, v), 0) * self.depth_at(edge)
            for edge in self.open_edges()
        ]
        self._step(dt, dt)
        return through

    def advance_velocity(self, dt):
        """Advance the velocity from step n+1/2 to n+3/2, unless it has gone with the depth."""
        super().advance_velocity(dt)
        if not self.moves:
            self._push(dt, dt)

    def _push(self, dt, pressure_time):
        """Press for `pressure_time` [s]; the depth rests."""
        self._step(0.0, pressure_time)

    def _step(self, dt, pressure_time):
        """Depth by `dt` and velocity by `pressure_time` [s] in one pass."""
        speeds = self._tiles.speeds()
        self._write(dt, pressure_time, self._tiles.runs, self._tiles.active, speeds)
        self._finish(pressure_time, speeds)

    def _write(self, dt, pressure_time, runs, tiles, speeds):
        """Write the step of some tiles to the spare copy, without friction."""
        new = self._spare
        step(
            runs, tiles, self.water, self.bed, self.numbers(dt, pressure_time, self.cap),
            new.h, new.u, new.v, *speeds,
        )  # fmt: skip

    def speeds_of(self, dt, pressure_time, runs, tiles):
        """Return the fastest wave and face [m/s] that a step would make in some tiles.

        Of fewer columns than `rows.RUN`: friction reads the new depths west and south of them, too.
        """
        speeds = np.zeros((2, len(tiles)), self.bed.dtype)
        if self.roughness is None:
            self._write(dt, pressure_time, runs, tiles, speeds)
        else:
            wider = [np.hstack([np.maximum(a[:, :4] - [1, 0, 1, 0], conserving.PAD), a[:, 4:]])
                     for a in (runs, tiles)]  # fmt: skip
            self._write(dt, pressure_time, *wider, speeds)
            conserving.fill_depth(self.edge_is_open, self._spare.h)
            self._slow(pressure_time, runs, tiles, self.water, self._spare, speeds)
        return speeds.max(axis=1, initial=0).tolist()

    def note_cells(self, edge, rows, columns, rise, dt):
        """Take note that last cells of an edge rose, see `ConservingFlow.note_cells`.

        The step took the velocity to n+3/2 together with the depth, before the cells rose: the
        faces inside the edge get the pressure of the rise here, and the ghosts follow.
        """
        dtype, water = self.bed.dtype.type, self.water
        sign = dtype(1 if edge in ("west", "south") else -1)
        w = water.u if edge in ("west", "east") else water.v
        at = rows + conserving.PAD + (edge == "south"), columns + conserving.PAD + (edge == "west")
        pushed = w[at] + sign * (self._gravity * dt / self._spacing * rise).astype(dtype)
        cap = dtype(self.cap)
        w[at] = np.where(w[at] != 0, np.clip(pushed, -cap, cap), 0)  # closed faces stay closed
        super().note_cells(edge, rows, columns, rise, dt)
        self._fill_ghosts()
