"""Splats from PlayCanvas compressed PLY files: chunks of 256 splats in 16 bytes each.

Chunks hold the range of positions, log scales and (newer files) colours; a splat stores shares of
them in 11, 10 or 8 bits; an optional element holds spherical harmonics as bytes.
"""

import numpy as np
from numpy.lib.recfunctions import structured_to_unstructured

from rainsim.errors import InputError
from rainsim.scene.activate import REST_COEFFICIENTS
from rainsim.scene.formats.extra import activated, decoding, load_extra

CHUNK = 256  # splats
KIND = "a compressed PLY"
REMEDY = "export it again, or as an uncompressed PLY"
RANGES = tuple(
    f"{end}_{kind}{axis}" for kind in ("", "scale_") for end in ("min", "max") for axis in "xyz"
)
COLORS = tuple(f"{end}_{channel}" for end in ("min", "max") for channel in "rgb")
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")


def read_compressed(path, header):
    """Return the Splats of a compressed PLY, which are usable, and no notes."""
    tables = _read_tables(path, header)
    chunks, packed = _chunk_table(path, tables), _columns(path, tables, "vertex", PACKED, "<u4")
    harmonics = _harmonics_table(path, tables, len(packed))
    if len(chunks) != -(-len(packed) // CHUNK):
        raise InputError(
            f"{path} has {len(chunks)} chunks for {len(packed)} splats; each chunk must hold "
            f"{CHUNK}; {REMEDY}"
        )
    gsply = load_extra(path, KIND)
    with decoding(path, KIND):
        data = gsply.decompress_from_bytes(_whole_file(chunks, packed, harmonics))
        return *activated(data), []


def _read_tables(path, header):
    """Return the rows of the elements chunk, vertex and sh as structured arrays, by name."""
    tables = {}
    with open(path, "rb") as file:
        for element in header.elements:
            if element.name in ("chunk", "vertex", "sh"):
                element.require_room(path)
                file.seek(element.offset)
                rows = np.fromfile(file, element.row, element.count)
                if len(rows) < element.count:
                    raise InputError(f"{path} became shorter while it was read; try again")
                tables[element.name] = rows
    return tables


def _columns(path, tables, name, properties, kind):
    """Return columns of an element as one table of type `kind`, the last axis the properties."""
    rows = tables.get(name)
    names = () if rows is None else rows.dtype.names or ()
    missing = [p for p in properties if p not in names]
    if rows is None or missing:
        lack = f"element {name}" if rows is None else f"property {', '.join(missing[:4])}"
        raise InputError(f"{path} is {KIND} without the {lack}; it must have it; {REMEDY}")
    wrong = [p for p in properties if rows.dtype[p].newbyteorder("=") != kind]
    if wrong:
        raise InputError(
            f"{path}: {wrong[0]} is of type {rows.dtype[wrong[0]].name}; in {KIND} it must be "
            f"{np.dtype(kind).name}; {REMEDY}"
        )
    return structured_to_unstructured(rows[list(properties)])


def _chunk_table(path, tables):
    ranges = _columns(path, tables, "chunk", RANGES, "<f4")
    if not set(COLORS) & set(tables["chunk"].dtype.names):  # before colours had ranges
        colors = np.tile(np.repeat(np.float32([0, 1]), 3), (len(ranges), 1))
    else:
        colors = _columns(path, tables, "chunk", COLORS, "<f4")
    table = np.concatenate([ranges, colors], axis=1)
    if not np.isfinite(table).all():
        raise InputError(f"{path} has chunks whose ranges are not finite; {REMEDY}")
    return table


def _harmonics_table(path, tables, count):
    if "sh" not in tables:
        return None
    names = tables["sh"].dtype.names or ()
    if len(names) not in REST_COEFFICIENTS or not names:
        raise InputError(
            f"{path} has {len(names)} coefficients of spherical harmonics; degrees 1 to 3 have 9, "
            f"24 or 45; {REMEDY}"
        )
    table = _columns(path, tables, "sh", [f"f_rest_{i}" for i in range(len(names))], "u1")
    if len(table) != count:
        raise InputError(
            f"{path} has spherical harmonics for {len(table)} of {count} splats; all must have "
            f"them; {REMEDY}"
        )
    return table


def _whole_file(chunks, packed, harmonics):
    """Return the checked tables as bytes of a PLY file in the layout that the decoder reads."""
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {len(chunks)}"]
    lines += [f"property float {name}" for name in (*RANGES, *COLORS)]
    lines += [f"element vertex {len(packed)}", *(f"property uint {name}" for name in PACKED)]
    tables = [chunks, packed]
    if harmonics is not None:
        lines += [f"element sh {len(packed)}"]
        lines += [f"property uchar f_rest_{i}" for i in range(harmonics.shape[1])]
        tables.append(harmonics)
    head = "\n".join([*lines, "end_header", ""]).encode("ascii")
    return b"".join([head, *(table.tobytes() for table in tables)])
