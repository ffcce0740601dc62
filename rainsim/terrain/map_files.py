"""Height maps on disk."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from rainsim.errors import InputError
from rainsim.io.arrays import TEXT, Field, read_arrays, write_arrays
from rainsim.io.rasters import SCALE, TIE, Raster, write_raster
from rainsim.terrain.map_size import MOST_CELLS
from rainsim.terrain.table import DRAIN
from rainsim.terrain.types import MEASURED, TOPS, Terrain

VERSION = 1
WHAT, REMEDY = "height map", "`rainsim heightmap` writes it; write it again"
LEAST_CELLS = 3  # in a row
HEIGHT = 1e5  # m, of the highest and deepest ground; maps of heights have the same limit
NEAR = 1e-3  # m by which rounded heights may lie in the wrong order

_MAP = ("ny", "nx")
_LENGTH = {"low": -1e7, "high": 1e7}  # m
_ARRAYS = {
    "bed": Field("float32", _MAP, -HEIGHT, HEIGHT),
    "top": Field("float32", _MAP, -HEIGHT, HEIGHT),
    "underside": Field("float32", _MAP, -HEIGHT, HEIGHT),
    "source": Field("uint8", _MAP, 0, MEASURED),
    "ground_class": Field("uint8", _MAP, 0, DRAIN),
    "noise": Field("float32", _MAP, 0, HEIGHT),
    "color": Field("float32", (*_MAP, 3), -100, 100),
    "standing": Field("float32", _MAP, 0, HEIGHT, needed=False),
    "poured": Field("float32", _MAP, 0, HEIGHT, needed=False),
    "water": Field("float32", _MAP, 0, HEIGHT, needed=False),
    "layer": Field("float32", ("layer rows", "layer columns"), -HEIGHT, HEIGHT, needed=False),
    "origin": Field("float64", (2,), **_LENGTH),
    "spacing": Field("float64", (), 1e-5, 1e3),
    "notes": Field(TEXT, ("notes",)),
}
_TOP_ARRAYS = {
    "index": Field("int16", ("top rows", "top columns"), -1),
    "surface": Field("float64", ("tops", "terms"), -HEIGHT, HEIGHT),
    "centre": Field("float64", ("tops", 2), **_LENGTH),
    "area": Field("float64", ("tops",), 0, 1e9),
    "patch": Field("int64", ("tops", 3), 0),
    "corner": Field("float64", ("tops", 2), **_LENGTH),
    "spacing": Field("float64", (), 1e-5, 1e3),
    "relief": Field("float32", ("rows", "columns"), -HEIGHT, HEIGHT),
    "holds": Field("bool", ("rows", "columns")),
}


def write_terrain(folder, terrain):
    """Write terrain.npz, bed.tif, top.tif (float32 metres) and pictures into `folder`.

    The pictures are hillshade.png (bed and top) and classes.png (in the class table's colours).

    Pictures and TIFFs have north (greatest y) at the top; arrays in the .npz have row 0 in the
    south. Returns the paths written.

    Examples
    --------
    >>> paths = rainsim.write_terrain("map", terrain)
    >>> paths[0].name
    'terrain.npz'
    """
    from rainsim.io import images
    from rainsim.terrain.pictures import class_map, hillshade

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    grid = terrain.grid
    write_arrays(folder / "terrain.npz", VERSION, terrain.arrays())
    corner = grid.origin[0], grid.origin[1] + grid.shape[0] * grid.spacing, 0.0
    tags = {SCALE: (grid.spacing, grid.spacing, 0.0), TIE: (0.0, 0.0, 0.0, *map(float, corner))}
    like = Raster(None, kind=".tif", tags=tags)
    write_raster(folder / "bed.tif", terrain.bed, like)
    write_raster(folder / "top.tif", terrain.top, like)
    shade = np.hstack([hillshade(terrain.bed, grid.spacing, exaggerate=8),
                       hillshade(terrain.top, grid.spacing, exaggerate=1)])  # fmt: skip
    picture = (shade[::-1] * 255 + 0.5).astype(np.uint8)
    images.write_png(folder / "hillshade.png", np.repeat(picture[..., None], 3, axis=2))
    images.write_png(folder / "classes.png", np.ascontiguousarray(class_map(terrain)))
    names = ("terrain.npz", "bed.tif", "top.tif", "hillshade.png", "classes.png")
    return [folder / name for name in names]


def read_terrain(folder):
    """Return the `Terrain` that `write_terrain` wrote into `folder` (or its .npz itself).

    Examples
    --------
    >>> paths = rainsim.write_terrain("map", terrain)
    >>> rainsim.read_terrain("map").grid == terrain.grid
    True
    """
    path = Path(folder)
    path = path / "terrain.npz" if path.is_dir() else path
    tops = {TOPS + name: replace(field, needed=False) for name, field in _TOP_ARRAYS.items()}
    found = read_arrays(path, WHAT, _ARRAYS | tops, VERSION, REMEDY)
    shape = found["bed"].shape
    if min(shape) < LEAST_CELLS or shape[0] * shape[1] > MOST_CELLS:
        raise _wrong(path, f"has {shape[1]} x {shape[0]} cells", f"{LEAST_CELLS} x {LEAST_CELLS} "
                     f"or more, {MOST_CELLS} in all")  # fmt: skip
    _check_heights(path, found)
    if "layer" in found and found["layer"].shape not in (shape, (0, 0)):
        raise _wrong(path, f"has a layer of shape {found['layer'].shape}", f"{shape} or (0, 0)")
    _check_tops(path, found, shape)
    if TOPS + "surface" in found:
        found[TOPS + "surface"] = found[TOPS + "surface"][:, :3]
    return Terrain.from_arrays(found)


def _wrong(path, fact, rule):
    return InputError(f"{path} {fact}; a {WHAT} must have {rule}; {REMEDY}")


def _check_heights(path, found):
    """Raise InputError unless the ground lies below the undersides and these below the tops."""
    low = (found["underside"] - found["bed"]).min()
    if min(low, (found["top"] - found["underside"]).min()) < -NEAR:
        raise _wrong(path, "has ground, undersides and tops in the wrong order", "bed <= "
                     "underside <= top")  # fmt: skip


def _check_tops(path, found, shape):
    """Raise InputError unless the arrays of the tops, if any, fit each other and the map."""
    arrays = {name: found[TOPS + name] for name in _TOP_ARRAYS if TOPS + name in found}
    if not arrays:
        return
    if len(arrays) < len(_TOP_ARRAYS):
        raise _wrong(path, "has a part of the tops only", "all of their arrays or none")
    count, (rows, columns) = len(arrays["surface"]), arrays["relief"].shape
    index, patch = arrays["index"], arrays["patch"]
    fits = index.shape == (shape if count else (0, 0)) and (index < count).all()
    squares = arrays["surface"][:, 3:]  # of old versions, which were zero
    fits &= squares.shape[1] in (0, 3) and not squares.any()
    fits &= (patch[:, 0] + patch[:, 1] <= rows).all() and (patch[:, 2] <= columns).all()
    if not fits or not arrays["relief"].size:
        raise _wrong(path, "has tops that do not fit together", "their cells and patches in place")
