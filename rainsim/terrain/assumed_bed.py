"""The bed of ground that the capture does not know to the centimetre: a plane with a roughness.

Where few pictures overlap, splats of the ground are sheets before the cameras, some decimetres off.
The hollows among them are noise, and no water stands in them. What is known is that there is
ground, about how high, and of which colour. Its unevenness is assumed to be that of average roads.
"""

import numpy as np
from scipy import ndimage

from rainsim import raster
from rainsim.numerics.blocks import beside, of_each
from rainsim.scene.cameras import resize_to
from rainsim.terrain import bed as bedding
from rainsim.terrain import filters
from rainsim.terrain.pictures import seen_points
from rainsim.terrain.types import INFERRED, UNKNOWN, Grid

WINDOW = 0.45  # of the cameras' height about the level, within which splats tell the scatter
POOR = 0.06  # of the cameras' height: root mean square from which on the ground is not known
CELL = 1.0  # m, in which the splats below the level are gathered
LEAST_COVER = 0.05  # of a cell by such splats, for it to count
CARRIED = 4.0  # m over the ground: higher cameras fly
SMOOTH = 3.0  # m, standard deviation of the smoothing of a level that is seen from the air
# Cameras' heights: how far along a path its cameras tell the ground's height; the first that does.
ALONG = 5.0, 2.5
FEWEST, SLOW = 6, 0.5  # cameras of a path; share of their rise that may differ from one to the next
AT_ONCE = 8192  # places, for memory
# How far from the bed splats lie that show it, in times their scatter: near things, and elsewhere;
# in heights of the cameras: at most, and where they went, for nothing but haze hangs there.
NEAR, LAYER, MOST, WENT = 1.0, 2.5, 0.5, 1.0
BESIDE = 0.3  # m about things, that is near them
# Cameras' heights: longest step from camera to camera; half of the width of a path, and of what a
# walker needs beside a parked car.
STEP, WIDE, WALKER = 4.0, 0.5, 0.4
CLUMP = 0.3  # m2, up to which what seems to stand on a path is haze
PICTURES, WIDTH = 48, 240  # of a capture, that are laid on the ground, at most; px
DRAWN = 8  # pictures that are drawn before they are laid
FARTHEST = 20.0  # cameras' heights to the ground that they show
PATCH = 0.1  # m, cells of the ground's colours
SPREADS, LEAST_SEEN = (0.0, 0.15, 0.5, 1.5, 4.0), 0.02  # m about seen cells; share of them
THICK = 0.06  # m about the places of things, that they fill
FRONT = 7.0  # m, length of the front of a house, at least; clumps of haze are shorter
# Layers over the bed up to which sheets of it lie; of them, how many splats are over that at most
# where nothing stands.
SHEETS, FEW = 2.0, 0.1
STANDS = 0.5  # m over the layer of the ground, up to which what begins there stands on it
# Power spectral density of the height of a road along a line, G (n / N0)^-2 [m3] at n waves per
# metre: ISO 8608:2016, class C ("average"), geometric mean of its range.
DENSITY, N0 = 256e-6, 0.1  # m3, 1/m
WAVES = 4.0, 2.0, 1.0  # m, the octaves that are drawn; longer ones are slopes
OCTAVE = 2**0.5 - 2**-0.5  # integral of n^-2 over an octave about n, times n
# ASSUMED: where stones and slabs have settled, hollows under the upper sixth of random waves. They
# are so deep that bed and hollows hold 2.2, 1.6, 1.1, 0.55 and 0.2 mm of rain at slopes S of 0.1,
# 0.25, 0.5, 1 and 2 %. Kidd (1978; EPA SWMM reference manual I) found 0.77 mm S^-0.49 on paved
# catchments; less 0.3 mm in dips finer than a cell that is 2.1, 1.2, 0.8, 0.5 and 0.25 mm.
SETTLED_WAVE, SETTLED_ABOVE, SETTLED = 1.5, 1.0, 0.018  # m; standard deviations; m for one
# ASSUMED: how much lower ground is along kerbs, walls and posts, and within which distance.
FOOT_DROP, FOOT_WIDTH = 8e-3, 0.3  # m
# Variance of the random coefficients over that of an octave: splines spread a part of it to longer
# waves. The density is then met within 15 % from 0.2 to 0.6 waves per metre; shorter waves would
# draw hollows of a hand's width, which joints and stones decide and not the bed.
COEFFICIENTS = 20.0
DEVIATION = 0.48  # of splines whose random coefficients have 1


