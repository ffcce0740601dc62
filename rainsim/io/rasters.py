"""Maps of numbers in files: ESRI ASCII grids, GeoTIFF, plain text and .npy, with cell size and
place.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.errors import InputError, one_line
from rainsim.io import images
from rainsim.io.arrays import npy_header
from rainsim.io.files import MAX_LENGTH, read_text, replacing, require_file

KINDS = (".asc", ".txt", ".npy", ".tif", ".tiff")
MOST_CELLS = 1 << 28
MOST_TEXT = 1 << 32  # bytes
HEADER = ("ncols", "nrows", "xllcorner", "yllcorner", "xllcenter", "yllcenter", "cellsize",
          "dx", "dy", "nodata_value")  # fmt: skip
NODATA = -9999.0  # of an ESRI ASCII grid that does not say another value
# TIFF tags: cell size, place, keys of the coordinate system with their numbers and texts, no data.
SCALE, TIE, KEYS, NUMBERS, TEXTS, NO_DATA = 33550, 33922, 34735, 34736, 34737, 42113
MODEL, GEOGRAPHIC = 1024, 2  # the key of the kind of coordinates, and the value for degrees
ACROSS, UPWARDS = 3076, 4099  # the keys of the linear unit of a projection and of heights
UNITS = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}  # m: metre, foot, US survey foot
UNIT_NAMES = {9001: "metres", 9002: "feet", 9003: "US survey feet"}


class Raster(NamedTuple):
    """A map of numbers.

    values : float64 array (ny, nx). Row 0 is south, column 0 is west; NaN where
        the file has none.
    spacing : float or None [m]. Side of a cell, if the file says it.
    corner : (float, float) or None [m]. x and y of the south-west corner, if the
        file says them.
    kind : str. Suffix of the file: .asc for all ESRI ASCII grids.
    tags : dict of int to tuple. Of a GeoTIFF: those that say where it is.
    notes : tuple of str. What was converted.
    per_height : float [m]. A unit of the heights as the file says it.
    """

    values: np.ndarray
    spacing: float | None = None
    corner: tuple | None = None
    kind: str = ".npy"
    tags: dict | None = None
    notes: tuple = ()
    per_height: float = 1.0


def read_raster(path):
    """Read a `Raster`. Lines of text and pictures begin in the north, rows of .npy in the south.

    Lengths and heights of a GeoTIFF in feet become metres; heights have the unit of the map where
    it does not say their own.

    Raises InputError if the file is no such map, its cells are no squares, or it
        is in degrees.
    """
    path = require_file(path, "a map, such as bed.tif of `rainsim heightmap`,")
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
    endless = np.argwhere(np.isinf(found.values))
    if len(endless):
        row, column = endless[0]
        raise InputError(
            f"{path} is {found.values[row, column]} at row {row} from the south, column {column} "
            f"({len(endless)} such cells); numbers must be finite; mark cells without one as nodata"
        )
    return found


def _loaded(path):
    try:
        with open(path, "rb") as file:
            shape, dtype = npy_header(file)
            size = path.stat().st_size - file.tell()
        if dtype.kind not in "biuf" or math.prod(shape) * dtype.itemsize > size:
            raise ValueError(f"{dtype} of shape {shape} in {size} bytes")
        return np.asarray(np.load(path, allow_pickle=False), np.float64)
    except Exception as fault:
        raise InputError(
            f"{path} is no .npy file of real numbers ({one_line(str(fault))}); write it again"
        ) from None


def _from_text(path):
    lines = read_text(path, "a map", MOST_TEXT).split("\n")
    header, first = {}, 0
    while first < len(lines) and lines[first].split()[:1]:
        name, *value = lines[first].split()
        if name.lower() not in HEADER:
            break
        header[name.lower()] = _header_number(path, first, lines[first], value)
        first += 1
    try:
        rows = [np.array(line.split(), np.float64) for line in lines[first:] if line.strip()]
        if "ncols" in header:  # a row of such a grid may go on in the next line
            rows = np.concatenate(rows).reshape(int(header["nrows"]), int(header["ncols"]))
        values = np.array(rows)
    except (ValueError, KeyError, OverflowError) as fault:
        comma = "; numbers have a point, not a comma" if "," in str(fault) else ""
        raise InputError(
            f"{path} is no map ({one_line(str(fault))}); it must have lines of as many numbers "
            f"each, or an ESRI ASCII grid's header and numbers{comma}"
        ) from None
    if not header:
        return Raster(values[::-1], kind=".txt")
    if "dx" in header and header["dx"] != header.get("dy"):
        raise InputError(
            f"{path} has cells of dx {header['dx']:g} by dy {header.get('dy', math.nan):g} m; they "
            "must be squares; resample it"
        )
    spacing = header.get("cellsize", header.get("dx", 0.0))
    if not spacing > 0:
        raise InputError(f"{path} has no cellsize above 0; an ESRI ASCII grid must; write it again")
    values[values == header.get("nodata_value", NODATA)] = np.nan
    corner = [
        header.get(f"{axis}llcorner", header.get(f"{axis}llcenter", spacing / 2) - spacing / 2)
        for axis in "xy"
    ]
    return Raster(values[::-1], spacing, tuple(corner), ".asc")


def _header_number(path, number, line, value):
    """Return the number of a line of a header of an ESRI ASCII grid."""
    try:
        found = float(value[0])
    except (ValueError, IndexError):
        remedy = "write it with a point" if "," in line else "correct it"
        raise InputError(
            f"line {number + 1} of {path} has no number: {line!r}; it must; {remedy}"
        ) from None
    if not abs(found) < MAX_LENGTH and line.split()[0].lower() != "nodata_value":  # true for NaN
        raise InputError(
            f"line {number + 1} of {path} is {line!r}; the number must be below {MAX_LENGTH:g}; "
            "correct it"
        )
    return found


def _from_tiff(path):
    values = np.array(images.read_image(path, MOST_CELLS), np.float64)
    found = images.tags_of(path)
    tags = {n: found[n] for n in (SCALE, TIE, KEYS, NUMBERS, TEXTS, NO_DATA) if n in found}
    try:
        keys = np.ravel(tags.get(KEYS, ())).astype(int)
        keys = dict(zip(keys[4::4].tolist(), keys[7::4].tolist(), strict=False))
        spacing, across = map(float, tags[SCALE][:2]) if SCALE in tags else (1.0, 1.0)
        tie = [float(number) for number in tags[TIE][:6]] if TIE in tags else None
        if (tie is not None and len(tie) < 6) or not np.isfinite(
            [spacing, across, *(tie or ())]
        ).all():
            raise ValueError
    except (ValueError, TypeError, OverflowError):
        raise InputError(
            f"{path} has GeoTIFF tags that are no numbers; it is damaged, write it again"
        ) from None
    if keys.get(MODEL) == GEOGRAPHIC:
        raise InputError(f"{path} is in degrees; cells must be in metres; project it first")
    try:
        empty = float(tags.pop(NO_DATA, "nan"))
    except (ValueError, TypeError):
        empty = np.nan
    values[(values == empty) | (np.abs(values) > 1e30)] = np.nan
    unit, high, notes = _units(path, keys)
    values *= high
    if notes:  # maps that are written in this place hold metres
        tags[KEYS] = _with_heights_in_metres(np.ravel(tags[KEYS]).astype(int).tolist())
    corner = None
    if SCALE not in tags:
        return Raster(values[::-1], None, None, ".tif", tags, notes, high)
    if not (spacing > 0 and abs(across - spacing) <= 1e-6 * spacing):
        raise InputError(f"{path} has cells of {spacing:g} x {across:g} m; resample to squares")
    if tie is not None:
        column, row, _, x, y, _ = tie
        south = y - (values.shape[0] - row) * spacing
        corner = (x - column * spacing) * unit, south * unit
    return Raster(values[::-1], spacing * unit, corner, ".tif", tags, notes, high)


def _with_heights_in_metres(keys):
    """Return the keys of a GeoTIFF, a list of int, with metres for the unit of heights."""
    head, entries = keys[:4], [keys[n : n + 4] for n in range(4, len(keys), 4)]
    entries = [entry for entry in entries if entry[0] != UPWARDS] + [[UPWARDS, 0, 1, 9001]]
    return (*head[:3], len(entries), *(number for entry in sorted(entries) for number in entry))


def _units(path, keys):
    """Return how many metres a unit of a GeoTIFF has, along it and upwards, and notes on both."""
    code = keys.get(ACROSS, 9001)
    upwards = keys.get(UPWARDS, code)
    for number in (code, upwards):
        if number not in UNITS:
            raise InputError(
                f"{path} has the linear unit {number}; metres (9001), feet (9002) and US survey "
                "feet (9003) are read; project it to metres"
            )
    unit, high = UNITS[code], UNITS[upwards]
    if unit == high == 1.0:
        return unit, high, ()
    said = "" if UPWARDS in keys else ", heights too for all that the file says; see --height-unit"
    return unit, high, (
        f"{path.name} is in {UNIT_NAMES[code]} (heights in {UNIT_NAMES[upwards]}){said}; made "
        "metres",
    )  # fmt: skip


def write_raster(path, values, like):
    """Write a map of the place and the kind of a `Raster`, whole or not at all; row 0 is south."""
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
                f"cellsize {like.spacing:.12g}\nNODATA_value {NODATA:g}\n"
            )
        with open(temporary, "w", encoding="ascii") as file:
            file.write(header)
            values = np.where(np.isnan(values), NODATA, values) if header else values
            np.savetxt(file, values[::-1], fmt="%.7g")
