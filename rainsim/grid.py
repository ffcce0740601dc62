"""The water solver: the owner of the water on a height field, and its step from top to bottom.

A step from time n to n+1 is the method `_step`:

    h at n+1    = h - dt div(h u)             the flow's `advance_depth`
    h          += dt (rain - losses)          the sources' `apply`, films first
    u at n+3/2  = u - dt (transport + g grad(bed + h)), then friction   `advance_velocity`

The scheme of the first and the last line is a `rainsim.water.conserving_flow.ConservingFlow`
("accurate", "lean") or `rainsim.water.paper_flow.PaperFlow` ("paper"), the sources those of
`rainsim.water.sources`. The twin on a CUDA device is `rainsim.cuda.grid`.
"""

import json
import math
from dataclasses import astuple, replace

import numpy as np

from rainsim import errors
from rainsim.constants import GRAVITY
from rainsim.io.states import digest, read_solver, write_solver
from rainsim.jit import one_caller
from rainsim.ledger import Ledger
from rainsim.water import inputs
from rainsim.water.choose import MAX_COURANT, SCHEMES, choose
from rainsim.water.conditions import apply_conditions, let_in, longest_step, place_all
from rainsim.water.conserving_flow import AccurateFlow, LeanFlow
from rainsim.water.paper_flow import PaperFlow
from rainsim.water.series import rain_pieces
from rainsim.water.sources import DRY_DEPTH, Sources, sum_tiles
from rainsim.water.water_report import WaterReport

MAX_SPEED = 1000.0  # m/s, no water on the ground is as fast: the run has diverged
QUIET_FALL = 0.5  # cells that water may fall from rest in the first step that moves it
SOURCE_PERIOD = 0.02  # s, rain and losses of shorter steps are booked together
SAME_END = 1e-12  # relative, within which a call ends where one that was stopped would have
DECIDE_EVERY = 8  # calls of `advance`, between two looks of "auto" at the water


def span_of_call(planned, time, end):
    """Return the times [s] from which and to which a call of `advance` goes.

    They are those of the call before, `planned`, if that was stopped at `time` and had this `end`.
    """
    stopped = planned[1] > time and math.isclose(planned[1], end, rel_tol=SAME_END)
    return planned if stopped else (time, end)


