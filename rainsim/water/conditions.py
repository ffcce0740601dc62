"""Conditions on parts of the map's edges: a given stage, a given discharge, a rating curve.

Each acts on the last cells of its part once in a step, after the flow: a stage sets their level, a
discharge adds water or takes it, a rating curve takes what belongs to their level. The edge itself
is a wall there, but what comes in passes its faces at the speed that it has in its cell, see
`StaggeredFlow.let_in`; what is wanting there is added.
"""

import math

import numpy as np

from rainsim.errors import ParameterError, require_choice
from rainsim.water.inputs import EDGES
from rainsim.water.series import Series, series

HALVINGS = 30  # of the share that a rating curve leaves: to 1e-9 of it


class Condition:
    """A part of an edge.

    edge : {"west", "east", "south", "north"}
    span : (int, int), optional. First cell and last cell + 1 along the edge, from
        the south or the west; all by default.
    volume : float [m3]. That came in since the state was set, less what left.
    flow : float [m3/s]. That came in over the last step, less what left.
    """

    def __init__(self, edge, span=None):
        self.edge = require_choice("edge", edge, EDGES)
        self.span = span
        self.volume = self.flow = 0.0

    def place(self, bed, pad, is_open):
        """Take the places of the cells and the bed [m] of a solver's map."""
        if is_open[self.edge]:
            raise ParameterError(
                f'the {self.edge} edge is open; a condition needs a wall; give boundary "wall" '
                "there"
            )
        along = bed.shape[0] if self.edge in ("west", "east") else bed.shape[1]
        first, end = (0, along) if self.span is None else self.span
        if not 0 <= first < end <= along or first != int(first) or end != int(end):
            raise ParameterError(
                f"span is {self.span}; it must be first cell and last cell + 1 of the {self.edge} "
                f"edge, within 0 and {along}"
            )
        cells = np.arange(int(first), int(end))
        last = {"west": 0, "east": bed.shape[1] - 1, "south": 0, "north": bed.shape[0] - 1}
        other = np.full(len(cells), last[self.edge])
        self.rows, self.columns = (
            (cells, other) if self.edge in ("west", "east") else (other, cells)
        )
        self.bed = bed[self.rows, self.columns].astype(np.float64)
        self.at = self.rows + pad, self.columns + pad
        self.reset()

    def reset(self):
        """Begin a new account."""
        self.volume = self.flow = 0.0
        self.rises = self.passes = np.zeros(len(self.rows))

    def comes_in(self, start, end, area):
        """Return what comes in from `start` to `end` [s] in each cell of `area` [m2], in m/s."""
        return np.zeros(len(self.rows))

    def deepest(self, start, end):
        """Return a depth [m] that the condition may bring about from `start` to `end` [s]."""
        return 0.0

    def rate(self, start, end, area):
        """Return the most [m/s] by which a cell of `area` [m2] may rise from `start` to `end`."""
        return 0.0

    def change(self, depth, start, end, area):
        """Return the cells' depths [m] after the step from `start` to `end` [s]; `area` [m2]."""
        raise NotImplementedError


class Stage(Condition):
    """A water level given over time: water comes in or leaves as the level asks for.

    Parameters
    ----------
    edge : {"west", "east", "south", "north"}
    level : float or Series [m]
        Height of the surface, in the heights of the bed. Where it is under the bed the cell is dry.
    span : (int, int), optional
        See `Condition`.

    Examples
    --------
    >>> tide = rainsim.Series([0, 100, 200], [0.2, 0.5, 0.2])
    >>> sea = rainsim.Stage("west", tide)
    >>> solver = rainsim.WaterSolver(np.zeros((4, 40)), 1.0, conditions=[sea])
    >>> ledger = solver.advance(100.0).ledger
    >>> bool(ledger.inflow > 10.0), round(sea.volume - ledger.inflow + ledger.outflow, 9)
    (True, 0.0)
    """

    def __init__(self, edge, level, span=None):
        super().__init__(edge, span)
        self.level = series(level)

    def deepest(self, start, end):
        """Return the depth [m] of the highest level from `start` to `end` [s]."""
        return max(self.level.most(start, end) - float(self.bed.min()), 0.0)

    def comes_in(self, start, end, area):
        """Return what came in over the last step [m/s]."""
        return np.maximum(self.rises, 0.0)

    def change(self, depth, start, end, area):
        """Return the depths [m] at which the surface has the level of the time `end` [s]."""
        return np.maximum(self.level(end) - self.bed, 0.0)


class Discharge(Condition):
    """A discharge given over time, spread evenly over the cells; negative: taken from them.

    Parameters
    ----------
    edge : {"west", "east", "south", "north"}
    flow : float or Series [m3/s]
        No more is taken than there is.
    span : (int, int), optional
        See `Condition`.

    Examples
    --------
    >>> river = rainsim.Discharge("west", 0.5, span=(1, 3))
    >>> solver = rainsim.WaterSolver(np.zeros((4, 40)), 1.0, conditions=[river])
    >>> round(solver.advance(10.0).ledger.inflow, 9)
    5.0
    """

    def __init__(self, edge, flow, span=None):
        super().__init__(edge, span)
        self.given = series(flow)

    def rate(self, start, end, area):
        """Return the largest discharge from `start` to `end` [s] over the cells' area [m/s]."""
        return max(self.given.most(start, end), 0.0) / (area * len(self.rows))

    def comes_in(self, start, end, area):
        """Return the mean discharge from `start` to `end` [s] over the cells' area [m/s]."""
        mean = max(self.given.mean(start, end), 0.0)
        return np.full(len(self.rows), mean / (area * len(self.rows)))

    def change(self, depth, start, end, area):
        """Return the depths [m] with what the discharge brings or takes."""
        brought = self.given.mean(start, end) * (end - start) / area
        if brought >= 0:
            return depth + brought / len(depth)
        return taken(depth, -brought)


