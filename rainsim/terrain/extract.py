"""From splats to `Terrain`: three orthographic splattings, tile by tile.

What lies near the bed, seen from above, gives the ground even under a table; everything below the
ceiling, seen from above, gives the tops of occluders; the same seen from below their undersides.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from skimage.morphology import remove_small_objects

from rainsim import raster
from rainsim.errors import GroundError, ParameterError
from rainsim.lod.held_parts import scene_over
from rainsim.scene.ground import STRAY
from rainsim.scene.types import Camera, pose_at
from rainsim.surface.kept_surface import STEPS as SURFACE_STEPS
from rainsim.surface.kept_surface import kept_surface
from rainsim.surface.sweep import ground_sweep
from rainsim.terrain import assumed_bed, filters, types
from rainsim.terrain import bed as bedding
from rainsim.terrain.classify import EXCESS_GREEN, classify, is_green, mark_drains, painted_mask
from rainsim.terrain.map_size import choose_grid
from rainsim.terrain.pond import fill_ponds
from rainsim.terrain.slab import FAINT, SLAB, follow_ground, lonely, splat_cover
from rainsim.terrain.table import GRASS, HARD
from rainsim.terrain.tops import find_tops, note_of
from rainsim.terrain.types import GAP_HEIGHT, INFERRED, MEASURED, UNKNOWN, Grid, Terrain

MIN_SEEN_ALPHA = 0.5  # of a cell from above: with less its height is unknown
OCCLUDER_HEIGHT = 0.10  # m above the ground from which something shelters it
SMALLEST_TOP = 2e-3  # m2 of a thing that shelters the ground
CEILING_OVER_CAMERAS = 1.0  # m: what is higher was hardly seen by any camera
CEILING_WITHOUT_CAMERAS = 4.0  # m above the ground
PIECE = 4_500_000  # cells of a map that are made at once, with their margins; some 800 MB
STEPS = 6  # that each part is made in, of some seconds for a million cells
MARGIN = 2.0  # m about the cells of a part that are made with them: nothing reaches farther
NEAR_BED = 0.03  # m, and four times the noise: what is farther from the first bed stands on it
LARGEST_SHIFT, SHIFT_WIDTH = 0.02, 0.05  # m, by which overlapping splats may hide the ground
EDGE_THICKNESS = 5e-3  # m between the looks from above and below from where an edge begins
EDGE_WIDTH = 0.06  # m: splats of a kerb's top reach so far over its edge
SWEPT_NOISE = 3e-3  # m, of heights from pictures, as far as smoothing them goes
LEAST_GROUND = 0.02  # share of the map that must show ground


def extract_terrain(scene, config, mask=None, tell=None):
    """Return the `Terrain` of a scene, see `rainsim.pipeline.extract_terrain`.

    `config` is the TerrainConfig. Cells of the mask that are -1 are found from the splats; without
    one the classes painted in the scene are taken, see `Scene.painted`. tell(notes, done, total) is
    called as steps are done; notes say what map is made. GroundError if hardly any ground is seen
    within the map, ParameterError if the mask does not fit the map.
    """
    grid, notes = choose_grid(scene, config)
    if mask is None and scene.painted is not None:
        mask = painted_mask(scene.painted, grid)
    if mask is not None and np.shape(mask) != grid.shape:
        raise ParameterError(
            f"the class mask has {np.shape(mask)[1]} x {np.shape(mask)[0]} cells; the map has "
            f"{grid.shape[1]} x {grid.shape[0]}; paint over the class map that was written for it"
        )
    scene = scene_over(scene, grid)
    parts = list(pieces(grid))
    step = _steps(tell, notes, SURFACE_STEPS + STEPS * len(parts) + 2)
    cloud = _Cloud(scene, grid, step=step)
    step(SURFACE_STEPS + 1)
    maps = _empty_maps(grid)
    left_out = np.zeros(len(cloud.position), bool)
    for core, inner, piece in parts:
        found = _piece(scene, cloud, piece, None if mask is None else mask[piece.cells], step)
        for name, values in found.items():
            if name == "left_out":
                left_out |= values
            else:
                maps[name][core] = values[inner]
    source, bed, top, underside = (maps[n] for n in ("source", "bed", "top", "underside"))
    if (seen := np.mean(source != UNKNOWN)) < LEAST_GROUND and (cloud.poor is None or not seen):
        raise GroundError(
            f"only {seen:.1%} of the map of {grid.size[0]:g} x {grid.size[1]:g} m shows "
            f"ground within {SLAB:g} m of the ground plane, from {len(scene.splats):,} splats; "
            "give --up and --meters-per-unit, or --ground-frame, or a capture with more splats"
        )
    water, pond_notes = fill_ponds(grid, bed, maps["ground_class"], maps["color"])
    if water is not None:
        filled = water > 0
        source[filled] = INFERRED
        stands = filled & (top > bed + water + OCCLUDER_HEIGHT)
        np.copyto(top, bed, where=filled & ~stands)
        np.copyto(underside, bed, where=filled & (underside < bed + water + GAP_HEIGHT))
    terrain = Terrain(grid, **maps, water=water)
    tops = types.NO_TOPS
    if cloud.poor is None:
        tops = find_tops(terrain, scene)
    else:
        terrain = replace(terrain, layer=cloud.poor.layer_map(terrain, OCCLUDER_HEIGHT))
    step()
    about = _report(terrain, int(np.count_nonzero(left_out)), mask)
    notes += (*cloud.notes, *about, *pond_notes, *note_of(tops))
    return replace(terrain, notes=notes, tops=tops)


def arrays_over(scene, grid, level):
    """Return the arrays of a `Terrain` over a part of a scene's ground; None if no splat is there.

    They are of shape (ny, nx) or (ny, nx, 3); within MARGIN of the grid's rim they are made from
    less than all that bears on it. level(x, y) is about the height of the ground [m], for arrays of
    points.
    """
    mask = None if scene.painted is None else painted_mask(scene.painted, grid)
    scene = scene_over(scene, grid)
    over = _over(scene, grid)
    if not over[2].any():
        return None
    cells = tuple(slice(0, n) for n in grid.shape)
    found = _piece(scene, _Cloud(scene, grid, level, over), Piece(grid, cells), mask, lambda: None)
    del found["left_out"]
    return found


def _over(scene, grid):
    """Return places and reaches [m] of splats in the ground frame; the mask of those over a map."""
    frame = scene.ground_frame
    with np.errstate(invalid="ignore"):
        position = frame.to_ground(scene.splats.position)
        reach = 3 * scene.splats.scale.max(axis=1) * frame.meters_per_unit
        x0, y0 = grid.origin
        width, depth = grid.size
        over = (
            (position[:, 0] + reach > x0) & (position[:, 0] - reach < x0 + width)
            & (position[:, 1] + reach > y0) & (position[:, 1] - reach < y0 + depth)
        )  # fmt: skip
    return position, reach, over


def _steps(tell, notes, total):
    """Return a function to be called after each step, with how many are done at least."""
    done = 0

    def step(least=0):
        nonlocal done
        done = max(done + 1, least)
        if tell is not None:
            tell(notes, done, total)

    if tell is not None:
        tell(notes, 0, total)
    return step


@dataclass(frozen=True)
class Piece:
    """A part of a map: its `Grid`, and its `cells` in the whole map (slices of rows, columns)."""

    grid: Grid
    cells: tuple


def pieces(grid, most=None):
    """Yield the parts in which a map is made, so that memory grows only with what is kept.

    Each overlaps its neighbours by a margin, wider than what cells know of each other. A part whose
    margins are wider than itself would cost more than it saves: else one has `most` cells. With a
    `Piece` come the cells that it is for: slices in the whole map and in the part.
    """
    margin = round(MARGIN / grid.spacing)
    number = [1, 1]

    def sides():
        return [-(-n // k) + margin * min(k - 1, 2)
                for n, k in zip(grid.shape, number, strict=True)]  # fmt: skip

    while np.prod(sides()) > (most or PIECE):
        longest = int(np.argmax(sides()))
        if grid.shape[longest] < 2 * margin * (number[longest] + 1):
            break
        number[longest] += 1
    cuts = [np.linspace(0, n, k + 1).astype(int)
            for n, k in zip(grid.shape, number, strict=True)]  # fmt: skip
    for place in np.ndindex(*number):
        core, inner, cells, origin = [], [], [], []
        for axis, k in enumerate(place):
            first, last = int(cuts[axis][k]), int(cuts[axis][k + 1])
            start, stop = max(first - margin, 0), min(last + margin, grid.shape[axis])
            core.append(slice(first, last))
            inner.append(slice(first - start, last - start))
            cells.append(slice(start, stop))
            origin.append(grid.origin[1 - axis] + start * grid.spacing)
        shape = tuple(c.stop - c.start for c in cells)
        part = Grid(shape, tuple(origin[::-1]), grid.spacing)
        yield tuple(core), tuple(inner), Piece(part, tuple(cells))


def _empty_maps(grid):
    """Return the arrays of a `Terrain`, to be filled."""
    maps = {name: np.empty(grid.shape, np.float32) for name in ("bed", "top", "underside", "noise")}
    maps |= {name: np.empty(grid.shape, np.uint8) for name in ("source", "ground_class")}
    return maps | {"color": np.empty((*grid.shape, 3), np.float32)}


def _piece(scene, cloud, piece, mask, step):
    """Return the arrays of a `Terrain` on a part of the map, and which splats were left out.

    `step()` is called STEPS times.
    """
    grid = piece.grid
    over = cloud.over(grid)
    near = cloud.near_bed & over
    off = np.zeros_like(near)
    if cloud.poor is not None:
        bed, source, noise, color, green = cloud.poor.bed(grid)
        bed, top, underside = cloud.poor.cover(cloud.places, grid, bed, cloud.top)
        for _ in range(STEPS - 1):
            step()
    else:
        ground = cloud.look(near, grid)
        step()
        if (ground.alpha > MIN_SEEN_ALPHA).any():
            off = _floaters(cloud, ground, grid) & near
        kept = near & ~off
        if off.any():
            ground = cloud.look(kept, grid)
        step()
        below = cloud.look(kept, grid, from_below=True)
        bed, source, noise, color, green = _bed(ground, below, grid, cloud.level, cloud.sweep)
        step()
        upper = cloud.look(cloud.below_ceiling & over, grid)
        step()
        lower = cloud.look(cloud.overhead & over, grid, from_below=True)
        top, underside = _cover(upper, lower, bed, grid.cell_area)
        step()
    classes = classify(bed, top, source, noise, color, green, grid.spacing)
    classes = mark_drains(classes, grid, scene)
    if mask is not None:
        classes = np.where(np.asarray(mask) >= 0, mask, classes).astype(np.uint8)
    bed = bedding.lower_rim(bed, classes == HARD, classes == GRASS, grid.spacing)
    # The soil under grass lies lower; what stands in the grass stands on it.
    soil = bed if cloud.poor is not None else cloud.soil(bed, classes, grid)
    lowered = soil < bed
    step()
    return {
        "bed": soil,
        "top": np.where(lowered & (top == bed), soil, top),
        "underside": np.where(lowered & (underside == bed), soil, underside),
        "source": source,
        "ground_class": classes,
        "noise": noise,
        "color": color,
        "left_out": off,
    }


def _report(terrain, removed, mask):
    """Return notes on what is known of the ground and what it is."""
    from rainsim.terrain.table import class_table

    source, classes = terrain.source, terrain.ground_class
    shares = [np.mean(source == kind) for kind in (MEASURED, INFERRED, UNKNOWN)]
    yield (
        f"ground measured {shares[0]:.0%}, inferred {shares[1]:.0%}, unknown {shares[2]:.0%}; "
        f"noise of the paving {terrain.hard_noise * 1e3:.2f} mm"
    )
    if terrain.layer.size:
        yield (
            f"PUDDLES ARE ASSUMED: the splats of the ground lie up to {terrain.layer.max():.2g} m "
            "off it: its bed has an average road's roughness, settled stones, lower feet of walls"
        )
    names = class_table().names
    counted = [(np.mean(classes == code), name) for code, name in enumerate(names)]
    yield "classes: " + ", ".join(f"{name} {share:.0%}" for share, name in counted if share > 0)
    if mask is not None:
        yield f"{np.mean(np.asarray(mask) >= 0):.0%} of the classes given by the mask"
    if removed:
        yield f"{removed} splats near the bed left out: they float over it or stand on it"


@dataclass(frozen=True)
class Seen:
    """An orthographic splatting over a grid, row 0 in the south.

    Height [m] and alpha have shape (ny, nx), colour (ny, nx, 3).
    """

    height: np.ndarray
    alpha: np.ndarray
    color: np.ndarray


class _Cloud:
    """The splats that lie over a map, as arrays in the ground frame.

    `level`, if given, says where the ground is, see `arrays_over`; else it is followed. `found` is
    what `_over` returns, if it is known.
    `look` splats a part of them orthographically from above or from below; masks (`near_bed`,
    `below_ceiling`, `overhead`) tell which part.
    """

    def __init__(self, scene, grid, level=None, found=None, step=lambda: None):
        self.frame = scene.ground_frame
        position, reach, over = _over(scene, grid) if found is None else found
        (x0, y0), (width, depth) = grid.origin, grid.size
        if not over.any():
            raise GroundError(
                f"no splat lies over the map of {width:g} x {depth:g} m about ({x0 + width / 2:g}, "
                f"{y0 + depth / 2:g}) of the ground frame; check --up and --meters-per-unit"
            )
        every = scene.splats
        # The mean colour over all directions: from straight above no camera has looked.
        self.splats = replace(every, sh=every.sh[:, :1]).take(over)
        self.position, self.reach = position[over], reach[over]
        self.cover = splat_cover(self.splats, self.frame)
        self.level, share = level, 1.0
        if level is None:
            start = _start_radius(scene, grid)
            self.level, share = follow_ground(self.position, self.cover, grid, start)
        self.above = self.position[:, 2] - self.level(self.position[:, 0], self.position[:, 1])
        self.poor = None
        if level is None:
            self.poor = assumed_bed.PoorGround.of(
                scene, grid, self.above, self.position, self.cover, self.level
            )
        self.slab = SLAB
        if self.poor is not None:
            self.level, self.slab = self.poor.level, max(SLAB, self.poor.layer)
            self.above = self.position[:, 2] - self.level(*self.position[:, :2].T)
        solid = self.cover > 0
        self.near_bed = (np.abs(self.above) < self.slab) & solid
        ceiling = _ceiling(scene)
        x, y = grid.centres()
        level = self.level(*np.meshgrid(x[::8], y[::8]))
        self.top = float(level.max()) + ceiling
        self.floor = float(level.min()) - self.slab
        self.below_ceiling = self.above < ceiling
        floating = lonely(self.position, self.splats, self.frame, grid, self.top)
        self.below_ceiling &= ~floating | (self.above <= self.slab)
        self.overhead = self.below_ceiling & (self.above > self.slab)
        self.sweep = None
        # Generated scenes were not photographed; along a drive pictures take too long.
        photographed = scene.source is not None and scene.cameras and scene.pages is None
        found = kept_surface(scene, step) if photographed else None
        if photographed and self.poor is None:
            self.sweep = ground_sweep(scene, found)
        self.places = self.position if found is None else found.surface.position
        self.notes = ()
        if level.max() - level.min() > SLAB:
            self.notes = (
                f"the ground rises {level.max() - level.min():.2f} m within the map and was "
                f"followed on {share:.0%} of it",
            )

    def look(self, which, grid, from_below=False):
        """Return what the splats of the mask `which` show on a grid from above, or from below."""
        if not which.any():
            empty = np.zeros(grid.shape, np.float32)
            return Seen(empty, empty, np.zeros((*grid.shape, 3), np.float32))
        spacing, (ny, nx) = grid.spacing, grid.shape
        if from_below:
            eye = (*grid.origin, self.floor)
            axes, flip, sign = np.eye(3), slice(None), 1
        else:
            eye = (grid.origin[0], grid.origin[1] + grid.size[1], self.top)
            axes = np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1.0]])
            flip, sign = slice(None, None, -1), -1  # pictures begin in the north
        scale, pose = 1 / spacing, pose_at(axes, eye)
        camera = Camera(nx, ny, scale, scale, 0.0, 0.0, pose, orthographic=True)
        prepared = raster.prepare(self.splats.take(which))
        layers = raster.rasterize(prepared, self.frame.camera_in_capture(camera), near=0.0)
        height = eye[2] + sign * layers.depth * self.frame.meters_per_unit
        return Seen(height[flip], layers.alpha[flip], layers.color[flip])

    def over(self, grid):
        """Return the mask of the splats that reach over a grid."""
        inside = np.ones(len(self.position), bool)
        for axis in (0, 1):
            low, high = grid.origin[axis], grid.origin[axis] + grid.size[axis]
            inside &= self.position[:, axis] + self.reach > low
            inside &= self.position[:, axis] - self.reach < high
        return inside

    def soil(self, bed, classes, grid):
        """Return the bed with the grass taken off."""
        solid = np.where(self.near_bed, self.splats.opacity > 3 * FAINT, False)
        return bedding.soil_under_grass(bed, classes == GRASS, self.position, solid, grid)


def _start_radius(scene, grid):
    """Return how far from the map's middle the ground surely lies on the plane [m]."""
    if not scene.cameras:
        return max(grid.size) / 4
    foot = np.array([scene.ground_frame.to_ground(c.position)[:2] for c in scene.cameras])
    return float(max(1.0, np.median(np.linalg.norm(foot - foot.mean(axis=0), axis=1))))


