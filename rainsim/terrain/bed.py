"""The bed from measured heights: gaps, objects, noise, smoothing, and the soil under grass."""

import numpy as np
from scipy import ndimage

from rainsim.terrain import filters

FINE_PASSES = 10  # of smoothing what was filled on coarser cells
OBJECT_HEIGHT = 0.02  # m above the opened ground: a leg, a pot, a ball, not the ground
OBJECT_NOISES = 4.0  # times the ground's noise, if that is more
KERB_WIGGLE = 0.03  # m by which the edge of a kerb as captured is not straight
OPENING_WIDTH = 0.5  # m: wider things that stand in the slab are taken as ground
STEP_RELIEF = 0.03  # m within 10 cm: a kerb or a step, kept sharp
STEP_NOISES = 5.0  # times the noise, if that is more
EDGE_BLUR = 0.12  # m, standard deviation, along which a step's edge is averaged
EDGE_REACH, EDGE_RAMP = 0.045, 0.03  # m from the edge: cells that may change; that are of both
EDGE_WIDE = 0.06  # m and more, twice, that both levels of an edge are wide
EDGE_AROUND, LEAST_EDGE = 0.4, 0.5  # m about a step that are looked at; length of one that counts
TREND_WIDTH = 0.025  # m, standard deviation of the trend that noise is measured about
NOISE_WIDTH = 0.15  # m, standard deviation of the window in which noise is measured
NOISE_CUT = 3.0  # local deviations; what is more is a leaf or a step, not noise
# Standard deviations of the smoothing [m] and the noise [m] they are for, between which it goes
# over. 4 cm looked best of eight filters on a captured patio with 0.7 mm; at 10 mm of noise more
# than 6 cm loses shallow dips, less makes false ones.
SMOOTHING = ((0.02, 0.2e-3), (0.04, 0.7e-3), (0.06, 5e-3))
SOIL_CELL = 0.2  # m: blades part often enough within this for the soil to be seen
SOIL_PERCENTILE = 8  # of the splats' heights in such a cell: 1 to 5 are floaters below the ground
SOIL_COUNT = 12  # splats in a cell that it takes to tell
RIM_WIDTH = 0.5  # m from paving within which the soil is not taken to lie lower than the paving
MIXED_WIDTH = 0.04  # m of paving before grass, and at least two cells, into which blades hang
GRASS_DEPTH = 0.08  # m: grass is not taken to be higher


def inpaint(values, known, passes=60):
    """Return `values` (ny, nx) with unknown cells filled smoothly from their known neighbours.

    Wide gaps are filled on coarser cells first; `passes` is how often a gap is smoothed at most.
    """
    if known.all():
        return values.astype(np.float32)
    if passes > FINE_PASSES and min(values.shape) >= 32:
        coarse = inpaint(*_halved(values, known), passes // 2)
        filled = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)
        filled = filled[: values.shape[0], : values.shape[1]]
        filled = np.where(known, values, filled).astype(np.float32)
        passes = FINE_PASSES
    else:
        nearest = ndimage.distance_transform_edt(
            ~known, return_distances=False, return_indices=True
        )
        filled = values[tuple(nearest)].astype(np.float32)
    for _ in range(passes):
        smooth = filters.uniform_filter(filled, 5)
        np.copyto(filled, smooth, where=~known)
    return filled


