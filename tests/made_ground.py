"""Level ground of known paint and shade, and what cameras around it see, without any splats."""

import numpy as np

from rainsim.scene.cameras import look_at
from rainsim.scene.view import lens_array
from rainsim.surface.views import DepthView

SUN_OVER_SKY = np.array([3.6, 2.3, 1.2])
PAVING, LAWN, SAND = np.array([(0.40, 0.38, 0.35), (0.07, 0.12, 0.03), (0.45, 0.34, 0.22)])
HALF = 3.0  # m


def shaded(place):
    """Return the hidden share of the sun: two bars across all paints, soft by 6 cm."""
    x, y = place[..., 0], place[..., 1]
    bars = [np.abs(x + 0.3 * y - at) - half for at, half in ((-1.0, 0.5), (1.2, 0.35))]
    return 1 / (1 + np.exp(np.clip(np.min(bars, axis=0) / 0.015, -30, 30)))


def painted(place, paints=(PAVING, LAWN)):
    """Return albedo (..., 3): stripes of paints along x, of slabs that differ by a tenth."""
    tone = np.exp(0.1 * np.random.default_rng(3).standard_normal(4096))
    slab = np.floor(place[..., :2] / 0.4).astype(int) @ [7, 31]
    stripe = np.floor((place[..., 1] + HALF) / (2 * HALF) * len(paints)).astype(int)
    return np.array(paints)[np.clip(stripe, 0, len(paints) - 1)] * tone[slab % 4096, None]


def light_of(place, paints=(PAVING, LAWN), shade=shaded):
    """Return linear captured light (..., 3) of the ground."""
    shown = 0 if shade is None else 1 - shade(place)[..., None]
    return 0.3 * painted(place, paints) * (1 + shown * SUN_OVER_SKY)


def views(light, exposure=(0.0,), count=8):
    """Return `DepthView`s of the ground; `light` is a function of places, exposures logarithms."""
    found = []
    for k in range(count):
        turn = 2 * np.pi * k / count
        eye = np.array([2.2 * np.cos(turn), 2.2 * np.sin(turn), 1.6])
        camera = look_at(eye, (-0.2 * eye[0], -0.2 * eye[1], 0), (0, 0, 1), 75.0, 160, 120)
        matrix, lens = camera.camera_from_world[:3], lens_array(camera)
        row, column = np.mgrid[:120, :160] + 0.5
        ray = np.stack([(column - lens[2]) / lens[0], (row - lens[3]) / lens[1], 1 + 0 * row], -1)
        ray = ray @ matrix[:, :3]
        with np.errstate(divide="ignore"):
            depth = np.where(ray[..., 2] < 0, -eye[2] / ray[..., 2], np.inf)
        place = eye + np.where(np.isfinite(depth), depth, 0)[..., None] * ray
        depth[np.abs(place[..., :2]).max(axis=-1) > HALF] = np.inf
        shown = light(place) * np.exp(exposure[k % len(exposure)])
        maps = (values.astype(np.float32) for values in (depth, depth, shown, 0 * row))
        found.append(DepthView(matrix.astype("f4"), eye.astype("f4"), lens, *maps))
    return found
