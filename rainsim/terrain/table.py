"""The table of ground classes, rainsim/config/classes.toml."""

import functools
import tomllib
from dataclasses import dataclass
from importlib import resources

import numpy as np

HARD, GRASS, SOIL, OBJECT, WATER, DRAIN = range(6)  # the codes in the table; HARD is its paving

# How keys of the TOML end that have a unit, and the factor to SI; the longer of two comes first.
_UNITS = {"_mm_per_hour": 1e-3 / 3600, "_mm": 1e-3}
_NOT_COLUMNS = "code", "color"


@dataclass(frozen=True)
class ClassTable:
    """Names, colours and numbers of the ground classes; the place in each is the class's code.

    Columns by name: storage [m], infiltration [m/s], manning [s/m^(1/3)], porosity, film_slope,
    albedo, albedo_spread (float32); soaks, mirrors.
    """

    names: tuple
    colors: np.ndarray  # (n, 3), uint8, of the class map
    columns: dict

    def column(self, name):
        """Return one number of every ground class by its key, see `columns`, ndarray of shape (n,).

        It is the table's own array, not a copy: index it with codes of ground classes.
        """
        return self.columns[name]


def column_of(key, values):
    """Return the name and the values [SI] of a column whose key in the TOML may end in a unit."""
    if isinstance(values[0], bool):
        return key, np.array(values)
    for ending, factor in _UNITS.items():
        if key.endswith(ending):
            return key.removesuffix(ending), np.array([v * factor for v in values], np.float32)
    return key, np.array(values, np.float32)


@functools.cache
def class_table():
    """Return the `ClassTable` that the package brings."""
    text = resources.files("rainsim.config").joinpath("classes.toml").read_text(encoding="utf-8")
    rows = tomllib.loads(text)
    names = tuple(sorted(rows, key=lambda name: rows[name]["code"]))
    entries = [rows[name] for name in names]
    if [entry["code"] for entry in entries] != list(range(len(entries))):
        raise AssertionError("the codes of classes.toml must count from 0")
    columns = {}
    for key in entries[0]:
        if key not in _NOT_COLUMNS:
            name, values = column_of(key, [entry[key] for entry in entries])
            columns[name] = values
    return ClassTable(names, np.array([e["color"] for e in entries], np.uint8), columns)
