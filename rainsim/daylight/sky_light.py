"""Light of the whole sky: directions over the hemisphere, and how bright skies are in each."""

import numpy as np

# Coefficients a to e of Perez's function for red, green and blue: fitted to the sky of Hosek and
# Wilkie 2012, An Analytic Model for Full Spectral Sky-Dome Radiance, for a turbidity of 3 (a usual
# clear day), ground of albedo 0.2 and suns 12 to 80 degrees high. What upright walls receive over
# level ground differs from it by at most 0.06, and by 0.02 in most places.
CLEAR = np.array([
    (-1.067, -0.175, 10.199, -3.872, 0.499),
    (-1.083, -0.259, 4.918, -3.688, 0.419),
    (-1.132, -0.490, 1.757, -3.274, 0.309),
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
    """Return the clear sky's radiance in three channels without the sun itself, (m, 3).

    Perez's function of the elevation and of the angle to the sun, with the coefficients `CLEAR`:
    brighter about the sun and at the horizon, and less blue there. Each channel is relative to
    nothing in particular. `directions` and `sun` are unit vectors, the former above the horizon.
    """
    sine = np.maximum(directions[:, 2:], 0.01)
    angle = np.arccos(np.clip(directions @ sun, -1, 1))[:, None]
    a, b, c, d, e = CLEAR.T
    around = 1 + c * np.exp(d * angle) + e * np.cos(angle) ** 2
    return np.maximum(1 + a * np.exp(b / sine), 0) * around
