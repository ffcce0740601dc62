"""Upright planes among the plain parts of a capture: walls, of which no texture tells the depth.

A plain wall is trained as a haze before the wall, decimetres thick where it is seen on edge. All of
it together tells about where the wall is: its strongest plane is found over all directions and
distances (the transform of Hough 1962, in the plane of the ground). Then offsets of the whole wall
are tried in the pictures, and what lies about it is moved to where they agree.
"""

import numpy as np
from scipy import ndimage

from rainsim.numerics.srgb import LUMINANCE_WEIGHTS
from rainsim.surface.sweep import BY_CHANCE, DARK, ENOUGH, TexturePicture, variances

TURNS = 180  # directions of half a turn
BIN, SMOOTH = 0.04, 3  # m of the distances; bins over which they are summed
MOST = 16  # walls
LEAST_AREA = 1.5  # m2 of a wall
THICK = 0.35  # m before and behind a wall, that is moved to it
HAZE, FEW = 0.9, 0.6  # m before a wall; cameras over those that see the wall
CELL, LEAST_SUPPORT = 0.25, 2  # m along a wall, and up; places near its plane that each must have
LEVELS = 3  # cells above each other, at least, of a wall
NEAR = 0.12  # m
ROUNDS = 4  # of its fit
STEEP = 0.3  # sine of the way that a place is seen, to the wall: on edge it tells less
PLAIN = 0.5  # of a place that shows where a wall is
FEWEST, TOLD = 200, 0.2  # of them; share of a wall's places whose depth pictures tell
TEXTURE = 25  # px, of the square whose mean is subtracted from the pictures of walls
STEP, STEPS = 0.02, 15  # m of the offsets that are tried; to either side
MOST_TRIED = 3000  # places of a wall
SURE = 0.85  # of the greatest difference between pictures, that the least may be


def to_walls(position, towards, size, plain, seen, views):
    """Return places (n, 3) moved to the walls that they belong to, and the walls' normals (n, 3).

    `position` and `size` are in metres, `towards` is the sum of the directions to the `seen`
    cameras that see each; `plain` is how plain each is, 0 to 1: what is plain shows where walls
    are. A normal points either way; it is 0 where no wall is.
    """
    moved, found = position.copy(), np.zeros(len(position), bool)
    upright, walls = np.zeros((len(position), 3), np.float32), []
    towards = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    area = np.where(plain > PLAIN, size.astype(np.float64) ** 2, 0.0)
    area[~_tall(position)] = 0
    turn = np.arange(TURNS) * np.pi / TURNS
    across = np.stack([np.cos(turn), np.sin(turn)], -1)
    middle = np.median(position[:, :2], axis=0) if len(position) else np.zeros(2)
    flat = position[:, :2].astype(np.float64) - middle
    for _ in range(MOST):
        left = np.flatnonzero(~found)
        if np.count_nonzero(area[left]) < FEWEST:
            break
        plane = _strongest(flat[left], area[left], across)
        normal, offset = _fitted(flat[left], towards[left], area[left], *plane)
        away = flat[left] @ normal - offset
        near = np.abs(away) < THICK
        along = flat[left] @ np.array([-normal[1], normal[0]])
        cell = np.floor(np.stack([along, position[left, 2]], -1) / CELL).astype(np.int64)
        _, group = np.unique(cell, axis=0, return_inverse=True)
        group = group.ravel()
        support = np.bincount(group, np.abs(away) < NEAR)
        mine = near & (support[group] >= LEAST_SUPPORT) & (area[left] > 0)
        # What is less plain belongs to the wall too, where it is beside what shows it, and what is
        # plain, stands before it and was seen by fewer cameras: haze that few of them saw.
        shown = np.bincount(group, mine) > 0
        mine |= near & shown[group]
        few = FEW * np.median(seen[left[mine]]) if mine.any() else 0
        before = away * np.sign(np.sum(towards[left[mine], :2] @ normal))
        haze = (before > 0) & (before < HAZE) & (seen[left] <= few) & (area[left] > 0)
        mine |= haze & shown[group]
        covered = np.count_nonzero(np.bincount(group, mine)) * CELL**2
        if covered < LEAST_AREA:
            break
        which = left[mine]
        moved[which, :2] -= (away[mine, None] * normal).astype(np.float32)
        found[which], upright[which, :2] = True, normal
        walls.append(which)
    pictures = [_textured(view) for view in views] if walls else []
    for which in walls:
        normal = upright[which[0]]
        normal = normal if np.sum(towards[which] @ normal) > 0 else -normal
        moved[which] += np.float32(_offset(moved[which], normal, pictures)) * normal
    return moved, upright