def _ceiling(scene):
    if not scene.cameras:
        return CEILING_WITHOUT_CAMERAS
    heights = np.array([scene.ground_frame.to_ground(c.position)[2] for c in scene.cameras])
    # A camera that stands many times as high as usual is misplaced.
    usual = heights[heights <= STRAY * max(float(np.median(heights)), 0.0)]
    return float(usual.max(initial=0.0)) + CEILING_OVER_CAMERAS


def _floaters(cloud, seen, grid):
    """Return the mask of the splats near the bed that float over it, under it or stand on it."""
    known = seen.alpha > MIN_SEEN_ALPHA
    filled = bedding.inpaint(np.where(known, seen.height, 0), known, passes=10)
    middle = filters.median_filter(filled)
    width = max(3, round(bedding.OPENING_WIDTH / grid.spacing))
    opened = filters.grey_opening(middle, size=width)
    noise = bedding.local_noise(filled, known, grid.spacing)
    # Kerbs and steps: within a few cells of them either level is the ground.
    size = max(3, 2 * round(0.04 / grid.spacing) + 1)
    relief = filters.maximum_filter(opened, size) - filters.minimum_filter(opened, size)
    limit = np.maximum(NEAR_BED, 4 * noise) + relief
    row, column, inside = grid.cells(cloud.position[:, 0], cloud.position[:, 1])
    off = np.abs(cloud.position[:, 2] - opened[row, column]) > limit[row, column]
    return off & inside & cloud.near_bed & ~is_green(cloud.splats)


