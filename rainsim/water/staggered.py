"""Depth and velocity on a staggered grid: the state that all schemes have."""

import numpy as np

from rainsim.water.bundles import StepNumbers, Water
from rainsim.water.inputs import EDGES

TINY = 1e-9  # m, keeps 0 / 0 out of dry cells into which nothing flows


class StaggeredFlow:
    """Depth at cell centres and velocity at faces, in two copies: a step writes the other one.

    bed : ndarray of the shape of the fields [m]. Height on which the water flows,
        of the type of all fields.
    roughness : ndarray of the shape of the fields, or None [s2 m^(-2/3)]. Square
        of Manning's n.
    dry : float [m]. Depth below which water does not flow.
    roundings : int. Rounding units of bed and depth within which levels are
        equal.
    pad, inner : int, tuple of slice. Rings of ghost cells, and the cells without
        them.
    water : Water. The present copy; the remainder is that of both.
    """

    pad, inner = 0, np.s_[:, :]

    def __init__(self, bed, spacing, gravity, is_open, roughness, dry, roundings=1):
        (ny, nx), dtype = bed.shape, bed.dtype.type
        self._spacing, self._gravity, self.is_open = spacing, gravity, is_open
        self.rounding, self.dry = dtype(roundings * np.finfo(dtype).eps), dtype(dry)
        self.bed, self.roughness = bed, roughness
        remainder = np.zeros_like(bed)
        self.water, self._spare = (
            Water(np.zeros_like(bed), remainder, np.zeros((ny, nx + 1), dtype),
                  np.zeros((ny + 1, nx), dtype))
            for _ in range(2)
        )  # fmt: skip
        self.wave_speed = self.water_speed = 0.0
        self._entries = []

    def faces(self):
        """Return the velocities of all faces, (ny, nx + 1) and (ny + 1, nx) [m/s]; views."""
        return self.water.u[self.inner], self.water.v[self.inner]

    def largest_speed(self):
        """Largest face speed [m/s], from all faces."""
        u, v = self.water.u, self.water.v
        return float(max(u.max(), -u.min(), v.max(), -v.min()))

    def open_edges(self):
        """Return the names of the open edges."""
        return [edge for edge in EDGES if self.is_open[edge]]

    def outward(self, edge, along, across):
        """Return the numbers of two face maps on the faces of an edge, outward > 0."""
        w, s = along[self.inner], across[self.inner]
        return {"west": -w[:, 0], "east": w[:, -1], "south": -s[0], "north": s[-1]}[edge]

    def depth_at(self, edge):
        """Return the depths [m] in the last cells of an edge."""
        h = self.water.h[self.inner]
        return {"west": h[:, 0], "east": h[:, -1], "south": h[0], "north": h[-1]}[edge]

    def leaving(self, edge):
        """Return the flow that leaves through an edge over the width of a cell [m2/s]."""
        speed = self.outward(edge, self.water.u, self.water.v)
        return float((speed.astype(np.float64) * self.depth_at(edge)).sum())

    def let_in(self, edge, rows, columns, flow):
        """Give faces of a wall the speed at which `flow` [m2/s] comes in through them.

        It is that of the depth in the cell, at most the critical one. From rest it would dam up.
        Return the depths [m] by which the next `advance_depth` fills the cells so, an array.
        """
        deep = self.water.h[rows + self.pad, columns + self.pad].astype(np.float64)
        critical = (flow**2 / self._gravity) ** (1 / 3)
        speed = (flow / np.maximum(np.maximum(deep, critical), TINY)).astype(self.bed.dtype)
        self._entries.append((edge, rows, columns, speed, np.zeros(len(rows))))
        self._set_entries()
        return self._entries[-1][-1]

    def close_entries(self):
        """Let nothing in any more; see `let_in`."""
        self._entries.clear()

    def _set_entries(self):
        """Write the speed of what comes in to faces of the edge and to ghost faces behind them."""
        for edge, rows, columns, speed, _ in self._entries:
            is_across, is_first = edge in ("west", "east"), edge in ("west", "south")
            w, along = (self.water.u, rows) if is_across else (self.water.v.T, columns)
            for face in (self.pad, self.pad - 1) if self.pad else (0,):
                last = face if is_first else w.shape[1] - 1 - face
                w[along + self.pad, last] = speed if is_first else -speed

    def _note_entries(self, k, dtype):
        """Note the depths [m] that come in through faces, before the depth moves.

        `k` [s/m] and the type of the flux are those with which it moves: the account is exact.
        """
        for _, rows, columns, speed, passed in self._entries:
            deep = self.water.h[rows + self.pad, columns + self.pad].astype(dtype)
            passed[:] = (speed.astype(dtype) * deep).astype(np.float64) * k

    def numbers(self, dt, pressure_time, cap):
        """Return the `StepNumbers` of a step of `dt` [s] with pressure over `pressure_time` [s]."""
        dtype, spacing, gravity = self.bed.dtype.type, self._spacing, self._gravity
        return StepNumbers(
            k=dtype(dt / spacing), kg=dtype(gravity * pressure_time / spacing),
            wave=dtype(gravity * (dt / spacing) ** 2), gravity=dtype(gravity), cap=dtype(cap),
            rounding=self.rounding, dry=self.dry,
        )  # fmt: skip
