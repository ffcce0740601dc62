"""Where the tyres of cars have rolled in the last seconds, and the water that they met there.

All of it follows from the cars' tracks, a time and the water of that time, so that a picture needs
none before it. The simulated water knows no tyres.
"""

from typing import NamedTuple

import numpy as np

from rainsim.actors.wheels import MOST_WHEELS, REMEDY
from rainsim.errors import ParameterError
from rainsim.numerics.random import mix, subkey
from rainsim.rain.wind import wind_at

TICK = 1 / 24  # s: within it a tyre rolls straight at one speed
REMEMBERED = 12.0  # s that tracks and mist are followed
SLOWEST = 0.3  # m/s, below which water closes behind a tyre without being thrown; an assumption
FASTEST = 100.0  # m/s, 360 km/h: what is faster is a track that jumps or a wrong scale
OFF_THE_ROAD = 0.3  # m: a wheel farther from the ground of the map stands on something else
LEFT = 1e-4  # m of water that stays in the road's texture under a tyre; an assumption
FOLLOWS = 0.15  # share of the water that a tyre finds in the track of one before it; an assumption
WIND_AT = 1.0  # m: height of the wind that carries drops and mist
ALONG, ACROSS = (np.arange(4) + 0.5) / 4, np.array([-1, 0, 1]) / 3  # where the water is looked up


class Rolls(NamedTuple):
    """Ways of tyres over the ground: n rows, one for each tyre in each step of TICK."""

    tick: np.ndarray  # (n,), int64: the step begins at `tick` times TICK [s]
    car: np.ndarray  # (n,), int64, number of the car
    id: np.ndarray  # (n,), uint64
    begin: np.ndarray  # (n, 3), m, of the way of the contact patch
    end: np.ndarray  # (n, 3), m
    out: np.ndarray  # (n, 2), unit vector across the way, away from the car's middle
    width: np.ndarray  # (n,), m
    radius: np.ndarray  # (n,), m
    covered: np.ndarray  # (n,), bool: whether the car's floor is behind the tyre
    section: np.ndarray  # (n,), m2, of the car's box, seen from behind
    water: np.ndarray  # (n,), m, depth of what the tyre clears
    wind: np.ndarray  # (n, 2), m/s, that carries what is thrown

    @property
    def way(self):
        """Horizontal vectors from begin to end, ndarray of shape (n, 2) [m]."""
        return (self.end - self.begin)[:, :2]

    @property
    def speed(self):
        """Speeds of the tyres, ndarray of shape (n,) [m/s]."""
        return np.hypot(*self.way.T) / TICK

    def take(self, where):
        """Return the rows at `where`, a mask or indices."""
        return Rolls(*(part[where] for part in self))


def cars_of(footprints, render):
    """Return the motions of actors with tyres; none if spray is off; ParameterError if unfit."""
    if render.spray == "off":
        return []
    cars = [footprint.motion for footprint in footprints if len(footprint.motion.wheels)]
    for car in cars:
        speed = car.speeds()
        if len(speed) and speed.max() > FASTEST:
            k, actor = int(speed.argmax()), car.actor
            raise ParameterError(
                f"actor {actor.id} moves at {speed[k]:.4g} m/s from {actor.track.time[k]:g} s on; "
                f"what has tyres must move at {FASTEST:g} m/s at most; {REMEDY}, or hide it there"
            )
    return cars


def rolled(cars, terrain, depth, film, time, weather, rain):
    """Return the `Rolls` of cars, see `cars_of`, in the seconds before a time [s].

    The last step of a tyre may end after that time. The ground has water of a `depth` (ny, nx) [m],
    at the least the film that it holds times the share `film` (ny, nx); `rain` is the RainConfig.
    """
    ticks = np.arange(np.floor((time - REMEMBERED) / TICK), np.floor(time / TICK) + 1)
    wind = np.array([weather.wind(tick * TICK) for tick in ticks])
    wind *= float(wind_at(WIND_AT, rain.roughness))
    key = mix(np.array([rain.seed % 2**64], np.uint64) ^ np.uint64(0x7912E5))
    ticks = ticks.astype(np.int64)
    found = [_rolls_of(number, car, ticks, wind, key) for number, car in enumerate(cars)]
    rolls = Rolls(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
    middle = 0.5 * (rolls.begin + rolls.end)
    row, column, inside = terrain.grid.cells(middle[:, 0], middle[:, 1])
    inside &= np.abs(terrain.bed[row, column] - middle[:, 2]) < OFF_THE_ROAD
    rolls = rolls.take(inside)
    along = ALONG[:, None, None] * rolls.way
    across = (ACROSS[:, None] * rolls.width)[..., None] * rolls.out
    places = rolls.begin[:, :2] + along[:, None] + across
    *cell, inside = terrain.grid.cells(places[..., 0], places[..., 1])
    cell = tuple(cell)
    water = np.maximum(depth[cell], film[cell] * terrain.by_class("storage", cell))
    cleared = np.maximum(water - LEFT, 0.0) * inside
    return rolls._replace(water=rolls.water * cleared.mean(axis=(0, 1)))


def _rolls_of(number, car, ticks, wind, key):
    """Return the `Rolls` of one car; `water` is the share of it that a tyre finds."""
    rotation, position, there = car.came(np.append(ticks, ticks[-1] + 1) * TICK)
    wheels, (centre, size) = car.wheels, car.box
    places = np.einsum("tij,wj->twi", rotation, wheels[:, :3]) + position[:, None]
    begin, end = places[:-1], places[1:]
    length = np.hypot(*np.moveaxis((end - begin)[..., :2], -1, 0))
    step, wheel = np.nonzero((there[:-1] & there[1:])[:, None] & (length > SLOWEST * TICK))
    begin, end, length = (a[step, wheel] for a in (begin, end, length))
    middle = (rotation @ centre + position)[step + 1, :2]
    out = (begin - end)[:, [1, 0]] * (1, -1) / length[:, None]
    away = ((end[:, :2] - middle) * out).sum(axis=1)
    out *= np.where(away < 0, -1.0, 1.0)[:, None]
    x, width, radius = wheels[:, 0], wheels[wheel, 3], wheels[wheel, 4]
    covered, leads = (x > x.min() + 0.5 * wheels[:, 4])[wheel], (x > x.max() - 0.1)[wheel]
    ids = subkey(subkey(key, number * MOST_WHEELS + wheel), ticks[step])
    cars, section = np.full(len(step), number), np.full(len(step), size[1] * size[2])
    finds = np.where(leads, 1.0, FOLLOWS)
    return Rolls(
        ticks[step], cars, ids, begin, end, out, width, radius, covered, section, finds, wind[step]
    )
