"""The third built-in scene: the street with cars that move, as actors.

A hatchback pulls out to the middle of the road ahead of the drive; a saloon drives on before it. On
a street of a given length cars also cross at the side streets, and wait there.
Each actor has its splats in a frame of its own: x ahead, z up, the tyres on z = 0.
"""

import hashlib
from dataclasses import replace

import numpy as np

from rainsim.actors.actor import Actor, box_of, with_actors
from rainsim.actors.motion import Track
from rainsim.demo_scenes.build import content_hash, discs, join, quaternions, to_splats, turn_about
from rainsim.demo_scenes.street import (
    CAMERAS,
    FRAMES_PER_SECOND,
    SEED,
    SPEED,
    cars,
    make_long_street,
    make_street,
    road,
)
from rainsim.demo_scenes.street.long import LongStreet
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

# of a long street: name, shape, paint, first x [m], by how much the distance varies [m]
AHEAD = (
    ("hatchback", cars.HATCH, (0.60, 0.09, 0.07), 9.5, 1.2),
    ("saloon", cars.SALOON, (0.10, 0.18, 0.42), 27.0, 2.0),
)
SIDE_CARS = (
    (cars.SALOON, (0.42, 0.42, 0.43)), (cars.HATCH, (0.10, 0.20, 0.14)),
    (cars.VAN, (0.58, 0.58, 0.57)), (cars.HATCH, (0.12, 0.12, 0.13)),
    (cars.HATCH, (0.50, 0.33, 0.08)),
)  # fmt: skip
SIDE_LANE = 1.35  # m from the middle of a side street to the middle of its lanes
CROSSING_SPEED = 7.5  # m/s
CROSSED_BEFORE = 3.9  # s before the drive arrives that the crossing car is in the middle
LINE, SLOWING, STOPPED_BEFORE = 6.3, 3.0, 3.5  # m from the middle; s of braking; s before the drive


def make_traffic():
    """Generate the scene; the same arrays every time."""
    street = make_street()
    frame = street.ground_frame
    rng = np.random.Generator(np.random.PCG64(SEED + 1))
    actors = []
    for name, shape, paint, first, speed, here, there in MOVING:
        track = _track(frame, first, speed, here, there)
        actors.append(_car(name, shape, paint, track, frame, rng))
    return _joined(street, actors, "traffic")


def make_long_traffic(length):
    """Generate a street of a length [m] with cars that drive ahead, cross, and give way."""
    street = make_long_street(length)
    frame = street.ground_frame
    rng = np.random.Generator(np.random.PCG64(SEED + 2))
    layout = LongStreet(length, SEED, None).layout
    seconds = (len(street.cameras) - 1) / FRAMES_PER_SECOND
    actors = []
    for name, shape, paint, first, sway in AHEAD:
        time = np.arange(0, seconds + 1 / KEYS_PER_SECOND, 1 / KEYS_PER_SECOND)
        x = first + SPEED * time + sway * np.sin(0.35 * time + first)
        y = 0.12 * np.sin(0.6 * time + first)
        track = _way(frame, time, x, y, 0.0, road.crown_of(layout))
        actors.append(_car(name, shape, paint, track, frame, rng))
    for k, middle in enumerate(layout.sides):
        arrival = middle / SPEED  # s at which the camera is there
        for name, way in (("cross", _crossing), ("wait", _waiting)):
            shape, paint = SIDE_CARS[(2 * k + (name == "wait")) % len(SIDE_CARS)]
            time, x, y, heading = way(middle, arrival)
            there = (time >= 0) & (time <= seconds)
            if there.sum() < 2:
                continue
            track = _way(frame, time[there], x[there], y[there], heading, road.crown_of(layout))
            seen = np.ones(there.sum(), bool)
            seen[-1] = False
            track = replace(track, visible=seen)
            actors.append(_car(f"{name}-{k + 1}", shape, paint, track, frame, rng))
    return _joined(street, actors, f"traffic:{length:g}")


def _joined(street, actors, name):
    """Return a street with actors as a scene of its own."""
    digest = hashlib.sha256(street.source_hash.encode())
    for actor in actors:
        digest.update(content_hash(actor.splats).encode() + actor.track.position.tobytes())
    scene = with_actors(street, actors)
    return replace(scene, name=name, source_hash=digest.hexdigest())


def _car(name, shape, paint, track, frame, rng):
    """Return a car as an actor that follows a track."""
    own = GroundFrame(np.eye(3), frame.meters_per_unit, np.zeros(3))
    body = cars.car(shape, np.array(paint), True, SPACING, rng)
    splats = to_splats(join([body, *_shade()]), own)
    return Actor(name, "car", splats, box_of(to_splats(body, own)), track, wheels=_wheels(frame))


def _crossing(middle, arrival):
    """Return times [s], x, y [m] and heading [rad] of a car that crosses ahead of the drive."""
    time = np.arange(arrival - 10.0, arrival + 2.5, 1 / KEYS_PER_SECOND)
    y = CROSSING_SPEED * (time - (arrival - CROSSED_BEFORE))
    return time, np.full(len(time), middle + SIDE_LANE), y, 0.5 * np.pi


def _waiting(middle, arrival):
    """Return the same of a car that comes to the line of a side street and gives way."""
    time = np.arange(arrival - 10.0, arrival + 1.5, 1 / KEYS_PER_SECOND)
    stop = arrival - STOPPED_BEFORE
    left = np.maximum(stop - time, 0)  # s until it stands
    away = np.where(left < SLOWING, left**2 / (2 * SLOWING), left - 0.5 * SLOWING)
    y = LINE + CROSSING_SPEED * away
    return time, np.full(len(time), middle - SIDE_LANE), y, -0.5 * np.pi


def _wheels(frame):
    """Return the tyres of a car as `Actor` has them."""
    return np.array([
        (x - 0.5 * cars.LENGTH, y, 0.0, TYRE_WIDTH, cars.WHEEL)
        for x in cars.AXLES for y in (cars.TRACK, -cars.TRACK)
    ]) / frame.meters_per_unit  # fmt: skip


def _shade():
    """Yield faint dark splats: the shade of a car from the sky's light on the road below it."""
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
    return _way(frame, time, first + speed * time, y, heading, road.CROWN)


def _way(frame, time, x, y, heading, height):
    """Return a car's track through places [m] of the ground frame, its tyres at a height [m]."""
    place = np.column_stack([x, y, np.full(len(time), height)])
    heading = np.broadcast_to(heading, len(time))
    turns = [frame.rotation.T @ turn_about((0, 0, 1), angle) for angle in heading]
    return Track(
        time, frame.to_capture(place), quaternions(np.array(turns)), np.ones(len(time), bool)
    )
