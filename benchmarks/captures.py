"""Synthetic captures whose ground is known: splats and cameras as a trained capture has them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.constants import SH_0
from rainsim.scene.cameras import look_at
from rainsim.scene.types import GroundFrame, Scene, Splats

PAVING, LAWN, WOOD, SKY = (0.55, 0.52, 0.48), (0.35, 0.5, 0.2), (0.4, 0.28, 0.15), (0.7, 0.75, 0.8)
LAWN_HEIGHT = 0.05  # m of the blades above the soil
DIP_DEPTH, DIP_WIDTH = 5e-3, 0.30  # m
KERB_HEIGHT, KERB_X = 0.12, 1.0  # m
TABLE = (-1.0, -1.0, 0.5, 0.72)  # m: x, y, half width, height
STREET_LENGTH, STREET_HALF, STREET_RISE, CAMBER = 300.0, 4.0, 0.03, 0.025


@dataclass(frozen=True)
class Truth:
    """The ground truth of a synthetic capture."""

    frame: GroundFrame  # the capture's true ground frame
    bed: object  # bed(x, y) [m]
    dips: np.ndarray  # (n, 2), centres [m]
    half: float  # m, half width of the paving, about the middle


def random_frame(rng, tilt=40.0):
    """Return a random ground frame: up to `tilt` degrees off z, any heading, scale and origin."""
    axis, angle = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(0, tilt))
    turn = rng.uniform(0, 2 * np.pi)
    lean = Rotation.from_rotvec((-angle * np.cos(axis), -angle * np.sin(axis), 0.0))
    rotation = (Rotation.from_rotvec((0.0, 0.0, -turn)) * lean).as_matrix()
    return GroundFrame(rotation, float(rng.uniform(0.2, 3.0)), rng.normal(size=3))


def yard(seed, noise=1e-3, floaters=0.3, kerb=False, step=0.025):
    """Return the Scene (in its capture frame) and Truth of a paved yard in a lawn.

    Eight dips, a table, a sky and floaters, 24 cameras in a ring; `noise` [m] is the standard
    deviation of the splats' heights, `floaters` the share of splats that hang at random in the air.
    """
    rng = np.random.default_rng(seed)
    half = 2.2
    dips = _dips(rng, half, kerb)

    def bed(x, y):
        z = np.zeros(np.broadcast(x, y).shape)
        for cx, cy in dips:
            r = np.hypot(x - cx, y - cy) / (DIP_WIDTH / 2)
            z -= np.where(r < 1, DIP_DEPTH * (1 - np.minimum(r, 1) ** 2), 0)
        # A crown, so that water leaves the paving where there is no dip.
        z += 0.003 * (half * half - np.minimum(x * x + y * y, 2 * half * half)) / half
        return z + (np.where(x > KERB_X, KERB_HEIGHT, 0) if kerb else 0)

    x, y = _lattice(rng, 4.0, step)
    lawn = np.maximum(np.abs(x), np.abs(y)) > half
    z = bed(x, y) + rng.normal(0, noise, x.shape)
    z[lawn] += rng.uniform(0.0, LAWN_HEIGHT, lawn.sum())
    color = np.where(lawn[:, None], LAWN, PAVING) + rng.normal(0, 0.02, (len(x), 3))
    parts = [(np.stack([x, y, z], 1), color, 0.7 * step, 0.95)]
    tx, ty = _lattice(rng, TABLE[2], step)
    top = np.stack([tx + TABLE[0], ty + TABLE[1], np.full(len(tx), TABLE[3])], 1)
    top[:, 2] += bed(*TABLE[:2])
    parts.append((top, np.tile(WOOD, (len(tx), 1)), 0.7 * step, 0.95))
    parts += _air(rng, len(x), floaters, 4.0)
    eyes = _ring(rng, 3.2, 1.5)
    scene = _scene(rng, parts, eyes, (0, 0, 0.3), f"yard-{seed}")
    return scene, Truth(scene.ground_frame, bed, dips, half)


def street(seed, noise=2e-3, step=0.08):
    """Return the Scene and Truth of a 300 m street with camber, kerbs and a hill and a dip."""
    rng = np.random.default_rng(seed)

    def bed(x, y):
        rise = STREET_RISE * STREET_LENGTH / (2 * np.pi) * np.sin(2 * np.pi * x / STREET_LENGTH)
        kerb = np.where(np.abs(y) > STREET_HALF, KERB_HEIGHT, 0)
        return rise - CAMBER * np.minimum(np.abs(y), STREET_HALF) + kerb

    u = np.arange(-STREET_LENGTH / 2, STREET_LENGTH / 2, step)
    v = np.arange(-6.0, 6.0, step)
    x, y = (a.ravel() + rng.uniform(-step / 3, step / 3, a.size) for a in np.meshgrid(u, v))
    z = bed(x, y) + rng.normal(0, noise, x.shape)
    color = np.tile(PAVING, (len(x), 1)) + rng.normal(0, 0.02, (len(x), 3))
    parts = [(np.stack([x, y, z], 1), color, 0.7 * step, 0.95)]
    parts += _air(rng, len(x), 0.05, 20.0)
    along = np.linspace(-STREET_LENGTH / 2 + 5, STREET_LENGTH / 2 - 5, 60)
    eyes = np.stack([along, rng.uniform(-1, 1, 60), bed(along, 0 * along) + 1.6], 1)
    scene = _scene(rng, parts, eyes, None, f"street-{seed}", tilt=5.0)
    return scene, Truth(scene.ground_frame, bed, np.zeros((0, 2)), STREET_HALF)


def fold(seed, degrees, share=0.5, noise=2e-3, step=0.05):
    """Return the Scene and Truth of two wide planes that meet in a line.

    One plane is level and covers `share` of 8 x 8 m; the other rises from it by `degrees`, or falls
    if negative.
    """
    rng = np.random.default_rng(seed)
    place = 8 * share - 4
    rise = np.tan(np.radians(degrees))

    def bed(x, y):
        return np.maximum(x - place, 0) * rise + 0 * y

    x, y = _lattice(rng, 4.0, step)
    z = bed(x, y) + rng.normal(0, noise, x.shape)
    color = np.tile(PAVING, (len(x), 1)) + rng.normal(0, 0.02, (len(x), 3))
    parts = [(np.stack([x, y, z], 1), color, 0.7 * step, 0.95), *_air(rng, len(x), 0.3, 4.0)]
    eyes = _ring(rng, 3.2, 1.5)
    eyes[:, 2] += bed(eyes[:, 0], eyes[:, 1])
    scene = _scene(rng, parts, eyes, (0, 0, 0.3), f"fold-{seed}")
    return scene, Truth(scene.ground_frame, bed, np.zeros((0, 2)), 4.0)


def _dips(rng, half, kerb):
    """Return centres of dips that do not touch each other, the rim or the kerb."""
    found = []
    while len(found) < 8:
        place = rng.uniform(-half + 0.4, half - 0.4, 2)
        clear = all(np.hypot(*(place - other)) > 0.5 for other in found)
        if clear and not (kerb and abs(place[0] - KERB_X) < 0.4):
            found.append(place)
    return np.array(found)


def _lattice(rng, half, step):
    u = np.arange(-half, half, step)
    x, y = np.meshgrid(u, u)
    return tuple(a.ravel() + rng.uniform(-step / 3, step / 3, a.size) for a in (x, y))


def _air(rng, count, floaters, half):
    """Yield the splats of a sky and of floaters at random places."""
    way = rng.normal(size=(2000, 3))
    way[:, 2] = np.abs(way[:, 2])
    sky = 20 * half * way / np.linalg.norm(way, axis=1)[:, None]
    yield sky, np.tile(SKY, (len(sky), 1)), half, 0.9
    number = int(count * floaters / (1 - floaters))
    if number:
        place = rng.uniform((-half, -half, -0.3), (half, half, 2.5), (number, 3))
        yield place, rng.uniform(0.2, 0.8, (number, 3)), 0.01, rng.uniform(0.02, 0.3, number)


def _ring(rng, radius, height, count=24):
    angle = 2 * np.pi * np.arange(count) / count
    eyes = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, height)], 1)
    return eyes + rng.normal(0, (0.15, 0.15, 0.1), (count, 3))


def _scene(rng, parts, eyes, target, name, tilt=40.0):
    """Return the Scene of parts (points, colour, size, opacity) in a random capture frame."""
    frame = random_frame(rng, tilt)
    points = np.concatenate([p[0] for p in parts])
    color = np.concatenate([p[1] for p in parts])
    size = np.concatenate([np.full(len(p[0]), p[2]) for p in parts])
    opacity = np.concatenate([np.broadcast_to(p[3], len(p[0])) for p in parts])
    scale = np.stack([size, size, np.minimum(size, 1e-3)], 1) / frame.meters_per_unit
    splats = Splats(
        frame.to_capture(points).astype(np.float32),
        np.tile(
            Rotation.from_matrix(frame.rotation.T).as_quat(scalar_first=True), (len(points), 1)
        ).astype(np.float32),
        scale.astype(np.float32),
        opacity.astype(np.float32),
        ((color - 0.5) / SH_0).astype(np.float32)[:, None, :],
    )
    cameras = []
    for eye in eyes:
        ahead = np.add(eye, (4.0, 0.0, -1.0)) if target is None else np.asarray(target)
        camera = look_at(eye, ahead, (0, 0, 1), 60, 320, 240)
        cameras.append(frame.camera_in_capture(camera))
    return Scene(name, splats, tuple(cameras), frame)
