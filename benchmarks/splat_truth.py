"""A capture's picture in float64: every splat is blended over every pixel that it reaches.

It blends by the rules of `rainsim.raster` without any shortcut: no tiles, no early stop, the
exponential of the mathematics library. It is slow and plain, and the benchmark's reference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.constants import SH_0, SH_1, SH_2, SH_3
from rainsim.jit import serial_kernel
from rainsim.scene.view import image_point, pixel_rays

LOW_PASS = 0.3  # px^2
MIN_ALPHA = 1 / 255
MAX_ALPHA = 0.999
MARGIN = 0.15  # of the picture, where the linearised projection is clamped
MIN_COVERAGE = 0.02  # alpha below which a pixel has no depth
EDGE_ON, PLANE_LIMIT = 0.02, 0.2  # see `rainsim.splatting.blend`
LAYERS = 8  # colour (3), depth, normal (3), plane distance
SH_FACTORS = (SH_0, SH_1, *SH_2, *SH_3)


@dataclass(frozen=True)
class Truth:
    """The layers of a camera's picture, float64, as `rainsim.raster.Layers` defines them."""

    color: np.ndarray  # (height, width, 3), display-referred, over black
    alpha: np.ndarray
    depth: np.ndarray
    median_depth: np.ndarray
    plane_depth: np.ndarray
    normal: np.ndarray  # (height, width, 3), unit, camera frame


def draw_truth(splats, camera, near=0.01, drop_last=False):
    """Return the `Truth` of `splats` (Splats) for `camera`; `near` is in world units.

    `drop_last` leaves out, as gsplat and the original code do, the splat that would bring a pixel's
    transmittance to 1e-4 and all behind it.
    """
    ellipse, values = _project(splats, camera, near)
    sums = np.zeros((camera.height, camera.width, LAYERS))
    clear = np.ones((camera.height, camera.width))
    median = np.full((camera.height, camera.width), np.inf)
    _blend(ellipse, values, 1e-4 if drop_last else -1.0, sums, clear, median)
    return _finish(camera, sums, 1 - clear, median)


def _project(splats, camera, near):
    """Return (n, 8) u, v, conic (3), opacity, half sizes (2) and (n, 8) layers, nearest first."""
    matrix = np.asarray(camera.camera_from_world, float)
    turn = matrix[:3, :3]
    point = splats.position.astype(float) @ turn.T + matrix[:3, 3]
    kept = np.flatnonzero((point[:, 2] >= near) & (splats.opacity >= MIN_ALPHA))
    kept = kept[np.argsort(point[kept, 2], kind="stable")]
    x, y, z = point[kept].T
    own = Rotation.from_quat(splats.rotation[kept].astype(float), scalar_first=True)
    axes = turn @ own.as_matrix()
    thinnest = np.argmin(splats.scale[kept], axis=1)
    normal = np.take_along_axis(axes, thinnest[:, None, None], axis=2)[..., 0]
    jacobian = np.zeros((len(kept), 2, 3))
    w = np.ones_like(z) if camera.orthographic else z
    jacobian[:, 0, 0], jacobian[:, 1, 1] = camera.fx / w, camera.fy / w
    if not camera.orthographic:
        for k, (f, c, side) in enumerate(
            ((camera.fx, camera.cx, camera.width), (camera.fy, camera.cy, camera.height))
        ):
            slope = np.clip(point[kept, k] / z, (-c - MARGIN * side) / f,
                            (side - c + MARGIN * side) / f)  # fmt: skip
            jacobian[:, k, 2] = -f * slope / z
    half = jacobian @ (axes * splats.scale[kept].astype(float)[:, None, :])
    cov = half @ half.transpose(0, 2, 1) + LOW_PASS * np.eye(2)
    conic = np.linalg.inv(cov)
    opacity = splats.opacity[kept].astype(float)
    reach = np.sqrt(2 * np.log(opacity / MIN_ALPHA))
    ellipse = np.stack([
        *image_point(camera, x, y, w),
        conic[:, 0, 0], conic[:, 0, 1], conic[:, 1, 1], opacity,
        reach * np.sqrt(cov[:, 0, 0]), reach * np.sqrt(cov[:, 1, 1]),
    ], axis=1)  # fmt: skip
    if camera.orthographic:
        way = np.broadcast_to(camera.forward, (len(kept), 3))
    else:
        way = splats.position[kept] - camera.position
        way = way / np.linalg.norm(way, axis=1, keepdims=True)
    sh = splats.sh[kept].astype(float)
    color = np.maximum(np.einsum("nk,nkc->nc", _harmonics(way, sh.shape[1]), sh) + 0.5, 0)
    distance = np.einsum("nc,nc->n", normal, point[kept])
    away = (normal[:, 2] if camera.orthographic else distance) > 0
    sign = np.where(away, -1.0, 1.0)
    values = np.column_stack([color, z, normal * sign[:, None], distance * sign])
    return ellipse, values