def scatter_of(above, position, cover, height):
    """Return how far the splats of the ground scatter about its level [m]; 0 if it is known.

    Nothing lies below the ground, so what is found there is scatter, and as much lies above it.
    The root mean square of the heights below it is taken by places, and their median counts.

    above : array (n,) [m]. Heights of splats over the level of the ground.
    position : array (n, 2 or 3) [m]
    cover : array (n,) [m2]
    height : float [m]. Of the cameras.
    """
    below = (above < 0) & (above > -WINDOW * height) & (cover > 0)
    if not below.any():
        return 0.0
    column, row = np.floor(position[below, :2] / CELL).astype(np.int64).T
    _, cell = np.unique(column * (np.ptp(row) + 1) + row, return_inverse=True)
    total = np.bincount(cell, cover[below])
    square = np.bincount(cell, cover[below] * above[below] ** 2)
    counted = total > LEAST_COVER * CELL**2
    if not counted.any():
        return 0.0
    found = float(np.median(np.sqrt(square[counted] / total[counted])))
    return found if found > POOR * height else 0.0


class PoorGround:
    """Ground of which a capture tells where it is and how it looks, but not its height.

    grid : Grid. Of the whole map.
    scatter : float [m]. See `scatter_of`.
    eyes : array (n, 3) [m]
    followed : callable. The level that is followed from cell to cell, see
        `slab.follow_ground`.
    level : callable. See `level_below`.
    layer : float [m]. How far from the bed most splats lie that show it.
    """

    def __init__(self, scene, grid, scatter, eyes, followed):
        self._scatter = scatter
        self._height = height = max(float(np.median(eyes[:, 2])), 0.1)
        self._reach = min(height, CARRIED)
        if height > CARRIED:  # from the air no camera was where things stand
            self.level, self._eyes = smooth_level(followed, grid), eyes[:0]
        else:
            self._eyes = eyes[np.abs(eyes[:, 2] - height) < WINDOW * height]  # others are misplaced
            self.level = level_below(self._eyes)
            self.level = _between(*_sampled(self.level, grid))
        self.layer = min(LAYER * scatter, MOST * self._reach)

        def colors():
            size = np.array(grid.shape[::-1]) * grid.spacing
            shape = tuple(int(n) for n in np.ceil(size / PATCH).astype(int)[::-1])
            patches = Grid(shape, grid.origin, PATCH)
            return patches, *filled(*laid_colors(scene, patches, self.level, self.layer, height))

        self._colors = beside(colors)  # while the surface is found

    @classmethod
    def of(cls, scene, grid, above, position, cover, followed):
        """Return the poor ground of a scene; None if it is well known, or without cameras.

        `followed` is the level that `slab.follow_ground` returns, `above` are the heights of the
        splats over that [m].
        """
        if not scene.cameras:
            return None
        eyes = np.array([scene.ground_frame.to_ground(c.position) for c in scene.cameras])
        height = np.clip(np.median(eyes[:, 2]), 0.1, CARRIED)
        scatter = scatter_of(above, position, cover, height)
        return cls(scene, grid, scatter, eyes, followed) if scatter else None

    def bed(self, grid):
        """Return what `bed_of` does, of a part of the map."""
        return bed_of(*self._colors(), grid, self.level)

    def cover(self, places, grid, bed, ceiling):
        """Return the bed, lower along what stands on it, and `cover` over it, all heights [m].

        `places` (n, 3) [m] are those on which cameras agree.
        """
        above = np.array(places)
        above[:, 2] -= self.level(*above[:, :2].T)
        went = path_of(self._eyes, grid, WALKER)
        top, low = cover(above, grid, self.layer, ceiling, went)
        label, count = ndimage.label(top > 0)
        none = np.bincount(label.ravel())[label] * grid.cell_area < CLUMP
        none &= path_of(self._eyes, grid)
        # What rises over the layer by less than the ground scatters is a part of the layer.
        none |= ndimage.maximum(top, label, range(count + 1))[label] < self.layer + self._scatter
        top[none] = low[none] = 0
        bed = bed - foot_drop((top > 0) & (low == 0), grid.spacing)
        return bed, bed + top, bed + low

    def layer_map(self, terrain, least):
        """Return what `layer_map` does, negative at fronts; what is over `least` [m] stands."""
        grid, stands = terrain.grid, terrain.top - terrain.bed > least
        went = path_of(self._eyes, grid)
        layer = layer_map(stands, went, grid.spacing, self._scatter, self._reach)
        wide = stands & (terrain.underside <= terrain.bed)
        wide = ndimage.binary_dilation(wide, iterations=max(1, round(THICK / grid.spacing)))
        label, _ = ndimage.label(wide)
        sides = [[part.stop - part.start for part in box] for box in ndimage.find_objects(label)]
        front = np.array([False, *(np.hypot(*side) * grid.spacing > FRONT for side in sides)])
        return np.where(front[label], -layer, layer)


