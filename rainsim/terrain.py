"""Terrain from splats: the ground, what stands on it or hangs over it, and what it is made of.

Three orthographic splattings do it. A slab near the ground plane, seen from above, gives the ground
even under a table; everything below the ceiling, seen from above, gives the tops of occluders; the
same seen from below gives their undersides.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage
from skimage.morphology import remove_small_objects

from rainsim import raster
from rainsim.errors import GroundError, InputError
from rainsim.scene.types import Camera

UNKNOWN, INFERRED, MEASURED = 0, 1, 2  # values of Terrain.source
HARD, GRASS = 0, 1  # values of Terrain.ground_class

MIN_SEEN_ALPHA = 0.5  # of a cell from above: less and the surface is not told
OBJECT_HEIGHT = 0.02  # m above the opened ground: a leg, a pot, a ball, not the ground
OPENING_WIDTH = 0.5  # m: wider things that stand in the slab are taken as ground
OCCLUDER_HEIGHT = 0.10  # m above the ground from which something shelters it
GAP_HEIGHT = 0.15  # m between ground and underside that rain can be blown into
CEILING_OVER_CAMERAS = 1.0  # m: what is higher was hardly seen by any camera
CEILING_WITHOUT_CAMERAS = 4.0  # m above the ground
EXCESS_GREEN = 0.11  # 2 G - R - B above which ground is taken as grass (Woebbecke et al. 1995)
SMALLEST_PATCH = 0.05  # m2 of lawn or paving that counts as such
SMOOTHING = 0.04  # m, standard deviation; looked best of eight filters on a captured patio
STEP_RELIEF = 0.03  # m within 10 cm: a kerb or a step, kept sharp
DEFAULT_HALF_WIDTH = 4.0  # m, of the map, unless the cameras roam farther
LARGEST_HALF_WIDTH = 10.0  # m
CAMERA_REACH = 1.5  # half widths of the map per camera's distance from its centre


@dataclass(frozen=True)
class Grid:
    """A raster on the ground: cell (j, i) spans spacing x spacing m, row 0 in the south (least y).

    Attributes
    ----------
    shape : tuple of int
        (ny, nx).
    origin : tuple of float [m]
        x, y of the outer corner of cell (0, 0) in the ground frame.
    spacing : float [m]
    """

    shape: tuple
    origin: tuple
    spacing: float

    @property
    def cell_area(self):
        """Area of a cell [m2]."""
        return self.spacing**2


@dataclass(frozen=True)
class Terrain:
    """Ground, cover and classes on a `Grid`.

    Attributes
    ----------
    grid : Grid
    bed : ndarray of shape (ny, nx), float32 [m]
        Height of the ground, smoothed at the scale of its noise.
    top : ndarray of shape (ny, nx), float32 [m]
        Highest surface; equals `bed` where nothing stands.
    underside : ndarray of shape (ny, nx), float32 [m]
        Lower side of what hangs over the ground; equals `bed` where it stands on it.
    source : ndarray of shape (ny, nx), uint8
        MEASURED, INFERRED (inpainted under an object) or UNKNOWN (nothing saw it).
    ground_class : ndarray of shape (ny, nx), uint8
        HARD or GRASS; unknown ground counts as grass: it takes up water and never mirrors.
    noise : ndarray of shape (ny, nx), float32 [m]
        Standard deviation of the measured ground about its trend.
    color : ndarray of shape (ny, nx, 3), float32
        Display-referred colour of the ground from above.
    notes : tuple of str
    """

    grid: Grid
    bed: np.ndarray
    top: np.ndarray
    underside: np.ndarray
    source: np.ndarray
    ground_class: np.ndarray
    noise: np.ndarray
    color: np.ndarray
    notes: tuple = ()

    @property
    def covered(self):
        """Mask of the ground cells that something hangs over."""
        return self.underside > self.bed + GAP_HEIGHT


def extract_terrain(scene, config):
    """Return the `Terrain` of a scene.

    Parameters
    ----------
    scene : Scene
    config : TerrainConfig
        spacing [m], extent (half width [m] or None) and slab (half thickness [m]).

    Raises
    ------
    GroundError
        If hardly any ground is seen within the map.
    """
    frame = scene.ground_frame
    grid, notes = choose_grid(scene, config)
    prepared = raster.prepare(scene.splats)
    height = frame.to_ground(prepared.position)[:, 2]
    ceiling = _ceiling(scene)
    slab = raster.select(prepared, np.abs(height) < config.slab)
    ground = _from_above(slab, grid, frame, config.slab)
    below = raster.select(prepared, height < ceiling)
    upper = _from_above(below, grid, frame, ceiling)
    lower = _from_below(raster.select(below, height[height < ceiling] > config.slab), grid, frame,
                        config.slab)  # fmt: skip
    bed, source, noise, classes, color = _ground(ground, grid)
    if np.mean(source == MEASURED) < 0.02:
        raise GroundError(
            f"only {np.mean(source == MEASURED):.1%} of the map of "
            f"{grid.shape[1] * grid.spacing:g} m shows ground within {config.slab:g} m of the "
            "ground plane; give --up and --meters-per-unit, or --ground-frame"
        )
    top, underside = _cover(upper, lower, bed)
    notes += (
        f"ground measured {np.mean(source == MEASURED):.0%}, inferred "
        f"{np.mean(source == INFERRED):.0%}, unknown {np.mean(source == UNKNOWN):.0%}; grass "
        f"{np.mean(classes == GRASS):.0%}; noise of hard ground "
        f"{_median(noise[(classes == HARD) & (source == MEASURED)]) * 1e3:.2f} mm",
    )
    return Terrain(grid, bed, top, underside, source, classes, noise, color, notes)


def choose_grid(scene, config):
    """Return the `Grid` that the cameras' surroundings ask for, and notes that say why."""
    centre = np.zeros(2)
    half, why = DEFAULT_HALF_WIDTH, "the default"
    if scene.cameras:
        foot = np.array([scene.ground_frame.to_ground(c.position)[:2] for c in scene.cameras])
        centre = foot.mean(axis=0)
        reach = CAMERA_REACH * np.percentile(np.linalg.norm(foot - centre, axis=1), 90)
        if reach > half:
            half, why = min(reach, LARGEST_HALF_WIDTH), "the cameras' reach"
    if config.extent is not None:
        half, why = config.extent, "given"
    cells = max(8, round(2 * half / config.spacing))
    corner = centre - cells * config.spacing / 2
    grid = Grid((cells, cells), (float(corner[0]), float(corner[1])), config.spacing)
    size = cells * config.spacing
    return grid, (f"map of {size:g} x {size:g} m ({why}), {cells} x {cells} cells",)


