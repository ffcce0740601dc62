"""The water solver: owns the fields of the MAC grid, checks what comes in, names the phases."""

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
from rainsim.grid.paper import BLOCK, extrapolate, flow, push, push_rough
from rainsim.grid.sources import soak
from rainsim.ledger import Ledger

SCHEMES = ("auto", "paper")
BOUNDARIES = ("wall", "open")
EDGES = ("west", "east", "south", "north")

COURANT = 0.5  # cells that the fastest wave or twice the flow crosses in a step
MAX_COURANT = 0.5  # above, a cell could give more than it holds through its four faces
ROUNDING_ROOM = 1 - 1e-6  # of a step, so that float32 factors keep that promise too
DRY_DEPTH = 1e-6  # m, below this water does not flow (RainyGS supplement, step 2)
CAP = 0.5  # cells per step, the most a face may be sped up to (Chentanez and Mueller 2010)
REST_ROUNDINGS = 2  # rounding units of bed and depth within which two levels are equal
MAX_SPEED = 1000.0  # m/s, no water on the ground is as fast: the run has diverged
MIN_CELLS = 2  # per side, so that there is a face between two cells


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
    scheme : {"auto", "paper"}
        "paper" is the staggered scheme of RainyGS (see `rainsim.grid.paper`); "auto" decides.
    boundary : {"wall", "open"} or dict
        One for all edges, or by edge: west, east, south, north (those left out are walls). Water
        leaves through an open edge at the speed that it has just inside; none comes in.
    manning : float or array_like of shape (ny, nx) [s m^(-1/3)]
        Manning's roughness; 0 is no friction.
    gravity : float [m/s2]
    courant : float, optional
        Cells crossed per step by the fastest wave, at most 0.5, the default.
    storage : float or array_like of shape (ny, nx) [m]
        Depth that a cell holds back; only water above it flows.
    infiltration : float or array_like of shape (ny, nx), optional [m/s]
        Rate at which the ground takes water, as long as there is some.
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
        gravity=9.81,
        courant=None,
        storage=0.0,
        infiltration=None,
        dtype=np.float32,
    ):
        bed = _require_bed(bed)
        self.shape = bed.shape
        self.spacing = require_positive("spacing", spacing, "m")
        self.scheme, self.reason = _choose_scheme(scheme)
        self.gravity = require_positive("gravity", gravity, "m/s2")
        self.courant = _require_courant(courant)
        self._open = _open_edges(boundary)
        self._type = _require_dtype(dtype)

        manning = _field("manning", manning, self.shape)
        storage = _field("storage", storage, self.shape)
        drink = _field("infiltration", 0.0 if infiltration is None else infiltration, self.shape)
        self._roughness = (manning**2).astype(self._type) if manning.any() else None
        self._storage, self._infiltration = storage.astype(self._type), drink.astype(self._type)
        self._stores, self._drinks = bool(storage.any()), bool(drink.any())
        # Levels are compared, so the height of the map itself must not cost digits.
        self._bed = (bed + self._storage - bed.mean()).astype(self._type)
        self._rest = self._type(REST_ROUNDINGS * np.finfo(self._type).eps)
        self._allocate()
        self.set_state(0.0)

    def _allocate(self):
        (ny, nx), dtype = self.shape, self._type
        self._h, self._h_spare = np.zeros((ny, nx), dtype), np.zeros((ny, nx), dtype)
        self._u, self._u_spare = np.zeros((ny, nx + 1), dtype), np.zeros((ny, nx + 1), dtype)
        self._v, self._v_spare = np.zeros((ny + 1, nx), dtype), np.zeros((ny + 1, nx), dtype)
        self._damp, self._film = np.zeros((ny, nx), dtype), np.zeros((ny, nx), dtype)
        self._rain = np.zeros((ny, nx), dtype)
        self._reaches = np.zeros((-(-ny // BLOCK), nx), dtype)
        self._row_infiltrated = np.zeros(ny)

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
        depth = _field("depth", depth, self.shape)
        u = _field("u", 0.0 if u is None else u, self.shape, signed=True)
        v = _field("v", 0.0 if v is None else v, self.shape, signed=True)
        self._film[:] = np.minimum(depth, self._storage)
        free = depth - self._film
        self._h[:] = np.where(free >= DRY_DEPTH, free, 0.0)
        self._damp[:] = free - self._h
        self._u[:, 1:-1] = _face_mean(u, self._h, self._bed, axis=1)
        self._v[1:-1] = _face_mean(v, self._h, self._bed, axis=0)
        self._set_edges()
        self._moves = bool(self._u.any() or self._v.any())
        self._speed = self._fastest()
        self._reach = self._speed + max(self._wave_speed(self._h), self._speed)
        self._added, self._settled = False, False  # drops to take in; pressure seen and at rest
        self.time = 0.0
        self._ledger = Ledger()
        self._book_stores()
        self._ledger.initial = self._ledger.ground + self._ledger.film

    @property
    def depth(self):
        """Depth above the bed, film included, ndarray of shape (ny, nx) [m]; a copy."""
        return self._film + (self._h + self._damp)

    @property
    def velocity(self):
        """Velocity (u, v) at cell centres, two ndarrays of shape (ny, nx) [m/s]; copies."""
        wet = self._h > 0
        half = self._type(0.5)
        u = np.where(wet, half * (self._u[:, :-1] + self._u[:, 1:]), self._type(0))
        v = np.where(wet, half * (self._v[:-1] + self._v[1:]), self._type(0))
        return u, v

    @property
    def ledger(self):
        """The account so far, a copy of the `Ledger`."""
        return replace(self._ledger)

    def discharge(self, edge):
        """Return the flow that leaves through `edge` now [m3/s]."""
        require_choice("edge", edge, EDGES)
        speed, h = {
            "west": (-self._u[:, 0], self._h[:, 0]),
            "east": (self._u[:, -1], self._h[:, -1]),
            "south": (-self._v[0], self._h[0]),
            "north": (self._v[-1], self._h[-1]),
        }[edge]
        return float((speed.astype(np.float64) * h).sum()) * self.spacing

    def deposit(self, rows, columns, volumes):
        """Add drops: `volumes` [m3] into the cells (`rows`, `columns`), arrays of one length."""
        rows, columns, volumes = np.atleast_1d(rows), np.atleast_1d(columns), np.atleast_1d(volumes)
        _require_drops(rows, columns, volumes, self.shape)
        if not len(rows):
            return
        # Rounded once in the sum of a cell, not once for each of its drops.
        cells, which = np.unique(rows * self.shape[1] + columns, return_inverse=True)
        depth = np.bincount(which, np.asarray(volumes, np.float64)) / self.spacing**2
        self._damp.reshape(-1)[cells] += depth.astype(self._type)
        self._ledger.rain += float(volumes.sum(dtype=np.float64))
        wave = self._wave_speed(self._h.reshape(-1)[cells] + depth)
        self._reach = max(self._reach, self._speed + max(wave, self._speed))
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
            self._added, self._settled = False, False
        while end > self.time:
            waits = self._settled and not self._moves
            if waits and not (rain_sum > 0.0 or (self._drinks and self._holds_water())):
                self.time = end  # a step would change no number
                break
            left = end - self.time
            steps = max(1, math.ceil(left / self._stable_step(left, rain_sum)))
            self._substep(left / steps, rain_sum)
            substeps += 1
            self.time = end if steps == 1 else self.time + left / steps
            self._require_sane()
        self._speed = self._fastest()
        self._book_stores()
        return self._report(substeps)

    def _substep(self, dt, rain_sum):
        dtype, k = self._type, self._type(dt / self.spacing)
        dry = dtype(DRY_DEPTH)
        kg, cap = dtype(self.gravity * dt / self.spacing), dtype(CAP * self.spacing / dt)
        old_u, old_v = self._u, self._v
        if self._moves:
            self._ledger.outflow += self._outflow() * float(k) * self.spacing
            flow(
                self._h, self._u, self._v, k, dry,
                self._damp, self._h_spare, self._u_spare, self._v_spare,
            )  # fmt: skip
            self._h, self._h_spare = self._h_spare, self._h  # h at n+1
            self._swap_velocity()  # carried, not yet pushed
        else:
            self._swap_velocity()  # pressure and friction read the velocity at n beside the new
            self._u[:] = 0
            self._v[:] = 0
        if rain_sum > 0.0 or self._stores or self._drinks:
            self._take_in(dt, rain_sum)
        scalars = cap, dtype(self.gravity), self._rest, dry
        if self._roughness is None:
            push(self._h, self._bed, kg, *scalars, self._u, self._v, self._reaches)
        else:
            drag = dtype(self.gravity * dt)
            push_rough(
                self._h, self._bed, self._roughness, old_u, old_v, kg, drag, *scalars,
                self._u, self._v, self._reaches,
            )  # fmt: skip
        self._reach = float(self._reaches.max())
        self._moves = bool(self._u.any() or self._v.any())
        self._settled = True
        if self._moves:
            extrapolate(self._h, self._u, self._v, self._u_spare, self._v_spare)
            self._swap_velocity()
        self._set_edges()  # u at n+1

    def _swap_velocity(self):
        self._u, self._u_spare = self._u_spare, self._u
        self._v, self._v_spare = self._v_spare, self._v

    def _take_in(self, dt, rain_sum):
        """Give the waiting drops and the rain of `dt` to the ground, the film and the water."""
        soak(
            self._rain, self._infiltration, self._storage, dt, DRY_DEPTH,
            self._h, self._damp, self._film, self._row_infiltrated,
        )  # fmt: skip
        area = self.spacing**2
        self._ledger.rain += rain_sum * dt * area
        self._ledger.infiltrated += float(self._row_infiltrated.sum()) * area

    def _stable_step(self, left, rain_sum):
        """Longest step that the waves, the flow and the rain of the step itself allow."""
        dt = left
        if self._reach > 0.0:
            dt = min(dt, ROUNDING_ROOM * self.courant * self.spacing / self._reach)
        if rain_sum > 0.0:
            # On dry ground the wave speed is that of the rain of the step, sqrt(g rain dt).
            rate = self.gravity * float(self._rain.max())
            dt = min(dt, (self.courant * self.spacing) ** (2 / 3) / rate ** (1 / 3))
        return dt

    def _set_rain(self, rain):
        """Fill the map of rain rates and return its sum over the cells [m/s]."""
        self._rain[:] = _field("rain", rain, self.shape)
        return float(self._rain.sum(dtype=np.float64))

    def _set_edges(self):
        """Edge faces: zero at walls, the outward part of the next face at open edges."""
        u, v, edges = self._u, self._v, self._open
        u[:, 0] = np.minimum(u[:, 1], 0) if edges["west"] else 0
        u[:, -1] = np.maximum(u[:, -2], 0) if edges["east"] else 0
        v[0] = np.minimum(v[1], 0) if edges["south"] else 0
        v[-1] = np.maximum(v[-2], 0) if edges["north"] else 0

    def _outflow(self):
        """Flow through all open edges [m3/s]."""
        return sum(self.discharge(edge) for edge in EDGES if self._open[edge])

    def _fastest(self):
        return float(max(self._u.max(), -self._u.min(), self._v.max(), -self._v.min()))

    def _wave_speed(self, h):
        return math.sqrt(self.gravity * float(h.max()))

    def _holds_water(self):
        return bool(self._h.any() or self._damp.any() or self._film.any())

    def _book_stores(self):
        area = self.spacing**2
        ground = self._h.sum(dtype=np.float64) + self._damp.sum(dtype=np.float64)
        self._ledger.ground = float(ground) * area
        self._ledger.film = float(self._film.sum(dtype=np.float64)) * area

    def _require_sane(self):
        if not self._reach <= MAX_SPEED:  # catches NaN too
            raise DivergedError(
                f"the water reached {self._fastest():.3g} m/s at {self.time:.6g} s; no water on "
                f"the ground is that fast; use a smaller courant than {self.courant:g}"
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
            max_speed=self._speed,
            min_depth=float(self.depth.min()),
        )


def _choose_scheme(name):
    """Return the scheme that runs and why."""
    require_choice("scheme", name, SCHEMES)
    if name == "auto":
        return "paper", "auto: paper is the only scheme so far"
    return name, "asked for by name"


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


def _require_bed(bed):
    bed = np.asarray(bed, np.float64)
    if bed.ndim != 2 or min(bed.shape) < MIN_CELLS:
        raise ParameterError(
            f"bed has shape {bed.shape}; it must be a map of at least {MIN_CELLS} by {MIN_CELLS} "
            "cells"
        )
    holes = int(np.count_nonzero(~np.isfinite(bed)))
    if holes:
        j, i = np.argwhere(~np.isfinite(bed))[0]
        raise ParameterError(
            f"bed is {bed[j, i]} at row {j}, column {i} ({holes} such cells); heights must be "
            "finite; fill the holes first"
        )
    return bed


def _require_courant(courant):
    if courant is None:
        return COURANT
    if require_positive("courant", courant) > MAX_COURANT:
        raise ParameterError(
            f"courant is {courant!r}; it must be at most {MAX_COURANT}; above, a cell could give "
            "more water than it holds"
        )
    return float(courant)


def _require_dtype(dtype):
    dtype = np.dtype(dtype)
    if dtype not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise ParameterError(f"dtype is {dtype}; it must be float32 or float64")
    return dtype.type


def _open_edges(boundary):
    """Return {edge: whether it is open} from one name or a dict of names."""
    if not isinstance(boundary, dict):
        boundary = dict.fromkeys(EDGES, boundary)
    for edge, kind in boundary.items():
        require_choice("boundary edge", edge, EDGES)
        require_choice(f"boundary {edge}", kind, BOUNDARIES)
    return {edge: boundary.get(edge, "wall") == "open" for edge in EDGES}


def _field(name, value, shape, signed=False):
    """Return `value` as a float64 map, or raise ParameterError naming what is wrong with it."""
    value = np.asarray(value, np.float64)
    if value.shape not in ((), shape):
        raise ParameterError(
            f"{name} has shape {value.shape}; it must be a number or of the bed's shape {shape}"
        )
    bad = ~np.isfinite(value) if signed else ~((value >= 0) & np.isfinite(value))
    if bad.any():
        rule = "finite" if signed else "finite and not negative"
        raise ParameterError(f"{name} is {value[bad].flat[0]}; it must be {rule} everywhere")
    return np.broadcast_to(value, shape)


def _require_drops(rows, columns, volumes, shape):
    if not rows.shape == columns.shape == volumes.shape or rows.ndim != 1:
        raise ParameterError(
            f"rows, columns and volumes have shapes {rows.shape}, {columns.shape} and "
            f"{volumes.shape}; they must be one-dimensional and of one length"
        )
    for name, cells, size in (("rows", rows, shape[0]), ("columns", columns, shape[1])):
        if len(cells) and (cells.dtype.kind not in "iu" or cells.min() < 0 or cells.max() >= size):
            raise ParameterError(f"{name} must be whole numbers from 0 to {size - 1}")
    if not (np.isfinite(volumes) & (volumes >= 0)).all():
        bad = volumes[~(np.isfinite(volumes) & (volumes >= 0))][0]
        raise ParameterError(f"volumes hold {bad} m3; a drop's volume must be finite, not negative")
