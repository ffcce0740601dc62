"""Spray of tyres: how much water of the road they throw, by which way, and how it flies.

A tyre that rolls over water of depth h clears it from its path. Four ways share it (Weir, Strange
and Heffley 1978): the bow wave ahead of the tyre, the side waves, what the grooves of the tread
pick up, and the film that clings to the rubber between them (capillary adhesion). A part of each
becomes mist, which hangs behind the car; the other drops fly on their own. Here both waves are one.

References
----------
The rates are those of Weir, Strange and Heffley (1978, "Reduction of adverse aerodynamic effects of
large trucks", FHWA-RD-79-84) in the form that the splash and spray assessment tool took over
(Flintsch et al. 2014, FHWA-HRT-15-062). Both were at hand second hand only, as a public program
that states them. Drop sizes are those that Radovich and Browand measured behind a tyre's groove
(Radovich 2009, thesis, University of Southern California, its abstract). What is an assumption says
so beside its number.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv

from rainsim.constants import GRAVITY, SURFACE_TENSION, WATER_DENSITY
from rainsim.numerics.places import group_means
from rainsim.numerics.random import mix, subkey, uniform_triple
from rainsim.rain.size_distribution import LARGEST, terminal_speed
from rainsim.rain.tyres import TICK

WAYS = WAVE, TREAD, FILM = range(3)
RIB_SHARE = 0.75  # of a tyre's width that is rubber and not groove
CLINGING = 1e-4  # m of water that clings to the rubber
GROOVE_DEPTH = 8e-3  # m, of a new tyre: what the tread can hold
MILES_PER_HOUR = 0.44704  # m/s
# Spray density [kg/m3] beside a vehicle over the mass rate [kg/s] of bow wave, side waves, tread
# and film, against the speed V [miles/h]: slope V + offset [s/m3]. Measured at trucks; where it is
# negative there is none.
MIST_SLOPE = np.array([2.67e-5, 1.65e-5, 1.16e-5, -2.69e-5])
MIST_OFFSET = np.array([-4.71e-4, -3.99e-4, -5.25e-5, 2.43e-3])
MOST_MIST = 0.5  # share of a way; beyond the speeds that were measured
# Mean diameter of drops from a groove at its Weber number; sizes go with the root of one over it.
MEAN_DIAMETER, WEBER, GROOVE_WIDTH = 0.8e-3, 2700.0, 5.5e-3  # m, 1, m
LARGEST_MEAN = 1.5e-3  # m; an assumption: below 3 m/s no sizes were measured
FILM_DIAMETER = 1e-4  # m, mean of drops of the clinging film, its own thickness; an assumption
COARSER = 1.0  # share by which drops of waves of water as deep as the grooves are larger; assumed
SMALLEST = 1e-4  # m
MIST_DIAMETER = 1e-4  # m: the smallest drops behind a tyre, as thick as the sheets that they are of
MIST_LIFE = 4.0  # s: a cloud of 1 m settles at their fall speed of 0.27 m/s
FLIGHT = 2.0  # s that drops fly at most
PARCELS = 16  # drops of one size that fly together, of each way in each step
# Their diameters over the mean: of a gamma distribution of the mass with the shape 4, whose numbers
# fall exponentially (assumed); not in the order in which they leave.
SIZES = gammaincinv(4, (5 * np.arange(PARCELS) % PARCELS + 0.5) / PARCELS)

# How the water leaves the tyre: assumptions, by eye after pictures of tyres on wet roads.
# Mean angle behind the contact at which tread and film let go (a wave does not cling); the wheel's
# housing takes what stays on longer.
LEAVES, GUARD = np.radians([15.0, 15.0, 30.0]), math.radians(40.0)
SPREAD = 0.08  # of the speed: sideways, of what the tread throws
AHEAD = math.radians(35.0), math.radians(90.0)  # of waves, from straight ahead to the side
WAVE_SPEED = 0.20, 0.70  # of the tyre's speed
LOW, HIGH = math.radians(6.0), math.radians(32.0)  # of waves: over a film; over water as deep as
# the grooves, and deeper
CLEARANCE = 0.6  # of the radius: the highest that drops rise under the car
AIR_DRAG = 0.5  # of the first speed through the air: quadratic drag, linear at that share of it
RISE, SPAN = 0.30, 0.22  # of the root of the vehicle's section: the mist's height and deviation
WAKE, WAKE_TIME = 0.35, 0.5  # share of the speed with which the wake follows, and how long [s]
JOINED, TOGETHER = 0.8, 4  # s: mist older than that is one puff for so many steps of a car
STIRRED = 0.08  # m2/s, the turbulence that spreads mist


class Parcels(NamedTuple):
    """Drops of one size that fly together, n of them at one time."""

    place: np.ndarray  # (n, 3), m
    velocity: np.ndarray  # (n, 3), m/s
    flown: np.ndarray  # (n,), m, distance from where they were thrown
    diameter: np.ndarray  # (n,), m
    number: np.ndarray  # (n,), float64, of drops
    road: np.ndarray  # (n,), m, height of the ground below
    id: np.ndarray  # (n,), uint64

    def take(self, where):
        """Return the parcels at `where`, a mask or indices."""
        return Parcels(*(part[where] for part in self))


class Puffs(NamedTuple):
    """Clouds of drops, each a Gaussian in space."""

    place: np.ndarray  # (n, 3), m
    deviation: np.ndarray  # (n,), m
    section: np.ndarray  # (n,), m2, sum of the cross-sections of a cloud's drops


def thrown_rates(depth, width, speed):
    """Return the water that a tyre throws by each of the four ways [m3/s], ndarray (..., 4).

    It clears water of a depth [m] over its width [m] at a speed [m/s]. With K the share of ribs, c
    the clinging film and g the depth of the grooves: b V K min(c, h) clings, b V (1 - K) min(g, h)
    is picked up, and bow wave and side waves share the other water equally. The sum is b V h.
    """
    film = RIB_SHARE * np.minimum(CLINGING, depth)
    tread = (1 - RIB_SHARE) * np.minimum(GROOVE_DEPTH, depth)
    wave = np.maximum(0.5 * (depth - film - tread), 0.0)
    return np.stack([wave, wave, tread, film], axis=-1) * np.asarray(width * speed)[..., None]


def mist_share(speed, section):
    """Return the share of each of the four ways' water that becomes mist, ndarray (..., 4).

    The spray density times speed [m/s] and section [m2] of the cloud behind the vehicle is the mass
    that hangs in the air a second. That the section is the box's width times its height is an
    assumption.
    """
    density = np.multiply.outer(speed, MIST_SLOPE / MILES_PER_HOUR) + MIST_OFFSET  # s/m3
    return np.clip(density * np.asarray(section * speed)[..., None], 0.0, MOST_MIST)


def mean_diameter(speed):
    """Return the mean diameter [m] of drops that leave a groove at a speed [m/s].

    0.8 mm at the Weber number 2700 of the groove's width (6 m/s), and with the root of one over it.
    """
    weber = WATER_DENSITY * speed * speed * GROOVE_WIDTH / SURFACE_TENSION
    return np.minimum(MEAN_DIAMETER * np.sqrt(WEBER / np.maximum(weber, 1.0)), LARGEST_MEAN)


def thrown_by(rolls):
    """Return what `Rolls` threw: drops of each of WAYS (n, 3), and mist (n,) [m3]."""
    volume = thrown_rates(rolls.water, rolls.width, rolls.speed) * TICK
    mist = volume * mist_share(rolls.speed, rolls.section)
    bow, side, tread, film = (volume - mist).T
    return np.column_stack([bow + side, tread, film]), mist.sum(axis=1)


def flying(rolls, time):
    """Return the `Parcels` of drops of `Rolls` that are in the air at a time [s].

    Drag pulls the velocity towards that of a drop that falls in the wind, at the rate 1 / t with
    t = v^2 / (g (v + s w)), v the fall speed, w the first speed through the air and s `AIR_DRAG`:
    quadratic drag made linear, so that the path has a closed form.
    """
    rolls = rolls.take((rolls.tick + 1) * TICK > time - FLIGHT)
    volume, _ = thrown_by(rolls)
    row, way, number = np.nonzero(volume[:, :, None] > np.zeros(PARCELS))
    ids = subkey(subkey(rolls.id[row], way), number)
    share = (number + uniform_triple(ids)[0]) / PARCELS
    age = time - (rolls.tick[row] + share) * TICK
    there = (age >= 0) & (age < FLIGHT)
    row, way, number, ids, share, age = (a[there] for a in (row, way, number, ids, share, age))
    rolls, volume = rolls.take(row), volume[row, way] / PARCELS
    start, velocity, mean = _leaving(rolls, way, number, share, ids)
    diameter = np.clip(mean * SIZES[number], SMALLEST, LARGEST)
    falling = np.column_stack([rolls.wind, -terminal_speed(diameter)])
    own = velocity - falling
    fall, through = -falling[:, 2], np.linalg.norm(own + (0, 0, 1) * falling, axis=1)
    ease = fall * fall / (GRAVITY * (fall + AIR_DRAG * through))
    gone = -np.expm1(-age / ease)
    flown = falling * age[:, None] + own * (ease * gone)[:, None]
    number = volume / (math.pi / 6 * diameter**3)
    parcels = Parcels(
        start + flown, falling + own * (1 - gone)[:, None], np.linalg.norm(flown, axis=1), diameter,
        number, rolls.begin[:, 2], ids,
    )  # fmt: skip
    return parcels.take(parcels.place[:, 2] > parcels.road)


def _leaving(rolls, way, number, share, ids):
    """Return where parcels leave the tyre [m], their velocity [m/s], and mean diameters [m].

    The number-th of each way, a `share` of the step after its begin.
    """
    angle, aside, quick = uniform_triple(mix(ids ^ np.uint64(0x5A)))
    speed, is_wave = rolls.speed, way == WAVE
    ahead = rolls.way / (speed * TICK)[:, None]
    # On the tyre, past the contact.
    turn = -LEAVES[way] * np.log1p(angle * np.expm1(-GUARD / LEAVES[way]))
    deep = np.minimum(rolls.water / GROOVE_DEPTH, 1.0)
    lift = (LOW + (HIGH - LOW) * deep) * (0.5 + angle)
    azimuth = AHEAD[0] + (AHEAD[1] - AHEAD[0]) * aside
    swift = speed * (WAVE_SPEED[0] + (WAVE_SPEED[1] - WAVE_SPEED[0]) * quick)
    sense = np.where(number % 2 == 0, 1.0, -1.0)  # away from the car, under it
    level = swift * np.cos(lift)
    forward = np.where(is_wave, level * np.cos(azimuth), speed * (1 - np.cos(turn)))
    sideways = np.where(is_wave, sense * level * np.sin(azimuth), SPREAD * speed * (2 * aside - 1))
    up = np.where(is_wave, swift * np.sin(lift), speed * np.sin(turn))
    highest = np.sqrt(2 * GRAVITY * CLEARANCE * rolls.radius)
    up = np.where(np.where(is_wave, sense < 0, rolls.covered), np.minimum(up, highest), up)
    back = np.where(is_wave, 0.0, rolls.radius * np.sin(turn))
    offset = rolls.width * np.where(is_wave, 0.5 * sense, quick - 0.5)
    high = rolls.radius * np.where(is_wave, 0.1 * angle, 1 - np.cos(turn))
    start = rolls.begin + share[:, None] * (rolls.end - rolls.begin)
    start[:, :2] += offset[:, None] * rolls.out - back[:, None] * ahead
    start[:, 2] += high
    velocity = np.column_stack([forward[:, None] * ahead + sideways[:, None] * rolls.out, up])
    coarse = np.where(is_wave, 1 + COARSER * deep, 1.0)
    return start, velocity, np.where(way == FILM, FILM_DIAMETER, coarse * mean_diameter(speed))


def mist_puffs(rolls, time):
    """Return the mist of `Rolls` that hangs in the air at a time [s]; older puffs are joined."""
    came = np.clip(time / TICK - rolls.tick, 0.0, 1.0)  # share of the last step's
    mist = thrown_by(rolls)[1] * came
    rolls, came, mist = rolls.take(mist > 0), came[mist > 0], mist[mist > 0]
    age = np.maximum(time - (rolls.tick + 0.5) * TICK, 0.0)
    side, first = np.sqrt(rolls.section), 0.5 * rolls.radius
    grown = -np.expm1(-age / WAKE_TIME)
    follows = 0.5 * came + WAKE * WAKE_TIME / TICK * grown
    place = rolls.begin + follows[:, None] * (rolls.end - rolls.begin)
    place[:, :2] += age[:, None] * rolls.wind
    place[:, 2] = rolls.begin[:, 2] + first + RISE * side * grown
    variance = (first + SPAN * side * grown) ** 2 + 2 * STIRRED * age
    section = 1.5 * mist * np.exp(-age / MIST_LIFE) / MIST_DIAMETER
    # A step's puff of each tyre by itself, then those of a car's steps together.
    joined = (rolls.tick + TOGETHER) * TICK < time - JOINED
    alone = np.where(joined, 0, 1 + np.arange(len(joined)))
    key = np.column_stack([alone, rolls.car * joined, rolls.tick // TOGETHER * joined])
    _, which = np.unique(key, axis=0, return_inverse=True)
    middle = group_means(which, place, section)
    apart = ((place - middle[which]) ** 2).sum(axis=1) / 3
    wide = group_means(which, (variance + apart)[:, None], section)[:, 0]
    return Puffs(middle, np.sqrt(wide), np.bincount(which, section))
