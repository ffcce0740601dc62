"""The wind near the ground, and how much of it drops of each size follow.

The wind blows as the logarithm of the height above rough land. A drop follows the wind only over
metres of fall (speed squared over g: 1.6 m at 1 mm, 7 m at 4 mm). So each size class drifts with a
share of the wind at 10 m that grows with its size, on a path that is taken as straight over the
few metres of a scene.
"""

import math

import numpy as np

from rainsim.constants import GRAVITY

WIND_HEIGHT = 10.0  # m; where weather services measure the wind, and the settings mean it
SCENE_HEIGHT = 3.0  # m above the ground, over which a class's drift is averaged
_FALLS, _FALL_WEIGHTS = np.polynomial.laguerre.laggauss(40)


def wind_shares(speed, roughness):
    """Return the horizontal speed of drops near the ground over the wind at WIND_HEIGHT.

    speed : array (n,) [m/s]. Fall speeds.
    roughness : float [m]. Roughness length of the land around: 0.005 smooth, 0.03
        grass, 0.1 crops, 0.5 suburbs (Davenport's classes); 0 for a wind that is
        the same at all heights.
    Returns float64 array (n,)

    The wind is u(z) = u_10 ln(1 + z / z0) / ln(1 + 10 m / z0). A drop that falls at v yields to a
    horizontal wind as dw/dt = (u - w) g / v, the linearised quadratic drag, so that at height z it
    has w(z) = integral_0^inf u(z + s v^2 / g) exp(-s) ds. Given is the mean of w from the ground to
    SCENE_HEIGHT: the drop's true path bends away from the straight one by some centimetres.
    """
    if roughness == 0:
        return np.ones(len(speed))
    height = SCENE_HEIGHT * (np.arange(64) + 0.5) / 64
    above = height[:, None] + (np.asarray(speed) ** 2 / GRAVITY)[:, None, None] * _FALLS
    wind = np.log1p(above / roughness) / math.log1p(WIND_HEIGHT / roughness)
    return (wind @ _FALL_WEIGHTS).mean(axis=1)


def wind_at(height, roughness):
    """Return the wind at a `height` [m] over that at WIND_HEIGHT, for `wind_shares`' roughness."""
    if roughness == 0:
        return np.ones_like(np.asarray(height, np.float64))
    return np.log1p(np.maximum(height, 0.0) / roughness) / math.log1p(WIND_HEIGHT / roughness)
