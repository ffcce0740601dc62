"""Crowns: the ring of water that a splashing drop throws up, as lines that a picture can draw.

A crown is a rim on a thin sheet, some milliseconds old; over deep water a jet follows it. What one
exposure sees of it is given as short lines, each with the area of water that it stands for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rainsim.jit import device_function, lean_function, serial_kernel
from rainsim.marks import FAINTEST, lane, lanes
from rainsim.random import subkey, uniform_triple

LONGEST_CROWN = 0.030  # s
LONGEST_JET = 0.075  # s after the impact
FINE_PIXEL = 8e-3  # m; where pixels are wider neither jets nor droplets are drawn
_DENSITY, _TENSION = 998.0, 0.0728  # kg/m3, N/m; water at 20 C
_WEBER = 600.0  # of a drop of 1.5 mm: what the three numbers below belong to
_LIFE = 22.0  # of a crown, in units of diameter over speed
_HEIGHT = 1.8  # diameters, greatest
_BELOW_INVISCID = 0.65  # what friction leaves of the inviscid estimate; chosen
_THINNEST, _THICKEST = 0.2, 3.0  # film over diameter between which the estimate is used
_FLARE = 0.3  # the rim leans out by this share of its height
_FINGERS = 0.45  # by which share of its height the rim is jagged
_RIM = 0.17  # thickness of the rim over the drop's diameter
_RIM_ALPHA, _SHEET_ALPHA = 0.8, 0.3  # share of light that each replaces; a sheet is a window
JET_FROM = 2.0  # film over diameter from which on a jet rises
_JET_START, _JET_HEIGHT, _JET_WIDTH = 0.018, 3.0, 0.55  # s; diameters
_SEGMENT = 1.5  # px, length of a piece of the ring
_FEWEST, _MOST = 5, 40  # pieces of the ring
_DOT = 1.5  # px; narrower rings are one line
_MOST_TIMES = 4  # moments in which a growing crown is drawn
_FULL_TURN = 2 * math.pi


@dataclass(frozen=True)
class Lines:
    """Pieces of water that a picture shows, in the form in which streaks are drawn.

    Attributes
    ----------
    position : ndarray of shape (n, 3), float64 [m]
        Where the line begins.
    velocity : ndarray of shape (n, 3), float64 [m/s]
        Its length over the exposure.
    diameter : ndarray of shape (n,), float64 [m]
        Of the disc with the line's area.
    """

    position: np.ndarray
    velocity: np.ndarray
    diameter: np.ndarray

    def __len__(self):
        return len(self.diameter)


@device_function
def crown_life(diameter, speed):
    """Return how long [s] a crown of drops of `diameter` [m] that fell at `speed` [m/s] stands."""
    return np.minimum(_LIFE * _strength(diameter, speed) * diameter / speed, LONGEST_CROWN)


def crown_lines(impacts, film, size, start, exposure, pixel, crowns=True, jets=True):
    """Return what an exposure sees of the crowns and jets of some impacts.

    Parameters
    ----------
    impacts : Impacts
        That splash on a film of water.
    film : ndarray of shape (n,), float64 [m]
        Depth of water at each.
    size : ndarray of shape (n,), float64
        Of each splash over the largest that such a drop makes.
    start, exposure : float [s]
        The shutter is open from `start` to `start + exposure`.
    pixel : ndarray of shape (n,), float64 [m]
        Width of a pixel at each impact: finer detail than that is left out.
    crowns, jets : bool or ndarray of shape (n,), bool
        Whose crowns and whose jets.

    Returns
    -------
    Lines
        Without those that replace less than FAINTEST of any pixel's light.

    Notes
    -----
    The crown's foot grows as Yarin and Weiss 1995 (J. Fluid Mech. 283, 141) have it, R / D =
    (2 / (3 h / D))^(1/4) (V t / D)^(1/2), times one factor for what the friction takes, which
    cannot be neglected for most of the spreading (Lamanna et al. 2022, J. Fluid Mech.).
    Height and life both grow with the square root of the Weber number, so that a higher crown takes
    longer but does not grow faster, as Cossali et al. 2004 (Exp. Fluids 36, 888) measured. The
    factors themselves and the jet are chosen, not fitted to measurements.
    """
    speed = np.abs(impacts.velocity[:, 2])
    diameter = impacts.diameter
    life, growth, height, jet = crown_shape(diameter, speed, film, size, pixel)
    life, jet = life * crowns, jet & jets
    age = start - impacts.time
    seen = (age < life) & (life > 0) | jet & (age < LONGEST_JET)
    shapes = np.stack([diameter, age, life, growth, height, jet, pixel], axis=1)[seen]
    drift, keys = 0.1 * impacts.velocity[seen, :2], impacts.id[seen]
    place = impacts.position[seen]
    capacity, count = 4096, np.zeros(1, np.int64)
    while True:
        out, count[0] = np.empty((capacity, 7)), 0
        _raise(place, drift, shapes, keys, float(exposure), count, out)
        if count[0] <= capacity:
            break
        capacity = count[0]
    out = out[: count[0]]
    return Lines(
        np.ascontiguousarray(out[:, :3]), np.ascontiguousarray(out[:, 3:6]),
        np.ascontiguousarray(out[:, 6]),
    )  # fmt: skip


@device_function
def crown_shape(diameter, speed, film, size, pixel):
    """Return a crown's life [s], its foot over the root of its age, its height, and if a jet rises.

    Of numbers or arrays; see `crown_lines`.
    """
    relative = film / diameter
    clipped = np.minimum(np.maximum(relative, _THINNEST), _THICKEST)
    spread = _BELOW_INVISCID * (2 / (3 * clipped)) ** 0.25
    growth = size * spread * np.sqrt(speed * diameter)  # m / s^(1/2)
    height = size * _HEIGHT * _strength(diameter, speed) * diameter
    jet = (relative > JET_FROM) & (pixel < FINE_PIXEL)
    return crown_life(diameter, speed), growth, height, jet


@device_function
def _strength(diameter, speed):
    """Square root of the Weber number over that of the reference drop."""
    return np.sqrt(_DENSITY * speed**2 * diameter / _TENSION / _WEBER)


@serial_kernel
def _raise(position, drift, shapes, ids, exposure, count, out):
    """Fill in the lines (see `Lines`: 3 + 3 + 1 numbers) that fit and count how many there are."""
    for n in range(len(ids)):
        x, y, z = position[n]
        diameter, age, life, growth, height, jet, pixel = shapes[n]
        raise_crown(
            x, y, z, drift[n, 0], drift[n, 1], diameter, age, life, growth, height, pixel, ids[n],
            exposure, count, out,
        )  # fmt: skip
        if jet > 0:
            raise_jet(x, y, z, diameter, age, pixel, exposure, count, out)


@lean_function
def raise_crown(
    x, y, z, drift_x, drift_y, diameter, age, life, growth, height, pixel, key, exposure, count, out
):  # fmt: skip
    """Add the lines of one impact's crown."""
    begin, end = max(age, 0.0), min(age + exposure, life)
    if begin >= end:
        return
    grown = growth * (math.sqrt(end) - math.sqrt(begin))
    times = min(1 + int(grown / pixel), _MOST_TIMES)
    share = (end - begin) / (exposure * times)
    for moment in range(times):
        time = begin + (end - begin) * (moment + 0.5) / times
        passed = time / life
        top = height * 4 * passed * (1 - passed)
        foot = growth * math.sqrt(time)
        _ring(
            x + drift_x * time, y + drift_y * time, z, foot, top, _RIM * diameter,
            share * (1 - passed * passed), pixel, key, exposure, count, out,
        )  # fmt: skip


