"""The water surface that pictures show: smooth where the solver's is made of wet and dry cells."""

from __future__ import annotations

import math
import weakref
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import cpu_kernel, device_function, prange, thorough_kernel

GRASS_HEIGHT = 0.05  # m of water that closes over a lawn
WET_CELL = np.float32(3e-4)  # m: cells with more carry the surface; thinner water only darkens
RELIEF = 0.5e-3  # m, standard deviation of the roughness that a capture does not show; by eye
RELIEF_WIDTHS = (0.02, 0.05, 0.12)  # m
SURFACE_REACH = 2  # cells by which the surface is continued into the dry, for soft rims
LEAST_WEIGHT = np.float32(1e-4)  # of wet cells around, below which there is no surface
BLOCK = 8  # cells of a block, of which the mean level is kept
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
    found = _reliefs.get((shape, spacing))
    if found is None:
        rng, relief = np.random.Generator(np.random.PCG64(0)), np.zeros(shape)
        for width in RELIEF_WIDTHS:
            part = rng.normal(size=shape)
            for axis in (0, 1):  # in place: maps of millions of cells in float64 are large
                ndimage.gaussian_filter1d(part, width / spacing, axis, output=part)
            part /= part.std()
            relief += part
        relief *= RELIEF / math.sqrt(len(RELIEF_WIDTHS))
        found = _reliefs[shape, spacing] = relief.astype(np.float32)
    return found


_reliefs = weakref.WeakValueDictionary()  # windows of one size share theirs while one holds it


def water_surface(terrain, depth, relief, mirrors):
    """Return the height of the water surface and the water's depth, both float32 (ny, nx) [m].

    The solver's cells are wet or dry; a picture needs a surface that goes on below the ground at
    the rim, so that depth falls to zero smoothly: the surface is the Gaussian mean over the wet
    cells around, and the height of the nearest water where none is near, so that view rays can be
    followed to it. Grass that stands out of the water hides it.

    Parameters
    ----------
    terrain : Terrain
    depth : ndarray of shape (ny, nx), float32 [m]
    relief : ndarray of shape (ny, nx), float32 [m]
        See `fine_relief`.
    mirrors : ndarray of shape (ny, nx), bool
        Cells on which even a thin film of water shows as a surface: no grass stands out of it.
    """
    surface, over = np.empty_like(terrain.bed), np.empty_like(terrain.bed)
    smooth = mirrors | (depth > GRASS_HEIGHT)
    depth = np.asarray(depth, np.float32)
    far = _far_surface(terrain.bed, depth, smooth)
    if far is None:
        return terrain.bed, np.zeros_like(terrain.bed)
    lift = relief + np.float32(GRASS_HEIGHT) * ~mirrors  # depth counts from the tips of the grass
    _continue(terrain.bed, depth, smooth, lift, WIDE, NARROW, far, surface, over)
    return surface, over


