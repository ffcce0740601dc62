"""Facets of rough water: their mean reflectance and light against sums over very many slopes."""

import math

import numpy as np
import pytest

from rainsim.jit import serial_kernel
from rainsim.reflection import facets
from rainsim.reflection.screen_space import surrounding_light
from rainsim.reflection.water_record import RECORD, read_record
from rainsim.shading.fresnel import EXACT

F4 = np.float32
VARIANCE_X, VARIANCE_Y, COVARIANCE, VIEW_X, VIEW_Z = 12, 13, 14, 3, 5


@serial_kernel
def reflectance_of(record, share_out):
    for n in range(len(record)):
        share_out[n] = facets.pixel_reflectance(EXACT, read_record(record, n))


@serial_kernel
def light_of(record, environment, light_out):
    for n in range(len(record)):
        light_out[n] = surrounding_light(environment, read_record(record, n))[1]


def water(degrees, slope, aside=0.0):
    """A record seen at an angle to the water, its slopes of that rms; `aside` a covariance."""
    record = np.zeros(RECORD, F4)
    record[VIEW_X], record[VIEW_Z] = (
        math.cos(math.radians(degrees)),
        -math.sin(math.radians(degrees)),
    )
    record[[VARIANCE_X, VARIANCE_Y]] = slope**2
    record[COVARIANCE] = aside * slope**2
    return record


def summed(record, light=None):
    """Reflectance, and mean light over elevation, of 400 x 400 slopes weighed by what they show."""
    x = np.linspace(-4, 4, 401)
    p, q = np.meshgrid(x, x)
    deviation = math.sqrt(record[VARIANCE_X])
    along = record[COVARIANCE] / deviation if deviation else 0
    gx = deviation * p
    gy = along * p + math.sqrt(max(record[VARIANCE_Y] - along**2, 0)) * q
    vx, vz = float(record[VIEW_X]), float(record[VIEW_Z])
    density = np.exp(-0.5 * (p * p + q * q))
    area = np.maximum(vx * gx - vz, facets.LEAST_COSINE)
    cosine = area / np.sqrt(1 + gx * gx + gy * gy)
    sine = np.sqrt(1 - cosine**2) / 1.333
    inside = np.sqrt(1 - sine**2)
    s = (cosine - 1.333 * inside) / (cosine + 1.333 * inside)
    t = (1.333 * cosine - inside) / (1.333 * cosine + inside)
    weight = density * area * (s * s + t * t) / 2
    share = weight.sum() / (density * area).sum()
    if light is None:
        return share
    rise = vz + 2 * cosine / np.sqrt(1 + gx * gx + gy * gy)
    seen = light(np.degrees(np.arcsin(np.clip(np.maximum(rise, 0.02), -1, 1))))
    return share, (weight * seen).sum() / weight.sum(), (density * seen).sum() / density.sum()


@pytest.mark.parametrize("degrees", [8, 14, 25, 45, 80])
@pytest.mark.parametrize("slope", [0.02, 0.06, 0.1])
def test_the_reflectance_is_the_mean_over_all_facets(degrees, slope):
    records = np.stack([water(degrees, slope), water(degrees, slope, 0.5), water(degrees, 0)])
    found = np.full(3, np.nan, F4)
    reflectance_of(records, found)
    steep = slope / math.tan(math.radians(degrees))  # of the facets over the angle of view
    for record, share in zip(records[:2], found, strict=False):
        assert share == pytest.approx(summed(record), rel=0.01 + 0.12 * max(steep - 0.3, 0))
    if steep > 0.3:
        assert abs(found[0] / found[2] - 1) > 0.05  # one facet for all is something else


def test_facets_that_mirror_the_low_dark_weigh_less_than_their_number():
    # A hedge up to 15 degrees before a bright sky: the picture's rows go from the zenith down.
    rows = 720
    elevation = 90 - (np.arange(rows) + 0.5) / rows * 180
    environment = np.repeat((elevation > 15).astype(F4)[:, None, None], 8, axis=1)
    environment = np.ascontiguousarray(np.repeat(environment, 3, axis=2))
    records = np.stack([water(d, 0.1) for d in (12, 15, 20, 28)])
    found = np.full(len(records), np.nan, F4)
    light_of(records, environment, found)
    for record, light in zip(records, found, strict=True):
        share, weighed, plain = summed(record, lambda e: (e > 15).astype(float))
        assert light == pytest.approx(weighed, abs=0.16)  # seven facets for a hard edge
        assert 0.02 < share < 0.4 and 0 < weighed < 1 and plain > 0
    # On the mean over these angles, where the steps of single facets fall out, weights tell.
    weighed, plain = np.mean([summed(r, lambda e: (e > 15).astype(float))[1:] for r in records], 0)
    assert abs(found.mean() - weighed) < 0.6 * abs(plain - weighed)
