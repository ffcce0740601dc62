"""Falling drops without state: which drops are where at any time, and where they hit.

All drops of a size class have one velocity. Seen from a frame that moves with the class they stand
still: a frozen Poisson field. That frame is cut into cubes; a counter-based hash of (seed, class,
cube) says how many drops a cube holds, and of (cube, drop) where each is and how big. So the drops
in any box of air at any time, or the hits in any interval, can be listed alone, without history.

A wind that changes in time keeps that: all drops of the air are carried by its integral, so that
places are continuous; only within one interval is it taken as steady. A rain that changes keeps
the drops of the heaviest rain and leaves some out by their ids; whether a drop is there depends on
the rate at the time when it passes z = 0, so that no drop ever appears or vanishes in the air.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rainsim.errors import ParameterError, require_finite, require_not_negative
from rainsim.jit import cpu_kernel, prange
from rainsim.numerics.random import poisson_tables
from rainsim.rain import poisson_cells
from rainsim.rain.heightfield import GROUND, OBSTACLE, Surfaces, flat_surfaces
from rainsim.rain.impacts import Impacts, fill_impacts, run_listing
from rainsim.rain.size_distribution import CLASSES, RainSpectrum, drop_volume
from rainsim.rain.wind import wind_shares

__all__ = [
    "GROUND", "OBSTACLE", "Drops", "Impacts", "RainField", "RainSpectrum", "Surfaces", "Weather",
    "drop_volume", "flat_surfaces", "impacts",
]  # fmt: skip

MARGIN = 2.0  # s before the first keyframe and after the last that drops aloft may need
TICK = 0.05  # s, between the times at which the share of drops is tabled; linear between
MOST_TICKS = 4096
GUST_PERIODS = (2.3, 5.1, 11.7)  # s; by eye: gusts of some seconds are what a video shows
GUST_SHARES = (0.45, 0.6, 0.66)  # of the gustiness; their squares sum to 1
_STEEP = 4.0  # room for hits per hit on level ground; walls in wind catch more than their area


class Weather:
    """The rain and the wind of a configuration's timeline at any time."""

    def __init__(self, config):
        self._seed, self._radii = config.rain.seed, config.rain.drop_radii
        times = config.key_times()
        states = [config.at(time) for time in times]
        self._times = np.array(times)
        self._rates = np.array([s.rain.rate for s in states]) * 3.6e6  # mm/h
        self._winds = np.array([s.rain.wind_velocity for s in states])
        self._gusts = config.rain.gusts
        phases = np.random.Generator(np.random.PCG64(self._seed + 1)).random(len(GUST_PERIODS))
        self._phases = 2 * math.pi * phases
        self.rains = bool(self._rates.max() > 0)
        self._steady = len(times) == 1
        self._only = None  # the field of steady rain in steady wind
        self._roughness = config.rain.roughness
        if self.rains:
            self._heaviest = self._spectrum(self._rates.max())
            self._share, self._clock = self._shares()
            self._follow = wind_shares(self._heaviest.speed, self._roughness)

    @property
    def mean_rate(self):
        """Rain rate [mm/h] over the keyframes that have rain; 0 without any."""
        return float(self._rates[self._rates > 0].mean()) if self.rains else 0.0

    def rate(self, time):
        """Rain rate [mm/h] at a time [s]."""
        return float(np.interp(time, self._times, self._rates))

    def fallen(self, time):
        """Depth of the rain [m] from time 0 to `time` [s]."""
        times = np.unique(np.clip([0.0, *self._times, time], 0.0, time))
        rates = np.interp(times, self._times, self._rates)
        return float(np.trapezoid(rates, times)) / 3.6e6

    def field(self, start, stop):
        """Return the `RainField` of the interval from `start` to `stop` [s], or None without rain.

        The field's spectrum is the rain's in the middle of the interval; fog and the drops too fine
        to track are computed from it.
        """
        if not self.rains:
            return None
        if self._steady and self._gusts == 0:
            if self._only is None:
                self._only = RainField(
                    self._heaviest, self._winds[0], self._seed, follow=self._follow
                )
            return self._only
        here, there = self.drift(start), self.drift(stop)
        wind = (there - here) / (stop - start)
        return RainField(
            self._spectrum(self.rate(0.5 * (start + stop))), wind, self._seed,
            offset=here - wind * start, heaviest=self._heaviest, share=self._share,
            clock=self._clock, follow=self._follow,
        )  # fmt: skip

    def wind(self, time):
        """Wind (x, y) [m/s] at WIND_HEIGHT at a time [s], gusts and all."""
        if self._steady and self._gusts == 0:
            return self._winds[0]
        base = np.array([np.interp(time, self._times, self._winds[:, a]) for a in (0, 1)])
        swing = sum(
            share * math.sin(2 * math.pi * time / period + phase)
            for share, period, phase in zip(GUST_SHARES, GUST_PERIODS, self._phases, strict=True)
        )
        return base * (1 + self._gusts * swing)

    def drift(self, time):
        """Return how far the wind has carried the air since time 0, ndarray of shape (2,) [m]."""
        return self._travel(time) - self._travel(0.0)

    def _travel(self, time):
        """Integral of the wind from the first keyframe to `time`, in closed form piece by piece."""
        begin = self._times[0]
        knots = self._times[(self._times > min(begin, time)) & (self._times < max(begin, time))]
        points = np.concatenate([[begin], knots if time > begin else knots[::-1], [time]])
        total = np.zeros(2)
        for a, b in pairwise(points):
            if a == b:
                continue
            ends = [
                np.array([np.interp(t, self._times, self._winds[:, i]) for i in (0, 1)])
                for t in (a, b)
            ]
            slope = (ends[1] - ends[0]) / (b - a)
            total += (b - a) * 0.5 * (ends[0] + ends[1])
            for share, period, phase in zip(GUST_SHARES, GUST_PERIODS, self._phases, strict=True):
                omega = 2 * math.pi / period
                for t, end, sign in ((a, ends[0], -1.0), (b, ends[1], 1.0)):
                    angle = omega * t + phase
                    part = -end * math.cos(angle) / omega + slope * math.sin(angle) / omega**2
                    total += sign * self._gusts * share * part
        return total

    def _spectrum(self, rate):
        return RainSpectrum(rate, self._radii)

    def _shares(self):
        """Return the share of each class's drops that pass z = 0 at even times, and those times."""
        if np.ptp(self._rates) == 0:
            return np.ones((CLASSES, 1)), (0.0, 1.0)
        first, last = self._times[0] - MARGIN, self._times[-1] + MARGIN
        ticks = min(math.ceil((last - first) / TICK) + 1, MOST_TICKS)
        times = np.linspace(first, last, ticks)
        share = np.stack([self._spectrum(self.rate(t)).density for t in times], axis=1)
        return share / self._heaviest.density[:, None], (float(first), float(times[1] - first))