def _ceiling(scene):
    if not scene.cameras:
        return CEILING_WITHOUT_CAMERAS
    heights = [scene.ground_frame.to_ground(c.position)[2] for c in scene.cameras]
    return max(heights) + CEILING_OVER_CAMERAS


def _orthographic(grid, axes, position):
    ny, nx = grid.shape
    matrix = np.eye(4)
    matrix[:3, :3] = axes
    matrix[:3, 3] = -np.asarray(axes) @ position
    scale = 1 / grid.spacing
    return Camera(nx, ny, scale, scale, 0.0, 0.0, matrix, orthographic=True)


def _from_above(splats, grid, frame, ceiling):
    """Return height, alpha and colour on `grid`, seen from `ceiling` downwards."""
    north = grid.origin[1] + grid.shape[0] * grid.spacing
    eye = (grid.origin[0], north, ceiling)
    camera = _orthographic(grid, ((1, 0, 0), (0, -1, 0), (0, 0, -1)), eye)
    layers = raster.rasterize(splats, frame.camera_in_capture(camera), near=0.0)
    height = ceiling - layers.depth * frame.meters_per_unit
    flip = slice(None, None, -1)  # pictures begin in the north, grids in the south
    return height[flip], layers.alpha[flip], layers.color[flip]


def _from_below(splats, grid, frame, floor):
    """Return height and alpha on `grid`, seen from `floor` upwards."""
    eye = (grid.origin[0], grid.origin[1], floor)
    camera = _orthographic(grid, np.eye(3), eye)
    layers = raster.rasterize(splats, frame.camera_in_capture(camera), near=0.0)
    return floor + layers.depth * frame.meters_per_unit, layers.alpha


def _ground(seen, grid):
    """Return bed, source, noise, class and colour of the ground from the slab's layers."""
    height, alpha, color = seen
    known = alpha > MIN_SEEN_ALPHA
    color = np.clip(color / np.maximum(alpha, 0.3)[..., None], 0, 1).astype(np.float32)
    source = np.where(known, MEASURED, UNKNOWN).astype(np.uint8)
    if not known.any():
        zero = np.zeros(grid.shape, np.float32)
        return zero, source, zero, np.full(grid.shape, GRASS, np.uint8), color
    filled = inpaint(np.where(known, height, 0), known)
    # What sticks out of the ground by more than an opening leaves is an object.
    width = max(3, round(OPENING_WIDTH / grid.spacing))
    opened = ndimage.grey_opening(ndimage.median_filter(filled, 3), size=(width, width))
    green = 2 * color[..., 1] - color[..., 0] - color[..., 2]
    grass = ~known | (ndimage.gaussian_filter(green, 0.06 / grid.spacing) > EXCESS_GREEN)
    standing = known & ~grass & (filled - opened > OBJECT_HEIGHT)
    standing = ndimage.binary_dilation(standing, iterations=2) & known & ~grass
    source[standing] = INFERRED
    measured = known & ~standing
    if measured.any():
        filled = inpaint(np.where(measured, height, 0), measured)
    noise = local_noise(filled, measured, grid.spacing)
    classes = np.where(_tidy(grass, grid.spacing), GRASS, HARD).astype(np.uint8)
    return _smooth(filled, grid.spacing), source, noise, classes, color


def _tidy(grass, spacing):
    """Return the mask without specks: moss in a joint is no lawn, a stone in it no paving."""
    iterations = max(1, round(0.03 / spacing))
    grass = ndimage.binary_opening(grass, iterations=iterations) | (grass & _edge(grass.shape, 8))
    cells = int(SMALLEST_PATCH / spacing**2)
    grass = remove_small_objects(grass, max_size=cells)
    return ~remove_small_objects(~grass, max_size=cells)


