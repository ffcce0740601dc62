"""Shallow-water cases with exact solutions: dam breaks, bowls, a ripple, a lake, rain on a slope.

References
----------
Delestre et al. 2013, "SWASHES: a compilation of shallow water analytic solutions", Int. J. Numer.
Meth. Fluids 72: sections 3.1.1 (Stoker), 3.1.2 (Ritter), 4.2.1 and 4.2.2 (Thacker). The ripple is
the linear wave's Hankel transform; rain is the kinematic wave with Manning friction.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq
from scipy.special import j0

from rainsim.constants import GRAVITY
from rainsim.grid import WaterSolver

WALLS = "wall"
CELL_BYTES = 28  # a cell that a step reads (depth, bed, two velocities) and writes (without bed)


@dataclass(frozen=True)
class Case:
    """A water problem and its exact answer, in SI units; maps of shape (ny, nx), row 0 south.

    `extra` has what the case's own error needs: "deep" [m], water without the ripple. "supply"
    [m/s]: a map of rain that falls all the time. "rate" [m/s]: rain until "until" [s], for a
    hydrograph "flow" over "time" [s] at "gauge" [m] from the west [m2/s], or at the edge "edge"
    [m3/s]. "conditions": what makes the conditions at the edges. "u" [m/s]: velocity eastwards at
    the start. "gauges": rows and columns at which arrivals are noted, by `flood_cases.Arrivals`.
    """

    name: str
    cells: int  # along the longer side
    x: np.ndarray  # m, of the cells' centres
    bed: np.ndarray
    depth: np.ndarray  # m, at the start
    spacing: float
    duration: float
    exact: np.ndarray | None = None  # m, depth at the end; NaN in cells that do not count
    v: object = 0.0  # m/s, velocity northwards at the start
    boundary: object = WALLS  # as for `WaterSolver`
    manning: object = 0.0
    extra: dict = field(default_factory=dict)


def cell_grid(nx, ny, length, x0=0.0, y0=0.0):
    """Return x and y of the cells' centres and their side [m], of nx x ny cells."""
    spacing = length / nx
    x, y = np.meshgrid(x0 + (np.arange(nx) + 0.5) * spacing, y0 + (np.arange(ny) + 0.5) * spacing)
    return x, y, spacing


def stoker(cells):
    """A dam between 5 mm and 1 mm of water goes; 6 s later."""
    left, right, time, middle = 0.005, 0.001, 6.0, 5.0
    x, _, spacing = cell_grid(cells, 8, 10.0)
    c_left, c_right = np.sqrt(GRAVITY * left), np.sqrt(GRAVITY * right)

    def mismatch(c):
        jump = c**2 - c_right**2
        return -8 * c_right**2 * c**2 * (c_left - c) ** 2 + jump**2 * (c**2 + c_right**2)

    c = brentq(mismatch, 1.0001 * c_right, 0.9999 * c_left)
    shock = middle + time * 2 * c**2 * (c_left - c) / (c**2 - c_right**2)
    fan = 4 / (9 * GRAVITY) * (c_left - (x - middle) / (2 * time)) ** 2
    exact = np.where(x < shock, c**2 / GRAVITY, right)
    exact = np.where(x < middle + time * (2 * c_left - 3 * c), fan, exact)
    exact = np.where(x < middle - time * c_left, left, exact)
    start = np.where(x < middle, left, right)
    return Case("stoker", cells, x, 0 * x, start, spacing, time, exact)


def ritter(cells):
    """A dam between 5 mm of water and dry ground goes; 6 s later."""
    left, time, middle = 0.005, 6.0, 5.0
    x, _, spacing = cell_grid(cells, 8, 10.0)
    c = np.sqrt(GRAVITY * left)
    fan = 4 / (9 * GRAVITY) * (c - (x - middle) / (2 * time)) ** 2
    exact = np.where(x < middle + 2 * time * c, fan, 0.0)
    exact = np.where(x < middle - time * c, left, exact)
    return Case("ritter", cells, x, 0 * x, np.where(x < middle, left, 0.0), spacing, time, exact)


def bowl_planar(cells):
    """Water with a plane surface swings round a parabolic bowl (Thacker 1981); one period."""
    radius, deep, shift = 1.0, 0.1, 0.5
    x, y, spacing = cell_grid(cells, cells, 4.0, -2.0, -2.0)
    rate = np.sqrt(2 * GRAVITY * deep) / radius
    bed = -deep * (1 - (x**2 + y**2) / radius**2)
    start = np.maximum(0, shift * deep / radius**2 * (2 * x - shift) - bed)
    v = shift * rate * (start > 0)
    return Case("bowl planar", cells, x, bed, start, spacing, 2 * np.pi / rate, start, v)


def bowl_radial(cells):
    """Water swells and sinks in a parabolic bowl (Thacker 1981); one period."""
    radius, deep, start_radius = 1.0, 0.1, 0.8
    x, y, spacing = cell_grid(cells, cells, 4.0, -2.0, -2.0)
    r2 = x**2 + y**2
    rate = np.sqrt(8 * GRAVITY * deep) / radius
    a = (radius**2 - start_radius**2) / (radius**2 + start_radius**2)
    bed = -deep * (1 - r2 / radius**2)
    squeeze = np.sqrt(1 - a * a) / (1 - a)
    level = deep * (squeeze - 1 - r2 / radius**2 * (squeeze**2 - 1))
    start = np.maximum(0, level - bed)
    return Case("bowl radial", cells, x, bed, start, spacing, 2 * np.pi / rate, start)


