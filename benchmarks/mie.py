"""Extinction of radar waves by the drops of a rain: Mie's series over the drop spectrum.

A check of the closed form in `rainsim.sensors.radar`, which is fitted to other drop spectra.
"""

import math

import numpy as np
from scipy.special import spherical_jn, spherical_yn

from rainsim.rain.size_distribution import LARGEST

LIGHT_SPEED = 299792458.0  # m/s
TEMPERATURE = 293.15  # K, of the water
NODES = 200  # diameters of the integral over the spectrum
DB = 10 / math.log(10)  # per neper of power


def water_permittivity(frequency_ghz, temperature=TEMPERATURE):
    """Return the relative permittivity of water, its imaginary part positive.

    frequency_ghz : float [GHz]. Up to 1000.
    temperature : float [K]

    Liebe, Hufford and Manabe 1991, Int. J. Infrared Millim. Waves 12, 659: two Debye terms.
    """
    theta = 1 - 300 / temperature
    static = 77.66 - 103.3 * theta
    middle, last = 0.0671 * static, 3.52 + 7.52 * theta
    first = 20.20 + 146.4 * theta + 316 * theta**2  # GHz
    second = 39.8 * first
    f = frequency_ghz
    lost = (static - middle) * f / (f + 1j * first) + (middle - last) * f / (f + 1j * second)
    return static - lost


def extinction_efficiency(size, index):
    """Return the extinction of a sphere over its section.

    size : float. Circumference over wavelength.
    index : complex. Refractive index, its imaginary part positive for a sphere
        that absorbs.

    Bohren and Huffman 1983, Absorption and Scattering of Light by Small Particles, 4.53 and 4.62.
    """
    count = int(size + 4 * size ** (1 / 3) + 10)
    n = np.arange(1, count + 1)
    inner = index * size

    def riccati(bessel, z):
        """Return z f(z) and its derivative for each order."""
        value = bessel(n, z)
        return z * value, value + z * bessel(n, z, derivative=True)

    psi, psi_slope = riccati(spherical_jn, size)
    chi, chi_slope = riccati(spherical_yn, size)
    own, own_slope = riccati(spherical_jn, inner)
    xi, xi_slope = psi + 1j * chi, psi_slope + 1j * chi_slope
    a = (index * own * psi_slope - psi * own_slope) / (index * own * xi_slope - xi * own_slope)
    b = (own * psi_slope - index * psi * own_slope) / (own * xi_slope - index * xi * own_slope)
    return float(2 / size**2 * ((2 * n + 1) * (a + b).real).sum())


def spectrum_attenuation(spectrum, frequency_ghz):
    """Return the specific attenuation [dB/km] one way by the drops of a `RainSpectrum`.

    Drops count as spheres.
    """
    wavelength = LIGHT_SPEED / (frequency_ghz * 1e9)
    index = np.sqrt(water_permittivity(frequency_ghz))
    diameter = LARGEST * (np.arange(NODES) + 0.5) / NODES
    section = math.pi / 4 * diameter**2
    efficiency = [extinction_efficiency(math.pi * d / wavelength, index) for d in diameter]
    number = spectrum.intercept * spectrum.law.number(diameter) * LARGEST / NODES
    return float(DB * 1e3 * (number * section * efficiency).sum())
