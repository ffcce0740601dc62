"""From splats to `Terrain`: three orthographic splattings, tile by tile.

What lies near the bed, seen from above, gives the ground even under a table; everything below the
ceiling, seen from above, gives the tops of occluders; the same seen from below their undersides.
"""

from dataclasses import replace

import numpy as np
from scipy import ndimage
from skimage.morphology import remove_small_objects

from rainsim.errors import GroundError, ParameterError
from rainsim.lod.held_parts import scene_over
from rainsim.scene.ground import STRAY
from rainsim.surface.kept_surface import STEPS as SURFACE_STEPS
from rainsim.surface.kept_surface import kept_surface
from rainsim.surface.sweep import GroundSweep, can_tell
from rainsim.terrain import assumed_bed, filters, types
from rainsim.terrain import bed as bedding
from rainsim.terrain.classify import EXCESS_GREEN, classify, is_green, mark_drains, painted_mask
from rainsim.terrain.map_size import choose_grid
from rainsim.terrain.pictures import Seen, seen_straight
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
    step = _steps(tell, notes, SURFACE_STEPS + len(parts) + 2)
    cloud = _Cloud(scene, grid, step=step)
    step(SURFACE_STEPS + 1)
    maps = _empty_maps(grid)
    left_out = np.zeros(len(cloud.position), bool)
    for core, inner, cells, part in parts:
        found, off = _arrays(scene, cloud, part, None if mask is None else mask[cells])
        left_out |= off
        for name, values in found.items():
            maps[name][core] = values[inner]
        step()
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
    places = _places(scene)
    if not _reaching(*places, grid).any():
        return None
    return _arrays(scene, _Cloud(scene, grid, level, places), grid, mask)[0]


def _places(scene):
    """Return places (n, 3) and reaches (n,) of splats in the ground frame [m]."""
    frame = scene.ground_frame
    with np.errstate(invalid="ignore"):
        position = frame.to_ground(scene.splats.position)
        return position, 3 * scene.splats.scale.max(axis=1) * frame.meters_per_unit


def _reaching(position, reach, grid):
    """Return the mask of the splats that reach over a grid, see `_places`."""
    low, high = np.array(grid.origin), np.array(grid.origin) + grid.size
    with np.errstate(invalid="ignore"):
        after = position[:, :2] + reach[:, None] > low
        return (after & (position[:, :2] - reach[:, None] < high)).all(axis=1)


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


