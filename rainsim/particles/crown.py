"""Crowns: the ring of water that a splashing drop throws up, as lines that a picture can draw.

A crown is a rim on a thin sheet, some milliseconds old; over deep water a jet follows it. What one
exposure sees of it is given as short lines, each with the area of water that it stands for.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import SURFACE_TENSION, WATER_DENSITY
from rainsim.jit import device_function, lean_function
from rainsim.numerics.random import subkey, uniform_triple
from rainsim.particles.line_raster import FAINTEST, lane, lanes
from rainsim.particles.splash import weber_number

LONGEST_CROWN = 0.030  # s
LONGEST_JET = 0.075  # s after the impact
FINE_PIXEL = 8e-3  # m; where pixels are wider neither jets nor droplets are drawn
JET_FROM = 2.0  # depth of the water over the drop's diameter from which on a jet rises
_WEBER = 600.0  # of a drop of 1.5 mm: what the three numbers below belong to
_LIFE = 22.0  # of a crown, in units of diameter over speed
_HEIGHT = 1.8  # diameters, greatest
_BELOW_INVISCID = 0.65  # what friction leaves of the inviscid estimate; chosen
_THINNEST, _THICKEST = 0.2, 3.0  # depth over diameter between which the estimate is used
_FLARE = 0.3  # the rim leans out by this share of its height
_FINGERS = 0.45  # by which share of its height the rim is jagged
_RIM = 0.17  # thickness of the rim over the drop's diameter
# A thread of water breaks up fastest at this wavelength over its radius, and grows by e in so many
# times of sqrt(density radius^3 / tension): Rayleigh 1878.
_BREAK_UP, _BREAK_UP_TIME = 9.02, 1 / 0.343
_UNEVEN = 0.15  # by which share the number of fingers varies; chosen
# Share of light that each replaces. A sheet is a window, whose faces mirror some 4 % each: so the
# light that a crown adds is that of a path-traced crown (tests/particles/test_mitsuba_rain.py).
_RIM_ALPHA, _SHEET_ALPHA = 0.8, 0.1
_DRIFT = 0.1  # share of the drop's horizontal velocity with which a crown moves; chosen
_JET_START, _JET_HEIGHT, _JET_WIDTH = 0.018, 3.0, 0.55  # s; diameters
_SEGMENT = 1.5  # px, length of a piece of the ring
_FEWEST, _MOST = 5, 40  # pieces of the ring
_DOT = 1.5  # px; narrower rings are one line
_MOST_TIMES = 4  # moments in which a growing crown is drawn
_FULL_TURN = 2 * math.pi


class Crown(NamedTuple):
    """The shape of a crown: see `crown_shape`.

    growth : float64 [m s^(-1/2)]. Radius of the foot over the square root of the
        age.
    height : float64 [m]. Greatest.
    fingers : float. Of the rim, on the mean.
    """

    life: float
    growth: float
    height: float
    jet: bool
    fingers: float


class _Ring(NamedTuple):
    """A crown at one moment: its middle, the radius of its foot and the top of its rim [m].

    `share`: of the light that the ring would replace if it stood for all of the exposure.
    """

    x: float
    y: float
    z: float
    foot: float
    top: float
    share: float


@device_function
def crown_life(diameter, speed):
    """Return how long [s] a crown of drops of `diameter` [m] that fell at `speed` [m/s] stands."""
    return np.minimum(_LIFE * _strength(diameter, speed) * diameter / speed, LONGEST_CROWN)


@device_function
def crown_shape(impact, size, pixel):
    """Return the `Crown` of an `Impact` on water.

    The crown's foot grows as Yarin and Weiss 1995 (J. Fluid Mech. 283, 141) have it, R / D =
    (2 / (3 h / D))^(1/4) (V t / D)^(1/2), times one factor for what the friction takes, which
    cannot be neglected for most of the spreading (Lamanna et al. 2022, J. Fluid Mech.).
    Height and life both grow with the square root of the Weber number, so that a higher crown takes
    longer but does not grow faster, as Cossali et al. 2004 (Exp. Fluids 36, 888) measured. The
    factors themselves and the jet are chosen, not fitted to measurements. The rim's fingers are as
    many as wavelengths of the Rayleigh-Plateau instability fit on it (Zhang et al. 2010, Phys.
    Fluids 22, 122105) when this has had the time to grow by e.
    """
    diameter, speed = impact.diameter, impact.speed
    relative = impact.depth / diameter
    clipped = np.minimum(np.maximum(relative, _THINNEST), _THICKEST)
    spread = _BELOW_INVISCID * (2 / (3 * clipped)) ** 0.25
    growth = size * spread * np.sqrt(speed * diameter)  # m / s^(1/2)
    height = size * _HEIGHT * _strength(diameter, speed) * diameter
    jet = (relative > JET_FROM) & (pixel < FINE_PIXEL)
    radius = 0.5 * _RIM * diameter
    grown = _BREAK_UP_TIME * np.sqrt(WATER_DENSITY * radius**3 / SURFACE_TENSION)
    fingers = _FULL_TURN * growth * np.sqrt(grown) / (_BREAK_UP * radius)
    return Crown(crown_life(diameter, speed), growth, height, jet, fingers)


@device_function
def fingers_of(crown, wave):
    """Return how many fingers a crown's rim has; `wave`, 0 to 1, is its own."""
    return int(crown.fingers * (1.0 + _UNEVEN * (2.0 * wave - 1.0)) + 0.5)


