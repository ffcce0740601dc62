"""The lobe of a wet rough surface: how much it mirrors, and from which directions.

Facets are mirrors whose slopes have a Gaussian density (Torrance and Sparrow 1967; Smith 1967 for
what hides what). Tilts in the plane of view matter most, for they turn the mirrored ray by twice as
much in elevation: they are cut into SAMPLES parts.
"""

import math

import numpy as np

from rainsim.jit import cpu_kernel, inlined_function, lean_function, prange
from rainsim.shading.fresnel import EXACT, reflectance

ZERO, ONE, TWO = (np.float32(v) for v in (0, 1, 2))
SAMPLES = 8  # parts of the lobe
ANGLES = 16  # steps of the table of the lobe
LEAST_DIP = np.float32(0.004)  # tangent at which ground is seen at least
LEAST_RISE = np.float32(0.004)  # tangent of the elevation above which facets mirror something
STEEPEST = np.float32(8)  # tangent of the elevation of what is mirrored at most


def lobe_table():
    """Return mean tilt and width of the facets in each part of the lobe, in units of the rms slope.

    A facet leans towards the viewer by x rms slopes. Of the facets that a viewer sees the density
    over x is N(x) max(a + x, 0) with the normal density N, a = tan(g) / s, the angle g between the
    view and the ground, and the rms slope s (Smith; Heitz 2014, JCGT 3(2)). It is cut into SAMPLES
    parts that hold the shares PARTS.

    Returns float32 array (ANGLES + 1, SAMPLES, 2). Row k is for a / (1 + a) = k /
        ANGLES. Of each part: mean of x, and the width of the uniform density that
        has the part's variance.
    """
    x = np.linspace(-5, 5, 8001)
    table = np.empty((ANGLES + 1, SAMPLES, 2), np.float32)
    for row in range(ANGLES + 1):
        share = row / ANGLES
        seen = np.maximum(share + (1 - share) * x, 0)
        density = np.exp(-0.5 * x * x) * seen
        part = np.searchsorted(PARTS.cumsum()[:-1], density.cumsum() / density.sum() - 1e-9)
        for k in range(SAMPLES):
            weight = density * (part == k)
            mean = (weight * x).sum() / weight.sum()
            spread = math.sqrt((weight * (x - mean) ** 2).sum() / weight.sum())
            table[row, k] = mean, spread * math.sqrt(12)
    return table


# Shares of the parts: small ones at the ends, whose tails reach far.
PARTS = np.sin(np.pi * (np.arange(SAMPLES) + 0.5) / SAMPLES).astype(np.float32)
PARTS /= PARTS.sum()
LOBE = lobe_table()


@lean_function
def shadowing(a):
    """Return Smith's Lambda of a Gaussian surface at a = tan(angle to it) / rms slope.

    The rational fit of Walter et al. 2007 (EGSR), equation 25 after its text, within 0.35 %.
    """
    c = a * np.float32(1 / math.sqrt(2))
    if c >= np.float32(1.6):
        return ZERO
    c = max(c, np.float32(1e-4))
    return (ONE - np.float32(1.259) * c + np.float32(0.396) * c * c) / (
        np.float32(3.535) * c + np.float32(2.181) * c * c
    )


@inlined_function
def lobe_part(lobe, k, dip, tilt, slope, law):
    """Return the tangent of part k's elevation, its weight, its facets' sine and its width.

    The ground is seen at an angle of tangent `dip` and leans towards the viewer with slope `tilt`;
    `slope` is the rms slope. The weight is the reflectance of a facet by one of `fresnel.LAWS`
    times the visible share of the mirrored ray (heights correlated, Heitz 2014) times the part's
    share; all weights add up to the reflectance of the ground. The sine is that of the view's
    angle to the facets, the width in elevation [rad].
    """
    a = max((dip + tilt) / max(ONE - dip * tilt, LEAST_DIP), LEAST_DIP) / slope
    at = a / (ONE + a) * np.float32(ANGLES)
    i = min(int(at), ANGLES - 1)
    f = at - np.float32(i)
    mean = lobe[i, k, 0] + (lobe[i + 1, k, 0] - lobe[i, k, 0]) * f
    width = lobe[i, k, 1] + (lobe[i + 1, k, 1] - lobe[i, k, 1]) * f
    lean = mean * slope + tilt
    # Facets lean across the plane of view, too, by the rms slope: they mirror lower.
    across = slope * slope
    square = lean * lean + across
    ahead = ONE + TWO * across - square - TWO * lean * dip
    aside = TWO * (lean + dip) * slope
    ahead = max(math.sqrt(ahead * ahead + aside * aside), np.float32(1e-3))
    rise = min((dip * (ONE - square) + TWO * lean) / ahead, STEEPEST)
    away = (rise - tilt) / max(ONE + rise * tilt, LEAST_DIP)
    if away < LEAST_RISE or rise < LEAST_RISE:
        return ZERO, ZERO, ZERO, ZERO
    facet = max(dip + lean, LEAST_DIP) / math.sqrt((ONE + dip * dip) * (ONE + square))
    seen = ONE + shadowing(a)
    weight = PARTS[k] * reflectance(law, facet) * seen / (seen + shadowing(away / slope))
    return rise, weight, facet, TWO * slope * width / (ONE + square)


@cpu_kernel
def ground_reflectance(lobe, tangent, slope, share_out):
    """Write the reflectance of wet ground of rms slope `slope` seen at angles of `tangent` (n,)."""
    for n in prange(len(tangent)):
        total = ZERO
        for k in range(SAMPLES):
            total += lobe_part(lobe, k, tangent[n], ZERO, slope, EXACT)[1]
        share_out[n] = total
