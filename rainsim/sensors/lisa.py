"""LISA's model of a lidar in rain in closed form, for baseline and check.

Lidar Light Scattering Augmentation (Kilic et al. 2021): ranges of the drops in a beam's cone are
spread as the cone's section, their diameters by the drop spectrum; the strongest echo above the
least power is reported. The formulas are LISA's; the spectrum is that of our rain, truncated as we
track it, so that both differ in the drops alone.
"""

import math

import numpy as np

from rainsim.rain.size_distribution import LARGEST, SMALLEST
from rainsim.sensors.lidar_model import DROP_REFLECTIVITY, echo_power, extinction_of

RANGES = 2000  # nodes of the integral


def scattered_share(distance, reflectivity, lidar, spectrum):
    """Return the probability that a beam reports a drop instead of its target, in closed form.

    1 - exp(-m) with the mean number m of drops in the cone that echo louder than the target and
    than the least power. Distance and reflectivity are the target's.
    """
    alpha = extinction_of(spectrum)
    target = float(echo_power(reflectivity, distance, alpha)) if math.isfinite(distance) else 0.0
    threshold = max(target, lidar.least_power)
    end = min(distance, lidar.far, math.sqrt(DROP_REFLECTIVITY / threshold))
    if end <= lidar.near:
        return 0.0
    r = lidar.near + (end - lidar.near) * (np.arange(RANGES) + 0.5) / RANGES
    density = loud_drops(r, threshold, lidar, spectrum)
    section = math.pi * (r * math.tan(lidar.divergence) / 2) ** 2
    return float(-np.expm1(-(density * section).sum() * (end - lidar.near) / RANGES))


def loud_drops(distance, threshold, lidar, spectrum):
    """Return the number [1/m3] of drops that echo louder than a power [1/m2] at ranges [m].

    threshold : float [1/m2]. See `lidar_model.echo_power`; a sensor's is its
        `least_power`.
    """
    # The least diameter that echoes louder than the threshold from each range.
    loss = np.exp(2 * extinction_of(spectrum) * distance)
    share = threshold * distance**2 * loss / DROP_REFLECTIVITY
    least = np.sqrt(share) * distance * math.tan(lidar.divergence)
    low = np.clip(least, SMALLEST, LARGEST)
    density = spectrum.intercept * spectrum.law.number_between(low, LARGEST)
    return np.where(share > 1, 0.0, density)
