"""Spray of tyres in a picture: drops that show one by one, and clouds of all others.

What tyres have thrown (`rain.throws`) is parcels of drops. A drop is drawn as rain is, as a streak
of its path over the exposure, if a pixel would show it; the drops that are too small or too many
are Gaussian clouds, as are the mist's. A drop is in one of both, so that all of them replace the
same light wherever the line is drawn.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import FAR_AWAY, HALF, ONE, ZERO
from rainsim.jit import (
    TAKERS,
    cpu_kernel,
    inlined_function,
    lean_function,
    none_taken,
    prange,
    take_next,
)
from rainsim.numerics.approximations import exp_minus
from rainsim.numerics.random import subkey, uniform_triple
from rainsim.particles.line_raster import FAINTEST, NEAR
from rainsim.rain.throws import FLIGHT, Puffs, column, cross_section, flown, flying, mist_puffs
from rainsim.scene.view import camera_points, edge_planes, finest, lens_array

MOST_DRAWN = 120_000  # drops of a picture that are drawn one by one
MOST_OF_ONE = 4000  # drops of a parcel
NO_LINES = np.zeros((0, 7))
NO_PUFFS = Puffs(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
FIRST_SPREAD, SPREAD, MOST_SPREAD = 0.02, 0.06, 0.25  # m, 1, m: deviation of a parcel's drops
# around its middle: at the tyre, over the way flown, at most; assumptions
UNEVEN = 0.15  # of the velocity: deviation from drop to drop of a parcel; an assumption
THINNEST = 2e-4  # optical depth of a puff's middle; what is less shows in no picture
ROWS = 8  # of a picture that a thread takes at a time
CUT = 3.0  # deviations at which a puff ends: 1 % of its mass lies beyond along a line of sight
FIRST_WORD = 32  # of the random words of a parcel that its drops have
_LOGISTIC = np.float32(1.702)  # the normal distribution as a logistic one, to 0.01
_PER_TWO_PI = np.float32(0.5 / math.pi)


class Flocks(NamedTuple):
    """Drops of parcels that are drawn one by one, each parcel's scattered around its middle.

    Attributes
    ----------
    place, velocity : ndarray of shape (n, 3), float64 [m], [m/s]
    spread : ndarray of shape (n,), float64 [m]
        Deviation of the drops' places.
    diameter, road : ndarray of shape (n,), float64 [m]
        Drops lower than `road` are not drawn.
    id : ndarray of shape (n,), uint64
    count : ndarray of shape (n,), int64
    """

    place: np.ndarray
    velocity: np.ndarray
    spread: np.ndarray
    diameter: np.ndarray
    road: np.ndarray
    id: np.ndarray
    count: np.ndarray


def spray_seen(throws, ids, camera, time, exposure):
    """Return the spray that a camera may see: drops and clouds.

    Parameters
    ----------
    throws, ids
        Of a `SimState`.
    camera : Camera
        In the ground frame.
    time, exposure : float [s]

    Returns
    -------
    lines : ndarray of shape (n, 7), float64
        Drops, the columns of `streaks.Line`.
    puffs : Puffs
    """
    flocks, puffs = flocks_seen(throws, ids, camera, time, exposure)
    return NO_LINES if flocks is None else scattered(flocks), puffs


def flocks_seen(throws, ids, camera, time, exposure, flying=flying):
    """Return what `spray_seen` does, but the `Flocks` of the drops; None without throws."""
    if not len(throws):
        return None, NO_PUFFS
    recent = (column(throws, "end") > time - FLIGHT) & (column(throws, "begin") <= time)
    parcels = flying(throws[recent], ids[recent], time)
    place, velocity = flown(parcels, time - parcels.begin)
    spread = FIRST_SPREAD + SPREAD * np.linalg.norm(place - parcels.start, axis=1)
    spread = np.minimum(spread, MOST_SPREAD)
    seen = (place[:, 2] > parcels.road) & _in_view(camera, place, 3 * spread)
    parcels, place, velocity, spread = (
        parcels.take(seen), place[seen], velocity[seen], spread[seen]
    )  # fmt: skip
    number = parcels.volume / (math.pi / 6 * parcels.diameter**3)
    drawn = _drawn(camera, parcels.diameter, place, velocity, exposure, number)
    flocks = Flocks(place, velocity, spread, parcels.diameter, parcels.road, parcels.id,
                    drawn.astype(np.int64))  # fmt: skip
    left = cross_section(parcels.volume, parcels.diameter) * (1 - drawn / number)
    mist = mist_puffs(throws, time)
    puffs = Puffs(*(np.concatenate(both) for both in zip(
        Puffs(place, spread, left), mist, strict=True)))  # fmt: skip
    thick = puffs.section / (2 * math.pi * puffs.deviation**2) > THINNEST
    thick &= _in_view(camera, puffs.place, CUT * puffs.deviation)
    return flocks, Puffs(*(part[thick] for part in puffs))


def _in_view(camera, place, radius):
    """Return which balls (n,) may be in a camera's picture."""
    seen = camera_points(camera, place)
    aside = seen @ edge_planes(camera).T
    return (seen[:, 2] + radius > NEAR) & (aside > -radius[:, None]).all(axis=1)


