"""Spray of tyres in a picture: drops that show one by one, and clouds of all others.

What tyres have thrown (`rain.throws`) is parcels of drops. A drop is drawn as rain is, as a streak
of its path over the exposure, if a pixel would show it; the drops that are too small or too many
are Gaussian clouds, as are the mist's. A drop is in one of both, so that all of them replace the
same light wherever the line is drawn.
"""

import math

import numpy as np

from rainsim.constants import FAR_AWAY, HALF, ONE, ZERO
from rainsim.jit import cpu_kernel, inlined_function, interleaved, prange
from rainsim.numerics.approximations import exp_minus
from rainsim.numerics.random import subkey, uniform_triple
from rainsim.particles.line_raster import FAINTEST, NEAR
from rainsim.rain.throws import Puffs, flying, mist_puffs
from rainsim.scene.view import camera_points, edge_planes, finest, lens_array

MOST_DRAWN = 40_000  # drops of a picture that are drawn one by one
MOST_OF_ONE = 4000  # drops of a parcel
MOST_CLOUDS = 8192  # of a picture
NO_DROPS = np.zeros((0, 7))
NO_PUFFS = Puffs(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
FIRST_SPREAD, SPREAD, MOST_SPREAD = 0.02, 0.06, 0.25  # m, 1, m: deviation of a parcel's drops
# around its middle: at the tyre, over the way flown, at most; assumptions
UNEVEN = 0.15  # of the velocity: deviation from drop to drop of a parcel; an assumption
THINNEST = 2e-4  # optical depth of a puff's middle; what is less shows in no picture
CUT = 3.0  # deviations at which a puff ends: 1 % of its mass lies beyond along a line of sight
FROM_TO = np.array([[0], [1]])  # px: behind the last
STEEPEST = 1.5  # rad from the view axis, beyond which nothing is in a picture
FIRST_WORD = 32  # of the random words of a parcel that its drops have
_LOGISTIC = np.float32(1.702)  # the normal distribution as a logistic one, to 0.01
_PER_TWO_PI = np.float32(0.5 / math.pi)


def spray_seen(rolls, camera, time, exposure):
    """Return the drops (columns of `Line`) and `Puffs` that a camera may see at a time [s]."""
    if rolls is None:
        return NO_DROPS, NO_PUFFS
    rolls = rolls.take(rolls.water > 0)
    parcels = flying(rolls, time)
    spread = np.minimum(FIRST_SPREAD + SPREAD * parcels.flown, MOST_SPREAD)
    seen = _in_view(camera, parcels.place, CUT * spread)
    parcels, spread = parcels.take(seen), spread[seen]
    drawn = _drawn(camera, parcels, exposure)
    section = (parcels.number - drawn) * math.pi / 4 * parcels.diameter**2
    clouds = zip((parcels.place, spread, section), mist_puffs(rolls, time), strict=True)
    puffs = Puffs(*(np.concatenate(both) for both in clouds))
    thick = puffs.section / (2 * math.pi * puffs.deviation**2) > THINNEST
    thick &= _in_view(camera, puffs.place, CUT * puffs.deviation)
    thickest = np.sort(np.argsort(-puffs.section * thick, kind="stable")[:MOST_CLOUDS])
    thickest = thickest[thick[thickest]]
    return _scattered(parcels, spread, drawn.astype(np.int64)), Puffs(*(p[thickest] for p in puffs))


def _in_view(camera, place, radius):
    """Return which balls (n,) may be in a camera's picture."""
    seen = camera_points(camera, place)
    aside = seen @ edge_planes(camera).T
    return (seen[:, 2] + radius > NEAR) & (aside > -radius[:, None]).all(axis=1)


def _drawn(camera, parcels, exposure):
    """Return how many drops of each parcel are drawn one by one, (n,) float64, whole numbers."""
    per_depth = finest(camera) / np.maximum(camera_points(camera, parcels.place)[:, 2], NEAR)
    cover = math.pi / 4 * (per_depth * parcels.diameter) ** 2  # px
    length = per_depth * np.linalg.norm(parcels.velocity, axis=1) * exposure
    shows = cover / np.maximum(length, 1.0) > FAINTEST
    drawn = np.where(shows, np.minimum(parcels.number, MOST_OF_ONE), 0.0)
    return np.floor(drawn * min(1.0, MOST_DRAWN / max(drawn.sum(), 1.0)))


def _scattered(parcels, spread, count):
    """Return so many drops of parcels, normally distributed around their middles, (n, 7)."""
    which = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    words = subkey(parcels.id[which], within + FIRST_WORD)
    even = np.array(uniform_triple(words)), np.array(uniform_triple(subkey(words, 1)))
    # Box and Muller: two normal numbers of two even ones.
    radius, turn = np.sqrt(-2 * np.log(even[0])), 2 * math.pi * even[1]
    place = parcels.place[which] + (spread[which] * radius * np.cos(turn)).T
    velocity = parcels.velocity[which]
    uneven = UNEVEN * np.linalg.norm(velocity, axis=1) * radius * np.sin(turn)
    drops = np.column_stack([place, velocity + uneven.T, parcels.diameter[which]])
    return drops[place[:, 2] > parcels.road[which]]


def lay_clouds(puffs, camera, depth, alpha_out):
    """Put clouds before a picture.

    depth : float32 array (height, width) [m]. Along the view axis, of what the
        clouds are before or behind.
    alpha_out : float32 array (height, width). Share of light that drops replace;
        the clouds' is added as of one behind the other.
    """
    if len(puffs.section):
        clouds, boxes = cloud_table(puffs, camera)
        rows = interleaved(len(depth))
        _lay_clouds(clouds, boxes, lens_array(camera), rows, depth, alpha_out)


def cloud_table(puffs, camera):
    """Return clouds as the kernels of both backends take them.

    Returns clouds : float32 array (n, 5) [m], [m2]. Place in the camera's frame,
        deviation and cross-section.
        boxes : int32 array (n, 4) [px]. First column and the one behind the last,
            and rows so, of what shows a cloud up to CUT.
    """
    place, reach = camera_points(camera, puffs.place), CUT * puffs.deviation
    boxes = np.empty((len(place), 4), np.int32)
    for k, (focal, middle, size) in enumerate((
        (camera.fx, camera.cx, camera.width), (camera.fy, camera.cy, camera.height),
    )):  # fmt: skip
        away = np.hypot(place[:, k], place[:, 2])
        half = np.arcsin(np.minimum(reach / np.maximum(away, 1e-9), 1.0))
        turn = np.arctan2(place[:, k], place[:, 2]) + np.array([-half, half])
        ends = middle + focal * np.tan(np.clip(turn, -STEEPEST, STEEPEST))
        boxes[:, 2 * k : 2 * k + 2] = np.clip(ends + FROM_TO, 0, size).T
    clouds = np.column_stack([place, puffs.deviation, puffs.section])
    return clouds.astype(np.float32), boxes


@cpu_kernel
def _lay_clouds(clouds, boxes, lens, rows, depth, alpha_out):
    """Blend clouds, a `cloud_table`, into the alpha, `rows` in this order; see `lay_clouds`."""
    height, width = alpha_out.shape
    per_x = ONE / lens[0]
    for at in prange(height):
        row, optical = rows[at], np.zeros(width, np.float32)
        b = (np.float32(row) + HALF - lens[3]) / lens[1]
        for n in range(len(clouds)):
            if boxes[n, 2] <= row < boxes[n, 3]:
                x, y, z = clouds[n, 0], clouds[n, 1], clouds[n, 2]
                deviation, section = clouds[n, 3], clouds[n, 4]
                # Whole numbers without a sign: of others LLVM does not take many at once.
                for k in range(np.uint32(boxes[n, 0]), np.uint32(boxes[n, 1])):
                    a = (np.float32(np.int32(k)) + HALF - lens[2]) * per_x
                    optical[k] += cloud_thickness(a, b, depth[row, k], x, y, z, deviation, section)
        for k in range(width):
            alpha_out[row, k] = ONE - (ONE - alpha_out[row, k]) * exp_minus(optical[k])


@inlined_function
def cloud_thickness(a, b, depth, x, y, z, deviation, section):
    """Return the optical depth of a cloud along the ray (a, b, 1) up to a depth [m].

    Along a ray that passes it at the distance b it is S / (2 pi s^2) exp(-b^2 / (2 s^2)) times the
    share of the mass between the camera and what the pixel shows, S the cross-section and s the
    deviation. Without branches, so that a processor does many pixels at once.
    """
    long = math.sqrt(ONE + a * a + b * b)
    along = (a * x + b * y + z) / long
    aside = max(x * x + y * y + z * z - along * along, ZERO)
    steep, square = _LOGISTIC / deviation, deviation * deviation
    share = _logistic((min(depth, FAR_AWAY) * long - along) * steep) - _logistic(-along * steep)
    most = section * _PER_TWO_PI / square
    return most * exp_minus(aside * HALF / square) * max(share, ZERO)


@inlined_function
def _logistic(x):
    """Return 1 / (1 + exp(-x)) within 3e-6 of it."""
    e = exp_minus(abs(x))
    part = ONE / (ONE + e)
    return part if x > ZERO else e * part
