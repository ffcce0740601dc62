"""The water on objects above the ground: films, puddles, drips from them, and its account."""

from dataclasses import replace

import numpy as np

from rainsim.drops import GROUND
from rainsim.rain.dripping import Drips, solid_cells

SMALLEST_ROOM = 1e-30  # m3, keeps tops without water from a division by zero


class Objects:
    """The water on objects above the ground, with its account; drips from them if asked for.

    start : Config. Of time 0.
    tops : TopWater
    dried : float [m]. What evaporation has taken from the tops.
    initial, inflow : float [m3]. What was on the objects when the account was
        opened, and what has risen from outside.
    """

    def __init__(self, surfaces, start, tops, dried):
        rain, wet = start.rain, start.rain.past > 0 or start.water.level is not None
        self.drips = Drips(surfaces, rain.seed, wet) if rain.drips else None
        self._roughness = rain.roughness
        self.initial = self._came = self._returned = self._kept = self.inflow = 0.0
        self.tops = tops
        self._on_tops = tops.after(rain.past, dried)
        if self.drips is not None:
            self._fill_tops()
        else:
            self._area = float(np.count_nonzero(solid_cells(surfaces))) * surfaces.spacing**2

    def _fill_tops(self):
        """Give each drip point the room that the tops above it have, and the water of past rain."""
        points, count, tops = self.drips.point, len(self.drips.room), len(self._on_tops)
        room, top = self.tops.room()
        over = (points >= 0) & (top >= 0)
        pairs, which = np.unique(points[over] * tops + top[over], return_inverse=True)
        self._point, self._top = np.divmod(pairs, max(tops, 1))
        self._room = np.bincount(which, room[over], len(pairs))
        self._room_of = np.bincount(self._point, self._room, count)
        self._room_on = np.maximum(np.bincount(self._top, self._room, tops), SMALLEST_ROOM)
        share = self._on_tops / np.maximum(self.tops.capacity, SMALLEST_ROOM)
        held = np.bincount(self._point, self._room * share[self._top], count)
        self.drips.hold(self._room_of, held)

    def top_water(self):
        """Return the water on each top now [m3], (n,)."""
        if self.drips is None or not len(self._on_tops):
            return self._on_tops.copy()
        return self._on_each(np.maximum(self._room_of - self.drips.room, 0.0))

    def _on_each(self, held):
        """Return the water on each top [m3] from the water `held` behind each drip point [m3]."""
        share = held / np.maximum(self._room_of, SMALLEST_ROOM)
        mine = np.bincount(self._top, self._room * share[self._point], len(self._on_tops))
        return mine / self._room_on * self.tops.capacity

    def open_account(self):
        """Count the water that is now on the objects and in the air as there from the start."""
        self._came = self._returned = self._kept = 0.0
        if self.drips is not None:
            self.initial = self.drips.held + self.drips.airborne

    def take_even_rain(self, depth):
        """Give the objects a depth [m] of rain that falls evenly."""
        if self.drips is not None:
            came = self.drips.take_even_rain(depth)
        else:
            came = self._area * depth
            self._kept += came
        self._came += came

    def let_in(self, solver, rows, columns, volumes):
        """Give the ground water that comes from outside; withdraw negative volumes [m3] from it."""
        more, less = volumes > 0, volumes < 0
        solver.deposit(rows[more], columns[more], volumes[more])
        solver.withdraw(rows[less], columns[less], -volumes[less])
        self.inflow += float(volumes[more].sum())

    def advance(self, start, stop, weather):
        """Return the rows, columns and volumes [m3] of the water that comes down from objects."""
        if self.drips is None:
            return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
        wind = weather.wind(0.5 * (start + stop)), self._roughness
        rows, columns, volumes = self.drips.advance(start, stop, *wind)
        self._returned += float(volumes.sum())
        return rows, columns, volumes

    def landed(self):
        """Return the drops that came to the ground in the last step, or None."""
        if self.drips is None:
            return None
        return self.drips.landed.take(self.drips.landed.kind == GROUND)

    @property
    def parted(self):
        """The drips in the air, as `Drips.parted`."""
        return () if self.drips is None else self.drips.parted

    def falling(self):
        """Return the drips in the air and their ids, as `SimState` holds them."""
        return () if self.drips is None else self.drips.falling()

    def ledger(self, report, solver):
        """Return the solver's ledger with the objects' water in it."""
        held, airborne = self._kept, 0.0
        if self.drips is not None:
            held, airborne = held + self.drips.held, self.drips.airborne
        ledger = solver.ledger if report is None else report.ledger
        return replace(
            ledger, initial=ledger.initial + self.initial,
            # The solver books water from objects and from outside as rain.
            rain=ledger.rain + (self._came - self._returned - self.inflow),
            inflow=ledger.inflow + self.inflow, obstacles=ledger.obstacles + held,
            airborne=ledger.airborne + airborne,
        )  # fmt: skip