class Rating(Condition):
    """A rating curve: the discharge that leaves is that of the mean level of the cells with water.

    Parameters
    ----------
    edge : {"west", "east", "south", "north"}
    levels : array_like of shape (n,) [m]
        Rising, in the heights of the bed.
    discharges : array_like of shape (n,) [m3/s]
        Of the whole part of the edge, not negative. Beyond the levels the first and last hold.
    span : (int, int), optional
        See `Condition`.

    Examples
    --------
    >>> weir = rainsim.Rating("east", [0.0, 0.1, 0.2], [0.0, 0.2, 0.6])
    >>> pond = rainsim.WaterSolver(np.zeros((4, 8)), 1.0, conditions=[weir])
    >>> pond.set_state(0.2)
    >>> bool(0.2 < pond.advance(1.0).ledger.outflow < 0.6)
    True
    """

    def __init__(self, edge, levels, discharges, span=None):
        super().__init__(edge, span)
        self.curve = Series(levels, discharges)
        if (self.curve.values < 0).any():
            raise ParameterError(
                f"a discharge of the rating curve is {self.curve.values.min():g} m3/s; it must not "
                "be negative; give what comes in as a Discharge"
            )

    def change(self, depth, start, end, area):
        """Return the depths [m] without what leaves at the level after the step.

        All cells keep the same share of their depth, found by bisection. With the level before the
        step a long step would empty the cells and the next one find them too low.
        """
        wet = depth > 0
        if not wet.any():
            return depth
        whole, bed, deep = float(depth.sum()), self.bed[wet].mean(), depth[wet].mean()
        dry, full = 0.0, 1.0
        for _ in range(HALVINGS):
            share = 0.5 * (dry + full)
            leaves = self.curve(bed + share * deep) * (end - start) / area
            dry, full = (share, full) if whole * (1 - share) > leaves else (dry, share)
        return depth * 0.5 * (dry + full)


def taken(depth, amount):
    """Return depths [m] of which a sum of `amount` [m] is taken, from each in its share."""
    whole = float(depth.sum())
    return depth * (1.0 - min(amount / whole, 1.0)) if whole > 0 else depth


def place_all(conditions, bed, pad, is_open):
    """Return the conditions as a list, placed on a solver's map, or raise ParameterError."""
    conditions = list(conditions or ())
    for condition in conditions:
        if not isinstance(condition, Condition):
            raise ParameterError(
                f"{condition!r} is no condition; give a Stage, a Discharge or a Rating"
            )
        condition.place(bed, pad, is_open)
    taken_cells = np.concatenate(
        [np.ravel_multi_index((c.rows, c.columns), bed.shape) for c in conditions] or [[]]
    )
    if len(np.unique(taken_cells)) < len(taken_cells):
        raise ParameterError("two conditions share a cell; give them spans that do not overlap")
    return conditions


def longest_step(solver, dt):
    """Return the step [s], at most `dt`, that the waves of what comes in allow."""
    start, room = solver.time, solver.courant * solver.spacing
    for condition in solver.conditions:
        rate = condition.rate(start, start + dt, solver.spacing**2)
        if rate > 0.0:  # as for rain on dry ground
            dt = min(dt, room ** (2 / 3) / (solver.gravity * rate) ** (1 / 3))
        deep = condition.deepest(start, start + dt)
        jump = deep - float(solver.flow.water.h[condition.at].max())
        if jump > 0.0:
            wave = math.sqrt(solver.gravity * deep) + math.sqrt(2 * solver.gravity * jump)
            dt = min(dt, room / (wave + solver.flow.water_speed))
    return dt


def let_in(solver, start, end):
    """Give what comes in from `start` to `end` [s] its speed at the walls, before the step."""
    solver.flow.close_entries()
    for condition in solver.conditions:
        rise = condition.comes_in(start, end, solver.spacing**2)
        condition.passes = solver.flow.let_in(
            condition.edge, condition.rows, condition.columns, rise * solver.spacing
        )


def apply_conditions(solver, start, end, dry):
    """Change the edge cells' water as the conditions ask; return volumes that came and left [m3].

    Films are left alone: the water above them changes.
    """
    (h, remainder, _, _), film, area = solver.flow.water, solver.sources.film, solver.spacing**2
    came = left = 0.0
    for condition in solver.conditions:
        at = condition.at
        held = film[at].astype(np.float64)
        free = h[at].astype(np.float64) + remainder[at]
        passed = condition.passes
        before = held + free - passed  # what came in through the faces is part of the change
        wanted = np.maximum(condition.change(before, start, end, area) - held, 0.0)
        h[at] = np.where(wanted >= dry, wanted, 0.0)
        remainder[at] = wanted - h[at]
        now = h[at].astype(np.float64) + remainder[at]
        rise = now - free + passed
        change, condition.rises = float(rise.sum()) * area, rise / (end - start)
        condition.volume += change
        condition.flow = change / (end - start)
        came, left = came + max(change, 0.0), left + max(-change, 0.0)
        solver.flow.note_cells(
            condition.edge, condition.rows, condition.columns, now - free, end - start
        )
    return came, left
