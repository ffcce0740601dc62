"""The owner of depth and velocity of the momentum-conserving schemes, and their step.

`advance_depth` and `advance_velocity` are the two halves of a step; the solver applies the sources
between them. "lean" does both in one pass over memory, within `advance_depth`.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.water.bundles import Flux, FrictionNumbers, Ground, StepNumbers, Water
from rainsim.water.conserving import (
    PAD,
    accelerate,
    fill_depth,
    fill_edge_flux,
    fill_velocity,
    move_depth,
    volume_flux,
)
from rainsim.water.friction import apply_friction
from rainsim.water.lean import step
from rainsim.water.rows import COLUMNS, ROWS, runs_of, tile_peaks

EDGES = ("west", "east", "south", "north")
MAX_STEP = 0.25  # cells that water may cross in a step: four faces then take what a cell holds
ROUNDING_ROOM = 1 - 1e-6  # of a step, so that float32 factors keep that promise too
CAP_STEPS = 64  # steps from one update of the speed cap to the next
STILL_STEPS = 2  # after which both copies of a tile's velocity are zero


class ConservingFlow:
    """Depth and velocity with `PAD` ghost cells around, and the step of "accurate" and "lean".

    Parameters
    ----------
    bed : ndarray of shape (ny, nx) [m]
        Height on which the water flows, of the type of all fields.
    spacing, gravity : float [m], [m/s2]
    is_open : dict
        Whether each edge is open.
    roughness : ndarray of shape (ny, nx) or None [s2 m^(-2/3)]
        Square of Manning's n.
    dry : float [m]
        Depth below which water does not flow.
    viscosity : float [m2/s]
        Kinematic; 0 is no laminar drag.
    is_lean : bool
        Whether the scheme is "lean".

    Attributes
    ----------
    h, remainder, bed, u, v : ndarray
        See `bundles.Water` and `bundles.Ground`; the first cell is (pad, pad).
    moves : bool
        Whether any water flows.
    wave_speed, water_speed : float [m/s]
        Of the fastest wave and of the fastest face.
    cap : float [m/s]
        Speed that no face may exceed: all energy there is.
    """

    pad = PAD
    inner = np.s_[PAD:-PAD, PAD:-PAD]  # the cells without their ghosts

    def __init__(
        self, bed, spacing, gravity, is_open, roughness, dry, viscosity=0.0, is_lean=False
    ):
        dtype = bed.dtype.type
        self._type, self._spacing, self._gravity = dtype, spacing, gravity
        self.rounding, self.dry = dtype(np.finfo(dtype).eps), dtype(dry)
        self.viscosity, self.is_lean = viscosity, is_lean
        self.edge_is_open = np.array([is_open[edge] for edge in EDGES], np.int64)
        self.roughness = None
        if roughness is not None or viscosity > 0.0:
            self.roughness = np.pad(np.zeros_like(bed) if roughness is None else roughness, PAD)
        self.bed = np.pad(bed, PAD)
        fill_depth(self.edge_is_open, self.bed)
        ny, nx = self.bed.shape
        self.h, self._h_spare, self.remainder = (np.zeros_like(self.bed) for _ in range(3))
        self.u, self._u_spare, self._qu = (np.zeros((ny, nx + 1), dtype) for _ in range(3))
        self.v, self._v_spare, self._qv = (np.zeros((ny + 1, nx), dtype) for _ in range(3))
        self._cut_into_tiles(ny, nx)
        self.cap, self.lowest_bed = 0.0, float(bed.min())

    def _cut_into_tiles(self, ny, nx):
        south, west = np.arange(PAD, ny - PAD, ROWS), np.arange(PAD, nx - PAD, COLUMNS)
        north = np.minimum(south + ROWS, ny - PAD)
        east = np.minimum(west + COLUMNS, nx - PAD)
        self._tile_shape = len(south), len(west)
        tiles = np.empty((*self._tile_shape, 4), np.int64)
        tiles[..., 0], tiles[..., 1] = south[:, None], north[:, None]
        tiles[..., 2], tiles[..., 3] = west, east
        self._all_tiles = tiles.reshape(-1, 4)
        count = len(self._all_tiles)
        self._wave_speeds, self._water_speeds = (np.zeros(count, self._type) for _ in range(2))
        self._still_steps = np.zeros(count, np.int64)  # since the tile last moved
        self._changed, self._moving = np.ones(count, bool), None
        self._activate()

    # -- state -------------------------------------------------------------------------------------

    def start(self, u, v):
        """Set the inner face velocities, (ny, nx - 1) and (ny - 1, nx); `h` must be set before."""
        self.u[:], self.v[:] = 0, 0
        self.u[PAD:-PAD, PAD + 1 : -PAD - 1] = u
        self.v[PAD + 1 : -PAD - 1, PAD:-PAD] = v
        self._u_spare[:], self._v_spare[:], self._qu[:], self._qv[:] = 0, 0, 0, 0
        self._h_spare[:] = self.h
        self._steps, self.cap = 0, 0.0
        # Velocity is known at n, like depth; the first step takes it to n + 1/2. `_lead` is twice
        # the time [s] by which velocity is ahead of depth.
        self.is_at_whole_step, self._lead = True, 0.0
        self._activate()
        self._fill_ghosts()
        self.refresh()

    def _fill_ghosts(self):
        fill_depth(self.edge_is_open, self.h)
        fill_velocity(
            self.edge_is_open, self.bed, self._u_spare, self._v_spare, self.u, self.v
        )  # fmt: skip

    def faces(self):
        """Velocities of all faces, shapes (ny, nx + 1) and (ny + 1, nx) [m/s]."""
        return self.u[self.inner], self.v[self.inner]

    def refresh(self):
        """Measure the speeds that limit step and cap from depths and velocities."""
        h, level = self.h[self.inner], (self.h + self.bed)[self.inner]
        self.water_speed = self.largest_speed()
        # Where the surface differs between cells, a step of pressure makes some of that speed.
        falls = [0.0]
        for axis in (0, 1):
            a, b = [slice(None)] * 2, [slice(None)] * 2
            a[axis], b[axis] = slice(None, -1), slice(1, None)
            a, b = tuple(a), tuple(b)
            falls.append(float(((level[a] - level[b]) * (h[a] > 0)).max()))
            falls.append(float(((level[b] - level[a]) * (h[b] > 0)).max()))
        drop = max(float(h.max()), *falls)
        self.wave_speed = self.water_speed + math.sqrt(self._gravity * drop)
        self.moves = self.water_speed > 0.0
        self._raise_cap()

    def largest_speed(self):
        """Largest face speed [m/s], from all faces."""
        return float(max(self.u.max(), -self.u.min(), self.v.max(), -self.v.min()))

    def _raise_cap(self):
        """Raise the cap to a dam break on the deepest water plus a fall from the highest [m/s]."""
        peaks = np.empty((2, len(self._all_tiles)), self._type)
        tile_peaks(self._all_tiles, self.h, self.bed, *peaks)
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
            if self.is_lean:
                self._step_lean(0.0, 0.5 * dt)
            else:
                self._accelerate(0.5 * dt, 0.5 * dt)
        if not self.moves:
            return 0.0
        if self.is_lean:
            through = self._lean_edge_flux()
            self._step_lean(dt, dt)
        else:
            k = dt / self._spacing
            volume_flux(self._runs, self.h, self.bed, self.u, self.v, self._qu, self._qv)
            fill_edge_flux(
                self.edge_is_open, self.h, self.bed, self.u, self.v, self._qu, self._qv
            )  # fmt: skip
            move_depth(self._runs, self._qu, self._qv, k, float(self.dry), self.h, self.remainder)
            fill_depth(self.edge_is_open, self.h)
            through = self._outward(self._qu, self._qv).values()
        left = sum(float(q.sum(dtype=np.float64)) for q in through)
        return left * dt * self._spacing

    def _outward(self, along, across):
        """Views of two face maps at the open edges by edge, outward > 0."""
        w, s = along[self.inner], across[self.inner]
        edges = {"west": -w[:, 0], "east": w[:, -1], "south": -s[0], "north": s[-1]}
        return {
            edge: edges[edge] for edge, is_open in zip(EDGES, self.edge_is_open, strict=True)
            if is_open
        }  # fmt: skip

    def _lean_edge_flux(self):
        """Volume flux [m2/s] of "lean" out of the map through each face of its open edges."""
        h = self.h[self.inner]
        inside = {"west": h[:, 0], "east": h[:, -1], "south": h[0], "north": h[-1]}
        outward = self._outward(self.u, self.v)
        return [np.maximum(speed, 0) * inside[edge] for edge, speed in outward.items()]

    def advance_velocity(self, dt):
        """Advance the velocity from step n+1/2 to n+3/2; "lean" has done so with the depth."""
        self._steps += 1
        if self._steps % CAP_STEPS == 0:
            self._raise_cap()
        if not self.is_lean:
            # Velocity was half of the last step ahead of the depth and must be half of this one.
            # After a step three times as long it waits instead: friction does not run backwards.
            pressure_time = max(dt + 0.5 * (dt - self._lead), 0.0)
            self._lead += 2 * (pressure_time - dt)
            self._accelerate(dt, pressure_time)
        elif not self.moves:
            self._step_lean(0.0, dt)

    def _step_lean(self, dt, pressure_time):
        """Depth by `dt` and velocity by `pressure_time` [s] in one pass."""
        speeds = self._speeds_of_active_tiles()
        step(
            self._runs, self._tiles, self._water(), self.bed, self._numbers(dt, pressure_time),
            self._h_spare, self._u_spare, self._v_spare, *speeds,
        )  # fmt: skip
        self.h, self._h_spare = self._h_spare, self.h
        self._finish_velocity(pressure_time, speeds)

    def _accelerate(self, dt, pressure_time):
        """Carry momentum over the `dt` [s] in which the depth moved; press for `pressure_time`."""
        speeds = self._speeds_of_active_tiles()
        accelerate(
            self._runs, self._tiles, self._water(), self.bed, Flux(self._qu, self._qv),
            self._numbers(dt, pressure_time), self._u_spare, self._v_spare, *speeds,
        )  # fmt: skip
        self._finish_velocity(pressure_time, speeds)

    def _water(self):
        return Water(self.h, self.remainder, self.u, self.v)

    def _numbers(self, dt, pressure_time):
        dtype, spacing, gravity = self._type, self._spacing, self._gravity
        return StepNumbers(
            k=dtype(dt / spacing), kg=dtype(gravity * pressure_time / spacing),
            wave=dtype(gravity * (dt / spacing) ** 2), gravity=dtype(gravity),
            cap=dtype(self.cap), rounding=self.rounding, dry=self.dry,
        )  # fmt: skip

    def _finish_velocity(self, dt, speeds):
        """Swap in the new velocity, slow it by friction, fill ghosts, measure speeds."""
        self.u, self._u_spare = self._u_spare, self.u
        self.v, self._v_spare = self._v_spare, self.v
        if self.roughness is not None:
            dtype = self._type
            numbers = FrictionNumbers(
                drag=dtype(self._gravity * dt), laminar=dtype(3 * self.viscosity * dt),
                gravity=dtype(self._gravity), dry=self.dry,
            )  # fmt: skip
            before = Water(self.h, self.remainder, self._u_spare, self._v_spare)
            ground = Ground(self.bed, self.roughness)
            apply_friction(
                self._runs, self._tiles, before, ground, numbers, self.u, self.v, *speeds
            )
        self._fill_ghosts()
        self._note_speeds(*speeds)

    # -- file -----------------------------------------------------------------------------------

    SAVED = "h", "_h_spare", "remainder", "u", "_u_spare", "_qu", "v", "_v_spare", "_qv"
    SAVED_NUMBERS = (
        "cap", "_steps", "is_at_whole_step", "_lead", "wave_speed", "water_speed", "moves",
    )  # fmt: skip

    def saved(self):
        """Return the arrays that make up the state, by name."""
        fields = {name.strip("_"): getattr(self, name) for name in self.SAVED}
        numbers = np.array([float(getattr(self, name)) for name in self.SAVED_NUMBERS])
        return {**fields, "numbers": numbers, "still_steps": self._still_steps}

    def restore(self, arrays):
        """Take over the arrays that `saved` returned."""
        for name in self.SAVED:
            getattr(self, name)[:] = arrays[name.strip("_")]
        for name, number in zip(self.SAVED_NUMBERS, arrays["numbers"].tolist(), strict=True):
            kind = {"_steps": int, "is_at_whole_step": bool, "moves": bool}.get(name, float)
            setattr(self, name, kind(number))
        self._still_steps[:] = arrays["still_steps"]
        self._changed[:] = True
        self._activate(slice(0, 0))

    # -- tiles -------------------------------------------------------------------------------------

    def tiles(self, everywhere):
        """Return the tiles to which sources are applied: all, or those where water moves."""
        return self._all_tiles if everywhere else self._tiles

    def changed_tiles(self):
        """Return the numbers of the tiles whose depths may have changed since the last call."""
        which = np.flatnonzero(self._changed)
        self._changed[:] = False
        return which

    def note_sources(self, everywhere):
        """Take note that sources have changed depths: all over, or where water moves."""
        if everywhere:
            self._changed[:] = True
            self._activate(self._wet_tiles())
        fill_depth(self.edge_is_open, self.h)

    def note_cells(self, edge, rows, columns, rise, dt):
        """Take note that last cells of an edge rose within a step.

        Parameters
        ----------
        edge : str
        rows, columns : ndarray of int
        rise : ndarray [m]
            Of each cell.
        dt : float [s]
            Of the step.
        """
        if self.is_lean:
            self._press(edge, rows + PAD, columns + PAD, rise, dt)
        tiles = rows // ROWS * self._tile_shape[1] + columns // COLUMNS
        self._changed[tiles] = True
        self._activate(tiles)
        fill_depth(self.edge_is_open, self.h)
        at = rows + PAD, columns + PAD
        self._raise_cap_to(float(self.h[at].max()), float((self.h[at] + self.bed[at]).max()))

    def _press(self, edge, j, i, rise, dt):
        """Give the faces inside the edge the pressure of a rise [m] that "lean" did not see.

        It takes the velocity to n+3/2 together with the depth, before the cells rise.
        """
        sign = self._type(1 if edge in ("west", "south") else -1)
        w = self.u if edge in ("west", "east") else self.v
        at = j + (edge == "south"), i + (edge == "west")
        pushed = w[at] + sign * (self._gravity * dt / self._spacing * rise).astype(self._type)
        cap = self._type(self.cap)
        w[at] = np.where(w[at] != 0, np.clip(pushed, -cap, cap), 0)  # closed faces stay closed

    def _wet_tiles(self):
        """Whether each tile holds water that can flow."""
        wet = self.h[self.inner] > 0
        rows = np.arange(0, wet.shape[0], ROWS)
        columns = np.arange(0, wet.shape[1], COLUMNS)
        wet = np.logical_or.reduceat(np.logical_or.reduceat(wet, rows, axis=0), columns, axis=1)
        return wet.reshape(-1)

    def _activate(self, which=slice(None)):
        """Let the tiles `which` and their neighbours take part in the next steps."""
        self._still_steps[which] = 0
        moving = self._still_steps < STILL_STEPS
        if not np.array_equal(moving, self._moving):
            self._moving = moving
            near = np.pad(moving.reshape(self._tile_shape), 1)
            near = near[:-2] | near[1:-1] | near[2:]
            near = near[:, :-2] | near[:, 1:-1] | near[:, 2:]
            self._active = np.flatnonzero(near)
            self._tiles = self._all_tiles[self._active]
            self._runs = runs_of(self._tiles, self._active, self._tile_shape[1])
        self._changed[self._active] = True

    def _speeds_of_active_tiles(self):
        """Return where the kernels write the fastest wave and face of each active tile."""
        count = len(self._tiles)
        return self._wave_speeds[:count], self._water_speeds[:count]

    def _note_speeds(self, wave_speeds, water_speeds):
        """Take over the speeds of the active tiles, and let still tiles sleep.

        A tile sleeps when it and its neighbours were still for two steps: then both copies of its
        fields are the same, and a step would change no number.
        """
        self.wave_speed = float(wave_speeds.max(initial=0))
        self.water_speed = float(water_speeds.max(initial=0))
        self.moves = self.water_speed > 0.0
        still = self._still_steps[self._active] + 1
        self._still_steps[self._active] = np.where(water_speeds > 0, 0, still)
        self._activate(slice(0, 0))