class RainField:
    """All drops of a steady rain in a steady wind, everywhere and at every time.

    wind : (float, float) [m/s]. Horizontal velocity of the air along x and y.
    seed : int. Rains of different seeds are independent. At the same seed a
        lighter rain's drops are, nearly all, among a heavier one's.
    offset : (float, float) [m]. How much farther the air has come along x and y
        than this wind alone would have taken it, for a wind that was another
        before.
    follow : float64 array (CLASSES,) or None. Horizontal speed of each class over
        the wind's, see `rainsim.rain.wind.wind_shares`; None for a wind that is
        the same at all heights, which all drops follow.
    heaviest : RainSpectrum or None. The rain whose drops are listed, if it
        changes; `spectrum` is then only what it is now.
    share : float64 array (CLASSES, n) or None. The share of those drops that
        there are, at n even times of passing z = 0; the first and last hold
        before and after.
    clock : (float, float) [s]. The first of those times and the step.
    cube : float64 array (CLASSES,) [m]. Side of the cubes in which the class is
        listed.
    """

    def __init__(
        self, spectrum, wind=(0.0, 0.0), seed=0, offset=(0.0, 0.0), heaviest=None, share=None,
        clock=(0.0, 1.0), follow=None,
    ):  # fmt: skip
        self.spectrum = spectrum
        self.listed = spectrum if heaviest is None else heaviest
        self._share = np.ones((CLASSES, 1)) if share is None else share
        follow = np.ones(CLASSES) if follow is None else np.asarray(follow, np.float64)
        # Of each class: offset in x and y, first time, steps per second.
        self._frame = np.empty((CLASSES, 4))
        self._frame[:, :2] = follow[:, None] * np.asarray(offset)
        self._frame[:, 2:] = clock[0], 1 / clock[1]
        self._offset = np.zeros((CLASSES, 3))
        self._offset[:, :2] = self._frame[:, :2]
        self.wind = tuple(require_finite("wind component", w) for w in wind)
        if len(self.wind) != 2:
            raise ParameterError(f"wind is {wind!r}; it must be two numbers, along x and y in m/s")
        if isinstance(seed, bool) or int(seed) != seed:
            raise ParameterError(f"seed is {seed!r}; it must be a whole number")
        self.seed = int(seed)
        self.velocity = np.empty((CLASSES, 3))
        self.velocity[:, :2] = follow[:, None] * self.wind
        self.velocity[:, 2] = -spectrum.speed
        self.cube = poisson_cells.cube_sides()
        self._key = poisson_cells.class_keys(self.seed)
        self.mean_count = self.listed.density * self.cube**3
        self._count = poisson_tables(self.mean_count)
        self._size = poisson_cells.size_tables(self.listed)

    def arrays(self):
        """Return the `DropField` from which kernels list the drops of a cube."""
        return poisson_cells.DropField(
            self.velocity, self.cube, self._key, self._count, self._size, self._share, self._frame
        )

    def drops_in_box(self, time, low, high):
        """List the drops in the box low <= position < high at `time`.

        time : float [s]
        low, high : array_like of shape (3,) or (CLASSES, 3) [m]. Of each class if
            they differ: cubes of a class that touch its own box are listed.
        """
        time = require_finite("time", time)
        low, high = np.array(low, dtype=np.float64), np.array(high, dtype=np.float64)
        if low.shape != high.shape or low.shape not in ((3,), (CLASSES, 3)):
            raise ParameterError("a box is its low and its high corner, three numbers each")
        first, last = self.cubes_in(low, high, time)
        low, high = low.reshape(-1, 3).min(axis=0), high.reshape(-1, 3).max(axis=0)
        tasks = poisson_cells.slab_tasks(first, last)
        cubes = np.prod(last - first + 1, axis=1)[tasks[:, 0]] / (last - first + 1)[tasks[:, 0], 0]
        expected = self.mean_count[tasks[:, 0]] * cubes
        values, labels, ids = run_listing(
            expected, 4, 1, _fill_box, tasks, first, last, time, low, high, self.arrays()
        )
        return Drops(
            np.ascontiguousarray(values[:, :3]),
            self.velocity[labels[:, 0]],
            np.ascontiguousarray(values[:, 3]),
            ids,
        )

    def cubes_in(self, low, high, start, duration=0.0):
        """Return the first and last cubes of the drops that come through a box in an interval.

        low, high : array (3,) or (CLASSES, 3) [m]. Corners of the box, of each
            class if they differ.
        Returns first, last : int64 array (CLASSES, 3). Along x, y and z; none if
            the last is less.
        """
        space = self.velocity, self._offset, self.cube[:, None]
        first, last = poisson_cells.cubes_along(low, high, start, duration, *space)
        return first.astype(np.int64), last.astype(np.int64)


