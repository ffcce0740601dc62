"""The layers (AOVs) of a frame as passes: what each is computed from, and how.

`rainsim.render.aov` says what they mean. They run after the passes of `rainsim.render.frame`, on
the CPU; of a frame that a GPU drew its buffers are fetched first.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from rainsim.numerics import srgb
from rainsim.particles.splash import LONGEST_LIFE, WET_FILM
from rainsim.particles.splash_pass import seen_splashes
from rainsim.rain.dripping import drip_impacts
from rainsim.reflection import water_record
from rainsim.reflection.water_pass import WetPicture, terms
from rainsim.render import actor_labels, labels, rain_layers
from rainsim.render.aov import spread_field
from rainsim.render.frame import WET, Pass
from rainsim.render.shutter import next_camera
from rainsim.scene.view import view_of
from rainsim.shading import composite
from rainsim.shading.dampness import find_dampness
from rainsim.shading.wet_pass import dry_picture
from rainsim.terrain.table import WATER

MOST_INDEX = 2**16 - 1
SEEN_SPLASH = 1 / 512  # share of a pixel's light from which a splash is labelled
TERMS = ("coverage", "reflection", "reflection_source", "refraction", "fresnel", "highlight",
         "water_depth")  # fmt: skip

LAYER_PASSES = (
    Pass("layer clean", WET, ("layers", "camera", "capture"), ("clean",)),
    Pass("layer wet", WET, ("picture",), ("wet",)),
    Pass("layer film", WET, ("picture", "below"), ("film",)),
    Pass("layer range", WET, ("depth", "view"), ("range",)),
    Pass("layer normal", WET, ("layers", "view"), ("normal",)),
    Pass("layer wetness", WET, ("layers", "depth", "view", "scene"), ("wetness",)),
    Pass("layer terms of the water", WET, ("seen", "reflected", "picture", "below", "depth", "view",
                                      "sun", "methods"), TERMS),
    Pass("layer transmission", WET, ("depth", "fog", "view"), ("transmission",)),
    Pass("layer splash_id", WET, ("splash_alpha", "depth", "view", "time", "render", "field",
                             "surfaces", "drips", "water", "paving"), ("splash_id",)),
    Pass("view of the next frame", WET, ("view", "view_end", "render", "interval", "scene"),
         ("next_view",)),
    Pass("layer drop_flow", WET, ("rain_alpha", "depth", "view", "next_view", "time", "render",
                                  "field", "interval"), ("drop_flow",)),
    Pass("actors", WET, ("camera", "scene", "interval"), ("actors",)),
    Pass("layer flow", WET, ("depth", "view", "next_view", "interval", "actors", "scene"),
         ("flow", "flow_mask")),
    Pass("layer actor_id", WET, ("depth", "actors"), ("actor_id",)),
    Pass("layer class_id", WET, ("layers", "depth", "clearance", "view", "seen", "actors",
                                 "ground"), ("class_id",)),
    Pass("layer puddle_id", WET, ("seen", "depth", "ground", "water"), ("puddle_id",)),
    Pass("layer beauty", WET, ("dazzling", "depth", "rain_alpha", "splash_alpha", "fog",
                               "rain_light", "view", "brightness"), ("beauty",)),
    Pass("layer dry", WET, ("layers", "camera", "capture"), ("dry",)),
    Pass("layer matte", WET, ("layers",), ("matte",)),
    Pass("layer position", WET, ("depth", "view"), ("position",)),
    Pass("layer glare", WET, ("dazzling", "shown"), ("glare",)),
    Pass("layer near_alpha", WET, ("depth", "view", "view_end", "time", "render", "field",
                                   "surfaces"), ("near_alpha",)),
    Pass("layer spray_alpha", WET, ("depth", "view", "view_end", "time", "render", "field",
                                    "throws"), ("spray_alpha",)),
    Pass("layer rain_depth", WET, ("rain_alpha", "splash_alpha", "depth", "view", "view_end",
                                   "time", "render", "field", "drips", "throws"),
         ("rain_depth",)),
)  # fmt: skip


def facts_of(names, frame, weather):
    """Return a frame's labels besides pictures, as plain JSON values.

    Parameters
    ----------
    names : sequence of str
        Layers that were made: classes are named, puddles and splashes get their boxes.
    frame : Frame
    weather : dict
        See `rainsim.render.weather.weather_of`.
    """
    facts = {"weather": weather}
    if "class_id" in names:
        facts["classes"] = labels.class_names()
    if "puddle_id" in names:
        _, puddles = labels.puddle_map(frame["ground"].terrain, frame["water"])
        boxes = labels.boxes_of(frame["puddle_id"])
        facts["puddles"] = [{**box, **puddles.get(box["id"], {})} for box in boxes]
    if "actor_id" in names and frame["actors"] is not None:
        facts["actors"] = actor_labels.facts_of_actors(frame["actors"], frame["view"])
    if "splash_id" in names:
        facts["splashes"] = labels.boxes_of(frame["splash_id"])
    return facts


def _clean(layers, camera, capture):
    color = capture.captured_color(camera, layers)
    return (np.clip(color, 0, 1) * 255 + 0.5).astype(np.uint8)


def _normal(layers, view):
    return (layers.normal @ view_of(view).ground_from_camera.T).astype(np.float32)


def _wetness(layers, depth, view, scene):
    damp, now = np.empty(depth.shape, np.float32), scene.shading
    find_dampness(
        depth, dry_picture(layers, scene.frame.meters_per_unit), now.look, view_of(view),
        now.ground, now.off_ground, damp,
    )  # fmt: skip
    return damp


def _transmission(depth, fog, view):
    clear = np.empty(depth.shape, np.float32)
    composite.find_clear(depth, fog, view_of(view), clear)
    return clear


def _water_terms(seen, reflected, picture, below, depth, view, sun, methods):
    """Return the AOVs of TERMS; zero where there is no water."""
    height, width = depth.shape
    wet = WetPicture(picture, depth, None, view_of(view), below)
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


def _splash_id(splash_alpha, depth, view, time, render, field, surfaces, drips, water, paving):
    """Return a number for each splashed pixel: that of the splash whose middle is nearest.

    A splash keeps its number from frame to frame and from camera to camera, for it comes from its
    drop; two splashes of one picture can have the same one by chance.
    """
    found = np.zeros(splash_alpha.shape, np.uint16)
    rows, columns = np.nonzero(splash_alpha > SEEN_SPLASH)
    if field is None or not len(rows):
        return found
    position, ids = seen_splashes(
        field, surfaces, view, time, render.exposure, water, WET_FILM * paving, depth,
        more=drip_impacts(*drips, surfaces, time - LONGEST_LIFE, time + render.exposure),
    )  # fmt: skip
    if not len(ids):
        return found
    place = rain_layers.project(position, view)[:, :2]
    nearest = cKDTree(place).query(np.column_stack([columns + 0.5, rows + 0.5]))[1]
    found[rows, columns] = (ids[nearest] % np.uint64(MOST_INDEX) + np.uint64(1)).astype(np.uint16)
    return found


def _next_view(view, view_end, render, interval, scene):
    """Return the next frame's camera; None where neither the camera nor anything else moves."""
    if view_end is not None:
        return next_camera(view, view_end, render.exposure / interval)
    return None if scene.capture.actors is None else view