def _less_bias(above, below, bare, grid):
    """Return the ground's height moved, slowly over the map, to the middle of its splats.

    Of splats that overlap the upper ones hide the others: seen from above the ground lies higher
    than it is by about its noise, seen from below lower. The middle is where cameras see it. Only
    bare ground tells: blades are no noise.
    """
    told = bare & (below.alpha > MIN_SEEN_ALPHA)
    thick = np.where(told, above.height - below.height, 0)
    usual = 2 * max(np.median(thick[told]), 0.0) if told.any() else 0.0
    edge = thick > bedding.STEP_RELIEF + usual
    edge = ndimage.binary_propagation(edge, mask=thick > EDGE_THICKNESS + usual)
    told &= ~edge
    shift = np.where(told, -thick / 2, 0)
    shift = np.clip(shift, -LARGEST_SHIFT, LARGEST_SHIFT).astype(np.float32)
    width = SHIFT_WIDTH / grid.spacing
    share = np.maximum(bedding.blur(told.astype(np.float32), width), 1e-3)
    height = above.height + bedding.blur(shift, width) / share
    if edge.any() and told.any():
        # Both levels of a step cover these cells; its edge lies halfway.
        away, nearest = ndimage.distance_transform_edt(~told, return_indices=True)
        edge &= away < max(EDGE_WIDTH / grid.spacing, 1.5)
        height = np.where(edge, height[tuple(nearest)], height)
    return height


