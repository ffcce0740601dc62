"""Maps of numbers in files: ESRI ASCII grids, GeoTIFF, plain text and .npy, with cell size and
place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rainsim.errors import InputError
from rainsim.io import images
from rainsim.io.files import read_text, replacing, require_file

KINDS = (".asc", ".txt", ".npy", ".tif", ".tiff")
MOST_CELLS = 1 << 28
MOST_TEXT = 1 << 32  # bytes
HEADER = ("ncols", "nrows", "xllcorner", "yllcorner", "xllcenter", "yllcenter", "cellsize",
          "nodata_value")  # fmt: skip
# TIFF tags: cell size, place, keys of the coordinate system with their numbers and texts, no data.
SCALE, TIE, KEYS, NUMBERS, TEXTS, NO_DATA = 33550, 33922, 34735, 34736, 34737, 42113
MODEL, GEOGRAPHIC = 1024, 2  # the key of the kind of coordinates, and the value for degrees


class Raster(NamedTuple):
    """A map of numbers.

    Attributes
    ----------
    values : ndarray of shape (ny, nx), float64
        Row 0 is south, column 0 is west; NaN where the file has none.
    spacing : float or None [m]
        Side of a cell, if the file says it.
    corner : (float, float) or None [m]
        x and y of the south-west corner, if the file says them.
    kind : str
        Suffix of the file: .asc for all ESRI ASCII grids.
    tags : dict of int to tuple
        Of a GeoTIFF: those that say where it is.
    """

    values: np.ndarray
    spacing: float | None = None
    corner: tuple | None = None
    kind: str = ".npy"
    tags: dict | None = None


def read_raster(path):
    """Read a `Raster`. Lines of text and pictures begin in the north, rows of .npy in the south.

    Raises
    ------
    InputError
        If the file is no such map, its cells are no squares, or it is in degrees.
    """
    path = require_file(path, "a map")
    suffix = path.suffix.lower()
    if suffix not in KINDS:
        raise InputError(f"{path} is no map; it must be one of {', '.join(KINDS)}; convert it")
    if suffix == ".npy":
        found = Raster(_loaded(path))
    elif suffix in (".tif", ".tiff"):
        found = _from_tiff(path)
    else:
        found = _from_text(path)
    if found.values.ndim != 2 or not 0 < found.values.size <= MOST_CELLS:
        raise InputError(
            f"{path} has the shape {found.values.shape}; it must be a map of rows and columns, of "
            f"at most {MOST_CELLS} cells"
        )
    return found


def _loaded(path):
    try:
        values = np.load(path, allow_pickle=False)
        return np.asarray(values, np.float64)
    except (ValueError, TypeError, EOFError, OSError) as fault:
        raise InputError(f"{path} is no .npy file of numbers ({fault}); write it again") from None


def _from_text(path):
    lines = read_text(path, "a map", MOST_TEXT).split("\n")
    header, first = {}, 0
    while first < len(lines) and lines[first].split()[:1]:
        name, *value = lines[first].split()
        if name.lower() not in HEADER:
            break
        try:
            header[name.lower()] = float(value[0])
        except (ValueError, IndexError):
            raise InputError(
                f"line {first + 1} of {path} has no number: {lines[first]!r}"
            ) from None
        first += 1
    try:
        rows = [np.array(line.split(), np.float64) for line in lines[first:] if line.strip()]
        if "ncols" in header:  # a row of such a grid may go on in the next line
            rows = np.concatenate(rows).reshape(int(header["nrows"]), int(header["ncols"]))
        values = np.array(rows)
    except (ValueError, KeyError) as fault:
        raise InputError(
            f"{path} is no map ({fault}); it must have lines of as many numbers each, or an ESRI "
            "ASCII grid's header and numbers"
        ) from None
    if not header:
        return Raster(values[::-1], kind=".txt")
    if not header.get("cellsize", 0) > 0:
        raise InputError(f"{path} has no cellsize above 0; an ESRI ASCII grid must; write it again")
    if "nodata_value" in header:
        values[values == header["nodata_value"]] = np.nan
    spacing = header["cellsize"]
    corner = [
        header.get(f"{axis}llcorner", header.get(f"{axis}llcenter", spacing / 2) - spacing / 2)
        for axis in "xy"
    ]
    return Raster(values[::-1], spacing, tuple(corner), ".asc")


def _from_tiff(path):
    values = np.array(images.read_image(path, MOST_CELLS), np.float64)
    found = images.tags_of(path)
    tags = {n: found[n] for n in (SCALE, TIE, KEYS, NUMBERS, TEXTS, NO_DATA) if n in found}
    keys = np.ravel(tags.get(KEYS, ())).astype(int)
    keys = dict(zip(keys[4::4].tolist(), keys[7::4].tolist(), strict=False))
    if keys.get(MODEL) == GEOGRAPHIC:
        raise InputError(f"{path} is in degrees; cells must be in metres; project it first")
    try:
        empty = float(tags.pop(NO_DATA, "nan"))
    except ValueError:
        empty = np.nan
    values[(values == empty) | (np.abs(values) > 1e30)] = np.nan
    spacing = corner = None
    if SCALE in tags:
        spacing, across = map(float, tags[SCALE][:2])
        if not (spacing > 0 and abs(across - spacing) <= 1e-6 * spacing):
            raise InputError(f"{path} has cells of {spacing:g} x {across:g} m; resample to squares")
        if TIE in tags:
            column, row, _, x, y, _ = tags[TIE][:6]
            south = y - (values.shape[0] - row) * spacing
            corner = x - column * spacing, south
    return Raster(values[::-1], spacing, corner, ".tif", tags)


def write_raster(path, values, like):
    """Write a map of the place and the kind of a `Raster`, whole or not at all.

    Parameters
    ----------
    path : path-like
        Its suffix is `like.kind`.
    values : ndarray of shape (ny, nx)
        Row 0 is south.
    like : Raster
    """
    with replacing(path) as temporary:
        if like.kind == ".npy":
            np.save(temporary, values)
            return
        if like.kind == ".tif":
            images.write_tagged(temporary, values[::-1], like.tags or {})
            return
        header = ""
        if like.kind == ".asc":
            (ny, nx), (x, y) = values.shape, like.corner
            header = (
                f"ncols {nx}\nnrows {ny}\nxllcorner {x:.12g}\nyllcorner {y:.12g}\n"
                f"cellsize {like.spacing:.12g}\nNODATA_value -9999\n"
            )
        with open(temporary, "w", encoding="ascii") as file:
            file.write(header)
            np.savetxt(file, values[::-1], fmt="%.7g")