class WaterSolver:
    """Shallow water over a height field, in SI units.

    Parameters
    ----------
    bed : array_like of shape (ny, nx) [m]
        Ground height; row 0 is south, column 0 is west.
    spacing : float [m]
        Side of a cell.
    scheme : {"auto", "accurate", "lean", "paper"}
        "accurate" conserves momentum to second order, linear waves to fourth; "lean" is its first
        order; "paper" is the staggered scheme of RainyGS; "auto" decides from the state. See
        `rainsim.water.conserving`, `rainsim.water.paper` and `rainsim.water.choose`.
    boundary : {"wall", "open"} or dict
        One for all edges, or by edge: west, east, south, north (edges left out are walls). Water
        leaves through an open edge at the speed that it has just inside; none comes in.
    manning : float or array_like of shape (ny, nx) [s m^(-1/3)]
        Manning's roughness. There is no friction unless it or the viscosity is given.
    kinematic_viscosity : float [m2/s]
        Drag of a laminar film, 3 nu u / h^2; 0 is none. Not for "paper".
    gravity : float [m/s2]
    courant : float, optional
        Cells crossed per step by the fastest wave, at most 0.7 (0.5 for "paper"). By default
        0.4 ("accurate"), 0.6 ("lean"), 0.5 ("paper"); "auto" takes 0.35 at fronts, else 0.6.
    storage : float or array_like of shape (ny, nx) [m]
        Depth of the film that a cell holds back; only water above it flows.
    infiltration : float or array_like of shape (ny, nx), optional [m/s]
        Rate at which the ground takes water, as long as there is some.
    drains : list of (row, column, rate [m3/s]), optional
        Cells that lose water at up to that rate.
    dtype : numpy.float32 or numpy.float64
        Type of the fields. Volumes are float64 either way.
    conditions : list of Stage, Discharge or Rating, optional
        Given levels, discharges and rating curves on parts of edges that are walls.

    Attributes
    ----------
    flow : ConservingFlow or PaperFlow
        Owner of depth and velocity, with `flow.pad` rings of ghost cells around the map.
    sources : Sources
        Owner of the rain, the films, and what ground and drains take.
    conditions : list
        Each with the `volume` [m3] that came in through it and the `flow` [m3/s] of the last step.

    Notes
    -----
    The ledger closes to float64 rounding for both types: the part of a depth that a float32 cannot
    represent is kept beside it. Only drops given to `deposit` are rounded to the fields' type,
    once. Of "lean" in float32 1e-8 of the volume was seen to go in a second; at rates of .001 mm/h
    the residual is 2e-4 of the rain. Take float64 where that counts.

    Examples
    --------
    >>> bed = np.zeros((16, 32))
    >>> solver = rainsim.WaterSolver(bed, spacing=0.1)
    >>> solver.set_state(np.where(np.arange(32) < 16, 0.2, 0.0) + bed)  # a dam that breaks
    >>> report = solver.advance(0.5)
    >>> bool(solver.depth[8, 20] > 0), abs(solver.ledger.residual) < 1e-9
    (True, True)
    """

    def __init__(
        self,
        bed,
        spacing,
        scheme="auto",
        boundary="wall",
        manning=0.0,
        kinematic_viscosity=0.0,
        gravity=GRAVITY,
        courant=None,
        storage=0.0,
        infiltration=None,
        drains=None,
        dtype=np.float32,
        conditions=None,
    ):
        bed = inputs.require_bed(bed)
        self.shape = bed.shape
        self.spacing = errors.require_positive("spacing", spacing, "m")
        self.gravity = errors.require_positive("gravity", gravity, "m/s2")
        self._asked_scheme = errors.require_choice("scheme", scheme, SCHEMES)
        self._asked_courant = inputs.require_courant(courant, MAX_COURANT[scheme])
        dtype = inputs.require_dtype(dtype)
        viscosity = errors.require_not_negative("kinematic_viscosity", kinematic_viscosity, "m2/s")
        storage = inputs.field("storage", storage, self.shape).astype(dtype)
        infiltration = inputs.field(
            "infiltration", 0.0 if infiltration is None else infiltration, self.shape
        ).astype(dtype)
        drains = inputs.require_drains(drains, self.shape)
        roughness = inputs.field("manning", manning, self.shape, most=inputs.MOST_MANNING) ** 2
        roughness = roughness.astype(dtype)
        roughness = roughness if roughness.any() else None
        # Levels are compared, so the height of the map itself must not cost digits.
        self._height = float(bed.mean())
        level_bed = (bed + storage - self._height).astype(dtype)
        common = (
            level_bed,
            self.spacing,
            self.gravity,
            inputs.open_edges(boundary),
            roughness,
            DRY_DEPTH,
        )
        if scheme == "paper":
            inputs.refuse_viscosity(viscosity)
            self.flow = PaperFlow(*common)
        else:
            self.flow = (LeanFlow if scheme == "lean" else AccurateFlow)(*common, viscosity)
        self.conditions = place_all(conditions, bed, self.flow.pad, self.flow.is_open)
        self.sources = Sources(self.flow, self.spacing**2, storage, infiltration, drains)
        self.set_state(0.0)

    # -- state ---------------------------------------------------------------------------------

    @one_caller
    def set_state(self, depth, u=None, v=None):
        """Set depth and velocity, and open a new ledger at time 0.

        Parameters
        ----------
        depth : float or array_like of shape (ny, nx) [m]
            Depth above the bed, film included.
        u, v : float or array_like of shape (ny, nx), optional [m/s]
            Velocity at cell centres. A face takes the mean of its wet neighbours; closed faces
            are 0.
        """
        depth = inputs.field("depth", depth, self.shape)
        u = inputs.field("u", 0.0 if u is None else u, self.shape, signed=True)
        v = inputs.field("v", 0.0 if v is None else v, self.shape, signed=True)
        flow, inner, film = self.flow, self.flow.inner, self.sources.film[self.flow.inner]
        h, remainder, bed = flow.water.h[inner], flow.water.remainder[inner], flow.bed[inner]
        film[:] = np.minimum(depth, self.sources.storage[inner])
        free = depth - film
        del depth  # maps of millions of cells are let go as soon as they may
        h[:] = np.where(free >= DRY_DEPTH, free, 0.0)
        remainder[:] = free - h
        del free
        u = inputs.mean_at_faces(u, h, bed, DRY_DEPTH, axis=1).astype(h.dtype)
        flow.start(u, inputs.mean_at_faces(v, h, bed, DRY_DEPTH, axis=0))
        self._advances, self._planned = 0, (0.0, 0.0)
        self._has_deposits = False  # drops that no step has taken in yet
        self.settled = False  # whether a step has shown that pressure moves nothing
        self._choose_scheme()
        self.time = self.sources.unbooked_time = 0.0
        for condition in self.conditions:
            condition.reset()
        self._ledger = Ledger()
        self._book_standing_water()
        self._ledger.initial = self._ledger.ground + self._ledger.film

    @property
    def depth(self):
        """Depth above the bed, film included, ndarray of shape (ny, nx) [m]; a copy."""
        water, inner = self.flow.water, self.flow.inner
        return self.sources.film[inner] + (water.h[inner] + water.remainder[inner])

    @property
    def velocity(self):
        """Velocity (u, v) at cell centres, two ndarrays of shape (ny, nx) [m/s]; copies."""
        wet, (u, v) = self.flow.water.h[self.flow.inner] > 0, self.flow.faces()
        half, rest = u.dtype.type(0.5), u.dtype.type(0)
        across = np.where(wet, half * (u[:, :-1] + u[:, 1:]), rest)
        return across, np.where(wet, half * (v[:-1] + v[1:]), rest)

    @property
    def ledger(self):
        """The account so far, a copy of the `Ledger`."""
        return replace(self._ledger)

    def discharge(self, edge):
        """Return the flow that leaves through `edge` now [m3/s]."""
        errors.require_choice("edge", edge, inputs.EDGES)
        return self.flow.leaving(edge) * self.spacing

    def deposit(self, rows, columns, volumes):
        """Add drops: `volumes` [m3] into the cells (`rows`, `columns`), arrays of one length.

        The next `advance` takes them in.
        """
        rows, columns, volumes = np.atleast_1d(rows), np.atleast_1d(columns), np.atleast_1d(volumes)
        inputs.require_drops(rows, columns, volumes, self.shape)
        if not len(rows):
            return
        # Rounded once in the sum of a cell, not once for each of its drops.
        remainder, pad = self.flow.water.remainder, self.flow.pad
        cells = (rows + pad) * remainder.shape[1] + columns + pad
        cells, which = np.unique(cells, return_inverse=True)
        depth = np.bincount(which, np.asarray(volumes, np.float64)) / self.spacing**2
        remainder.reshape(-1)[cells] += depth.astype(remainder.dtype)
        self._ledger.rain += float(volumes.sum(dtype=np.float64))
        self._has_deposits = True

    def withdraw(self, rows, columns, volumes):
        """Drain up to `volumes` [m3] of free water from cells, none of them named twice."""
        inputs.require_drops(rows, columns, volumes, self.shape)
        if len(rows):
            self._ledger.drained += self.sources.drain(rows, columns, np.asarray(volumes))
            self._has_deposits = True

    # -- time ----------------------------------------------------------------------------------

    @one_caller
    def advance(self, duration, rain=0.0, progress=None):
        """Advance by `duration` [s] under `rain` (a rate [m/s], a map of rates or a `Series`).

        Parameters
        ----------
        duration : float [s]
        rain : float, array_like of shape (ny, nx) or Series [m/s]
        progress : callable, optional
            Called with the time [s] after each step. Where it returns False the solver stops; the
            time of the report says where, and the next call goes on from there: to the same bytes
            as if it had not stopped, if it has the same end and the same rain.

        Returns
        -------
        WaterReport

        Raises
        ------
        DivergedError
            If the state is no longer finite or flows faster than water can.
        """
        end = self.time + errors.require_not_negative("duration", duration, "s")
        self._take_in()
        begin, end = span_of_call(self._planned, self.time, end)
        if end > self.time and (begin, end) != self._planned:
            self._planned = begin, end
            self._advances += 1
            if self.flow.moves and self._advances % DECIDE_EVERY == 0:
                self._choose_scheme()
        substeps = 0
        for stop, rate in rain_pieces(rain, begin, end):
            if stop <= self.time < end:
                continue
            if self.sources.unbooked_time > 0.0 and not self.sources.is_rain(rate):
                self._apply_sources(self.sources.unbooked_time)
                self.sources.unbooked_time = 0.0
            self.sources.set_rain(rate)
            taken, goes_on = self._advance_to(stop, progress)
            substeps += taken
            if not goes_on:
                break
        self._book_standing_water()
        return self._report(substeps)

    def _take_in(self):
        """Give deposited drops to film and water."""
        if self._has_deposits:
            self._apply_sources(0.0)
            self.flow.refresh()
            self._has_deposits, self.settled = False, False

    def _advance_to(self, end, progress):
        """Step to the time `end` [s]; return the steps taken and whether it was reached."""
        substeps = 0
        while end > self.time:
            if self._is_at_rest():
                self.time = end
                break
            left = end - self.time
            steps = max(1, math.ceil(left / self._stable_step(left)))
            self._step(left / steps, last=steps == 1)
            substeps += 1
            self.time = end if steps == 1 else self.time + left / steps
            self._require_possible_speed()
            if progress is not None and progress(self.time) is False:
                return substeps, False
        return substeps, True

    def _is_at_rest(self):
        """Whether a step would change no number."""
        waits = self.flow.moves or not self.settled or self.conditions
        return not waits and self.sources.are_idle()

    def _stable_step(self, left):
        """Longest step [s] that the waves, the flow and the rain of the step itself allow."""
        dt = min(left, self.flow.stable_step(self.courant))
        if self.sources.rain_sum > 0.0:
            # On dry ground the wave speed is that of the rain of the step, sqrt(g rain dt).
            rate = self.gravity * self.sources.most_rain()
            dt = min(dt, (self.courant * self.spacing) ** (2 / 3) / rate ** (1 / 3))
        if not self.flow.moves and (self.sources.rain_sum > 0.0 or self.conditions):
            dt = min(dt, math.sqrt(QUIET_FALL * self.spacing / self.gravity))
        return longest_step(self, dt)

    def _step(self, dt, last):
        """Advance depth, sources and velocity by `dt` [s]; see the module's docstring."""
        let_in(self, self.time, self.time + dt)
        self._ledger.outflow += self.flow.advance_depth(dt)  # h at n+1
        if self.conditions:
            came, left = apply_conditions(self, self.time, self.time + dt, DRY_DEPTH)
            self._ledger.inflow, self._ledger.outflow = (
                self._ledger.inflow + came, self._ledger.outflow + left
            )  # fmt: skip
        sources = self.sources
        if sources.rain_sum > 0.0 or sources.has_storage or sources.has_losses:
            sources.unbooked_time += dt
            if last or sources.unbooked_time >= SOURCE_PERIOD:
                self._apply_sources(sources.unbooked_time)
                sources.unbooked_time = 0.0
        self.flow.advance_velocity(dt)  # u, v at n+3/2 ("paper": n+1)
        self.settled = True

    def _apply_sources(self, dt):
        """Apply the sources of `dt` [s], everywhere if drops were deposited."""
        self.sources.apply(self._ledger, dt, self._has_deposits)

    @property
    def choice(self):
        """Scheme and Courant number of the present state, and why, as a sentence."""
        return f"water: scheme {self.scheme}, Courant number {self.courant:g} ({self.reason})"

    def _choose_scheme(self):
        """Choose scheme and Courant number, "auto" from the state."""
        h, bed = self.flow.water.h[self.flow.inner], self.flow.bed[self.flow.inner]
        self.scheme, courant, self.reason = choose(self._asked_scheme, h, bed)
        self.courant = courant if self._asked_courant is None else self._asked_courant

    # -- file ----------------------------------------------------------------------------------

    def save(self, path):
        """Write the whole state to a file (.npz), from which `load` goes on to the same bytes."""
        write_solver(path, self._made_of(), self._saved())

    @one_caller
    def load(self, path):
        """Take the state that `save` wrote; this solver must be made as that one was."""
        self._restore(read_solver(path, self._made_of(), self._saved()))

    def _restore(self, found):
        """Take over the arrays that `_saved` returned."""
        self.flow.restore(found)
        self.sources.restore(found)
        self.time, self.sources.unbooked_time, advances, *whether, self.courant, begin, end = (
            found["times"].tolist()
        )  # fmt: skip
        self._planned = begin, end
        self._advances, (self._has_deposits, self.settled) = int(advances), map(bool, whether)
        for condition, numbers in zip(self.conditions, found["volumes"].tolist(), strict=True):
            condition.volume, condition.flow = numbers
        ends = np.cumsum([len(condition.rows) for condition in self.conditions])
        for condition, rises in zip(
            self.conditions, np.split(found["rises"], ends)[:-1], strict=True
        ):
            condition.rises = rises
        self.scheme, self.reason = json.loads(str(found["choice"]))
        self._ledger = Ledger(*found["account"].tolist())
        self._book_standing_water()

    def _saved(self):
        """Return the arrays that make up the state, by name."""
        times = (
            self.time, self.sources.unbooked_time, self._advances, self._has_deposits,
            self.settled, self.courant, *self._planned,
        )  # fmt: skip
        volumes = [[condition.volume, condition.flow] for condition in self.conditions]
        return {
            **self.flow.saved(), "film": self.sources.film, "rain": self.sources.rain,
            "rises": np.concatenate([np.zeros(0), *(c.rises for c in self.conditions)]),
            "times": np.array(times, np.float64),
            "volumes": np.array(volumes, np.float64).reshape(-1, 2),
            "account": np.array(astuple(self._ledger)),
            "choice": np.array(json.dumps([self.scheme, self.reason])),
        }  # fmt: skip

    def _made_of(self):
        """Return what the solver was made of, as a text."""
        bed, roughness, sources = self.flow.bed, self.flow.roughness, self.sources
        rough = () if roughness is None else (roughness,)
        kept = {
            "scheme": self._asked_scheme, "spacing": self.spacing, "gravity": self.gravity,
            "type": bed.dtype.name, "height": self._height, "courant": self._asked_courant,
            "ground": digest(bed, sources.storage, sources.infiltration, *sources.drains, *rough),
            "conditions": [[type(c).__name__, c.edge, len(c.rows)] for c in self.conditions],
        }  # fmt: skip
        return json.dumps(kept, sort_keys=True)

    # -- account -------------------------------------------------------------------------------

    def _book_standing_water(self):
        """Write the water on the ground and in its film [m3] into the ledger."""
        area, water, tiles = self.spacing**2, self.flow.water, self.flow.tiles(True)
        self._standing = np.empty((3, len(tiles)))  # see `sum_tiles`
        sum_tiles(tiles, water.h, water.remainder, self.sources.film, *self._standing)
        self._ledger.ground = float(self._standing[0].sum()) * area
        self._ledger.film = float(self._standing[1].sum()) * area

    def _require_possible_speed(self):
        if not self.flow.wave_speed <= MAX_SPEED:  # catches NaN too
            raise errors.DivergedError(
                f"the water reached {self.flow.largest_speed():.3g} m/s at {self.time:.6g} s; no "
                f"water on the ground is that fast; use a smaller courant than {self.courant:g}"
            )

    def _report(self, substeps):
        if not math.isfinite(self._ledger.ground):
            raise errors.DivergedError(
                f"the water depth is not finite at {self.time:.6g} s; use a smaller courant than "
                f"{self.courant:g}"
            )
        return WaterReport(
            time=self.time,
            substeps=substeps,
            scheme=self.scheme,
            reason=self.reason,
            ledger=self.ledger,
            residual=self._ledger.residual,
            max_speed=self.flow.water_speed,
            min_depth=float(self._standing[2].min()),
        )