def ripple(cells):
    """A hump of 20 micrometres, 1 cm wide, on 2 cm of water spreads as a ring; 0.4 s later."""
    deep, height, width, time, length = 0.02, 2e-5, 0.01, 0.4, 0.5
    x, y, spacing = cell_grid(cells, cells, length, -length / 2, -length / 2)
    r, c = np.hypot(x, y), np.sqrt(GRAVITY * deep)
    k, radii = np.linspace(0, 9 / width, 6001), np.linspace(0, 0.75 * length, 1501)
    spectrum = height * width**2 * np.exp(-0.5 * (k * width) ** 2) * np.cos(c * k * time) * k
    ring = np.array([np.trapezoid(spectrum * j0(k * radius), k) for radius in radii])
    start = deep + height * np.exp(-0.5 * (r / width) ** 2)
    exact = deep + np.interp(r, radii, ring)
    extra = {"deep": deep, "crest": float(ring.max())}
    return Case("ripple", cells, x, 0 * x, start, spacing, time, exact, extra=extra)


def lake(cells):
    """A lake at rest on a rough bed with islands and tall single cells: nothing may move."""
    x, y, spacing = cell_grid(cells, cells, 10.0)
    rng = np.random.default_rng(1)
    bed = 0.3 * np.sin(1.3 * x) * np.cos(1.7 * y) + 0.15 * rng.random(x.shape)
    bed[rng.random(x.shape) < 0.01] += 1.0
    bed[cells // 4 : cells // 3, cells // 4 : cells // 3] = 1.2
    depth = np.maximum(0.2 - bed, 0)
    steps = 1000 * 0.4 * spacing / np.sqrt(GRAVITY * depth.max())
    return Case("lake", cells, x, bed, depth, spacing, steps, depth)


def rain(cells, slope=0.01):
    """50 mm/h for 300 s on a slope; the hydrograph 20 m down the slope, until 500 s."""
    length, rate, until, time, manning = 20.0, 50 / 3.6e6, 300.0, 500.0, 0.02
    x, _, spacing = cell_grid(cells, 8, 25.0)
    t = np.linspace(0, time, 501)
    flow = kinematic_flow(t, length, np.sqrt(slope) / manning, rate, until)
    extra = {"rate": rate, "until": until, "time": t, "flow": flow, "gauge": length}
    return Case(
        "rain", cells, x, -slope * x, 0 * x, spacing, time, boundary={"east": "open"},
        manning=manning, extra=extra,
    )  # fmt: skip


def kinematic_flow(t, length, alpha, rate, until):
    """Return what leaves a plane under rain at times `t` [s], per width [m2/s].

    The kinematic wave: the flow is alpha h^(5/3), alpha = sqrt(slope) / n [m^(1/3)/s]. `rate` [m/s]
    falls until `until` [s], when the flow at the foot, `length` [m] from the top, must be steady.
    """
    m = 5 / 3
    equilibrium = (length / (alpha * rate ** (m - 1))) ** (1 / m)
    top = rate * length
    q = np.minimum(alpha * (rate * np.minimum(t, equilibrium)) ** m, top)
    for n in np.flatnonzero(t > until):

        def late(flow, after=t[n] - until):
            return flow / rate + m * alpha ** (1 / m) * flow ** ((m - 1) / m) * after - length

        q[n] = brentq(late, 0, 1.01 * top)
    return q


def error_of(case, depth):
    """Return the relative L1 error of `depth`, of a ripple relative to the wave.

    Cells whose exact depth is NaN are left out.
    """
    rest = case.extra.get("deep", 0.0)
    exact = case.exact - rest
    return float(np.nansum(np.abs(depth - rest - exact)) / np.nansum(np.abs(exact)))


def crest_of(case, depth):
    """Return the height of a ripple's crest along the x axis over the exact one."""
    n = case.cells
    wave = (0.5 * (depth[n // 2] + depth[n // 2 - 1]) - case.extra["deep"])[n // 2 :]
    k = int(np.clip(np.argmax(wave), 1, len(wave) - 2))
    a, b, c = wave[k - 1 : k + 2]
    shift = (a - c) / (2 * (a - 2 * b + c))
    return float((b - 0.25 * (a - c) * shift) / case.extra["crest"])


def wavy_lake(cells, scheme, **given):
    """Return a solver of a lake of 20 m, `cells` a side, with waves everywhere."""
    y, x = np.ogrid[:cells, :cells]
    y, x = y * (20.0 / cells), x * (20.0 / cells)
    solver = WaterSolver(np.zeros((cells, cells)), 20.0 / cells, scheme=scheme, **given)
    solver.set_state(0.3 + 0.003 * np.sin(x) * np.cos(1.3 * y))
    return solver


def span_of(cells, steps):
    """Return the time [s] in which `wavy_lake` takes `steps` steps of a Courant number of 0.3."""
    return steps * 0.3 * (20.0 / cells) / np.sqrt(GRAVITY * 0.303)
