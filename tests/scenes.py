"""Tiny scenes: just enough splats for every stage to have something to do."""

import numpy as np
from scipy.spatial.transform import Rotation

import factories
from rainsim.render.shutter import moved
from rainsim.scene.types import Camera, GroundFrame, Scene, Splats

DIP_DEPTH, DIP_RADIUS, DIP_CENTRE = 0.010, 0.30, (0.45, -0.35)  # m
TABLE_CENTRE, TABLE_HALF, TABLE_HEIGHT = (-0.35, 0.35), 0.22, 0.42  # m


def one_splat(position=(0.0, 0.0, 2.0), scale=0.1, opacity=0.8, color=(0.6, 0.3, 0.2)):
    """A round splat of one colour in the capture frame."""
    return factories.splats([position], scale=scale, opacity=opacity, color=color)


def ground_frame():
    """A similarity far from the identity: tilted, turned, scaled and moved."""
    rotation = _rotation(0.4, 0) @ _rotation(-2.0, 1) @ _rotation(1.1, 2)
    return GroundFrame(rotation, 0.6, np.array([0.3, -0.2, 0.7]), 1.0, ("made for a test",))


def bed_height(x, y):
    """The true ground of `tiny_scene` [m]: level but for one dip."""
    away = (x - DIP_CENTRE[0]) ** 2 + (y - DIP_CENTRE[1]) ** 2
    return -DIP_DEPTH * np.exp(-away / (2 * (DIP_RADIUS / 2) ** 2))


def tiny_scene(width=64, height=48, table=TABLE_HALF):
    """A paved 2 x 2 m ground with a 10 mm dip and a table, some 3000 splats, three cameras.

    `table` is half the side of its top [m].
    """
    frame = ground_frame()
    rng = np.random.default_rng(5)
    parts = [_paving(rng), *_table(table)]
    position, scale, color = (np.concatenate(each) for each in zip(*parts, strict=True))
    splats = factories.splats(
        frame.to_capture(position), _quaternion(frame.rotation.T), scale / frame.meters_per_unit,
        0.97, color=color,
    )  # fmt: skip
    eyes = [(-1.3, -0.9, 1.0), (-0.2, -1.6, 1.2), (1.4, -0.8, 0.9)]
    cameras = [
        frame.camera_in_capture(looking(eye, (0.1, 0.0, 0.1), width, height, name=f"view_{n}"))
        for n, eye in enumerate(eyes)
    ]
    return Scene("tiny", splats, tuple(cameras), frame, None, "0" * 64, ())


def _paving(rng, side=50):
    step = 2.0 / side
    x, y = np.meshgrid((np.arange(side) + 0.5) * step - 1, (np.arange(side) + 0.5) * step - 1)
    position = np.stack([x, y, bed_height(x, y)], axis=-1).reshape(-1, 3)
    scale = np.broadcast_to([0.7 * step, 0.7 * step, 0.5e-3], position.shape)
    grey = 0.45 + 0.1 * rng.random((len(position), 1))
    return position, scale, grey * np.array([1.0, 0.97, 0.92])


def _table(half, side=14):
    """Yield the table's top and underside, and its four legs."""
    step = 2 * half / side
    u = (np.arange(side) + 0.5) * step - half
    x, y = np.meshgrid(u + TABLE_CENTRE[0], u + TABLE_CENTRE[1])
    for z in (TABLE_HEIGHT, TABLE_HEIGHT - 0.03):
        position = np.stack([x, y, np.full_like(x, z)], axis=-1).reshape(-1, 3)
        scale = np.broadcast_to([0.7 * step, 0.7 * step, 1e-3], position.shape)
        yield position, scale, np.broadcast_to([0.5, 0.3, 0.15], position.shape)
    for sx in (-1, 1):
        for sy in (-1, 1):
            z = np.linspace(0.02, TABLE_HEIGHT - 0.05, 12)
            corner = np.array(TABLE_CENTRE) + 0.85 * half * np.array([sx, sy])
            position = np.column_stack([np.tile(corner, (len(z), 1)), z])
            scale = np.broadcast_to([0.012, 0.012, 0.025], position.shape)
            yield position, scale, np.broadcast_to([0.35, 0.2, 0.1], position.shape)


