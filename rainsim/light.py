"""Scalar formulas of light and of looking things up, shared by the shading kernels."""

from __future__ import annotations

import math

import numpy as np

from rainsim.jit import device_function

ZERO = np.float32(0)
ONE = np.float32(1)
THREE = np.float32(3)
TWO = np.float32(2)
HALF = np.float32(0.5)

LUMA_R, LUMA_G, LUMA_B = np.float32(0.2126), np.float32(0.7152), np.float32(0.0722)  # Rec. 709
REFRACTIVE_INDEX = np.float32(1.333)  # of water against air, visible light


@device_function
def linear_from_display(c):
    """Return linear light of a display-referred value (IEC 61966-2-1)."""
    if c <= np.float32(0.04045):
        return c * np.float32(1 / 12.92)
    return ((c + np.float32(0.055)) * np.float32(1 / 1.055)) ** np.float32(2.4)


@device_function
def display_from_linear(c):
    """Return the display-referred value of linear light (IEC 61966-2-1)."""
    if c <= np.float32(0.0031308):
        return c * np.float32(12.92)
    return np.float32(1.055) * c ** np.float32(1 / 2.4) - np.float32(0.055)


@device_function
def luminance(r, g, b):
    """Return the luminance of linear Rec. 709 light."""
    return LUMA_R * r + LUMA_G * g + LUMA_B * b


@device_function
def bilinear(field, u, v):
    """Return `field` (rows, columns) at column u, row v, cell centres at whole numbers; clamped."""
    rows, columns = field.shape
    u = min(max(u, ZERO), np.float32(columns - 1))
    v = min(max(v, ZERO), np.float32(rows - 1))
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    a, b = u - np.float32(i), v - np.float32(j)
    upper = field[j, i] * (ONE - a) + field[j, i + 1] * a
    lower = field[j + 1, i] * (ONE - a) + field[j + 1, i + 1] * a
    return upper * (ONE - b) + lower * b


@device_function
def fresnel(cosine):
    """Return the reflectance of smooth water for unpolarised light, exact dielectric."""
    c = min(max(cosine, ZERO), ONE)
    t = math.sqrt(ONE - (ONE - c * c) / (REFRACTIVE_INDEX * REFRACTIVE_INDEX))
    s = (c - REFRACTIVE_INDEX * t) / (c + REFRACTIVE_INDEX * t)
    p = (REFRACTIVE_INDEX * c - t) / (REFRACTIVE_INDEX * c + t)
    return HALF * (s * s + p * p)


@device_function
def smoothstep(low, high, x):
    """Return 0 below `low`, 1 above `high` and a smooth cubic between."""
    s = min(max((x - low) / (high - low), ZERO), ONE)
    return s * s * (THREE - TWO * s)


@device_function
def bilinear_color(picture, u, v, channel):
    """Return a channel of `picture` at image point (u, v), interpolated, clamped to the edge."""
    rows, columns = picture.shape[0], picture.shape[1]
    u = min(max(u - HALF, ZERO), np.float32(columns - 1))
    v = min(max(v - HALF, ZERO), np.float32(rows - 1))
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    a, b = u - np.float32(i), v - np.float32(j)
    upper = picture[j, i, channel] * (ONE - a) + picture[j, i + 1, channel] * a
    lower = picture[j + 1, i, channel] * (ONE - a) + picture[j + 1, i + 1, channel] * a
    return upper * (ONE - b) + lower * b
