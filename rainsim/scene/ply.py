"""Splats from and to the PLY files of the original 3D Gaussian Splatting code and its relatives.

A splat is one `vertex` with its centre (x, y, z), spherical harmonics (f_dc_0..2, f_rest_*),
opacity as a logit, scales as logarithms and a quaternion, w first, of any length. Properties may
stand in any order; unknown ones are ignored. These variants are recognised by their properties:

- 2DGS: two scales. The splat is a disc whose normal is the third axis, which is made thin.
- Mip-Splatting, Gaussian Opacity Fields: filter_3D widens the splats and thins their opacity.
- GaussianShader: roughness and specular0..2. Its base colour is kept; roughness and specular
  colour are dropped.

PGSR writes the original properties.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.recfunctions import structured_to_unstructured

from rainsim.constants import SH_0
from rainsim.errors import InputError
from rainsim.scene.activate import (
    MAX_BROKEN_SHARE,
    REST_COEFFICIENTS,
    ROWS_PER_STEP,
    activate_rows,
    empty_splats,
    require_few_broken,
)
from rainsim.scene.origin import NOWHERE, SAMPLE, origin_note, whole_origin
from rainsim.scene.plyheader import REMEDY, Element, header_of

POSITION = ("x", "y", "z")
BASE_COLOR = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALE = ("scale_0", "scale_1", "scale_2")
ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
BLOCK = 1 << 18  # splats of a part that is read at once
REQUIRED = (*POSITION, *BASE_COLOR, "opacity", *SCALE, *ROTATION)
FILTER = "filter_3D"
SHADER = ("roughness", "specular0")
DISC_THICKNESS = 1e-3  # of a 2D splat's smaller axis: looks flat, and is safe in float32
READERS = 2  # threads; reading is then bound by memory


@dataclass(frozen=True, slots=True)
class _Layout:
    """The layout of one row of splats."""

    coefficients: int
    disc: bool
    filtered: bool
    shader: bool


def read_plain(path, header):
    """Return the Splats of an uncompressed PLY, which are usable, and notes."""
    vertex = _require_splats(path, header)
    layout, origin = _layout(path, vertex), _origin(path, vertex)
    splats, good = _read_rows(path, vertex, layout, origin)
    return splats, good, [*_variant_notes(layout), *origin_note(origin)]


def origin_of(path):
    """Return what is taken off the places of a splat file when it is read, see `scene.origin`."""
    header = header_of(path)
    if header is None or header.compressed:
        return NOWHERE
    return _origin(path, _require_splats(path, header))


def _origin(path, vertex):
    if any(vertex.row[name].itemsize < 8 for name in POSITION):
        return NOWHERE
    rows = np.fromfile(path, vertex.row, min(vertex.count, SAMPLE), offset=vertex.offset)
    return whole_origin(np.stack([rows[name] for name in POSITION], axis=1))


def plain_blocks(path, header, rows=BLOCK):
    """Yield the Splats of an uncompressed PLY in parts of `rows`; InputError as for a whole."""
    vertex = _require_splats(path, header)
    layout, broken, origin = _layout(path, vertex), 0, _origin(path, vertex)
    for start in range(0, vertex.count, rows):
        offset = vertex.offset + start * vertex.row.itemsize
        part = replace(vertex, count=min(rows, vertex.count - start), offset=offset)
        splats, good = _read_rows(path, part, layout, origin)
        broken += len(good) - int(np.count_nonzero(good))
        yield splats if good.all() else splats.take(good)
    require_few_broken(path, broken, vertex.count, MAX_BROKEN_SHARE)


# --- what the rows hold ---------------------------------------------------------------------------


def _require_splats(path, header):
    """Return the vertex element, its place and size checked against the file."""
    vertex = header.find("vertex")
    if vertex is None and header.find("vertex_background") is not None:
        raise InputError(
            f"{path} is a model of Street Gaussians, in parts; splats are stored as vertices; "
            "examples/drives/convert.py makes a scene of it"
        )
    if vertex is None:
        raise InputError(f"{path} has no vertex element; splats are stored as vertices; {REMEDY}")
    _require_properties(path, vertex.names)
    if vertex.offset is None:
        raise InputError(f"{path} has lists before its vertices; that is no splat PLY; {REMEDY}")
    if vertex.row is None:
        raise InputError(f"{path} has lists in its vertices; splats have none; {REMEDY}")
    vertex.require_room(path)
    return vertex


def _require_properties(path, names):
    missing = [name for name in REQUIRED if name not in names and name != SCALE[2]]
    if not missing:
        return
    if "opacity" in missing and "rot_0" in missing:
        raise InputError(
            f"{path} is a mesh or point cloud (its vertices have {', '.join(names[:8])}); splats "
            f"have opacity, scales and rotations too; {REMEDY}"
        )
    raise InputError(f"{path} lacks the property {', '.join(missing)}; splats need it; {REMEDY}")


def _layout(path, vertex: Element):
    names = vertex.names
    shader = all(name in names for name in SHADER)
    rest = 0 if shader else sum(name.startswith("f_rest_") for name in names)
    if rest not in REST_COEFFICIENTS or any(f"f_rest_{i}" not in names for i in range(rest)):
        raise InputError(
            f"{path} has {rest} f_rest properties; spherical harmonics of degree 0 to 3 have 0, "
            f"9, 24 or 45; {REMEDY}"
        )
    return _Layout(REST_COEFFICIENTS[rest], SCALE[2] not in names, FILTER in names, shader)


def _variant_notes(layout):
    notes = []
    if layout.disc:
        notes.append(
            f"2D splats (2DGS): the third axis is made {DISC_THICKNESS:g} of the smaller of the two"
        )
    if layout.filtered:
        notes.append("filter_3D (Mip-Splatting, GOF) is applied to scales and opacities")
    if layout.shader:
        notes.append(
            "GaussianShader: the base colour is used; its specular colour, roughness, normals and "
            "environment light are dropped, so shiny things look dull"
        )
    return notes


# --- rows -----------------------------------------------------------------------------------------


def _read_rows(path, vertex, layout, origin):
    """Return the activated Splats and a mask of those whose values are all usable."""
    splats = empty_splats(vertex.count, layout.coefficients)
    good = np.empty(vertex.count, bool)

    def read_part(start):
        count = min(ROWS_PER_STEP, vertex.count - start)
        offset = vertex.offset + start * vertex.row.itemsize
        with open(path, "rb", buffering=0) as file:
            rows = np.fromfile(file, vertex.row, count, offset=offset)
        if len(rows) < count:
            raise InputError(f"{path} became shorter while it was read; try again")
        part = slice(start, start + count)
        good[part] = _activate(rows, layout, origin, splats, part)

    with ThreadPoolExecutor(READERS) as pool:  # numpy works outside Python's lock
        list(pool.map(read_part, range(0, vertex.count, ROWS_PER_STEP)))
    return splats, good


def _columns(rows, names, origin=0.0):
    """Return columns as float32 of shape (n, names), less the float64 `origin` if there is one."""
    table = structured_to_unstructured(rows[list(names)])  # no copy in the usual order
    with np.errstate(all="ignore"):  # what float32 cannot hold is counted as broken
        return (table - origin if np.any(origin) else table).astype(np.float32, copy=False)


def _activate(rows, layout, origin, splats, part):
    """Fill rows `part` of `splats` in place; return which of them are usable."""
    base, rest = _columns(rows, BASE_COLOR), None
    if layout.shader:
        base = _shader_base(base)
    if layout.coefficients > 1:
        bands = layout.coefficients - 1
        rest = _columns(rows, [f"f_rest_{i}" for i in range(3 * bands)])
        rest = rest.reshape(-1, 3, bands).transpose(0, 2, 1)
    log_scale = _columns(rows, SCALE[:2] if layout.disc else SCALE)
    if layout.disc:
        thin = log_scale.min(axis=1, keepdims=True) + np.float32(np.log(DISC_THICKNESS))
        log_scale = np.concatenate([log_scale, thin], axis=1)
    return activate_rows(
        splats,
        part,
        position=_columns(rows, POSITION, origin),
        log_scale=log_scale,
        turn=_columns(rows, ROTATION),
        logit=_columns(rows, ["opacity"])[:, 0],
        base=base,
        rest=rest,
        widen=_columns(rows, [FILTER])[:, 0] if layout.filtered else None,
    )


def _shader_base(raw):
    """Return GaussianShader's diffuse colour as first coefficients of spherical harmonics.

    Its renderer shows sigmoid(raw - ln 3) plus the reflection of a light that the PLY lacks.
    """
    with np.errstate(all="ignore"):
        color = 1 / (1 + 3 * np.exp(-raw))
    color[np.isnan(raw) | np.isinf(raw)] = np.nan  # a broken value must not pass for black or white
    return ((color - 0.5) / SH_0).astype(np.float32)
