"""Environment maps: equirectangular pictures of the surroundings, linear light, ground frame.

Column and row of a direction: azimuth 0 (the ground frame's x axis) is the map's middle column,
azimuth grows to the left (a panorama as seen from inside), row 0 is the zenith.
"""

import functools
import math

import numpy as np
from scipy import ndimage

from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import device_function, inlined_function
from rainsim.numerics.approximations import angle
from rainsim.numerics.interpolation import four_colors
from rainsim.scene.types import Camera, pose_at
from rainsim.scene.view import image_point

ROWS, COLUMNS = 128, 256
GLOSS_BLUR = (math.radians(10), math.radians(6))  # of elevation and azimuth; by eye
COAT_BLUR = (math.radians(2.5), math.radians(2.5))  # of drops and unevenness; by eye
FACE = 160  # px, side of the pictures that a probe of the capture is made from

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


def blurred(environment, by=GLOSS_BLUR):
    """Return a map as a wet rough surface mirrors it: its lobe is longer than wide.

    Or another surface, whose lobe has the deviations `by` of elevation and azimuth [rad].
    """
    rows = environment.shape[0]
    sigma = (by[0] * rows / np.pi, by[1] * rows / np.pi, 0)
    made = ndimage.gaussian_filter(environment, sigma, mode=("nearest", "wrap", "nearest"))
    return np.ascontiguousarray(made, dtype=np.float32)


def glossy(environment):
    """Return a map as wet rough things mirror it, and as water on smooth things does."""
    return blurred(environment), blurred(environment, COAT_BLUR)


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
    """Return the map (rows, columns, n) of all directions seen from `position` (ground frame, m).

    draw : callable. draw(camera) returns the square picture of n channels that
        the ground-frame `camera` sees.
    position : array (3,) [m]
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
            column, row = image_point(camera, *local.T)
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
    pose = pose_at(np.array([right, -up, forward]), position)
    return Camera(side, side, *(4 * [side / 2]), pose)


@device_function
def sample_environment(environment, x, y, z):
    """Return the map's radiance (three numbers) in the direction (x, y, z), interpolated."""
    return color_in_map(environment, azimuth_in_map(x, y), elevation_in_map(x, y, z))


@inlined_function
def azimuth_in_map(x, y):
    """Return at which share of a map's columns the direction (x, y) of the ground frame appears.

    0 and 1 are the map's left and right edge, the direction -x; 0.5 is x, 0.25 is y.
    """
    return HALF - angle(y, x) * INV_TWO_PI


@inlined_function
def elevation_in_map(x, y, z):
    """Return at which share of a map's rows the direction (x, y, z) of the ground frame appears.

    0 is the zenith, 0.5 the horizon, 1 straight down.
    """
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