def _textured(view):
    """Return the `TexturePicture` of a `DepthView`."""
    log = np.log(np.maximum(view.light @ LUMINANCE_WEIGHTS.astype(np.float32), np.float32(DARK)))
    texture = log - ndimage.uniform_filter(log, TEXTURE)
    return TexturePicture(view.matrix, view.eye, view.lens, view.depth, texture)


def _offset(position, normal, pictures):
    """Return how far a wall's places are to be moved along its normal [m], 0 if nothing tells."""
    some = position[:: max(1, len(position) // MOST_TRIED)][None]
    offsets = (STEP * np.arange(-STEPS, STEPS + 1)).astype(np.float32)
    wanted = np.ones(some.shape[:2], bool)
    variance, weight, count = variances(some, normal.astype(np.float32), wanted, offsets, pictures)
    known = (weight > ENOUGH) & (count > BY_CHANCE)
    if np.count_nonzero(known) < max(FEWEST, TOLD * known.size):
        return 0.0
    curve = variance[:, known] / np.maximum(variance[:, known].mean(axis=0), 1e-12)
    curve = np.median(curve, axis=1)
    k = int(np.argmin(curve))
    if not 0 < k < len(curve) - 1 or curve[k] > SURE * curve.max():
        return 0.0
    below, at, above = curve[k - 1 : k + 2]
    bend = max(below - 2 * at + above, 1e-9)
    return float(offsets[k] + STEP * np.clip(0.5 * (below - above) / bend, -0.5, 0.5))


def _tall(position):
    """Return which places have others above or below them, in LEVELS cells together."""
    cell = np.floor(position / CELL).astype(np.int64)
    cell, back = np.unique(cell, axis=0, return_inverse=True)
    _, column = np.unique(cell[:, :2], axis=0, return_inverse=True)
    column = column.ravel()
    return (np.bincount(column) >= LEVELS)[column][back.ravel()]


def _strongest(flat, area, across):
    """Return normal (2,) and offset [m] of the line that most area lies on."""
    reach = np.linalg.norm(flat, axis=1).max() + BIN
    count = int(2 * reach / BIN) + 1
    best = -1.0, across[0], 0.0
    for normal in across:
        place = ((flat @ normal + reach) / BIN).astype(np.int64)
        bins = np.convolve(np.bincount(place, area, count), np.ones(SMOOTH), "same")
        k = int(np.argmax(bins))
        if bins[k] > best[0]:
            best = bins[k], normal, (k + 0.5) * BIN - reach
    return best[1], best[2]


def _fitted(flat, towards, area, normal, offset):
    """Return normal and offset of a line fitted to points near it, weighted by facing."""
    for _ in range(ROUNDS):
        away = flat @ normal - offset
        facing = np.abs(towards[:, :2] @ normal)
        weight = area * facing**4 / (1 + (away / (0.5 * NEAR)) ** 2) ** 2
        weight *= (np.abs(away) < THICK) & (facing > STEEP)
        total = weight.sum()
        if total <= 0:
            break
        mean = weight @ flat / total
        spread = (flat - mean).T @ ((flat - mean) * weight[:, None])
        axis = np.linalg.eigh(spread)[1][:, 0]
        normal = axis if axis @ normal > 0 else -axis
        offset = float(mean @ normal)
    return normal, offset