def pieces(grid, most=None):
    """Yield the parts in which a map is made, so that memory grows only with what is kept.

    Each overlaps its neighbours by a margin, wider than what cells know of each other. A part whose
    margins are wider than itself would cost more than it saves: else one has `most` cells. Each is
    the cells that it is for, slices in the whole map and in the part; all of its cells, slices in
    the whole map; and its `Grid`.
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
        yield tuple(core), tuple(inner), tuple(cells), part


def _empty_maps(grid):
    """Return the arrays of a `Terrain`, to be filled."""
    maps = {name: np.empty(grid.shape, np.float32) for name in ("bed", "top", "underside", "noise")}
    maps |= {name: np.empty(grid.shape, np.uint8) for name in ("source", "ground_class")}
    return maps | {"color": np.empty((*grid.shape, 3), np.float32)}


def _arrays(scene, cloud, grid, mask):
    """Return the arrays of a `Terrain` on a part of the map, and which splats were left out."""
    over = _reaching(cloud.position, cloud.reach, grid)
    near = cloud.near_bed & over
    off = np.zeros_like(near)
    if cloud.poor is not None:
        bed, source, noise, color, green = cloud.poor.bed(grid)
        bed, top, underside = cloud.poor.cover(cloud.places, grid, bed, cloud.top)
    else:
        ground = cloud.look(near, grid)
        if (ground.alpha > MIN_SEEN_ALPHA).any():
            off = _floaters(cloud, ground, grid) & near
        kept = near & ~off
        if off.any():
            ground = cloud.look(kept, grid)
        below = cloud.look(kept, grid, from_below=True)
        bed, source, noise, color, green = _bed(ground, below, grid, cloud.level, cloud.sweep)
        upper = cloud.look(cloud.below_ceiling & over, grid)
        lower = cloud.look(cloud.overhead & over, grid, from_below=True)
        top, underside = _cover(upper, lower, bed, grid.cell_area)
    classes = classify(bed, top, source, noise, color, green, grid.spacing)
    classes = mark_drains(classes, grid, scene)
    if mask is not None:
        classes = np.where(np.asarray(mask) >= 0, mask, classes).astype(np.uint8)
    bed = bedding.lower_rim(bed, classes == HARD, classes == GRASS, grid.spacing)
    # The soil under grass lies lower; what stands in the grass stands on it.
    soil = bed if cloud.poor is not None else cloud.soil(bed, classes, grid)
    lowered = soil < bed
    found = {
        "bed": soil,
        "top": np.where(lowered & (top == bed), soil, top),
        "underside": np.where(lowered & (underside == bed), soil, underside),
        "source": source,
        "ground_class": classes,
        "noise": noise,
        "color": color,
    }
    return found, off


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
        off = np.abs(terrain.layer).max()
        yield (
            f"PUDDLES ARE ASSUMED: the splats of the ground lie up to {off:.2g} m "
            "off it: its bed has an average road's roughness, settled stones, lower feet of walls"
        )
    names = class_table().names
    counted = [(np.mean(classes == code), name) for code, name in enumerate(names)]
    yield "classes: " + ", ".join(f"{name} {share:.0%}" for share, name in counted if share > 0)
    if mask is not None:
        yield f"{np.mean(np.asarray(mask) >= 0):.0%} of the classes given by the mask"
    if removed:
        yield f"{removed} splats near the bed left out: they float over it or stand on it"


class _Cloud:
    """The splats that lie over a map, as arrays in the ground frame.

    `level`, if given, says where the ground is, see `arrays_over`; else it is followed. `places`
    are those of `_places`, if they are known.
    `look` splats a part of them orthographically from above or from below; masks (`near_bed`,
    `below_ceiling`, `overhead`) tell which part.
    """

    def __init__(self, scene, grid, level=None, places=None, step=lambda: None):
        self.frame = scene.ground_frame
        position, reach = _places(scene) if places is None else places
        over = _reaching(position, reach, grid)
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
        ground = self.level(*np.meshgrid(x[::8], y[::8]))
        self.top = float(ground.max()) + ceiling
        self.floor = float(ground.min()) - self.slab
        self.below_ceiling = self.above < ceiling
        floating = lonely(self.position, self.splats, self.frame, grid, self.top)
        self.below_ceiling &= ~floating | (self.above <= self.slab)
        self.overhead = self.below_ceiling & (self.above > self.slab)
        self.sweep = None
        # Few pictures may show a leg of a drive, and what they show takes long to find.
        told = is_photographed(scene) and (level is None or can_tell(scene, grid, self.floor))
        found = kept_surface(scene, step) if told else None
        if found is not None and self.poor is None:
            self.sweep = GroundSweep(scene, found.surface)
        self.places = self.position if found is None else found.surface.position
        self.notes = ()
        if ground.max() - ground.min() > SLAB:
            self.notes = (
                f"the ground rises {ground.max() - ground.min():.2f} m within the map and was "
                f"followed on {share:.0%} of it",
            )

    def look(self, which, grid, from_below=False):
        """Return what the splats of the mask `which` show on a grid from above, or from below."""
        if not which.any():
            empty = np.zeros(grid.shape, np.float32)
            return Seen(empty, empty, np.zeros((*grid.shape, 3), np.float32))
        height = self.floor if from_below else self.top
        return seen_straight(self.splats.take(which), self.frame, grid, height, from_below)

    def soil(self, bed, classes, grid):
        """Return the bed with the grass taken off."""
        solid = np.where(self.near_bed, self.splats.opacity > 3 * FAINT, False)
        return bedding.soil_under_grass(bed, classes == GRASS, self.position, solid, grid)


def is_photographed(scene):
    """Tell whether cameras show the surface of a capture that is held whole, or of such a part."""
    return scene.source is not None and bool(scene.cameras) and scene.pages is None


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