@dataclass(frozen=True)
class Drops:
    """Drops in the air at one time.

    id : uint64 array (n,). The drop's own random word: the same at all times;
        ascending.
    """

    position: np.ndarray
    velocity: np.ndarray
    diameter: np.ndarray
    id: np.ndarray

    def __len__(self):
        return len(self.id)


@cpu_kernel
def _fill_box(
    tasks, first, last, time, low, high, field, offset, values_out, labels_out, ids_out, needed_out
):
    """List the drops of each slab of cubes that are in the box; outputs: see `run_listing`."""
    for t in prange(tasks.shape[0]):
        b, i = tasks[t]
        found = 0
        vx, vy, vz = field.velocity[b, 0], field.velocity[b, 1], field.velocity[b, 2]
        for j in range(first[b, 1], last[b, 1] + 1):
            for k in range(first[b, 2], last[b, 2] + 1):
                cube = poisson_cells.Cube(b, i, j, k)
                key = poisson_cells.cube_key(cube, field)
                for n in range(poisson_cells.drops_in_cube(key, b, field)):
                    word = poisson_cells.drop_id(key, n)
                    x, y, z = poisson_cells.drop_place(word, cube, field)
                    if poisson_cells.thinned_out(word, b, z, field):
                        continue
                    x, y, z = x + vx * time, y + vy * time, z + vz * time
                    if low[0] <= x < high[0] and low[1] <= y < high[1] and low[2] <= z < high[2]:
                        if offset[t] + found < offset[t + 1]:
                            out = offset[t] + found
                            values_out[out, 0], values_out[out, 1] = x, y
                            values_out[out, 2] = z
                            values_out[out, 3] = poisson_cells.drop_diameter(word, b, field)
                            labels_out[out, 0] = b
                            ids_out[out] = word
                        found += 1
        needed_out[t] = found


