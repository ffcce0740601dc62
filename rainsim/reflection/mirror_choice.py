"""Which mirrored pictures a frame gets: at which levels of the water, and how large."""

import math

import numpy as np

from rainsim.config.rules import MM_PER_HOUR

MIRROR_SPREAD = 0.06  # m: water at levels farther apart has no mirror in common
MOST_MIRRORS = 3  # levels that auto draws mirrored; what stands at others is marched
LEAST_SHARE = 0.04  # of the water's pixels for which another mirror is drawn
LEVEL_STEP = 2e-3  # m, of a mirror's level: a slowly filling puddle keeps its mirror for a while
LEVEL_STEPS = int(MIRROR_SPREAD / LEVEL_STEP)
# Blur of what open water mirrors in the rain [px], median over its pixels, for each pixel of focal
# length and root of mm/h: 1.1e-3 to 2.3e-3 in three scenes at 10 and 50 mm/h, on clean water.
RING_BLUR = 1.4e-3
FILM_CALMS = 0.3  # share of the rms slope that a full film of dirt takes, 0.27 to 0.31
HALF_BLUR = 1.4  # px: a picture of half the size blurs by less
HALF_MERGE = 2.0  # times as wide are the cells in which such a picture merges splats


def mirror_step(name, rate, surface_film, lens):
    """Return how many pixels of a picture one of its mirrored pictures stands for, 1 or 2.

    It follows from the moment and the lens alone: so a frame is the same in any film.

    name : {"auto", "full", "half"}. "auto" takes half the size where rings on
        open water blur what it mirrors by HALF_BLUR.
    rate : float [m/s]. Of the rain.
    surface_film : float. How far a film of dirt calms the rings, 0 to 1.
    lens : array_like of shape (4,) [px]
    """
    if name != "auto":
        return 2 if name == "half" else 1
    blur = RING_BLUR * float(lens[0]) * math.sqrt(rate / MM_PER_HOUR)
    return 2 if blur * (1 - FILM_CALMS * surface_film) >= HALF_BLUR else 1


def merged_cells(merge, step):
    """Return the side [px] of the cells in which a mirrored picture merges splats.

    Of the picture itself, whose `mirror_step` is given. `merge` is that of the frame's own.
    """
    return merge * (HALF_MERGE if step > 1 else 1.0)


def group_levels(height, name):
    """Share out water pixels between mirrors.

    height : float32 array (n,) [m]. Of the water in each pixel.
    name : str. A name of reflections: "mirror" takes one mirror for all, "auto"
        one for each level at which much of the water stands, others none.
    Returns mirrors : list of (float [m], ndarray of int64). Level of each mirror
        and the pixels that it serves.
        others : int64 array. Pixels that no mirror serves.
    """
    everything = np.arange(len(height))
    if name not in ("mirror", "auto") or not len(height):
        return [], everything
    place = np.floor(height.astype(np.float64) / LEVEL_STEP).astype(np.int64)
    lowest = int(place.min())
    place -= lowest
    left, mirrors = np.ones(len(height), bool), []
    for first, middle in mirror_levels(np.bincount(place), MOST_MIRRORS if name == "auto" else 1):
        mine = left & (place >= first) & (place < first + LEVEL_STEPS)
        level = (lowest + middle + 0.5) * LEVEL_STEP
        mirrors.append((level, everything if name == "mirror" else np.flatnonzero(mine)))
        left &= ~mine
    return mirrors, everything[left] if name == "auto" else everything[:0]


def mirror_levels(count, most):
    """Choose levels at which much of the water stands.

    count : int64 array (n,). Pixels of each step of height.
    most : int
    Yields first, middle : int. The first of the LEVEL_STEPS steps that a mirror
        serves, and that of its level.
    """
    count, total = count.copy(), count.sum()
    for _ in range(most):
        if count.sum() < LEAST_SHARE * total:
            break
        below = np.append(0, count.cumsum())
        ends = np.minimum(np.arange(len(count)) + LEVEL_STEPS, len(count))
        first = int(np.argmax(below[ends] - below[:-1]))
        inside = count[first : first + LEVEL_STEPS].cumsum()
        if inside[-1] < LEAST_SHARE * total:
            break
        yield first, first + int(np.searchsorted(inside, inside[-1] / 2))
        count[first : first + LEVEL_STEPS] = 0