def _bed(seen, below, grid, level, sweep=None):
    """Return bed, source, noise, colour and excess green from a look at the ground."""
    known = seen.alpha > MIN_SEEN_ALPHA
    if not known.any():
        blank = np.zeros(grid.shape, np.float32)
        carried = level(*np.meshgrid(*grid.centres())).astype(np.float32)
        unknown = np.full(grid.shape, UNKNOWN, np.uint8)
        return carried, unknown, blank, np.zeros((*grid.shape, 3), np.float32), blank
    color = np.clip(seen.color / np.maximum(seen.alpha, 0.3)[..., None], 0, 1).astype(np.float32)
    source = np.where(known, MEASURED, UNKNOWN).astype(np.uint8)
    green = 2 * color[..., 1] - color[..., 0] - color[..., 2]
    green = filters.gaussian_filter(np.where(known, green, 0), 0.06 / grid.spacing)
    bare = known & (green < EXCESS_GREEN)
    height = np.where(known, _less_bias(seen, below, bare, grid), 0)
    swept = 0.0
    if sweep is not None:
        height, swept = sweep.heights(grid, height.astype(np.float32), bare)
    filled = bedding.inpaint(height, known)
    standing = bedding.objects(filled, known, green > EXCESS_GREEN, grid.spacing)
    # A hole that is all within known ground is where something stood: a table's foot, a pot.
    holes = ndimage.binary_fill_holes(known) & ~known
    labels, count = ndimage.label(holes)
    if count:
        small = np.bincount(labels.ravel()) * grid.cell_area < 1.0
        small[0] = False
        holes = small[labels]
    source[standing | holes] = INFERRED
    measured = known & ~standing
    if measured.any():
        filled = bedding.inpaint(np.where(measured, height, 0), measured)
    noise = bedding.local_noise(filled, measured, grid.spacing)
    noise = np.maximum(noise, SWEPT_NOISE * swept)
    bed = bedding.smooth(filled, noise, grid.spacing)
    if bare.any() and not bare.all():
        # Blades must not raise the rim of the paving beside them: it would dam puddles.
        nearest = ndimage.distance_transform_edt(~bare, return_distances=False, return_indices=True)
        alone = bedding.smooth(filled[tuple(nearest)], noise, grid.spacing)
        bed = np.where(bare, alone, bed)
    edges = bedding.steps(filters.median_filter(filled), noise, grid.spacing) & bare & measured
    if edges.any():
        bed = bedding.straighten(bed, edges, grid.spacing)
    return bed, source, noise, color, green


def _cover(upper, lower, bed, cell_area):
    """Return top and underside of what stands on or hangs over the bed."""
    top = np.where(upper.alpha > MIN_SEEN_ALPHA, filters.median_filter(upper.height), bed)
    standing = top > bed + OCCLUDER_HEIGHT
    standing = remove_small_objects(standing, max_size=int(SMALLEST_TOP / cell_area))
    top = np.where(standing, top, bed)
    hanging = (lower.alpha > MIN_SEEN_ALPHA) & (lower.height > bed + GAP_HEIGHT) & (top > bed)
    underside = np.where(hanging, np.minimum(lower.height, top), bed)
    return top.astype(np.float32), underside.astype(np.float32)
