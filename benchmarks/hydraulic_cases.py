"""Steady channels, rain on planes and a V-catchment: cases of `benchmarks hydraulics`.

An inflow is rain on an inlet to the west of the channel, with a wall behind it; the solver's rain
joins at the speed of the water, which the exact flow in the inlet respects. Where the flow leaves
it is faster than its waves, so that an open edge adds no error.

References
----------
Delestre et al. 2013, "SWASHES: a compilation of shallow water analytic solutions", Int. J. Numer.
Meth. Fluids 72 (bump with a jump, MacDonald's long channel, rain), whose numbers are from memory:
each bed is made for its depth here, so that the solutions are exact whatever they are.
MacDonald et al. 1997, J. Hydraul. Eng. 123. Di Giammarco et al. 1996, J. Hydrol. 175 (catchment).
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import brentq

from benchmarks.cases import Case, kinematic_flow, rain
from rainsim.constants import GRAVITY

INLET = 0.1  # of the length of a channel, before its west end
ROWS = 4  # of a channel, in which nothing differs from row to row
FINE = 20000  # intervals of an integral that stands for the exact one

BUMP_FLOW, BUMP_STAGE = 0.18, 0.33  # m2/s, m: SWASHES' discharge and depth behind the jump
BUMP_LENGTH = 25.0  # m, where SWASHES' channel ends and gives way to the second bump
SECOND_CREST = 30.0  # m

CHANNEL = 1000.0  # m, MacDonald's
CHANNEL_FLOW, CHANNEL_MANNING = 2.0, 0.0218  # m2/s, s m^(-1/3)

PLANE, VALLEY, CHANNEL_WIDTH = 800.0, 1000.0, 20.0  # m, of the catchment
PLANE_SLOPE, VALLEY_SLOPE = 0.05, 0.02
PLANE_MANNING, VALLEY_MANNING = 0.015, 0.15  # s m^(-1/3)
SHOWER, SHOWER_TIME = 10.8 / 3.6e6, 5400.0  # m/s, s
BANK = 1.0  # m, from the plane's foot down into the channel's upper end


def critical_depth(flow):
    """Return the depth [m] at which `flow` [m2/s] is as fast as its waves."""
    return (flow**2 / GRAVITY) ** (1 / 3)


def head(depth, flow):
    """Return the specific energy of a flow [m]."""
    return depth + flow**2 / (2 * GRAVITY * depth**2)


def thrust(depth, flow):
    """Return the flux of momentum and pressure over the density [m3/s2]; a jump keeps it."""
    return flow**2 / depth + 0.5 * GRAVITY * depth**2


def depth_of_head(energy, flow, is_fast):
    """Return the depth [m] of a flow with the specific energy `energy` [m], fast or tranquil."""
    critical = critical_depth(flow)
    least = head(critical, flow)
    if energy <= least:
        return critical
    span = (1e-6 * critical, critical) if is_fast else (critical, energy)
    return brentq(lambda depth: head(depth, flow) - energy, *span, xtol=1e-15, rtol=1e-14)


def first_bump(x):
    """Return SWASHES' bump [m]."""
    return np.maximum(0.2 - 0.05 * (x - 10) ** 2, 0)


def bump_bed(x):
    """Return SWASHES' bump, and a second one whose crest holds the stage `BUMP_STAGE` [m]."""
    crest = head(BUMP_STAGE, BUMP_FLOW) - 1.5 * critical_depth(BUMP_FLOW)
    return first_bump(x) + np.maximum(crest - 0.02 * (x - SECOND_CREST) ** 2, 0)


def jump_place():
    """Return where the jump stands [m], and the depths before and behind it [m]."""
    before, behind = 0.2 + 1.5 * critical_depth(BUMP_FLOW), head(BUMP_STAGE, BUMP_FLOW)

    def depths(x):
        bed = float(bump_bed(x))
        return (
            depth_of_head(before - bed, BUMP_FLOW, True),
            depth_of_head(behind - bed, BUMP_FLOW, False),
        )

    def mismatch(x):
        fast, tranquil = depths(x)
        return thrust(fast, BUMP_FLOW) - thrust(tranquil, BUMP_FLOW)

    # Nearer to the crest the flow behind a jump would not get over the bed there.
    lowest = 0.2 - (behind - 1.5 * critical_depth(BUMP_FLOW))
    place = brentq(mismatch, 10 + np.sqrt(lowest / 0.05) + 1e-9, 12, xtol=1e-14)
    return place, *depths(place)


def bump_depth(x):
    """Return the steady depth [m] over the bump, with its jump, at places `x` [m] of a row."""
    before, behind = 0.2 + 1.5 * critical_depth(BUMP_FLOW), head(BUMP_STAGE, BUMP_FLOW)
    jump = jump_place()[0]
    depth = []
    for place, bed in zip(x, bump_bed(x), strict=True):
        energy = before if place < jump else behind
        is_fast = 10 < place < jump or place > SECOND_CREST
        depth.append(depth_of_head(energy - bed, BUMP_FLOW, is_fast))
    return np.array(depth)


