"""Radar in the rain: specific attenuation after ITU-R P.838-3.

gamma = k R^alpha [dB/km] with the rain rate R [mm/h]; k and alpha are sums of Gaussians over the
logarithm of the frequency, for horizontal and vertical polarization (Recommendation ITU-R P.838-3,
2005, equations 1 to 3, tables 1 to 4). Elevation and tilt of the path mix them (equations 4, 5).
"""

import math

import numpy as np

from rainsim.errors import ParameterError, require_not_negative

FREQUENCIES = (1.0, 1000.0)  # GHz, that the recommendation is for
# Tables 1 to 4: rows of a, b, c of each Gaussian; then slope m and constant c.
_K = {
    "horizontal": (
        ((-5.33980, -0.10008, 1.13098), (-0.35351, 1.26970, 0.45400),
         (-0.23789, 0.86036, 0.15354), (-0.94158, 0.64552, 0.16817)), -0.18961, 0.71147),
    "vertical": (
        ((-3.80595, 0.56934, 0.81061), (-3.44965, -0.22911, 0.51059),
         (-0.39902, 0.73042, 0.11899), (0.50167, 1.07319, 0.27195)), -0.16398, 0.63297),
}  # fmt: skip
_ALPHA = {
    "horizontal": (
        ((-0.14318, 1.82442, -0.55187), (0.29591, 0.77564, 0.19822), (0.32177, 0.63773, 0.13164),
         (-5.37610, -0.96230, 1.47828), (16.1721, -3.29980, 3.43990)), 0.67849, -1.95537),
    "vertical": (
        ((-0.07771, 2.33840, -0.76284), (0.56727, 0.95545, 0.54039), (-0.20238, 1.14520, 0.26809),
         (-48.2991, 0.791669, 0.116226), (48.5833, 0.791459, 0.116479)), -0.053739, 0.83433),
}  # fmt: skip


def rain_coefficients(frequency_ghz, polarization="vertical"):
    """Return k and alpha of one polarization, "horizontal" or "vertical", at a frequency [GHz]."""
    low, high = FREQUENCIES
    if not low <= frequency_ghz <= high:  # false for NaN
        raise ParameterError(
            f"radar frequency is {frequency_ghz} GHz; it must lie from {low:g} to {high:g}; 77 is "
            "usual on cars"
        )
    if polarization not in _K:
        raise ParameterError(f"polarization is {polarization!r}; it must be horizontal or vertical")
    x = math.log10(frequency_ghz)
    return 10 ** _curve(x, *_K[polarization]), _curve(x, *_ALPHA[polarization])


def _curve(x, gaussians, slope, constant):
    return sum(a * math.exp(-(((x - b) / c) ** 2)) for a, b, c in gaussians) + slope * x + constant


def rain_attenuation(rate, frequency_ghz, polarization="vertical", elevation=0.0):
    """Return the specific attenuation by rain [dB/km] one way, for one rate [mm/h] or an array.

    The polarization is "horizontal", "vertical" or "circular"; `elevation` [rad] is that of the
    path above the horizon.
    """
    require_not_negative("rain rate", float(np.min(rate)), "mm/h")
    tilt = {"horizontal": 0.0, "vertical": math.pi / 2, "circular": math.pi / 4}.get(polarization)
    if tilt is None:
        raise ParameterError(
            f"polarization is {polarization!r}; it must be horizontal, vertical or circular"
        )
    (kh, ah), (kv, av) = (rain_coefficients(frequency_ghz, p) for p in ("horizontal", "vertical"))
    mix = math.cos(elevation) ** 2 * math.cos(2 * tilt)
    k = (kh + kv + (kh - kv) * mix) / 2
    alpha = (kh * ah + kv * av + (kh * ah - kv * av) * mix) / (2 * k)
    return k * np.asarray(rate, np.float64) ** alpha
