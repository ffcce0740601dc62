"""Classes of the ground: paving, soil, grass and low plants, or hidden below an object.

Green ground that is wide, or stands above the paving or is rough as blades are, is grass. Green on
level paving in patches and strips narrower than a stride is moss in the joints and fallen leaves:
it lies on paving, and a puddle's water does not leave through it.
"""

import numpy as np
from scipy import ndimage
from skimage.morphology import remove_small_objects

from rainsim.constants import SH_0
from rainsim.errors import InputError, shown
from rainsim.terrain import filters
from rainsim.terrain.bed import blur
from rainsim.terrain.map_size import MOST_CELLS
from rainsim.terrain.table import DRAIN, GRASS, HARD, OBJECT, SOIL, class_table
from rainsim.terrain.types import MEASURED, UNKNOWN, Grid

EXCESS_GREEN = 0.11  # 2 G - R - B above which ground is taken as green (Woebbecke et al. 1995)
SMALLEST_PATCH = 0.05  # m2 of lawn or paving that counts as such
MOSS_WIDTH = 0.32  # m: narrower green on the paving's own level is moss or leaves
MOSS_HEIGHT = 0.02  # m above the paving's level
LEVEL_WIDTH = 0.25  # m, standard deviation of the paving's level about a place
SOIL_ROUGHNESS = 2.5e-3  # m of noise; trodden paving has 0.5 to 1.5 mm
SOIL_BROWN = 0.10  # R - B of earth
SMALLEST_SOIL = 0.1  # m2
DRAIN_RADIUS = 0.16  # m about the middle of a grating that takes water
OBJECT_TOP = 0.10  # m above the bed
ROWS_AT_ONCE = 64  # of a mask
MASK_DISTANCE = 60.0  # 8-bit levels a painted colour may be off (soft brushes, palettes)


def is_green(splats):
    """Return the mask of the splats that are green as plants are."""
    color = 0.5 + SH_0 * splats.sh[:, 0]
    return 2 * color[:, 1] - color[:, 0] - color[:, 2] > EXCESS_GREEN


def classify(bed, top, source, noise, color, green, spacing):
    """Return the class of every cell, ndarray of shape (ny, nx), uint8.

    Bed and top are heights [m], `noise` is the bed's deviation [m]; `green` is the excess green,
    2 G - R - B, smoothed over a few cm.
    """
    unknown = source == UNKNOWN
    plants = (green > EXCESS_GREEN) | unknown
    plants = _tidy(plants, spacing)
    plants &= ~_moss(bed, plants, unknown, spacing)
    plants = _tidy(plants, spacing)
    classes = np.where(plants, GRASS, HARD).astype(np.uint8)
    classes[_soil(noise, color, source, plants, spacing)] = SOIL
    classes[unknown & (top > bed + OBJECT_TOP)] = OBJECT
    return classes


def mark_drains(classes, grid, scene):
    """Return the classes with the scene's drains in them."""
    if not scene.drains:
        return classes
    x, y, _ = scene.ground_frame.to_ground(np.array(scene.drains)).T
    middle_x, middle_y = grid.centres()
    away = np.hypot(middle_x[None, :, None] - x, middle_y[:, None, None] - y)
    return np.where((away < DRAIN_RADIUS).any(axis=-1), DRAIN, classes).astype(np.uint8)


def _moss(bed, plants, unknown, spacing):
    """Return the mask of the green that lies on paving, in the paving's own level.

    It is moss or leaves if it is narrow, and also at the rim of a lawn that stands up: there the
    lawn begins where its blades do.
    """
    hard = ~plants
    if not hard.any():
        return np.zeros_like(plants)
    most = MOSS_WIDTH / spacing
    away = filters.distance(plants, most) * spacing
    # Closing by distances: a disc, and quick at any radius.
    closed = filters.distance(away <= MOSS_WIDTH / 2, most / 2) * spacing > MOSS_WIDTH / 2
    level, near = _mean_near(bed, hard, spacing)
    lawn, _ = _mean_near(bed, plants & ~unknown & (away > MOSS_WIDTH / 2), spacing)
    rim = (away <= MOSS_WIDTH) & (lawn - level > 2 * MOSS_HEIGHT)
    return (closed | rim) & (bed - level < MOSS_HEIGHT) & near & plants & ~unknown


