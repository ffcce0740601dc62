"""The water surface that pictures show: smooth where the solver's is made of wet and dry cells."""

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.constants import HALF, ONE, ZERO
from rainsim.io import cache
from rainsim.jit import cpu_kernel, device_function, inlined_function, prange

GRASS_HEIGHT = 0.05  # m of water that closes over a lawn
HIGH_GRASS = np.float32(GRASS_HEIGHT)
WET_CELL = np.float32(3e-4)  # m: cells with more carry the surface; thinner water only darkens
RELIEF = 0.5e-3  # m, standard deviation of the roughness that a capture does not show; by eye
RELIEF_WIDTHS = (0.02, 0.05, 0.12)  # m
SURFACE_REACH = 2  # cells by which the surface is continued into the dry, for soft rims
LEAST_WEIGHT = np.float32(1e-4)  # of wet cells around, below which there is no surface
BLOCK = 8  # cells of a block, of which the mean level is kept
SPAN = 32  # cells of a row that take no means together; at least as many as a mean reaches
INFINITE = np.float32(np.inf)
WIDE_WATER = np.ones((2, 2), np.float32)  # no shores


class WaterMap(NamedTuple):
    """The water that pictures show, over the map's cells."""

    surface: np.ndarray  # (ny, nx) float32 [m], height; continued below the ground beside the water
    depth: np.ndarray  # (ny, nx) float32 [m]
    rings: np.ndarray  # (ny, nx) float32, amplitude of rings over that in the open
    origin: np.ndarray  # (2,) float32 [m], corner of the map
    spacing: np.float32  # m, of its cells
    # (rows, columns) float32, of blocks of BLOCK x BLOCK cells: amplitude of rings over that in a
    # usual puddle, see `puddle_rings`
    shores: np.ndarray = WIDE_WATER


def _gauss(sigma, radius):
    """Return the weights of a Gaussian of `sigma` cells at -radius to radius, sum 1, float32."""
    weight = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    return (weight / weight.sum()).astype(np.float32)


WIDE, NARROW = _gauss(1.5, 6), _gauss(0.7, 3)


def fine_relief(terrain):
    """Return a made-up roughness of hard ground, finer than a capture resolves, (ny, nx) [m].

    Captured beds are smoothed, so their puddles would end in lines too smooth for stone. The
    relief moves the drawn rim by less than a millimetre of depth; the solver's bed has none.
    """
    shape, spacing = terrain.grid.shape, terrain.grid.spacing

    def made():
        rng, relief = np.random.Generator(np.random.PCG64(0)), np.zeros(shape)
        for width in RELIEF_WIDTHS:
            part = rng.normal(size=shape)
            for axis in (0, 1):  # in place: maps of millions of cells in float64 are large
                ndimage.gaussian_filter1d(part, width / spacing, axis, output=part)
            part /= part.std()
            relief += part
        relief *= RELIEF / math.sqrt(len(RELIEF_WIDTHS))
        return {"relief": relief.astype(np.float32)}

    return cache.kept_arrays("relief", made, shape, spacing)["relief"]


def water_surface(terrain, depth, relief, mirrors):
    """Return the water surface, the water's depth and the highest water [m].

    The solver's cells are wet or dry; a picture needs a surface that goes on below the ground at
    the rim, so that depth falls to zero smoothly: the surface is the Gaussian mean over the wet
    cells around, and the height of the nearest water where none is near, so that view rays can be
    followed to it. Grass that stands out of the water hides it.

    depth : float32 array (ny, nx) [m]
    relief : float32 array (ny, nx) [m]. See `fine_relief`.
    mirrors : bool array (ny, nx). Cells on which even a thin film of water shows
        as a surface: no grass stands out of it.
    Returns surface, over : float32 array (ny, nx) [m]. Height of the surface in
        the ground frame, and the depth of water that pictures show.
        highest : float32 [m] or None. Of the surface where there is water; None
            if there is none.
    """
    depth = np.asarray(depth, np.float32)
    far = _far_surface(terrain.bed, depth, mirrors)
    if far is None:
        return terrain.bed, np.zeros_like(terrain.bed), None
    surface, over = np.empty_like(terrain.bed), np.empty_like(terrain.bed)
    highest = np.empty(len(depth), np.float32)
    given = terrain.bed, depth, mirrors, relief, WIDE, NARROW, far
    _continue(*given, surface, over, highest)
    highest = highest.max()
    return surface, over, highest if highest > -np.inf else None


