"""LISA's model of a lidar in rain: drops drawn again for each beam, for baseline and check.

Lidar Light Scattering Augmentation (Kilic et al. 2021): the number of drops in a beam's cone is its
mean rounded at random, their ranges are spread as the cone's section, their diameters by the drop
spectrum; the strongest echo above the least power is reported. The formulas are LISA's; the
spectrum is that of our rain, truncated as we track it, so that both differ in the drops alone.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.rain.size_distribution import LARGEST, SMALLEST
from rainsim.sensors.lidar_model import (
    DROP_REFLECTIVITY,
    KEPT,
    LOST,
    SCATTERED,
    drop_reflectivity,
    echo_power,
    extinction_of,
)

DIAMETERS, RANGES = 400, 2000  # nodes of the integrals


def lisa_returns(distance, reflectivity, lidar, spectrum, rng):
    """Return range, reflectivity and label of each beam's echo in the rain.

    Parameters
    ----------
    distance, reflectivity : ndarray of shape (n,)
        Of the echo in clear air; infinite where there is none.
    lidar : Lidar
    spectrum : RainSpectrum
    rng : numpy.random.Generator

    Returns
    -------
    distance, reflectivity : ndarray of shape (n,), float64
        0 where the echo is lost.
    label : ndarray of shape (n,), uint8
    """
    alpha, least = extinction_of(spectrum), lidar.least_power
    end = np.minimum(distance, lidar.far)
    volume = math.pi / 3 * end * (end * math.tan(lidar.divergence) / 2) ** 2
    mean = volume * spectrum.density.sum()
    count = np.floor(mean).astype(np.int64)
    count += rng.random(len(end)) < mean - count
    beam = np.repeat(np.arange(len(end)), count)
    place = end[beam] * rng.random(len(beam)) ** (1 / 3)
    diameter = _drawn(spectrum, len(beam), rng)
    kept = place > lidar.near
    beam, place, diameter = beam[kept], place[kept], diameter[kept]
    drop = drop_reflectivity(diameter, place, lidar.divergence)
    power = echo_power(drop, place, alpha)
    order = np.lexsort((power, beam))
    last = np.flatnonzero(np.append(beam[order][1:] != beam[order][:-1], True)) if len(beam) else []
    best = order[last] if len(beam) else order
    own = np.where(np.isfinite(distance), echo_power(reflectivity, end, alpha), 0.0)
    found = np.where(own >= least, end, 0.0)
    label = np.where(own >= least, KEPT, LOST).astype(np.uint8)
    brightness = np.where(label == KEPT, reflectivity * np.exp(-2 * alpha * end), 0.0)
    wins = (power[best] > own[beam[best]]) & (power[best] >= least)
    best = best[wins]
    found[beam[best]], label[beam[best]] = place[best], SCATTERED
    brightness[beam[best]] = drop[best] * np.exp(-2 * alpha * place[best])
    return found, brightness, label


def _drawn(spectrum, count, rng):
    """Return diameters [m] of an exponential distribution from SMALLEST to LARGEST."""
    span = -np.expm1(-spectrum.decay * (LARGEST - SMALLEST))
    return SMALLEST - np.log(1 - rng.random(count) * span) / spectrum.decay


def scattered_share(distance, reflectivity, lidar, spectrum):
    """Return the probability that a beam reports a drop instead of its target, in closed form.

    1 - exp(-m) with the mean number m of drops in the cone that echo louder than the target and
    than the least power.

    Parameters
    ----------
    distance, reflectivity : float
        Of the target.
    lidar : Lidar
    spectrum : RainSpectrum
    """
    alpha = extinction_of(spectrum)
    target = float(echo_power(reflectivity, distance, alpha)) if math.isfinite(distance) else 0.0
    threshold = max(target, lidar.least_power)
    end = min(distance, lidar.far, math.sqrt(DROP_REFLECTIVITY / threshold))
    if end <= lidar.near:
        return 0.0
    r = lidar.near + (end - lidar.near) * (np.arange(RANGES) + 0.5) / RANGES
    # The least diameter that echoes louder than the threshold from each range.
    share = threshold * r**2 * np.exp(2 * alpha * r) / DROP_REFLECTIVITY
    least = np.sqrt(share) * r * math.tan(lidar.divergence)
    low = np.clip(least, SMALLEST, LARGEST)
    decay = spectrum.decay
    density = spectrum.intercept / decay * (np.exp(-decay * low) - np.exp(-decay * LARGEST))
    density = np.where(share > 1, 0.0, density)
    section = math.pi * (r * math.tan(lidar.divergence) / 2) ** 2
    return float(-np.expm1(-(density * section).sum() * (end - lidar.near) / RANGES))
