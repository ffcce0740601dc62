"""The errors a user can meet, and the checks at the border that raise them.

A message names the value, the rule and the remedy. `cli` prints it as one line;
kernels never raise.
"""

import math
from numbers import Real

MOST_VALUE = 60  # characters of a value in a message
MOST_SHOWN = 640  # characters of a message, of which the last third is its end


def one_line(text, most=MOST_SHOWN):
    """Return a text as one line of at most `most` printable characters, cut in its middle.

    Messages repeat what was found in files: names that hold commands for the terminal, values of
    any length. What is no printable character is shown as Python writes it in a string.
    """
    text = text if isinstance(text, str) else shown(text)
    if len(text) > most:
        end = most // 3
        text = f"{text[: most - end - 5]} ... {text[-end:]}"
    words = " ".join(text.split())
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in words)


def shown(value, most=MOST_VALUE):
    """Return a value from a file as a message shows it, cut if it is long."""
    try:
        text = repr(value)
    except (RecursionError, ValueError):  # lists within lists; a number of thousands of digits
        text = "too long to be shown"
    return text if len(text) <= most else text[: most - 3] + "..."


def counted(number, thing):
    """Return a number and its noun as a message shows them: "1 frame", "2 frames"."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


class RainsimError(Exception):
    """Base of all errors that rainsim raises on purpose; the command exits with 1."""

    def __init__(self, message=""):
        super().__init__(one_line(str(message)))


class ParameterError(RainsimError, ValueError):
    """A value that a user gave breaks a rule; the command exits with 2."""


class InputError(RainsimError):
    """A file cannot be read as the kind of file that it should be."""


class GroundError(RainsimError):
    """The ground, the up direction or the scale cannot be found from the given data."""


class BackendError(RainsimError):
    """The backend that was asked for cannot run here."""


class DivergedError(RainsimError):
    """A simulation produced values that no physical state has."""


def require_finite(name, value, remedy=""):
    """Return `value` as a float, or raise ParameterError if it is not a finite number."""
    try:
        if not isinstance(value, bool) and isinstance(value, Real) and math.isfinite(value):
            return float(value)
    except OverflowError:  # a whole number beyond all floats
        pass
    raise ParameterError(_line(f"{name} is {shown(value)}; it must be a finite number", remedy))


def require_positive(name, value, unit="", remedy=""):
    """Return `value` as a float, or raise ParameterError unless it is finite and above zero."""
    if require_finite(name, value, remedy) <= 0:
        rule = f"{name} is {shown(value)}{_unit(unit)}; it must be positive"
        raise ParameterError(_line(rule, remedy))
    return float(value)


def require_not_negative(name, value, unit="", remedy=""):
    """Return `value` as a float, or raise ParameterError unless it is finite and not below zero."""
    if require_finite(name, value, remedy) < 0:
        raise ParameterError(
            _line(f"{name} is {shown(value)}{_unit(unit)}; it must not be negative", remedy)
        )
    return float(value)


def require_choice(name, value, choices, remedy=""):
    """Return `value`, or raise ParameterError unless it is one of `choices`."""
    if value not in choices:
        listed = ", ".join(map(str, choices))
        raise ParameterError(_line(f"{name} is {shown(value)}; it must be one of {listed}", remedy))
    return value


def _unit(unit):
    return f" {unit}" if unit else ""


def _line(rule, remedy):
    return f"{rule}; {remedy}" if remedy else rule
