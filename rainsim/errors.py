"""The errors a user can meet, and the checks at the border that raise them.

A message names the value, the rule and the remedy. `cli` prints it as one line;
kernels never raise.
"""

import math
from numbers import Real


class RainsimError(Exception):
    """Base of all errors that rainsim raises on purpose; the command exits with 1."""


class ParameterError(RainsimError, ValueError):
    """A value that a user gave breaks a rule; the command exits with 2."""


class InputError(RainsimError):
    """A file cannot be read as what it is meant to be."""


class GroundError(RainsimError):
    """The ground, the up direction or the scale cannot be found from the given data."""


class BackendError(RainsimError):
    """The backend that was asked for cannot run here."""


class DivergedError(RainsimError):
    """A simulation produced values that no physical state has."""


def require_finite(name, value, remedy=""):
    """Return `value` as a float, or raise ParameterError if it is not a finite number."""
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise ParameterError(_line(f"{name} is {value!r}; it must be a finite number", remedy))
    return float(value)


def require_positive(name, value, unit="", remedy=""):
    """Return `value` as a float, or raise ParameterError unless it is finite and above zero."""
    if require_finite(name, value, remedy) <= 0:
        rule = f"{name} is {value!r}{_unit(unit)}; it must be positive"
        raise ParameterError(_line(rule, remedy))
    return float(value)


def require_not_negative(name, value, unit="", remedy=""):
    """Return `value` as a float, or raise ParameterError unless it is finite and not below zero."""
    if require_finite(name, value, remedy) < 0:
        raise ParameterError(
            _line(f"{name} is {value!r}{_unit(unit)}; it must not be negative", remedy)
        )
    return float(value)


def require_choice(name, value, choices, remedy=""):
    """Return `value`, or raise ParameterError unless it is one of `choices`."""
    if value not in choices:
        listed = ", ".join(map(str, choices))
        raise ParameterError(_line(f"{name} is {value!r}; it must be one of {listed}", remedy))
    return value


def _unit(unit):
    return f" {unit}" if unit else ""


def _line(rule, remedy):
    return f"{rule}; {remedy}" if remedy else rule
