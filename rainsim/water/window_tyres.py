"""Cars over windows of the ground: tyres in a window, beyond it, and before its water begins.

A window's water begins a moment before its first frame, but a track lasts for seconds and mist
hangs behind a car. Cars therefore come to a window as they drove before, over the water as it
stands there: what they have thrown flies on, and where they passed the film is as full as the rain
has made it since. What lies around the window is treated so at all times, for a car some twenty
metres ahead is seen there. Neither is in the account of the window's water.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rainsim.config.settings import mm_per_hour
from rainsim.rain.throws import REMEMBERED
from rainsim.water.tyres import BEFORE, LEFT, Tyres

DEEP = 1e-3  # m over the film: water that stands so deep flows back behind a tyre
CLOSING = 0.5  # s in which it does so, to a part of e; an assumption


def tyres_of(terrain, config, begin=None, kind=Tyres):
    """Return the `Tyres` of the actors on a terrain; none if the settings leave spray out.

    Parameters
    ----------
    terrain : Terrain
    config : Config
    begin : Begin, optional
        Of a window's water.
    kind : type
        Of the tyres of a whole map.
    """
    around = None if begin is None else begin.around
    how = config.rain.seed, config.rain.roughness
    if config.render.spray == "off" or around is None:
        footprints = () if config.render.spray == "off" else terrain.footprints
        return kind(replace(terrain, footprints=footprints), *how)
    return WindowTyres(around, config.fps, *how)


class WindowTyres(Tyres):
    """The tyres of cars on a window of the ground and around it.

    Water that they take from the window is in the account, as `Tyres` has it. What they throw into
    the window from around it, or before the account opens, is counted as rain when it lands.

    Parameters
    ----------
    around : Around
    fps : float [1/s]
        Of the states before the first: cars come in the steps in which they go on.
    seed, roughness
        See `Tyres`.
    """

    def __init__(self, around, fps, seed=0, roughness=0.0):
        super().__init__(around.terrain, seed, roughness)
        self._around, self._fps, self._weather = around, fps, None
        rows, columns = around.window
        self._low = np.array([rows.start, columns.start])
        self._high = np.array([rows.stop, columns.stop])
        if self._cars:
            self._left = around.depth.copy()  # depth [m] when a tyre had passed last
            self._when = np.zeros(around.depth.shape, np.float32)  # s: when that was

    def come(self, depth, weather, number):
        """Let cars come to the window; return the depth [m] of its water when they have.

        Parameters
        ----------
        depth : ndarray of shape (ny, nx), float64 [m]
            Of the window's water at rest.
        weather : Weather
        number : int
            Of the state with which the water begins.
        """
        self._weather = weather
        if not self._cars:
            return depth
        first = max(number - math.ceil(REMEMBERED * self._fps), -math.ceil(BEFORE * self._fps))
        for n in range(first, number):
            self.roll(None, n / self._fps, (n + 1) / self._fps, weather)
        if self._box is None:
            return depth
        depth = depth.copy()
        rows, columns = np.nonzero(self._passed[self._around.window])
        now = self._refilled(rows + self._low[0], columns + self._low[1], number / self._fps)
        depth[rows, columns] = np.minimum(depth[rows, columns], now)
        return depth

    def start(self, solver, weather, time=0.0):
        """Return the `WaterReport` of the start, with which the account opens; None without cars.

        See `come`, which must have been called before the solver got its water.
        """
        return solver.advance(0.0) if self._cars else None

    def state(self, depth, time):
        """Return throws, ids and tracks as `SimState` takes them; the tracks also around it."""
        throws, ids = self.throws()
        if self._box is None:
            return {"throws": throws, "throw_id": ids, "tracks": self.tracks(depth)}
        wide = self._around.depth.copy()
        part = self._passed_part()
        rows, columns = np.nonzero(self._passed[part])
        rows, columns = rows + part[0].start, columns + part[1].start
        wide[rows, columns] = self._refilled(rows, columns, time)
        wide[self._around.window] = depth
        return {"throws": throws, "throw_id": ids, "tracks": self.tracks(wide)}

    def _refilled(self, rows, columns, time):
        """Return the depth [m] at a time [s] of water around the window that tyres have passed."""
        rest = self._around.depth[rows, columns].astype(np.float64)
        left, gone = self._left[rows, columns], np.maximum(time - self._when[rows, columns], 0.0)
        rain = mm_per_hour(self._weather.rate(time)) * self._around.exposure[rows, columns]
        film = self._terrain.by_class("storage", (rows, columns))
        closed = rest - (rest - left) * np.exp(-gone / CLOSING)
        return np.where(rest > film + DEEP, closed, np.minimum(left + rain * gone, rest))

    def _taken(self, solver, rows, columns, time):
        """See `Tyres._taken`; `solver` is None before the window's account opens."""
        own, outside = 0.0, np.ones(len(rows), bool)
        if solver is not None:
            place = np.column_stack([rows, columns])
            outside = ~((place >= self._low) & (place < self._high)).all(axis=1)
            within = place[~outside] - self._low
            own = solver.lift(within[:, 0], within[:, 1], LEFT)
        rows, columns = rows[outside], columns[outside]
        depth = self._refilled(rows, columns, time)
        left = np.minimum(depth, LEFT)
        self._left[rows, columns], self._when[rows, columns] = left, time
        beyond = float((depth - left).sum()) * self._terrain.grid.cell_area
        return own + beyond, own

    def _put_down(self, solver, row, column, volume, own):
        """See `Tyres._put_down`; on the water around the window nothing is put."""
        place = np.column_stack([row, column])
        inside = ((place >= self._low) & (place < self._high)).all(axis=1)
        self.gone += float(own[~inside].sum())
        if solver is not None:
            within = place[inside] - self._low
            super()._put_down(solver, within[:, 0], within[:, 1], volume[inside], own[inside])
