"""Rules of single settings: whether a value may stand, in the units that people write.

A rule is called with the setting's name, its value and the unit, and raises an error that names
value, rule and remedy.
"""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass

from rainsim import errors

MM_PER_HOUR = 1e-3 / 3600  # m/s
SKIES = ("overcast", "capture")


@dataclass(frozen=True)
class Number:
    """A finite number between two ends; `positive`, `not_negative` and `finite` make one."""

    sign: Callable  # its first check
    remedy: str = ""  # a usual value
    label: str = ""  # the setting's name in messages, where its attribute is none
    low: float = -math.inf  # beyond the ends nothing can be meant, or formulas overflow
    high: float = math.inf
    most: str = ""  # the upper end as a message says it; without it the message names both

    def __call__(self, name, value, unit):
        """Raise ParameterError unless `value` obeys."""
        name = self.label or name
        self.sign(name, value, unit, self.remedy)
        if self.low <= rounded(value) <= self.high:
            return
        unit = f" {unit}" if unit else ""
        rule = f"lie from {self.low:g} to {self.high:g}{unit}"
        if value > self.high and self.most:
            rule = f"be at most {self.most}"
        elif self.remedy:
            rule += f"; {self.remedy}"
        raise errors.ParameterError(f"{name} is {value}{unit}; it must {rule}")


def positive(remedy="", **bounds):
    """Return the rule of a number above zero; `bounds` are attributes of `Number`."""
    return Number(errors.require_positive, remedy, **bounds)


def not_negative(remedy="", **bounds):
    """Return the rule of a number that is zero or more; `bounds` are attributes of `Number`."""
    return Number(errors.require_not_negative, remedy, **{"low": 0.0} | bounds)


def finite(remedy="", **bounds):
    """Return the rule of a number of either sign; `bounds` are attributes of `Number`."""
    return Number(lambda name, x, _, more: errors.require_finite(name, x, more), remedy, **bounds)


class OneOf:
    """One of some values; where there are two, the second is mostly the paper's."""

    def __init__(self, *choices, remedy="", label=""):
        self.choices, self.remedy, self.label = choices, remedy, label

    def __call__(self, name, value, unit):
        """Raise ParameterError unless `value` is one of them."""
        errors.require_choice(self.label or name, value, self.choices, self.remedy)


def whole(low, high):
    """Return the rule of a whole number from `low` to `high`."""
    return lambda name, value, unit: require_whole(name, value, low, high, unit)


def check_sky(sky):
    """Raise an error unless `sky` is a known name or an existing .hdr file."""
    if sky in SKIES:
        return
    if not isinstance(sky, str) or not sky.lower().endswith(".hdr"):
        raise errors.ParameterError(
            f"sky is {errors.shown(sky)}; it must be {' or '.join(SKIES)} or the path of a "
            "Radiance .hdr file"
        )
    if not os.path.isfile(sky):  # pathlib raises where a name is too long for any file
        raise errors.InputError(f"there is no sky file {sky}; check the path, or use overcast")


def require_whole(name, value, low, high, unit=""):
    """Return `value`, or raise ParameterError unless it is a whole number from low to high."""
    unit = f" {unit}" if unit else ""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise errors.ParameterError(
            f"{name} is {errors.shown(value)}{unit}; it must be a whole number from {low} to "
            f"{high}{unit}"
        )
    return value


def pair(name, value, what):
    """Return `value`, or raise ParameterError unless it is two values, which `what` names."""
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise errors.ParameterError(f"{name} is {errors.shown(value)}; it must be {what}")
    return value


def rounded(value):
    """Return a number as a person wrote it: without the noise of a change of units."""
    return float(f"{value:.9g}") if is_number(value) else value


def is_number(value):
    """Return whether a value is a number that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return isinstance(value, float) or abs(value) < 2**63  # TOML allows any length
