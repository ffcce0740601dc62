"""Splats near the bed, even where the bed leaves the ground plane: a slab that follows it.

Streets rise and fall and cross; a plane is their frame, not their bed. On coarse cells the level of
the ground is followed from where it lies on the plane outwards: in each cell the lowest
well-supported layer of splats within reach of its neighbours' level. Where there is none the level
is carried on for a while, so that ground behind a hedge is found again.
"""

import numpy as np
from scipy import ndimage

from rainsim.jit import serial_kernel
from rainsim.numerics.blocks import stable_order
from rainsim.terrain import filters

SLAB = 0.12  # m above and below the ground's level within which splats are ground
CELL = 0.25  # m
BIN = 0.01  # m of height
REACH = 0.16  # m a cell's ground may differ from its neighbours': a kerb, or a slope of 60 %
LEAST_COVER = 0.25  # of a cell by splats, for its layer to count as ground
LOWER_SHARE = 0.3  # of the strongest layer that a lower one needs to be the ground
CARRY = 16  # cells without ground over which the level is carried on
SEED_REACH = 0.06  # m from the plane, of the cells that the search starts from
FAINT = 0.1  # opacity of haze
BLOB = 0.15  # m of standard deviation upwards: haze, not a surface
VOXEL, MOST_VOXELS = 0.1, 4_000_000  # m; larger over large maps
LONELY_COVER = 1.0  # of a voxel's face: a surface through the 27 voxels about it covers 9
UNSEEN, CARRIED, FOUND = 0, 1, 2


def follow_ground(points, cover, grid, start):
    """Return the coarse level of the ground, and the share of coarse cells with their own.

    The level is a function of arrays of x and y [m]. `points` are the centres of the splats, (n, 3)
    [m], `cover` the area that each covers [m2]. The search starts within `start` [m] of the map's
    middle, where ground lies on the plane.
    """
    (width, depth), origin = grid.size, np.array(grid.origin)
    nx, ny = max(1, int(np.ceil(width / CELL))), max(1, int(np.ceil(depth / CELL)))
    place = np.floor((points[:, :2] - origin) / CELL).astype(np.int64)
    near = (place >= 0).all(axis=1) & (place < (nx, ny)).all(axis=1) & (cover > 0)
    cell = place[near, 1] * nx + place[near, 0]
    order = stable_order(cell)
    first = np.searchsorted(cell[order], np.arange(nx * ny + 1)).astype(np.int64)
    height = points[near, 2][order].astype(np.float32)
    cover = (cover[near][order] / CELL**2).astype(np.float32)
    y, x = np.meshgrid(np.arange(ny) + 0.5, np.arange(nx) + 0.5, indexing="ij")
    away = np.hypot(x * CELL - width / 2, y * CELL - depth / 2).ravel()
    level, state = np.zeros(nx * ny, np.float32), np.zeros(nx * ny, np.uint8)
    # Without ground near the middle, begin wherever ground lies on the plane.
    for reach in (start, np.inf):
        follow(height, cover, first, nx, np.flatnonzero(away <= reach), level, state)
        if (state == FOUND).any():
            break
    share = float(np.mean(state == FOUND))
    level, known = level.reshape(ny, nx), state.reshape(ny, nx) != UNSEEN
    if known.any():
        nearest = ndimage.distance_transform_edt(~known, return_indices=True)[1]
        level = filters.median_filter(level[tuple(nearest)])

    def at(px, py):
        places = np.stack([np.asarray(py) - origin[1], np.asarray(px) - origin[0]]) / CELL - 0.5
        return ndimage.map_coordinates(level, places, order=1, mode="nearest")

    return at, share


@serial_kernel
def follow(height, cover, first, nx, seeds, level_out, state_out):
    """Follow the ground outwards from cells in which it lies on the plane.

    height, cover : float32 array (n,). Splats, sorted by cell [m], [cells].
    first : int64 array (cells + 1,). Where each cell's splats begin.
    nx : int. Cells in a row.
    seeds : int64 array (k,). Cells that may lie on the plane.
    level_out : float32 array (cells,) [m]
    state_out : uint8 array (cells,). UNSEEN, CARRIED or FOUND.
    """
    count = first.size - 1
    queue, gap = np.empty(count, np.int64), np.zeros(count, np.int64)
    bins = np.zeros(int(2 * REACH / BIN) + 1)
    head = tail = 0
    for c in seeds:
        level, found = lowest_layer(height, cover, first[c], first[c + 1], 0.0, SEED_REACH, bins)
        if found:
            level_out[c], state_out[c] = level, FOUND
            queue[tail] = c
            tail += 1
    while head < tail:
        c = queue[head]
        head += 1
        if gap[c] >= CARRY:
            continue
        row, column = c // nx, c % nx
        for side in range(4):
            j = row + (side == 0) - (side == 1)
            i = column + (side == 2) - (side == 3)
            d = j * nx + i
            if j < 0 or i < 0 or i >= nx or d >= count or state_out[d] != UNSEEN:
                continue
            total, number = 0.0, 0
            for b in range(max(j - 1, 0), j + 2):
                for a in range(max(i - 1, 0), min(i + 2, nx)):
                    e = b * nx + a
                    if e < count and state_out[e] != UNSEEN:
                        total += level_out[e]
                        number += 1
            expected = total / number
            level, found = lowest_layer(
                height, cover, first[d], first[d + 1], expected, REACH, bins
            )
            level_out[d] = level if found else expected
            state_out[d] = FOUND if found else CARRIED
            gap[d] = 0 if found else gap[c] + 1
            queue[tail] = d
            tail += 1