def _mean_near(values, mask, spacing):
    """Return the mean of the masked values near each cell, and where there are any."""
    weight = mask.astype(np.float32)
    share = blur(weight, LEVEL_WIDTH / spacing)
    mean = blur(values * weight, LEVEL_WIDTH / spacing)
    return mean / np.maximum(share, 1e-6), share > 1e-3


def _soil(noise, color, source, plants, spacing):
    """Return the mask of rough brown ground."""
    brown = filters.gaussian_filter(color[..., 0] - color[..., 2], 0.06 / spacing) > SOIL_BROWN
    rough = (noise > SOIL_ROUGHNESS) & brown & ~plants & (source == MEASURED)
    rough = ndimage.binary_opening(rough, iterations=max(1, round(0.05 / spacing)))
    return remove_small_objects(rough, max_size=int(SMALLEST_SOIL / spacing**2))


def _tidy(grass, spacing):
    """Return the mask without specks: a stone in a lawn is no paving."""
    iterations = max(1, round(0.03 / spacing))
    grass = ndimage.binary_opening(grass, iterations=iterations) | (grass & _edge(grass.shape, 8))
    cells = int(SMALLEST_PATCH / spacing**2)
    grass = remove_small_objects(grass, max_size=cells)
    return ~remove_small_objects(~grass, max_size=cells)


def _edge(shape, width):
    mask = np.ones(shape, bool)
    mask[width:-width, width:-width] = False
    return mask


def read_mask(path):
    """Return the classes painted in a picture aligned with the height map, -1 where none is.

    The colours are those of rainsim/config/classes.toml, as the class map has them; black and
    transparent
    pixels leave the class to the program. North is at the top of the picture; row 0 of the result
    is in the south.
    """
    from rainsim.io import images

    picture = images.read_image(path, MOST_CELLS)
    if picture.ndim != 3 or picture.shape[2] not in (3, 4) or picture.dtype != np.uint8:
        raise InputError(f"{path} is no 8-bit colour picture; a class mask must be; save it as PNG")
    found = np.empty(picture.shape[:2], np.int16)
    for start in range(0, len(picture), ROWS_AT_ONCE):
        part = slice(start, start + ROWS_AT_ONCE)
        found[part] = _painted_classes(path, picture[part], start)
    return np.ascontiguousarray(found[::-1])


def painted_mask(painted, grid):
    """Return a class mask of the cells of a `Grid` from `PaintedClasses`, -1 where none is.

    InputError if a painted class has a name that this version does not know.
    """
    names = class_table().names
    strange = [name for name in painted.name if name not in names]
    if strange:
        raise InputError(
            f"the scene has painted classes named {shown(strange[0])}; a class must be one of "
            f"{', '.join(names)}; paint them again"
        )
    codes = np.array([*(names.index(name) for name in painted.name), -1], np.int16)
    source = Grid(painted.cells.shape, painted.origin, painted.spacing)
    x, y = grid.centres()
    rows, columns, inside = source.cells(x[None, :], y[:, None])
    found = codes[painted.cells[rows, columns]]
    return np.where(inside, found, np.int16(-1))


def _painted_classes(path, picture, first_row):
    """Return the classes of some rows of a mask, -1 where none is painted."""
    table = class_table()
    pixels = picture[..., :3].astype(np.float32)
    blank = (pixels < 16).all(axis=-1)
    if picture.shape[2] == 4:
        blank |= picture[..., 3] < 128
    away = np.linalg.norm(pixels[..., None, :] - table.colors.astype(np.float32), axis=-1)
    strange = ~blank & (away.min(axis=-1) > MASK_DISTANCE)
    if strange.any():
        row, column = np.argwhere(strange)[0]
        colors = ", ".join(
            f"{name} {tuple(int(v) for v in color)}"
            for name, color in zip(table.names, table.colors, strict=True)
        )
        raise InputError(
            f"{path}: pixel ({column}, {first_row + row}) has the colour "
            f"{tuple(int(v) for v in pixels[row, column])}; a class mask has {colors}, or black "
            "for what is left to the program; repaint it"
        )
    return np.where(blank, -1, away.argmin(axis=-1)).astype(np.int16)
