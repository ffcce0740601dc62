"""Light from around: an equirectangular environment map in the ground frame, linear light.

Column and row of a direction: azimuth 0 (the ground frame's x axis) is the map's middle column,
azimuth grows to the left (a panorama as seen from inside), row 0 is the zenith.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.jit import device_function
from rainsim.light import angle, four_colors
from rainsim.scene.types import Camera

ROWS, COLUMNS = 128, 256
ZENITH_RADIANCE = 1.2  # of display white: overcast sky over wet ground at a normal exposure
OVERCAST_TINT = np.array([0.95, 1.0, 1.06])  # a dull sky is slightly blue (about 7000 K)
GROUND_ALBEDO = 0.15  # what the lower half of a plain sky map shows
DROP_FIELD = np.radians(165 / 2)  # half the angle that a drop gathers light from (Garg, Nayar 2007)
DROP_TRANSMISSION, DROP_AMBIENT = 0.94, 0.06  # share refracted from that field, and the rest
FACE = 160  # px, side of the pictures that a probe of the capture is made from

ZERO = np.float32(0)
ONE = np.float32(1)
HALF = np.float32(0.5)
INV_TWO_PI = np.float32(0.5 / np.pi)
INV_PI = np.float32(1 / np.pi)


def directions(rows=ROWS, columns=COLUMNS):
    """Return the unit direction of each map texel, ndarray of shape (rows, columns, 3)."""
    elevation = (0.5 - (np.arange(rows) + 0.5) / rows) * np.pi
    azimuth = (0.5 - (np.arange(columns) + 0.5) / columns) * 2 * np.pi
    elevation, azimuth = np.meshgrid(elevation, azimuth, indexing="ij")
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)


def overcast(brightness=1.0):
    """Return the map of an overcast sky over dull ground.

    Moon and Spencer 1942: L = Lz (1 + 2 sin(elevation)) / 3 above the horizon, which gives the
    ground the irradiance (7/9) pi Lz.
    """
    sine = directions()[..., 2]
    zenith = ZENITH_RADIANCE * brightness
    above = zenith * (1 + 2 * np.maximum(sine, 0)) / 3
    below = GROUND_ALBEDO * zenith * 7 / 9
    # No edge at the horizon: haze mixes the two within some degrees.
    mix = np.clip(sine / 0.05 + 0.5, 0, 1)
    radiance = below + (above - below) * mix
    return np.ascontiguousarray(radiance[..., None] * OVERCAST_TINT, dtype=np.float32)


def from_panorama(panorama, brightness=1.0):
    """Return the map of an equirectangular HDR picture, scaled to the overcast sky's irradiance.

    An HDR panorama has arbitrary units; the captured picture has its own exposure. So the mean
    radiance of the upper half, weighted by the cosine, is set to that of `overcast`.
    """
    rows = np.linspace(0, panorama.shape[0], ROWS + 1).astype(int)
    columns = np.linspace(0, panorama.shape[1], COLUMNS + 1).astype(int)
    if panorama.shape[0] >= ROWS and panorama.shape[1] >= COLUMNS:
        total = np.add.reduceat(np.add.reduceat(panorama, rows[:-1], axis=0), columns[:-1], axis=1)
        area = np.diff(rows)[:, None] * np.diff(columns)[None, :]
        scaled = total / area[..., None]
    else:
        row = np.minimum((np.arange(ROWS) + 0.5) / ROWS * panorama.shape[0], panorama.shape[0] - 1)
        column = (np.arange(COLUMNS) + 0.5) / COLUMNS * panorama.shape[1]
        column = np.minimum(column, panorama.shape[1] - 1)
        scaled = panorama[row.astype(int)][:, column.astype(int)]
    wanted = irradiance(overcast(brightness))[1]
    present = max(irradiance(scaled)[1], 1e-6)
    return np.ascontiguousarray(scaled * (wanted / present), dtype=np.float32)


def irradiance(environment):
    """Return the irradiance / pi that level ground receives from the map, three numbers."""
    direction = directions(*environment.shape[:2])
    weight = np.maximum(direction[..., 2], 0) * np.sqrt(1 - direction[..., 2] ** 2)
    return np.einsum("ij,ijc->c", weight, environment) / weight.sum()


def horizon_radiance(environment):
    """Return the mean radiance just above the horizon, float32 (3,): the light of distant air."""
    sine = directions(*environment.shape[:2])[..., 2]
    return environment[(sine > 0.03) & (sine < 0.15)].mean(axis=0)


def probe(draw, position):
    """Return the map of what lies all around `position` (ground frame, m).

    Parameters
    ----------
    draw : callable
        draw(camera) returns the picture (160, 160, 3) in linear light that the ground-frame
        `camera` sees.
    position : ndarray of shape (3,) [m]
    """
    direction = directions()
    radiance = np.zeros((ROWS, COLUMNS, 3), np.float32)
    axis = np.argmax(np.abs(direction), axis=-1)
    for a in range(3):
        for sign in (1, -1):
            which = (axis == a) & (np.sign(direction[..., a]) == sign)
            camera = _face(a, sign, position)
            picture = draw(camera)
            local = direction[which] @ camera.camera_from_world[:3, :3].T
            column = camera.fx * local[:, 0] / local[:, 2] + camera.cx
            row = camera.fy * local[:, 1] / local[:, 2] + camera.cy
            row = np.clip(row.astype(int), 0, FACE - 1)
            column = np.clip(column.astype(int), 0, FACE - 1)
            radiance[which] = picture[row, column]
    return radiance


def _face(axis, sign, position):
    """Return the camera of the cube face that looks along +-axis of the ground frame."""
    forward = np.zeros(3)
    forward[axis] = sign
    up = np.array([0.0, 0.0, 1.0]) if axis != 2 else np.array([1.0, 0.0, 0.0])
    right = np.cross(forward, up)
    matrix = np.eye(4)
    matrix[:3, :3] = (right, -up, forward)
    matrix[:3, 3] = -matrix[:3, :3] @ position
    return Camera(FACE, FACE, FACE / 2, FACE / 2, FACE / 2, FACE / 2, matrix)


def drop_radiance(environment, forward):
    """Return the radiance of a raindrop seen along `forward` (unit, ground frame).

    A drop is a wide-angle lens: it shows the mean of some 165 degrees of what lies behind it, and
    hardly what is right behind it (Garg and Nayar 2007, IJCV 75(1), section 3).
    """
    direction = directions(*environment.shape[:2])
    area = np.sqrt(1 - direction[..., 2] ** 2)
    inside = area * (direction @ np.asarray(forward) > np.cos(DROP_FIELD))
    field = np.einsum("ij,ijc->c", inside, environment) / inside.sum()
    around = np.einsum("ij,ijc->c", area, environment) / area.sum()
    return (DROP_TRANSMISSION * field + DROP_AMBIENT * around).astype(np.float32)


@device_function
def sample_environment(environment, x, y, z):
    """Return the map's radiance (three numbers) in the unit direction (x, y, z), interpolated."""
    rows, columns = environment.shape[0], environment.shape[1]
    u = (HALF - angle(y, x) * INV_TWO_PI) * np.float32(columns) - HALF
    v = (HALF - angle(z, math.sqrt(x * x + y * y)) * INV_PI) * np.float32(rows) - HALF
    v = min(max(v, ZERO), np.float32(rows - 1))
    i = int(u + ONE) - 1  # the floor: u is above -1
    j = min(int(v), rows - 2)
    a, b = u - np.float32(i), v - np.float32(j)
    i = i + columns if i < 0 else i
    k = i + 1 if i + 1 < columns else 0
    return four_colors(environment, j, j + 1, i, k, a, b)
