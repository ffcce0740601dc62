"""The layers (AOVs) of a frame as passes: what each is computed from, and how.

`rainsim.render.aov` says what they mean. They run after the passes of `rainsim.render.frame`, on
the CPU; of a frame that a GPU drew its buffers are fetched first.
"""

import numpy as np
from scipy.spatial import cKDTree

from rainsim.constants import FAR_AWAY
from rainsim.numerics import srgb
from rainsim.particles.splash import LONGEST_LIFE, WET_FILM
from rainsim.particles.splash_pass import seen_splashes
from rainsim.rain.dripping import drip_impacts
from rainsim.reflection import water_record
from rainsim.reflection.water_pass import WetPicture, terms
from rainsim.render import actor_labels, labels, rain_layers
from rainsim.render.aov import spread_field
from rainsim.render.frame import Pass, parameters_of
from rainsim.render.shutter import next_camera
from rainsim.scene.view import pixel_rays
from rainsim.shading import composite
from rainsim.shading.dampness import find_dampness
from rainsim.terrain.table import WATER

MOST_INDEX = 2**16 - 1
SEEN_SPLASH = 1 / 512  # share of a pixel's light from which a splash is labelled
TERMS = ("coverage", "reflection", "reflection_source", "refraction", "fresnel", "highlight",
         "water_depth")  # fmt: skip

# The layer of depth is a label; the buffer of that name is of what is drawn and hides drops.
BUFFERS = {"depth": "surface_depth", "drawn_depth": "depth"}

LAYER_PASSES, WORK = [], {}  # in the order of this file; what each computes, see `Frame.make`


def layer(*writes, name=""):
    """Make a pass of a function: it reads the inputs and buffers that its parameters are named for.

    *writes : str. The layers, or other buffers, that it returns.
    name : str. Of the pass; by default that of the layer.
    """

    def passed(compute):
        called = name or f"layer {writes[0]}"
        LAYER_PASSES.append(Pass(called, tuple(parameters_of(compute)), writes))
        WORK[called] = compute
        return compute

    return passed


def buffers_of(names):
    """Return the buffers of a `Frame` that hold layers of these names."""
    return [BUFFERS.get(name, name) for name in names]


def facts_of(names, frame, weather):
    """Return a frame's labels besides pictures, as plain JSON values.

    names : sequence of str. Layers that were made: classes are named, puddles and
        splashes get their boxes.
    weather : dict. See `rainsim.render.weather.weather_of`.
    """
    facts = {"weather": weather}
    if "class_id" in names:
        facts["classes"] = labels.class_names()
    if "puddle_id" in names:
        _, puddles = frame["puddles"]
        boxes = labels.boxes_of(frame["puddle_id"])
        facts["puddles"] = [{**box, **puddles.get(box["id"], {})} for box in boxes]
    if "actor_id" in names and frame["actors"] is not None:
        facts["actors"] = actor_labels.facts_of_actors(frame["actors"], frame["ground_camera"])
    if "splash_id" in names:
        facts["splashes"] = labels.boxes_of(frame["splash_id"])
    return facts


@layer("clean")
def _clean(layers, camera, capture):
    color = capture.captured_color(camera, layers)
    return (np.clip(color, 0, 1) * 255 + 0.5).astype(np.uint8)


@layer("wet")
def _wet(picture):
    return picture


@layer("film")
def _film(picture, below):
    return picture - below


@layer("surface_depth")
def _surface_depth(layers, view, scene):
    return scene.depth_of(layers, view)


@layer("range")
def _range(surface_depth, ground_camera):
    return labels.range_of(surface_depth, ground_camera)


@layer("height")
def _height(clearance):
    return np.where(clearance < FAR_AWAY, clearance, np.float32(np.inf))


@layer("normal")
def _normal(layers, view):
    return (layers.normal @ view.ground_from_camera.T).astype(np.float32)


@layer("wetness", "matte", name="wet and covered shares")
def _wet_shares(layers, depth, view, scene):
    damp, matte = (np.empty(depth.shape, np.float32) for _ in range(2))
    now = scene.shading
    find_dampness(depth, scene.dry(layers), now.look, view, now.ground, now.off_ground, damp, matte)
    return damp, matte


@layer("transmission")
def _transmission(depth, fog, view):
    clear = np.empty(depth.shape, np.float32)
    composite.find_clear(depth, fog, view, clear)
    return clear


@layer(*TERMS, name="layer terms of the water")
def _water_terms(seen, reflected, picture, below, depth, view, sun, methods):
    """Return the AOVs of TERMS; zero where there is no water."""
    height, width = depth.shape
    wet = WetPicture(picture, depth, None, view, below)
    through, share, glint = terms(seen, methods, wet, sun)

    def spread(values, dtype=np.float32):
        out = np.zeros((height * width, *values.shape[1:]), dtype)
        out[seen.pixel] = values
        return out.reshape(height, width, *values.shape[1:])

    return (
        spread(seen.record[:, water_record.COVERAGE]), spread(seen.light),
        spread(seen.source + 1, np.uint16), spread(through), spread(share), spread(glint),
        spread(seen.record[:, water_record.WATER_DEPTH]),
    )  # fmt: skip


