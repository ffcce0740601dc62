"""Reflections in the film on wet ground, against a lobe of rays traced through the splats.

Facets are drawn at random by the slopes of the film and weighted by how large they are seen; each
sends one ray from the ground through all that stands on it. Part of `benchmarks look`.
"""

from __future__ import annotations

import math
import time

import numpy as np

from benchmarks.suite import decibels
from benchmarks.traced import RayScene
from rainsim.constants import REFRACTIVE_INDEX
from rainsim.scene.view import slopes
from rainsim.shading import wet_ground_mirror
from rainsim.shading.microfacet import LEAST_DIP

PIXELS, RAYS = 250, 160
FULL = 0.5  # share of film from which a pixel is compared


def film_accuracy(renderer, camera, pixels=PIXELS, rays=RAYS, seed=0):
    """Return how near the film's light is to traced lobes, or None where no film is seen.

    The renderer has drawn the camera. `pixels` are drawn at random among those with film, `rays`
    are the facets of each. The result has the number of pixels, the seconds of the tracing, and for
    the mirrored picture ("mirror"), for the surroundings only ("environment") and for the rays' own
    noise ("noise") the PSNR [dB], with peak 1, and the root mean square error over the mean of the
    truth.
    """
    cover = np.zeros((camera.height, camera.width), np.float32)
    wet_picture = renderer.conductor.wet_scene.picture(camera, cover)
    rows, columns = np.nonzero((cover > FULL) & np.isfinite(wet_picture.depth))
    if not len(rows):
        return None
    rng = np.random.Generator(np.random.PCG64(seed))
    chosen = rng.choice(len(rows), min(pixels, len(rows)), replace=False)
    rows, columns = rows[chosen], columns[chosen]
    start = time.perf_counter()
    wanted, noise = traced_film(renderer, wet_picture, rows, columns, rays, rng)
    seconds = time.perf_counter() - start
    found = {}
    for name in ("mirror", "environment"):
        field, step = _field(renderer, wet_picture, cover, name)
        full = np.empty_like(wet_picture.picture)
        one = np.ones_like(cover)
        wet_ground_mirror.add_reflection(np.zeros_like(wet_picture.picture), one, field, step, full)
        found[name] = _error(full[rows, columns] - wanted, wanted)
    found["noise"] = _error(noise, wanted)
    return {"pixels": len(rows), "rays": rays, "seconds": seconds, **found}


def film_line(found):
    """Return the result of `film_accuracy` as a line of text."""
    told = ", ".join(
        f"{name} {found[key]['psnr']:.1f} dB ({found[key]['relative']:.0%})"
        for name, key in (
            ("mirrored picture", "mirror"), ("surroundings only", "environment"),
            ("noise of the rays", "noise"),
        )
    )  # fmt: skip
    return f"  film on wet ground against {found['rays']} traced rays a pixel: {told}"


def _field(renderer, wet_picture, cover, name):
    """Return the field of mirrored light and its step, with or without the mirrored picture."""
    film, scene = renderer.conductor.ground.film, renderer.conductor.wet_scene
    before, film.drawn = film.drawn, name == "mirror"
    try:
        around = scene.level_mirrored, scene.sky.gloss
        return film.field(wet_picture.view, cover, renderer.conductor.ground_camera, *around)
    finally:
        film.drawn = before


def _error(difference, truth):
    square = float(np.mean(np.square(difference, dtype=np.float64)))
    return {
        "psnr": decibels(square),
        "relative": math.sqrt(square) / max(float(truth.mean()), 1e-9),
    }


def traced_film(renderer, wet_picture, rows, columns, rays, rng):
    """Return the light that a full film mirrors to pixels, and the noise of its estimate.

    Both have the shape (pixels, 3); the rays start on the ground that the pixels show, and meet
    only what stands on it.
    """
    view = wet_picture.view
    local = np.stack([*slopes(view, columns + 0.5, rows + 0.5), np.ones(len(rows))], -1)
    ray = local @ view.ground_from_camera.T.astype(np.float64)
    spot = view.eye + ray * wet_picture.depth[rows, columns][:, None]
    before = np.linalg.norm(spot - view.eye, axis=1)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    height, gx, gy, slope = ground_under(renderer, spot)
    spot[:, 2] = height
    n = len(rows)
    tilt = rng.normal(0, slope[:, None, None], (n, rays, 2)) + np.stack([gx, gy], -1)[:, None]
    normal = np.concatenate([-tilt, np.ones((n, rays, 1))], axis=-1)
    long = np.linalg.norm(normal, axis=-1)
    cosine = np.maximum(-np.einsum("nrk,nk->nr", normal, ray) / long, 0)
    out = ray[:, None] + 2 * (cosine / long)[..., None] * normal
    rise = out[..., 2] / np.maximum(np.hypot(out[..., 0], out[..., 1]), 1e-6)
    seen = cosine * long
    up = rise > 1e-3
    dip = -ray[:, 2] / np.hypot(ray[:, 0], ray[:, 1])
    leave = 1 + _smith(np.maximum(dip, LEAST_DIP) / slope)[:, None]
    weight = seen / seen.sum(axis=1, keepdims=True) * _fresnel(cosine) * up
    weight *= leave / (leave + _smith(np.maximum(rise, 1e-3) / slope[:, None]))
    light = np.zeros((n * rays, 3))
    which = np.flatnonzero(up.ravel())
    light[which] = _trace(
        renderer, np.repeat(spot, rays, 0)[which], out.reshape(-1, 3)[which],
        np.repeat(before, rays)[which], 1 / float(view.fx),
    )  # fmt: skip
    parts = weight[..., None] * light.reshape(n, rays, 3)
    total = parts.sum(axis=1)
    spread = rays * parts.std(axis=1, ddof=1) / math.sqrt(rays)
    return total, spread


def ground_under(renderer, spot):
    """Return height, both slopes and the film's rms slope of the ground under points (n, 3)."""
    tables = renderer.conductor.ground
    terrain, ground = tables.terrain, tables.film.ground.slopes
    (x0, y0), cell = terrain.grid.origin, terrain.grid.spacing
    rows, columns = terrain.bed.shape
    i = np.clip(((spot[:, 0] - x0) / cell).astype(int), 0, columns - 1)
    j = np.clip(((spot[:, 1] - y0) / cell).astype(int), 0, rows - 1)
    return ground[j, i].T.astype(np.float64)


def _trace(renderer, origin, direction, before, pixel):
    """Return the radiance of rays that are traced through the standing splats."""
    scene = renderer.conductor.wet_scene
    terrain = renderer.conductor.ground.terrain
    stands = wet_ground_mirror.standing(scene.capture.prepared, terrain, scene.frame)
    rays = RayScene(scene, scene.scene.splats.take(np.sort(stands.order)))
    return rays.trace(
        origin.astype(np.float32), direction.astype(np.float32), before.astype(np.float32),
        np.full(len(origin), pixel, np.float32),
    )[0]  # fmt: skip


def _fresnel(cosine):
    t = np.sqrt(1 - (1 - cosine**2) / REFRACTIVE_INDEX**2)
    across = (cosine - REFRACTIVE_INDEX * t) / (cosine + REFRACTIVE_INDEX * t)
    along = (REFRACTIVE_INDEX * cosine - t) / (REFRACTIVE_INDEX * cosine + t)
    return (across**2 + along**2) / 2


def _smith(a):
    erfc = np.vectorize(math.erfc)(a / math.sqrt(2))
    return np.exp(-a * a / 2) / (a * math.sqrt(2 * math.pi)) - erfc / 2
