"""Arbitrary output variables (AOVs) of a frame, for compositing and as labels: `--layers`.

Only those AOVs are computed that are asked for by name. `recompose` computes a frame from its AOVs:
so it defines what they mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from rainsim.errors import ParameterError
from rainsim.particles.splash import LONGEST_LIFE
from rainsim.particles.splash_pass import seen_splashes
from rainsim.particles.streaks import NEAR
from rainsim.rain.dripping import drip_impacts
from rainsim.reflection import water_record
from rainsim.render import actor_labels, labels
from rainsim.shading import composite
from rainsim.shading.dampness import find_dampness
from rainsim.shading.wet_pass import dry_picture
from rainsim.terrain.table import WATER

PICTURE, SHARE, INDEX, DATA = "picture", "share", "index", "data"  # kinds, see `Aov`
MOST_INDEX = 2**16 - 1
FLOW_SAMPLES = 24  # places on a drop's path at which its motion is recorded
SEEN_SPLASH = 1 / 512  # share of a pixel's light from which a splash is labelled


@dataclass(frozen=True)
class Aov:
    """Description of an arbitrary output variable (AOV).

    Attributes
    ----------
    kind : str
        PICTURE: display-referred, 8-bit PNG. SHARE: 0 to 1, 16-bit PNG. INDEX: whole numbers,
        16-bit PNG. DATA: float32, OpenEXR with the extra `exr`, else .npz.
    unit : str
    what : str
    channels : tuple of str
        Their names in a file of DATA, as OpenEXR users expect them.
    """

    kind: str
    unit: str
    what: str
    channels: tuple = ("R", "G", "B")


AOVS = {
    "clean": Aov(PICTURE, "", "the dry capture without grading"),
    "depth": Aov(DATA, "m", "along the view axis (z-depth), infinite for sky", ("Z",)),
    "range": Aov(DATA, "m", "distance from the camera's centre, infinite for sky", ("Y",)),
    "normal": Aov(
        DATA, "", "of the captured surface, in the ground frame; zero for sky", ("X", "Y", "Z")
    ),
    "water_depth": Aov(DATA, "m", "of the water that the pixel shows", ("Y",)),
    "wetness": Aov(SHARE, "", "of surfaces: 0 dry, 1 wet through"),
    "wet": Aov(DATA, "display white", "linear light: graded and wetted, without water"),
    "film": Aov(DATA, "display white", "reflection of the water film on the ground, a part of wet"),
    "coverage": Aov(SHARE, "", "of the pixel that is water"),
    "reflection": Aov(DATA, "display white", "what the water mirrors (the paper's specular)"),
    "reflection_source": Aov(
        INDEX, "", "0 no water, 1 environment, 2 screen, 3 mirrored pass, 4 traced"
    ),
    "refraction": Aov(DATA, "display white", "what shows through the water, absorption included"),
    "fresnel": Aov(SHARE, "", "of the light that the water mirrors"),
    "highlight": Aov(DATA, "display white", "the sun's glint on the water, as it is added"),
    "transmission": Aov(SHARE, "", "of the air, where drops are too small or far to draw"),
    "rain_alpha": Aov(SHARE, "", "of the light that falling drops replace"),
    "splash_alpha": Aov(SHARE, "", "of the light that splashes replace"),
    "splash_id": Aov(INDEX, "", "of the splash nearest to a splashed pixel, 0 for none"),
    "drop_flow": Aov(
        DATA, "px per frame", "mean motion (right, down) of the drops in a pixel", ("X", "Y")
    ),
    "flow": Aov(
        DATA, "px per frame", "motion (right, down) of the scene to the next frame", ("X", "Y")
    ),
    "flow_mask": Aov(INDEX, "", "0 no flow, 1 seen, 2 occluded, 3 outside the next frame"),
    "class_id": Aov(INDEX, "", "class of ground or water, 255 for all else"),
    "puddle_id": Aov(INDEX, "", "of the puddle that a pixel shows, 0 for none"),
    "actor_id": Aov(INDEX, "", "of the actor that a pixel shows, 0 for none"),
}
TERMS = ("coverage", "reflection", "reflection_source", "refraction", "fresnel", "highlight",
         "water_depth")  # fmt: skip
OF_THE_WATER = (*TERMS, "class_id", "puddle_id")  # those that need the list of the water's pixels
DRY = frozenset({"clean", "normal", "wetness", "class_id"})  # those that need the dry picture
FLOW = frozenset({"flow", "flow_mask"})
ACTORS = FLOW | {"actor_id", "class_id"}  # those that need to know which actor a pixel shows
NEEDED = ("wet", "coverage", "reflection", "refraction", "fresnel", "highlight", "transmission",
          "rain_alpha", "splash_alpha")  # fmt: skip


def parse_names(text):
    """Return the AOVs that a text names: all, or names with commas between them.

    Raises
    ------
    ParameterError
        If a name is not known.
    """
    if text is None:
        return ()
    if text == "all":
        return tuple(AOVS)
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in AOVS:
            raise ParameterError(
                f"there is no layer {name!r}; known are all, {', '.join(AOVS)}; correct the name"
            )
    return names


@dataclass(frozen=True)
class FrameParts:
    """The parts that a frame was composed of.

    Attributes
    ----------
    dry : raster.Layers or None
        The dry capture; None if no AOV of DRY is asked for.
    wet : WetPicture
    water : WaterPass
    sun : ndarray of shape (6,), float32
        See `sky.sunlight`.
    field : RainField or None
    surfaces : Surfaces
    camera : Camera
        In the ground frame.
    state : SimState
    exposure, interval : float [s]
        Of the shutter, and from frame to frame.
    film : float [m]
        Water on all that is wet.
    ground : GroundMaps
    off_ground : OffGroundWetness
    look : Look
    unit : float [m]
        A unit of the capture.
    cover : RainCover
    far : float [m]
        As far as drops are drawn.
    terrain : Terrain
    after : Camera or None
        Of the next frame, in the ground frame; None: the camera stands still.
    depth_after : ndarray of shape (height, width), float32 [m], or None
        What the next frame's camera sees; None: the camera stands still, or no AOV of FLOW is
        asked for.
    actors : ActorsSeen or None
        What moves; None: nothing does, or no AOV of ACTORS is asked for.
    """

    dry: object
    wet: object
    water: object
    sun: np.ndarray
    field: object
    surfaces: object
    camera: object
    state: object
    exposure: float
    interval: float
    film: float
    ground: object
    off_ground: object
    look: object
    unit: float
    cover: object
    far: float
    terrain: object
    after: object = None
    depth_after: np.ndarray | None = None
    actors: actor_labels.ActorsSeen | None = None


def collect(names, parts):
    """Return the named AOVs of a frame, a dict of arrays (height, width) or (height, width, n).

    Parameters
    ----------
    names : sequence of str
        Of `AOVS`.
    parts : FrameParts
    """
    found = {
        "depth": parts.wet.depth, "wet": parts.wet.picture,
        "film": parts.wet.picture - parts.wet.below,
        "rain_alpha": parts.cover.rain_alpha, "splash_alpha": parts.cover.splash_alpha,
    }  # fmt: skip
    if not set(TERMS).isdisjoint(names):
        found.update(_water_terms(parts))
    if not FLOW.isdisjoint(names):
        found["flow"], found["flow_mask"] = _flow(parts)
    computed = {
        "clean": _clean, "normal": _normal, "wetness": _wetness, "transmission": _transmission,
        "splash_id": _splash_id, "drop_flow": _drop_flow, "range": _range, "class_id": _class_id,
        "puddle_id": _puddle_id, "actor_id": _actor_id,
    }  # fmt: skip
    return {n: computed[n](parts) if n in computed else found[n].copy() for n in names}


def facts_of(aovs, parts, weather):
    """Return a frame's labels besides pictures, as plain JSON values.

    Parameters
    ----------
    aovs : dict of str to ndarray
        Those that were asked for: classes are named, puddles and splashes get their boxes.
    parts : FrameParts
    weather : dict
        See `rainsim.render.weather.weather_of`.
    """
    facts = {"weather": weather}
    if "class_id" in aovs:
        facts["classes"] = labels.class_names()
    if "puddle_id" in aovs:
        _, puddles = labels.puddle_map(parts.terrain, parts.state.depth)
        boxes = labels.boxes_of(aovs["puddle_id"])
        facts["puddles"] = [{**box, **puddles.get(box["id"], {})} for box in boxes]
    if "actor_id" in aovs and parts.actors is not None:
        facts["actors"] = actor_labels.facts_of_actors(parts.actors, parts.camera)
    if "splash_id" in aovs:
        facts["splashes"] = labels.boxes_of(aovs["splash_id"])
    return facts


def recompose(aovs, drop, around, air, brightness):
    """Return the frame, uint8, that its AOVs make.

    Parameters
    ----------
    aovs : dict of str to ndarray
        At least those of NEEDED.
    drop : array_like of shape (3,) or (m, n, 3)
        Radiance of drops: everywhere, or at places from edge to edge of the picture, bilinear
        between them.
    around : array_like of shape (3,) or (m, n, 3)
        The same of the sheets of splashes.
    air : array_like of shape (3,)
        Radiance of the air; see `FrameReport.light`.
    brightness : float

    Examples
    --------
    >>> from rainsim.render.aov import NEEDED
    >>> renderer = rainsim.Renderer(scene, terrain, config, scene.cameras[0])
    >>> picture, report = renderer.draw(scene.cameras[0], state, names=NEEDED)
    >>> again = rainsim.recompose(report.aovs, **report.light)
    >>> int(np.abs(again.astype(int) - picture).max()) <= 1
    True
    """
    part = {name: np.asarray(aovs[name], np.float64) for name in NEEDED}
    share, cover = part["fresnel"][..., None], part["coverage"][..., None]
    water = (1 - share) * part["refraction"] + share * part["reflection"] + part["highlight"]
    value = part["wet"] * (1 - cover) + water * cover
    drop, around = (spread_field(field, *part["coverage"].shape) for field in (drop, around))
    past_splashes, past_drops = (
        1 - part[name][..., None] for name in ("splash_alpha", "rain_alpha")
    )
    value = brightness * composite.through_rain(
        value, drop, around, np.asarray(air), part["transmission"][..., None],
        past_splashes, past_drops,
    )  # fmt: skip
    image = np.empty(value.shape, np.uint8)
    composite.encode(value.astype(np.float32).ravel(), image.ravel())
    return image


def spread_field(drop, height, width):
    """Interpolate the radiance of drops from a few places of the picture to its pixels.

    Parameters
    ----------
    drop : array_like of shape (rows, columns, 3) or (3,)
        At places from edge to edge, see `falling_light`; (3,) is even over the picture.
    height, width : int [px]

    Returns
    -------
    ndarray of shape (height, width, 3) or (3,), float64
    """
    drop = np.asarray(drop, np.float64)
    if drop.ndim == 1:
        return drop
    v = (np.arange(height) + 0.5) / height * (drop.shape[0] - 1)
    u = (np.arange(width) + 0.5) / width * (drop.shape[1] - 1)
    j, i = v.astype(int), u.astype(int)
    b, a = (v - j)[:, None, None], (u - i)[None, :, None]
    rows = drop[j] * (1 - b) + drop[j + 1] * b
    return rows[:, i] * (1 - a) + rows[:, i + 1] * a


def _clean(parts):
    return (np.clip(parts.dry.color, 0, 1) * 255 + 0.5).astype(np.uint8)


def _normal(parts):
    return (parts.dry.normal @ parts.wet.view.ground_from_camera.T).astype(np.float32)


def _wetness(parts):
    damp = np.empty(parts.wet.depth.shape, np.float32)
    find_dampness(
        parts.wet.depth, parts.wet.clearance, dry_picture(parts.dry, parts.unit),
        parts.look, parts.wet.view,
        parts.ground, parts.off_ground, damp,
    )  # fmt: skip
    return damp


def _transmission(parts):
    clear = np.empty(parts.wet.depth.shape, np.float32)
    composite.find_clear(parts.wet.depth, parts.cover.fog, parts.wet.view, clear)
    return clear


def _water_terms(parts):
    """Return the AOVs of TERMS; zero where there is no water."""
    water, wet = parts.water, parts.wet
    height, width = wet.depth.shape
    through, share, glint = water.terms(parts.sun)

    def spread(values, dtype=np.float32):
        out = np.zeros((height * width, *values.shape[1:]), dtype)
        out[water.pixel] = values
        return out.reshape(height, width, *values.shape[1:])

    return {
        "coverage": spread(water.record[:, water_record.COVERAGE]),
        "reflection": spread(water.light),
        "reflection_source": spread(water.source + 1, np.uint16), "refraction": spread(through),
        "fresnel": spread(share), "highlight": spread(glint),
        "water_depth": spread(water.record[:, water_record.WATER_DEPTH]),
    }  # fmt: skip


def _splash_id(parts):
    """Return a number for each splashed pixel: that of the splash whose middle is nearest.

    A splash keeps its number from frame to frame and from camera to camera, for it comes from its
    drop; two splashes of one picture can have the same one by chance.
    """
    labels = np.zeros(parts.cover.splash_alpha.shape, np.uint16)
    rows, columns = np.nonzero(parts.cover.splash_alpha > SEEN_SPLASH)
    if parts.field is None or not len(rows):
        return labels
    time, drips = parts.state.time, (parts.state.drips, parts.state.drip_id, parts.surfaces)
    position, ids = seen_splashes(
        parts.field, parts.surfaces, parts.camera, time, parts.exposure, parts.state.depth,
        parts.film, parts.wet.depth,
        more=drip_impacts(*drips, time - LONGEST_LIFE, time + parts.exposure),
    )  # fmt: skip
    if not len(ids):
        return labels
    place = _project(position, parts.camera)[:, :2]
    nearest = cKDTree(place).query(np.column_stack([columns + 0.5, rows + 0.5]))[1]
    labels[rows, columns] = (ids[nearest] % np.uint64(MOST_INDEX) + np.uint64(1)).astype(np.uint16)
    return labels


def _range(parts):
    return labels.range_of(parts.wet.depth, parts.camera)


def _flow(parts):
    """Return motion and mask of the scene, see `labels.flow_of`; zero and seen if it is still."""
    if parts.after is None:
        shape = parts.wet.depth.shape
        return np.zeros((*shape, 2), np.float32), np.full(shape, labels.SEEN, np.uint16)
    given = parts.wet.depth, parts.camera, parts.after, parts.depth_after
    if parts.actors is None:
        return labels.flow_of(*given)
    return labels.flow_of(*given, parts.actors.number, actor_labels.moves_of(parts.actors))


def _class_id(parts):
    water = np.zeros(parts.wet.depth.shape, bool)
    kept = labels.shown_water(parts.water.record)
    water.ravel()[parts.water.pixel[kept]] = True
    ids = labels.class_ids(parts.wet, _normal(parts), parts.terrain, water)
    if parts.actors is not None:
        ids[(parts.actors.number > 0) & (ids != WATER)] = labels.OTHER_CLASS
    return ids


def _actor_id(parts):
    if parts.actors is None:
        return np.zeros(parts.wet.depth.shape, np.uint16)
    return parts.actors.number.copy()


def _puddle_id(parts):
    ids, _ = labels.puddle_map(parts.terrain, parts.state.depth)
    water = parts.water
    return labels.puddle_ids(water.pixel, water.record, parts.wet.depth.shape, parts.terrain, ids)


def _project(points, camera):
    """Return image point and depth of ground-frame points, (n, 3)."""
    matrix = camera.camera_from_world
    x, y, z = (np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z], axis=1)


def _drop_flow(parts):
    """Return the motion of drops in the picture, the mean over the drops in a pixel.

    The camera's own motion is part of it. Each drop counts with the light that it replaces; zero
    where there are none.
    """
    height, width = parts.cover.rain_alpha.shape
    flow = np.zeros((height * width, 2))
    weight = np.zeros(height * width)
    if parts.field is None:
        return flow.reshape(height, width, 2).astype(np.float32)
    camera, depth = parts.camera, parts.wet.depth
    corners = np.array([(u, v, 1.0) for u in (0, camera.width) for v in (0, camera.height)])
    rays = (corners - (camera.cx, camera.cy, 0)) / (camera.fx, camera.fy, 1)
    box = np.concatenate([rays * parts.far, np.zeros((1, 3))])
    box = box @ camera.camera_from_world[:3, :3] + camera.position
    high = box.max(axis=0) + np.array([0, 0, 0.3])  # drops that fall into view meanwhile
    found = parts.field.drops_in_box(parts.state.time, box.min(axis=0), high)
    start = _project(found.position, camera)
    view_after = camera if parts.after is None else parts.after
    after = _project(found.position + found.velocity * parts.interval, view_after)
    ahead = (start[:, 2] > NEAR) & (after[:, 2] > NEAR)
    start, after = start[ahead], after[ahead]
    cover = found.diameter[ahead] ** 2 / start[:, 2] ** 2
    opened = parts.exposure / parts.interval
    for k in range(FLOW_SAMPLES):
        part = opened * (k + 0.5) / FLOW_SAMPLES
        u, v, z = (start + part * (after - start)).T
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height) & (z < parts.far)
        at = v[inside].astype(np.int64) * width + u[inside].astype(np.int64)
        before = z[inside] < depth.ravel()[at]
        at, which = at[before], np.flatnonzero(inside)[before]
        np.add.at(weight, at, cover[which])
        np.add.at(flow, at, cover[which, None] * (after - start)[which, :2])
    flow /= np.maximum(weight, 1e-30)[:, None]
    flow[parts.cover.rain_alpha.ravel() <= 0] = 0
    return flow.reshape(height, width, 2).astype(np.float32)
