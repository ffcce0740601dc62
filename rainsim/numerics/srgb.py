"""sRGB (IEC 61966-2-1): its transfer function on arrays, for values of any size, and luminance."""

import numpy as np

LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # of linear red, green, blue: Rec. 709


def linear(display):
    """Return linear light of display-referred values; negative ones count as 0."""
    value = np.maximum(display, 0)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def display(light):
    """Return display-referred values of linear light, 1 being white; negative light counts as 0."""
    value = np.maximum(light, 0)
    return np.where(value <= 0.0031308, value * 12.92, 1.055 * value ** (1 / 2.4) - 0.055)
