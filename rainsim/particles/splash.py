"""Splashes: whether an impact throws up droplets, and which, as a function of the impact alone.

Whether a drop splashes follows published thresholds. How high its droplets fly is set to what was
measured, with the drag of the air. Its crown's size (see `crown`), how many droplets it throws and
how big they are is set by eye, not validated against measurement.
Splashes are drawn (see `splash_pass`) and forgotten: their water (a few percent of the drop's)
stays booked where the drop fell.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import GRAVITY, SURFACE_TENSION, WATER_DENSITY, WATER_VISCOSITY
from rainsim.jit import device_function
from rainsim.numerics.random import subkey, uniform_triple
from rainsim.particles.line_raster import FAINTEST

LONGEST_LIFE = 0.42  # s; impacts older than this have no droplets in the air any more
SMALLEST_SPLASH = 0.65e-3  # m; smaller drops at terminal speed splash on nothing
SMALLEST_ON_FILM = 1.24e-3  # m; smaller drops at terminal speed do not splash on a film
WET_FILM = 2e-4  # m of water on everything that rain has wetted; a guess
WET_DEPTH = 1e-4  # m; less water than this on the ground counts as a dry rough surface
WEBER_ON_FILM = 400.0  # splash threshold on a film, sqrt(We) = 20
LARGEST_SHARE = 0.20  # of the drop's diameter, which no droplet exceeds
_SMALLEST_SHARE = 0.06
_MUNDO_DRY = 57.7  # splash threshold on a rough dry wall, sqrt(We) Re^(1/4)
# Time of a droplet's flight over the drop's fall speed [s2/m], least and greatest: droplets of a
# drop of 5 mm fly up to 0.41 s and 20 cm high, half of them over 7 cm, those of 2 mm up to 0.29 s
# and 10 cm; they leave at 0.5 to 4.4 m/s. Droplets of 4 and 5 mm drops on a film were caught up to
# 70 cm high, most between 15 and 20 cm (Fitt and Lysandrou 1984, J. Phytopathology 111, 323, the
# abstract); most are under 0.1 mm, which no camera sees, and not drawn here.
_LEAST_FLIGHT, _MOST_FLIGHT = 0.010, 0.045
# s/m: time in which air takes over a droplet's motion, over its diameter: fall speed over gravity,
# with a fall speed of 4000 diameters a second from 0.08 to 1.2 mm (Rogers and Yau 1989, A Short
# Course in Cloud Physics, chapter 8)
_RELAXATION = 4000.0 / GRAVITY
_FEWEST, _MOST = 4, 12  # droplets per splash
_WEBER_STEP = 150.0  # Weber number per further droplet
_DEPTH_OF_PEAK = 1 / 3  # film depth over diameter at which splashes are largest
_DEPTH_OF_POOL = 3.0  # and from which on they no longer change
_SIZE_DRY, _SIZE_POOL = 0.6, 0.75  # relative to the largest splash
_LEAST_SPREAD, _MOST_SPREAD = 0.5, 1.1  # horizontal over vertical speed: 63 to 42 degrees up
_CARRIED = 0.15  # share of the drop's horizontal velocity that droplets keep
_FULL_TURN = 2 * np.pi
_DROPLET_SPEED = 1.2  # m/s, of a droplet, typically


class Impact(NamedTuple):
    """A drop that has met a surface.

    key : uint64. The drop's id: the random word that its splash comes from.
    x, y, z : float64 [m]
    vx, vy, speed : float64 [m/s]. Horizontal velocity and fall speed.
    diameter : float64 [m]
    depth : float64 [m]. Of the water that it met.
    age : float64 [s]. From the impact to the opening of the shutter; negative if
        the impact comes later.
    """

    key: int
    x: float
    y: float
    z: float
    vx: float
    vy: float
    speed: float
    diameter: float
    depth: float
    age: float


@device_function
def weber_number(diameter, speed):
    """Return inertia over surface tension of a drop [m] at a speed [m/s]; numbers or arrays."""
    return WATER_DENSITY * speed**2 * diameter / SURFACE_TENSION


@device_function
def splashes_on(depth, diameter, speed):
    """Tell whether a drop splashes on water of some depth; numbers or arrays.

    speed : float or ndarray [m/s]. Of the fall: also on sloping ground and on the
        sides of objects.

    On a film sqrt(We) > 20 (Vander Wal, Berger and Mozes 2006, Exp. Fluids 40, 53); on a dry rough
    surface K = sqrt(We) Re^(1/4) > 57.7 (Mundo, Sommerfeld and Tropea 1995, Int. J. Multiphase
    Flow 21, 151).
    """
    weber = weber_number(diameter, speed)
    mundo = np.sqrt(weber) * (speed * diameter / WATER_VISCOSITY) ** 0.25
    on_film = (depth > WET_DEPTH) & (weber > WEBER_ON_FILM)
    return on_film | (depth <= WET_DEPTH) & (mundo > _MUNDO_DRY)


@device_function
def droplets_of(diameter, speed):
    """Return how many droplets a splash throws, a float that is to be cut; numbers or arrays."""
    wanted = _FEWEST + (weber_number(diameter, speed) - WEBER_ON_FILM) / _WEBER_STEP
    return np.minimum(np.maximum(wanted, float(_FEWEST)), float(_MOST))


@device_function
def longest_flight(speed):
    """Return how long [s] droplets of a drop that fell at `speed` [m/s] fly; numbers or arrays."""
    return np.minimum(_MOST_FLIGHT * speed, LONGEST_LIFE)


@device_function
def least_seen(pixel, exposure):
    """Return the diameter [m] of a droplet in flight that replaces FAINTEST of a pixel's light."""
    way = np.maximum(_DROPLET_SPEED * exposure / pixel, 1.0)  # px
    return pixel * np.sqrt(4 / math.pi * FAINTEST * way)