@lean_function
def raise_jet(x, y, z, diameter, age, pixel, exposure, count, out):
    """Add the line of one impact's jet."""
    begin, end = max(age, _JET_START), min(age + exposure, LONGEST_JET)
    if begin >= end or lane() > 0:
        return
    passed = (0.5 * (begin + end) - _JET_START) / (LONGEST_JET - _JET_START)
    tall = _JET_HEIGHT * diameter * 4 * passed * (1 - passed)
    area = tall * _JET_WIDTH * diameter * _RIM_ALPHA * (end - begin) / exposure
    _line(x, y, z, x, y, z + tall, area, pixel, exposure, count, out)


@lean_function
def _ring(x, y, z, foot, top, thickness, share, pixel, key, exposure, count, out):
    """Add one crown at one moment: a jagged rim, and under it the sheet."""
    rim = foot + _FLARE * top
    if 2 * rim < _DOT * pixel:  # no more than a spot to this camera
        if lane() > 0:
            return
        mean = top * (1 - 0.5 * _FINGERS)
        slant = mean * math.sqrt(1 + _FLARE * _FLARE)
        area = _FULL_TURN * rim * thickness * _RIM_ALPHA
        area = (area + math.pi * (rim + foot) * slant * _SHEET_ALPHA) * share
        _line(x - rim, y, z + 0.5 * mean, x + rim, y, z + 0.5 * mean, area, pixel, exposure, count,
              out)  # fmt: skip
        return
    pieces = min(max(int(_FULL_TURN * rim / (_SEGMENT * pixel)), _FEWEST), _MOST)
    turn = _FULL_TURN / pieces
    turned, _, _ = uniform_triple(subkey(key, 1 << 20))
    # The rim's number of fingers is its own, however many pieces draw it.
    phase_1, phase_2, wave = uniform_triple(subkey(key, (1 << 20) + 1))
    fingers = 5 + int(4 * wave)
    length = 2 * rim * math.sin(turn / 2)
    rim_area = length * thickness * _RIM_ALPHA * share
    sheet_area = turn * 0.5 * (rim + foot) * _SHEET_ALPHA * share
    last_x, last_y, last_z = x, y, z
    for piece in range(1 + lane(), pieces + 1, lanes()):
        if piece == 1 or lanes() > 1:
            last_out, last_z, cosine, sine = _rim_point(
                turn * (piece - 1 + turned), foot, top, fingers, phase_1, phase_2
            )
            last_x, last_y, last_z = x + last_out * cosine, y + last_out * sine, z + last_z
        out_there, high, cosine, sine = _rim_point(
            turn * (piece + turned), foot, top, fingers, phase_1, phase_2
        )
        px, py, pz = x + out_there * cosine, y + out_there * sine, z + high
        area = rim_area
        if high > 0.5 * pixel:
            slant = math.sqrt(high * high + (out_there - foot) ** 2)
            _line(
                x + foot * cosine, y + foot * sine, z, px, py, pz, sheet_area * slant, pixel,
                exposure, count, out,
            )  # fmt: skip
        else:
            area += sheet_area * high
        _line(last_x, last_y, last_z, px, py, pz, area, pixel, exposure, count, out)
        last_x, last_y, last_z = px, py, pz


@device_function
def _rim_point(angle, foot, top, fingers, phase_1, phase_2):
    """Return how far out and how high a jagged rim is at an angle, and its cosine and sine."""
    jagged = math.sin(fingers * angle + _FULL_TURN * phase_1)
    jagged = 0.6 * jagged + 0.4 * math.sin(3 * angle + _FULL_TURN * phase_2)
    high = top * (1 - _FINGERS * (0.5 - 0.5 * jagged))
    return foot + _FLARE * high, high, math.cos(angle), math.sin(angle)


@lean_function
def _line(x0, y0, z0, x1, y1, z1, area, pixel, exposure, count, out):
    """Add a line of the given area [m2], unless it is too faint to be seen."""
    if area < FAINTEST * pixel * pixel:
        return
    row = next_row(count)
    if row < len(out):
        out[row, 0], out[row, 1], out[row, 2] = x0, y0, z0
        out[row, 3] = (x1 - x0) / exposure
        out[row, 4] = (y1 - y0) / exposure
        out[row, 5] = (z1 - z0) / exposure
        out[row, 6] = math.sqrt(area * 4 / math.pi)


@lean_function
def next_row(count):
    """Return the number of rows before, and count one more."""
    count[0] += 1
    return count[0] - 1
