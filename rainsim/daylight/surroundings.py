"""Light that places receive from what stands around them, as brightly lit as each of it is.

A hedge in its own shadow sees shaded leaves and shaded lawn, one in the sun sees lit ones. So the
light of the surroundings is gathered from patches: pieces of the capture of one cell and side, each
of which sends out what the capture shows. The unit is the light on open level ground, as it sends
out none.
"""

from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF, ONE, QUARTER, ZERO
from rainsim.daylight.lit_surface import luminance
from rainsim.daylight.sky_light import hemisphere
from rainsim.jit import cpu_kernel, device_function, prange
from rainsim.numerics.places import group_means, groups_of, nearest

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
RAYS = 96  # of a patch, over each half of the sphere
OVERLAP = np.float32(0.15)  # cells, by which a patch's plane reaches beyond its cell
LEAST_LEFT = np.float32(0.02)  # of a ray, below which it has ended
TINY = np.float32(1e-4)


class Patches(NamedTuple):
    """Pieces of a capture's surfaces, of one cell and side each."""

    position: np.ndarray  # (m, 3), float32, m
    normal: np.ndarray  # (m, 3), float32, unit
    flat: np.ndarray  # (m,), float32, see `Surface`
    area: np.ndarray  # (m,), float32, m2, that it covers
    cell: float  # m
    of: np.ndarray  # (n,), int64, the patch of each splat; m: none, it is too far away


class Sent(NamedTuple):
    """Light that the surroundings send to each patch, as mean radiosity of what it sees of them."""

    patches: Patches
    light: np.ndarray  # (m, 2, 3), float32, from below the horizon and above it, over open ground's
    mean: np.ndarray  # (2, 3), float32, of all patches, for places away from them

    def at(self, position, normal, flat):
        """Return the mean radiosity that places see below the horizon and above it, (n, 2, 3)."""
        patches = self.patches
        if not len(patches.area) or not len(position):
            return np.tile(self.mean, (len(position), 1, 1))
        reach = REACH * patches.cell
        away, near, known = nearest(patches.position, position, NEAR_PATCHES, reach)
        along = np.einsum("ijk,ik->ij", patches.normal[near], normal)
        plane = flat[:, None] * patches.flat[near]
        weight = plane * np.maximum(along, 0) ** 2 + OTHER_SIDE
        weight *= known * np.exp(-2 * (away / patches.cell) ** 2)
        total = weight.sum(axis=1)[:, None, None]
        found = np.einsum("ij,ijkl->ikl", weight, self.light[near]) / np.maximum(total, 1e-12)
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
        group = groups_of(place, side)
        count = int(group.max()) + 1 if len(group) else 0
        if count <= MOST_PATCHES:
            break
        cell *= COARSER
    of = np.full(len(surface.position), count, np.int64)
    of[inside] = group
    means = group_means(group, np.column_stack([position, normal, surface.flat[inside]]))
    middle, up, flat = np.split(means.astype(np.float32), [3, 6], axis=1)
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-6)
    covered = np.bincount(group, surface.area[inside], minlength=count) / cell**2
    area = (cell**2 * -np.expm1(-covered)).astype(np.float32)
    return Patches(middle, up, flat[:, 0], area, cell, of)


def sent_in(surface, patches, white=USUAL_ALBEDO, gain=None):
    """Return what the surroundings send to each patch, as `Sent`.

    `patches` are those of the surface's splats, `white` is the albedo that a captured linear colour
    of 1 stands for, on open level ground. A `gain` (n, 3) on the splats' light, which keeps the
    mean of open ground, gives what they send in another light.
    """
    bright = luminance(surface.light)
    level = (surface.flat > HALF) & (surface.normal[:, 2] > LEVEL)
    known = bright[level] if level.sum() >= FEWEST_LEVEL else bright
    ground = max(float(np.percentile(known, BRIGHT_GROUND)), 1e-3)
    albedo = float(np.clip(white * ground, LEAST_ALBEDO, MOST_ALBEDO))
    own = surface.light / np.maximum(ground, bright / MOST_BRIGHT)[:, None]
    if gain is not None:
        own = own * gain
    count = len(patches.area)
    some = patches.of < count
    radiosity = group_means(patches.of[some], albedo * own[some]).astype(np.float32)
    light = np.zeros((count, 2, 3), np.float32)
    if count:
        covered = -np.log1p(-np.minimum(patches.area / patches.cell**2, 1 - 1e-6))
        low, first, order = _lists(patches.position, patches.cell)
        rays = np.concatenate([hemisphere(RAYS), -hemisphere(RAYS)])
        gather(
            *patches[:3], covered.astype(np.float32), radiosity, low, np.float32(patches.cell),
            first, order, rays.astype(np.float32), light,
        )  # fmt: skip
    mean = light.mean(axis=0) if count else np.tile(albedo * own.mean(axis=0), (2, 1))
    return Sent(patches, light, mean.astype(np.float32))