def level_below(eyes):
    """Return the level of the ground [m] as a function of arrays of x and y.

    Where cameras rise and fall slowly along their path, as on a walk, the ground does below them.
    Where they do so from one to the next, somebody held them high and low, and it is a plane.

    eyes : array (n, 3) [m]
    """
    usual = float(np.median(eyes[:, 2])) if len(eyes) else 1.0
    rise = eyes[:, 2] - eyes[:, 2].mean() if len(eyes) else eyes[:, 2]

    def mean(x, y, along, but_self=0.0):
        x, y = np.ravel(x), np.ravel(y)
        found = np.empty(len(x))
        for first in range(0, len(x), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            square = (x[part, None] - eyes[:, 0]) ** 2 + (y[part, None] - eyes[:, 1]) ** 2
            square /= 2 * (along * usual) ** 2
            weight = np.exp(square.min(axis=1, keepdims=True) - square)
            weight[square == 0] *= 1 - but_self
            found[part] = weight @ rise / np.maximum(weight.sum(axis=1), 1e-12)
        return found

    for along in ALONG if len(eyes) >= FEWEST and usual > 0 else ():
        left = rise - mean(eyes[:, 0], eyes[:, 1], along, 1.0)
        if np.std(left) < SLOW * np.std(rise):
            return lambda x, y, along=along: mean(x, y, along)
    return lambda x, y: np.zeros(np.size(x))


def laid_colors(scene, grid, level, layer, height):
    """Return the colours of the ground in the cameras' pictures, (ny, nx, 3), and where it is seen.

    Each pixel that shows it is laid where its ray meets the level. Near pixels count more, by the
    square of their distance.

    level : callable. See `level_below`.
    layer : float [m]. How far from the bed the splats lie that show it.
    height : float [m]. Of the cameras.
    """
    frame, total = scene.ground_frame, np.zeros((4, grid.shape[0] * grid.shape[1]))
    near, drawn = 0.05 / frame.meters_per_unit, raster.Rasterizer(raster.prepare(scene.splats))

    def laid(camera, layers):
        view = frame.camera_in_ground(camera)
        place, distance = seen_points(view, layers.depth * frame.meters_per_unit)
        with np.errstate(all="ignore"):
            down = (view.position[2] - place[..., 2]) / distance
            above = place[..., 2] - level(place[..., 0], place[..., 1]).reshape(distance.shape)
            # The way along the ray to the plane at the level below the camera.
            floor = float(level(*view.position[:2, None])[0])
            way = (view.position[2] - floor) / down / distance
            hit = view.position + way[..., None] * (place - view.position)
            far = way * distance
        ground = (layers.alpha > 0.5) & (above < layer) & (down > 0) & (far < FARTHEST * height)
        row, column, inside = grid.cells(hit[ground][:, 0], hit[ground][:, 1])
        cell = (row * grid.shape[1] + column)[inside]
        weight = 1 / np.maximum(far[ground][inside], 0.3) ** 2
        return cell, np.stack([*(weight * layers.color[ground][inside].T), weight])

    cameras = scene.cameras[:: max(1, -(-len(scene.cameras) // PICTURES))]
    for first in range(0, len(cameras), DRAWN):
        some = cameras[first : first + DRAWN]
        some = [resize_to(camera, min(WIDTH, camera.width)) for camera in some]
        parts = of_each(laid, some, [drawn.draw(camera, near) for camera in some])
        cell, values = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
        for channel, value in zip(total, values, strict=True):
            channel += np.bincount(cell, value, len(channel))
    seen = total[3] > 0
    color = np.where(seen, total[:3] / np.where(seen, total[3], 1), 0).astype(np.float32)
    return np.ascontiguousarray(color.T).reshape(*grid.shape, 3), seen.reshape(grid.shape)


def filled(color, seen):
    """Return colours of all patches of ground (ny, nx, 3), and which are known (ny, nx).

    A patch that no picture shows has the colour of what is near, within the least of SPREADS that
    shows enough.
    """
    found, known = np.zeros_like(color), np.zeros(seen.shape, bool)
    for spread in SPREADS:
        share = bedding.blur(seen.astype(np.float32), spread / PATCH) if spread else seen
        new = (share > LEAST_SEEN) & ~known
        for c in range(3):
            channel = np.where(seen, color[..., c], 0).astype(np.float32)
            channel = bedding.blur(channel, spread / PATCH) if spread else channel
            found[new, c] = channel[new] / share[new]
        known |= new
    soft = [ndimage.gaussian_filter(found[..., c], 1) for c in range(3)]
    return np.clip(np.stack(soft, -1), 0, 1), known


def smooth_level(followed, grid):
    """Return a level that is followed from the air without its noise, as `level_below` does.

    It has no hollows: those of dry ground are a puddle's, and nobody knows them to the centimetre.
    """
    from skimage.morphology import reconstruction  # .1 s, and few captures are from the air

    height, coarse = _sampled(followed, grid)
    height = ndimage.gaussian_filter(height, SMOOTH / CELL)
    rim = np.pad(np.full(np.array(height.shape) - 2, height.max()), 1, constant_values=-np.inf)
    return _between(reconstruction(np.maximum(rim, height), height, "erosion"), coarse)


def _sampled(level, grid):
    """Return heights of a level over a grid, on a lattice of CELL, and x and y of the lattice."""
    coarse = [np.arange(grid.origin[k], grid.origin[k] + grid.size[k] + CELL, CELL) for k in (0, 1)]
    x, y = np.meshgrid(*coarse)
    return level(x, y).reshape(x.shape), coarse


def _between(height, coarse):
    """Return the level between the heights of a lattice, a function of arrays of x and y."""

    def level(x, y):
        place = [(np.ravel(y) - coarse[1][0]) / CELL, (np.ravel(x) - coarse[0][0]) / CELL]
        return ndimage.map_coordinates(height, place, order=1, mode="nearest")

    return level


def bed_of(patches, color, known, grid, level):
    """Return bed [m], source, noise [m], colour and excess green of ground that is poorly known.

    patches : Grid. Of the colours.
    color, known : ndarray. See `filled`.
    level : callable. See `level_below`.
    """
    x, y = grid.centres()
    row, column = (
        np.clip(((values - first) / PATCH).astype(int), 0, n - 1)
        for values, first, n in zip((y, x), patches.origin[::-1], known.shape, strict=True)
    )
    color, known = color[np.ix_(row, column)], known[np.ix_(row, column)]
    green = 2 * color[..., 1] - color[..., 0] - color[..., 2]
    heights = level(*np.meshgrid(x, y)).reshape(grid.shape)
    bed = (heights + roughness(grid) - settled(grid)).astype(np.float32)
    source = np.where(known, INFERRED, UNKNOWN).astype(np.uint8)
    return bed, source, np.zeros(grid.shape, np.float32), color, green


def path_of(eyes, grid, wide=WIDE):
    """Return where cameras went, bool (ny, nx): nothing stands there, whatever splats look like.

    From each camera the way to the next two counts, as far as they are near. `eyes` (n, 3) [m] are
    the places of cameras that are not misplaced; half of the way is `wide` times their height.
    """
    went = np.zeros(grid.shape, bool)
    if not len(eyes):
        return went
    height, foot = float(np.median(eyes[:, 2])), eyes[:, :2]
    away = np.linalg.norm(foot[:, None] - foot, axis=-1)
    for n, near in enumerate(np.argsort(away, axis=1)[:, :3]):
        for other in near:
            if away[n, other] <= STEP * height:
                steps = max(2, int(2 * away[n, other] / grid.spacing))
                way = foot[n] + np.linspace(0, 1, steps)[:, None] * (foot[other] - foot[n])
                row, column, inside = grid.cells(*way.T)
                went[row[inside], column[inside]] = True
    if not went.any():
        return went
    most = wide * height
    return filters.distance(~went, most / grid.spacing) * grid.spacing < most


def cover(places, grid, layer, ceiling, went):
    """Return top and underside over the bed [m] of what is on or over poorly known ground.

    places : array (n, 3) [m]. Of surfaces on which cameras agree, with heights
        over the level: splats before few cameras look like things.
    layer : float [m]. How far from the bed the splats lie that show it.
    ceiling : float [m]. What is higher was hardly seen.
    went : bool array (ny, nx). See `path_of`.
    """
    row, column, inside = grid.cells(places[:, 0], places[:, 1])
    inside &= (places[:, 2] > layer) & (places[:, 2] < ceiling) & ~went[row, column]
    row, column, height = row[inside], column[inside], places[inside, 2].astype(np.float32)
    top, low = np.full(grid.shape, -np.inf, np.float32), np.full(grid.shape, np.inf, np.float32)
    np.maximum.at(top, (row, column), height)
    np.minimum.at(low, (row, column), height)
    size = 2 * max(1, round(THICK / grid.spacing)) + 1
    top, low = ndimage.maximum_filter(top, size), ndimage.minimum_filter(low, size)
    there = np.isfinite(top)
    low = np.where(low < layer + STANDS, 0, low)
    return np.where(there, top, 0), np.where(there, np.minimum(low, top), 0)


def layer_map(stands, went, spacing, scatter, height):
    """Return how far from the bed splats lie that show it, (ny, nx) float32 [m].

    stands, went : bool array (ny, nx). Where things stand, and where cameras
        went.
    spacing : float [m]
    scatter : float [m]. See `scatter_of`.
    height : float [m]. Of the cameras.
    """
    width = BESIDE / spacing
    near = np.clip(4 * bedding.blur(stands.astype(np.float32), width), 0, 1)
    free = (1 - near) * np.clip(4 * bedding.blur(went.astype(np.float32), width) - 3, 0, 1)
    layer = np.minimum(scatter * (LAYER + near * (NEAR - LAYER)), MOST * height)
    return (layer + free * (WENT * height - layer)).astype(np.float32)


def foot_drop(stands, spacing):
    """Return how much lower [m] the bed is along what `stands` (ny, nx), bool, on it, float32."""
    if not stands.any():
        return np.zeros(stands.shape, np.float32)
    away = filters.distance(~stands, FOOT_WIDTH / spacing).astype(np.float32) * np.float32(spacing)
    return np.float32(FOOT_DROP) * np.clip(1 - away / np.float32(FOOT_WIDTH), 0, 1)


def roughness(grid, seed=0):
    """Return the heights [m] of an average road over a grid, ndarray of shape (ny, nx), float32.

    They depend on the place alone, not on the grid: octaves of cubic splines whose coefficients are
    random numbers on lattices through the origin. Under a straightedge of 3 m gaps are some 6 mm.
    """
    height = np.zeros(grid.shape, np.float32)
    for octave, wave in enumerate(WAVES):
        variance = COEFFICIENTS * DENSITY * N0**2 * wave * OCTAVE
        height += np.sqrt(np.float32(variance)) * _waves(grid, wave, 97 * seed + octave)
    return height


def settled(grid):
    """Return how deep stones have settled [m] over a grid, by the place alone, (ny, nx) float32."""
    waves = _waves(grid, SETTLED_WAVE, len(WAVES)) / np.float32(DEVIATION)
    return np.float32(SETTLED) * np.maximum(waves - np.float32(SETTLED_ABOVE), 0)


def _waves(grid, wave, seed):
    """Return cubic splines over a grid of random numbers on a lattice of half a `wave` [m]."""
    x, y = grid.centres()
    columns, across = _spline(2 * x / wave)
    rows, down = _spline(2 * y / wave)
    return down @ _normal(rows[:, None], columns[None, :], seed) @ across.T


def _spline(place):
    """Return the lattice points that bear on places (n,), and their weights (n, points)."""
    first = np.floor(place).astype(np.int64)
    t = place - first
    lattice = np.arange(first.min() - 1, first.max() + 3)
    weights = np.zeros((len(place), len(lattice)), np.float32)
    row, column = np.arange(len(place)), first - lattice[0]
    parts = (1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3
    for k, part in enumerate(parts):
        weights[row, column - 1 + k] = part / 6
    return lattice, weights


def _normal(row, column, seed):
    """Return a random number of mean 0 and variance 1 for each lattice point, float32."""
    with np.errstate(over="ignore"):
        h = row.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        h = (h ^ (h >> np.uint64(29))) + column.astype(np.uint64) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(32))) * np.uint64(0x94D049BB133111EB + 2 * seed)
        h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    # The sum of four uniform numbers of 16 bits is nearly normal.
    parts = sum(((h >> np.uint64(16 * k)) & np.uint64(0xFFFF)).astype(np.float32) for k in range(4))
    return (parts / np.float32(65536) - np.float32(2)) * np.float32(3**0.5)


def open_sheets(terrain, position):
    """Return which splats show poor ground where nothing stands, bool (n,).

    They lie about the bed, and few are over them. `position` (n, 3) [m] is that of all splats.
    """
    if not terrain.layer.size:
        return np.zeros(len(position), bool)
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(position).all(axis=1)
    grid = terrain.grid
    row, column, _ = grid.cells(*np.where(finite[:, None], position, 0)[:, :2].T)
    over = position[:, 2] - terrain.bed[row, column] - SHEETS * np.abs(terrain.layer[row, column])
    low, rises = finite & (over < 0), finite & (over >= 0) & (over < STANDS)
    side = max(1, round(BESIDE / grid.spacing))
    wide = grid.shape[1] // side + 1
    cell = (row // side) * wide + column // side
    size = (grid.shape[0] // side + 1) * wide
    few = np.bincount(cell[rises], minlength=size) < FEW * np.bincount(cell[low], minlength=size)
    return low & few[cell]
