"""Which drops a cube of air holds: counts, places and sizes from random words alone.

In the frame that moves with a size class its drops are a frozen Poisson field, cut into cubes. What
`drops` lists and `streaks` draws are both read from here.
"""

from __future__ import annotations

import functools

import numpy as np

from rainsim.jit import device_function, lean_function
from rainsim.random import mix, subkey, uniform
from rainsim.spectrum import CLASSES, RainSpectrum

_CUBE_FILL = 6.0  # drops per cube aimed at: fewer make cubes cost more than their drops
_CUBE_SIDES = (0.5, 2.0)  # m; large cubes reach far out of the box that is asked for
_FILL_RATE = 25.0  # mm/h; fixed, so that cubes, and with them drops, stay when the rate changes
_SPREAD = np.uint64(0x9E3779B97F4A7C15)
_SHARE_STREAM = np.uint64(0x51A4)  # tells whether the drop is there at all
_DIAMETER_STREAM = np.uint64(0xD1A3)  # tells the diameter's random word from the place's


@device_function
def cube_key(class_key, i, j, k):
    """Return the random key (uint64) of cube (i, j, k) of a class."""
    return subkey(subkey(subkey(class_key, i), j), k)


@lean_function
def drops_in_cube(key, size_class, count):
    """Return how many drops the cube of that key holds, by inverting the Poisson distribution."""
    chance = uniform(key)
    drops = 0
    while chance >= count[size_class, drops]:
        drops += 1
    return drops


@device_function
def drop_id(key, drop):
    """Return the random word of drop number `drop` of a cube; its bits are the drop's place."""
    return subkey(key, drop + 1)


@lean_function
def left_out(word, size_class, z, vz, share, frame):
    """Tell whether a drop that would be at height z [m] at time 0 is not in the rain of its time.

    Its time is when it passes z = 0.
    """
    ticks = share.shape[1]
    if ticks == 1:
        return False
    at = min(max((-z / vz - frame[size_class, 2]) * frame[size_class, 3], 0.0), ticks - 1.0)
    tick = min(int(at), ticks - 2)
    part = at - tick
    there = share[size_class, tick] * (1.0 - part) + share[size_class, tick + 1] * part
    return uniform(mix(word ^ _SHARE_STREAM)) >= there


@lean_function
def drop_diameter(word, size_class, size):
    """Return the diameter [m] of the drop with that id: exponential within its class."""
    chance = uniform(mix(word ^ _DIAMETER_STREAM))
    return size[size_class, 0] - np.log(1 - chance * size[size_class, 1]) * size[size_class, 2]


def slab_tasks(first, last):
    """Return the work items (class, i), int64, of cube ranges, shuffled to balance the threads."""
    counts = np.maximum(last[:, 0] - first[:, 0] + 1, 0)
    size_class = np.repeat(np.arange(len(counts)), counts)
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    tasks = np.stack([size_class, first[size_class, 0] + step], axis=1).astype(np.int64)
    return tasks[_shuffled(len(tasks))]


@functools.lru_cache(64)
def _shuffled(count):
    return np.random.Generator(np.random.PCG64(0)).permutation(count)


def swept_cubes(field, surfaces, start, stop, within=None):
    """Return the cubes whose drops may end on the map in an interval.

    Parameters
    ----------
    field, surfaces, within
        As `drops.impacts` has them.
    start, stop : float or ndarray of shape (CLASSES,) [s]

    Returns
    -------
    first, last : ndarray of shape (CLASSES, 3), int64
        The first and last cubes of each class; `drops.cubes_swept` says which of them along z.
    corner, opposite : ndarray of shape (2,) [m]
        Of the part of the map that is asked for.
    """
    start = np.asarray(start, np.float64)[..., None]
    corner, ny, nx = np.array(surfaces.origin, np.float64), *surfaces.shape
    opposite = corner + np.array([nx, ny]) * surfaces.spacing
    if within is not None:
        corner = np.maximum(corner, within[0])
        opposite = np.maximum(np.minimum(opposite, within[1]), corner)
    drift, offset = field.velocity * (np.asarray(stop)[..., None] - start), field.velocity * start
    first, last = field.cube_range(
        np.append(corner, 0.0) - np.maximum(drift, 0.0) - offset,
        np.append(opposite, 0.0) - np.minimum(drift, 0.0) - offset,
    )
    return first, last, corner, opposite


def cube_sides():
    """Return the cube side [m] of each class: a power of two that holds some drops."""
    density = RainSpectrum(_FILL_RATE).density
    side = 2.0 ** np.round(np.log2((_CUBE_FILL / density) ** (1 / 3)))
    return np.clip(side, *_CUBE_SIDES)


def class_keys(seed):
    """Return one random key per class, ndarray of shape (CLASSES,), uint64."""
    root = mix(np.array([seed % 2**64], np.uint64) + _SPREAD)
    return subkey(root, np.arange(CLASSES, dtype=np.uint64))


def size_tables(spectrum):
    """Return (lowest diameter, share of the exponential within, its scale) for each class."""
    low, high = spectrum.edges[:-1], spectrum.edges[1:]
    span = -np.expm1(-spectrum.decay * (high - low))
    scale = np.full(len(low), 1 / spectrum.decay)
    return np.ascontiguousarray(np.stack([low, span, scale], axis=1))
