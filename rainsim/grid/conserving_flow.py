"""The owner of the fields of the momentum-conserving schemes; its methods name the phases."""

from __future__ import annotations

import math

import numpy as np

from rainsim.grid.conserving import (
    PAD,
    fill_depth,
    fill_velocity,
    flux,
    move,
    push,
)
from rainsim.grid.friction import rub
from rainsim.grid.lean import step
from rainsim.grid.rows import COLUMNS, ROWS, peaks, runs_of

EDGES = ("west", "east", "south", "north")
MAX_STEP = 0.25  # cells that water may cross in a step: four faces then take what a cell holds
ROUNDING_ROOM = 1 - 1e-6  # of a step, so that float32 factors keep that promise too
CAP_STEPS = 64  # between two looks at how much energy there is
EDGE_TILES = {
    "west": np.s_[:, 0], "east": np.s_[:, -1], "south": np.s_[0], "north": np.s_[-1]
}  # fmt: skip
STILL_STEPS = 2  # after which both copies of a tile's velocity are zero


class ConservingFlow:
    """Depth and velocity with `PAD` ghost cells around, and the step of "accurate".

    Parameters
    ----------
    bed : ndarray of shape (ny, nx) [m]
        Height on which the water flows, of the type of all fields.
    spacing, gravity : float [m], [m/s2]
    is_open : dict
        Whether each edge is open.
    inflow : dict
        Discharge [m3/s] that comes in through each of some edges.
    roughness : ndarray of shape (ny, nx) or None [s2 m^(-2/3)]
        Square of Manning's n.
    viscosity : float [m2/s]
    rest, dry : float
        Relative rounding of levels; depth [m] below which water does not flow.
    """

    pad = PAD

    def __init__(
        self, bed, spacing, gravity, is_open, inflow, roughness, viscosity, rest, dry, lean
    ):
        self._type = bed.dtype.type
        self._spacing, self._gravity, self._rest, self._dry = spacing, gravity, rest, dry
        self._kinds = np.array([is_open[edge] for edge in EDGES], np.int64)
        self._inflow = {edge: rate for edge, rate in inflow.items() if rate > 0.0}
        self._passages = [edge for edge in EDGES if is_open[edge] or edge in self._inflow]
        self._viscosity = viscosity
        self._roughness = None
        if roughness is not None or viscosity > 0.0:
            self._roughness = self._framed(np.zeros_like(bed) if roughness is None else roughness)
        self.bed = self._framed(bed)
        fill_depth(self._kinds, self.bed)
        ny, nx = self.bed.shape
        self.h, self.damp = np.zeros_like(self.bed), np.zeros_like(self.bed)
        self._lean, self._h_spare = lean, np.zeros_like(self.bed)
        self.u, self._u_spare, self._qu = (np.zeros((ny, nx + 1), self._type) for _ in range(3))
        self.v, self._v_spare, self._qv = (np.zeros((ny + 1, nx), self._type) for _ in range(3))
        self._inflow_reach = 0.0
        self._lay_tiles(ny, nx)
        self.cap, self._floor = 0.0, float(bed.min())

    def _framed(self, field):
        return np.pad(field, PAD)

    def _lay_tiles(self, ny, nx):
        south, west = np.arange(PAD, ny - PAD, ROWS), np.arange(PAD, nx - PAD, COLUMNS)
        north = np.minimum(south + ROWS, ny - PAD)
        east = np.minimum(west + COLUMNS, nx - PAD)
        self._tile_shape = len(south), len(west)
        tiles = np.empty((*self._tile_shape, 4), np.int64)
        tiles[..., 0], tiles[..., 1] = south[:, None], north[:, None]
        tiles[..., 2], tiles[..., 3] = west, east
        self._all_tiles = tiles.reshape(-1, 4)
        count = len(self._all_tiles)
        self._reaches, self._fasts = np.zeros(count, self._type), np.zeros(count, self._type)
        self._still = np.zeros(count, np.int64)  # steps since the tile last moved
        self._changed, self._moving = np.ones(count, bool), None
        self._wake()

    # -- state -------------------------------------------------------------------------------------

    @property
    def inner(self):
        """The slices of the cells without their ghosts."""
        return np.s_[PAD:-PAD, PAD:-PAD]

    def start(self, u, v):
        """Set the inner face velocities, shapes (ny, nx - 1) and (ny - 1, nx), after `h`."""
        self.u[:], self.v[:] = 0, 0
        self.u[PAD:-PAD, PAD + 1 : -PAD - 1] = u
        self.v[PAD + 1 : -PAD - 1, PAD:-PAD] = v
        self._u_spare[:], self._v_spare[:], self._qu[:], self._qv[:] = 0, 0, 0, 0
        self._h_spare[:] = self.h
        self._steps, self._waits, self.cap, self._ahead = 0, True, 0.0, 0.0
        self._wake()
        self._settle()
        self.refresh()

    def _settle(self):
        fill_depth(self._kinds, self.h)
        fill_velocity(self._kinds, self.u, self.v)
        for edge, rate in self._inflow.items():
            self._let_in(edge, rate)

    def _let_in(self, edge, rate):
        """Set depth and speed beyond an inflow edge so that `rate` comes through its faces.

        The ghost cells are as deep as the cells beside them, or critically deep if that is more.
        """
        across = edge in ("west", "east")
        h, w = (self.h, self.u) if across else (self.h.T, self.v.T)
        inner, begins = np.s_[PAD:-PAD], edge in ("west", "south")
        q = rate / ((h.shape[0] - 2 * PAD) * self._spacing)
        beside = h[inner, PAD if begins else -PAD - 1]
        depth = np.maximum(beside, (q * q / self._gravity) ** (1 / 3))[:, None]
        h[inner, np.s_[:PAD] if begins else np.s_[-PAD:]] = depth
        speed = (q if begins else -q) / depth
        w[inner, np.s_[: PAD + 1] if begins else np.s_[-PAD - 1 :]] = speed
        fast = float(np.abs(speed).max())
        self._inflow_reach = fast + math.sqrt(self._gravity * float(depth.max()))

    def faces(self):
        """Velocities of all faces, shapes (ny, nx + 1) and (ny + 1, nx) [m/s]."""
        return self.u[PAD:-PAD, PAD:-PAD], self.v[PAD:-PAD, PAD:-PAD]

    def tiles(self, everywhere):
        """Return the tiles to which rain and losses go: all, or those where water moves."""
        return self._all_tiles if everywhere else self._tiles

    def changed(self):
        """Return the numbers of the tiles in which depths may have changed since last asked."""
        which = np.flatnonzero(self._changed)
        self._changed[:] = False
        return which

    def touched(self, everywhere):
        """Take note that depths were changed from outside: all over, or where water moves."""
        if everywhere:
            self._changed[:] = True
            self._wake(self._wet_tiles())
        fill_depth(self._kinds, self.h)

    def _wet_tiles(self):
        """Whether each tile holds water that can flow."""
        wet = self.h[self.inner] > 0
        rows = np.arange(0, wet.shape[0], ROWS)
        columns = np.arange(0, wet.shape[1], COLUMNS)
        wet = np.logical_or.reduceat(np.logical_or.reduceat(wet, rows, axis=0), columns, axis=1)
        return wet.reshape(-1)

    def _wake(self, which=slice(None)):
        """Let the tiles `which` take part in the next steps, with their neighbours."""
        self._still[which] = 0
        for edge in self._inflow:
            self._still.reshape(self._tile_shape)[EDGE_TILES[edge]] = 0
        moving = self._still < STILL_STEPS
        if not np.array_equal(moving, self._moving):
            self._moving = moving
            near = np.pad(moving.reshape(self._tile_shape), 1)
            near = near[:-2] | near[1:-1] | near[2:]
            near = near[:, :-2] | near[:, 1:-1] | near[:, 2:]
            self._awake = np.flatnonzero(near)
            self._tiles = self._all_tiles[self._awake]
            self._runs = runs_of(self._tiles, self._awake, self._tile_shape[1])
        self._changed[self._awake] = True

    def refresh(self):
        """Measure anew what the step and the cap follow, from depths and velocities."""
        h, level = self.h[self.inner], (self.h + self.bed)[self.inner]
        self.swift = self.fastest()
        # Where a surface difference waits, a step of pressure makes some of that speed.
        falls = [0.0]
        for axis in (0, 1):
            a, b = [slice(None)] * 2, [slice(None)] * 2
            a[axis], b[axis] = slice(None, -1), slice(1, None)
            a, b = tuple(a), tuple(b)
            falls.append(float(((level[a] - level[b]) * (h[a] > 0)).max()))
            falls.append(float(((level[b] - level[a]) * (h[b] > 0)).max()))
        drop = max(float(h.max()), *falls)
        self.reach = self.swift + math.sqrt(self._gravity * drop)
        self.moves = self.swift > 0.0 or bool(self._inflow)
        self._raise_cap()

    def fastest(self):
        """Largest face speed [m/s], from all faces."""
        return float(max(self.u.max(), -self.u.min(), self.v.max(), -self.v.min()))

    def _raise_cap(self):
        """Speed of a dam break on the deepest water and of a fall from the highest [m/s]."""
        tops = np.empty((2, len(self._all_tiles)), self._type)
        peaks(self._all_tiles, self.h, self.bed, *tops)
        deepest, highest = (float(top) for top in tops.max(axis=1))
        if deepest <= 0.0:
            return
        fall = max(highest - self._floor, 0.0)
        bound = 2 * math.sqrt(self._gravity * deepest) + math.sqrt(2 * self._gravity * fall)
        self.cap = max(self.cap, bound, self.swift if self._steps == 0 else 0.0)

    # -- step --------------------------------------------------------------------------------------

    def stable_step(self, courant):
        """Longest step [s] at which waves and flow stay within their limits."""
        step = courant * self._spacing / max(self.reach, self._inflow_reach, 1e-30)
        return ROUNDING_ROOM * min(step, MAX_STEP * self._spacing / max(self.swift, 1e-30))

    def flow(self, dt):
        """Bring depth from n to n+1; return the volumes [m3] that left and came in."""
        if self._waits:  # velocity is known at n like depth: half a step of pressure brings it on
            self._waits, self._ahead = False, dt
            if self._lean:
                self._step(0.0, 0.5 * dt)
            else:
                self._push(0.5 * dt, 0.5 * dt)
        if not self.moves:
            return 0.0, 0.0
        if self._lean:
            through = self._through_edges()
            self._step(dt, dt)
        else:
            k = dt / self._spacing
            flux(self._runs, self.h, self.bed, self.u, self.v, self._qu, self._qv)
            move(self._runs, self._qu, self._qv, k, float(self._dry), self.h, self.damp)
            fill_depth(self._kinds, self.h)
            through = self._outward(self._qu, self._qv).values()
        left = sum(float(q.clip(min=0).sum(dtype=np.float64)) for q in through)
        entered = -sum(float(q.clip(max=0).sum(dtype=np.float64)) for q in through)
        return left * dt * self._spacing, entered * dt * self._spacing

    def _outward(self, along, across):
        """Views of what two face maps hold at the edges that let water through, outward > 0."""
        w, s = along[PAD:-PAD, PAD:-PAD], across[PAD:-PAD, PAD:-PAD]
        edges = {"west": -w[:, 0], "east": w[:, -1], "south": -s[0], "north": s[-1]}
        return {edge: edges[edge] for edge in self._passages}

    def _through_edges(self):
        """Volume flux [m2/s] out of the map through each face of its edges, as "lean" has it."""
        h, inner, fluxes = self.h, np.s_[PAD:-PAD], []
        inside = {
            "west": h[inner, PAD], "east": h[inner, -PAD - 1],
            "south": h[PAD, inner], "north": h[-PAD - 1, inner],
        }  # fmt: skip
        beyond = {
            "west": h[inner, PAD - 1], "east": h[inner, -PAD],
            "south": h[PAD - 1, inner], "north": h[-PAD, inner],
        }  # fmt: skip
        for edge, speed in self._outward(self.u, self.v).items():
            fluxes.append(speed * np.where(speed > 0, inside[edge], beyond[edge]))
        return fluxes

    def turn(self, dt):
        """Bring velocity from n+1/2 to n+3/2; "lean" has done so with the depth."""
        self._steps += 1
        if self._steps % CAP_STEPS == 0:
            self._raise_cap()
        if not self._lean:
            # Velocity was half of the last step ahead of the depth; now it shall be half of this.
            # After a step three times as long it waits instead: friction does not run backwards.
            push_time = max(dt + 0.5 * (dt - self._ahead), 0.0)
            self._ahead += 2 * (push_time - dt)
            self._push(dt, push_time)
        elif not self.moves:
            self._step(0.0, dt)

    def _step(self, dt, push_time):
        dtype = self._type
        k, kg = dtype(dt / self._spacing), dtype(self._gravity * push_time / self._spacing)
        tops = self._reaches[: len(self._tiles)], self._fasts[: len(self._tiles)]
        step(
            self._runs, self._tiles, self.h, self.bed, self.u, self.v, k, kg, dtype(self._gravity),
            dtype(self.cap), self._rest, self._dry,
            self._h_spare, self._u_spare, self._v_spare, *tops,
        )  # fmt: skip
        self.h, self._h_spare = self._h_spare, self.h
        self._swap_velocity()
        if self._roughness is not None:
            self._rub(push_time, tops)
        self._settle()
        self._follow(*tops)

    def _push(self, dt, push_time):
        """Carry momentum over the `dt` in which the depth moved; press for `push_time`."""
        dtype, k = self._type, self._type(dt / self._spacing)
        kg = dtype(self._gravity * push_time / self._spacing)
        wave = dtype(self._gravity * (dt / self._spacing) ** 2)
        tops = self._reaches[: len(self._tiles)], self._fasts[: len(self._tiles)]
        push(
            self._runs, self._tiles, self.h, self.damp, self.bed, self.u, self.v,
            self._qu, self._qv, k, kg, wave, dtype(self._gravity), dtype(self.cap),
            self._rest, self._dry, self._u_spare, self._v_spare, *tops,
        )  # fmt: skip
        self._swap_velocity()
        if self._roughness is not None:
            self._rub(push_time, tops)
        self._settle()
        self._follow(*tops)

    def _rub(self, dt, tops):
        drag, film = self._type(self._gravity * dt), self._type(3 * self._viscosity * dt)
        rub(
            self._runs, self._tiles, self.h, self.bed, self._roughness,
            self._u_spare, self._v_spare, drag, film, self._type(self._gravity), self._dry,
            self.u, self.v, *tops,
        )  # fmt: skip

    def _swap_velocity(self):
        self.u, self._u_spare = self._u_spare, self.u
        self.v, self._v_spare = self._v_spare, self.v

    def _follow(self, reaches, fasts):
        """Note how fast waves and water are, and which tiles are still.

        A tile sleeps when it and its neighbours were still for two steps: then both copies of its
        fields are the same, and a step would change no number.
        """
        self.reach = float(reaches.max(initial=0))
        self.swift = float(fasts.max(initial=0))
        self.moves = self.swift > 0.0 or bool(self._inflow)
        self._still[self._awake] = np.where(fasts > 0, 0, self._still[self._awake] + 1)
        self._wake(slice(0, 0))