def inflow(x, flow, length):
    """Return the flow [m2/s] along an inlet of `length` [m] to the west of x = 0: 0 to `flow`."""
    s = np.clip(x / length + 1, 0, 1)
    return flow * s**2 * (3 - 2 * s)


def _channel(name, cells, length, duration, flow, profile, inlet=0.0, counted=None, manning=0.0):
    """Return a channel of a steady flow; the inlet and what lies east of `counted` do not count.

    `flow`(x) [m2/s] is the flow at the faces of the cells, `profile`(x) bed, depth at the start and
    exact depth [m] at their centres.
    """
    spacing = length / cells
    before = round(inlet / spacing)
    x = (np.arange(-before, cells) + 0.5) * spacing
    bed, start, exact = profile(x)
    exact = np.where((x < 0) | (x > (counted or length)), np.nan, exact)
    faces = np.arange(-before, cells + 1) * spacing
    maps = [np.tile(row, (ROWS, 1)) for row in (x, bed, start, exact, np.diff(flow(faces)))]
    return Case(
        name, cells, *maps[:3], spacing, duration, maps[3], boundary={"east": "open"},
        manning=manning, extra={"supply": maps[4] / spacing},
    )  # fmt: skip


def bump(cells):
    """A flow over a bump becomes fast and jumps back; 35 m, of which SWASHES' 25 m count.

    SWASHES prescribes the depth at the outlet. Here a second bump holds it: over its crest the flow
    is critical, which fixes the depth before it. Behind it the ground is dry at the start: an open
    edge keeps a lake.
    """
    length = 35.0

    def profile(x):
        bed = bump_bed(x)
        level = np.where(x < SECOND_CREST, BUMP_STAGE, 0.0)
        return bed, np.maximum(level - bed, 0), bump_depth(x)

    def flow(x):
        return inflow(x, BUMP_FLOW, INLET * length)

    return _channel("bump", cells, length, 300.0, flow, profile, INLET * length, BUMP_LENGTH)


def channel_depth(x):
    """Return MacDonald's depth [m] and its slope, tranquil above `CHANNEL` / 2, fast below."""
    s = x / CHANNEL - 0.5
    sharp = np.where(s < 0, 3.0, 6.0)
    critical = critical_depth(CHANNEL_FLOW)
    depth = critical * (1 - np.tanh(sharp * s) / sharp)
    return depth, -critical / np.cosh(sharp * s) ** 2 / CHANNEL


def steady_slope(depth, flow, manning, drag=0.0):
    """Return the bed's slope that keeps a depth [m] and its slope, a pair, under a flow [m2/s].

    `drag` is the slope that takes falling rain along.
    """
    h, rise = depth
    friction = manning**2 * flow**2 / h ** (10 / 3)
    return (flow**2 / (GRAVITY * h**3) - 1) * rise - friction - drag


def channel_slope(x, flow, gain, brought):
    """Return the bed's slope on which a flow [m2/s] of `channel_depth` is steady at places `x` [m].

    Rain lets the flow grow by `gain` [m/s] in each metre; it comes at `brought` times the water's
    speed: 0 if it falls straight down, as in SWASHES.
    """
    depth = channel_depth(x)
    rain_drag = (2 - brought) * flow * gain / (GRAVITY * depth[0] ** 2)
    return steady_slope(depth, flow, CHANNEL_MANNING, rain_drag)


def bed_of(slope, start=0.0):
    """Return the function of x [m] that gives the height [m] of the channel from `start` [m] on.

    Its slope(x) is integrated by Simpson's rule.
    """
    fine = np.linspace(start, CHANNEL, FINE + 1)
    ends, middle = slope(fine), slope(0.5 * (fine[1:] + fine[:-1]))
    steps = (ends[1:] + 4 * middle + ends[:-1]) / 6 * np.diff(fine)
    height = np.concatenate([[0.0], np.cumsum(steps)])
    return lambda x: np.interp(x, fine, height)


def _macdonald(name, cells, flow, gain, brought, inlet):
    """Return a channel whose bed carries `flow`(x), which grows by `gain`(x)."""
    bed = bed_of(lambda x: channel_slope(x, flow(x), gain(x), brought(x)), -inlet)

    def profile(x):
        return bed(x), 0 * x, channel_depth(x)[0]

    return _channel(
        name, cells, CHANNEL, 1500.0, flow, profile, inlet, manning=CHANNEL_MANNING
    )  # fmt: skip