def _harmonics(way, count):
    """Return the first `count` real spherical harmonics (n, count) in the unit directions `way`."""
    x, y, z = way.T
    a, b, c, d, e, f, g, h, i, j = SH_FACTORS
    basis = [
        a + 0 * x, -b * y, b * z, -b * x,
        c * x * y, -c * y * z, d * (2 * z * z - x * x - y * y), -c * x * z, e * (x * x - y * y),
        -f * y * (3 * x * x - y * y), g * x * y * z, -h * y * (4 * z * z - x * x - y * y),
        i * z * (2 * z * z - 3 * x * x - 3 * y * y), -h * x * (4 * z * z - x * x - y * y),
        j * z * (x * x - y * y), -f * x * (x * x - 3 * y * y),
    ]  # fmt: skip
    return np.stack(basis[:count], axis=1)


@serial_kernel
def _blend(ellipse, values, stop, sums_out, clear_out, median_out):
    """Blend the splats in their order; a negative transmittance marks a pixel that has ended."""
    height, width, layers = sums_out.shape
    for s in range(len(ellipse)):
        u, v, a, b, c, opacity, ex, ey = ellipse[s]
        # One pixel more than the ellipse's box; a splat with NaN reaches no pixel.
        if not (abs(u) < 1e9 and abs(v) < 1e9 and ex < 1e9 and ey < 1e9):
            continue
        for j in range(max(0, int(v - ey) - 1), min(height, int(v + ey) + 2)):
            for i in range(max(0, int(u - ex) - 1), min(width, int(u + ex) + 2)):
                dx, dy = i + 0.5 - u, j + 0.5 - v
                power = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
                alpha = min(opacity * np.exp(-power), MAX_ALPHA)
                before = clear_out[j, i]
                if alpha < MIN_ALPHA or before < 0:
                    continue
                after = before * (1 - alpha)
                if after <= stop:
                    clear_out[j, i] = -before
                    continue
                for k in range(layers):
                    sums_out[j, i, k] += alpha * before * values[s, k]
                if before > 0.5 and after <= 0.5:
                    median_out[j, i] = values[s, 3]
                clear_out[j, i] = after
    for j in range(height):
        for i in range(width):
            clear_out[j, i] = abs(clear_out[j, i])


def _finish(camera, sums, alpha, median):
    """Return the Truth from the sums, alpha and median depth of the pixels."""
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = sums[..., 3] / alpha
        length = np.linalg.norm(sums[..., 4:7], axis=-1)
        known = (alpha >= MIN_COVERAGE) & (length > 0)
        a, b, _ = np.moveaxis(pixel_rays(camera), -1, 0)
        flat = sums[..., 4] * a + sums[..., 5] * b
        along = sums[..., 6] + (0 if camera.orthographic else flat)
        plane = (sums[..., 7] - (flat if camera.orthographic else 0)) / along
        limit = np.inf if camera.orthographic else PLANE_LIMIT * depth
        good = (along <= -EDGE_ON * alpha) & (np.abs(plane - depth) < limit)
        plane = np.where(good, plane, depth)
        normal = np.where(known[..., None], sums[..., 4:7] / length[..., None], 0)
    return Truth(
        sums[..., :3], alpha, np.where(known, depth, np.inf),
        np.where(known, median, np.inf), np.where(known, plane, np.inf), normal,
    )  # fmt: skip
