"""A yard of known light: a ground, a box, a wall and a post under a sun and a clear sky, as splats.

Visibility is computed from the boxes' faces and not from the splats.
"""

import numpy as np
from scipy.spatial.transform import Rotation

import factories
from rainsim.scene.types import GroundFrame, Scene
from scenes import looking

SH_0 = 0.28209479177387814
BOXES = np.array([  # lowest and highest corner [m]
    [(-0.6, -0.2, 0.0), (0.2, 0.5, 0.75)],
    [(2.2, -2.5, 0.0), (2.4, 2.5, 2.2)],
    [(-1.6, 1.0, 0.0), (-1.5, 1.1, 1.8)],
])  # fmt: skip
HALF = 3.5  # m, of the ground
REFLECTED = 0.15  # light of what hides the sky, over that on open ground
SUN_OVER_SKY = np.array([5.2, 4.4, 3.4])  # on a surface that faces the sun, over the open sky's


def direction_of(azimuth, elevation):
    """Return the unit vector of angles in degrees."""
    a, e = np.radians(azimuth), np.radians(elevation)
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def hidden(points, direction):
    """Tell which points (n, 3) do not see along a direction, by the slabs of each box."""
    found = np.zeros(len(points), bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        for low, high in BOXES:
            # Axis by axis: over rows of three numpy's greatest takes ten times as long.
            enter, leave = np.full((2, len(points)), [[-np.inf], [np.inf]])
            for k in range(3):
                a, b = (
                    (low[k] - points[:, k]) / direction[k],
                    (high[k] - points[:, k]) / direction[k],
                )
                enter, leave = (
                    np.maximum(enter, np.minimum(a, b)),
                    np.minimum(leave, np.maximum(a, b)),
                )
            found |= (leave > np.maximum(enter, 0)) & (leave > 1e-4)
    return found | (direction[2] < 0)


def points_of(step):
    """Return positions and normals of all faces, `step` metres apart."""
    line = np.arange(-HALF, HALF, step) + step / 2
    x, y = (part.ravel() for part in np.meshgrid(line, line))
    free = np.ones(len(x), bool)
    for low, high in BOXES:
        free &= ~((x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1]))
    position = [np.stack([x, y, 0 * x], -1)[free]]
    normal = [np.tile([0.0, 0.0, 1.0], (free.sum(), 1))]
    for low, high in BOXES:
        for axis in range(3):
            u, v = (k for k in range(3) if k != axis)
            a, b = (
                low[k] + (np.arange(round((high - low)[k] / step)) + 0.5) * step for k in (u, v)
            )
            a, b = (part.ravel() for part in np.meshgrid(a, b))
            for sign, at in ((-1, low[axis]), (1, high[axis])):
                if axis == 2 and sign < 0:
                    continue
                face = np.empty((len(a), 3))
                face[:, axis], face[:, u], face[:, v] = at, a, b
                position.append(face)
                normal.append(np.tile(sign * np.eye(3)[axis], (len(a), 1)))
    return np.concatenate(position), np.concatenate(normal)


def openness(position, normal, radiance=None, count=160):
    """Return the light of a sky on each point over its light on open level ground."""
    k = np.arange(count) + 0.5
    height, turn = k / count, k * np.pi * (1 + 5**0.5)
    flat = np.sqrt(1 - height**2)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], -1)
    bright = np.ones(count) if radiance is None else radiance(directions)
    total = np.zeros(len(position))
    for d, light in zip(directions, bright, strict=True):
        cosine = np.maximum(normal @ d, 0)
        total += light * cosine * ~hidden(position + 1e-3 * normal, d)
    return total / (bright * directions[:, 2]).sum()


def overcast(directions):
    """Return an overcast sky's radiance, Moon and Spencer 1942."""
    return (1 + 2 * directions[:, 2]) / 3


def clear(directions, sun):
    """Return a clear sky's radiance: brighter about the sun and at the horizon (CIE S 011)."""
    angle = np.arccos(np.clip(directions @ sun, -1, 1))
    glow = 1 + 10 * (np.exp(-3 * angle) - np.exp(-1.5 * np.pi)) + 0.45 * np.cos(angle) ** 2
    return glow * (1 - np.exp(-0.32 / np.maximum(directions[:, 2], 0.01)))


def yard(azimuth=200.0, elevation=38.0, sun=SUN_OVER_SKY, step=0.045, paint=0.2, turned=True):
    """Return the scene, and of each splat the sun's share of its light and its openness.

    `sun` 0 is a dull day: the light of the overcast sky alone.
    """
    rng = np.random.default_rng(7)
    position, normal = points_of(step)
    position = position + 0.15 * step * rng.standard_normal(position.shape) * (normal == 0)
    towards = direction_of(azimuth, elevation)
    lit = ~hidden(position + 1e-3 * normal, towards) * np.maximum(normal @ towards, 0)
    dull = not np.any(sun)
    sky = openness(position, normal, overcast if dull else lambda d: clear(d, towards))
    hidden_share = np.maximum(1 - openness(position, normal), 0)
    around = 1 + np.asarray(sun) * towards[2]
    shaded = sky[:, None] + REFLECTED * hidden_share[:, None] * around
    light = lit[:, None] * np.asarray(sun) + shaded
    tone = np.exp(paint * rng.standard_normal(len(position)))
    slab = np.floor(position / 0.5).astype(int) @ [1, 7, 31]
    tone *= np.exp(0.15 * np.random.default_rng(3).standard_normal(4096))[slab % 4096]
    albedo = np.array([0.32, 0.29, 0.25]) * tone[:, None]
    exposure = 1.4 if dull else 1.4 / around[1]
    linear = np.clip(albedo * light * exposure, 0, 1)
    color = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    scale = np.where(normal != 0, 1e-3, 0.6 * step)
    frame = _frame() if turned else GroundFrame(np.eye(3), 1.0, np.zeros(3))
    turn = Rotation.from_matrix(frame.rotation.T).as_quat(scalar_first=True)
    splats = factories.splats(
        frame.to_capture(position), turn, scale / frame.meters_per_unit, 0.97, color=color
    )
    eyes = [(2.0 * np.cos(a) - 0.3, 2.4 * np.sin(a), 1.5) for a in np.arange(8) * np.pi / 4]
    cameras = tuple(
        frame.camera_in_capture(looking(eye, (0.0, 0.0, 0.2), 96, 64, 80.0)) for eye in eyes
    )
    scene = Scene("yard", splats, cameras, frame, None, "0" * 64, ())
    return scene, lit[:, None] * sun / np.maximum(light, 1e-9), sky


def _frame():
    turn = Rotation.from_euler("ZX", (35.0, -70.0), degrees=True)
    return GroundFrame(turn.as_matrix(), 0.7, np.array([0.2, -0.1, 0.5]))
