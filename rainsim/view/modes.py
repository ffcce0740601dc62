"""Pictures that a page can show in place of the rain: layers of the frame, maps of the terrain."""

import numpy as np

from rainsim.render.aov import AOVS, INDEX, PICTURE, SHARE
from rainsim.shading import composite
from rainsim.terrain.pictures import FADE_DEPTHS, WATER_DARK, WATER_LIGHT, seen_points
from rainsim.terrain.table import class_table
from rainsim.terrain.types import INFERRED, UNKNOWN
from rainsim.water.puddles import puddles_of

RAIN = "rain"
CLASSES, CONFIDENCE, PUDDLES = "classes", "confidence of the map", "puddles after N mm"
MAPS = (CLASSES, CONFIDENCE, PUDDLES)
# Mode: the layer of the frame that it shows.
LAYERS = {
    "clean capture": "clean", "depth": "depth", "normals": "normal", "wetness": "wetness",
    "water depth": "water_depth", "wet, without water": "wet", "coverage of water": "coverage",
    "reflection": "reflection", "source of reflections": "reflection_source",
    "refraction": "refraction", "reflectance": "fresnel", "highlight": "highlight",
    "film on wet ground": "film", "transmission of the air": "transmission",
    "rain alpha": "rain_alpha", "splash alpha": "splash_alpha",
}  # fmt: skip
MODES = (RAIN, *LAYERS, *MAPS)
ON_GROUND = 0.04  # m, and 1 % of the distance: what is nearer the bed counts as ground
DEPTHS = (0.3, 60.0)  # m, the ends of the colours of depth, by its logarithm
DEEPEST = 0.02  # m of water, the end of its colours
NOISE = 0.01  # m, of the measured bed: at this it is as little known as inferred ground
OPACITY = 0.55  # of a map over the capture
# Dark blue over green to yellow: as bright as the value is high, also for the colour-blind.
COLORS = np.array(
    [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], np.float32
)
KINDS = np.array(
    [[40, 40, 40], [86, 180, 233], [230, 159, 0], [0, 158, 115], [204, 121, 167]], np.uint8
)
MEASURED_COLOR, INFERRED_COLOR, UNKNOWN_COLOR = (40, 180, 90), (240, 180, 40), (200, 50, 40)


def mode_picture(
    session, name, amount, shot, check=lambda: None, with_depth=True, simple=False
):  # fmt: skip
    """Return the picture of a mode, and the depth of its pixels.

    amount : float [mm]. Of rain, for PUDDLES.
    with_depth : bool. Without it None stands for the depth where it is not at
        hand.
    Returns picture : uint8 array (height, width, 3)
        depth : float32 array (height, width) [m]. Along the view axis, infinite
            for sky.
    """
    wanted = (LAYERS[name],) if name in LAYERS else ("clean",) if name in MAPS else ()
    names = (*wanted, "drawn_depth") if wanted or (with_depth and session.backend != "cpu") else ()
    picture, report = session.draw(*shot, names, check, simple)
    at_hand = session.renderer.frame["depth"] if session.backend == "cpu" else None
    depth = report.aovs["drawn_depth"] if names else at_hand
    if name in LAYERS:
        return layer_picture(LAYERS[name], report.aovs[LAYERS[name]]), depth
    if name in MAPS:
        colors = _map_colors(session, name, amount)
        return over_ground(session, shot, report.aovs["clean"], depth, *colors), depth
    return picture, depth


def layer_picture(name, values):
    """Return a layer of the frame, by its name in `aov.AOVS`, as uint8 (height, width, 3)."""
    kind = AOVS[name].kind
    if kind == PICTURE:
        return np.ascontiguousarray(values)
    if kind == SHARE:
        return colored(values)
    if kind == INDEX:
        return KINDS[np.minimum(values.astype(np.int64), len(KINDS) - 1)]
    if name == "depth":
        near, far = np.log(DEPTHS)
        return colored(1 - (np.log(np.clip(values, *DEPTHS)) - near) / (far - near))
    if name == "normal":
        return np.rint(np.clip(0.5 + 0.5 * values, 0, 1) * 255).astype(np.uint8)
    if name == "water_depth":
        return colored(values / DEEPEST)
    shown = np.empty(values.size, np.uint8)
    composite.encode(np.ascontiguousarray(values, np.float32).ravel(), shown)
    return shown.reshape(values.shape)


def colored(share):
    """Return shares from 0 to 1 of any shape as colours of shape (..., 3), uint8."""
    place = np.clip(np.nan_to_num(share), 0, 1) * (len(COLORS) - 1)
    low = np.minimum(place.astype(np.int64), len(COLORS) - 2)
    part = (place - low)[..., None]
    return np.rint(COLORS[low] * (1 - part) + COLORS[low + 1] * part).astype(np.uint8)


def _map_colors(session, name, amount):
    """Return colours (ny, nx, 3), 0 to 255, and opacity (ny, nx) of a map of the ground."""
    terrain = session.terrain
    full = np.full(terrain.grid.shape, OPACITY, np.float32)
    if name == CLASSES:
        return class_table().colors[terrain.ground_class].astype(np.float32), full
    if name == CONFIDENCE:
        return confidence_colors(terrain), full
    depth = session.kept(("puddles", amount), lambda: puddle_depths(terrain, amount))
    return puddle_colors(depth)


def confidence_colors(terrain):
    """Return how well the ground is known as colours (ny, nx, 3) float32, 0 to 255.

    Green is measured ground, yellow is ground that is noisy or inferred, red is unknown.
    """
    sure, guess = np.array(MEASURED_COLOR, np.float32), np.array(INFERRED_COLOR, np.float32)
    share = np.clip(terrain.noise / NOISE, 0, 1)[..., None]
    colors = sure + (guess - sure) * share
    colors[terrain.source == INFERRED] = guess
    colors[terrain.source == UNKNOWN] = UNKNOWN_COLOR
    return colors


def puddle_depths(terrain, rain):
    """Return the depth [m] (ny, nx) of the water that stands at rest after `rain` [mm]."""
    puddles = puddles_of(terrain)
    puddles.rain(rain * 1e-3)
    return puddles.depth


def puddle_colors(depth):
    """Return colours (ny, nx, 3), 0 to 255, and opacity (ny, nx) of a water depth [m]."""
    low, high, deep = FADE_DEPTHS
    share = np.clip(depth / deep, 0, 1)[..., None]
    colors = (WATER_LIGHT + (WATER_DARK - WATER_LIGHT) * share) * 255
    return colors, np.clip((depth - low) / (high - low), 0, 1) * 0.8


def over_ground(session, shot, picture, depth, colors, opacity):
    """Return a picture with a map (colours to 255) laid over the pixels that show the ground."""
    camera = session.camera_of(*shot[:3])
    points, distance = seen_points(session.scene.ground_frame.camera_in_ground(camera), depth)
    terrain = session.terrain
    row, column, inside = terrain.grid.cells(points[..., 0], points[..., 1])
    away = np.abs(points[..., 2] - terrain.bed[row, column])
    ground = inside & np.isfinite(depth) & (away < ON_GROUND + 0.01 * distance)
    share = np.where(ground, opacity[row, column], 0)[..., None]
    mixed = picture + (colors[row, column] - picture) * share
    return np.rint(np.clip(mixed, 0, 255)).astype(np.uint8)