def _lists(position, cell):
    """Return the cells of a grid about patches that have some, for `gather`.

    The grid's low corner (3,), float32 [m]; where the patches of a cell begin and end in `order`,
    (nx, ny, nz, 2), int32; and `order`, int64.
    """
    low = position.min(axis=0) - np.float32(0.5 * cell)
    place = ((position - low) / np.float32(cell)).astype(np.int64)
    shape = place.max(axis=0) + 1
    key = np.ravel_multi_index(place.T, shape)
    order = np.argsort(key, kind="stable")
    found, start, count = np.unique(key[order], return_index=True, return_counts=True)
    first = np.zeros((int(np.prod(shape)), 2), np.int32)
    first[found] = np.stack([start, start + count], axis=-1)
    return low, first.reshape(*shape, 2), order


@cpu_kernel
def gather(
    position, normal, flat, covered, radiosity, low, cell, first, order, directions, light_out
):  # fmt: skip
    """Write the mean radiosity of what each patch sees of the others, below the horizon and above.

    Rays go from patch to patch through the cells of a grid. What has no plane receives by its mean
    cosine of 1/4, and sends to both sides, itself included.

    position, normal : float32 array (m, 3)
    flat : float32 array (m,)
    covered : float32 array (m,). Area of its splats over that of the face of a
        cell.
    radiosity : float32 array (m, 3)
    low, first, order. See `_lists`.
    cell : float32 [m]
    directions : float32 array (d, 3). Unit, over the sphere.
    light_out : float32 array (m, 2, 3). Zeros.
    """
    for i in prange(len(flat)):
        below, above = ZERO, ZERO
        for k in range(len(directions)):
            d = directions[k]
            to = d[0] * normal[i, 0] + d[1] * normal[i, 1] + d[2] * normal[i, 2]
            to = flat[i] * max(to, ZERO) + (ONE - flat[i]) * QUARTER
            if to <= ZERO:
                continue
            red, green, blue, met = _meet(
                i, d, position, normal, flat, covered, radiosity, low, cell, first, order
            )
            side = 0 if d[2] <= ZERO else 1
            light_out[i, side, 0] += to * red
            light_out[i, side, 1] += to * green
            light_out[i, side, 2] += to * blue
            if side == 0:
                below += to * met
            else:
                above += to * met
        for k in range(3):
            light_out[i, 0, k] /= max(below, np.float32(1e-9))
            light_out[i, 1, k] /= max(above, np.float32(1e-9))


@device_function
def _meet(i, d, position, normal, flat, covered, radiosity, low, cell, first, order):
    """Return the light of what a ray from patch `i` meets, and which share of it met something."""
    red, green, blue, met, left = ZERO, ZERO, ZERO, ZERO, ONE
    o0, o1, o2 = position[i, 0], position[i, 1], position[i, 2]
    x, y, z = (o0 - low[0]) / cell, (o1 - low[1]) / cell, (o2 - low[2]) / cell
    a, b, c = int(x), int(y), int(z)
    step_a, step_b, step_c = (
        (1 if d[0] > 0 else -1),
        (1 if d[1] > 0 else -1),
        (1 if d[2] > 0 else -1),
    )
    p, q, r = (ONE / max(abs(d[0]), TINY), ONE / max(abs(d[1]), TINY), ONE / max(abs(d[2]), TINY))
    next_a = p * (np.float32(a + 1) - x if d[0] > 0 else x - np.float32(a))
    next_b = q * (np.float32(b + 1) - y if d[1] > 0 else y - np.float32(b))
    next_c = r * (np.float32(c + 1) - z if d[2] > 0 else z - np.float32(c))
    begin = ZERO
    while left > LEAST_LEFT:
        if a < 0 or b < 0 or c < 0:
            break
        if a >= first.shape[0] or b >= first.shape[1] or c >= first.shape[2]:
            break
        end = min(next_a, min(next_b, next_c))
        for n in range(first[a, b, c, 0], first[a, b, c, 1]):
            j = order[n]
            if flat[j] > HALF:
                n0, n1, n2 = normal[j, 0], normal[j, 1], normal[j, 2]
                slant = d[0] * n0 + d[1] * n1 + d[2] * n2
                if j == i or abs(slant) < TINY:
                    continue
                away = (position[j, 0] - o0) * n0 + (position[j, 1] - o1) * n1
                away = (away + (position[j, 2] - o2) * n2) / (slant * cell)
                if away < OVERLAP or away < begin - OVERLAP or away > end + OVERLAP:
                    continue
                share = left * (ONE - np.exp(-covered[j]))
                left -= share
                if slant > ZERO:  # its back, whose light nobody saw
                    continue
            else:
                share = left * (ONE - np.exp(-HALF * covered[j] * (end - begin)))
                left -= share
            met += share
            red += share * radiosity[j, 0]
            green += share * radiosity[j, 1]
            blue += share * radiosity[j, 2]
        begin = end
        if next_a <= next_b and next_a <= next_c:
            a += step_a
            next_a += p
        elif next_b <= next_c:
            b += step_b
            next_b += q
        else:
            c += step_c
            next_c += r
    return red, green, blue, met
