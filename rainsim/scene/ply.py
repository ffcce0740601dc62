"""Splats from and to the PLY files of the original 3D Gaussian Splatting code.

A splat is one `vertex` with its centre (x, y, z), spherical harmonics (f_dc_0..2, f_rest_*),
opacity as a logit, scales as logarithms and a quaternion, w first, of any length. Properties may
stand in any order and any others are ignored.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from rainsim.errors import InputError
from rainsim.scene.files import MAX_LENGTH, replacing, require_file
from rainsim.scene.types import Splats

MAX_BROKEN_SHARE = 0.01  # above this the file is damaged, not merely untidy
HEADER_LIMIT = 1 << 18  # bytes; a real header has some 2,000
ROWS_PER_READ = 1 << 14  # 4 MB of the usual 62 properties: fits a core's share of cache
REMEDY = "export the capture as a standard 3D Gaussian Splatting PLY"

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}

POSITION = ("x", "y", "z")
BASE_COLOR = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALE = ("scale_0", "scale_1", "scale_2")
ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
REQUIRED = (*POSITION, *BASE_COLOR, "opacity", *SCALE, *ROTATION)
COEFFICIENTS = {0: 1, 9: 4, 24: 9, 45: 16}  # number of f_rest_* -> (degree + 1)^2


@dataclass(frozen=True, slots=True)
class _Table:
    """Where the splats' rows lie in the file and what one row holds."""

    offset: int
    count: int
    row: np.dtype
    coefficients: int


def read_splats(path):
    """Read a 3D Gaussian Splatting PLY file, found by its content and not by its name.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    splats : Splats
        Activated: linear scales, opacity in [0, 1], unit quaternions.
    notes : list of str
        What was dropped, one line each; usually empty.

    Raises
    ------
    InputError
        If it is no such file, is shorter than its header promises, or holds more than 1 % of
        splats with values that are not finite.
    """
    path = require_file(path, "a splat PLY")
    with open(path, "rb") as file:
        table = _read_header(path, file)
        file.seek(table.offset)
        splats, good = _read_rows(path, file, table)
    broken = table.count - np.count_nonzero(good)
    if not broken:
        return splats, []
    share = f"{broken} of {table.count} splats ({100 * broken / table.count:.3g} %)"
    if broken > MAX_BROKEN_SHARE * table.count:
        raise InputError(
            f"{path} has {share} with NaN, infinite or absurd values; at most "
            f"{100 * MAX_BROKEN_SHARE:g} % are tolerated; export the capture again"
        )
    return splats.take(good), [f"dropped {share} with NaN, infinite or absurd values"]


def write_splats(path, splats):
    """Write splats as a 3D Gaussian Splatting PLY file with the properties of the original code.

    Parameters
    ----------
    path : path-like
        Replaced whole or not at all.
    splats : Splats

    Notes
    -----
    The file stores logits and logarithms: opacities of exactly 0 or 1 and scales of 0 come back
    as the nearest value that has a finite one, all else to float32 rounding.
    """
    n, k = splats.sh.shape[:2]
    rest = [f"f_rest_{i}" for i in range(3 * (k - 1))]
    names = [*POSITION, "nx", "ny", "nz", *BASE_COLOR, *rest, "opacity", *SCALE, *ROTATION]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    with replacing(path) as temporary, open(temporary, "wb") as file:
        file.write("\n".join(header).encode("ascii"))
        for start in range(0, n, ROWS_PER_READ):
            rows = splats.take(slice(start, start + ROWS_PER_READ))
            file.write(_stored_rows(rows).tobytes())


def _stored_rows(splats):
    n = len(splats)
    opacity = np.clip(splats.opacity.astype(np.float64), 1e-12, 1 - 1e-12)
    scale = np.maximum(splats.scale, np.finfo(np.float32).tiny)
    columns = [
        splats.position,
        np.zeros((n, 3)),
        splats.sh[:, 0],
        splats.sh[:, 1:].transpose(0, 2, 1).reshape(n, -1),
        np.log(opacity / (1 - opacity))[:, None],
        np.log(scale),
        splats.rotation,
    ]
    return np.concatenate(columns, axis=1).astype("<f4")


# --- header ---------------------------------------------------------------------------------------


def _read_header(path, file):
    """Return the _Table that the header describes, checked against the file's size."""
    start = file.read(HEADER_LIMIT)
    if not start.startswith((b"ply\n", b"ply\r")):
        raise InputError(f"{path} is not a PLY file{_kind(start)}; {REMEDY}")
    end = start.find(b"\nend_header")
    stop = start.find(b"\n", end + 1)
    if end < 0 or stop < 0:
        raise InputError(f"{path} has no end_header line; a PLY must have one; {REMEDY}")
    offset = stop + 1
    for name, count, properties in _parse_header(path, start[:end].decode("ascii", "replace")):
        if name == "vertex":
            return _splat_table(path, os.fstat(file.fileno()).st_size, offset, count, properties)
        if any(kind == "list" for _, kind in properties):
            raise InputError(
                f"{path} has lists before its vertices; that is no splat PLY; {REMEDY}"
            )
        offset += count * sum(np.dtype(kind).itemsize for _, kind in properties)
    raise InputError(f"{path} has no vertex element; splats are stored as vertices; {REMEDY}")


def _kind(start):
    if start.startswith(b"PK\x03\x04"):
        return " (it looks like a zip archive, perhaps SOG)"
    if start.startswith(b"\x1f\x8b"):
        return " (it looks like gzip, perhaps SPZ)"
    return "" if start.strip() else " (it is empty)"