def impacts(field, surfaces, start, stop, smallest=0.0, within=None):
    """List the drops that meet the surfaces at start <= time < stop.

    Intervals that share an end share no drop and lose none. What a drop would have met on its
    path before `start` counts: under a roof there are no drops. Drops that come in over the map's
    edge below the highest top count if nothing on the map was in their way.

    smallest : float [m]. Classes that hold smaller drops only are not listed.
    within : array (2, 2) [m] or None. Low and high corner (x, y): only hits
        inside are listed.
    Returns Impacts. Sorted by drop id. Their volume is all the water that tracked
        drops bring; the drops under `size_distribution.SMALLEST` come besides, as
        `field.spectrum.fine_rate`.
    """
    start = require_finite("start", start)
    duration = require_not_negative("stop - start", stop - start, "s")
    first, last, corner, opposite = poisson_cells.swept_cubes(field, surfaces, start, stop, within)
    tasks = poisson_cells.slab_tasks(first, last)
    tasks = tasks[field.spectrum.edges[tasks[:, 0] + 1] > smallest]
    flux = field.listed.density * field.listed.speed * field.cube * duration
    level = (flux * (last - first + 1)[:, 1] * field.cube)[tasks[:, 0]]
    expected = _STEEP * level
    values, labels, ids = run_listing(
        expected, 5, 4, fill_impacts, tasks, first, last, start, float(stop), field.arrays(),
        surfaces.height_fields(),
    )  # fmt: skip
    if within is not None:
        place = values[:, :2]
        inside = ((place >= corner) & (place < opposite)).all(axis=1)
        values, labels, ids = values[inside], labels[inside], ids[inside]
    return Impacts(
        position=np.ascontiguousarray(values[:, :3]),
        velocity=field.velocity[labels[:, 0]],
        diameter=np.ascontiguousarray(values[:, 3]),
        time=np.ascontiguousarray(values[:, 4]),
        kind=labels[:, 1].astype(np.uint8),
        row=np.ascontiguousarray(labels[:, 2]),
        column=np.ascontiguousarray(labels[:, 3]),
        id=ids,
    )
