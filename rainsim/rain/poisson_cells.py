"""Which drops a cube of air holds: counts, places and sizes from random words alone.

In the frame that moves with a size class its drops are a frozen Poisson field, cut into cubes. The
lists of `rainsim.drops` and the streaks of a picture both take their drops from these functions.
"""

import functools
from typing import NamedTuple

import numpy as np

from rainsim.jit import device_function, inlined_function, lean_function
from rainsim.numerics.random import mix, subkey, uniform, uniform_triple
from rainsim.rain.size_distribution import CLASSES, RainSpectrum

_CUBE_FILL = 6.0  # drops per cube aimed at: fewer make cubes cost more than their drops
_CUBE_SIDES = (0.5, 2.0)  # m; large cubes reach far out of the box that is asked for
_FILL_RATE = 25.0  # mm/h; fixed, so that cubes, and with them drops, stay when the rate changes
_SPREAD = np.uint64(0x9E3779B97F4A7C15)
# A drop's id gives its place; mixed with these words, independent numbers for the other questions.
_SHARE_STREAM = np.uint64(0x51A4)  # whether a thinned rain has the drop
_DIAMETER_STREAM = np.uint64(0xD1A3)


class DropField(NamedTuple):
    """The arrays of `rainsim.drops.RainField` that kernels read, class by class.

    cube : float64 array (CLASSES,) [m]. Side of the cubes, a power of two.
    class_key : uint64 array (CLASSES,). The random key that the keys of the cubes
        come from.
    count : float64 array (CLASSES, most). Cumulative Poisson distribution of the
        number of drops in a cube.
    size : float64 array (CLASSES, 3). Lowest diameter [m], share of the
        exponential distribution within the class, its scale [m].
    share : float64 array (CLASSES, ticks). Share of the drops that the rain has
        at even times; one tick for a steady rain.
    frame : float64 array (CLASSES, 4). Offset of the co-moving frame along x and
        y [m], first tick [s] and ticks per second.
    """

    velocity: np.ndarray
    cube: np.ndarray
    class_key: np.ndarray
    count: np.ndarray
    size: np.ndarray
    share: np.ndarray
    frame: np.ndarray


class Cube(NamedTuple):
    """A cube of the co-moving frame of a size class: whole numbers of sides along x, y and z."""

    size_class: int
    i: int
    j: int
    k: int


@inlined_function
def cube_key(cube, field):
    """Return the random key (uint64) of a `Cube`."""
    key = field.class_key[cube.size_class]
    return subkey(subkey(subkey(key, cube.i), cube.j), cube.k)


@inlined_function
def drops_in_cube(key, size_class, field):
    """Return how many drops the cube of that key holds, by inverting the Poisson distribution."""
    chance = uniform(key)
    drops = 0
    while chance >= field.count[size_class, drops]:
        drops += 1
    return drops


@device_function
def drop_id(key, drop):
    """Return the random word of drop number `drop` of a cube; its bits are the drop's place."""
    return subkey(key, drop + 1)


@inlined_function
def drop_place(word, cube, field):
    """Return where (x, y, z) [m] a drop of a `Cube` would be at time 0.

    In a wind that changes that is the place from which the wind of the field's interval would have
    carried the drop to where it is.
    """
    side, (ux, uy, uz) = field.cube[cube.size_class], uniform_triple(word)
    return (
        (cube.i + ux) * side + field.frame[cube.size_class, 0],
        (cube.j + uy) * side + field.frame[cube.size_class, 1],
        (cube.k + uz) * side,
    )


@inlined_function
def thinned_out(word, size_class, z, field):
    """Tell whether the rain lacks a drop that would be at height z [m] at time 0.

    The rain is a thinning of the heaviest rain's Poisson field; its rate when the drop passes z = 0
    decides, so that a drop is there for all of its fall or for none of it.
    """
    return field.share.shape[1] > 1 and _thinned_out(word, size_class, z, field)


@lean_function
def _thinned_out(word, size_class, z, field):
    share, frame = field.share, field.frame
    ticks, passes = share.shape[1], -z / field.velocity[size_class, 2]
    at = min(max((passes - frame[size_class, 2]) * frame[size_class, 3], 0.0), ticks - 1.0)
    tick = min(int(at), ticks - 2)
    part = at - tick
    there = share[size_class, tick] * (1.0 - part) + share[size_class, tick + 1] * part
    return uniform(mix(word ^ _SHARE_STREAM)) >= there


@inlined_function
def drop_diameter(word, size_class, field):
    """Return the diameter [m] of the drop with that id: exponential within its class."""
    chance, size = uniform(mix(word ^ _DIAMETER_STREAM)), field.size
    return size[size_class, 0] - np.log(1 - chance * size[size_class, 1]) * size[size_class, 2]


@lean_function
def cubes_along(low, high, start, duration, velocity, offset, side):
    """Return the first and last cube along an axis whose drops come by in an interval, float64.

    Numbers, or arrays of a shape.

    low, high : float [m]. Where the drops come by.
    """
    drift, before = velocity * duration, velocity * start
    first = np.floor((low - np.maximum(drift, 0.0) - before - offset) / side)
    last = np.floor((high - np.minimum(drift, 0.0) - before - offset) / side)
    return first, np.maximum(last, first - 1)


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

    start, stop : float or array (CLASSES,) [s]
    Returns first, last : int64 array (CLASSES, 3). The first and last cubes of
        each class; `impacts.cubes_swept` narrows them along z.
        corner, opposite : array (2,) [m]. Of the part of the map that `within`
            selects.
    """
    start = np.asarray(start, np.float64)[..., None]
    corner, ny, nx = np.array(surfaces.origin, np.float64), *surfaces.shape
    opposite = corner + np.array([nx, ny]) * surfaces.spacing
    if within is not None:
        corner = np.maximum(corner, within[0])
        opposite = np.maximum(np.minimum(opposite, within[1]), corner)
    low, high = np.append(corner, 0.0), np.append(opposite, 0.0)
    first, last = field.cubes_in(low, high, start, np.asarray(stop)[..., None] - start)
    return first, last, corner, opposite


def cube_sides():
    """Return each class's cube side [m], a power of two: _CUBE_FILL drops in rain of _FILL_RATE."""
    density = RainSpectrum(_FILL_RATE).density
    side = 2.0 ** np.round(np.log2((_CUBE_FILL / density) ** (1 / 3)))
    return np.clip(side, *_CUBE_SIDES)


def class_keys(seed):
    """Return one random key per class, ndarray of shape (CLASSES,), uint64."""
    root = mix(np.array([seed % 2**64], np.uint64) + _SPREAD)
    return subkey(root, np.arange(CLASSES, dtype=np.uint64))


def size_tables(spectrum):
    """Return (lowest diameter, share of the exponential within, its scale) for each class."""
    low, high, decay = spectrum.edges[:-1], spectrum.edges[1:], spectrum.class_decay
    span = -np.expm1(-decay * (high - low))
    return np.ascontiguousarray(np.stack([low, span, 1 / decay], axis=1))
