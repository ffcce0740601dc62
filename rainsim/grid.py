"""The water solver: checks what comes in, keeps the account of the water, names the phases."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rainsim.errors import (
    DivergedError,
    ParameterError,
    require_choice,
    require_not_negative,
    require_positive,
)
from rainsim.grid.choose import MAX_COURANT, SCHEMES, choose
from rainsim.grid.conserving_flow import ConservingFlow
from rainsim.grid.inputs import (
    EDGES,
    field,
    horton,
    open_edges,
    require_bed,
    require_courant,
    require_drains,
    require_drops,
    require_dtype,
    require_inflow,
)
from rainsim.grid.paper_flow import PaperFlow
from rainsim.grid.sources import drawn_off, soak, tally
from rainsim.ledger import Ledger

DRY_DEPTH = 1e-6  # m, below this water does not flow (RainyGS supplement, step 2)
REST_ROUNDINGS = {"paper": 2}  # rounding units of bed and depth within which levels are equal
MAX_SPEED = 1000.0  # m/s, no water on the ground is as fast: the run has diverged
SOURCE_PERIOD = 0.02  # s, rain and losses of shorter steps are booked together
DECIDE_EVERY = 8  # calls of `advance`, between two looks of "auto" at the water
QUIET_FALL = 0.5  # cells that water may fall from rest in the first step that moves it


@dataclass(frozen=True, slots=True)
class WaterReport:
    """What `WaterSolver.advance` did.

    Attributes
    ----------
    time : float [s]
        Since the state was set.
    substeps : int
        Steps taken; 0 if nothing moved and nothing was added.
    scheme : str
        Scheme that ran.
    reason : str
        Why this scheme.
    ledger : Ledger
        Volumes [m3] since the state was set; a copy.
    residual : float
        The ledger's residual, relative to the water supplied.
    max_speed : float [m/s]
        Largest face speed at the end.
    min_depth : float [m]
        Smallest depth at the end.
    """

    time: float
    substeps: int
    scheme: str
    reason: str
    ledger: Ledger
    residual: float
    max_speed: float
    min_depth: float


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
        order; "paper" is the staggered scheme of RainyGS; "auto" decides from what it sees. See
        `rainsim.grid.conserving`, `rainsim.grid.paper` and `rainsim.grid.choose`.
    boundary : {"wall", "open"} or dict
        One for all edges, or by edge: west, east, south, north (those left out are walls). Water
        leaves through an open edge at the speed that it has just inside; none comes in.
    manning : float or array_like of shape (ny, nx) [s m^(-1/3)]
        Manning's roughness; 0 is no friction.
    kinematic_viscosity : float [m2/s]
        Drag of a laminar film, 3 nu u / h^2; 0 is none. Not for "paper".
    gravity : float [m/s2]
    courant : float, optional
        Cells crossed per step by the fastest wave, at most 0.7 (0.5 for "paper"). By default
        0.4 ("accurate"), 0.6 ("lean"), 0.5 ("paper"); "auto" takes 0.35 at fronts, else 0.6.
    storage : float or array_like of shape (ny, nx) [m]
        Depth that a cell holds back; only water above it flows.
    infiltration : float, array_like of shape (ny, nx) or Horton, optional [m/s]
        Rate at which the ground takes water, as long as there is some.
    drains : list of (row, column, rate [m3/s]), optional
        Cells that lose water at up to that rate.
    evaporation : float or array_like of shape (ny, nx) [m/s]
        Rate at which water, then film, evaporates.
    inflow : dict, optional
        Discharge [m3/s] by edge, spread evenly along it; the edge's boundary is "wall". Not for
        "paper".
    dtype : numpy.float32 or numpy.float64
        Type of the fields. Volumes are float64 either way.

    Notes
    -----
    The ledger closes to float64 rounding for both types: what a depth cannot represent is kept
    beside it. Only drops given to `deposit` are rounded to the fields' type, once.
    """

    def __init__(
        self,
        bed,
        spacing,
        scheme="auto",
        boundary="wall",
        manning=0.0,
        kinematic_viscosity=0.0,
        gravity=9.81,
        courant=None,
        storage=0.0,
        infiltration=None,
        drains=None,
        evaporation=0.0,
        inflow=None,
        dtype=np.float32,
    ):
        bed = require_bed(bed)
        self.shape = bed.shape
        self.spacing = require_positive("spacing", spacing, "m")
        self._asked = require_choice("scheme", scheme, SCHEMES)
        self.gravity = require_positive("gravity", gravity, "m/s2")
        self._courant = require_courant(courant, MAX_COURANT[scheme])
        self._type = require_dtype(dtype)
        viscosity = require_not_negative("kinematic_viscosity", kinematic_viscosity, "m2/s")
        is_open = open_edges(boundary)
        inflow = require_inflow(inflow, is_open)
        storage = field("storage", storage, self.shape)
        self._horton = horton(infiltration, self.shape)
        self._drains = require_drains(drains, self.shape)
        evaporation = field("evaporation", evaporation, self.shape)
        manning = field("manning", manning, self.shape)
        rough = (manning**2).astype(self._type) if manning.any() else None
        # Levels are compared, so the height of the map itself must not cost digits.
        level_bed = (bed + storage.astype(self._type) - bed.mean()).astype(self._type)
        rest = self._type(REST_ROUNDINGS.get(scheme, 1) * np.finfo(self._type).eps)
        common = level_bed, self.spacing, self.gravity, is_open
        if scheme == "paper":
            _refuse_in_paper(kinematic_viscosity=viscosity, inflow=inflow)
            self._flow = PaperFlow(*common, rough, rest, self._type(DRY_DEPTH))
        else:
            numbers = rest, self._type(DRY_DEPTH), scheme == "lean"
            self._flow = ConservingFlow(*common, inflow, rough, viscosity, *numbers)
        self._inner = self._flow.inner if self._flow.pad else np.s_[:, :]
        self._storage, self._evaporation = self._framed(storage), self._framed(evaporation)
        self._infiltration = self._framed(self._horton.rate(0.0))
        self._film, self._rain = self._framed(0.0), self._framed(0.0)
        self._lost = np.zeros(len(self._flow.tiles(True)))
        self._stands = np.zeros((3, len(self._lost)))  # water, film and least depth of each tile
        self._rain_set, self._rain_sum = 0.0, 0.0
        self._stores = bool(storage.any())
        self._drinks = bool(np.any(self._horton.first) or np.any(self._horton.last))
        self._wanes = bool(np.any(self._horton.first != self._horton.last))
        self._dries = bool(evaporation.any())
        self.set_state(0.0)

    def _framed(self, values):
        """Return a map of the fields' type with the flow's ghost cells, zero there, around it."""
        full = np.zeros(self._flow.h.shape, self._type)
        full[self._inner] = values
        return full

    # -- state ---------------------------------------------------------------------------------

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
        depth = field("depth", depth, self.shape)
        u = field("u", 0.0 if u is None else u, self.shape, signed=True)
        v = field("v", 0.0 if v is None else v, self.shape, signed=True)
        flow, inner = self._flow, self._inner
        self._film[inner] = np.minimum(depth, self._storage[inner])
        free = depth - self._film[inner]
        flow.h[inner] = np.where(free >= DRY_DEPTH, free, 0.0)
        flow.damp[inner] = free - flow.h[inner]
        h, bed = flow.h[inner], flow.bed[inner]
        flow.start(_face_mean(u, h, bed, axis=1), _face_mean(v, h, bed, axis=0))
        self._advances = 0
        self._added, self._settled = False, False  # drops to take in; pressure seen and at rest
        self._decide()
        self.time = self._owed = 0.0
        self._ledger = Ledger()
        self._book_stores()
        self._ledger.initial = self._ledger.ground + self._ledger.film

    @property
    def depth(self):
        """Depth above the bed, film included, ndarray of shape (ny, nx) [m]; a copy."""
        flow, inner = self._flow, self._inner
        return self._film[inner] + (flow.h[inner] + flow.damp[inner])

    @property
    def velocity(self):
        """Velocity (u, v) at cell centres, two ndarrays of shape (ny, nx) [m/s]; copies."""
        wet = self._flow.h[self._inner] > 0
        half, (u, v) = self._type(0.5), self._flow.faces()
        across = np.where(wet, half * (u[:, :-1] + u[:, 1:]), self._type(0))
        return across, np.where(wet, half * (v[:-1] + v[1:]), self._type(0))

    @property
    def ledger(self):
        """The account so far, a copy of the `Ledger`."""
        return replace(self._ledger)

    def discharge(self, edge):
        """Return the flow that leaves through `edge` now [m3/s]; negative where water comes in."""
        require_choice("edge", edge, EDGES)
        (u, v), h = self._flow.faces(), self._flow.h[self._inner]
        speed, h = {
            "west": (-u[:, 0], h[:, 0]), "east": (u[:, -1], h[:, -1]),
            "south": (-v[0], h[0]), "north": (v[-1], h[-1]),
        }[edge]  # fmt: skip
        return float((speed.astype(np.float64) * h).sum()) * self.spacing

    def deposit(self, rows, columns, volumes):
        """Add drops: `volumes` [m3] into the cells (`rows`, `columns`), arrays of one length."""
        rows, columns, volumes = np.atleast_1d(rows), np.atleast_1d(columns), np.atleast_1d(volumes)
        require_drops(rows, columns, volumes, self.shape)
        if not len(rows):
            return
        # Rounded once in the sum of a cell, not once for each of its drops.
        width, pad = self._film.shape[1], self._flow.pad
        cells, which = np.unique((rows + pad) * width + columns + pad, return_inverse=True)
        depth = np.bincount(which, np.asarray(volumes, np.float64)) / self.spacing**2
        self._flow.damp.reshape(-1)[cells] += depth.astype(self._type)
        self._ledger.rain += float(volumes.sum(dtype=np.float64))
        self._added = True

    def withdraw(self, rows, columns, volumes):
        """Drain up to `volumes` [m3] of free water from cells, none of them named twice."""
        require_drops(rows, columns, volumes, self.shape)
        if not len(rows):
            return
        flow, area = self._flow, self.spacing**2
        at = np.asarray(rows) + flow.pad, np.asarray(columns) + flow.pad
        depth = np.asarray(volumes) / area
        flow.h[at], flow.damp[at], taken = drawn_off(flow.h[at], flow.damp[at], depth, DRY_DEPTH)
        self._ledger.drained += taken * area
        self._added = True

    # -- time ----------------------------------------------------------------------------------

    def advance(self, duration, rain=0.0):
        """Advance by `duration` [s] under `rain` (a rate [m/s] or a map of rates).

        Returns
        -------
        WaterReport

        Raises
        ------
        DivergedError
            If the state is no longer finite or flows faster than water can.
        """
        end = self.time + require_not_negative("duration", duration, "s")
        rain_sum = self._set_rain(rain)
        substeps = 0
        if self._added:
            self._take_in(0.0, 0.0)
            self._flow.refresh()
            self._added, self._settled = False, False
        self._advances += 1
        if self._flow.moves and self._advances % DECIDE_EVERY == 0:
            self._decide()
        while end > self.time:
            waits = self._settled and not self._flow.moves
            if waits and not (rain_sum > 0.0 or (self._loses() and self._holds_water())):
                self.time = end  # a step would change no number
                break
            left = end - self.time
            steps = max(1, math.ceil(left / self._stable_step(left, rain_sum)))
            self._substep(left / steps, rain_sum, last=steps == 1)
            substeps += 1
            self.time = end if steps == 1 else self.time + left / steps
            self._require_sane()
        self._book_stores()
        return self._report(substeps)

    def _substep(self, dt, rain_sum, last):
        left, entered = self._flow.flow(dt)  # h at n+1
        self._ledger.outflow += left
        self._ledger.inflow += entered
        if rain_sum > 0.0 or self._stores or self._loses():
            self._owed += dt
            if last or self._owed >= SOURCE_PERIOD:
                self._take_in(self._owed, rain_sum)
                self._owed = 0.0
        self._flow.turn(dt)  # velocity after h at n+1
        self._settled = True

    def _loses(self):
        return bool(self._drinks or self._dries or len(self._drains[0]))

    def _take_in(self, dt, rain_sum):
        """Give the waiting drops and the rain of `dt` to the ground, the film and the water."""
        flow, ledger, area = self._flow, self._ledger, self.spacing**2
        if self._wanes:
            self._infiltration[self._inner] = self._horton.rate(self.time)
        # Without rain and losses only water that moves can still fill films.
        everywhere = rain_sum > 0.0 or self._loses() or self._added
        tiles = flow.tiles(everywhere)
        lost = self._lost[: len(tiles)]
        water = flow.h, flow.damp, self._film, lost
        soak(tiles, self._rain, self._infiltration, self._storage, dt, DRY_DEPTH, *water)
        ledger.rain += rain_sum * dt * area
        ledger.infiltrated += float(lost.sum()) * area
        if self._dries:
            nothing = np.zeros_like(self._rain)
            soak(tiles, nothing, self._evaporation, self._storage, dt, DRY_DEPTH, *water)
            ledger.evaporated += float(lost.sum()) * area
        if len(self._drains[0]):
            ledger.drained += self._drain(dt) * area
        flow.touched(everywhere)

    def _drain(self, dt):
        """Let the drains take what they can in `dt`; return the depth taken [m]."""
        taken = 0.0
        for row, column, rate in zip(*self._drains, strict=True):
            j, i = row + self._flow.pad, column + self._flow.pad
            free = float(self._flow.h[j, i]) + float(self._flow.damp[j, i])
            stays = free - min(rate * dt / self.spacing**2, free)
            self._flow.h[j, i] = stays if stays >= DRY_DEPTH else 0.0
            self._flow.damp[j, i] = stays - float(self._flow.h[j, i])
            taken += free - float(self._flow.h[j, i]) - float(self._flow.damp[j, i])
        return taken

    def _stable_step(self, left, rain_sum):
        """Longest step that the waves, the flow and the rain of the step itself allow."""
        dt = min(left, self._flow.stable_step(self.courant))
        if rain_sum > 0.0:
            # On dry ground the wave speed is that of the rain of the step, sqrt(g rain dt).
            rate = self.gravity * float(self._rain.max())
            dt = min(dt, (self.courant * self.spacing) ** (2 / 3) / rate ** (1 / 3))
            if not self._flow.moves:
                dt = min(dt, math.sqrt(QUIET_FALL * self.spacing / self.gravity))
        return dt

    def _decide(self):
        """Choose scheme and Courant number, "auto" from the state."""
        h, bed = self._flow.h[self._inner], self._flow.bed[self._inner]
        self.scheme, courant, self.reason = choose(self._asked, h, bed)
        self.courant = courant if self._courant is None else self._courant

    def _set_rain(self, rain):
        """Fill the map of rain rates and return its sum over the cells [m/s]."""
        if np.ndim(rain) > 0 or rain != self._rain_set:
            self._rain[self._inner] = field("rain", rain, self.shape)
            self._rain_sum = float(self._rain.sum(dtype=np.float64))
            self._rain_set = rain if np.ndim(rain) == 0 else None
        return self._rain_sum

    def _holds_water(self):
        flow = self._flow
        return bool(flow.h.any() or flow.damp.any() or self._film.any())

    def _book_stores(self):
        """Bring the account of what stands on the map up to date, tile by tile."""
        area, flow = self.spacing**2, self._flow
        which = flow.changed()
        sums = np.empty((3, len(which)))
        tally(flow.tiles(True)[which], flow.h, flow.damp, self._film, *sums)
        self._stands[:, which] = sums
        self._ledger.ground = float(self._stands[0].sum()) * area
        self._ledger.film = float(self._stands[1].sum()) * area

    def _require_sane(self):
        if not self._flow.reach <= MAX_SPEED:  # catches NaN too
            raise DivergedError(
                f"the water reached {self._flow.fastest():.3g} m/s at {self.time:.6g} s; no water "
                f"on the ground is that fast; use a smaller courant than {self.courant:g}"
            )

    def _report(self, substeps):
        if not math.isfinite(self._ledger.ground):
            raise DivergedError(
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
            max_speed=self._flow.swift,
            min_depth=float(self._stands[2].min()),
        )


def _refuse_in_paper(**given):
    for name, value in given.items():
        if value:
            raise ParameterError(
                f'{name} is {value}, which scheme "paper" does not have; use "accurate"'
            )


def _face_mean(values, h, bed, axis):
    """Mean of the wet neighbours of each inner face along `axis`; 0 at closed faces."""
    before, after = [slice(None)] * 2, [slice(None)] * 2
    before[axis], after[axis] = slice(None, -1), slice(1, None)
    before, after = tuple(before), tuple(after)
    wet = (h > 0).astype(np.float64)
    count = wet[before] + wet[after]
    mean = (wet[before] * values[before] + wet[after] * values[after]) / np.maximum(count, 1)
    level = bed + h
    walled = (h[before] <= 0) & (bed[before] + DRY_DEPTH >= level[after])
    walled |= (h[after] <= 0) & (bed[after] + DRY_DEPTH >= level[before])
    return np.where(walled, 0.0, mean)