def _drawn(camera, diameter, place, velocity, exposure, number):
    """Return how many drops of each parcel are drawn one by one, (n,) float64, whole numbers."""
    depth = place @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
    focal = finest(camera)
    depth = np.maximum(depth, NEAR)
    cover = math.pi / 4 * (focal * diameter / depth) ** 2  # px
    length = focal / depth * np.linalg.norm(velocity, axis=1) * exposure
    shows = cover / np.maximum(length, 1.0) > FAINTEST
    drawn = np.where(shows, np.minimum(number, MOST_OF_ONE), 0.0)
    return np.floor(drawn * min(1.0, MOST_DRAWN / max(drawn.sum(), 1.0)))


def scattered(flocks):
    """Return the drops of `Flocks`, (n, 7)."""
    place, velocity, spread, diameter, road, ids, count = flocks
    which = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    words = subkey(ids[which], within + FIRST_WORD)
    a, b, c = uniform_triple(words)
    d, e, f = uniform_triple(subkey(words, 1))
    # Box and Muller: two normal numbers of two even ones.
    normal = [r * turn(2 * math.pi * t)
              for r, t in ((np.sqrt(-2 * np.log(a)), b), (np.sqrt(-2 * np.log(c)), d),
                           (np.sqrt(-2 * np.log(e)), f))
              for turn in (np.cos, np.sin)]  # fmt: skip
    at = place[which] + spread[which, None] * np.column_stack(normal[:3])
    speed = np.linalg.norm(velocity, axis=1)[which, None]
    moves = velocity[which] + UNEVEN * speed * np.column_stack(normal[3:])
    lines = np.column_stack([at, moves, diameter[which]])
    return lines[at[:, 2] > road[which]]


def lay_clouds(puffs, camera, depth, alpha_out):
    """Put clouds before a picture.

    Parameters
    ----------
    puffs : Puffs
    camera : Camera
        In the ground frame.
    depth : ndarray of shape (height, width), float32 [m]
        Along the view axis, of what the clouds are before or behind.
    alpha_out : ndarray of shape (height, width), float32
        Share of light that drops replace; the clouds' is added as of one behind the other.
    """
    if len(puffs.section):
        lens = lens_array(camera)
        _lay_clouds(cloud_table(puffs, camera), lens, depth, alpha_out)


def cloud_table(puffs, camera):
    """Return clouds as the kernels of both backends take them, ndarray of shape (n, 5), float32.

    Place in the camera's frame, deviation [m] and cross-section [m2].
    """
    place = camera_points(camera, puffs.place)
    return np.column_stack([place, puffs.deviation, puffs.section]).astype(np.float32)


@cpu_kernel
def _lay_clouds(puffs, lens, depth, alpha_out):
    """Blend the clouds `puffs`, a `cloud_table`, into the alpha, see `lay_clouds`."""
    height, width = alpha_out.shape
    bands = (height + ROWS - 1) // ROWS
    taken = none_taken()  # clouds stand close together: some bands have most of them
    for _taker in prange(TAKERS):
        band = take_next(taken)
        if band >= bands:
            continue
        optical = np.empty((ROWS, width), np.float32)
        while band < bands:
            first, end = band * ROWS, min((band + 1) * ROWS, height)
            optical[:] = ZERO
            for n in range(puffs.shape[0]):
                _add_cloud(puffs, n, lens, first, end, depth, optical)
            for row in range(first, end):
                for k in range(width):
                    through = exp_minus(optical[row - first, k])
                    alpha_out[row, k] = ONE - (ONE - alpha_out[row, k]) * through
            band = take_next(taken)


