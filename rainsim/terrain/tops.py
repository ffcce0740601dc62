"""Flat tops above the ground: tables, benches, roofs, sills, steps.

A flat patch of the map of tops counts if a plane fits it to a centimetre: hedges, cushions and
bonnets do not. Of a level one the splats show more than the map has cells for: seen from above
in finer cells they give the relief on which thin puddles stand and the gaps that part them.
"""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from rainsim.errors import counted
from rainsim.terrain.pictures import seen_straight
from rainsim.terrain.types import NO_TOPS, Grid, Tops

LOWEST, HIGHEST = 0.3, 1.5  # m over the bed: lower things are wetted as ground
STEEPEST = 0.35  # slope, of a roof
SMALLEST = 0.2  # m2
ROUGHEST = 0.010  # m from the fitted surface, of four fifths of the cells
LEVEL_SLOPE = 0.03  # from which on water runs off wholly
UNSURE_SLOPE = 0.015  # the vertical is not known better: a flatter top is meant to be level
MARGIN = 0.04  # m around a top, in which its edge may show
EDGE_CELLS = 4  # of the map, along an edge, that count as steep
MOST_TOPS = 512
FINE, FINER = 5e-3, 4  # m of a patch's cells, and how many of them are in one of the map
MOST_CELLS = 1_000_000  # of all patches
BAND = 0.05  # m above and below the surface, within which splats belong to a top
SEEN_ALPHA = 0.6
FARTHEST = 0.02  # m from the surface, of cells on which water can stand
GAP_WIDTH, GAP_DARK = 0.025, 0.035  # m, and the share by which a gap is darker than what is around,
# on the mean over GAP_LENGTH along it and beyond what it is across: a capture blurs gaps of some mm
GAP_LENGTH, GAP_TURNS = 0.08, 16  # m, and directions of a half turn
DARKEST = 0.3  # share that counts: one black spot makes no line
GAP_CELLS = 8  # of a gap that is found; smaller ones are knots
SMOOTHING, STRAIGHT = 0.02, 0.12  # m, of the relief: finer forms are noise, broader ones are the
# capture's warp, since boards and slabs are built straight
RIM = 0.03  # m along the edge: there splats bend down
FITS = 4  # of the surface, each to the better half of the cells


def find_tops(terrain, scene=None):
    """Return the `Tops` of a terrain.

    The splats of a scene show the relief of level tops; without one the terrain's cells do.
    """
    grid, found = terrain.grid, []
    for box, mask in flat_patches(terrain):
        fit = fitted(terrain, box, mask)
        if fit is not None:
            found.append((*grown(terrain, box, mask, *fit[:2]), *fit))
    if not found:
        return NO_TOPS
    found = sorted(found, key=lambda top: -np.count_nonzero(top[1]))[:MOST_TOPS]
    index = np.full(grid.shape, -1, np.int16)
    reach = max(1, round(MARGIN / grid.spacing))
    nearest = np.full(grid.shape, np.inf, np.float32)
    for k, (box, mask, *_) in enumerate(found):
        away = ndimage.distance_transform_edt(~mask)
        mine = (away <= reach) & (away < nearest[box])
        index[box][mine], nearest[box][mine] = k, away[mine]
    surface, centre = (np.array([top[a] for top in found]) for a in (2, 3))
    area = np.array([np.count_nonzero(top[1]) for top in found]) * grid.cell_area
    level = np.array([top[4] for top in found])
    spacing = max(FINE, grid.spacing / FINER)
    spacing *= max(1.0, np.sqrt(2 * area[level].sum() / spacing**2 / MOST_CELLS))
    blank = np.zeros((len(found), 3), np.int64), np.zeros((len(found), 2))
    plain = Tops(index, surface, centre, area, *blank, spacing, NO_TOPS.relief, NO_TOPS.holds)
    return with_patches(plain, level, terrain, scene)


def flat_patches(terrain):
    """Yield the flat parts of objects above the ground: a box of the map, and a mask in it."""
    spacing = terrain.grid.spacing
    height = terrain.top - terrain.bed
    things, count = ndimage.label((height > LOWEST) & (height < HIGHEST))  # NaN is no thing
    del height
    least = SMALLEST / spacing**2
    size = np.bincount(things.ravel(), minlength=count + 1)
    for k, slices in enumerate(ndimage.find_objects(things), 1):
        if size[k] < least:
            continue
        box = padded(slices, 2, things.shape)
        tall = things[box] == k
        # The ground beside an edge must not count as the top's slope.
        dy, dx = np.gradient(mean_around(terrain.top[box], tall, 1), spacing)
        flat = ndimage.binary_opening(tall & (np.hypot(dx, dy) < STEEPEST), iterations=2)
        labels, _ = ndimage.label(flat)
        cells = np.bincount(labels.ravel())
        for n in np.flatnonzero(cells >= least):
            if n > 0:
                yield box, labels == n


