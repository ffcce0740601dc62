"""Spray of tyres: how much water of the road they throw, by which way, and how it flies.

A tyre that rolls over water of depth h clears it from its path. Four ways share it (Weir, Strange
and Heffley 1978): the bow wave ahead of the tyre, the side waves, what the grooves of the tread
pick up, and the film that clings to the rubber between them (capillary adhesion). A part of each
becomes mist, which hangs behind the car; the other drops fly on their own.

A row of a table of throws is what one tyre threw in one short step of time, see
`THROW_COLUMNS`. All that flies follows from rows, their ids and the time alone.

References
----------
The rates are those of Weir, Strange and Heffley (1978, "Reduction of adverse aerodynamic effects of
large trucks", FHWA-RD-79-84) in the form that the splash and spray assessment tool took over
(Flintsch et al. 2014, FHWA-HRT-15-062). Both were at hand second hand only, as a public program
that states them. Drop sizes are those that Radovich and Browand measured behind a tyre's groove
(Radovich 2009, thesis, University of Southern California, its abstract). What is an assumption says
so beside its number.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv

from rainsim.constants import GRAVITY, SURFACE_TENSION, WATER_DENSITY
from rainsim.io.states import AT, THROW_COLUMNS
from rainsim.jit import device_function, serial_kernel
from rainsim.numerics.random import mix, subkey, uniform_triple
from rainsim.rain.size_distribution import LARGEST, terminal_speed

WAYS = BOW, SIDE, TREAD, FILM = range(4)
# Columns of a table of throws, as kernels take them.
BEGIN, END, X, Y, Z, X_END, Y_END, OUT, WIDTH, RADIUS, COVERED, DEPTH = (AT[name] for name in (
    "begin", "end", "x", "y", "z", "x_end", "y_end", "out_x", "width", "radius", "covered", "depth",
))  # fmt: skip
RIB_SHARE = 0.75  # of a tyre's width that is rubber and not groove
CLINGING = 1e-4  # m of water that clings to the rubber
GROOVE_DEPTH = 8e-3  # m, of a new tyre: what the tread can hold
MILES_PER_HOUR = 0.44704  # m/s
# Spray density [kg/m3] beside a vehicle over the mass rate [kg/s] of each way, against the speed V
# [miles/h]: slope V + offset [s/m3]. Measured at trucks; where it is negative there is none.
MIST_SLOPE = np.array([2.67e-5, 1.65e-5, 1.16e-5, -2.69e-5])
MIST_OFFSET = np.array([-4.71e-4, -3.99e-4, -5.25e-5, 2.43e-3])
MOST_MIST = 0.5  # share of a way; beyond the speeds that were measured
# Mean diameter of drops from a groove at its Weber number; sizes go with the root of one over it.
MEAN_DIAMETER, WEBER, GROOVE_WIDTH = 0.8e-3, 2700.0, 5.5e-3  # m, 1, m
LARGEST_MEAN = 1.5e-3  # m; an assumption: below 3 m/s no sizes were measured
LEAST_WEBER = WEBER * (MEAN_DIAMETER / LARGEST_MEAN) ** 2
FILM_DIAMETER = 1e-4  # m, mean of drops of the clinging film, its own thickness; an assumption
COARSER = 1.0  # share by which drops of waves of water as deep as the grooves are larger; assumed
SHAPE = 4  # of the mass over diameters, a gamma distribution: numbers fall exponentially; assumed
SMALLEST = 1e-4  # m
MIST_DIAMETER = 1e-4  # m: the smallest drops behind a tyre, as thick as the sheets that they are of
MIST_LIFE = 4.0  # s: a cloud of 1 m settles at their fall speed of 0.27 m/s
REMEMBERED = 8.0  # s that mist is followed: 13 % of it are left, and leave
FLIGHT = 4.0  # s that drops fly at most
SLOWEST = 0.3  # m/s, below which water closes behind a tyre without being thrown; an assumption
PARCELS = 16  # drops of one size that fly together, of each way in each step

# How the four ways leave the tyre: assumptions, by eye after pictures of tyres on wet roads.
# Mean angle behind the contact at which tread and film let go; the wheel's housing takes what stays
# on longer.
LEAVES, GUARD = (math.radians(15.0), math.radians(30.0)), math.radians(40.0)
SPREAD = 0.08  # of the speed: sideways, of what the tread throws
AHEAD = math.radians(35.0), math.radians(80.0)  # of the bow wave, from straight ahead to the side
SIDE_SPEED, BOW_SPEED = (0.30, 0.70), (0.20, 0.50)  # of the tyre's speed
LOW, HIGH = math.radians(6.0), math.radians(32.0)  # of waves: over a film; over water as deep as
# the grooves, and deeper
CLEARANCE = 0.6  # of the radius: the highest that drops rise under the car
AIR_DRAG = 0.5  # of the first speed through the air: quadratic drag, linear at that share of it
RISE, SPAN = 0.30, 0.22  # of the root of the vehicle's section: the mist's height and deviation
WAKE, WAKE_TIME = 0.35, 0.5  # share of the speed with which the wake follows, and how long [s]
JOINED = (0.3, 1 / 12), (1.5, 1 / 6)  # s: mist older than the first is one puff for the second
STIRRED = 0.08  # m2/s, the turbulence that spreads mist


class Parcels(NamedTuple):
    """Drops of one size that fly together.

    Attributes
    ----------
    row, way : ndarray of shape (n,), int64
        Row of the table of throws; `BOW`, `SIDE`, `TREAD` or `FILM`.
    volume : ndarray of shape (n,), float64 [m3]
        Of all its drops.
    diameter : ndarray of shape (n,), float64 [m]
    begin : ndarray of shape (n,), float64 [s]
    start, velocity : ndarray of shape (n, 3), float64 [m], [m/s]
        When it is thrown.
    wind : ndarray of shape (n, 2), float64 [m/s]
    road : ndarray of shape (n,), float64 [m]
        Height of the ground below.
    id : ndarray of shape (n,), uint64
    age : ndarray of shape (n,), float64 [s]
        At which it comes down, see `landing_age`.
    """

    row: np.ndarray
    way: np.ndarray
    volume: np.ndarray
    diameter: np.ndarray
    begin: np.ndarray
    start: np.ndarray
    velocity: np.ndarray
    wind: np.ndarray
    road: np.ndarray
    id: np.ndarray
    age: np.ndarray

    def take(self, where):
        """Return the parcels at `where`, a mask or indices."""
        return Parcels(*(part[where] for part in self))


class Puffs(NamedTuple):
    """Clouds of drops, each a Gaussian in space.

    Attributes
    ----------
    place : ndarray of shape (n, 3), float64 [m]
    deviation : ndarray of shape (n,), float64 [m]
    section : ndarray of shape (n,), float64 [m2]
        Sum of the cross-sections of a cloud's drops.
    """

    place: np.ndarray
    deviation: np.ndarray
    section: np.ndarray


def column(table, name):
    """Return a column of a table of throws by its name in `io.states.THROW_COLUMNS`."""
    return table[:, AT[name]]


def thrown_rates(depth, width, speed):
    """Return the water that a tyre throws by each way [m3/s], ndarray of shape (..., 4).

    Parameters
    ----------
    depth : float or ndarray [m]
        Of the water that the tyre clears.
    width : float or ndarray [m]
    speed : float or ndarray [m/s]

    Notes
    -----
    With K the share of ribs, c the clinging film and g the depth of the grooves: b V K min(c, h)
    clings, b V (1 - K) min(g, h) is picked up, and bow wave and side waves share the other water
    equally. The sum is b V h.
    """
    depth, width, speed = np.broadcast_arrays(depth, width, speed)
    film = RIB_SHARE * np.minimum(CLINGING, depth)
    tread = (1 - RIB_SHARE) * np.minimum(GROOVE_DEPTH, depth)
    wave = np.maximum(0.5 * (depth - film - tread), 0.0)
    return np.stack([wave, wave, tread, film], axis=-1) * (width * speed)[..., None]


def mist_share(speed, section):
    """Return the share of each way's water that becomes mist, ndarray of shape (4,).

    Parameters
    ----------
    speed : float [m/s]
    section : float [m2]
        Of the cloud behind the vehicle. The spray density times section and speed is the mass that
        hangs in the air a second. That the section is the box's width times its height is an
        assumption.
    """
    density = MIST_SLOPE * (speed / MILES_PER_HOUR) + MIST_OFFSET  # s/m3
    return np.clip(density * section * speed, 0.0, MOST_MIST)


@device_function
def mean_diameter(speed):
    """Return the mean diameter [m] of drops that leave a groove at a speed [m/s].

    0.8 mm at the Weber number 2700 of the groove's width (6 m/s), and with the root of one over it.
    """
    weber = WATER_DENSITY * speed * speed * GROOVE_WIDTH / SURFACE_TENSION
    return MEAN_DIAMETER * math.sqrt(WEBER / max(weber, LEAST_WEBER))


def parcels_of(table, ids):
    """Return the `Parcels` of a table of throws and its ids (n,) uint64, for reading.

    Those of the last tables are kept: water that comes down is asked for first, its drops then.
    """
    return _parcels_of(np.ascontiguousarray(table).tobytes(), ids.tobytes())


@lru_cache(4)
def _parcels_of(table, ids):
    table = np.frombuffer(table).reshape(-1, len(THROW_COLUMNS))
    ids = np.frombuffer(ids, np.uint64)
    row, way, number = np.nonzero(np.ones((len(table), 4, PARCELS), bool))
    volume = table[row, AT["bow"] + way] / PARCELS
    there = volume > 0
    row, way, number, volume = (a[there] for a in (row, way, number, volume))
    count = len(row)
    words, begin, mean, size = np.empty(count, np.uint64), *np.empty((3, count))
    start, velocity = np.empty((2, count, 3))
    _throw(table.copy(), ids.copy(), row, way, number, words, begin, start, velocity, mean, size)
    diameter = np.clip(mean * gammaincinv(SHAPE, size), SMALLEST, LARGEST)
    wind, road = table[:, AT["wind_x"] : AT["wind_y"] + 1][row], column(table, "z")[row]
    parcels = Parcels(row, way, volume, diameter, begin, start, velocity, wind, road, words, None)
    return parcels._replace(age=landing_age(parcels))


@serial_kernel
def _throw(
    table, ids, row, way, number, words_out, begin_out, start_out, velocity_out, mean_out, size_out
):
    """Write how parcels leave: the number-th of each row of a table of throws and its way.

    Parameters
    ----------
    table : ndarray of shape (t, 22), float64
    ids : ndarray of shape (t,), uint64
    row, way, number : ndarray of shape (n,), int64
    words_out : ndarray of shape (n,), uint64
        Ids of the parcels.
    begin_out, start_out, velocity_out
        As `Parcels` has them.
    mean_out : ndarray of shape (n,), float64 [m]
        Mean diameter of drops of this way.
    size_out : ndarray of shape (n,), float64
        Share of their mass in smaller drops.
    """
    for n in range(len(row)):
        thrown = table[row[n]]
        word = subkey(subkey(ids[row[n]], way[n]), number[n])
        early, angle, aside = uniform_triple(word)
        quick, across, size = uniform_triple(mix(word ^ np.uint64(0x5A)))
        way_x, way_y = thrown[X_END] - thrown[X], thrown[Y_END] - thrown[Y]
        duration = thrown[END] - thrown[BEGIN]
        length = math.hypot(way_x, way_y)
        speed, share = length / duration, (number[n] + early) / PARCELS
        sense = 1.0 if number[n] % 2 == 0 else -1.0  # away from the car, under it
        forward, sideways, up, back, offset, high = _leaving(
            thrown, way[n], speed, sense, angle, aside, quick, across
        )
        for k, along in enumerate((way_x, way_y)):
            ahead, out = along / length, thrown[OUT + k]
            start_out[n, k] = thrown[X + k] + share * along - back * ahead + offset * out
            velocity_out[n, k] = forward * ahead + sideways * out
        start_out[n, 2], velocity_out[n, 2] = thrown[Z] + high, up
        words_out[n], begin_out[n] = word, thrown[BEGIN] + share * duration
        deep = min(thrown[DEPTH] / GROOVE_DEPTH, 1.0) if way[n] < TREAD else 0.0
        groove = mean_diameter(speed) * (1 + COARSER * deep)
        mean_out[n] = FILM_DIAMETER if way[n] == FILM else groove
        size_out[n] = (number[n] + size) / PARCELS


def on_their_way(parcels, time):
    """Return the parcels that were thrown up to `FLIGHT` before a time [s]."""
    there = (parcels.begin <= time) & (parcels.begin > time - FLIGHT)
    return parcels if there.all() else parcels.take(there)


def flying(table, ids, time):
    """Return the parcels of a table of throws and its ids that may fly at a time [s]."""
    return on_their_way(parcels_of(table, ids), time)


class KnownParcels:
    """The parcels of a table of throws that grows at its end and shrinks at its begin."""

    def __init__(self):
        self._ids, self._parcels, self._time = np.zeros(0, np.uint64), None, math.inf

    def flying(self, table, ids, time):
        """Return those of `flying` that are over the road.

        Only parcels of new rows are computed as long as time goes on.
        """
        first = int(np.argmax(self._ids == ids[0])) if len(ids) and len(self._ids) else 0
        old = self._ids[first:]
        count = len(old)
        goes_on = count > 0 and time >= self._time and np.array_equal(old, ids[:count])
        count = count if goes_on else 0
        parcels = parcels_of(table[count:], ids[count:])
        if goes_on:
            kept, new = self._parcels, parcels._replace(row=parcels.row + count)
            kept = kept._replace(row=kept.row - first)
            parcels = Parcels(*(np.concatenate(both) for both in zip(kept, new, strict=True)))
        above = (parcels.begin + parcels.age > time) & (parcels.row >= 0)
        self._ids, self._time = ids, time
        self._parcels = parcels.take(above)
        return on_their_way(self._parcels, time)


@device_function
def _leaving(thrown, way, speed, sense, angle, aside, quick, across):
    """Return how a parcel leaves the tyre, by random numbers of 0 to 1.

    Velocities ahead, to the side away from the car and up [m/s], and the place [m] behind the
    contact, to that side and above the road.
    """
    radius, width = thrown[RADIUS], thrown[WIDTH]
    if way >= TREAD:
        scale = LEAVES[0] if way == TREAD else LEAVES[1]
        # On the tyre, past the contact.
        turn = -scale * math.log1p(angle * math.expm1(-GUARD / scale))
        forward, sideways = speed * (1 - math.cos(turn)), SPREAD * speed * (2 * aside - 1)
        up, under = speed * math.sin(turn), thrown[COVERED] > 0
        back, offset, high = (
            radius * math.sin(turn), width * (across - 0.5), radius * (1 - math.cos(turn))
        )  # fmt: skip
    else:
        deep = min(thrown[DEPTH] / GROOVE_DEPTH, 1.0)
        lift = (LOW + (HIGH - LOW) * deep) * (0.5 + angle)
        azimuth, back, (slow, fast) = 0.5 * math.pi, 0.0, SIDE_SPEED
        if way == BOW:
            azimuth, back = AHEAD[0] + (AHEAD[1] - AHEAD[0]) * across, -0.3 * radius
            slow, fast = BOW_SPEED
        wave = speed * (slow + (fast - slow) * quick)
        forward = wave * math.cos(lift) * math.cos(azimuth)
        sideways = sense * wave * math.cos(lift) * math.sin(azimuth)
        up, under = wave * math.sin(lift), sense < 0
        offset, high = 0.5 * sense * width, 0.1 * radius * aside
    if under:
        up = min(up, math.sqrt(2 * GRAVITY * CLEARANCE * radius))
    return forward, sideways, up, back, offset, high


def flown(parcels, age):
    """Return place [m] and velocity [m/s] of parcels, (n, 3) each, some seconds after the throw.

    Notes
    -----
    Drag pulls the velocity towards that of a drop that falls in the wind, at the rate 1 / t with
    t = v^2 / (g (v + s w)), v the fall speed, w the first speed through the air and s `AIR_DRAG`:
    quadratic drag made linear, so that the path has a closed form.
    """
    place, velocity = np.empty_like(parcels.start), np.empty_like(parcels.start)
    _fly(parcels.diameter, parcels.wind, parcels.start, parcels.velocity, age, place, velocity)
    return place, velocity


@serial_kernel
def _fly(diameter, wind, start, velocity, age, place_out, velocity_out):
    """Write place and velocity of parcels at their age (n,) [s], see `flown`."""
    for n in range(len(age)):
        fall, own, ease = _flight(diameter[n], wind[n], velocity[n])
        gone = -math.expm1(-age[n] / ease)
        for k in range(3):
            falling = wind[n, k] if k < 2 else -fall
            place_out[n, k] = start[n, k] + falling * age[n] + own[k] * (ease * gone)
            velocity_out[n, k] = falling + own[k] * (1 - gone)


@device_function
def _flight(diameter, wind, velocity):
    """Return the fall in still air, the first velocity beyond that and t of `flown`."""
    fall = terminal_speed(diameter)
    x, y, z = velocity[0] - wind[0], velocity[1] - wind[1], velocity[2]
    through = math.sqrt(x * x + y * y + z * z)
    return fall, (x, y, z + fall), fall * fall / (GRAVITY * (fall + AIR_DRAG * through))


def landing_age(parcels):
    """Return how long [s] parcels fly before they come down on the road, at most `FLIGHT`."""
    age = np.empty(len(parcels.road))
    _find_landing(
        parcels.diameter, parcels.wind, parcels.start, parcels.velocity, parcels.road, age
    )
    return age


@serial_kernel
def _find_landing(diameter, wind, start, velocity, road, age_out):
    """Write when parcels come down, see `landing_age`."""
    for n in range(len(road)):
        fall, own, ease = _flight(diameter[n], wind[n], velocity[n])
        low, high = 0.0, FLIGHT
        for _ in range(36):  # to a nanosecond
            middle = 0.5 * (low + high)
            flies = own[2] * (ease * -math.expm1(-middle / ease)) - fall * middle
            if start[n, 2] + flies > road[n]:
                low = middle
            else:
                high = middle
        age_out[n] = high


def mist_left(table, time):
    """Return the mist [m3] of each row of a table of throws that still hangs in the air."""
    age = np.maximum(time - column(table, "end"), 0.0)
    return column(table, "mist") * np.exp(-age / MIST_LIFE)


def mist_puffs(table, time):
    """Return the mist of a table of throws at a time [s] as `Puffs`; older ones are joined."""
    begin = column(table, "begin")
    table = table[(column(table, "mist") > 0) & (begin <= time)]
    begin, end = column(table, "begin"), column(table, "end")
    age = np.maximum(time - 0.5 * (begin + end), 0.0)
    way = table[:, AT["x_end"] : AT["y_end"] + 1] - table[:, AT["x"] : AT["y"] + 1]
    side = np.sqrt(column(table, "section"))
    grown = -np.expm1(-age / WAKE_TIME)
    follows = 0.5 + WAKE * WAKE_TIME * grown / (end - begin)
    place = np.column_stack([
        table[:, AT["x"] : AT["y"] + 1] + follows[:, None] * way
        + age[:, None] * table[:, AT["wind_x"] : AT["wind_y"] + 1],
        column(table, "z") + 0.5 * column(table, "radius") + RISE * side * grown,
    ])  # fmt: skip
    first = 0.5 * column(table, "radius")
    variance = (first + (SPAN * side) * grown) ** 2 + 2 * STIRRED * age
    section = cross_section(mist_left(table, time), MIST_DIAMETER)
    return _joined(table, age, place, variance, section)


def _joined(table, age, place, variance, section):
    """Return `Puffs`; an axle's throws within a while, which grows with their age, are one puff."""
    bins = np.select([age > JOINED[1][0], age > JOINED[0][0]], [JOINED[1][1], JOINED[0][1]], 0.0)
    moment = np.where(bins > 0, np.floor(column(table, "begin") / np.maximum(bins, 1e-9)), 0.0)
    alone = np.where(bins > 0, 0.0, 1.0 + np.arange(len(table)))
    key = np.stack([alone, moment, bins, column(table, "covered"), column(table, "car")])
    order = np.lexsort(key)  # `np.unique` of rows takes four times as long
    which = np.empty(len(order), np.int64)
    which[order] = (np.diff(key[:, order], prepend=np.nan) != 0).any(axis=0).cumsum() - 1
    weight = np.bincount(which, section)

    def mean(values):
        return np.bincount(which, section * values) / weight

    middle = np.column_stack([mean(place[:, k]) for k in range(3)])
    apart = ((place - middle[which]) ** 2).sum(axis=1) / 3
    return Puffs(middle, np.sqrt(mean(variance + apart)), weight)


def cross_section(volume, diameter):
    """Return the summed cross-section [m2] of a volume [m3] of drops of one diameter [m]."""
    return 1.5 * volume / diameter
