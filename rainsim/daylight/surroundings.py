"""Light that places receive from what stands around them, as brightly lit as each of it is.

A hedge in its own shadow sees shaded leaves and shaded lawn, one in the sun sees lit ones. So the
light of the surroundings is gathered from patches: pieces of the capture of one cell and side, each
of which sends out what the capture shows. The unit is the light on open level ground, as it sends
out none.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from rainsim.constants import HALF, ONE, QUARTER, ZERO
from rainsim.daylight.surface import luminance
from rainsim.jit import cpu_kernel, get_num_threads, prange

CELL, COARSER = 0.4, 1.26  # m, of the patches, and the factor by which cells grow
MOST_PATCHES = 8000  # each is compared with each
NEAR_PATCHES = 8  # that a place takes the light of
REACH = 2.0  # cells: deviation over one is the weight's, and none is farther than this
OTHER_SIDE = np.float32(0.05)  # weight of a patch that faces another way, or no way
USUAL_ALBEDO = 0.6  # of a captured linear colour of 1, if it is not known: a usual exposure
LEAST_ALBEDO, MOST_ALBEDO = 0.05, 0.35
LEVEL = 0.9  # cosine to the vertical of level ground
FEWEST_LEVEL = 20  # splats of level ground, below which all splats say what open ground sends
BRIGHT_GROUND = 70  # percentile of level ground's light that is taken for open: much may be shaded
MOST_BRIGHT = 1.5  # of that light, beyond which a splat counts as this
PI = np.float32(np.pi)


class Patches(NamedTuple):
    """Pieces of a capture's surfaces, of one cell and side each.

    Attributes
    ----------
    position, normal : ndarray of shape (m, 3), float32
        [m]; the normals are unit vectors.
    flat : ndarray of shape (m,), float32
        See `Surface`.
    area : ndarray of shape (m,), float32 [m2]
        That it covers.
    cell : float [m]
    of : ndarray of shape (n,), int64
        The patch of each splat; m: none, it is too far away.
    """

    position: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    area: np.ndarray
    cell: float
    of: np.ndarray


class Sent(NamedTuple):
    """Light that the surroundings send to each patch, as mean radiosity of what it sees of them.

    Attributes
    ----------
    patches : Patches
    light : ndarray of shape (m, 2), float32
        From below the horizon and from above it, over the light on open level ground.
    mean : ndarray of shape (2,), float32
        Of all patches, for places away from them.
    """

    patches: Patches
    light: np.ndarray
    mean: np.ndarray

    def at(self, position, normal, flat):
        """Return the mean radiosity that places see below the horizon and above, (n, 2) float32.

        Parameters
        ----------
        position, normal : ndarray of shape (n, 3), float32
        flat : ndarray of shape (n,), float32
        """
        patches = self.patches
        count = min(NEAR_PATCHES, len(patches.area))
        if not count or not len(position):
            return np.tile(self.mean, (len(position), 1))
        tree = cKDTree(patches.position)
        away, near = tree.query(
            position, k=range(1, count + 1), distance_upper_bound=REACH * patches.cell,
            workers=get_num_threads(),
        )  # fmt: skip
        known = np.isfinite(away)
        near = np.where(known, near, 0)
        along = np.einsum("ijk,ik->ij", patches.normal[near], normal)
        plane = flat[:, None] * patches.flat[near]
        weight = plane * np.maximum(along, 0) ** 2 + OTHER_SIDE
        weight *= known * np.exp(-2 * (np.where(known, away, 0) / patches.cell) ** 2)
        total = weight.sum(axis=1)[:, None]
        found = np.einsum("ij,ijk->ik", weight, self.light[near]) / np.maximum(total, 1e-12)
        return np.where(total > 0, found, self.mean).astype(np.float32)


def patches_of(surface, window):
    """Return the `Patches` of the splats within a window."""
    half = 0.5 * window.side * float(window.pixel)
    inside = np.flatnonzero(np.linalg.norm(surface.position - window.middle, axis=1) < half)
    position, normal = surface.position[inside], surface.normal[inside]
    side = np.argmax(np.abs(normal), axis=1)
    side += 3 * (np.take_along_axis(normal, side[:, None], 1)[:, 0] < 0)
    side = np.where(surface.flat[inside] > HALF, side, 6)  # what has no plane has one patch a cell
    cell = CELL
    while True:
        place = np.floor((position - window.middle + half) / cell).astype(np.int64)
        key = ((place[:, 0] << 40) | (place[:, 1] << 20) | place[:, 2]) * 7 + side
        _, group = np.unique(key, return_inverse=True)
        group = group.ravel()
        count = int(group.max()) + 1 if len(group) else 0
        if count <= MOST_PATCHES:
            break
        cell *= COARSER
    of = np.full(len(surface.position), count, np.int64)
    of[inside] = group
    number = np.bincount(group, minlength=count)

    def mean(values):
        return (np.bincount(group, values, minlength=count) / number).astype(np.float32)

    up = np.stack([mean(normal[:, k]) for k in range(3)], axis=-1)
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-6)
    covered = np.bincount(group, surface.area[inside], minlength=count) / cell**2
    return Patches(
        np.stack([mean(position[:, k]) for k in range(3)], axis=-1), up,
        mean(surface.flat[inside]), (cell**2 * -np.expm1(-covered)).astype(np.float32), cell, of,
    )  # fmt: skip


def sent_in(surface, patches, white=USUAL_ALBEDO, gain=None):
    """Return what the surroundings send to each patch, as `Sent`.

    Parameters
    ----------
    surface : Surface
    patches : Patches
        Of these splats.
    white : float
        Albedo that a captured linear colour of 1 stands for, on open level ground.
    gain : ndarray of shape (n, 3), optional
        On the splats' light, which keeps the mean of open ground: what they send in another light.
    """
    bright = luminance(surface.light)
    level = (surface.flat > HALF) & (surface.normal[:, 2] > LEVEL)
    known = bright[level] if level.sum() >= FEWEST_LEVEL else bright
    ground = max(float(np.percentile(known, BRIGHT_GROUND)), 1e-3)
    albedo = float(np.clip(white * ground, LEAST_ALBEDO, MOST_ALBEDO))
    own = np.minimum(bright / ground, MOST_BRIGHT)
    if gain is not None:
        own = own * luminance(surface.light * gain) / np.maximum(bright, 1e-6)
    count = len(patches.area)
    number = np.bincount(patches.of, minlength=count + 1)[:count]
    radiosity = np.bincount(patches.of, albedo * own, minlength=count + 1)[:count]
    radiosity = (radiosity / np.maximum(number, 1)).astype(np.float32)
    light = np.zeros((count, 2), np.float32)
    gather(*patches[:4], radiosity, light)
    mean = light.mean(axis=0) if count else np.full(2, albedo * own.mean(), np.float32)
    return Sent(patches, light, mean)


@cpu_kernel
def gather(position, normal, flat, area, radiosity, light_out):
    """Write the mean radiosity of what each patch sees of the others, below the horizon and above.

    The weights are form factors of discs (a disc of area A at a distance r fills A / (pi r^2 + A)),
    but nothing hides what is behind, so only their ratios count. What has no plane
    receives by its mean cosine of 1/4 and sends to both sides by 1/2, itself included.

    Parameters
    ----------
    position, normal : ndarray of shape (m, 3), float32
    flat, area, radiosity : ndarray of shape (m,), float32
    light_out : ndarray of shape (m, 2), float32
    """
    for i in prange(len(area)):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        n0, n1, n2, f = normal[i, 0], normal[i, 1], normal[i, 2], flat[i]
        low, low_weight, high, high_weight = ZERO, ZERO, ZERO, ZERO
        for j in range(len(area)):
            d0, d1, d2 = position[j, 0] - x, position[j, 1] - y, position[j, 2] - z
            square = d0 * d0 + d1 * d1 + d2 * d2
            inverse = ONE / max(np.sqrt(square), np.float32(1e-6))
            to = max((d0 * n0 + d1 * n1 + d2 * n2) * inverse, ZERO)
            back = -(d0 * normal[j, 0] + d1 * normal[j, 1] + d2 * normal[j, 2]) * inverse
            to = f * to + (ONE - f) * QUARTER
            back = flat[j] * max(back, ZERO) + (ONE - flat[j]) * HALF
            w = to * back * area[j] / (PI * square + area[j] + np.float32(1e-9))
            below = w if d2 <= ZERO else ZERO
            low_weight += below
            low += below * radiosity[j]
            high_weight += w - below
            high += (w - below) * radiosity[j]
        light_out[i, 0] = low / low_weight if low_weight > ZERO else ZERO
        light_out[i, 1] = high / high_weight if high_weight > ZERO else ZERO
