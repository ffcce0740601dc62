"""Pictures to look at: classes and puddles from above, the ground's grid through a camera."""

import math
from typing import NamedTuple

import numpy as np

from rainsim.errors import ParameterError
from rainsim.scene.cameras import resize_to
from rainsim.scene.types import Camera, pose_at
from rainsim.scene.view import pixel_rays
from rainsim.terrain.pond import without_images
from rainsim.terrain.table import class_table
from rainsim.terrain.types import UNKNOWN

FADE_DEPTHS = (0.8e-3, 2.8e-3, 20e-3)  # m of water: begins to show, shows fully, is darkest
WATER_LIGHT, WATER_DARK = np.array([0.35, 0.6, 0.95]), np.array([0.05, 0.15, 0.5])
GRID_STEP = 0.5  # m between the lines of the checking grid
ON_GROUND = 0.04  # m, and 1 % of the distance: what is nearer the bed counts as ground
CHECK_WIDTH = 960  # px


def hillshade(height, spacing, exaggerate=4):
    """Return the brightness, 0 to 1, of a height field lit from the north-west, 35 degrees up.

    Row 0 is in the south, also in the result. Heights and spacing are in metres; heights are taken
    `exaggerate` times; no shadow is cast.
    """
    azimuth, elevation = np.radians(135), np.radians(35)
    dy, dx = np.gradient(height * exaggerate, spacing)
    light = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    shade = (np.sin(elevation) - light[0] * dx - light[1] * dy) / np.sqrt(1 + dx * dx + dy * dy)
    return np.clip(shade, 0, 1)


def class_map(terrain):
    """Return the classes in the table's colours, (ny, nx, 3) uint8 with north at the top.

    Painted over, it is a mask for `rainsim heightmap --class-mask`.
    """
    return class_table().colors[terrain.ground_class][::-1]


def from_above(terrain):
    """Return the ground's colour with its relief shaded in, (ny, nx, 3) float, south first."""
    shade = hillshade(terrain.bed, terrain.grid.spacing, exaggerate=4)[..., None]
    picture = terrain.color * (0.55 + 0.8 * shade)
    picture[terrain.source == UNKNOWN] *= 0.4
    return picture


def puddle_overlay(terrain, depth):
    """Return the ground from above with `depth` [m] of water over it, uint8, north at the top."""
    return _bytes(_with_water(from_above(terrain), depth))[::-1]


def water_over(bed, spacing, depth):
    """Return a bed from above, grey, with `depth` [m] of water over it, uint8, north at the top.

    Cells of the bed that are NaN are black.
    """
    absent = np.isnan(bed)
    relief = max(float(np.nanmax(bed) - np.nanmin(bed)), 1e-3)
    steps = max(1.0, 0.3 * spacing * max(bed.shape) / relief)  # flat ground shows its shape, too
    shade = hillshade(np.where(absent, np.nanmean(bed), bed), spacing, exaggerate=min(steps, 20.0))
    picture = np.repeat((0.25 + 0.6 * shade)[..., None], 3, axis=2)
    picture = _with_water(picture, np.where(absent, 0.0, depth))
    picture[absent] = 0.0
    return _bytes(picture)[::-1]


def _with_water(picture, depth):
    """Return `picture` with water drawn over it; `depth` has the picture's shape."""
    low, high, deep = FADE_DEPTHS
    alpha = np.clip((depth - low) / (high - low), 0, 1)[..., None] * 0.8
    share = np.clip(depth / deep, 0, 1)[..., None]
    return picture + alpha * (WATER_LIGHT + (WATER_DARK - WATER_LIGHT) * share - picture)