@device_function
def _strength(diameter, speed):
    """Square root of the Weber number over that of the reference drop."""
    return np.sqrt(weber_number(diameter, speed) / _WEBER)


@lean_function
def raise_crown(impact, crown, pixel, exposure, count, lines_out):
    """Add the lines of one impact's crown.

    pixel : float [m]. Width of a pixel there: finer detail is not drawn.
    exposure : float [s]
    count : array of shape (1,), int. Lines so far; raised by those that are
        added, also where there is no room.
    lines_out : array of shape (room, 7), float64. The columns of `streaks.Line`;
        only lines that replace FAINTEST of a pixel's light or more.
    """
    begin, end = max(impact.age, 0.0), min(impact.age + exposure, crown.life)
    if begin >= end:
        return
    grown = crown.growth * (math.sqrt(end) - math.sqrt(begin))
    times = min(1 + int(grown / pixel), _MOST_TIMES)
    share = (end - begin) / (exposure * times)
    for moment in range(times):
        time = begin + (end - begin) * (moment + 0.5) / times
        passed = time / crown.life
        ring = _Ring(
            impact.x + _DRIFT * impact.vx * time, impact.y + _DRIFT * impact.vy * time, impact.z,
            crown.growth * math.sqrt(time), crown.height * 4 * passed * (1 - passed),
            share * (1 - passed * passed),
        )  # fmt: skip
        _raise_ring(ring, crown, _RIM * impact.diameter, impact.key, pixel, exposure, count,
                    lines_out)  # fmt: skip


@lean_function
def raise_jet(impact, pixel, exposure, count, lines_out):
    """Add the line of one impact's jet; see `raise_crown`."""
    begin, end = max(impact.age, _JET_START), min(impact.age + exposure, LONGEST_JET)
    if begin >= end or lane() > 0:
        return
    passed = (0.5 * (begin + end) - _JET_START) / (LONGEST_JET - _JET_START)
    tall = _JET_HEIGHT * impact.diameter * 4 * passed * (1 - passed)
    area = tall * _JET_WIDTH * impact.diameter * _RIM_ALPHA * (end - begin) / exposure
    foot = (impact.x, impact.y, impact.z)
    top = (impact.x, impact.y, impact.z + tall)
    _add_line(foot, top, area, pixel, exposure, count, lines_out)