def _far_surface(bed, depth, smooth):
    """Return the mean water level of each block of BLOCK x BLOCK cells, or of the nearest block.

    None if nothing is wet.
    """
    ny, nx = bed.shape
    count = np.zeros((-(-ny // BLOCK), -(-nx // BLOCK)), np.float32)
    total = np.zeros_like(count)
    _sum_blocks(bed, depth, smooth, count, total)
    empty = count == 0
    if empty.all():
        return None
    nearest = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
    return (total / np.maximum(count, 1))[tuple(nearest)]


@cpu_kernel
def _sum_blocks(bed, depth, smooth, count_out, total_out):
    """Count the wet cells in the mask `smooth` of each block, and sum their water levels."""
    ny, nx = bed.shape
    rows = len(count_out)
    for m in prange(rows):
        for j in range(m * BLOCK, min(m * BLOCK + BLOCK, ny)):
            for i in range(nx):
                if depth[j, i] > WET_CELL and smooth[j, i]:
                    count_out[m, i // BLOCK] += ONE
                    total_out[m, i // BLOCK] += bed[j, i] + depth[j, i]


@thorough_kernel
def _continue(bed, depth, smooth, relief, wide, narrow, far, surface_out, over_out):
    """Write the two results of `water_surface`: the height of the surface and the water's depth.

    Both are Gaussian means over cells, taken along rows first, then along columns.

    Parameters
    ----------
    bed, depth : ndarray of shape (ny, nx), float32 [m]
    smooth : ndarray of shape (ny, nx), bool
        Cells on which water can show as a surface: no grass stands out of it.
    relief : ndarray of shape (ny, nx), float32 [m]
        Height above the bed from which the water's depth counts.
    wide, narrow : ndarray of shape (13,) and (7,), float32
        Weights of the Gaussians that smooth the surface and the depth.
    far : ndarray of shape (ceil(ny / BLOCK), ceil(nx / BLOCK)), float32 [m]
        Height of the surface where no water is near, see `_far_surface`.
    surface_out, over_out : ndarray of shape (ny, nx), float32 [m]
        Height of the surface in the ground frame; its smoothed height above bed and relief, the
        water's depth, 0 away from water.
    """
    ny, nx = bed.shape
    weight, height = np.empty((ny, nx), np.float32), np.empty((ny, nx), np.float32)
    wet = np.empty((ny, nx), np.bool_)
    any_wet = np.zeros(ny, np.bool_)
    base = bed[ny // 2, nx // 2]  # heights are taken from here: small numbers, small rounding
    for j in prange(ny):
        for i in range(nx):
            wet[j, i] = depth[j, i] > WET_CELL and smooth[j, i]
            any_wet[j] |= wet[j, i]
        weight[j] = ZERO
        height[j] = ZERO
        if any_wet[j]:
            for i in range(nx):
                if wet[j, i]:
                    eta = bed[j, i] + depth[j, i] - base
                    for k in range(max(i - 6, 0), min(i + 7, nx)):
                        weight[j, k] += wide[i - k + 6]
                        height[j, k] += wide[i - k + 6] * eta
    rough, any_rough = np.zeros((ny, nx), np.float32), np.zeros(ny, np.bool_)
    for j in prange(ny):
        continue_far(far, np.int64(j), surface_out[j])
        total, mean = np.zeros(nx, np.float32), np.zeros(nx, np.float32)
        near = False
        for k in range(max(j - 6, 0), min(j + 7, ny)):
            if any_wet[k]:
                near = True
                w = wide[k - j + 6]
                for i in range(nx):
                    total[i] += w * weight[k, i]
                    mean[i] += w * height[k, i]
        if near:
            for i in range(nx):
                if total[i] > LEAST_WEIGHT:
                    surface_out[j, i] = base + mean[i] / total[i]
                    if smooth[j, i] and _wet_near(wet, j, i):
                        over = surface_out[j, i] - bed[j, i] - relief[j, i]
                        rough[j, i] = max(over, ZERO)
                        any_rough[j] |= over > ZERO
    for j in prange(ny):
        over = over_out[j]
        over[:] = ZERO
        first, end = max(j - 3, 0), min(j + 4, ny)
        if any_rough[first:end].any():
            row = np.zeros(nx, np.float32)
            for k in range(first, end):
                for i in range(nx):
                    row[i] += narrow[k - j + 3] * rough[k, i]
            for m in range(7):
                for i in range(max(3 - m, 0), min(nx, nx + 3 - m)):
                    over[i] += narrow[m] * row[i + m - 3]


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
    for i in range(len(surface_out)):
        # Cell i lies between the middles of two blocks; a block of its own stands at either end.
        block = (i + BLOCK // 2) // BLOCK
        across = (np.float32((i + BLOCK // 2) % BLOCK) + HALF) / np.float32(BLOCK)
        surface_out[i] = line[block] * (ONE - across) + line[block + 1] * across


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
