"""Height maps without a capture: from triangle meshes (PLY, OBJ) and maps (TIFF, .asc)."""

from pathlib import Path

import numpy as np

from rainsim.errors import InputError, ParameterError, require_positive
from rainsim.io.files import require_file
from rainsim.jit import serial_kernel
from rainsim.scene.plyheader import HEADER_LIMIT, TYPES
from rainsim.terrain.bed import inpaint, local_noise
from rainsim.terrain.map_size import MOST_CELLS, choose_spacing
from rainsim.terrain.table import GRASS, HARD
from rainsim.terrain.types import MEASURED, UNKNOWN, Grid, Terrain

MAPS = (".tif", ".tiff", ".asc")
GREY = 0.5  # colour of what has none
LONGEST_COUNT = 19  # digits of a number of rows, as in `rainsim.scene.plyheader`
FARTHEST = 1e9  # units, from the origin, of a mesh; more is damage


def is_surface(path):
    """Whether `path` is a file with a triangle mesh or heights: OBJ, TIFF, .asc, PLY with faces."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in (".obj", *MAPS):
        return path.is_file()
    if suffix != ".ply" or not path.is_file():
        return False
    with open(path, "rb") as file:
        header = file.read(HEADER_LIMIT).partition(b"end_header")[0]
    return b"element face" in header and b"scale_0" not in header


def terrain_from_surface(path, config, up=None, meters_per_unit=None):
    """Return the `Terrain` of a mesh or a TIFF.

    Of the TerrainConfig spacing [m], of a TIFF its own cell size, and extent count (half width [m]
    or None for all). `up` is a mesh's, z if not given; there is 1 metre in a unit if not given.
    """
    path = Path(path)
    scale = 1.0 if meters_per_unit is None else require_positive("meters-per-unit", meters_per_unit)
    if path.suffix.lower() in MAPS:
        if up is not None or config.extent is not None:
            raise ParameterError(f"{path} is a map of heights; --up and --extent do not apply")
        return _from_map(path, config.spacing, scale)
    points, triangles = (_read_obj if path.suffix.lower() == ".obj" else _read_ply)(path)
    note = f"{len(triangles)} triangles, z up" if up is None else f"{len(triangles)} triangles"
    if meters_per_unit is None:
        note += "; its units are taken as metres"
    points = points @ _level(up).T * scale
    return terrain_from_mesh(points, triangles, config, (note,))


def _level(up):
    """Return the rotation that turns `up` to z; its x axis is x (y if `up` is near x), levelled."""
    if up is None:
        return np.eye(3)
    z = np.asarray(up, np.float64)
    z = z / np.linalg.norm(z)
    x = np.eye(3)[0] if abs(z[0]) < 0.7 else np.eye(3)[1]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def terrain_from_mesh(points, triangles, config, notes=()):
    """Return the `Terrain` of the uppermost surface of a triangle mesh.

    `points` are of shape (n, 3) [m], z up, `triangles` of shape (m, 3), int.
    """
    used = points[np.unique(triangles)]
    low, high = used[:, :2].min(axis=0), used[:, :2].max(axis=0)
    if config.extent is not None:
        middle = (low + high) / 2
        low = np.maximum(low, middle - config.extent)
        high = np.minimum(high, middle + config.extent)
    spacing, why = config.spacing, "given"
    if spacing is None:
        spacing, why = choose_spacing((high - low) / 2)
    notes += (f"cells of {spacing:g} m ({why})",)
    nx, ny = (max(3, int(np.ceil(side / spacing - 1e-9))) for side in high - low)
    if nx * ny > MOST_CELLS:
        raise ParameterError(
            f"a map of {nx} x {ny} cells is too large; at most {MOST_CELLS} fit the memory; give a "
            "larger --spacing or an --extent"
        )
    grid = Grid((ny, nx), (float(low[0]), float(low[1])), spacing)
    height = np.full(grid.shape, -np.inf, np.float32)
    corners = points[triangles].astype(np.float64)
    corners[..., :2] = (corners[..., :2] - low) / spacing - 0.5
    raise_to_triangles(np.ascontiguousarray(corners), height)
    return terrain_from_heights(np.where(np.isfinite(height), height, np.nan), grid, notes)


def _from_map(path, spacing, scale):
    from rainsim.io.rasters import read_raster

    found = read_raster(path)
    spacing = spacing or found.spacing
    if spacing is None:
        raise ParameterError(f"{path} does not say how large its cells are; give --spacing M")
    if min(found.values.shape) < 3:
        raise InputError(
            f"{path} has shape {found.values.shape}; a map of heights has at least 3 x 3 cells"
        )
    values = np.where(np.abs(found.values) < 1e5, found.values, np.nan) * scale
    size = np.array(values.shape[::-1]) * spacing
    grid = Grid(values.shape, (float(-size[0] / 2), float(-size[1] / 2)), spacing)
    note = f"{path.name}: {values.shape[1]} x {values.shape[0]} heights, cells of {spacing:g} m"
    return terrain_from_heights(values, grid, (*found.notes, note))


def terrain_from_heights(height, grid, notes=()):
    """Return the `Terrain` of heights (ny, nx) [m], row 0 in the south; NaN is not known.

    All known ground is paving; nothing hangs over it. Heights are taken as they are, unsmoothed.
    """
    known = np.isfinite(height)
    if not known.any():
        raise InputError("the surface has no height within the map; check its units and --extent")
    bed = inpaint(np.where(known, height, 0).astype(np.float32), known)
    source = np.where(known, MEASURED, UNKNOWN).astype(np.uint8)
    classes = np.where(known, HARD, GRASS).astype(np.uint8)
    noise = local_noise(bed, known, grid.spacing)
    color = np.full((*grid.shape, 3), GREY, np.float32)
    notes = (*notes, f"height known on {known.mean():.0%} of {grid.size[0]:g} x {grid.size[1]:g} m")
    return Terrain(grid, bed, bed.copy(), bed.copy(), source, classes, noise, color, notes)


@serial_kernel
def raise_to_triangles(corners, height_out):
    """Raise each cell's height [m] to the triangles over its centre.

    `corners`, (m, 3, 3), float64, are x, y in cells (a centre has whole numbers) and z [m].
    """
    ny, nx = height_out.shape
    for n in range(len(corners)):
        ax, ay, az = corners[n, 0]
        bx, by, bz = corners[n, 1]
        cx, cy, cz = corners[n, 2]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if not abs(area) > 1e-12:  # seen edge-on, or not a number
            continue
        first_i = max(0, int(np.ceil(min(ax, bx, cx) - 1e-9)))
        last_i = min(nx - 1, int(np.floor(max(ax, bx, cx) + 1e-9)))
        first_j = max(0, int(np.ceil(min(ay, by, cy) - 1e-9)))
        last_j = min(ny - 1, int(np.floor(max(ay, by, cy) + 1e-9)))
        for j in range(first_j, last_j + 1):
            for i in range(first_i, last_i + 1):
                u = ((i - ax) * (cy - ay) - (cx - ax) * (j - ay)) / area
                v = ((bx - ax) * (j - ay) - (i - ax) * (by - ay)) / area
                if u >= -1e-9 and v >= -1e-9 and u + v <= 1 + 1e-9:
                    z = az + u * (bz - az) + v * (cz - az)
                    if z > height_out[j, i]:
                        height_out[j, i] = z


def _read_obj(path):
    """Return points (n, 3) and triangles (m, 3) of a Wavefront OBJ file."""
    points, triangles = [], []
    with open(require_file(path, "a mesh"), encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(file, 1):
            parts = line.split()
            try:
                if parts and parts[0] == "v":
                    points.append([float(v) for v in parts[1:4]])
                elif parts and parts[0] == "f":
                    corner = [int(p.partition("/")[0]) for p in parts[1:]]
                    corner = [c - 1 if c > 0 else len(points) + c for c in corner]
                    triangles += [
                        (corner[0], corner[k], corner[k + 1]) for k in range(1, len(corner) - 1)
                    ]
            except (ValueError, IndexError):
                raise InputError(
                    f"{path}, line {number}: {line.strip()[:60]!r} is no vertex or face; mend it"
                ) from None
    return _checked(path, np.array(points, dtype=object), triangles)


def _read_ply(path):
    """Return points (n, 3) and triangles (m, 3) of a PLY mesh, text or binary."""
    data = require_file(path, "a mesh").read_bytes()
    header, _, body = data.partition(b"end_header")
    lines = header.decode("ascii", "replace").split("\n")
    body = body[body.find(b"\n") + 1 :]
    form, elements = "", []
    for words in map(str.split, lines):
        if words[:1] == ["format"] and len(words) > 1:
            form = words[1]
        elif words[:1] == ["element"] and len(words) == 3 and _is_count(words[2]):
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"] and elements:
            elements[-1][2].append(words[1:])
    try:
        order = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}[form]
        return _checked(path, *_mesh_of(body, elements, order))
    except (ArithmeticError, IndexError, KeyError, MemoryError, TypeError, ValueError):
        raise InputError(
            f"{path} is no mesh that can be read: a PLY with vertices x, y, z and lists of faces, "
            "whole; write it again"
        ) from None


def _is_count(word):
    """Whether a word is a number of rows; one of thousands of digits is none."""
    return word.isdecimal() and len(word) < LONGEST_COUNT


def _mesh_of(body, elements, order):
    """Return points and triangles of the elements in a PLY's body; `order` is None for text."""
    data, at = body.split() if order is None else body, 0
    points, triangles = None, []

    def rows(types, count):
        """Return the next `count` rows of numbers, float64 (count, columns)."""
        nonlocal at
        if order is None:
            size = count * len(types)
            table = np.array(data[at : at + size], float).reshape(count, -1)
        else:
            row = np.dtype([(str(k), order + TYPES[t]) for k, t in enumerate(types)])
            size, found = count * row.itemsize, np.frombuffer(data, row, count, at)
            table = np.stack([found[name] for name in row.names], axis=1).astype(float)
        at += size
        return table

    for name, count, properties in elements:
        if all(p[0] != "list" for p in properties):
            table = rows([p[0] for p in properties], count)
            if name == "vertex":
                points = table[:, [[p[1] for p in properties].index(axis) for axis in "xyz"]]
            continue
        if name != "face" or len(properties) != 1:
            raise ValueError(name)
        start, (size_type, index_type) = at, properties[0][1:3]
        # Nearly all meshes have triangles only: then the faces are one table.
        table = rows([size_type, *[index_type] * 3], count)
        if (table[:, 0] == 3).all():
            triangles = table[:, 1:]
            continue
        at = start
        for _ in range(count):
            size = int(rows([size_type], 1).item())
            corner = rows([index_type], max(size, 0))[:, 0]
            triangles += [(corner[0], corner[k], corner[k + 1]) for k in range(1, size - 1)]
    return points, triangles


def _checked(path, points, triangles):
    """Return points (n, 3) float64 and triangles (m, 3) int64 after checking that they fit."""
    try:
        points = np.asarray(points).astype(np.float64)
        triangles = np.asarray(triangles, np.int64).reshape(-1, 3)
    except (OverflowError, TypeError, ValueError):
        points = np.zeros(0)
    if points.ndim != 2 or points.shape[1:] != (3,) or not len(triangles):
        raise InputError(f"{path} has no triangles; a height map needs a surface; write it again")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InputError(
            f"{path}: a face names vertex {int(triangles.max())}, but there are {len(points)}; "
            "write it again"
        )
    used = points[np.unique(triangles)]
    if not (np.abs(used) < FARTHEST).all():  # false for NaN
        raise InputError(
            f"{path} has vertices that are not finite or beyond {FARTHEST:g} units; remove them"
        )
    return points, triangles