def _edge(shape, width):
    mask = np.ones(shape, bool)
    mask[width:-width, width:-width] = False
    return mask


def inpaint(values, known, passes=60):
    """Return `values` (ny, nx) with unknown cells filled smoothly from their known neighbours."""
    if known.all():
        return values.astype(np.float32)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = values[tuple(nearest)].astype(np.float32)
    for _ in range(passes):
        smooth = ndimage.uniform_filter(filled, 5)
        filled[~known] = smooth[~known]
    return filled


def local_noise(height, known, spacing):
    """Return the standard deviation [m] of `height` about its 5 cm trend, within about 15 cm."""
    weight = np.maximum(ndimage.gaussian_filter(known.astype(np.float32), 0.15 / spacing), 1e-3)
    trend = ndimage.gaussian_filter(height, 0.025 / spacing)
    square = np.where(known, (height - trend) ** 2, 0)
    variance = ndimage.gaussian_filter(square.astype(np.float32), 0.15 / spacing) / weight
    return np.sqrt(variance).astype(np.float32)


def _smooth(height, spacing):
    """Return `height` smoothed by a Gaussian, but only by a median at kerbs and steps."""
    median = ndimage.median_filter(height, 3)
    smooth = ndimage.gaussian_filter(median, SMOOTHING / spacing)
    size = max(3, 2 * round(0.05 / spacing) + 1)
    relief = ndimage.maximum_filter(median, size) - ndimage.minimum_filter(median, size)
    steep = ndimage.gaussian_filter((relief > STEP_RELIEF).astype(np.float32), 1.5)
    return (smooth + (median - smooth) * np.clip(2 * steep, 0, 1)).astype(np.float32)


def _cover(upper, lower, bed):
    """Return top and underside of what stands on or hangs over the bed."""
    top_height, top_alpha, _ = upper
    under_height, under_alpha = lower
    top = np.where(top_alpha > MIN_SEEN_ALPHA, ndimage.median_filter(top_height, 3), bed)
    top = np.where(top > bed + OCCLUDER_HEIGHT, top, bed)
    hanging = (under_alpha > MIN_SEEN_ALPHA) & (under_height > bed + GAP_HEIGHT) & (top > bed)
    underside = np.where(hanging, np.minimum(under_height, top), bed)
    return top.astype(np.float32), underside.astype(np.float32)


def _median(values):
    return float(np.median(values)) if values.size else float("nan")


def hillshade(height, spacing, exaggerate=4):
    """Return the brightness (0 to 1) of the surface `height` (ny, nx) lit from one side."""
    azimuth, elevation = np.radians(135), np.radians(35)
    dy, dx = np.gradient(height * exaggerate, spacing)
    light = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    shade = (np.sin(elevation) - light[0] * dx - light[1] * dy) / np.sqrt(1 + dx * dx + dy * dy)
    return np.clip(shade, 0, 1)


_ARRAYS = ("bed", "top", "underside", "source", "ground_class", "noise", "color")


def write_terrain(folder, terrain):
    """Write terrain.npz, bed.tif, top.tif (float32 metres) and hillshade.png into `folder`.

    Pictures and TIFFs have north (greatest y) at the top; arrays in the .npz have row 0 in the
    south. Returns the paths written.
    """
    from rainsim import image

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    arrays = {name: getattr(terrain, name) for name in _ARRAYS}
    grid = terrain.grid
    image.write_npz(
        folder / "terrain.npz", **arrays, origin=np.array(grid.origin), spacing=grid.spacing,
        notes=np.array(terrain.notes, dtype=np.str_),
    )  # fmt: skip
    image.write_tiff(folder / "bed.tif", terrain.bed[::-1])
    image.write_tiff(folder / "top.tif", terrain.top[::-1])
    shade = np.hstack([hillshade(terrain.bed, grid.spacing, exaggerate=8),
                       hillshade(terrain.top, grid.spacing, exaggerate=1)])  # fmt: skip
    picture = (shade[::-1] * 255 + 0.5).astype(np.uint8)
    image.write_png(folder / "hillshade.png", np.repeat(picture[..., None], 3, axis=2))
    return [folder / name for name in ("terrain.npz", "bed.tif", "top.tif", "hillshade.png")]


def read_terrain(folder):
    """Return the `Terrain` that `write_terrain` wrote into `folder` (or its .npz itself)."""
    path = Path(folder)
    path = path / "terrain.npz" if path.is_dir() else path
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = [data[name] for name in _ARRAYS]
            shape = arrays[0].shape
            grid = Grid(shape, tuple(map(float, data["origin"])), float(data["spacing"]))
            notes = tuple(map(str, data["notes"]))
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; `rainsim heightmap` writes it") from None
    except (KeyError, ValueError, OSError, EOFError) as error:
        raise InputError(f"{path} is no terrain of rainsim ({error}); write it anew") from error
    return Terrain(grid, *arrays, notes=notes)
