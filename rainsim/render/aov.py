"""Layers of a frame: what it is put together from, for compositing and as labels.

Nothing here is computed unless it is asked for by name. `recompose` puts a frame together again
from its layers: that is what they mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from rainsim import optics, shade
from rainsim.drips import drip_impacts
from rainsim.errors import ParameterError
from rainsim.splash import LONGEST_LIFE
from rainsim.splashview import seen_splashes
from rainsim.streaks import NEAR

PICTURE, SHARE, INDEX, DATA = "picture", "share", "index", "data"  # kinds, see `Layer`
MOST_INDEX = 2**16 - 1
FLOW_SAMPLES = 24  # places on a drop's path at which its flow is written down
SEEN_SPLASH = 1 / 512  # share of a pixel's light from which a splash is labelled


@dataclass(frozen=True)
class Layer:
    """What a layer is.

    Attributes
    ----------
    kind : str
        PICTURE: display-referred, 8-bit PNG. SHARE: 0 to 1, 16-bit PNG. INDEX: whole numbers,
        16-bit PNG. DATA: float32, OpenEXR with the extra `exr`, else .npz.
    unit : str
    what : str
    """

    kind: str
    unit: str
    what: str


LAYERS = {
    "clean": Layer(PICTURE, "", "the dry capture, as it was captured"),
    "depth": Layer(DATA, "m", "along the view axis, infinite for sky"),
    "normal": Layer(DATA, "", "of the captured surface, in the ground frame; zero for sky"),
    "water_depth": Layer(DATA, "m", "of the water that the pixel shows"),
    "wetness": Layer(SHARE, "", "of what the rain reaches: 0 dry, 1 wet through"),
    "wet": Layer(DATA, "display white", "linear light: graded and wetted, without water"),
    "film": Layer(DATA, "display white", "what the film on the ground mirrors, a part of wet"),
    "coverage": Layer(SHARE, "", "of the pixel that is water"),
    "reflection": Layer(DATA, "display white", "what the water mirrors (the paper's specular)"),
    "reflection_source": Layer(
        INDEX, "", "0 no water, 1 environment, 2 screen, 3 mirrored pass, 4 traced"
    ),
    "refraction": Layer(DATA, "display white", "what shows through the water, absorption included"),
    "fresnel": Layer(SHARE, "", "of the light that the water mirrors"),
    "highlight": Layer(DATA, "display white", "the sun's glint on the water, as it is added"),
    "transmission": Layer(SHARE, "", "of the air, where drops are too small or far to draw"),
    "rain_alpha": Layer(SHARE, "", "of the light that falling drops replace"),
    "splash_alpha": Layer(SHARE, "", "of the light that splashes replace"),
    "splash_id": Layer(INDEX, "", "of the splash nearest to a splashed pixel, 0 for none"),
    "drop_flow": Layer(DATA, "px per frame", "mean motion (right, down) of the drops in a pixel"),
}
TERMS = ("coverage", "reflection", "reflection_source", "refraction", "fresnel", "highlight",
         "water_depth")  # fmt: skip
NEEDED = ("wet", "coverage", "reflection", "refraction", "fresnel", "highlight", "transmission",
          "rain_alpha", "splash_alpha")  # fmt: skip


def parse_names(text):
    """Return the layers that a text names: all, or names with commas between them.

    Raises
    ------
    ParameterError
        If a name is not known.
    """
    if text is None:
        return ()
    if text == "all":
        return tuple(LAYERS)
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in LAYERS:
            raise ParameterError(
                f"there is no layer {name!r}; known are all, {', '.join(LAYERS)}; correct the name"
            )
    return names


@dataclass(frozen=True)
class Shot:
    """What a frame was put together from, as the renderer had it.

    Attributes
    ----------
    layers : raster.Layers or None
        Of the dry capture; None if no layer asks for it.
    view : waterview.View
    water : waterview.WaterView
    environment, sun
        As the water had them.
    field : RainField or None
    surfaces : Surfaces
    camera : Camera
        In the ground frame.
    state : SimState
    exposure, interval : float [s]
        Of the shutter, and from frame to frame.
    film : float [m]
        Water on all that is wet.
    ground, others : ndarray
        See `wetness.ground_maps` and `wetness.others`.
    rain, splash : ndarray of shape (height, width), float32
    fog : ndarray
        See `streaks.fog_table`.
    far : float [m]
        As far as drops are drawn.
    """

    layers: object
    view: object
    water: object
    environment: np.ndarray
    sun: np.ndarray
    field: object
    surfaces: object
    camera: object
    state: object
    exposure: float
    interval: float
    film: float
    ground: np.ndarray
    others: np.ndarray
    rain: np.ndarray
    splash: np.ndarray
    fog: np.ndarray
    far: float


def collect(names, shot):
    """Return the named layers of a frame, a dict of arrays (height, width) or (height, width, n).

    Parameters
    ----------
    names : sequence of str
        Of `LAYERS`.
    shot : Shot
    """
    found = {}
    if any(name in TERMS for name in names):
        found.update(_water_terms(shot))
    makers = {
        "clean": _clean, "normal": _normal, "wetness": _wetness, "transmission": _transmission,
        "splash_id": _splash_id, "drop_flow": _drop_flow,
    }  # fmt: skip
    found["depth"], found["wet"] = shot.view.depth, shot.view.picture
    found["film"] = shot.view.picture - shot.view.below
    found["rain_alpha"], found["splash_alpha"] = shot.rain, shot.splash
    return {n: makers[n](shot) if n in makers else found[n].copy() for n in names}


def recompose(layers, drop, around, air, brightness):
    """Return the frame, uint8, that its layers make.

    Parameters
    ----------
    layers : dict of str to ndarray
        At least those of NEEDED.
    drop : array_like of shape (3,) or (m, n, 3)
        Radiance of drops: everywhere, or at places from edge to edge of the picture, between which
        it is interpolated.
    around, air : array_like of shape (3,)
        Mean radiance of everything, and that of the air; all as the frame's facts have them.
    brightness : float
    """
    part = {name: np.asarray(layers[name], np.float64) for name in NEEDED}
    share, cover = part["fresnel"][..., None], part["coverage"][..., None]
    water = (1 - share) * part["refraction"] + share * part["reflection"] + part["highlight"]
    value = part["wet"] * (1 - cover) + water * cover
    clear = part["transmission"][..., None]
    drop = spread_field(drop, *part["coverage"].shape)
    value = value * clear + np.asarray(air) * (1 - clear)
    splash = shade.splash_light(drop, np.asarray(around))
    for name, shown in (("splash_alpha", splash), ("rain_alpha", drop)):
        value = value + part[name][..., None] * (shown - value)
    value = value * brightness
    value = np.where(value > 0.5, 0.5 + 0.5 * (1 - np.exp(-2 * (value - 0.5))), value)
    value = np.clip(value, 0, 1)
    shown = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return (np.clip(shown, 0, 1) * 255 + 0.5).astype(np.uint8)


def spread_field(drop, height, width):
    """Return the radiance of drops for each pixel, (height, width, 3), or (3,) if it is even."""
    drop = np.asarray(drop, np.float64)
    if drop.ndim == 1:
        return drop
    v = (np.arange(height) + 0.5) / height * (drop.shape[0] - 1)
    u = (np.arange(width) + 0.5) / width * (drop.shape[1] - 1)
    j, i = v.astype(int), u.astype(int)
    b, a = (v - j)[:, None, None], (u - i)[None, :, None]
    rows = drop[j] * (1 - b) + drop[j + 1] * b
    return rows[:, i] * (1 - a) + rows[:, i + 1] * a


def _clean(shot):
    return (np.clip(shot.layers.color, 0, 1) * 255 + 0.5).astype(np.uint8)


def _normal(shot):
    return (shot.layers.normal @ shot.view.turn.T).astype(np.float32)


def _wetness(shot):
    damp = np.empty(shot.view.depth.shape, np.float32)
    shade.dampness(
        shot.view.depth, shot.view.clearance, shot.layers.normal, shot.view.turn, shot.view.eye,
        shot.view.lens, shot.ground, *shot.water.place, shot.others, damp,
    )  # fmt: skip
    return damp


def _transmission(shot):
    height, width = shot.view.depth.shape
    fx, fy, cx, cy = shot.view.lens
    a, b = (np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy
    slant = np.sqrt(1 + a[None] ** 2 + b[:, None] ** 2)
    z, fog = np.minimum(shot.view.depth, np.float32(1e4)), shot.fog.astype(np.float64)
    even = np.linspace(0, fog[0], len(fog) - 2)
    thickness = np.interp(z, even, fog[2:]) + fog[1] * np.maximum(z - fog[0], 0)
    clear = np.exp(-thickness * slant)
    return np.where(z < 1e4, clear, 1).astype(np.float32)  # the sky is seen through all air already


def _water_terms(shot):
    """Return the layers of TERMS; zero where there is no water."""
    water, view = shot.water, shot.view
    height, width = view.depth.shape
    n = len(water.pixel)
    through, glint = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    share = np.empty(n, np.float32)
    if n:
        optics.separate_water(
            water.pixel, water.record, view.below, view.depth, view.turn, view.lens,
            *water.laws(), shot.sun, through, share, glint,
        )  # fmt: skip

    def spread(values, dtype=np.float32):
        out = np.zeros((height * width, *values.shape[1:]), dtype)
        out[water.pixel] = values
        return out.reshape(height, width, *values.shape[1:])

    return {
        "coverage": spread(water.record[:, 8]), "reflection": spread(water.light),
        "reflection_source": spread(water.source + 1, np.uint16), "refraction": spread(through),
        "fresnel": spread(share), "highlight": spread(glint),
        "water_depth": spread(water.record[:, 7]),
    }  # fmt: skip


def _splash_id(shot):
    """Return a number for each splashed pixel: that of the splash whose middle is nearest.

    A splash keeps its number from frame to frame and from camera to camera, for it comes from its
    drop; two splashes of one picture can have the same one by chance.
    """
    labels = np.zeros(shot.splash.shape, np.uint16)
    rows, columns = np.nonzero(shot.splash > SEEN_SPLASH)
    if shot.field is None or not len(rows):
        return labels
    time, drips = shot.state.time, (shot.state.drips, shot.state.drip_id, shot.surfaces)
    found = seen_splashes(
        shot.field, shot.surfaces, shot.camera, time, shot.exposure, shot.state.depth, shot.film,
        more=drip_impacts(*drips, time - LONGEST_LIFE, time + shot.exposure),
    )  # fmt: skip
    if not len(found):
        return labels
    place = _project(found.position, shot.camera)[:, :2]
    nearest = cKDTree(place).query(np.column_stack([columns + 0.5, rows + 0.5]))[1]
    labels[rows, columns] = (found.id[nearest] % np.uint64(MOST_INDEX) + np.uint64(1)).astype(
        np.uint16
    )
    return labels


def _project(points, camera):
    """Return image point and depth of ground-frame points, (n, 3)."""
    matrix = camera.camera_from_world
    x, y, z = (np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z], axis=1)


def _drop_flow(shot):
    """Return the motion of drops in the picture, the mean over the drops in a pixel.

    Each drop counts with the light that it replaces; zero where there are none.
    """
    height, width = shot.rain.shape
    flow = np.zeros((height * width, 2))
    weight = np.zeros(height * width)
    if shot.field is None:
        return flow.reshape(height, width, 2).astype(np.float32)
    camera, depth = shot.camera, shot.view.depth
    corners = np.array([(u, v, 1.0) for u in (0, camera.width) for v in (0, camera.height)])
    rays = (corners - (camera.cx, camera.cy, 0)) / (camera.fx, camera.fy, 1)
    box = np.concatenate([rays * shot.far, np.zeros((1, 3))])
    box = box @ camera.camera_from_world[:3, :3] + camera.position
    high = box.max(axis=0) + np.array([0, 0, 0.3])  # drops that fall into view meanwhile
    found = shot.field.drops_in_box(shot.state.time, box.min(axis=0), high)
    start = _project(found.position, camera)
    after = _project(found.position + found.velocity * shot.interval, camera)
    ahead = (start[:, 2] > NEAR) & (after[:, 2] > NEAR)
    start, after = start[ahead], after[ahead]
    cover = found.diameter[ahead] ** 2 / start[:, 2] ** 2
    opened = shot.exposure / shot.interval
    for k in range(FLOW_SAMPLES):
        part = opened * (k + 0.5) / FLOW_SAMPLES
        u, v, z = (start + part * (after - start)).T
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height) & (z < shot.far)
        at = v[inside].astype(np.int64) * width + u[inside].astype(np.int64)
        before = z[inside] < depth.ravel()[at]
        at, which = at[before], np.flatnonzero(inside)[before]
        np.add.at(weight, at, cover[which])
        np.add.at(flow, at, cover[which, None] * (after - start)[which, :2])
    flow /= np.maximum(weight, 1e-30)[:, None]
    flow[shot.rain.ravel() <= 0] = 0
    return flow.reshape(height, width, 2).astype(np.float32)


def channels(name):
    """Return the channel names of a DATA layer, as OpenEXR users expect them."""
    return {"normal": ("X", "Y", "Z"), "drop_flow": ("X", "Y"), "depth": ("Z",),
            "water_depth": ("Y",)}.get(name, ("R", "G", "B"))  # fmt: skip
