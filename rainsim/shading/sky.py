"""Light from around: an equirectangular environment map in the ground frame, linear light.

Column and row of a direction: azimuth 0 (the ground frame's x axis) is the map's middle column,
azimuth grows to the left (a panorama as seen from inside), row 0 is the zenith.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from scipy import ndimage

from rainsim.jit import device_function, inlined_function
from rainsim.light import angle, four_colors
from rainsim.scene.types import Camera

ROWS, COLUMNS = 128, 256
ZENITH_RADIANCE = 1.2  # of display white: overcast sky over wet ground at a normal exposure
OVERCAST_TINT = np.array([0.95, 1.0, 1.06])  # a dull sky is slightly blue (about 7000 K)
GROUND_ALBEDO = 0.15  # what the lower half of a plain sky map shows
PANORAMA_ROWS = 512  # of the map of a panorama: it is seen behind the scene, too
CLOUD_DEPTH = 0.3  # of the noise in the logarithm of a clouded sky's radiance
LEAST_SKY_SEEN = 0.02  # share of the upper half below which a captured sky tells nothing
SEAM = 5.0  # texels of the map, over which a captured sky goes over into the filled one
GLOSS_BLUR = (math.radians(10), math.radians(6))  # of elevation and azimuth; by eye
SUN_BLUR, SUN_PEAK = math.radians(2.5), 4.0
FACE = 160  # px, side of the pictures that a probe of the capture is made from

ZERO = np.float32(0)
ONE = np.float32(1)
HALF = np.float32(0.5)
INV_TWO_PI = np.float32(0.5 / np.pi)
INV_PI = np.float32(1 / np.pi)


@functools.cache
def directions(rows=ROWS, columns=COLUMNS):
    """Return the unit direction of each map texel, read-only ndarray (rows, columns, 3)."""
    elevation = (0.5 - (np.arange(rows) + 0.5) / rows) * np.pi
    azimuth = (0.5 - (np.arange(columns) + 0.5) / columns) * 2 * np.pi
    elevation, azimuth = np.meshgrid(elevation, azimuth, indexing="ij")
    flat = np.cos(elevation)
    found = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
    found.flags.writeable = False
    return found


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


def clouded(environment, rows=2 * ROWS, depth=CLOUD_DEPTH):
    """Return an even sky with the bellies of its clouds, (rows, 2 rows, 3), irradiance unchanged.

    Smooth noise on a sheet of cloud above, whose parts crowd towards the horizon, where haze hides
    them. By eye: a dull sky is no even grey.
    """
    direction = directions(rows, 2 * rows)
    row, column = np.indices(direction.shape[:2]) / rows
    scale = environment.shape[0]
    where = [row * scale - 0.5, column * environment.shape[1] / 2 - 0.5]
    even = np.stack(
        [
            ndimage.map_coordinates(environment[..., c], where, order=1, mode="nearest")
            for c in range(3)
        ],
        axis=-1,
    )
    height = np.maximum(direction[..., 2], 0)
    sheet = direction[..., :2] / (height[..., None] + 0.25)
    lattice = np.random.Generator(np.random.PCG64(3)).uniform(-1, 1, (64, 64))
    noise = np.zeros(height.shape)
    for octave, (size, amplitude) in enumerate(((1.7, 1.0), (0.8, 0.5), (0.36, 0.25), (0.17, 0.1))):
        at = [sheet[..., k] / size * (1.0, 0.6)[k] + 7.3 * octave for k in range(2)]
        noise += amplitude * ndimage.map_coordinates(lattice, at, order=3, mode="grid-wrap")
    fade = np.clip(height / 0.25, 0, 1)
    factor = np.exp(depth * fade * noise)
    made = even * factor[..., None]
    made *= irradiance(environment)[1] / irradiance(made)[1]
    return np.ascontiguousarray(made, dtype=np.float32)


def completed(radiance, known):
    """Return a sky map with what no camera saw filled by an overcast sky, and the share known.

    Parameters
    ----------
    radiance : ndarray of shape (rows, columns, 3), float32
    known : ndarray of shape (rows, columns), bool
        Where it is the captured sky. The fill is as bright as that, and goes over into it softly.
    """
    plain = overcast()
    above = directions()[..., 2] > 0
    area = np.cos((0.5 - (np.arange(ROWS) + 0.5) / ROWS) * np.pi)[:, None]
    share = float((area * (known & above)).sum() / (area * above).sum())
    if share < LEAST_SKY_SEEN:
        return plain, share
    ratio = np.median(radiance[known & above] / plain[known & above], axis=0)
    weight = ndimage.gaussian_filter(
        (known & above).astype(np.float64), SEAM, mode=("nearest", "wrap")
    )
    held = np.where((known & above)[..., None], radiance, 0)
    near = ndimage.gaussian_filter(held, (SEAM, SEAM, 0), mode=("nearest", "wrap", "nearest"))
    near = near / np.maximum(weight, 1e-6)[..., None]
    mix = np.clip(2 * weight, 0, 1)[..., None]
    filled = plain * ratio * (1 - mix) + near * mix
    return np.where((known & above)[..., None], radiance, filled).astype(np.float32), share


def brightest(environment):
    """Return azimuth and elevation [rad] of the sun in a sky, or None if nothing stands out.

    The sun is taken to be where the radiance, blurred over SUN_BLUR, exceeds the upper half's
    mean by SUN_PEAK.
    """
    rows, columns = environment.shape[:2]
    light = environment @ np.array([0.2126, 0.7152, 0.0722])
    blur = SUN_BLUR * rows / np.pi
    smooth = ndimage.gaussian_filter(light, blur, mode=("nearest", "wrap"))
    direction = directions(rows, columns)
    upper = direction[..., 2] > 0.02
    area = np.sqrt(1 - direction[..., 2] ** 2)
    mean = float((light * area)[upper].sum() / area[upper].sum())
    smooth = np.where(upper, smooth, 0)
    if smooth.max() < SUN_PEAK * mean:
        return None
    # The centroid of what is nearly as bright, not the texel.
    weight = np.where(smooth > 0.7 * smooth.max(), light * area, 0)
    x, y, z = np.einsum("ij,ijc->c", weight, direction)
    return math.atan2(y, x), math.atan2(z, math.hypot(x, y))


def blurred(environment):
    """Return what a wet rough surface mirrors of a map: its lobe is longer than wide."""
    rows = environment.shape[0]
    sigma = (GLOSS_BLUR[0] * rows / np.pi, GLOSS_BLUR[1] * rows / np.pi, 0)
    made = ndimage.gaussian_filter(environment, sigma, mode=("nearest", "wrap", "nearest"))
    return np.ascontiguousarray(made, dtype=np.float32)


def from_panorama(panorama, brightness=1.0):
    """Return the map of an equirectangular HDR picture, scaled to the overcast sky's irradiance.

    An HDR panorama has arbitrary units; the captured picture has its own exposure. So the mean
    radiance of the upper half, weighted by the cosine, is set to that of `overcast`.
    """
    high = min(max(panorama.shape[0], ROWS), PANORAMA_ROWS)
    wide = 2 * high
    rows = np.linspace(0, panorama.shape[0], high + 1).astype(int)
    columns = np.linspace(0, panorama.shape[1], wide + 1).astype(int)
    if panorama.shape[0] >= high and panorama.shape[1] >= wide:
        total = np.add.reduceat(np.add.reduceat(panorama, rows[:-1], axis=0), columns[:-1], axis=1)
        area = np.diff(rows)[:, None] * np.diff(columns)[None, :]
        scaled = total / area[..., None]
    else:
        row = np.minimum((np.arange(high) + 0.5) / high * panorama.shape[0], panorama.shape[0] - 1)
        column = (np.arange(wide) + 0.5) / wide * panorama.shape[1]
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


def probe(draw, position, rows=ROWS, columns=COLUMNS):
    """Return the map (rows, columns, n) of what lies all around `position` (ground frame, m).

    Parameters
    ----------
    draw : callable
        draw(camera) returns the square picture of n channels that the ground-frame `camera` sees.
    position : ndarray of shape (3,) [m]
    """
    direction = directions(rows, columns)
    side = FACE * rows // ROWS
    radiance = None
    axis = np.argmax(np.abs(direction), axis=-1)
    for a in range(3):
        for sign in (1, -1):
            which = (axis == a) & (np.sign(direction[..., a]) == sign)
            camera = _face(a, sign, position, side)
            picture = draw(camera)
            if radiance is None:
                radiance = np.zeros((rows, columns, picture.shape[-1]), np.float32)
            local = direction[which] @ camera.camera_from_world[:3, :3].T
            column = camera.fx * local[:, 0] / local[:, 2] + camera.cx
            row = camera.fy * local[:, 1] / local[:, 2] + camera.cy
            row = np.clip(row.astype(int), 0, side - 1)
            column = np.clip(column.astype(int), 0, side - 1)
            radiance[which] = picture[row, column]
    return radiance


def _face(axis, sign, position, side):
    """Return the camera of the cube face that looks along +-axis, `side` pixels wide."""
    forward = np.zeros(3)
    forward[axis] = sign
    up = np.array([0.0, 0.0, 1.0]) if axis != 2 else np.array([1.0, 0.0, 0.0])
    right = np.cross(forward, up)
    matrix = np.eye(4)
    matrix[:3, :3] = (right, -up, forward)
    matrix[:3, 3] = -matrix[:3, :3] @ position
    return Camera(side, side, *(4 * [side / 2]), matrix)


@device_function
def sample_environment(environment, x, y, z):
    """Return the map's radiance (three numbers) in the direction (x, y, z), interpolated."""
    return color_in_map(environment, azimuth_in_map(x, y), elevation_in_map(x, y, z))


@inlined_function
def azimuth_in_map(x, y):
    """Return where a map shows the azimuth of (x, y), as a share of its columns."""
    return HALF - angle(y, x) * INV_TWO_PI


@inlined_function
def elevation_in_map(x, y, z):
    """Return where a map shows the elevation of (x, y, z), as a share of its rows."""
    return HALF - angle(z, math.sqrt(x * x + y * y)) * INV_PI


@device_function
def color_in_map(environment, across, down):
    """Return the map's radiance at shares of its columns and rows, interpolated."""
    rows, columns = environment.shape[0], environment.shape[1]
    u = across * np.float32(columns) - HALF
    v = min(max(down * np.float32(rows) - HALF, ZERO), np.float32(rows - 1))
    i = int(u + ONE) - 1  # the floor: u is above -1
    j = min(int(v), rows - 2)
    a, b = u - np.float32(i), v - np.float32(j)
    i = i + columns if i < 0 else i
    k = i + 1 if i + 1 < columns else 0
    return four_colors(environment, j, j + 1, i, k, a, b)
