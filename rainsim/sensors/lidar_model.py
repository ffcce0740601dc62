"""Model of a lidar: its beams, the power of an echo, and the choice of the echo it reports.

Powers are relative: an echo of reflectivity rho at range R through rain of extinction alpha has
rho exp(-2 alpha R) / R^2, and the least that is measured is that of rho = 0.9 at the sensor's
greatest range in clear air. A drop in the beam echoes with the reflectivity of water at normal
incidence, times the share of the beam's section that it fills. So has LISA (Kilic, Hegde, Sindagi
et al. 2021, arXiv 2107.07004, and pylisa/lisa.py), which `rainsim.sensors.lisa` draws.
"""

import math
from dataclasses import dataclass

import numpy as np

from rainsim.errors import ParameterError, require_not_negative, require_positive

REFRACTIVE_INDEX = 1.328  # of water at 905 nm, as LISA has it
DROP_REFLECTIVITY = ((REFRACTIVE_INDEX - 1) / (REFRACTIVE_INDEX + 1)) ** 2  # normal incidence
CALIBRATION = 0.9  # reflectivity of the target that the greatest range is given for
EXTINCTION_EFFICIENCY = 2.0  # of drops much larger than the wavelength: Mie's limit
WATER_ABSORPTION = 6.8  # 1/m at 905 nm (Hale and Querry 1973, Appl. Opt. 12, table I)
# Transmittance at which a beam ends. Behind a surface of splats a little always shines through, and
# a hundredth of a beam that meets a sky 500 m away would put a mean of distances 5 m too far.
PASSED = 0.2
# Labels; the first three are LISA's.
LOST, SCATTERED, KEPT, MIRRORED = range(4)
LABEL_NAMES = {LOST: "lost", SCATTERED: "scattered", KEPT: "kept", MIRRORED: "mirrored"}


@dataclass(frozen=True)
class Lidar:
    """A spinning lidar."""

    elevation: tuple  # rad, of each channel, from the lowest
    columns: int = 1800  # pulses of a channel in a turn
    rate: float = 10.0  # 1/s, turns
    far: float = 100.0  # m, the greatest range, of a target of reflectivity 0.9 in clear air
    near: float = 1.5  # m, the least range
    divergence: float = 3e-3  # rad, full angle of the beam; it begins as a point
    accuracy: float = 0.09  # m: an echo of signal to noise s is off by accuracy / sqrt(2 s)

    def __post_init__(self):
        """Raise ParameterError if a value breaks its rule."""
        for name, unit in (("columns", ""), ("rate", "turns/s"), ("far", "m"), ("near", "m"),
                           ("divergence", "rad")):  # fmt: skip
            require_positive(f"lidar {name}", getattr(self, name), unit)
        require_not_negative("lidar accuracy", self.accuracy, "m")
        if not self.near < self.far:
            raise ParameterError(
                f"lidar near is {self.near} m and far {self.far} m; near must be less; correct one"
            )
        if not self.elevation or not all(abs(e) < math.pi / 2 for e in self.elevation):
            raise ParameterError(
                f"lidar elevations are {self.elevation}; there must be one or more, each less than "
                "90 degrees up or down"
            )

    @property
    def least_power(self):
        """The least power that is measured [1/m2]."""
        return CALIBRATION / self.far**2

    def beams(self):
        """Return the directions (n, 3) of a turn's beams and the time of each since its begin [s].

        Sensor frame: x ahead, y left, z up. The turn begins behind the sensor and goes clockwise
        seen from above, column by column, each from the lowest channel up.
        """
        azimuth = math.pi - 2 * math.pi * (np.arange(self.columns) + 0.5) / self.columns
        time = (np.arange(self.columns) + 0.5) / self.columns / self.rate
        up = np.array(self.elevation)
        a, e = (grid.ravel() for grid in np.meshgrid(azimuth, up, indexing="ij"))
        level = np.cos(e)
        direction = np.stack([level * np.cos(a), level * np.sin(a), np.sin(e)], axis=1)
        return direction, np.repeat(time, len(up))

    def drop_reach(self, diameter):
        """Return the range [m] up to which a drop in clear air echoes enough to be measured.

        It fills (D / (R tan divergence))^2 of the beam, at most all of it.
        """
        share = DROP_REFLECTIVITY / self.least_power
        diameter = np.asarray(diameter, np.float64)
        thin = (share * (diameter / math.tan(self.divergence)) ** 2) ** 0.25
        return np.minimum(np.maximum(thin, 0.0), math.sqrt(share))


def _evenly(low, high, count):
    return tuple(math.radians(low + (high - low) * k / (count - 1)) for k in range(count))


# From the makers' data sheets: channels, ranges and beam divergence (the wider one).
SENSORS = {
    "vlp16": Lidar(_evenly(-15, 15, 16), 1800, 10.0, 100.0, 1.0, 3.0e-3, 0.06),
    "hdl32": Lidar(_evenly(-30.67, 10.67, 32), 2170, 10.0, 100.0, 1.0, 3.0e-3, 0.04),
    "hdl64": Lidar(_evenly(-24.8, 2, 64), 2083, 10.0, 120.0, 1.5, 2.0e-3, 0.04),
}


def extinction_of(spectrum):
    """Return the extinction [1/m] of a `RainSpectrum` for a laser beam."""
    shadow = float(spectrum.extinction.sum()) + spectrum.fine_extinction
    return EXTINCTION_EFFICIENCY * shadow


def echo_power(reflectivity, distance, extinction):
    """Return the relative power of an echo [1/m2]; arguments may be arrays."""
    return reflectivity * np.exp(-2 * extinction * distance) / distance**2


def drop_reflectivity(diameter, distance, divergence):
    """Return the reflectivity of a drop in the beam: water's, by the share of the beam it fills."""
    return DROP_REFLECTIVITY * np.minimum((diameter / (math.tan(divergence) * distance)) ** 2, 1.0)


def fresnel_of(cosine, index=REFRACTIVE_INDEX):
    """Return the reflectance of smooth water for unpolarized light, and the refracted cosine."""
    c = np.clip(cosine, 0, 1)
    t = np.sqrt(1 - (1 - c * c) / index**2)
    s, p = (c - index * t) / (c + index * t), (index * c - t) / (index * c + t)
    return 0.5 * (s * s + p * p), t
