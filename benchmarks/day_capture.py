"""The capture of a made-up garden: splats of the radiance of a day, and the program's frames."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.day_data import FOLDER, HALF, unpack_colors
from benchmarks.day_shapes import spiral
from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.constants import SH_0
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS
from rainsim.render.renderer import Renderer
from rainsim.scene.cameras import resize_to
from rainsim.scene.ground import estimate_ground_frame
from rainsim.scene.types import Scene, Splats

PRESET = "moderate"
LAYERS = ("clean", "wet", "film", "coverage", "reflection", "refraction", "fresnel", "highlight")
WIDTH, LEAF_ACROSS = 0.6, 0.36  # standard deviation over spacing; of a leaf across it
THIN, OPACITY = 8e-4, 0.99  # m, of all splats
BACKED = ("paving", "lawn", "wall", "tabletop", "box")  # with splats behind, against gaps
BACKED_EVERY, BACKED_BY, BACKED_WIDTH = 5, 4e-3, 1.5  # splats, m, over the spacing
LEAF_THICK = 2e-3  # m between the splats of the two sides: depth order tells the sides apart
DOME, DOME_LOWEST, DOME_WIDTH, DOME_THIN = 60.0, -0.05, 0.7, 0.02  # m; the others over the spacing
STEEP = 0.9  # sine of the elevation from which sky counts as zenith


def capture(case, shapes, arrays, day, sky=True):
    """Return the capture of a case's day as a `Scene`, its ground found as in any capture.

    `arrays` are those of `day_data.read`, `day` is "sun" or "dull"; without `sky` the dome of the
    sky has no splats.
    """
    spots, part, names = shapes.joined()
    colors = unpack_colors(arrays[day])
    lots = [_surface(spots, part, names, colors), _backing(spots, part, names, colors)]
    if sky:
        lots.append(_dome(unpack_colors(arrays[f"{day} sky"])))
    position, axes, scale, color = (np.concatenate(parts) for parts in zip(*lots, strict=True))
    rotation = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]]
    splats = Splats(
        *(np.ascontiguousarray(a, np.float32) for a in (
            position, rotation, scale, np.full(len(position), OPACITY),
            ((color / 255 - 0.5) / SH_0)[:, None, :],
        ))
    )  # fmt: skip
    cameras = case.cameras()
    frame = estimate_ground_frame(splats, cameras, (0, 0, 1), 1.0)
    name = f"{case.name}, {day}{'' if sky else ', no sky'}"
    # A source tells the program that this is a capture, whose light it has to find out.
    return Scene(name, splats, cameras, frame, FOLDER / f"{case.name}.npz", name)


def _surface(spots, part, names, color):
    """Return position, axes, scale and colour of the splats on all parts."""
    across = np.cross(spots.normal, spots.along)
    size = np.abs(spots.spacing)
    other = np.where(spots.spacing > 0, WIDTH, LEAF_ACROSS) * size
    leaf = part == names.index("leaf")
    position = spots.position + LEAF_THICK * spots.normal * leaf[:, None]
    axes = np.stack([spots.along, across, spots.normal], axis=-1)
    scale = np.stack([WIDTH * size, other, np.full(len(size), THIN)], axis=-1)
    return position, axes, scale, color


def _backing(spots, part, names, color):
    """Return splats a little behind some parts, so that nothing shines through."""
    which = np.concatenate([
        np.flatnonzero(part == names.index(name))[::BACKED_EVERY]
        for name in BACKED if name in names
    ])  # fmt: skip
    normal, along = spots.normal[which], spots.along[which]
    axes = np.stack([along, np.cross(normal, along), normal], axis=-1)
    wide = BACKED_WIDTH * spots.spacing[which]
    scale = np.stack([wide, wide, np.full(len(wide), THIN)], axis=-1)
    return spots.position[which] - BACKED_BY * normal, axes, scale, color[which]


def _dome(color):
    """Return splats on a dome far away."""
    out = spiral(len(color), DOME_LOWEST)
    along = np.cross(out, [0.01, 0.02, 1.0])
    along /= np.linalg.norm(along, axis=1)[:, None]
    axes = np.stack([along, np.cross(out, along), out], axis=-1)
    step = DOME * math.sqrt(2 * math.pi * (1 - DOME_LOWEST) / len(color))
    scale = np.tile([[DOME_WIDTH * step, DOME_WIDTH * step, DOME_THIN * step]], (len(color), 1))
    return DOME * out, axes, scale, color


def settings(scene, rain, width):
    """Return the `Config` of a rainy day: no rain falls, the fallen rain stands at rest."""
    speed, turn = rain.wind
    toward = scene.ground_frame.rotation @ (math.cos(turn), math.sin(turn), 0.0)
    wind = speed, math.atan2(toward[1], toward[0])
    config = Config.from_preset(PRESET)
    return config.replace(rate=0.0, past=rain.past, wind=wind, frames=1, width=width,
                          exposure_bias=0.0).check()  # fmt: skip


def frames(scene, rain, views, width):
    """Yield view, pictures of the program, zenith of the sky and brightness for each view.

    Pictures are reduced to the size of the traced ones, (height, width, ...): picture: radiance
    without what falls; gloss: what water and film mirror of it; mirrored and fresnel: in water,
    before Fresnel's factor, and the factor; coverage; clean: the dry capture, 0 to 1. The zenith is
    the luminance of the drawn sky above.
    """
    config = settings(scene, rain, width)
    ground = pipeline.extract_terrain(scene, config)
    states = list(pipeline.frames_of(pipeline.simulate(ground, config), config))
    for view in views:
        camera = resize_to(scene.cameras[view], width)
        renderer = Renderer(scene, ground, config, camera)
        _, report = next(renderer.film([(camera, states[0], None)], LAYERS))
        yield view, parts_of(report.aovs), zenith_of(renderer), report.light["brightness"]


def parts_of(layers):
    """Return the parts of a frame that are compared, each pixel a mean of HALF x HALF."""
    layer = {name: np.asarray(values, np.float64) for name, values in layers.items()}
    share, cover = layer["fresnel"][..., None], layer["coverage"][..., None]
    mirrored = share * layer["reflection"] + layer["highlight"]
    water = (1 - share) * layer["refraction"] + mirrored
    parts = {
        "picture": (1 - cover) * layer["wet"] + cover * water,
        "gloss": (1 - cover) * layer["film"] + cover * mirrored,
        "mirrored": layer["reflection"], "fresnel": layer["fresnel"],
        "coverage": layer["coverage"], "clean": layer["clean"] / 255,
    }  # fmt: skip
    return {name: reduced(values) for name, values in parts.items()}


def reduced(values):
    """Return means over squares of HALF x HALF pixels."""
    height, width = values.shape[0] // HALF, values.shape[1] // HALF
    squares = values[: height * HALF, : width * HALF]
    return squares.reshape(height, HALF, width, HALF, *values.shape[2:]).mean(axis=(1, 3))


def zenith_of(renderer):
    """Return the luminance that the renderer's sky of the day has at its zenith.

    It is that of an overcast sky, L = Lz (1 + 2 sine) / 3, fitted above STEEP: the bellies of
    single clouds fall out.
    """
    sky = renderer.conductor.wet_scene.sky.day @ LUMINANCE_WEIGHTS  # row 0 is the zenith
    rows = sky.shape[0]
    elevation = (0.5 - (np.arange(rows) + 0.5) / rows) * np.pi
    cap = np.sin(elevation) > STEEP
    area, sine = np.cos(elevation[cap]), np.sin(elevation[cap])
    return float((sky[cap].mean(axis=1) * area).sum() / (area * (1 + 2 * sine) / 3).sum())