def looking(eye, target, width, height, focal=None, name=""):
    """A camera with z up in the picture; without a focal length [px] 60 degrees wide."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = right, np.cross(forward, right), forward
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    focal = width / 2 / np.tan(np.radians(30)) if focal is None else focal
    return Camera(width, height, focal, focal, width / 2, height / 2, matrix, name)


def walk(scene):
    """Return the first camera, and where it is a frame later, .4 m to its right."""
    frame = scene.ground_frame
    here = frame.camera_in_ground(scene.cameras[0])
    there = moved(here, 0.4 * here.camera_from_world[0, :3], np.zeros(3))
    return [scene.cameras[0], frame.camera_in_capture(there)]


def _rotation(angle, axis):
    return Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()


def _quaternion(rotation):
    """w, x, y, z of a rotation matrix, w not negative."""
    return Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)


BOX_SIZE = np.array([0.30, 0.22, 0.28])  # m
BOX_WAY = ((0.78, -0.75, 0.0), (0.78, 0.25, 0.6))  # x, y [m] and heading [rad] at 0 s and at 1 s


def moving_scene(way=BOX_WAY, visible=(True, True), **size):
    """`tiny_scene` with a box that stands on the ground and moves past the dip, as an actor."""
    from rainsim.actors.actor import Actor, with_actors
    from rainsim.actors.motion import Track
    from rainsim.demo_scenes.build import box, join, quaternions, to_splats, turn_about

    scene = tiny_scene(**size)
    frame, half = scene.ground_frame, BOX_SIZE / 2
    body = box((0, 0, half[2]), half - 0.004, (0.75, 0.15, 0.10), spacing=0.015, stretch=1.0)
    stripe = box((0, 0, 0.16), (half[0] - 0.002, half[1] - 0.002, 0.03), (0.9, 0.85, 0.2),
                 spacing=0.015, stretch=1.0)  # fmt: skip
    own = _rotation(0.5, 1) @ _rotation(-1.2, 0)  # upright to actor frame: any frame will do
    placed = GroundFrame(own.T, frame.meters_per_unit, np.zeros(3))
    splats = to_splats(join([body, stripe]), placed)
    splats = Splats(splats.position, splats.rotation, splats.scale, splats.opacity,
                    np.ascontiguousarray(splats.sh[:, :1]))  # fmt: skip
    centre = own @ np.array([0, 0, half[2]]) / frame.meters_per_unit
    time = np.arange(len(way), dtype=float)
    turns = [frame.rotation.T @ turn_about((0, 0, 1), heading) @ own.T for *_, heading in way]
    ground = np.array([(x, y, 0.002) for x, y, _ in way])
    track = Track(
        time, frame.to_capture(ground), quaternions(np.array(turns)), np.array(visible[: len(way)])
    )
    # The actor frame is tilted against the box: its box is the upright one's bound there.
    reach = np.abs(own) @ half * 2 / frame.meters_per_unit
    return with_actors(scene, [Actor("box", "parcel", splats, np.stack([centre, reach]), track)])


def rolling_scene(**size):
    """The box of `moving_scene` on four wheels."""
    from dataclasses import replace

    plain = moving_scene(**size)
    (actor,) = plain.actors
    unit = plain.ground_frame.meters_per_unit
    turn = actor.track.first_seen.rotation.T @ plain.ground_frame.rotation.T
    at = [(x * BOX_SIZE[0], y * BOX_SIZE[1], 0.0) for x in (0.4, -0.4) for y in (0.4, -0.4)]
    wheels = np.column_stack([np.array(at) @ turn.T, np.tile([0.05, 0.05], (4, 1))]) / unit
    return replace(plain, actors=(replace(actor, wheels=wheels),))


LAMP = (1.06, -0.16, 0.35)  # m, whose image the first camera sees in the water of the dip


def lamp_scene():
    """`tiny_scene` with a lamp over the ground: clipped at white, and shining."""
    from dataclasses import replace

    from rainsim.scene.lamps import Lamp, with_lamps
    from rainsim.scene.splat_sets import joined

    scene = tiny_scene()
    frame = scene.ground_frame
    steps = np.linspace(-0.06, 0.06, 5)
    grid = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    place = np.array(LAMP) + np.insert(grid, 0, 0.0, axis=1)
    glow = joined([one_splat(p, scale=0.02 / frame.meters_per_unit, color=(1.0, 0.8, 0.5))
                   for p in frame.to_capture(place)])  # fmt: skip
    centre = frame.to_capture(np.array([LAMP]))[0]
    lit, _ = with_lamps(glow, [Lamp("brake", centre, 0.3)])
    return tuple(replace(scene, splats=joined([scene.splats, part])) for part in (glow, lit))
