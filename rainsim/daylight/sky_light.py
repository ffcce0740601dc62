"""Light of the whole sky: directions over the hemisphere, and how bright skies are in each."""

from __future__ import annotations

import numpy as np


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
    sine = np.maximum(directions[:, 2], 0.01)
    angle = np.arccos(np.clip(directions @ sun, -1, 1))
    around = 1 + 10 * (np.exp(-3 * angle) - np.exp(-3 * np.pi / 2)) + 0.45 * np.cos(angle) ** 2
    return around * (1 - np.exp(-0.32 / sine))
