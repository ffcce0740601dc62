"""The slopes that a pixel of water shows, as facets: each a mirror with a share of the light.

The slopes in a pixel are taken for normally distributed, with the mean and covariance that the
pixel has, and SAMPLES of them stand for all. A facet that leans towards the viewer fills more of
the pixel, and one that is seen at a slant mirrors more: facets weigh by the area that they show
times Fresnel's factor (Torrance and Sparrow 1967). Without these weights a film of slopes of 0.1
rms is up to a quarter too bright where it mirrors a dark hedge under a bright sky.
"""

import math

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.jit import inlined_function
from rainsim.reflection.slope_moments import root_of
from rainsim.shading.fresnel import EXACT, reflectance

LEAST_COSINE = np.float32(0.02)
LEAST_VARIANCE = np.float32(2 * 0.003**2)  # of slopes, both axes: below that a mirror is smooth
SAMPLES = 7  # one in the middle, six around it
_RING = 2 * np.pi * np.arange(6) / 6
RADIUS = np.sqrt(2 * 7 / 6)  # in deviations: keeps the variance of the slopes
SAMPLE_X = np.append(0, RADIUS * np.cos(_RING)).astype(np.float32)
SAMPLE_Y = np.append(0, RADIUS * np.sin(_RING)).astype(np.float32)


@inlined_function
def normal_of(gx, gy):
    """Return the unit normal of a surface with slopes gx and gy."""
    inv = ONE / math.sqrt(ONE + gx * gx + gy * gy)
    return -gx * inv, -gy * inv, inv


@inlined_function
def view_cosine(water, ux, uy, uz):
    """Return the cosine of the angle between the view of a pixel and a normal u."""
    return max(-(water.view_x * ux + water.view_y * uy + water.view_z * uz), LEAST_COSINE)


@inlined_function
def slope_samples(water):
    """Return the number of slopes to take in a pixel, and a root of their covariance.

    The root (a, b, c) is the lower triangle (a; b, c), see `sample_slopes`.
    """
    if water.variance_x + water.variance_y < LEAST_VARIANCE:
        return 1, ZERO, ZERO, ZERO
    a, b, c = root_of(water.variance_x, water.variance_y, water.covariance)
    return SAMPLES, a, b, c


@inlined_function
def sample_slopes(water, a, b, c, sample):
    """Return one of the slopes in a pixel; the root a, b, c as of `slope_samples`."""
    p, q = SAMPLE_X[sample], SAMPLE_Y[sample]
    return water.slope_x + a * p, water.slope_y + b * p + c * q


@inlined_function
def shown_area(water, gx, gy):
    """Return the area that a facet of slopes gx and gy shows the viewer, over that on the plan."""
    return max(water.view_x * gx + water.view_y * gy - water.view_z, LEAST_COSINE)


@inlined_function
def facet_weight(water, law, gx, gy):
    """Return the area that a facet shows, and that times its reflectance by one of `LAWS`."""
    area = shown_area(water, gx, gy)
    return area, area * reflectance(law, area / math.sqrt(ONE + gx * gx + gy * gy))


@inlined_function
def pixel_reflectance(law, water):
    """Return the reflectance of the water that a pixel shows: a mean over the area shown."""
    samples, a, b, c = slope_samples(water)
    area, light = ZERO, ZERO
    for sample in range(samples):
        gx, gy = sample_slopes(water, a, b, c, sample)
        shown, weight = facet_weight(water, law, gx, gy)
        area, light = area + shown, light + weight
    return light / area


@inlined_function
def light_weight(water, a, b, c, sample):
    """Return the weight of one of the slopes of a pixel in the mean of the light they mirror."""
    gx, gy = sample_slopes(water, a, b, c, sample)
    return facet_weight(water, EXACT, gx, gy)[1]