@layer("splash_id")
def _splash_id(
    splash_alpha, depth, ground_camera, time, render, field, surfaces, drips, water, paving
):
    """Return a number for each splashed pixel: that of the splash whose middle is nearest.

    A splash keeps its number from frame to frame and from camera to camera, for it comes from its
    drop; two splashes of one picture can have the same one by chance.
    """
    found = np.zeros(splash_alpha.shape, np.uint16)
    rows, columns = np.nonzero(splash_alpha > SEEN_SPLASH)
    if field is None or not len(rows):
        return found
    position, ids = seen_splashes(
        field, surfaces, ground_camera, time, render.exposure, water, WET_FILM * paving, depth,
        more=drip_impacts(*drips, surfaces, time - LONGEST_LIFE, time + render.exposure),
    )  # fmt: skip
    if not len(ids):
        return found
    place = rain_layers.project(position, ground_camera)[:, :2]
    nearest = cKDTree(place).query(np.column_stack([columns + 0.5, rows + 0.5]))[1]
    found[rows, columns] = (ids[nearest] % np.uint64(MOST_INDEX) + np.uint64(1)).astype(np.uint16)
    return found


@layer("next_ground_camera", name="camera of the next frame")
def _next_camera(ground_camera, ground_camera_end, render, interval, scene):
    """Return the next frame's camera; None where neither the camera nor anything else moves."""
    if ground_camera_end is not None:
        return next_camera(ground_camera, ground_camera_end, render.exposure / interval)
    return None if scene.capture.actors is None else ground_camera


@layer("actors", name="actors")
def _actors(camera, scene, interval):
    """Return the `ActorsSeen` of the frame; None without actors."""
    actors = scene.capture.actors
    if actors is None:
        return None
    numbers = scene.capture.actor_numbers(camera)
    return actor_labels.ActorsSeen(actors.actors, actors.time, interval, scene.frame, numbers)


@layer("flow", "flow_mask")
def _flow(surface_depth, ground_camera, next_ground_camera, interval, actors, scene):
    """Return motion and mask of the scene, see `labels.flow_of`; zero and seen if it is still."""
    if next_ground_camera is None:
        shape = surface_depth.shape
        return np.zeros((*shape, 2), np.float32), np.full(shape, labels.SEEN, np.uint16)
    if actors is not None:
        scene.move_actors(actors.time + interval)
    after = scene.surface_depth(scene.frame.camera_in_capture(next_ground_camera))
    own = ()
    if actors is not None:
        scene.move_actors(actors.time)
        own = actors.number, actor_labels.moves_of(actors)
    return labels.flow_of(surface_depth, ground_camera, next_ground_camera, after, *own)


@layer("class_id")
def _class_id(layers, depth, clearance, view, seen, actors, ground):
    upright = (layers.normal @ view.ground_from_camera[2]).astype(np.float32)
    water = seen.pixel[labels.shown_water(seen.record)]
    ids = labels.class_ids(view, depth, clearance, upright, ground.terrain, water)
    if actors is not None:
        ids[(actors.number > 0) & (ids != WATER)] = labels.OTHER_CLASS
    return ids


@layer("actor_id")
def _actor_id(depth, actors):
    return np.zeros(depth.shape, np.uint16) if actors is None else actors.number


@layer("puddles", name="puddles of the map")
def _puddles(ground, water):
    return labels.puddle_map(ground.terrain, water)


@layer("puddle_id")
def _puddle_id(seen, depth, ground, puddles):
    return labels.puddle_ids(seen.pixel, seen.record, depth.shape, ground.terrain, puddles[0])


@layer("beauty")
def _beauty(dazzling, depth, rain_alpha, splash_alpha, fog, rain_light, view, brightness):
    """Return the finished picture before its tone curve."""
    clear = _transmission(depth, fog, view)[..., None]
    both = rain_light.drops, rain_light.around
    drop, around = (spread_field(field, *depth.shape) for field in both)
    past = (1 - alpha[..., None] for alpha in (splash_alpha, rain_alpha))
    seen = composite.through_rain(dazzling, drop, around, np.asarray(rain_light.air), clear, *past)
    return (brightness * seen).astype(np.float32)


@layer("clear_air")
def _clear_air(dazzling, brightness):
    """Return the finished picture as it would be if nothing fell, in its tone curve."""
    image = np.empty(dazzling.shape, np.uint8)
    composite.encode((brightness * dazzling).astype(np.float32).ravel(), image.ravel())
    return image


@layer("dry")
def _dry(layers, camera, capture):
    return srgb.linear(capture.captured_color(camera, layers)).astype(np.float32)


@layer("position")
def _position(surface_depth, ground_camera):
    """Return the places of surfaces in the ground frame [m], zero for sky."""
    away = np.where(np.isfinite(surface_depth), surface_depth, 0)[..., None]
    turn = ground_camera.camera_from_world[:3, :3]
    place = pixel_rays(ground_camera) * away @ turn + ground_camera.position
    return np.where(away > 0, place, 0).astype(np.float32)


@layer("glare")
def _glare(dazzling, shown, render):
    # A GPU's finished picture differs by rounding from the one that is made again without halos.
    return np.zeros_like(dazzling) if render.glare == "off" else dazzling - shown


layer("falling", name="drops of the picture")(rain_layers.find_falling)
for _name in ("drop_flow", "near_alpha", "spray_alpha", "rain_depth"):
    layer(_name)(getattr(rain_layers, _name))
layer("near_depth", "streak_depth", "spray_depth")(rain_layers.element_depths)
