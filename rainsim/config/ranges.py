"""The ranges of settings beyond which nothing can be meant, and formulas overflow or never end."""

from __future__ import annotations

from rainsim.config.preset_files import is_number
from rainsim.config.rules import rounded
from rainsim.errors import ParameterError

TURNS = 1e4  # rad, of a direction; float32 no longer keeps more turns to a degree
FARTHEST = 1e12  # capture units, as `rainsim.io.files.MAX_LENGTH`
# Least and greatest value [SI], what one of the unit in messages is in SI, and that unit.
RANGES = {
    "fps": (0.1, 9999.0, 1.0, " frames/s"),
    "spacing": (1e-3, 0.5, 1.0, " m"),
    "extent": (1e-3, 1e5, 1.0, " m"),
    "drying": (0.0, 3.6e7, 3600.0, " h"),
    "level": (-1000.0, 1000.0, 1.0, " m"),
    "courant": (1e-3, 1.0, 1.0, ""),
    "exposure": (1e-6, 10.0, 1e-3, " ms"),
    "daylight": (1e-4, 1.0, 1.0, ""),
    "puddles": (0.0, 2.0, 1.0, ""),
    "wetness": (0.0, 2.0, 1.0, ""),
    "ripples": (0.0, 2.0, 1.0, ""),
    "exposure_bias": (-5.0, 5.0, 1.0, " EV"),
    "brightness": (1e-3, 1000.0, 1.0, ""),
    "ground_albedo": (1e-3, 1.0, 1.0, ""),
    "focus": (1e-3, 1e6, 1.0, " m"),
    "streak_far": (0.1, 1000.0, 1.0, " m"),
    "merge": (0.0, 1e4, 1.0, " px"),
    "detail": (0.0, 1e4, 1.0, " px"),
    "memory": (1e6, 1e15, 1e9, " GB"),
    "wind": (-TURNS, TURNS, 1.0, ""),
    "sun": (-TURNS, TURNS, 1.0, " rad"),
    "surroundings": (-FARTHEST, FARTHEST, 1.0, " units"),
}


def check_ranges(settings):
    """Raise ParameterError if an attribute of a group of settings is out of its range.

    Parameters
    ----------
    settings : dataclass
        Its own `check` has passed: what is a number is finite.
    """
    for name, (low, high, one, unit) in RANGES.items():
        value = getattr(settings, name, None)
        for number in value if isinstance(value, tuple | list) else (value,):
            if is_number(number) and not low / one <= rounded(number / one) <= high / one:
                raise ParameterError(
                    f"{name} is {rounded(number / one)}{unit}; it must lie from {low / one:g} to "
                    f"{high / one:g}{unit}"
                )