def _far_surface(bed, depth, mirrors):
    """Return the mean water level of each block of BLOCK x BLOCK cells, or of the nearest block.

    None if nothing is wet.
    """
    ny, nx = bed.shape
    count = np.zeros((-(-ny // BLOCK), -(-nx // BLOCK)), np.float32)
    total = np.zeros_like(count)
    _sum_blocks(bed, depth, mirrors, count, total)
    empty = count == 0
    if empty.all():
        return None
    nearest = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
    return (total / np.maximum(count, 1))[tuple(nearest)]


@cpu_kernel
def _sum_blocks(bed, depth, mirrors, count_out, total_out):
    """Count the cells of each block that carry a surface, and sum their water levels."""
    ny, nx = bed.shape
    rows = len(count_out)
    for m in prange(rows):
        for j in range(m * BLOCK, min(m * BLOCK + BLOCK, ny)):
            for i in range(nx):
                if depth[j, i] > WET_CELL and is_smooth(depth[j, i], mirrors[j, i]):
                    count_out[m, i // BLOCK] += ONE
                    total_out[m, i // BLOCK] += bed[j, i] + depth[j, i]


@inlined_function
def is_smooth(depth, mirrors):
    """Tell whether water of a depth [m] can show as a surface: no grass stands out of it."""
    return mirrors | (depth > HIGH_GRASS)  # without a branch, so that a row is one in vectors


@cpu_kernel
def _continue(bed, depth, mirrors, relief, wide, narrow, far, surface_out, over_out, highest_out):
    """Write the results of `water_surface`: heights of the surface, depths, the highest water.

    Surface and depth are Gaussian means, taken along rows first, then along columns. Most of a map
    is dry: each row is cut into spans of SPAN cells, and those without water near take no means.

    bed, depth : float32 array (ny, nx) [m]
    mirrors : bool array (ny, nx)
    relief : float32 array (ny, nx) [m]. Height above the bed from which the
        water's depth counts; on grass from its tips on.
    wide, narrow : array (13,) and (7,), float32. Weights of the Gaussians that
        smooth the surface and the depth.
    far : ndarray of shape (ceil(ny / BLOCK), ceil(nx / BLOCK)), float32 [m].
        Height of the surface where no water is near, see `_far_surface`.
    surface_out, over_out : float32 array (ny, nx) [m]. Height of the surface in
        the ground frame; its smoothed height above bed and relief, the water's
        depth, 0 away from water.
    highest_out : float32 array (ny,) [m]. Of the surface in each row where there
        is water; -inf where there is none.
    """
    ny, nx = bed.shape
    spans = -(-nx // SPAN)
    wet = np.empty((ny, nx), np.bool_)
    # Sums along rows, weight and level of each cell, and which spans have them; then the depth
    # before it is smoothed.
    sums = np.empty((ny, 2 * nx), np.float32)
    reached = np.zeros((ny, spans), np.bool_)
    rough, is_rough = np.empty((ny, nx), np.float32), np.zeros((ny, spans), np.bool_)
    base = bed[ny // 2, nx // 2]  # heights are taken from here: small numbers, small rounding
    for j in prange(ny):
        find_wet(depth[j], mirrors[j], wet[j])
        mark_spans(wet[j], reached[j])
        sum_along_row(bed[j], depth[j], wet[j], base, wide, reached[j], sums[j])
    for row in prange(ny):
        j = np.int64(row)
        continue_far(far, j, surface_out[j])
        total = np.empty(2 * SPAN, np.float32)
        for m in range(spans):
            left, right = m * SPAN, min(m * SPAN + SPAN, nx)
            near = False
            for k in range(max(j - 6, 0), min(j + 7, ny)):
                if reached[k, m]:
                    if not near:
                        total[:], near = ZERO, True
                    add_scaled(wide[k - j + 6], sums[k, 2 * left : 2 * right], total)
            if near:
                rough[j, left:right] = ZERO
                for i in range(left, right):
                    weight, level = total[2 * (i - left)], total[2 * (i - left) + 1]
                    if weight > LEAST_WEIGHT:
                        surface_out[j, i] = base + level / weight
                        if is_smooth(depth[j, i], mirrors[j, i]) and _wet_near(wet, j, i):
                            lift = relief[j, i] if mirrors[j, i] else relief[j, i] + HIGH_GRASS
                            over = surface_out[j, i] - bed[j, i] - lift
                            rough[j, i] = max(over, ZERO)
                            is_rough[j, m] |= over > ZERO
    for row in prange(ny):
        j = np.int64(row)
        highest_out[j] = soften_row(rough, is_rough, narrow, j, surface_out[j], over_out[j])


@inlined_function
def find_wet(depth, mirrors, wet_out):
    """Mark the cells of a row that carry a water surface; all in vectors."""
    for i in range(len(wet_out)):
        wet_out[i] = (depth[i] > WET_CELL) & is_smooth(depth[i], mirrors[i])


@inlined_function
def add_scaled(gain, numbers, sum_out):
    """Add `gain` times some numbers to as many at the start of the sums, in vectors."""
    for i in range(len(numbers)):
        sum_out[i] += gain * numbers[i]


@inlined_function
def mark_spans(wet, reached_out):
    """Mark the spans of a row that hold a wet cell, and those beside them."""
    nx, spans = len(wet), len(reached_out)
    for m in range(spans):
        found = False
        for i in range(m * SPAN, min(m * SPAN + SPAN, nx)):
            found |= wet[i]
        if found:
            for k in range(max(m - 1, 0), min(m + 2, spans)):
                reached_out[k] = True


@device_function
def sum_along_row(bed, depth, wet, base, wide, reached, sums_out):
    """Write Gaussian sums of a row's wet cells, 1 and the level over `base` [m] of each by turns.

    Only in the spans that are `reached`.
    """
    nx, reach = len(wet), len(wide) // 2
    given = np.zeros(2 * (nx + 2 * reach), np.float32)
    for m in range(len(reached)):
        if reached[m]:
            for i in range(m * SPAN, min(m * SPAN + SPAN, nx)):
                if wet[i]:
                    given[2 * (i + reach)] = ONE
                    given[2 * (i + reach) + 1] = bed[i] + depth[i] - base
    for m in range(len(reached)):
        if reached[m]:
            left, right = 2 * m * SPAN, 2 * min(m * SPAN + SPAN, nx)
            sums_out[left:right] = ZERO
            for k in range(2 * reach + 1):
                add_scaled(wide[k], given[left + 2 * k : right + 2 * k], sums_out[left:right])


@device_function
def soften_row(rough, is_rough, narrow, j, surface, over_out):
    """Write the smoothed depth of row j; return its highest water [m], -inf if it has none.

    `rough` (ny, nx) [m] is read in the spans of SPAN cells that `is_rough` marks.
    """
    ny, nx = rough.shape
    spans = is_rough.shape[1]
    line, lies = np.zeros(nx + 6, np.float32), np.zeros(spans + 2, np.bool_)
    for m in range(spans):
        for k in range(max(j - 3, 0), min(j + 4, ny)):
            if is_rough[k, m]:
                lies[m + 1] = True
                left, right = m * SPAN, min(m * SPAN + SPAN, nx)
                add_scaled(narrow[k - j + 3], rough[k, left:right], line[left + 3 : right + 3])
    over_out[:] = ZERO
    highest = -INFINITE
    for m in range(spans):
        if lies[m] or lies[m + 1] or lies[m + 2]:
            left, right = m * SPAN, min(m * SPAN + SPAN, nx)
            for k in range(7):
                add_scaled(narrow[k], line[left + k : right + k], over_out[left:right])
            for i in range(left, right):
                if over_out[i] > ZERO:
                    highest = max(highest, surface[i])
    return highest


@device_function
def continue_far(far, j, surface_out):
    """Write the mean levels of blocks, interpolated, as row j of the surface."""
    rows, columns = far.shape
    at = (np.float32(j) + HALF) / np.float32(BLOCK) - HALF
    at = min(max(at, ZERO), np.float32(rows - 1))
    upper = min(int(at), max(rows - 2, 0))
    lower, down = min(upper + 1, rows - 1), at - np.float32(upper)
    line = np.empty(columns + 2, np.float32)
    for i in range(columns):
        line[i + 1] = far[upper, i] * (ONE - down) + far[lower, i] * down
    line[0], line[columns + 1] = line[1], line[columns]
    cells = np.empty((columns + 1) * BLOCK, np.float32)  # from half a block before the map on
    for block in range(columns + 1):
        for k in range(BLOCK):
            across = (np.float32(k) + HALF) / np.float32(BLOCK)
            cells[block * BLOCK + k] = line[block] * (ONE - across) + line[block + 1] * across
    for i in range(len(surface_out)):
        surface_out[i] = cells[i + BLOCK // 2]


@device_function
def _wet_near(wet, j, i):
    """Tell whether a cell within SURFACE_REACH steps is wet."""
    ny, nx = wet.shape
    for k in range(max(j - SURFACE_REACH, 0), min(j + SURFACE_REACH + 1, ny)):
        reach = SURFACE_REACH - abs(k - j)
        for m in range(max(i - reach, 0), min(i + reach + 1, nx)):
            if wet[k, m]:
                return True
    return False
