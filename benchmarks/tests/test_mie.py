"""Mie's series over the drop spectrum: published values, limits, and the closed form."""

import numpy as np
import pytest

from benchmarks.mie import extinction_efficiency, spectrum_attenuation, water_permittivity
from rainsim.drops import RainSpectrum
from rainsim.sensors.radar import rain_attenuation


def test_a_sphere_as_in_the_book():
    """Bohren and Huffman 1983, appendix A: radius 0.525 um, 0.6328 um, index 1.55."""
    size = 2 * np.pi * 0.525 / 0.6328
    assert extinction_efficiency(size, 1.55 + 0j) == pytest.approx(3.10543, abs=1e-5)


def test_small_and_large_spheres_reach_their_limits():
    index = np.sqrt(water_permittivity(10.0))
    size = 0.01
    rayleigh = 4 * size * ((index**2 - 1) / (index**2 + 2)).imag
    assert extinction_efficiency(size, index) == pytest.approx(rayleigh, rel=0.01)
    assert extinction_efficiency(150.0, 1.33 + 1e-2j) == pytest.approx(2, abs=0.15)


def test_water_is_lossy_and_nearly_static_at_low_frequencies():
    still, fast = water_permittivity(0.01), water_permittivity(77.0)
    assert still.real == pytest.approx(80.1, abs=0.3) and 0 < still.imag < 0.1
    assert 5 < fast.real < 12 and 10 < fast.imag < 20


@pytest.mark.parametrize("frequency", [24.0, 77.0])
def test_attenuation_is_near_the_closed_form(frequency):
    for rate in (10.0, 25.0, 50.0):
        ours = spectrum_attenuation(RainSpectrum(rate), frequency)
        assert ours == pytest.approx(float(rain_attenuation(rate, frequency)), rel=0.25)
    assert spectrum_attenuation(RainSpectrum(0.0), frequency) == 0
