"""Rain and wind that change: the timeline of a configuration as rain fields of one interval each.

Drops of one class all have one velocity, which is what lets them be listed without history. A wind
that changes in time keeps that: all drops of the air are carried by its integral, so that places
are continuous; only within one interval is it taken as steady. A rain that changes keeps the drops
of the heaviest rain and leaves some out by their ids; whether a drop is there is told by the rate
at the time when it passes z = 0, so that no drop ever appears or vanishes in the air.

The wind blows as the logarithm of the height above rough land, and a drop follows it only over
metres of fall (speed squared over g: 1.6 m at 1 mm, 7 m at 4 mm). So each class drifts with a share
of the wind at 10 m that grows with its size, see `wind_shares`, on a path that is taken as straight
over the few metres of a scene.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from rainsim.drops import RainField
from rainsim.spectrum import CLASSES, RainSpectrum

MARGIN = 2.0  # s before the first keyframe and after the last that drops aloft may need
TICK = 0.05  # s, between the times at which the share of drops is tabled; linear between
MOST_TICKS = 4096
WIND_HEIGHT = 10.0  # m; where weather services measure the wind, and the settings mean it
SCENE_HEIGHT = 3.0  # m above the ground, over which a class's drift is averaged
_GRAVITY = 9.81  # m/s2
_FALLS, _FALL_WEIGHTS = np.polynomial.laguerre.laggauss(40)
GUST_PERIODS = (2.3, 5.1, 11.7)  # s; by eye: gusts of some seconds are what a film shows
GUST_SHARES = (0.45, 0.6, 0.66)  # of the gustiness; their squares sum to 1


def wind_shares(speed, roughness):
    """Return the horizontal speed of drops near the ground over the wind at WIND_HEIGHT.

    Parameters
    ----------
    speed : ndarray of shape (n,) [m/s]
        Fall speeds.
    roughness : float [m]
        Roughness length of the land around: 0.005 smooth, 0.03 grass, 0.1 crops, 0.5 suburbs
        (Davenport's classes); 0 for a wind that is the same at all heights.

    Returns
    -------
    ndarray of shape (n,), float64

    Notes
    -----
    The wind is u(z) = u_10 ln(1 + z / z0) / ln(1 + 10 m / z0). A drop that falls at v yields to a
    horizontal wind as dw/dt = (u - w) g / v, the linearised quadratic drag, so that at height z it
    has w(z) = integral_0^inf u(z + s v^2 / g) exp(-s) ds. Given is the mean of w from the ground to
    SCENE_HEIGHT: the drop's true path bends away from the straight one by some centimetres.
    """
    if roughness == 0:
        return np.ones(len(speed))
    height = SCENE_HEIGHT * (np.arange(64) + 0.5) / 64
    above = height[:, None] + (np.asarray(speed) ** 2 / _GRAVITY)[:, None, None] * _FALLS
    wind = np.log1p(above / roughness) / math.log1p(WIND_HEIGHT / roughness)
    return (wind @ _FALL_WEIGHTS).mean(axis=1)


def wind_at(height, roughness):
    """Return the wind at a `height` [m] over that at WIND_HEIGHT, for `wind_shares`' roughness."""
    if roughness == 0:
        return np.ones_like(np.asarray(height, np.float64))
    return np.log1p(np.maximum(height, 0.0) / roughness) / math.log1p(WIND_HEIGHT / roughness)


class Weather:
    """What a configuration's timeline says of rain and wind at any time.

    Parameters
    ----------
    config : Config

    Attributes
    ----------
    rains : bool
        Whether it rains at any time.
    """

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

    def field(self, start, stop):
        """Return the `RainField` of the interval from `start` to `stop` [s], or None without rain.

        Its spectrum is that of the rain in the middle of the interval: what fog and the drops too
        fine to track need.
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
