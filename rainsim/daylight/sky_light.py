"""Light of the whole sky: directions over the hemisphere, and how bright skies are in each."""

from __future__ import annotations

import numpy as np

TURBIDITY = 3.0  # of a usual clear day; Preetham et al. call 2 very clear and 6 slightly hazy
# Preetham, Shirley and Smits 1999, A Practical Analytic Model for Daylight: chromaticities x and y.
# Of the zenith: polynomials of the turbidity (rows: 1, T, T^2) and of the sun's zenith angle
# (columns: its cube first). Around it: five coefficients of Perez's function, T times the first
# plus the second.
ZENITH_X = (
    (0.11693, -0.21196, 0.06052, 0.25886),
    (-0.02903, 0.06377, -0.03202, 0.00394),
    (0.00166, -0.00375, 0.00209, 0.0),
)
ZENITH_Y = (
    (0.15346, -0.26756, 0.06670, 0.26688),
    (-0.04214, 0.08970, -0.04153, 0.00516),
    (0.00275, -0.00610, 0.00317, 0.0),
)
PEREZ_X = (
    (-0.0193, -0.2592), (-0.0665, 0.0008), (-0.0004, 0.2125), (-0.0641, -0.8989), (-0.0033, 0.0452),
)  # fmt: skip
PEREZ_Y = (
    (-0.0167, -0.2608), (-0.0950, 0.0092), (-0.0079, 0.2102), (-0.0441, -1.6537), (-0.0109, 0.0529),
)  # fmt: skip
SRGB_OF_XYZ = np.array([
    [3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570],
])  # fmt: skip


def hemisphere(count):
    """Return unit directions (count, 3) over the upper hemisphere, of equal solid angle each."""
    k = np.arange(count) + 0.5
    height = k / count
    turn = k * np.pi * (1 + 5**0.5)
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=-1)


def overcast(directions):
    """Return the overcast sky's radiance, of Moon and Spencer 1942: (1 + 2 sin(elevation)) / 3."""
    return (1 + 2 * np.maximum(directions[:, 2], 0)) / 3


def clear(directions, sun):
    """Return the clear sky's radiance without the sun itself, relative to nothing in particular.

    The clear sky of CIE S 011 (ISO 15469:2004, type 12): brighter about the sun and at the horizon.

    Parameters
    ----------
    directions : ndarray of shape (m, 3)
        Unit, above the horizon.
    sun : ndarray of shape (3,)
        Unit, towards the sun.
    """
    sine, angle = _places(directions, sun)
    around = 1 + 10 * (np.exp(-3 * angle) - np.exp(-3 * np.pi / 2)) + 0.45 * np.cos(angle) ** 2
    return around * (1 - np.exp(-0.32 / sine))


def clear_color(directions, sun, turbidity=TURBIDITY):
    """Return the clear sky's linear colour, of luminance 1, in each direction, (m, 3).

    The chromaticities of Preetham, Shirley and Smits 1999: bluest opposite to the sun.

    Parameters
    ----------
    directions : ndarray of shape (m, 3)
        Unit, above the horizon.
    sun : ndarray of shape (3,)
        Unit, towards the sun.
    turbidity : float
    """
    high = np.arccos(np.clip(sun[2], 0.0, 1.0))
    powers = np.array([high**3, high**2, high, 1.0])
    sine, angle = _places(directions, sun)
    x, y = (
        turbidity ** np.arange(3) @ (np.array(zenith) @ powers)
        * _perez(coefficients, turbidity, sine, angle) / _perez(coefficients, turbidity, 1.0, high)
        for zenith, coefficients in ((ZENITH_X, PEREZ_X), (ZENITH_Y, PEREZ_Y))
    )  # fmt: skip
    color = np.stack([x / y, np.ones_like(x), (1 - x - y) / y], axis=-1) @ SRGB_OF_XYZ.T
    return np.maximum(color, 0)


def _places(directions, sun):
    """Return the sine of each direction's elevation and its angle to the sun [rad]."""
    return np.maximum(directions[:, 2], 0.01), np.arccos(np.clip(directions @ sun, -1, 1))


def _perez(coefficients, turbidity, sine, angle):
    """Return Perez's function of the sine of an elevation and an angle to the sun."""
    a, b, c, d, e = (slope * turbidity + start for slope, start in coefficients)
    return (1 + a * np.exp(b / sine)) * (1 + c * np.exp(d * angle) + e * np.cos(angle) ** 2)
