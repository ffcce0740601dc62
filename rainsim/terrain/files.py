"""Height maps on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rainsim.errors import InputError
from rainsim.terrain.types import NO_TOPS, Grid, Terrain, Tops

_ARRAYS = ("bed", "top", "underside", "source", "ground_class", "noise", "color")
_WATER = "water"  # not in the files of old versions
_TOPS = "tops_"  # begins the names of the arrays of `Tops`; not in the files of old versions


def write_terrain(folder, terrain):
    """Write terrain.npz, bed.tif, top.tif (float32 metres) and pictures into `folder`.

    The pictures are hillshade.png (bed and top) and classes.png (in the class table's colours).

    Pictures and TIFFs have north (greatest y) at the top; arrays in the .npz have row 0 in the
    south. Returns the paths written.
    """
    from rainsim.io import images
    from rainsim.terrain.pictures import class_map, hillshade

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    arrays = {name: getattr(terrain, name) for name in (*_ARRAYS, _WATER)}
    arrays |= {_TOPS + name: values for name, values in terrain.tops.arrays().items()}
    grid = terrain.grid
    images.write_npz(
        folder / "terrain.npz", **arrays, origin=np.array(grid.origin), spacing=grid.spacing,
        notes=np.array(terrain.notes, dtype=np.str_),
    )  # fmt: skip
    images.write_tiff(folder / "bed.tif", terrain.bed[::-1])
    images.write_tiff(folder / "top.tif", terrain.top[::-1])
    shade = np.hstack([hillshade(terrain.bed, grid.spacing, exaggerate=8),
                       hillshade(terrain.top, grid.spacing, exaggerate=1)])  # fmt: skip
    picture = (shade[::-1] * 255 + 0.5).astype(np.uint8)
    images.write_png(folder / "hillshade.png", np.repeat(picture[..., None], 3, axis=2))
    images.write_png(folder / "classes.png", np.ascontiguousarray(class_map(terrain)))
    names = ("terrain.npz", "bed.tif", "top.tif", "hillshade.png", "classes.png")
    return [folder / name for name in names]


def read_terrain(folder):
    """Return the `Terrain` that `write_terrain` wrote into `folder` (or its .npz itself)."""
    path = Path(folder)
    path = path / "terrain.npz" if path.is_dir() else path
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = [data[name] for name in _ARRAYS]
            shape = arrays[0].shape
            grid = Grid(shape, tuple(map(float, data["origin"])), float(data["spacing"]))
            notes = tuple(map(str, data["notes"]))
            water = data[_WATER] if _WATER in data else None
            tops = {n.removeprefix(_TOPS): data[n] for n in data.files if n.startswith(_TOPS)}
            tops = Tops.from_arrays(tops) if tops else NO_TOPS
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; `rainsim heightmap` writes it") from None
    except (KeyError, ValueError, TypeError, OSError, EOFError) as error:
        raise InputError(f"{path} is no terrain of rainsim ({error}); write it again") from error
    return Terrain(grid, *arrays, notes=notes, water=water, tops=tops)