def through_camera(scene, terrain, camera, depth=None):
    """Return a camera's picture with the ground's grid drawn over it, (height, width, 3) uint8.

    Lines every half metre lie on the bed where the camera sees ground (within 4 cm of it): where
    they bend or vanish on open ground the bed is wrong. The axes are red (x) and green (y). With a
    `depth` of water [m] (ny, nx) puddles are shown too.
    """
    from rainsim import raster

    camera = resize_to(camera, min(CHECK_WIDTH, camera.width))
    frame, grid = scene.ground_frame, terrain.grid
    scene = without_images(scene, terrain)
    layers = raster.rasterize(raster.prepare(scene.splats), camera, near=0.05)
    picture = np.clip(layers.color, 0, 1).astype(np.float64)
    view = frame.camera_in_ground(camera)
    points, distance = seen_points(view, layers.plane_depth * frame.meters_per_unit)
    row, column, inside = grid.cells(points[..., 0], points[..., 1])
    away = np.abs(points[..., 2] - terrain.bed[row, column])
    ground = inside & (layers.alpha > 0.5) & (away < ON_GROUND + 0.01 * distance)
    if depth is not None:
        picture = _with_water(picture, np.where(ground, depth[row, column], 0))
    thick = np.maximum(0.006, 1.2 * distance / view.fx)
    color = np.array([1.0, 0.95, 0.2])
    for axis, own in ((0, (0.2, 0.9, 0.2)), (1, (0.95, 0.2, 0.2))):
        place = points[..., axis]
        nearest = np.round(place / GRID_STEP) * GRID_STEP
        line = ground & (np.abs(place - nearest) < thick)
        picture[line] += 0.7 * (color - picture[line])
        line &= nearest == 0
        picture[line] = own
    return _bytes(picture)


def points_at(splats, camera, pixels):
    """Return the surface points that a camera sees at pixels, (n, 3), in the capture frame.

    Pixels are columns and rows in the camera's full picture, (n, 2) [px], from its upper left
    corner. ParameterError if one lies outside the picture or shows nothing solid.
    """
    from rainsim import raster

    small, width = resize_to(camera, CHECK_WIDTH), CHECK_WIDTH
    layers = raster.rasterize(raster.prepare(splats), small, near=1e-3)
    points, _ = seen_points(small, layers.plane_depth)
    found = []
    for u, v in pixels:
        column, row = math.floor(u * width / camera.width), math.floor(v * width / camera.width)
        if not (0 <= u < camera.width and 0 <= v < camera.height and row < small.height):
            raise ParameterError(
                f"pixel ({u:g}, {v:g}) is outside the picture of camera {camera.name}, which has "
                f"{camera.width} x {camera.height} px; give column,row from its upper left corner"
            )
        if not layers.alpha[row, column] > 0.5 or not np.isfinite(layers.plane_depth[row, column]):
            raise ParameterError(
                f"pixel ({u:g}, {v:g}) of camera {camera.name} shows nothing solid; pick a point "
                "on a surface"
            )
        found.append(points[row, column])
    return np.array(found)


def seen_points(view, depth):
    """Return the points [m] (height, width, 3) at a view's z-depths and their distances."""
    ray = pixel_rays(view)
    depth = np.where(np.isfinite(depth), depth, 1e4)[..., None]
    points = view.position + (ray * depth) @ view.camera_from_world[:3, :3]
    return points, np.linalg.norm(ray, axis=-1) * depth[..., 0]


class Seen(NamedTuple):
    """An orthographic splatting over a grid, row 0 in the south."""

    height: np.ndarray  # (ny, nx) [m]
    alpha: np.ndarray  # (ny, nx)
    color: np.ndarray  # (ny, nx, 3)


def seen_straight(splats, frame, grid, height, from_below=False, plane=False):
    """Return what splats show on a grid from a height [m] straight down, or up, as `Seen`.

    With `plane` the heights are those of the splats' planes.
    """
    from rainsim import raster

    axes, eye, flip, sign = np.eye(3), (*grid.origin, height), slice(None), 1
    if not from_below:  # pictures begin in the north
        axes, flip, sign = np.diag([1.0, -1.0, -1.0]), slice(None, None, -1), -1
        eye = (grid.origin[0], grid.origin[1] + grid.size[1], height)
    scale = 1 / grid.spacing
    camera = Camera(
        *grid.shape[::-1], scale, scale, 0.0, 0.0, pose_at(axes, eye), orthographic=True
    )
    layers = raster.rasterize(raster.prepare(splats), frame.camera_in_capture(camera), near=0.0)
    depth = layers.plane_depth if plane else layers.depth
    with np.errstate(invalid="ignore"):
        height = eye[2] + sign * depth * frame.meters_per_unit
    return Seen(height[flip], layers.alpha[flip], layers.color[flip])


def _bytes(picture):
    return (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)