def padded(box, cells, shape):
    """Return a box of slices with `cells` more on all sides, within a map of that shape."""
    return tuple(
        slice(max(s.start - cells, 0), min(s.stop + cells, side))
        for s, side in zip(box, shape, strict=True)
    )


def fitted(terrain, box, mask):
    """Return surface (3,), centre (2,) and whether a flat patch is level; None if it is rough."""
    x, y = terrain.grid.centres()
    rows, columns = np.nonzero(mask)
    height = terrain.top[box][rows, columns].astype(np.float64)
    x, y = x[box[1]][columns], y[box[0]][rows]
    centre = np.array([x.mean(), y.mean()])
    plane, away = robust_fit(terms_of(x - centre[0], y - centre[1]), height)
    slope = np.hypot(*plane[1:])
    # A curved one has no outline in a map of such cells: bonnets keep the gloss of all wet things.
    if not away < ROUGHEST or slope > STEEPEST:
        return None
    return plane, centre, bool(slope < LEVEL_SLOPE)


def grown(terrain, box, mask, surface, centre):
    """Return box and mask of a flat patch with the cells around it that lie on its surface.

    Where slopes are taken over an edge, the cells along it count as steep.
    """
    steps = EDGE_CELLS + 2 * int(MARGIN / terrain.grid.spacing) + 1
    wide = padded(box, steps, terrain.top.shape)
    inner = np.zeros([s.stop - s.start for s in wide], bool)
    rows, columns = np.nonzero(mask)
    inner[rows + box[0].start - wide[0].start, columns + box[1].start - wide[1].start] = True
    reach = EDGE_CELLS + int(MARGIN / terrain.grid.spacing)
    x, y = terrain.grid.centres()
    height = terms_of(*np.meshgrid(x[wide[1]] - centre[0], y[wide[0]] - centre[1])) @ surface
    with np.errstate(invalid="ignore"):
        on = np.abs(terrain.top[wide] - height) < FARTHEST
    on &= ndimage.binary_dilation(inner, iterations=reach)
    return wide, ndimage.binary_propagation(inner & on, mask=on) | inner


def terms_of(x, y):
    """Return the three terms of a surface at distances from its centre, (..., 3)."""
    return np.stack([np.ones_like(x), x, y], axis=-1)


def robust_fit(terms, height):
    """Return the coefficients that fit most of the heights, and the distance of four fifths [m]."""
    kept = np.ones(len(height), bool)
    for _ in range(FITS):
        found = np.linalg.lstsq(terms[kept], height[kept], rcond=None)[0]
        away = np.abs(height - terms @ found)
        kept = away <= 2 * np.median(away) + 1e-6
    return found, float(np.percentile(away, 80))


def note_of(tops):
    """Yield in words which tops were found; nothing without any."""
    if not len(tops):
        return
    level = np.flatnonzero(tops.level)
    words = [f"{tops.area[k]:.2g} m2 at {tops.surface[k, 0]:.2f} m" for k in level[:3]]
    if len(level) > 3:
        words.append(f"{len(level) - 3} more level ones")
    if len(level) < len(tops):
        words.append(f"{len(tops) - len(level)} not level")
    yield f"{counted(len(tops), 'flat top')} above the ground: {', '.join(words)}"


# ---- the relief of level tops


def with_patches(tops, level, terrain, scene):
    """Return the tops with patches for those that are `level` (n,)."""
    patch, corner = tops.patch.copy(), tops.corner.copy()
    reliefs, holds, first = [], [], 0
    for k in np.flatnonzero(level):
        rows, columns = np.nonzero(tops.index == k)
        low = np.array([columns.min(), rows.min()]) * terrain.grid.spacing + terrain.grid.origin
        size = np.array([np.ptp(columns) + 1, np.ptp(rows) + 1]) * terrain.grid.spacing
        nx, ny = (np.ceil(size / tops.spacing).astype(int) + 2).tolist()
        corner[k] = low - tops.spacing
        grid = Grid((ny, nx), tuple(corner[k]), tops.spacing)
        relief, hold = measured(tops, k, grid, terrain, scene)
        hold[[0, -1]], hold[:, [0, -1]] = False, False
        patch[k] = first, ny, nx
        first += ny
        reliefs.append(relief)
        holds.append(hold)
    if not reliefs:
        return tops
    width = max(relief.shape[1] for relief in reliefs)

    def stacked(parts):
        return np.concatenate([np.pad(a, ((0, 0), (0, width - a.shape[1]))) for a in parts])

    return replace(
        tops, patch=patch, corner=corner, relief=stacked(reliefs).astype(np.float32),
        holds=stacked(holds),
    )  # fmt: skip


