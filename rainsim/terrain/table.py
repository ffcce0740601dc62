"""The table of ground classes, rainsim/config/classes.toml."""

from __future__ import annotations

import functools
import tomllib
from dataclasses import dataclass
from importlib import resources

import numpy as np

HARD, GRASS, SOIL, OBJECT, WATER, DRAIN = range(6)  # the codes in the table; HARD is its paving

# Columns: the TOML's key, and the factor to SI.
_COLUMNS = {
    "storage": ("storage_mm", 1e-3),
    "infiltration": ("infiltration_mm_per_hour", 1e-3 / 3600),
    "manning": ("manning", 1.0),
    "porosity": ("porosity", 1.0),
    "film_slope": ("film_slope", 1.0),
    "albedo": ("albedo", 1.0),
    "albedo_spread": ("albedo_spread", 1.0),
}


@dataclass(frozen=True)
class ClassTable:
    """Names, colours and numbers of the ground classes; the place in each is the class's code.

    Attributes
    ----------
    names : tuple of str
    colors : ndarray of shape (n, 3), uint8
        Of the class map.
    columns : dict of str to ndarray of shape (n,)
        storage [m], infiltration [m/s], manning [s/m^(1/3)], porosity, film_slope, albedo,
        albedo_spread (float32); soaks, mirrors.
    """

    names: tuple
    colors: np.ndarray
    columns: dict

    def column(self, name):
        """Return one number of every ground class, ndarray of shape (n,).

        Parameters
        ----------
        name : str
            A key of `columns`, which lists the units.

        Returns
        -------
        ndarray of shape (n,)
            The table's own array, not a copy: index it with codes of ground classes.
        """
        return self.columns[name]


@functools.cache
def class_table():
    """Return the `ClassTable` that the package brings."""
    text = resources.files("rainsim.config").joinpath("classes.toml").read_text(encoding="utf-8")
    rows = tomllib.loads(text)
    names = tuple(sorted(rows, key=lambda name: rows[name]["code"]))
    entries = [rows[name] for name in names]
    if [entry["code"] for entry in entries] != list(range(len(entries))):
        raise AssertionError("the codes of classes.toml must count from 0")
    columns = {
        name: np.array([entry[key] * factor for entry in entries], np.float32)
        for name, (key, factor) in _COLUMNS.items()
    }
    for name in ("soaks", "mirrors"):
        columns[name] = np.array([entry[name] for entry in entries])
    return ClassTable(names, np.array([e["color"] for e in entries], np.uint8), columns)
