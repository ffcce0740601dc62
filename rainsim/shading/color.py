"""Colours: display-referred values, linear light, luminance."""

import math

import numpy as np

from rainsim.constants import ZERO
from rainsim.jit import device_function, inlined_function
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS

LUMA = LUMINANCE_WEIGHTS.astype(np.float32)
LUMA_R, LUMA_G, LUMA_B = LUMA
GAMMA = 2.2  # of the display, near enough for what is judged or blurred
BRIGHTEST = np.float32(4)  # display value, 27 times white: more is a flaw of a capture

# Polynomials, minimax fits of ours: x^1.6 and x^(10/3).
D0, D1, D2 = np.float32(-0.0180342311), np.float32(0.280658696), np.float32(0.960916507)
D3, D4, D5 = np.float32(-0.3063445), np.float32(0.097504342), np.float32(-0.0147001988)
E0, E1, E2 = np.float32(-0.00304723237), np.float32(0.0311847871), np.float32(-0.154336153)
E3, E4, E5 = np.float32(0.861662725), np.float32(0.29686102), np.float32(-0.0323252575)


@inlined_function
def linear_from_display(c):
    """Return linear light of a display-referred value (IEC 61966-2-1), within 4e-6 of it.

    By square roots and a polynomial for x^1.6 in x^(1/4): no library call, so that loops over it
    run in vectors. Values above BRIGHTEST count as that.
    """
    x = (min(c, BRIGHTEST) + np.float32(0.055)) * np.float32(1 / 1.055)
    t = math.sqrt(math.sqrt(max(x, ZERO)))
    p = D0 + t * (D1 + t * (D2 + t * (D3 + t * (D4 + t * D5))))
    return c * np.float32(1 / 12.92) if c <= np.float32(0.04045) else x * x * p


@device_function
def display_from_linear(c):
    """Return the display-referred value of linear light up to 1 (IEC 61966-2-1), within 1e-6.

    x^(1/2.4) is a polynomial in x^(1/8).
    """
    t = math.sqrt(math.sqrt(math.sqrt(max(c, ZERO))))
    p = E0 + t * (E1 + t * (E2 + t * (E3 + t * (E4 + t * E5))))
    low = c * np.float32(12.92)
    return low if c <= np.float32(0.0031308) else np.float32(1.055) * p - np.float32(0.055)


@inlined_function
def luminance(r, g, b):
    """Return the luminance of linear Rec. 709 light."""
    return LUMA_R * r + LUMA_G * g + LUMA_B * b


def roughly_linear(color, most=1.0):
    """Return about the linear light of display-referred colours, an array, up to `most`."""
    return np.clip(color, 0, most) ** GAMMA


def luminance_of(color):
    """Return about the linear luminance of display-referred colours (..., 3)."""
    return roughly_linear(color) @ LUMA
