"""The built-in scene: a bicycle against a bench on a paved path, generated as splats.

Built in metres in a frame whose x runs along the path and whose origin lies before the bench, then
turned into a ground frame and taken to a capture frame that, like that of a real capture, is
tilted, has y downwards and is not metric.
"""

from functools import partial

import numpy as np
from scipy.ndimage import map_coordinates

from rainsim.demo_scenes import build
from rainsim.demo_scenes.bicycle import bench, bike, plants
from rainsim.demo_scenes.bicycle.backdrop import far_trees, sky_cloud
from rainsim.demo_scenes.bicycle.paving import bed_height, paving_cloud
from rainsim.scene.cameras import look_at
from rainsim.scene.types import Scene

SEED = 20140
BLADES = 64_000
CAMERAS = 24
WIDTH, HEIGHT = 648, 432  # px
FIELD_OF_VIEW = 60.0  # degrees, horizontal
TARGET = np.array([0.0, -0.15, 0.82])  # m, what the cameras look at
FIRST_AZIMUTH = np.radians(-118)  # of the first camera as seen from the target
METERS_PER_UNIT = 0.6
CAPTURE_TILT = (np.radians(101), np.radians(7), np.radians(-13))  # about x, y, z: y points down
CAPTURE_ORIGIN = np.array([0.35, -0.80, 1.10])  # m, where the capture frame has its origin


def make_bicycle() -> Scene:
    """Generate the scene; the same arrays every time."""
    rng = np.random.Generator(np.random.PCG64(SEED))
    noise = build.Noise(rng)
    ground = partial(bed_height, noise=noise)
    light = _ground_light()
    cloud = build.join(
        [
            paving_cloud(noise, rng, light),
            bench.bench_cloud(noise, rng),
            bike.bike_cloud(noise, ground),
            plants.lawn_cloud(noise, rng, light, BLADES),
            *(plants.bush(spot, rng) for spot in plants.BUSHES),
            *(plants.tree(spot, noise, rng) for spot in plants.TREES),
            plants.hedge(plants.HEDGE_FACES[0], 0.032, 22_000, noise, rng),
            plants.hedge(plants.HEDGE_FACES[1], 0.050, 9_000, noise, rng),
            far_trees(rng),
            sky_cloud(noise),
        ]
    )
    eyes = _eyes()
    forward = TARGET - eyes[0]
    turn = build.turn_about((0, 0, 1), -np.arctan2(forward[1], forward[0]))  # ground_from_path
    frame = build.tilted_frame(CAPTURE_TILT, METERS_PER_UNIT, CAPTURE_ORIGIN)
    splats = build.to_splats(build.moved(cloud, turn), frame)
    view = (0, 0, 1), FIELD_OF_VIEW, WIDTH, HEIGHT
    cameras = tuple(
        frame.camera_in_capture(look_at(turn @ eye, turn @ TARGET, *view, f"{k:02d}"))
        for k, eye in enumerate(eyes)
    )
    return Scene("bicycle", splats, cameras, frame, source_hash=build.content_hash(splats))


def _eyes():
    """Camera centres on a circle round the bench, 1.5 m high on average, ndarray (n, 3) [m]."""
    k = np.arange(CAMERAS)
    azimuth = FIRST_AZIMUTH + 2 * np.pi * k / CAMERAS
    distance = 3.9 + 0.35 * np.sin(2 * np.pi * 3 * k / CAMERAS)
    height = 1.5 + 0.12 * np.cos(2 * np.pi * 5 * k / CAMERAS)
    flat = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1) * distance[:, None]
    return np.column_stack([TARGET[:2] + flat, height])


def _ground_light():
    """Return a function that gives the light at points on the ground, (n, 3) to (n,).

    Overcast light throws no edges: bench and bicycle take a share of the sky, and what touches the
    ground darkens it close by.
    """
    spacing = 0.06  # m, of the table that is looked up
    x, y = np.arange(-2.6, 2.6, spacing), np.arange(-2.0, 1.6, spacing)
    xx, yy = np.meshgrid(x, y, indexing="ij")
    table = np.stack([xx, yy, 0 * xx], axis=-1).reshape(-1, 3).astype(np.float32)
    boxes = np.concatenate([bench.occluders(), bike.occluders()])
    share = build.sky_share(table, boxes, build.sky_directions(72)).reshape(xx.shape)

    def light(points):
        where = (points[:, :2] - (x[0], y[0])) / spacing
        value = map_coordinates(share, where.T, order=1, mode="constant", cval=1.0)
        for contact in bike.contacts():
            dx, dy = (points[:, :2] - contact).T
            value = value * (1 - 0.70 * np.exp(-((dx / 0.13) ** 2) - (dy / 0.032) ** 2))
            value = value * (1 - 0.38 * np.exp(-((dx / 0.28) ** 2) - (dy / 0.12) ** 2))
        for foot in bench.feet():
            dx, dy = (points[:, :2] - foot).T
            value = value * (1 - 0.60 * np.exp(-((dx / 0.055) ** 2) - (dy / 0.075) ** 2))
        face = np.minimum(
            np.abs(plants.HEDGE_FACES[0] - points[:, 1]),
            np.abs(plants.HEDGE_FACES[1] - points[:, 1]),
        )
        value = value * (1 - 0.45 * np.exp(-face / 0.45))
        for tx, ty, *_ in plants.TREES:
            d2 = ((points[:, 0] - tx) ** 2 + (points[:, 1] - ty) ** 2) / 2.2**2
            value = value * (1 - 0.40 * np.exp(-d2))
        return 0.04 + 0.96 * value**1.15

    return light
