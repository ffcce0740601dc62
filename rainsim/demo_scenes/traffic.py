"""The third built-in scene: the street with cars that move, as rigid nodes.

A hatchback pulls out to the middle of the road ahead of the drive; a saloon drives on before it.
Each node has its splats in a frame of its own: x ahead, z up, the tyres on z = 0.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from rainsim.demo_scenes.build import (
    content_hash,
    discs,
    join,
    quaternions,
    to_splats,
    turn_about,
)
from rainsim.demo_scenes.street import CAMERAS, FRAMES_PER_SECOND, SEED, cars, make_street, road
from rainsim.scene.actors import Actor, Track, box_of, with_actors
from rainsim.scene.types import GroundFrame

SPACING = 0.035  # m, of a car's splats
KEYS_PER_SECOND = 12  # of the tracks
TYRE_WIDTH = 0.20  # m
SHADE, SHADE_LAYERS = 0.28, 4  # opacity of a layer of the shade under a car, and their number

# shape, paint, first x [m], speed [m/s], lane y [m] at the start and at the end, height of the road
MOVING = (
    ("hatchback", cars.HATCH, (0.60, 0.09, 0.07), 7.5, 9.0, -0.55, 0.10),
    ("saloon", cars.SALOON, (0.10, 0.18, 0.42), 20.0, 11.0, 0.0, 0.0),
)


def make_traffic():
    """Generate the scene; the same arrays every time."""
    street = make_street()
    frame = street.ground_frame
    rng = np.random.Generator(np.random.PCG64(SEED + 1))
    own = GroundFrame(np.eye(3), frame.meters_per_unit, np.zeros(3))
    actors = []
    for name, shape, paint, first, speed, here, there in MOVING:
        body = cars.car(shape, np.array(paint), True, SPACING, rng)
        splats = to_splats(join([body, *_shade()]), own)
        box = box_of(to_splats(body, own))
        track = _track(frame, first, speed, here, there)
        actors.append(Actor(name, "car", splats, box, track, wheels=_wheels(frame)))
    digest = hashlib.sha256(street.source_hash.encode())
    for actor in actors:
        digest.update(content_hash(actor.splats).encode() + actor.track.position.tobytes())
    scene = with_actors(street, actors)
    return replace(scene, name="traffic", source_hash=digest.hexdigest())


def _wheels(frame):
    """Return the tyres of a car as `Actor` has them."""
    return np.array([
        (x - 0.5 * cars.LENGTH, y, 0.0, TYRE_WIDTH, cars.WHEEL)
        for x in cars.AXLES for y in (cars.TRACK, -cars.TRACK)
    ]) / frame.meters_per_unit  # fmt: skip


def _shade():
    """Yield what a car takes of the sky's light on the road below it, as faint dark splats."""
    for layer in range(SHADE_LAYERS):
        grow = 1 + 0.12 * layer
        size = np.array([[0.27 * cars.LENGTH * grow, 0.27 * cars.WIDTH * grow]])
        yield discs(
            np.array([[0.0, 0.0, 0.012 + 0.002 * layer]]), (0, 0, 1), (0.05, 0.05, 0.05), size,
            thickness=2e-3, opacity=SHADE,
        )  # fmt: skip


def _track(frame, first, speed, here, there):
    """Return the way of a car from x = `first` [m] on, from one lane to another."""
    seconds = CAMERAS / FRAMES_PER_SECOND
    time = np.arange(0, seconds + 1 / KEYS_PER_SECOND, 1 / KEYS_PER_SECOND)
    share = np.clip(time / seconds, 0, 1)
    y = here + (there - here) * share**2 * (3 - 2 * share)
    heading = np.arctan2(np.gradient(y, time), speed)
    place = np.column_stack([first + speed * time, y, np.full(len(time), road.CROWN)])
    turns = [frame.rotation.T @ turn_about((0, 0, 1), angle) for angle in heading]
    return Track(
        time, frame.to_capture(place), quaternions(np.array(turns)), np.ones(len(time), bool)
    )