@device_function
def relative_size(depth_over_diameter):
    """Return the size of a splash over the largest that such a drop makes.

    Mutchler and Hansen 1970, Science 169, 1311: largest on water as deep as a third of the
    diameter, constant from three diameters on. The two levels relative to the peak are guesses.
    """
    rise = np.minimum(depth_over_diameter / _DEPTH_OF_PEAK, 1.0)
    fall = (depth_over_diameter - _DEPTH_OF_PEAK) / (_DEPTH_OF_POOL - _DEPTH_OF_PEAK)
    fall = np.minimum(np.maximum(fall, 0.0), 1.0)
    return _SIZE_DRY + (1 - _SIZE_DRY) * rise - (1 - _SIZE_POOL) * fall


@device_function
def droplet(impact, n, count, size, exposure):
    """Return droplet n of a splash as an exposure sees it.

    A droplet leaves at the impact's place and time and lives as long as its flight back to that
    height lasts. The air takes over its motion in a time tau: dv/dt = -g - v / tau, which is exact
    for the fall speed and brakes the fast start of the flight too little.

    n, count : int. Its number, and how many droplets there are.
    exposure : float [s]. 0 for a moment. With an exposure the velocity is the way
        during the exposure over the exposure, and the diameter that of the disc
        that covers as much for all of the exposure as the droplet does while it
        lives.
    Returns seen : bool. Whether it is in the air at any time of the exposure.
        x, y, z, vx, vy, vz, diameter : float64. [m], [m/s]; the place is that at
            which it is first seen.
        id : uint64. The same in every frame.
    """
    word = subkey(impact.key, -1 - n)
    flight, spread, chance = uniform_triple(word)
    jitter, _, _ = uniform_triple(subkey(word, 0))
    share = _SMALLEST_SHARE + (LARGEST_SHARE - _SMALLEST_SHARE) * chance * chance
    diameter = share * impact.diameter * size
    life = (_LEAST_FLIGHT + (_MOST_FLIGHT - _LEAST_FLIGHT) * flight) * impact.speed
    life = min(life, LONGEST_LIFE)
    tau = _RELAXATION * diameter
    # At the height that it left when its life ends: (up + g tau) (1 - exp(-life / tau)) = g life.
    driven = GRAVITY * life / (1.0 - np.exp(-life / tau))
    up = driven - GRAVITY * tau
    out = up * (_LEAST_SPREAD + (_MOST_SPREAD - _LEAST_SPREAD) * spread)
    angle = _FULL_TURN * (n + jitter) / count
    vx = out * np.cos(angle) + _CARRIED * impact.vx
    vy = out * np.sin(angle) + _CARRIED * impact.vy
    begin, end = max(impact.age, 0.0), min(impact.age + exposure, life)
    left = np.exp(-begin / tau)
    way, part, vz = tau * (1.0 - left), 1.0, driven * left - GRAVITY * tau
    x, y, z = vx * way, vy * way, driven * way - GRAVITY * tau * begin
    if exposure > 0.0:
        last = max(end, begin)
        further = tau * (left - np.exp(-last / tau))
        part, left = (last - begin) / exposure, further / exposure
        vz = (driven * further - GRAVITY * tau * (last - begin)) / exposure
    return (
        impact.age < life and end >= begin, impact.x + x, impact.y + y, impact.z + z, vx * left,
        vy * left, vz, diameter * np.sqrt(part), word,
    )  # fmt: skip
