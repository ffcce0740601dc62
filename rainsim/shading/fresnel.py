"""Reflectance of smooth water."""

import math

import numpy as np

from rainsim import constants
from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import device_function, inlined_function

REFRACTIVE_INDEX = np.float32(constants.REFRACTIVE_INDEX)
SCHLICK_0 = np.float32(0.0204)  # reflectance at normal incidence


@inlined_function
def fresnel(cosine):
    """Return the reflectance of smooth water for unpolarised light, exact dielectric."""
    c = min(max(cosine, ZERO), ONE)
    t = math.sqrt(ONE - (ONE - c * c) / (REFRACTIVE_INDEX * REFRACTIVE_INDEX))
    s = (c - REFRACTIVE_INDEX * t) / (c + REFRACTIVE_INDEX * t)
    p = (REFRACTIVE_INDEX * c - t) / (REFRACTIVE_INDEX * c + t)
    return HALF * (s * s + p * p)


# Laws of reflectance by the name that a configuration gives them (`RenderConfig.fresnel`).
EXACT, SCHLICK = 0, 1
LAWS = {"exact": EXACT, "schlick": SCHLICK}


@inlined_function
def reflectance(law, cosine):
    """Return the reflectance of smooth water by one of LAWS, at a cosine of the angle to it."""
    return schlick(cosine) if law == SCHLICK else fresnel(cosine)


@device_function
def schlick(cosine):
    """Return Schlick's approximation (1994): 15 % low at 60 degrees, 14 % high at 80."""
    c = ONE - min(max(cosine, ZERO), ONE)
    return SCHLICK_0 + (ONE - SCHLICK_0) * (c * c) * (c * c) * c
