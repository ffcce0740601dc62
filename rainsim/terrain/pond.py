"""Water that the user paints into the class mask, and the capture without that water's image.

A capture does not show how deep its ponds are, so the bed of painted water is assumed. Painted
water starts full, rain runs over its lowest rim, and it mirrors by the optics of water. The mirror
image that the splats hold is removed, because it would be seen through the new water.
"""

import functools
from dataclasses import replace

import numpy as np
from scipy import ndimage

from rainsim.constants import SH_0
from rainsim.scene.pages import Change, Pages
from rainsim.scene.splat_sets import joined
from rainsim.scene.types import Splats
from rainsim.terrain.table import WATER

DEPTH = 0.3  # m, greatest assumed depth of painted water
SHELF = 1.0  # m of depth per metre from the rim, up to DEPTH
RIM = 0.3  # m about painted water in which its rim is looked for
RIM_PERCENTILE = 10  # of the rim's heights: as high water stands that was painted
WATER_COLOR = np.array([0.02, 0.028, 0.018])  # linear, of painted water without reflections
GAMMA = 2.2
SURFACE = 0.02  # m above the level up to which splats over the water show it
DEEP, SLOPE = 0.24, 0.1  # m below the ground; off the map the ground may fall by so much a metre
DISC = 0.75  # of the distance between the splats of the bed, their standard deviation
LEAST_PITCH = 0.02  # m between them


def fill_ponds(grid, bed, classes, color):
    """Dig the assumed beds of painted water (bed [m] and color are modified in place).

    `classes` are WATER where the user's mask has it. Return the depth of the water [m], 0 where
    there is none, or None if there is none at all; and notes.
    """
    wet = classes == WATER
    if not wet.any():
        return None, ()
    depth = np.zeros(grid.shape, np.float32)
    labels, count = ndimage.label(wet)
    notes, litres = [], 0.0
    for n, part in enumerate(ndimage.find_objects(labels, count), 1):
        margin = round(RIM / grid.spacing) + 1
        part = tuple(slice(max(s.start - margin, 0), s.stop + margin) for s in part)
        here = labels[part] == n
        away = ndimage.distance_transform_edt(np.pad(wet[part], 1, mode="edge"))[1:-1, 1:-1]
        level = rim_level(bed[part], here, wet[part], grid.spacing)
        deep = np.minimum(DEPTH, SHELF * away * grid.spacing)
        bed[part] = np.where(here, level - deep, bed[part])
        depth[part] = np.where(here, deep, depth[part])
        color[part][here] = WATER_COLOR ** (1 / GAMMA)
        litres += float(deep[here].sum()) * grid.cell_area * 1e3
    bodies_are = "body" if count == 1 else "bodies"
    notes.append(
        f"painted water: {count} {bodies_are}, {wet.sum() * grid.cell_area:.3g} m2; its bed is "
        f"not seen and ASSUMED {DEPTH:g} m deep ({litres:.0f} litres)"
    )
    return depth, tuple(notes)


def rim_level(bed, here, wet, spacing):
    """Return the level [m] of painted water: that of its rim where it is low."""
    around = ndimage.distance_transform_edt(~here) * spacing
    rim = (around > 0) & (around < RIM) & ~wet
    return float(np.percentile(bed[rim if rim.any() else here], RIM_PERCENTILE))


def without_images(scene, terrain):
    """Return the scene with the assumed beds of painted water in place of the captured water.

    The splats of the captured water surface are left out, and so are the mirror images below the
    ground, wherever they are: they would shine through the splats that cover the ground. Runs of a
    capture in chunks are changed as they are read. Without painted water the scene itself is
    returned.
    """
    if not (terrain.water > 0).any():
        return scene
    grid, frame = terrain.grid, scene.ground_frame
    gone = functools.partial(shows_water, frame, grid, terrain.bed, terrain.water)
    kept = scene.splats.take(~gone(scene.splats))
    added = _bed_splats(terrain, frame, kept.sh.shape[1])
    pages = scene.pages
    if pages is not None:
        pages.read.clear()  # that the memory is not taken twice
        pages = Pages(pages.tree, pages.memory, Change(gone, added))
    return replace(scene, splats=joined([kept, added]), pages=pages)


def shows_water(frame, grid, bed, water, splats):
    """Return which splats are captured water or a mirror image below the ground, (n,) bool.

    `bed` is the assumed bed of painted water [m], `water` how deep it is [m].
    """
    wet = water > 0
    level = np.where(wet, bed + water, 0)
    with np.errstate(invalid="ignore", over="ignore"):
        position = frame.to_ground(splats.position)
        known = np.isfinite(position).all(axis=1)
        j, i, inside = grid.cells(*np.where(known[:, None], position, 1e9)[:, :2].T)
    gone = inside & wet[j, i] & (position[:, 2] < level[j, i] + SURFACE)
    beyond = [
        np.abs(
            position[:, k] - np.clip(position[:, k], grid.origin[k], grid.origin[k] + grid.size[k])
        )
        for k in (0, 1)
    ]
    ground = np.where(wet, level, bed)[j, i] - SLOPE * np.hypot(*beyond)
    return gone | (position[:, 2] < ground - DEEP)


def _bed_splats(terrain, frame, coefficients):
    """Return discs on the bed of painted water, in its colours."""
    grid = terrain.grid
    row, column = np.nonzero(terrain.water > 0)
    every = max(1, round(LEAST_PITCH / grid.spacing))
    chosen = (row % every == 0) & (column % every == 0)
    row, column = row[chosen], column[chosen]
    x, y = grid.centres()
    points = np.stack([x[column], y[row], terrain.bed[row, column]], axis=1)
    size = DISC * every * grid.spacing / frame.meters_per_unit
    n = len(points)
    sh = np.zeros((n, coefficients, 3), np.float32)
    sh[:, 0] = (terrain.color[row, column] - 0.5) / SH_0
    rotation = np.zeros((n, 4), np.float32)
    rotation[:, 0] = 1
    return Splats(
        frame.to_capture(points).astype(np.float32), rotation,
        np.full((n, 3), size, np.float32), np.full(n, 0.99, np.float32), sh,
    )  # fmt: skip
