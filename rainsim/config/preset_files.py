"""Preset files: where they lie, and how their keys, in the units of people, are read."""

import difflib
import math
import tomllib
from importlib import resources
from pathlib import Path

from rainsim.config.rules import SKIES, is_number
from rainsim.config.tables import HUMAN_KEYS, PARTS
from rainsim.errors import MOST_VALUE, InputError, ParameterError, shown

MOST_BYTES, LONGEST_LINE = 1 << 20, 1000  # of a preset file; 10,000 keyframes fit
DEFAULT_PRESET = "downpour"  # what a newcomer sees first: rain that shows at once


def preset_names():
    """Return the names of the built-in presets, from dry to wet.

    Examples
    --------
    >>> rainsim.preset_names()
    ['drizzle', 'moderate', 'downpour', 'flood', 'after', 'dusk', 'paper']
    """
    return ["drizzle", "moderate", "downpour", "flood", "after", "dusk", "paper"]


def preset_text(name):
    """Return the TOML text of a built-in preset or of a TOML file."""
    return preset_file(name)[0]


def preset_file(name):
    """Return the text, its name in errors and the folder for relative paths."""
    if isinstance(name, Path) or str(name).endswith(".toml"):
        from rainsim.io.files import read_text  # brings numpy, which `--help` does without

        path = Path(name)
        text = read_text(path, "a preset file", MOST_BYTES)
        longest = max(map(len, text.splitlines()), default=0)
        if longest > LONGEST_LINE:  # a key of thousands of dots takes gigabytes to parse
            raise InputError(
                f"{path} has a line of {longest} characters; a preset file must have at most "
                f"{LONGEST_LINE} in each; check the path"
            )
        return text, str(path), path.parent
    if name not in preset_names():
        raise ParameterError(
            f"there is no preset {shown(name)}; {nearest(name, preset_names())}; see `rainsim "
            "presets`, or give a path that ends in .toml"
        )
    file = resources.files(__package__).joinpath("presets", f"{name}.toml")
    return file.read_text(encoding="utf-8"), f"preset {name}", None


def parsed_toml(text, where):
    """Return the table of a TOML text; `where` names it in errors."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        fault = str(error)
    except RecursionError:
        fault = "lists within lists without end"
    except ValueError:  # Python reads no number of more than 4,300 digits
        fault = "a number of thousands of digits"
    raise ParameterError(
        f"{where} is not valid TOML ({fault}); it must hold lines of key = value; compare with "
        "`rainsim presets moderate`"
    )


def from_human(table, where, folder=None):
    """Return attributes in SI units from a table of preset keys."""
    for key in table:
        if key not in HUMAN_KEYS:
            raise ParameterError(
                f"{where} has the key {shown(key)}; {nearest(key, HUMAN_KEYS)}; correct the key"
            )
    changes = {}
    for key, value in table.items():
        attribute, unit = HUMAN_KEYS[key]
        if unit is not None:
            if not is_number(value) or not math.isfinite(value):
                raise ParameterError(
                    f"{where}: {key} is {shown(value)}; it must be a finite number; correct it"
                )
            value = value * unit
        table[key] = value
        if attribute not in PARTS:
            changes[attribute] = value
    for attribute, keys in PARTS.items():
        given = [key for key, _ in keys if key in table]
        if not given:
            continue
        lacking = [key for key, default in keys if key not in table and default is None]
        if lacking:
            raise ParameterError(
                f"{where} has {given[0]} but no {lacking[0]}; give all of "
                f"{', '.join(key for key, _ in keys)}"
            )
        changes[attribute] = tuple(table.get(key, default) for key, default in keys)
    sky = changes.get("sky")
    if folder is not None and isinstance(sky, str) and sky not in SKIES:
        changes["sky"] = str(folder / sky)
    return changes


def nearest(name, known, hint="the nearest is {!r}", otherwise="known are {}"):
    """Return a hint that names the known word closest to `name`, or all if none is close."""
    close = difflib.get_close_matches(str(name)[:MOST_VALUE], list(known), n=1, cutoff=0.5)
    return hint.format(close[0]) if close else otherwise.format(", ".join(known))
