"""Rules of single settings, and what their messages show."""

from __future__ import annotations

import os

from rainsim.config.preset_files import SKIES, is_number
from rainsim.errors import InputError, ParameterError, shown


def check_sky(sky):
    """Raise an error unless `sky` is a known name or an existing .hdr file."""
    if sky in SKIES:
        return
    if not isinstance(sky, str) or not sky.lower().endswith(".hdr"):
        raise ParameterError(
            f"sky is {shown(sky)}; it must be {' or '.join(SKIES)} or the path of a Radiance .hdr "
            "file"
        )
    if not os.path.isfile(sky):  # pathlib raises where a name is too long for any file
        raise InputError(f"there is no sky file {sky}; check the path, or use overcast")


def require_whole(name, value, low, high, unit=""):
    """Return `value`, or raise ParameterError unless it is a whole number from low to high."""
    unit = f" {unit}" if unit else ""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ParameterError(
            f"{name} is {shown(value)}{unit}; it must be a whole number from {low} to {high}{unit}"
        )
    return value


def pair(name, value, what):
    """Return `value`, or raise ParameterError unless it is two values, which `what` names."""
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise ParameterError(f"{name} is {shown(value)}; it must be {what}")
    return value


def rounded(value):
    """Return a number as a person wrote it: without the noise of a change of units."""
    return float(f"{value:.9g}") if is_number(value) else value