def _halved(values, known):
    """Return the means of the known values in blocks of 2 x 2 cells, and where there are any."""
    odd = [(0, n % 2) for n in values.shape]
    weight = np.pad(known, odd).astype(np.float32)
    total = np.pad(np.where(known, values, 0).astype(np.float32), odd)
    shape = (weight.shape[0] // 2, 2, weight.shape[1] // 2, 2)
    weight, total = (a.reshape(shape).sum(axis=(1, 3)) for a in (weight, total))
    return total / np.maximum(weight, 1), weight > 0


def objects(filled, known, grass, spacing):
    """Return the mask of objects: cells well above the morphological opening of the ground."""
    width = max(3, round(OPENING_WIDTH / spacing))
    opened = filters.grey_opening(filters.median_filter(filled), size=width)
    # An opening cuts the corners of kerbs; beside the upper level they are no objects.
    opened = filters.maximum_filter(opened, max(3, 2 * round(KERB_WIGGLE / spacing) + 1))
    limit = np.maximum(OBJECT_HEIGHT, OBJECT_NOISES * local_noise(filled, known, spacing))
    standing = known & ~grass & (filled - opened > limit)
    return ndimage.binary_dilation(standing, iterations=2) & known & ~grass


def local_noise(height, known, spacing):
    """Return the standard deviation [m] of `height` about its trend, within about 15 cm.

    What is more than three local deviations (by the median) off the trend is a leaf or a kerb and
    counts as three.
    """
    weight = known.astype(np.float32)
    s = TREND_WIDTH / spacing
    share = np.maximum(filters.gaussian_filter(weight, s), 1e-3)
    trend = filters.gaussian_filter(np.where(known, height, 0).astype(np.float32), s) / share
    away = np.abs(np.where(known, height - trend, 0)).astype(np.float32)
    cut = NOISE_CUT * 1.4826 * _block_median(away, known, max(4, round(0.25 / spacing)))
    square = np.minimum(away, cut) ** 2 * weight
    wide = NOISE_WIDTH / spacing
    weight = np.maximum(blur(weight, wide), 1e-3)
    variance = blur(square.astype(np.float32), wide) / weight
    if s > 0.5:  # the trend itself follows white noise: what it takes away is given back
        variance /= 1 - 1 / (np.pi * s * s) + 1 / (4 * np.pi * s * s)
    return np.sqrt(np.maximum(variance, 0)).astype(np.float32)


def blur(values, width):
    """Return `values` (ny, nx) blurred by a Gaussian of `width` cells, on fewer cells if wide."""
    step = int(width / 3)
    if step < 2 or min(values.shape) < 4 * step:
        return filters.gaussian_filter(values, width)
    ny, nx = values.shape
    padded = np.pad(values, ((0, -ny % step), (0, -nx % step)), mode="edge")
    rows, columns = padded.shape[0] // step, padded.shape[1] // step
    coarse = padded.reshape(rows, step, columns, step).mean(axis=(1, 3))
    coarse = filters.gaussian_filter(coarse, width / step)
    return _spread(ny, rows, step) @ coarse @ _spread(nx, columns, step).T


def _spread(fine, coarse, step):
    """Return the matrix (fine, coarse) that interpolates linearly between the blocks' centres."""
    place = np.clip((np.arange(fine) + 0.5) / step - 0.5, 0, coarse - 1)
    low = np.minimum(place.astype(int), coarse - 2)
    matrix = np.zeros((fine, coarse), np.float32)
    matrix[np.arange(fine), low] = 1 - (place - low)
    matrix[np.arange(fine), low + 1] = place - low
    return matrix


def _block_median(values, known, size):
    """Return the median of the known values about every cell, from blocks of `size` cells."""
    ny, nx = values.shape
    rows, columns = -(-ny // size), -(-nx // size)
    padded = np.full((rows * size, columns * size), np.nan, np.float32)
    padded[:ny, :nx] = np.where(known, values, np.nan)
    blocks = padded.reshape(rows, size, columns, size).swapaxes(1, 2).reshape(rows, columns, -1)
    counted = np.count_nonzero(np.isfinite(blocks), axis=2)
    blocks[counted == 0] = 0
    median = np.nanmedian(blocks, axis=2)
    median = inpaint(median, counted > size, passes=2) if (counted > size).any() else median
    coarse = filters.median_filter(median)
    j, i = (np.arange(n) // size for n in (ny, nx))
    return coarse[np.ix_(j, i)]


def smooth(height, noise, spacing):
    """Return `height` smoothed at the scale of its noise, but only by a median at kerbs and steps.

    Height and noise are maps [m], `spacing` the width of their cells [m].
    """
    median = filters.median_filter(height)
    finest, scale = SMOOTHING[0]
    result = filters.gaussian_filter(median, finest / spacing)
    for width, next_scale in SMOOTHING[1:]:
        part = filters.gaussian_filter(median, width / spacing)
        share = np.log(np.maximum(noise, 1e-6) / scale) / np.log(next_scale / scale)
        result = result + (part - result) * np.clip(share, 0, 1)
        scale = next_scale
    steep = steps(median, noise, spacing).astype(np.float32)
    steep = np.clip(2 * filters.gaussian_filter(steep, 1.5), 0, 1)
    return (result + (median - result) * steep).astype(np.float32)


def steps(height, noise, spacing):
    """Return the mask of the cells about kerbs and steps."""
    size = max(3, 2 * round(0.05 / spacing) + 1)
    relief = filters.maximum_filter(height, size) - filters.minimum_filter(height, size)
    return relief > np.maximum(STEP_RELIEF, STEP_NOISES * noise)


def straighten(height, step, spacing):
    """Return `height` with the edges of its steps put where they are on average along them.

    Splats tell an edge to half the gap between them; along a kerb there are many. The mask of the
    upper level, blurred, keeps a straight edge in its place and loses the jags; only cells within
    4 cm of the edge change, between levels that are both wide. `step` marks the cells about steps;
    height and spacing are in metres.
    """
    labels, count = ndimage.label(ndimage.binary_dilation(step, np.ones((3, 3), bool)))
    margin = int(EDGE_AROUND / spacing) + 1
    result = height
    for n, part in enumerate(ndimage.find_objects(labels, count), 1):
        if max(s.stop - s.start for s in part) * spacing < LEAST_EDGE:
            continue
        if result is height:
            result = height.copy()
        part = tuple(slice(max(s.start - margin, 0), s.stop + margin) for s in part)
        _straighten_one(height[part], labels[part] == n, spacing, result[part])
    return result


def _straighten_one(height, band, spacing, out):
    """Straighten one step's edge, into `out`."""
    size = max(3, 2 * round(0.08 / spacing) + 1)
    middle = (filters.minimum_filter(height, size) + filters.maximum_filter(height, size)) / 2
    nearest = ndimage.distance_transform_edt(~band, return_distances=False, return_indices=True)
    upper = height > middle[tuple(nearest)]
    inside = [ndimage.distance_transform_edt(side) * spacing for side in (upper, ~upper)]
    away = np.where(upper, inside[0], inside[1])
    straight = filters.gaussian_filter(upper.astype(np.float32), EDGE_BLUR / spacing) > 0.5
    there = band & (away < EDGE_REACH)
    for depth in inside:  # both levels must be wide, or a wall would be blurred away
        wide = ndimage.distance_transform_edt(~(depth > EDGE_WIDE)) * spacing
        there &= wide < EDGE_WIDE + 2 * EDGE_REACH
    for side in (True, False):
        clear = (upper == side) & (away > EDGE_RAMP)
        if clear.any():
            nearest = ndimage.distance_transform_edt(
                ~clear, return_distances=False, return_indices=True
            )
            np.copyto(out, height[tuple(nearest)], where=there & (straight == side))


def lower_rim(height, hard, grass, spacing):
    """Return `height` with the last cells of paving before grass not above the paving behind them.

    Those cells are of both: blades in them raise a wall that would dam puddles. `hard` and `grass`
    are masks; height and spacing are in metres.
    """
    width = max(2, round(MIXED_WIDTH / spacing))
    rim = hard & ndimage.binary_dilation(grass, iterations=width)
    behind = hard & ~rim
    if not (rim.any() and behind.any()):
        return height
    away, nearest = ndimage.distance_transform_edt(~behind, return_indices=True)
    rim &= away < 2 * width
    return np.where(rim, np.minimum(height, height[tuple(nearest)]), height)


def smoothing_width(noise):
    """Return the standard deviation [m] of the smoothing for a noise [m]."""
    widths, scales = np.transpose(SMOOTHING)
    return float(np.interp(np.log(max(noise, 1e-9)), np.log(scales), widths))


def soil_under_grass(canopy, grass, points, weights, grid):
    """Return the height of the ground with the grass taken off, ndarray of shape (ny, nx) [m].

    Blades hide the soil from above, but splats reach down between them: the soil is a low
    percentile of their heights. `points` [m] are solid splats near the ground; those of weight 0
    are not used.
    """
    row, column, inside = grid.cells(points[:, 0], points[:, 1])
    inside &= weights > 0
    row, column = row[inside], column[inside]
    below = canopy[row, column] - points[inside, 2]
    fine = grass[row, column] & (np.abs(below) < 2 * GRASS_DEPTH)
    if not fine.any():
        return canopy
    size = max(1, round(SOIL_CELL / grid.spacing))
    rows, columns = -(-grid.shape[0] // size), -(-grid.shape[1] // size)
    cell = (row[fine] // size) * columns + column[fine] // size
    depth, told = _percentile_per_cell(cell, below[fine], rows * columns, 100 - SOIL_PERCENTILE)
    if not told.any():
        return canopy
    depth = inpaint(depth.reshape(rows, columns), told.reshape(rows, columns), passes=10)
    depth = filters.gaussian_filter(filters.median_filter(depth), 0.7)
    fine_rows = (np.arange(grid.shape[0]) + 0.5) / size - 0.5
    fine_columns = (np.arange(grid.shape[1]) + 0.5) / size - 0.5
    places = np.meshgrid(fine_rows, fine_columns, indexing="ij")
    depth = ndimage.map_coordinates(depth, places, order=1, mode="nearest")
    soil = canopy - np.clip(depth, 0, GRASS_DEPTH)
    if not grass.all():
        # Blades are short at the rim of paving, and lawns do not lie in a trench beside it.
        away, nearest = ndimage.distance_transform_edt(grass, return_indices=True)
        rim = np.minimum(filters.gaussian_filter(canopy[tuple(nearest)], 1.0), canopy)
        soil = np.where(away * grid.spacing < RIM_WIDTH, np.maximum(soil, rim), soil)
    return np.where(grass, soil, canopy).astype(np.float32)


def _percentile_per_cell(cell, values, count, percentile):
    """Return a percentile of the values in each of `count` cells, and where there were enough."""
    order = np.lexsort((values, cell))
    cell, values = cell[order], values[order]
    start = np.searchsorted(cell, np.arange(count + 1))
    number = np.diff(start)
    told = number >= SOIL_COUNT
    place = start[:-1] + np.minimum((number * percentile / 100).astype(np.int64), number - 1)
    result = np.where(told, values[np.minimum(np.maximum(place, 0), len(values) - 1)], 0)
    return result.astype(np.float32), told