@serial_kernel
def lowest_layer(height, cover, begin, end, expected, reach, bins):
    """Return the level [m] of the lowest well-supported layer near `expected`, and if there is one.

    `bins` is room for a histogram.
    """
    number = int(2 * reach / BIN) + 1
    bins[:number] = 0.0
    for n in range(begin, end):
        k = int(np.floor((height[n] - expected + reach) / BIN))
        if 0 <= k < number:
            bins[k] += cover[n]
    best = 0.0
    for k in range(number - 2):
        best = max(best, bins[k] + bins[k + 1] + bins[k + 2])
    if best < LEAST_COVER:
        return expected, False
    for k in range(number - 2):
        mass = bins[k] + bins[k + 1] + bins[k + 2]
        if mass >= LOWER_SHARE * best and mass >= LEAST_COVER:
            # Climb to the layer's own peak.
            while k < number - 3 and bins[k + 3] > bins[k]:
                k += 1
            low = expected - reach + k * BIN
            total, weight = 0.0, 0.0
            for n in range(begin, end):
                if low <= height[n] < low + 3 * BIN:
                    total += height[n] * cover[n]
                    weight += cover[n]
            if weight > 0.0:
                return total / weight, True
            return expected, False
    return expected, False


def splat_cover(splats, frame):
    """Return the area [m2] that each splat covers for an eye above it; none for haze and blobs.

    Big splats are capped at four times the median area: one must not outweigh many.
    """
    scale = splats.scale.astype(np.float64) * frame.meters_per_unit
    a, b, c = scale.T  # column by column: numpy is slow along an axis of three
    area = a * b * c / np.maximum(np.minimum(np.minimum(a, b), c), 1e-12) * 2 * np.pi
    solid = (splats.opacity >= FAINT) & (upward_spread(splats, frame) < BLOB)
    cap = 4 * np.median(area[solid]) if solid.any() else 0.0
    return np.where(solid, splats.opacity * np.minimum(area, max(cap, 1e-12)), 0.0)


def upward_spread(splats, frame):
    """Return the standard deviation of each splat along the ground's up [m]."""
    w, x, y, z = splats.rotation.T
    u = frame.up.astype(np.float32)
    # Rows of the transposed rotation times up: up in the splat's own axes.
    own = (
        (1 - 2 * (y * y + z * z)) * u[0] + 2 * (x * y + w * z) * u[1] + 2 * (x * z - w * y) * u[2],
        2 * (x * y - w * z) * u[0] + (1 - 2 * (x * x + z * z)) * u[1] + 2 * (y * z + w * x) * u[2],
        2 * (x * z + w * y) * u[0] + 2 * (y * z - w * x) * u[1] + (1 - 2 * (x * x + y * y)) * u[2],
    )
    total = sum((axis * splats.scale[:, k]) ** 2 for k, axis in enumerate(own))
    return np.sqrt(total) * frame.meters_per_unit


def lonely(points, splats, frame, grid, top):
    """Return the mask of splats with too little surface about them to be a thing: floaters.

    Within three voxels of about 10 cm each way the splats of a surface cover it; floaters, be they
    many, are small or faint. `points` are the centres in the ground frame [m], `splats` lie in the
    capture frame. What lies beyond the map or above the height `top` [m] is not lonely.
    """
    lonely = np.zeros(len(points), bool)
    low = np.array([*grid.origin, points[:, 2].min(initial=0.0, where=np.isfinite(points[:, 2]))])
    low[2] = max(low[2], -top)
    size = np.array([*grid.size, top - low[2]])
    voxel = max(VOXEL, float(size.prod() / MOST_VOXELS) ** (1 / 3))
    shape = np.maximum(np.ceil(size / voxel).astype(np.int64), 1)
    with np.errstate(invalid="ignore"):
        place = np.floor((points - low) / voxel)
        inside = ((place >= 0) & (place < shape)).all(axis=1)
    index = np.ravel_multi_index(place[inside].astype(np.int64).T, shape)
    a, b, c = splats.scale[inside].astype(np.float64).T
    middle = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
    largest = np.maximum(np.maximum(a, b), c)
    scale = frame.meters_per_unit
    area = 2 * np.pi * ((middle * scale) * (largest * scale)) * splats.opacity[inside]
    cover = np.bincount(index, area, minlength=shape.prod()).reshape(shape)
    near = 27 * ndimage.uniform_filter(cover.astype(np.float32), 3, mode="constant")
    lonely[inside] = near.ravel()[index] < LONELY_COVER * voxel**2
    return lonely