def macdonald(cells):
    """2 m2/s enter a dry channel of 1 km and turn from tranquil to fast half way."""
    inlet = INLET * CHANNEL

    def gain(x):
        s = np.clip(x / inlet + 1, 0, 1)
        return 6 * CHANNEL_FLOW / inlet * s * (1 - s)

    return _macdonald(
        "macdonald", cells, lambda x: inflow(x, CHANNEL_FLOW, inlet), gain, np.ones_like, inlet
    )


def macdonald_rain(cells, brought=0.0):
    """Rain alone fills the channel, 4 mm/s, so that the flow half way is again 2 m2/s.

    It falls straight down, as in SWASHES, or with a speed of `brought` times that of the water.
    """
    rate = 2 * CHANNEL_FLOW / CHANNEL
    return _macdonald(
        "macdonald rain", cells, lambda x: rate * x, lambda x: rate + 0 * x,
        lambda x: brought + 0 * x, 0.0,
    )  # fmt: skip


def macdonald_carried(cells):
    """`macdonald_rain` with rain that comes at the speed of the water, as the solver has it."""
    return macdonald_rain(cells, 1.0)


def sill(place=-1):
    """0.2 m2/s on a slope of 0.5 %, 60 m; the column `place`, at the open edge, is 0.1 m higher.

    All that comes in has to leave; there is no exact depth.
    """
    x = (np.arange(60) + 0.5)[None].repeat(ROWS, 0)
    bed = -0.005 * x
    bed[:, place] += 0.1
    supply = np.where(x < 5, 0.2 / 5, 0.0)
    return Case(
        "sill", 60, x, bed, 0 * x, 1.0, 1500.0, boundary={"east": "open"}, manning=0.02,
        extra={"supply": supply},
    )  # fmt: skip


def plane_gentle(cells):
    """`cases.rain` on a slope of 0.5 %."""
    return rain(cells, 0.005)


def plane_middle(cells):
    """`cases.rain` on a slope of 2 %."""
    return rain(cells, 0.02)


def plane_steep(cells):
    """`cases.rain` on a slope of 10 %."""
    return rain(cells, 0.1)


def catchment_flow(times):
    """Return the flow out of the V-catchment [m3/s] at `times` [s], by kinematic theory.

    Both planes give the channel what `kinematic_flow` says. Characteristics of the channel start at
    its upper end; along each the depth grows by what flows in, whatever the place.
    """
    t = np.linspace(0, times[-1], 4001)
    sides = kinematic_flow(t, PLANE, np.sqrt(PLANE_SLOPE) / PLANE_MANNING, SHOWER, SHOWER_TIME)
    gain = 2 * sides / CHANNEL_WIDTH + SHOWER * (t < SHOWER_TIME)  # m/s, on the channel
    fed = cumulative_trapezoid(gain, t, initial=0.0)
    alpha, m = np.sqrt(VALLEY_SLOPE) / VALLEY_MANNING, 5 / 3
    arrivals, depths = [], []
    for n in range(len(t) - 1):
        depth = fed[n:] - fed[n]
        place = cumulative_trapezoid(m * alpha * depth ** (m - 1), t[n:], initial=0.0)
        if place[-1] < VALLEY:
            break
        arrivals.append(np.interp(VALLEY, place, t[n:]))
        depths.append(np.interp(arrivals[-1], t[n:], depth))
    early = np.interp(times, t, fed)  # nothing from the upper end has come yet
    depth = np.where(times < arrivals[0], early, np.interp(times, arrivals, depths))
    return CHANNEL_WIDTH * alpha * depth**m


def catchment(cells):
    """90 min of 10.8 mm/h on two planes and a channel of 20 m; `cells` across, 1620 m, 180 min.

    The planes slope towards the channel only, which lies below their feet by `BANK` at its upper
    end and 21 m at its mouth.
    """
    width = 2 * PLANE + CHANNEL_WIDTH
    spacing = width / cells
    x = (np.arange(cells) + 0.5) * spacing - width / 2
    y = (np.arange(round(VALLEY / spacing)) + 0.5) * spacing
    x, y = np.meshgrid(x, y)
    in_channel = np.abs(x) < CHANNEL_WIDTH / 2
    foot = VALLEY_SLOPE * VALLEY + BANK
    plane = foot + PLANE_SLOPE * (np.abs(x) - CHANNEL_WIDTH / 2)
    bed = np.where(in_channel, VALLEY_SLOPE * y, plane)
    t = np.arange(0.0, 2 * SHOWER_TIME + 1, 20.0)
    extra = {
        "rate": SHOWER, "until": SHOWER_TIME, "time": t, "flow": catchment_flow(t),
        "edge": "south", "period": 20.0,
    }  # fmt: skip
    return Case(
        "catchment", cells, x, bed, 0 * x, spacing, 2 * SHOWER_TIME, boundary={"south": "open"},
        manning=np.where(in_channel, VALLEY_MANNING, PLANE_MANNING), extra=extra,
    )  # fmt: skip