@lean_function
def _raise_ring(ring, crown, thickness, key, pixel, exposure, count, lines_out):
    """Add one crown at one moment: a jagged rim of a `thickness` [m], and under it the sheet."""
    rim = ring.foot + _FLARE * ring.top
    if 2 * rim < _DOT * pixel:
        _raise_spot(ring, rim, thickness, pixel, exposure, count, lines_out)
        return
    pieces = min(max(int(_FULL_TURN * rim / (_SEGMENT * pixel)), _FEWEST), _MOST)
    turn = _FULL_TURN / pieces
    turned, _, _ = uniform_triple(subkey(key, 1 << 20))
    # The rim's number of fingers is its own, however many pieces draw it.
    phase_1, phase_2, wave = uniform_triple(subkey(key, (1 << 20) + 1))
    fingers = fingers_of(crown, wave)
    length = 2 * rim * math.sin(turn / 2)
    rim_area = length * thickness * _RIM_ALPHA * ring.share
    sheet_area = turn * 0.5 * (rim + ring.foot) * _SHEET_ALPHA * ring.share
    before = (ring.x, ring.y, ring.z)
    for piece in range(1 + lane(), pieces + 1, lanes()):
        if piece == 1 or lanes() > 1:
            out, high, cosine, sine = _rim_point(
                turn * (piece - 1 + turned), ring, fingers, phase_1, phase_2
            )
            before = (ring.x + out * cosine, ring.y + out * sine, ring.z + high)
        out, high, cosine, sine = _rim_point(
            turn * (piece + turned), ring, fingers, phase_1, phase_2
        )
        here = (ring.x + out * cosine, ring.y + out * sine, ring.z + high)
        area = rim_area
        if high > 0.5 * pixel:
            slant = math.sqrt(high * high + (out - ring.foot) ** 2)
            foot = (ring.x + ring.foot * cosine, ring.y + ring.foot * sine, ring.z)
            _add_line(foot, here, sheet_area * slant, pixel, exposure, count, lines_out)
        else:
            area += sheet_area * high
        _add_line(before, here, area, pixel, exposure, count, lines_out)
        before = here


@lean_function
def _raise_spot(ring, rim, thickness, pixel, exposure, count, lines_out):
    """Add one crown at one moment that is no more than a spot to this camera, as one line."""
    if lane() > 0:
        return
    mean = ring.top * (1 - 0.5 * _FINGERS)
    slant = mean * math.sqrt(1 + _FLARE * _FLARE)
    area = _FULL_TURN * rim * thickness * _RIM_ALPHA
    area = (area + math.pi * (rim + ring.foot) * slant * _SHEET_ALPHA) * ring.share
    west = (ring.x - rim, ring.y, ring.z + 0.5 * mean)
    east = (ring.x + rim, ring.y, ring.z + 0.5 * mean)
    _add_line(west, east, area, pixel, exposure, count, lines_out)


@device_function
def _rim_point(angle, ring, fingers, phase_1, phase_2):
    """Return how far out and how high a jagged rim is at an angle, and its cosine and sine."""
    jagged = math.sin(fingers * angle + _FULL_TURN * phase_1)
    jagged = 0.6 * jagged + 0.4 * math.sin(3 * angle + _FULL_TURN * phase_2)
    high = ring.top * (1 - _FINGERS * (0.5 - 0.5 * jagged))
    return ring.foot + _FLARE * high, high, math.cos(angle), math.sin(angle)


@lean_function
def _add_line(begin, end, area, pixel, exposure, count, lines_out):
    """Add a line of the given area [m2] between two places, unless it is too faint to be seen."""
    if area < FAINTEST * pixel * pixel:
        return
    row = next_row(count)
    if row < len(lines_out):
        lines_out[row, 0], lines_out[row, 1], lines_out[row, 2] = begin[0], begin[1], begin[2]
        lines_out[row, 3] = (end[0] - begin[0]) / exposure
        lines_out[row, 4] = (end[1] - begin[1]) / exposure
        lines_out[row, 5] = (end[2] - begin[2]) / exposure
        lines_out[row, 6] = math.sqrt(area * 4 / math.pi)


@lean_function
def next_row(count):
    """Count one row more in `count`, and return how many there were before."""
    count[0] += 1
    return count[0] - 1
