"""The second built-in scene: a narrow shopping street on a dull afternoon, generated as splats.

A one-way road with camber, kerbs, gutters and drains, parked cars, lamp posts, lit windows. Its
cameras are a drive: 1.5 m above the crown of the road, 10 m/s at 24 frames/s. Built in metres with
x along the street, then taken to a capture frame that, like that of a real capture, is tilted, has
y downwards and is not metric.
"""

from functools import partial

import numpy as np

from rainsim.demo_scenes.bicycle.backdrop import sky_cloud
from rainsim.demo_scenes.build import Noise, content_hash, discs, join, tilted_frame, to_splats
from rainsim.demo_scenes.street import cars, footway, furniture, road
from rainsim.demo_scenes.street.facades import houses
from rainsim.demo_scenes.street.long import LongStreet
from rainsim.scene.splat_sets import joined
from rainsim.scene.types import Camera, Scene, pose_at

SEED = 1871
SPEED, FRAMES_PER_SECOND, CAMERAS = 10.0, 24.0, 40  # m/s, 1/s
EYE_HEIGHT = 1.5  # m above the crown of the road
LOOK_AHEAD, LOOK_DOWN = 14.0, 0.75  # m: the drive looks at a point so far ahead, so far below it
WIDTH, HEIGHT = 648, 432  # px
FIELD_OF_VIEW = np.radians(62)  # horizontal
METERS_PER_UNIT = 1.7
CAPTURE_TILT = (np.radians(97), np.radians(-4), np.radians(21))  # about x, y, z: y points down
CAPTURE_ORIGIN = np.array([6.0, 0.4, 1.9])  # m, where the capture frame has its origin
SKY_RADIUS, SKY_SPLATS = 120.0, 3600


def make_street() -> Scene:
    """Generate the scene; the same arrays every time."""
    rng = np.random.Generator(np.random.PCG64(SEED))
    noise = Noise(rng)
    fronts, windows = houses(noise, rng, road.ENDS, road.FACADE)
    light = road.ground_light(cars.footprints())
    glows = np.concatenate([windows, cars.lamp_glows(), furniture.lamp_glows()])
    ground = join(
        [road.road_cloud(noise, rng), footway.footway_cloud(noise, rng), _leaves(noise, rng)]
    )
    cloud = join(
        [
            road.lit_ground(ground, light, glows),
            fronts,
            cars.parked_cars(rng),
            furniture.furniture(rng),
            sky_cloud(noise, SKY_SPLATS, SKY_RADIUS),
        ]
    )
    frame = tilted_frame(CAPTURE_TILT, METERS_PER_UNIT, CAPTURE_ORIGIN)
    splats = to_splats(cloud, frame)
    cameras = tuple(frame.camera_in_capture(camera) for camera in _drive())
    height = partial(road.bed_height, noise=noise)
    drains = np.column_stack([road.DRAINS, height(*road.DRAINS.T)])
    return Scene(
        "street", splats, cameras, frame, source_hash=content_hash(splats),
        drains=tuple(map(tuple, frame.to_capture(drains))),
    )  # fmt: skip


def make_long_street(length) -> Scene:
    """Generate a street of a length [m]; the same arrays every time."""
    street = LongStreet(length, SEED, _leaves)
    frame = tilted_frame(CAPTURE_TILT, METERS_PER_UNIT, CAPTURE_ORIGIN)
    splats = joined([to_splats(piece, frame) for piece in street.pieces()])
    return Scene(
        f"street:{length:g}", splats, tuple(long_drive(street, frame)), frame,
        source_hash=content_hash(splats), drains=long_drains(street, frame),
    )  # fmt: skip


def long_drive(street, frame):
    """Yield the cameras of the drive along a `LongStreet` in the capture frame."""
    crown = road.crown_of(street.layout)
    for camera in _drive(1 + int(street.drive * FRAMES_PER_SECOND / SPEED), crown):
        yield frame.camera_in_capture(camera)


def long_drains(street, frame):
    """Return the drains of a `LongStreet` as `Scene` has them."""
    drains = street.layout.drains
    height = street.bed_height()(*drains.T)
    return tuple(map(tuple, frame.to_capture(np.column_stack([drains, height]))))


def _drive(count=CAMERAS, crown=road.CROWN):
    """Yield the cameras of the drive in the ground frame [m]."""
    focal = float(WIDTH / 2 / np.tan(FIELD_OF_VIEW / 2))
    fall = np.arctan2(LOOK_DOWN, LOOK_AHEAD)
    forward = np.array([np.cos(fall), 0.0, -np.sin(fall)])
    right = np.array([0.0, -1.0, 0.0])
    axes = np.array([right, np.cross(forward, right), forward])
    for k in range(count):
        pose = pose_at(axes, np.array([k * SPEED / FRAMES_PER_SECOND, 0.0, crown + EYE_HEIGHT]))
        yield Camera(WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, pose, f"{k:02d}")


def _leaves(noise, rng, count=420, first=1.0, last=30.0, layout=road.LAYOUT):
    """Return fallen leaves, most of them in the gutters."""
    side = np.where(rng.random(count) < 0.5, -1, 1)
    away = np.where(rng.random(count) < 0.7, road.KERB - rng.gamma(1.5, 0.12, count),
                    rng.uniform(0.2, road.FACADE, count))  # fmt: skip
    x = rng.uniform(first, last, count)
    y = side * np.clip(away, 0.1, road.FACADE)
    z = road.bed_height(x, y, noise, layout) + rng.uniform(0.002, 0.004, count)
    turn, size = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.014, 0.026, count)
    palette = np.array([(0.52, 0.36, 0.10), (0.40, 0.22, 0.08), (0.34, 0.25, 0.12)])
    colour = palette[rng.integers(0, 3, count)] * rng.uniform(0.75, 1.15, (count, 1))
    along = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    shape = np.stack([size, size * rng.uniform(0.5, 0.75, count)], axis=1)
    return discs(np.stack([x, y, z], axis=1), (0, 0, 1), colour, shape, along=along, sheen=0.1)