def measured(tops, k, grid, terrain, scene):
    """Return relief [m] and the mask of cells that hold water on the patch `grid` of a top."""
    x, y = np.meshgrid(*grid.centres())
    plane = terms_of(x - tops.centre[k, 0], y - tops.centre[k, 1]) @ tops.surface[k]
    if scene is None:
        row, column, inside = terrain.grid.cells(x, y)
        height = terrain.top[row, column].astype(np.float64)
        seen, gap = inside & np.isfinite(height), np.zeros(grid.shape, bool)
    else:
        height, alpha, light = seen_from_above(tops, k, grid, scene)
        seen, gap = alpha > SEEN_ALPHA, gaps_in(light, alpha, grid.spacing)
    relief = np.where(seen, height - plane, 0)
    solid = seen & (np.abs(relief) < FARTHEST)
    whole = ndimage.binary_closing(np.pad(solid, 8), iterations=4)[8:-8, 8:-8]
    core = solid & (ndimage.distance_transform_edt(whole) * grid.spacing > RIM)
    forms = mean_around(relief, core, SMOOTHING / grid.spacing)
    forms = forms - mean_around(forms, core, STRAIGHT / grid.spacing)
    # What the vertical leaves open is taken off: a table is meant to be level.
    tilt = float(np.hypot(*tops.surface[k, 1:3]))
    sure = 1 - min(1.0, UNSURE_SLOPE / max(tilt, 1e-9))
    return forms + sure * (plane - tops.surface[k, 0]), solid & ~gap


def mean_around(values, known, width):
    """Return the Gaussian mean of the known values, of a standard deviation of `width` cells."""
    share = ndimage.gaussian_filter(known.astype(np.float64), width)
    return ndimage.gaussian_filter(np.where(known, values, 0), width) / np.maximum(share, 1e-3)


def seen_from_above(tops, k, grid, scene):
    """Return height [m], alpha and brightness of a top's own splats on a patch, (rows, columns).

    What stands on the top is left out.
    """
    frame = scene.ground_frame
    with np.errstate(invalid="ignore", over="ignore"):
        place = frame.to_ground(scene.splats.position.astype(np.float64))
        away = place[:, :2] - tops.centre[k]
        near = (np.abs(away) < max(grid.size)).all(axis=1)
        plane = terms_of(*away.T) @ tops.surface[k]
        near &= np.abs(place[:, 2] - plane) < BAND
    blank = np.zeros(grid.shape)
    if not near.any():
        return blank, blank, blank
    splats = replace(scene.splats, sh=scene.splats.sh[:, :1]).take(near)
    seen = seen_straight(splats, frame, grid, float(tops.surface[k, 0]) + 1.0, plane=True)
    light = seen.color.mean(axis=-1) / np.maximum(seen.alpha, 0.3)
    known = np.isfinite(seen.height)
    return np.where(known, seen.height, 0), np.where(known, seen.alpha, 0), light


def gaps_in(light, alpha, spacing):
    """Return the mask of dark lines: the gaps between planks.

    A gap is faint where the capture blurs it, but it is straight: darkness is averaged along each
    direction, and a line is where one direction is darker than most are.
    """
    size = max(3, 2 * round(GAP_WIDTH / spacing / 2) + 1)
    filled = np.where(alpha > SEEN_ALPHA, light, 0)
    around = ndimage.grey_closing(filled, size=(size, size))
    dark = np.clip((around - filled) / np.maximum(around, 0.02), 0, DARKEST)
    along = np.stack([
        ndimage.convolve(dark, needle, mode="constant") for needle in _needles(GAP_LENGTH / spacing)
    ])  # fmt: skip
    line = along.max(axis=0)
    gap = (line - np.median(along, axis=0) > GAP_DARK) & (dark > 0.5 * line)
    labels, count = ndimage.label(gap, structure=np.ones((3, 3)))
    long = np.bincount(labels.ravel(), minlength=count + 1) >= GAP_CELLS
    long[0] = False
    return long[labels]


def _needles(length):
    """Yield the weights of means over lines of a `length` [cells] in each direction."""
    half = max(round(length / 2), 1)
    steps = np.linspace(-half, half, 8 * half + 1)
    for turn in np.pi / GAP_TURNS * np.arange(GAP_TURNS):
        needle = np.zeros((2 * half + 1, 2 * half + 1))
        place = (np.rint(half + steps * f(turn)).astype(int) for f in (np.sin, np.cos))
        np.add.at(needle, tuple(place), 1.0)
        yield needle / needle.sum()
