"""How many drops of which size and speed a rain of so many mm/h holds.

Marshall and Palmer's exponential spectrum, renormalised so that a gauge reads the rate asked for;
drops from 0.5 to 6 mm in classes of one speed each, smaller ones as continuous rain and fog.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.special import gammainc

from rainsim.errors import ParameterError, require_choice, require_not_negative
from rainsim.jit import device_function

SMALLEST = 0.5e-3  # m; smaller drops are not tracked one by one
LARGEST = 6.0e-3  # m; larger drops break up as they fall
CLASSES = 48  # even steps of log speed: 3.1 % from class to class
_HIGHEST_RATE = 2000.0  # mm/h; about the highest minute ever measured
_SHAPE_FLOOR = 1e-3  # mm/h; below it the spectrum keeps its shape, which has no limit at 0
_REFERENCE_RATE = 10.0  # mm/h; the rain whose class means fix the classes' speeds
LEAST_DECAY = 1.0  # 1/m: diameters as good as even within a class, which a decay of 0 cannot say
PAPER_RADIUS = 0.5e-3  # m, mean of the paper's exponential radii; it does not say which
PAPER_SPEED = 6.0  # m/s, of all its drops; it leaves that to its user: here that of 1.8 mm
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


@device_function
def terminal_speed(diameter):
    """Fall speed of a drop [m/s] in still air at sea level; `diameter` in metres.

    Brandes, Zhang and Vivekanandan 2002, J. Appl. Meteorol. 41, 674, their polynomial, here from
    0.1 to 6 mm; within 2 % of Gunn and Kinzer (1949) from 1 to 6 mm. Below 0.02 mm, where it
    would be negative, the speed is 0.
    """
    d = diameter * 1000.0
    speed = -0.1021 + d * (4.932 + d * (-0.9551 + d * (0.07934 + d * -0.002362)))
    return np.maximum(speed, 0.0)


class SizeLaw(NamedTuple):
    """How the diameters of a rain's drops are distributed, up to a factor.

    N(D) = intercept (D / 1 mm)^shape exp(-decay D), a gamma distribution; of shape 0 an
    exponential one.
    """

    source: str  # for people: whose law it is
    decay: float  # 1/m
    shape: float = 0.0
    speed: float | None = None  # m/s, of all drops; None: each falls at its own, `terminal_speed`

    def number(self, diameter):
        """Return N(D) over the intercept at diameters [m]."""
        return (diameter * 1e3) ** self.shape * np.exp(-self.decay * diameter)

    def number_between(self, low, high):
        """Return the integral of `number` from diameters `low` to `high` [m]."""
        if self.shape == 0:
            return (np.exp(-self.decay * low) - np.exp(-self.decay * high)) / self.decay
        power = self.shape + 1
        whole = 1e3**self.shape * math.gamma(power) / self.decay**power
        return whole * (gammainc(power, self.decay * high) - gammainc(power, self.decay * low))

    def decay_within(self, low, high):
        """Return the decay [1/m] of the exponential that is nearest between two diameters [m]."""
        decay = self.decay - self.shape * 2 / (low + high)
        return np.where(np.abs(decay) < LEAST_DECAY, LEAST_DECAY, decay)

    @property
    def text(self):
        """The law as an equation, for files."""
        power = f" (D / 1 mm)^{self.shape:g}" if self.shape else ""
        return f"N(D) = intercept{power} exp(-decay D)"


def marshall_palmer(rate_mm_per_hour):
    """Return Marshall and Palmer's `SizeLaw` at a rate, see `RainSpectrum`."""
    rate = max(rate_mm_per_hour, _SHAPE_FLOOR)
    return SizeLaw("Marshall and Palmer 1948", 4.1e3 * rate**-0.21)


def paper_sizes(_rate):
    """Return the `SizeLaw` of the paper: one for all rates, and one speed."""
    return SizeLaw("the paper's radii", 1 / (2 * PAPER_RADIUS), speed=PAPER_SPEED)


# Laws by the name that a configuration gives them (`RainConfig.drop_radii`).
SIZE_LAWS = {"measured": marshall_palmer, "paper": paper_sizes}


