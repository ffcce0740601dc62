"""Synthetic captures with water in them, as training leaves it in splats; their truth is known.

What cameras saw in the water is a mirror image. Training explains it in two ways, and captures
hold mixtures: by splats below the ground where the mirror images of things seem to be, with a hole
in the surface (`VIRTUAL`), or by a surface whose colour changes with the view (`GLOSSY`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rainsim import raster
from rainsim.bench.captures import PAVING, SH_0, SKY, Truth, _air, _lattice, _ring, _scene
from rainsim.scene.cameras import mirrored_camera
from rainsim.scene.types import Scene, Splats

VIRTUAL, GLOSSY, MIXED = "virtual", "glossy", "mixed"
PIT = "pit"  # no water: a hole with things at its bottom
LEVEL = -0.06  # m: the water lies below the paving
MIDDLE, HALF_AXES = (0.5, 0.3), (1.1, 0.8)  # m, of the pond's outline, an ellipse
BODY = (0.020, 0.028, 0.018)  # linear colour of the water itself
GAMMA = 2.2
FIT = 2e-3  # weight that keeps a fit of harmonics to a few views tame
PIT_DEPTH = 0.7  # m
VIEW = (320, 240)  # px


@dataclass(frozen=True)
class WaterTruth(Truth):
    """What is known of a capture with water in it.

    Attributes
    ----------
    wet : callable
        wet(x, y): whether there is water.
    level : float [m]
        Of the water; None if there is none.
    """

    wet: object = None
    level: float | None = LEVEL


def pond(seed, kind=VIRTUAL, noise=1e-3, step=0.025, lost=0.15):
    """Return the Scene (in its capture frame) and WaterTruth of a yard with a pond.

    Parameters
    ----------
    seed : int
    kind : {"virtual", "glossy", "mixed", "pit"}
        How the capture shows the water; "pit" has none.
    noise : float [m]
        Of the splats' heights.
    step : float [m]
        Between splats.
    lost : float
        Share of the mirror images, and of the patches of the surface, that the capture has lost.
    """
    rng = np.random.default_rng(seed)

    def wet(x, y):
        away = np.hypot((x - MIDDLE[0]) / HALF_AXES[0], (y - MIDDLE[1]) / HALF_AXES[1])
        return away < 1 + 0.1 * np.sin(3 * np.arctan2(y - MIDDLE[1], x - MIDDLE[0]) + seed)

    def bed(x, y):
        return 0.003 * (4 - np.minimum(x * x + y * y, 8)) / 2

    x, y = _lattice(rng, 4.0, step)
    dry = ~wet(x, y)
    z = bed(x, y) + rng.normal(0, noise, x.shape)
    ground = np.stack([x, y, z], 1)[dry]
    things = list(_things(rng, step))
    shown = rng.normal(0, 0.02, (len(ground), 3)) + PAVING
    above = [(ground, shown, 0.7 * step, 0.95), _rim(rng, wet, step), *things]
    above += _air(rng, len(x), 0.1, 4.0)
    parts = list(above)
    if kind in (VIRTUAL, MIXED):
        parts += _images(rng, [*things, above[-2]], lost, 0.55 if kind == MIXED else 0.9)
    if kind == PIT:
        floor = np.stack([x, y, np.full(x.shape, -PIT_DEPTH)], 1)[~dry]
        color = 0.35 + 0.25 * np.sin(9 * floor[:, :1]) * np.sin(7 * floor[:, 1:2]) * np.ones(3)
        parts.append((floor, color, 0.7 * step, 0.95))
    kept = rng.bit_generator.state
    scene = _scene(rng, parts, _ring(rng, 3.2, 1.5), (0, 0, 0.0), f"{kind}-{seed}")
    if kind in (GLOSSY, MIXED):
        rng.bit_generator.state = kept  # the same frame
        dried = _scene(rng, above, _ring(rng, 3.2, 1.5), (0, 0, 0.0), scene.name)
        x, y = _lattice(rng, 4.0, 2 * step)
        here = wet(x, y) & (np.sin(3.1 * x + seed) * np.sin(2.7 * y) < 1 - 2 * lost)
        surface = np.stack([x, y, LEVEL + rng.normal(0, 3 * noise, x.shape)], 1)[here]
        scene = _with_surface(scene, dried, surface, 1.4 * step, 0.3 if kind == MIXED else 0.95)
    truth = WaterTruth(scene.ground_frame, bed, np.zeros((0, 2)), 4.0)
    return scene, replace(truth, wet=wet, level=None if kind == PIT else LEVEL)


def _things(rng, step):
    """Yield what stands about the water: a wall with stripes, bushes, posts, trees far off."""
    u, v = np.meshgrid(np.arange(-3, 3, step), np.arange(0, 1.6, step))
    wall = np.stack([u.ravel(), np.full(u.size, 3.7), v.ravel()], 1)
    stripes = np.where(np.floor(wall[:, :1] / 0.4) % 2 > 0, (0.75, 0.3, 0.2), (0.85, 0.8, 0.7))
    yield wall, stripes, 0.7 * step, 0.95
    for place in ((-1.8, 0.2), (1.2, -2.2), (2.6, 0.4)):
        way = rng.normal(size=(1500, 3))
        way *= 0.45 * rng.uniform(0.6, 1, (1500, 1)) / np.linalg.norm(way, axis=1)[:, None]
        bush = way + np.array([*place, 0.5])
        color = rng.normal((0.18, 0.33, 0.12), 0.05, (1500, 3))
        yield bush, color, 0.03, 0.9
    up = np.arange(0.0, 1.2, 0.01)
    for place in ((-0.9, 1.3), (-0.7, -1.0)):
        post = np.concatenate([np.stack([0 * up + place[0], 0 * up + place[1], up], 1)])
        yield post, np.tile((0.9, 0.75, 0.1), (len(up), 1)), 0.02, 0.95
    turn = rng.uniform(0, 2 * np.pi, 6000)
    high = rng.uniform(0, 5, 6000) * (0.6 + 0.4 * np.sin(5 * turn))
    trees = np.stack([12 * np.cos(turn), 12 * np.sin(turn), high], 1)
    yield trees, (0.15, 0.22, 0.1) + rng.uniform(0, 0.15, (6000, 1)) * np.ones(3), 0.25, 0.9


def _rim(rng, wet, step):
    """Return the bank between the paving and the water."""
    turn = np.arange(0, 2 * np.pi, step / 2)
    far = np.ones(turn.size)
    for _ in range(40):  # where a ray from the middle leaves the water
        x = MIDDLE[0] + far * HALF_AXES[0] * np.cos(turn)
        y = MIDDLE[1] + far * HALF_AXES[1] * np.sin(turn)
        far += np.where(wet(x, y), 0.01, -0.01)
    rows = [np.stack([x, y, np.full(x.shape, z)], 1) for z in np.arange(LEVEL, 0, step / 2)]
    points = np.concatenate(rows)
    return points, 0.4 + rng.normal(0, 0.02, (len(points), 3)), 0.5 * step, 0.95


def _images(rng, parts, lost, opacity):
    """Return parts mirrored in the water, dimmed as its surface mirrors at 65 degrees."""
    result = []
    for points, color, size, _ in parts:
        image = points * (1, 1, -1) + (0, 0, 2 * LEVEL) + rng.normal(0, 0.01, points.shape)
        shown = (BODY + 0.1 * np.clip(color, 0, 1) ** GAMMA) ** (1 / GAMMA)
        kept = rng.uniform(size=len(points)) > lost
        kept &= np.sin(5 * points[:, 0] + 2) * np.sin(4 * points[:, 2] + 1) < 1 - lost
        result.append((image[kept], shown[kept], size, opacity))
    return result


def _with_surface(scene, dried, points, size, opacity):
    """Return the scene with a surface whose harmonics are fitted to what the cameras saw in it.

    Each camera sees the mirror image of the `dried` scene (Fresnel's share of it) and the water.
    """
    frame = scene.ground_frame
    rasterizer = raster.Rasterizer(raster.prepare(dried.splats))
    near = 0.05 / frame.meters_per_unit
    normal = np.zeros((len(points), 16, 16))
    right = np.zeros((len(points), 16, 3))
    place = frame.to_capture(points)
    for camera in scene.cameras:
        plane, mirrored = mirrored_camera(camera, frame, LEVEL)
        seen = rasterizer.draw(mirrored, near, plane, background=SKY)
        at = place @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
        u = camera.fx * at[:, 0] / at[:, 2] + camera.cx
        v = camera.fy * at[:, 1] / at[:, 2] + camera.cy
        here = (at[:, 2] > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        way = place - camera.position
        way /= np.linalg.norm(way, axis=1)[:, None]
        cosine = np.abs(way @ frame.up)
        shared = 0.02 + 0.98 * (1 - cosine) ** 5
        rows, columns = v[here].astype(int), u[here].astype(int)
        mirror = np.clip(seen.color[rows, columns], 0, 1) ** GAMMA
        value = (BODY + shared[here, None] * mirror) ** (1 / GAMMA)
        basis = harmonics(way[here])
        normal[here] += basis[:, :, None] * basis[:, None, :]
        right[here] += basis[:, :, None] * (value - 0.5)[:, None, :]
    weight = FIT * np.repeat((0.01, 1, 4, 9), (1, 3, 5, 7))
    sh = np.linalg.solve(normal + np.diag(weight * len(scene.cameras)), right).astype(np.float32)
    old = scene.splats
    scale = np.tile((size, size, 1e-3), (len(points), 1)) / frame.meters_per_unit
    padded = np.zeros((len(old), 16, 3), np.float32)
    padded[:, :1] = old.sh
    splats = Splats(
        np.concatenate([old.position, place.astype(np.float32)]),
        np.concatenate([old.rotation, np.tile(old.rotation[:1], (len(points), 1))]),
        np.concatenate([old.scale, scale.astype(np.float32)]),
        np.concatenate([old.opacity, np.full(len(points), opacity, np.float32)]),
        np.concatenate([padded, sh]),
    )
    return Scene(scene.name, splats, scene.cameras, frame)


def harmonics(way):
    """Return the real spherical harmonics to degree 3, (n, 16), of unit directions (n, 3).

    In the basis and order of Kerbl et al. 2023.
    """
    x, y, z = way.T
    xx, yy, zz = x * x, y * y, z * z
    terms = (
        SH_0 + 0 * x,
        -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
        1.0925484305920792 * x * y, -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * zz - xx - yy), -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy), 1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    )  # fmt: skip
    return np.stack(terms, axis=1)
