"""The light that water mirrors, from rays traced through the splats, and errors against it.

The truth of a pixel is the mean over its area. The water is found in a picture of RAYS times the
size, shifted by part of a pixel, and of each of its pixels one ray is traced, at a slope drawn from
those that even that pixel does not resolve. Such a mean of some rays has noise of its own: it is
taken twice, and errors against the two are multiplied, or covariances between the two taken, so
that the noise falls out (all but its own scatter) and a perfect picture has no error.

Splats are as wide on these rays as the picture itself widens them, so that the truth is that of
the mirrored light, not of what splatting at this size makes of thin things.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from scipy import ndimage

from benchmarks.suite import decibels
from benchmarks.traced import RayScene, mirror_rays, traced_light
from rainsim.reflection.facets import LEAST_VARIANCE, SAMPLES
from rainsim.reflection.screen_space import NOT_GROUND
from rainsim.reflection.water_record import (
    COVARIANCE,
    COVERAGE,
    POINT,
    SLOPE_X,
    SLOPE_Y,
    VARIANCE_X,
    VARIANCE_Y,
    VIEW_DEPTH,
)
from rainsim.scene.view import image_point

RAYS = 4  # along each side of a pixel
SEEDS = 1, 2
SEEN = 0.05, 0.15  # share of the depth and metres within which a traced end is what the camera sees
WINDOW = 7  # px, of the structural similarity
DARK = 0.5  # alpha of a ray that has met something
STEADY = 0.01**2, 0.03**2  # constants of the structural similarity for values up to 1


def trace_truth(renderer, camera, state):
    """Return the traced light, which of it the camera sees, and why it does not see the other.

    A dict. light: a pair of (n, 3), float32, independent estimates of what each record mirrors.
    known and seen, (n,) bool: which records the truth has, and whose ray ends on something that the
    camera sees. alpha, (n,): of the ray of the mean slope. traced, (n, 3): light of SAMPLES
    rays. causes, view_dependence and cost: dicts.
    """
    water, wet, scene = renderer.water, renderer.wet, renderer.conductor.wet_scene
    rays_of = RayScene(scene)
    rays_of.trace(  # builds the hierarchy, which the time of tracing is counted without
        water.record[:1, POINT], np.array([[0, 0, 1]], np.float32), np.zeros(1, np.float32), 1e-3
    )
    start = time.process_time()
    alpha, end = traced_light(water.record, wet.view, rays_of.trace, water.light, water.source)
    seconds = time.process_time() - start
    traced = water.light.copy()
    sampled = (water.record[:, VARIANCE_X] + water.record[:, VARIANCE_Y] >= LEAST_VARIANCE).sum()
    rays = len(traced) + (SAMPLES - 1) * int(sampled)
    causes = why_unseen(wet, alpha, end)
    # What the colours' dependence on the view alone makes: the same rays, colours as seen from the
    # camera, which is all that a march can show.
    eye = scene.frame.to_capture(wet.view.eye)

    def trace(*ray):
        return rays_of.trace(*ray, color_eye=eye)

    traced_light(water.record, wet.view, trace, water.light, water.source)
    view_dependence = compare(water, water.light, (traced, traced), causes == "seen")
    pixel = water.pixel.copy()
    light = [area_light(renderer, rays_of, camera, state, pixel, seed) for seed in SEEDS]
    renderer.draw(camera, state)
    known = np.isfinite(light[0] + light[1]).all(axis=1)
    for estimate in light:
        estimate[~known] = 0
    return {
        "light": light, "known": known, "seen": known & (causes == "seen"), "alpha": alpha,
        "traced": traced, "view_dependence": view_dependence,
        "causes": {str(name): int(n) for name, n in zip(*np.unique(causes, return_counts=True),
                                                        strict=True)},
        "cost": {
            "seconds": seconds, "rays": rays, "rays_per_second": rays / max(seconds, 1e-9),
            "memory_mb": rays_of.tracer.nbytes / 1e6,
        },
    }  # fmt: skip


def area_light(renderer, rays_of, camera, state, pixel, seed):
    """Return the mean of RAYS^2 traced rays in each of the given pixels; NaN without water.

    `rays_of` is the `RayScene`. The renderer is left with another picture.
    """
    rng = np.random.default_rng(seed)
    fine = camera.resized(camera.width * RAYS, camera.height * RAYS)
    dx, dy = rng.uniform(-0.5, 0.5, 2)
    fine = replace(fine, cx=fine.cx + dx, cy=fine.cy + dy)
    conductor = renderer.conductor
    before = conductor.methods
    conductor.methods = replace(before, reflections="ssr")  # what it mirrors is not wanted
    renderer.draw(fine, state)
    conductor.methods = before
    water = renderer.water
    record, count = water.record, len(water.pixel)
    p, q = rng.standard_normal((2, count)).astype(np.float32)
    # A normal variable of the covariance that even these pixels hide: its root is triangular.
    deviation = np.sqrt(np.maximum(record[:, VARIANCE_X], np.float32(1e-12)))
    along = record[:, COVARIANCE] / deviation
    record[:, SLOPE_X] += deviation * p
    across = np.sqrt(np.maximum(record[:, VARIANCE_Y] - along**2, 0))
    record[:, SLOPE_Y] += along * p + across * q
    direction, (way, weight) = np.empty((count, 3), np.float32), np.empty((2, count), np.float32)
    mirror_rays(np.arange(count), record, renderer.wet.view, 0, direction, way, weight)
    light, _, _ = rays_of.trace(
        record[:, POINT], direction, way, record[:, VIEW_DEPTH] / way / np.float32(camera.fx)
    )
    row, column = np.divmod(water.pixel, fine.width)
    to = (row // RAYS) * camera.width + column // RAYS
    size = camera.width * camera.height
    weight *= record[:, COVERAGE]
    total = np.bincount(to, weight, size)[pixel]
    sums = [np.bincount(to, weight * light[:, k], size)[pixel] for k in range(3)]
    with np.errstate(invalid="ignore"):
        return (np.stack(sums, axis=1) / total[:, None]).astype(np.float32)


def why_unseen(wet, alpha, end):
    """Return for each record "seen", or why the camera does not see where its traced ray ends."""
    v = wet.view
    local = (np.where(np.isfinite(end), end, v.eye) - v.eye) @ v.ground_from_camera  # sky: nowhere
    height, width = wet.depth.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        u, w = image_point(v, *local.T)
    inside = (local[:, 2] > 0) & (u >= 0) & (w >= 0) & (u < width) & (w < height)
    column, row = (np.where(inside, a, 0).astype(int) for a in (u, w))
    there = wet.depth[row, column]
    off = local[:, 2] - there
    near = np.abs(off) < np.maximum(SEEN[0] * local[:, 2], SEEN[1])
    cause = np.full(len(end), "hidden by something nearer", dtype=object)
    cause[off < 0] = "before what is seen"
    cause[near] = "seen"
    cause[near & (wet.clearance[row, column] < NOT_GROUND)] = "ground"
    cause[~inside] = "outside the picture"
    cause[local[:, 2] <= 0] = "behind the camera"
    cause[~(alpha > DARK)] = "sky"
    return cause.astype(str)


def compare(water, light, truth, mask):
    """Return PSNR [dB] and structural similarity of mirrored radiance over the records in mask.

    `light` is that of each record, (n, 3); `truth` a pair of independent estimates of it: where
    these are one and the same, the measures are the usual ones. The result has psnr, ssim (in
    windows that hold water only; None if there are none) and pixels.
    """
    if not mask.any():
        return {"psnr": None, "ssim": None, "pixels": 0}
    light, (a, b) = light.astype(float), (t.astype(float) for t in truth)
    error = float(np.mean((light[mask] - a[mask]) * (light[mask] - b[mask])))
    shape = water.coverage.shape
    wet = np.zeros(shape, bool)
    wet.ravel()[water.pixel] = True
    whole = ndimage.binary_erosion(wet, np.ones((WINDOW, WINDOW)))
    wanted = np.zeros_like(wet)
    wanted.ravel()[water.pixel[mask]] = True
    wanted &= whole
    similar = None
    if wanted.any():
        similar = float(_similarity(*(_picture(water, v) for v in (light, a, b)))[wanted].mean())
    return {"psnr": decibels(error), "ssim": similar, "pixels": int(mask.sum())}


def clipped(water, light, truth):
    """Return the accuracy of light clipped at display white, as a picture shows it.

    Each of the truth's estimates is clipped, which darkens the edges of lamps a little. `truth` is
    as `trace_truth` returns it; the result holds that of `compare` for "seen" and for "all".
    """
    light, estimates = np.minimum(light, 1), [np.minimum(a, 1) for a in truth["light"]]
    return {
        name: compare(water, light, estimates, truth[mask])
        for name, mask in (("seen", "seen"), ("all", "known"))
    }


def _picture(water, values):
    picture = np.zeros((*water.coverage.shape, 3))
    picture.reshape(-1, 3)[water.pixel] = values
    return picture


def _similarity(x, a, b):
    """Return the structural similarity (Wang et al. 2004) of x with the truth estimated by a and b.

    The truth's squared mean and variance are estimated as mean product and covariance of a and b.
    """
    mean = [ndimage.uniform_filter(p, (WINDOW, WINDOW, 1)) for p in (x, a, b)]
    n = WINDOW * WINDOW

    def common(i, j, p, q):
        both = ndimage.uniform_filter(p * q, (WINDOW, WINDOW, 1))
        return n / (n - 1) * (both - mean[i] * mean[j])

    own, theirs = common(0, 0, x, x), np.maximum(common(1, 2, a, b), 0)
    shared = (common(0, 1, x, a) + common(0, 2, x, b)) / 2
    middle = (mean[1] + mean[2]) / 2
    level = (2 * mean[0] * middle + STEADY[0]) / (mean[0] ** 2 + mean[1] * mean[2] + STEADY[0])
    return level * (2 * shared + STEADY[1]) / (own + theirs + STEADY[1])
