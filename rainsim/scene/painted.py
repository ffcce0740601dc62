"""Classes that a user painted on the ground of a scene, kept in its folder as `classes.npz`.

They lie in the ground frame with a place and a cell of their own, so that a map of any cell size
and extent takes them; names stand for the classes, because codes may change between versions.
"""

import hashlib
from dataclasses import dataclass

import numpy as np

from rainsim.errors import InputError
from rainsim.io.arrays import TEXT, Field, read_arrays, write_arrays

PAINTED_FILE = "classes.npz"
VERSION = 1
REMEDY = "save the scene again on the page of rainsim view"
ARRAYS = {
    "name": Field(TEXT, ("classes",)),
    "cells": Field("int16", ("ny", "nx"), -1),
    "origin": Field("float64", (2,)),
    "spacing": Field("float64", (), 1e-6, 1e3),
}


@dataclass(frozen=True)
class PaintedClasses:
    """Classes of the ground as a user has them.

    cells : int16 array (ny, nx). Index of each cell's class in `name`, -1 where
        it is left to the program; row 0 in the south.
    origin : tuple of float [m]. x, y of the outer corner of cell (0, 0) in the
        ground frame.
    """

    name: tuple
    cells: np.ndarray
    origin: tuple
    spacing: float

    @property
    def sha256(self):
        """SHA-256 of the names, the cells and their place."""
        digest = hashlib.sha256(repr((self.name, self.origin, self.spacing)).encode())
        digest.update(np.ascontiguousarray(self.cells, np.int16).tobytes())
        return digest.hexdigest()


def write_painted(path, painted):
    """Write painted classes."""
    write_arrays(path, VERSION, {
        "name": np.array(painted.name), "cells": np.asarray(painted.cells, np.int16),
        "origin": np.array(painted.origin, np.float64), "spacing": np.float64(painted.spacing),
    })  # fmt: skip


def read_painted(path):
    """Read the file that `write_painted` wrote; raise InputError if it is damaged."""
    found = read_arrays(path, "file of painted classes", ARRAYS, VERSION, REMEDY)
    names, cells = tuple(map(str, found["name"])), found["cells"]
    if cells.size and cells.max() >= len(names):
        raise InputError(
            f"{path}: a cell has class {cells.max()}; it must be below {len(names)}, the number of "
            f"names; {REMEDY}"
        )
    origin = tuple(map(float, found["origin"]))
    return PaintedClasses(names, cells, origin, float(found["spacing"]))