@lean_function
def _add_cloud(puffs, n, lens, first, end, depth, optical_out):
    """Add the optical depth of one Gaussian cloud to a band of rows, see `cloud_thickness`."""
    x, y, z, deviation, section = puffs[n, 0], puffs[n, 1], puffs[n, 2], puffs[n, 3], puffs[n, 4]
    reach = np.float32(CUT) * deviation
    nearest = z - reach
    width = np.float32(depth.shape[1])
    left, right = ZERO, width
    top, bottom = np.float32(first), np.float32(end)
    if nearest > HALF * deviation:  # else the camera stands in it or beside it
        fx, fy = lens[0], lens[1]
        far_x, far_y = reach + abs(x) * reach / z, reach + abs(y) * reach / z
        left = max(left, fx * (x - far_x) / nearest + lens[2] if x < far_x else ZERO)
        right = min(right, fx * (x + far_x) / nearest + lens[2] if x > -far_x else width)
        high = fy * (y - far_y) / nearest + lens[3] if y < far_y else top
        low = fy * (y + far_y) / nearest + lens[3] if y > -far_y else bottom
        top, bottom = max(top, high), min(bottom, low)
    if top >= bottom or left >= right:
        return
    cloud = cloud_of(x, y, z, deviation, section)
    # Whole numbers without a sign: an index that may be negative keeps LLVM from vectorising.
    begin, stop = np.uint32(max(left, ZERO)), np.uint32(min(int(right) + 1, depth.shape[1]))
    per_x = ONE / lens[0]
    for row in range(np.uint32(top), np.uint32(min(int(bottom) + 1, end))):
        b = (np.float32(row) + HALF - lens[3]) / lens[1]
        line = np.uint32(row - first)
        if cloud.nearest < ZERO:
            for k in range(begin, stop):
                a = (np.float32(np.int32(k)) + HALF - lens[2]) * per_x
                optical_out[line, k] += cloud_thickness(a, b, depth[row, k], cloud, True)
        else:
            for k in range(begin, stop):
                a = (np.float32(np.int32(k)) + HALF - lens[2]) * per_x
                optical_out[line, k] += cloud_thickness(a, b, depth[row, k], cloud, False)


class Cloud(NamedTuple):
    """A Gaussian cloud in the camera's frame, with the terms that all rays share; float32."""

    x: float
    y: float
    z: float
    square: float  # m2: of the distance
    per_two_variances: float  # m-2
    most: float  # optical depth through the middle
    steep: float  # m-1: of the share of the mass along a ray
    clear: float  # m2: square of the distance up to which a ray passes beside it
    nearest: float  # m


@inlined_function
def cloud_of(x, y, z, deviation, section):
    """Return the `Cloud` of a row of a `cloud_table`."""
    reach = np.float32(CUT) * deviation
    square = x * x + y * y + z * z
    return Cloud(
        x, y, z, square, HALF / (deviation * deviation),
        section * _PER_TWO_PI / (deviation * deviation), _LOGISTIC / deviation,
        square - reach * reach, z - reach,
    )  # fmt: skip


@inlined_function
def passes_beside(a, b, cloud):
    """Return whether the ray (a, b, 1) passes a cloud farther away than `CUT` deviations."""
    towards = a * cloud.x + b * cloud.y + cloud.z
    return towards * towards < cloud.clear * (ONE + a * a + b * b)


@inlined_function
def cloud_thickness(a, b, depth, cloud, around):
    """Return the optical depth of a cloud along the ray (a, b, 1) up to a depth [m].

    Along a ray that passes it at the distance b it is S / (2 pi s^2) exp(-b^2 / (2 s^2)) times the
    share of the mass before what the pixel shows, S the cross-section and s the deviation; 0 where
    the ray `passes_beside`. `around` says that the camera may have some of the cloud behind it,
    which is left out. Without branches, so that a processor does many pixels at once.
    """
    long = math.sqrt(ONE + a * a + b * b)
    along = (a * cloud.x + b * cloud.y + cloud.z) / long
    aside = max(cloud.square - along * along, ZERO)
    share = _logistic((min(depth, FAR_AWAY) * long - along) * cloud.steep)
    if around:
        share -= _logistic(-cloud.steep * along)
    thickness = cloud.most * exp_minus(aside * cloud.per_two_variances) * max(share, ZERO)
    return ZERO if passes_beside(a, b, cloud) else thickness


@inlined_function
def _logistic(x):
    """Return 1 / (1 + exp(-x)) within 3e-6 of it."""
    e = exp_minus(abs(x))
    part = ONE / (ONE + e)
    return part if x > ZERO else e * part