def _actors(camera, scene, interval):
    """Return the `ActorsSeen` of the frame; None without actors."""
    actors = scene.capture.actors
    if actors is None:
        return None
    numbers = scene.capture.actor_numbers(camera)
    return actor_labels.ActorsSeen(actors.actors, actors.time, interval, scene.frame, numbers)


def _flow(depth, view, next_view, interval, actors, scene):
    """Return motion and mask of the scene, see `labels.flow_of`; zero and seen if it is still."""
    if next_view is None:
        return np.zeros((*depth.shape, 2), np.float32), np.full(depth.shape, labels.SEEN, np.uint16)
    if actors is not None:
        scene.move_actors(actors.time + interval)
    seen = scene.picture(scene.frame.camera_in_capture(next_view))
    if actors is None:
        return labels.flow_of(depth, view, next_view, seen.depth)
    scene.move_actors(actors.time)
    moves = actor_labels.moves_of(actors)
    return labels.flow_of(depth, view, next_view, seen.depth, actors.number, moves)


def _class_id(layers, depth, clearance, view, seen, actors, ground):
    water = np.zeros(depth.shape, bool)
    water.ravel()[seen.pixel[labels.shown_water(seen.record)]] = True
    wet = WetPicture(None, depth, clearance, view_of(view), None)
    ids = labels.class_ids(wet, _normal(layers, view), ground.terrain, water)
    if actors is not None:
        ids[(actors.number > 0) & (ids != WATER)] = labels.OTHER_CLASS
    return ids


def _actor_id(depth, actors):
    return np.zeros(depth.shape, np.uint16) if actors is None else actors.number


def _puddle_id(seen, depth, ground, water):
    ids, _ = labels.puddle_map(ground.terrain, water)
    return labels.puddle_ids(seen.pixel, seen.record, depth.shape, ground.terrain, ids)


def _beauty(dazzling, depth, rain_alpha, splash_alpha, fog, light, view, brightness):
    """Return the finished picture before its tone curve."""
    clear = _transmission(depth, fog, view)[..., None]
    drop, around = (spread_field(field, *depth.shape) for field in (light.drops, light.around))
    past = (1 - alpha[..., None] for alpha in (splash_alpha, rain_alpha))
    seen = composite.through_rain(dazzling, drop, around, np.asarray(light.air), clear, *past)
    return (brightness * seen).astype(np.float32)


def _dry(layers, camera, capture):
    return srgb.linear(capture.captured_color(camera, layers)).astype(np.float32)


def _position(depth, view):
    """Return the places of surfaces in the ground frame [m], zero for sky."""
    away = np.where(np.isfinite(depth), depth, 0)[..., None]
    place = labels.rays_of(view) * away @ view.camera_from_world[:3, :3] + view.position
    return np.where(away > 0, place, 0).astype(np.float32)


WORK = {
    "layer clean": _clean, "layer wet": lambda picture: picture,
    "layer film": lambda picture, below: picture - below, "layer range": labels.range_of,
    "layer normal": _normal, "layer wetness": _wetness, "layer terms of the water": _water_terms,
    "layer transmission": _transmission, "layer splash_id": _splash_id,
    "view of the next frame": _next_view, "layer drop_flow": rain_layers.drop_flow,
    "actors": _actors,
    "layer flow": _flow, "layer actor_id": _actor_id, "layer class_id": _class_id,
    "layer puddle_id": _puddle_id, "layer beauty": _beauty, "layer dry": _dry,
    "layer matte": lambda layers: np.clip(layers.alpha, 0, 1), "layer position": _position,
    "layer glare": lambda dazzling, shown: dazzling - shown,
    "layer near_alpha": rain_layers.near_alpha, "layer spray_alpha": rain_layers.spray_alpha,
    "layer rain_depth": rain_layers.rain_depth,
}  # fmt: skip
"""What each pass of LAYER_PASSES computes, see `Frame.make`."""