class RainSpectrum:
    """The drops of a rain.

    rate_mm_per_hour : float [mm/h]. What a gauge collects; 0 gives a spectrum
        without drops.
    radii : str. Name of one of `SIZE_LAWS`: "measured", or "paper" for the
        baseline of the paper (RainyGS): radii of one exponential distribution
        whatever the rate, and one speed for all drops. There are as many drops as
        the rate asks for; the paper leaves their number to its user.
    decay : float [1/m]. Of the law.
    intercept : float [1/m4]. Of the law: as many drops as bring the rate.
    edges : float64 array (CLASSES + 1,) [m]. Diameters between the classes.
    density : float64 array (CLASSES,) [1/m3]. Drops per volume of air.
    speed : float64 array (CLASSES,) [m/s]. The one fall speed of all drops of the
        class; the same at every rate, so that drops stay where they are when the
        rate changes.
    extinction : float64 array (CLASSES,) [1/m]. Shadow area per volume, (pi/4)
        integral N D^2 dD.
    fine_rate : float [m/s]. Rate of the drops under SMALLEST: what to add as
        continuous rain.

    Marshall and Palmer 1948, J. Meteorol. 5, 165: Lambda = 4.1 R^-0.21 per mm, R in mm/h. Their
    N0 = 8000 m^-3 mm^-1 with real fall speeds returns 9 to 19 % too much water, so N0 is chosen
    here to satisfy integral_0^LARGEST N v (pi/6) D^3 dD = rate, with the classes' speeds for v.
    """

    def __init__(self, rate_mm_per_hour, radii="measured"):
        require_choice("radii", radii, tuple(SIZE_LAWS))
        rate = require_not_negative("rain rate", rate_mm_per_hour, "mm/h")
        if rate > _HIGHEST_RATE:
            raise ParameterError(
                f"rain rate is {rate_mm_per_hour!r} mm/h; it must be at most {_HIGHEST_RATE:g}; "
                "the rate is in millimetres per hour"
            )
        self.rate = rate / 3.6e6
        self.radii, self.law = radii, SIZE_LAWS[radii](rate)
        law, self.decay = self.law, self.law.decay
        self.edges = class_edges()
        fine_edges = np.linspace(0.0, SMALLEST, 9)
        if law.speed is None:
            self.speed = class_speeds()
            fine_flux = _moments(_volume_flux, law, fine_edges).sum()
        else:
            self.speed = np.full(CLASSES, law.speed)
            fine_flux = law.speed * _moments(drop_volume, law, fine_edges).sum()
        volume = _moments(drop_volume, law, self.edges)
        self.intercept = self.rate / (volume @ self.speed + fine_flux)

        self.density = self.intercept * _moments(np.ones_like, law, self.edges)
        self.extinction = self.intercept * _moments(_shadow, law, self.edges)
        self.fine_rate = self.intercept * fine_flux
        self.fine_extinction = self.intercept * _moments(_shadow, law, fine_edges).sum()

    @property
    def class_decay(self):
        """Decay [1/m] of the diameters within each class, ndarray of shape (CLASSES,)."""
        return self.law.decay_within(self.edges[:-1], self.edges[1:])

    def diameters(self, size_class, chance):
        """Return diameters [m] of drops of some classes, by chances from 0 to 1."""
        decay, low = self.class_decay[size_class], self.edges[size_class]
        share = -np.expm1(-decay * (self.edges[size_class + 1] - low))
        return low - np.log(1 - chance * share) / decay


def class_edges():
    """Return the diameters [m] between the classes: even steps of log terminal speed."""
    diameter = np.linspace(SMALLEST, LARGEST, 20001)
    log_speed = np.log(np.maximum.accumulate(terminal_speed(diameter)))
    edges = np.interp(np.linspace(log_speed[0], log_speed[-1], CLASSES + 1), log_speed, diameter)
    edges[0], edges[-1] = SMALLEST, LARGEST
    return edges


def class_speeds():
    """Return each class's fall speed [m/s], mean by volume at 10 mm/h: off by .7 % at most."""
    edges, law = class_edges(), marshall_palmer(_REFERENCE_RATE)
    return _moments(_volume_flux, law, edges) / _moments(drop_volume, law, edges)


@device_function
def drop_volume(diameter):
    """Volume of a drop [m3] of the given equivalent `diameter` [m]."""
    return math.pi / 6 * diameter**3


def _moments(weight, law, edges):
    """Integrate weight(D) law.number(D) between the edges, by Gauss-Legendre quadrature."""
    low, high = edges[:-1, None], edges[1:, None]
    diameter = low + (high - low) * (_NODES + 1) / 2
    values = weight(diameter) * law.number(diameter)
    return (values * _WEIGHTS).sum(axis=1) * (high - low)[:, 0] / 2


def _volume_flux(diameter):
    return terminal_speed(diameter) * drop_volume(diameter)


def _shadow(diameter):
    return math.pi / 4 * diameter**2