def _parse_header(path, text):
    """Return the elements in order, each as (name, count, [(property, numpy type)])."""
    order, elements = None, []
    for number, line in enumerate(text.splitlines()[1:], start=2):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", "ascii", *_]:
                raise InputError(
                    f"{path} is an ASCII PLY; splats must be stored as binary; {REMEDY}"
                )
            case ["format", kind, *_] if kind in ORDERS:
                order = ORDERS[kind]
            case ["element", name, count] if count.isdecimal() and len(count) < 19:
                elements.append((name, int(count), []))
            case ["property", "list", _, _, name] if elements:
                elements[-1][2].append((name, "list"))
            case ["property", kind, name] if elements and order and kind in TYPES:
                elements[-1][2].append((name, order + TYPES[kind]))
            case _:
                shown = line.strip()[:60]
                raise InputError(f"{path} line {number} is {shown!r}; no PLY has that; {REMEDY}")
    if order is None:
        raise InputError(f"{path} has no format line; a PLY must have one; {REMEDY}")
    return elements


def _splat_table(path, size, offset, count, properties):
    names = [name for name, _ in properties]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{path} has the property {twice} twice; names must differ; {REMEDY}")
    _require_splat_properties(path, names)
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest not in COEFFICIENTS or any(f"f_rest_{i}" not in names for i in range(rest)):
        raise InputError(
            f"{path} has {rest} f_rest properties; spherical harmonics of degree 0 to 3 have 0, "
            f"9, 24 or 45; {REMEDY}"
        )
    if any(kind == "list" for _, kind in properties):
        raise InputError(f"{path} has lists in its vertices; splats have none; {REMEDY}")
    row = np.dtype(properties)
    if count == 0:
        raise InputError(f"{path} holds 0 splats; it must hold at least one; {REMEDY}")
    if offset + count * row.itemsize > size:
        raise InputError(
            f"{path} promises {count} splats of {row.itemsize} bytes but has room for "
            f"{max(size - offset, 0) // row.itemsize}; it is truncated or damaged; copy or export "
            "it again"
        )
    return _Table(offset, count, row, COEFFICIENTS[rest])


def _require_splat_properties(path, names):
    if "packed_position" in names:
        raise InputError(f"{path} is a compressed PLY; its splats must be uncompressed; {REMEDY}")
    missing = [name for name in REQUIRED if name not in names]
    if not missing:
        return
    if "opacity" in missing and "rot_0" in missing:
        raise InputError(
            f"{path} is a mesh or point cloud (its vertices have {', '.join(names[:8])}); splats "
            f"have opacity, scales and rotations too; {REMEDY}"
        )
    if missing == ["scale_2"]:
        raise InputError(f"{path} holds 2D splats (no scale_2); splats must be 3D; {REMEDY}")
    raise InputError(f"{path} lacks the property {', '.join(missing)}; splats need it; {REMEDY}")


# --- rows -----------------------------------------------------------------------------------------


def _read_rows(path, file, table):
    """Return the activated Splats and a mask of those whose values are all usable."""
    n, k = table.count, table.coefficients
    splats = Splats(
        position=np.empty((n, 3), np.float32),
        rotation=np.empty((n, 4), np.float32),
        scale=np.empty((n, 3), np.float32),
        opacity=np.empty(n, np.float32),
        sh=np.empty((n, k, 3), np.float32),
    )
    good = np.empty(n, bool)
    for start in range(0, n, ROWS_PER_READ):
        rows = np.fromfile(file, table.row, min(ROWS_PER_READ, n - start))
        if len(rows) < min(ROWS_PER_READ, n - start):
            raise InputError(f"{path} became shorter while it was read; try again")
        part = slice(start, start + len(rows))
        with np.errstate(all="ignore"):  # what overflows is counted as broken
            good[part] = _activate(_columns(rows), k, splats, part)
    return splats, good


def _columns(rows):
    """Return a function from property names to their float32 values of shape (n, names)."""
    fields = rows.dtype.fields
    if all(kind == np.dtype("<f4") for kind, _ in fields.values()):
        table = rows.view("<f4").reshape(len(rows), -1)
        place = {name: offset // 4 for name, (_, offset) in fields.items()}

        def pick(names):
            first = place[names[0]]
            if [place[name] for name in names] == list(range(first, first + len(names))):
                return table[:, first : first + len(names)]  # no copy in the usual order
            return table[:, [place[name] for name in names]]

        return pick
    return lambda names: np.stack([rows[name].astype(np.float32) for name in names], axis=1)


def _activate(pick, k, splats, part):
    """Fill rows `part` of `splats` in place; return which of them are usable."""
    position, log_scale, turn = pick(POSITION), pick(SCALE), pick(ROTATION)
    logit, base = pick(("opacity",))[:, 0], pick(BASE_COLOR)
    length = np.linalg.norm(turn, axis=1)
    splats.position[part] = position
    np.exp(log_scale, out=splats.scale[part])
    splats.opacity[part] = 1 / (1 + np.exp(-logit))
    np.divide(turn, length[:, None], out=splats.rotation[part])
    splats.sh[part, 0] = base
    good = np.isfinite(logit) & (length > 0) & np.isfinite(length)
    good &= (np.abs(position) < MAX_LENGTH).all(axis=1)  # false for NaN
    good &= (splats.scale[part] < MAX_LENGTH).all(axis=1)
    good &= np.isfinite(log_scale).all(axis=1) & np.isfinite(base).all(axis=1)
    if k > 1:
        rest = pick([f"f_rest_{i}" for i in range(3 * (k - 1))])
        splats.sh[part, 1:] = rest.reshape(-1, 3, k - 1).transpose(0, 2, 1)
        good &= np.isfinite(rest).all(axis=1)
    return good
