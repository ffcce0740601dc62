"""Water that a user puts on the ground, as a map of depths from above."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.errors import InputError, ParameterError
from rainsim.terrain.map_size import MOST_CELLS
from rainsim.terrain.pond import rim_level

STAYS, DRAINS = "stays", "drains"
DEEPEST = 10.0  # m


class WaterMask(NamedTuple):
    """Depths of water on the cells of a height map."""

    depth: np.ndarray  # (ny, nx), float32, m, row 0 in the south
    stays: bool  # whether the ground is dented by the depth, so that the water stays


def read_water_mask(path, use=STAYS):
    """Return the `WaterMask` of a grey picture aligned with the height map, in millimetres.

    North is at the top of the picture, 8 or 16 bits or a float TIFF.
    """
    from rainsim.io import images

    picture = images.read_image(path, MOST_CELLS)
    if picture.ndim != 2:
        raise InputError(
            f"{path} has {picture.shape[-1]} channels; a water mask must be grey, its value the "
            "depth in mm; save it as a grey PNG"
        )
    depth = picture[::-1].astype(np.float32) * np.float32(1e-3)
    if not (np.isfinite(depth).all() and depth.min() >= 0 and depth.max() <= DEEPEST):
        raise InputError(
            f"{path} holds depths of {picture.min():g} to {picture.max():g} mm; they must be 0 to "
            f"{DEEPEST * 1e3:g}; mend it"
        )
    return WaterMask(np.ascontiguousarray(depth), use == STAYS)


def write_water_mask(path, mask):
    """Write a `WaterMask` as a grey picture of 16 bits, in millimetres, north at the top."""
    from rainsim.io import images

    images.write_png16(path, np.rint(mask.depth[::-1] * 1e3).astype(np.uint16))


def painted_water(mask, grid, point, radius, depth, stays):
    """Return a `WaterMask` with a disc of water painted on it about `point` (x, y), radius in m.

    A depth [m] of 0 takes water away; `stays` holds for all water of the mask.
    """
    found = np.zeros(grid.shape, np.float32) if mask is None else mask.depth.copy()
    found[grid.disc(point, radius)] = depth
    return WaterMask(found, stays)


def with_water(terrain, mask):
    """Return the terrain with the water of a `WaterMask` on it at the start, and a note.

    Water that stays fills a dent of its depth in the ground up to the dent's low rim: on a slope a
    part of the dent is dry. Water that drains is poured, and comes to rest where the ground dips.
    Without a mask the terrain itself is returned; ParameterError if it does not fit the map.
    """
    if mask is None or not mask.depth.any():
        return terrain
    if mask.depth.shape != terrain.grid.shape:
        raise ParameterError(
            f"the water mask has {mask.depth.shape[1]} x {mask.depth.shape[0]} cells; the map has "
            f"{terrain.grid.shape[1]} x {terrain.grid.shape[0]}; paint over a picture that "
            "`rainsim heightmap` wrote with the same options"
        )
    litres = float(mask.depth.sum()) * terrain.grid.cell_area * 1e3
    if not mask.stays:
        note = f"water mask: {litres:.3g} litres are poured, and stand where the ground dips"
        return replace(terrain, poured=mask.depth, notes=(*terrain.notes, note))
    bed, standing = terrain.bed.copy(), np.zeros(terrain.grid.shape, np.float32)
    wet = mask.depth > 0
    labels, count = ndimage.label(wet)
    for n, part in enumerate(ndimage.find_objects(labels, count), 1):
        part = tuple(slice(max(s.start - 1, 0), s.stop + 1) for s in part)
        here = labels[part] == n
        level = rim_level(terrain.bed[part], here, wet[part], terrain.grid.spacing)
        bed[part] -= np.where(here, mask.depth[part], 0)
        standing[part] += np.where(here, np.maximum(level - bed[part], 0), 0).astype(np.float32)
    stands = float(standing.sum()) * terrain.grid.cell_area * 1e3
    note = (
        f"water mask: dents of {litres:.3g} litres hold {stands:.3g} up to their low rims, in "
        f"{count} {'puddle' if count == 1 else 'puddles'}"
    )
    free = terrain.top <= terrain.bed  # what stands there keeps its height
    low = terrain.underside <= terrain.bed
    return replace(
        terrain, bed=bed, standing=standing, notes=(*terrain.notes, note),
        top=np.where(free, bed, terrain.top), underside=np.where(low, bed, terrain.underside),
    )  # fmt: skip


def with_standing(terrain, depth):
    """Return depths (ny, nx) [m] with at least the water that a user has stand on the ground."""
    return depth if terrain.standing is None else np.maximum(depth, terrain.standing)
