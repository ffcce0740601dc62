"""Smooth bodies: cars, boxes, bollards, what stands on the ground and has an even upper side.

Rain that falls on them runs down their sides, and does not soak in. So all of them but what faces
the ground is wet, and mirrors as the water that covers it does. What is taller than a van, walls,
trees and masts, is none; what is rough from above is leaves. Moving actors are bodies wherever they
are.
"""

import numpy as np
from scipy import ndimage

from rainsim.actors.footprint import shadows_on
from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import inlined_function
from rainsim.numerics.interpolation import smoothstep
from rainsim.numerics.windows import widened
from rainsim.terrain import filters

LOWEST, TALLEST = 0.25, 2.8  # m over the ground, of a body's upper side
STANDS = 0.3  # m over the ground, of the lower side of what stands on it, as a car does
ROUGHEST = 0.01  # m, rms of a body's upper side about its mean over some centimetres
MEAN_OVER, ROUGH_OVER = 0.03, 0.06  # m, deviations of those means
FEWEST, STEEPEST = 0.05, 0.5  # m2 of an upper side that slopes by less: haze in the air has none
TALL, LARGE = 1.7, 1.5  # m, m2: what is higher and smaller is a trunk
LARGEST = 15.0  # m2, of what stands there on poorly known ground: a van; steps are larger
RIM = 0.22  # m, of an upper side: there it is steep
FADING = 0.12  # m, deviation of the edge between a body and what it is one with
AROUND = 0.08  # m beside a body's cells in which its sides show
STEP = 0.025  # m, unit of the heights in the map
TOP, HEIGHTS = 128, 127  # bit of the upper side: it shows water of its own; the bits of its height
MOST = 255  # a whole body
IN_STEPS, SHARE = np.float32(1 / STEP), np.float32(1 / MOST)
EDGE, SOFT = np.float32(4), np.float32(1 / 3)  # STEPs beyond its sides that a body reaches, fading
FOOT = np.float32(8)  # STEPs over the ground: what is lower by EDGE may be uneven ground
SLOPED, LEVEL = np.float32(0.6), np.float32(0.85)  # cosines to the vertical of sides, of the top
NO_BODIES = np.zeros((0, 0, 3), np.uint8)


class BodyMap:
    """Where smooth bodies stand and move on a part of the ground.

    terrain : Terrain. With the footprints of what moves over it.
    still : ndarray. The map without what moves, see `body_map`.
    actors : ActorSplats or None. Whose time tells where the actors are; before
        they have one none is there.
    now : array (ny, nx, 3) or (0, 0, 3), uint8. See `body_map`.
    moved : list of tuple of slice. Rows and columns in which the two differ.
    """

    def __init__(self, terrain, still, actors=None):
        self._terrain, self._actors, self.still = terrain, actors, still
        self.move()

    def move(self):
        """Put what moves where it is at the time of the actors."""
        self.now, self.moved = self.still, []
        if self._actors is not None and self._actors.time is not None:
            self.now, self.moved = stamped(self.still, self._terrain, self._actors.time)


def body_map(terrain):
    """Return between which heights over the bed each cell shows a body, in STEPs.

    Returns uint8 array (ny, nx, 3). Lower and upper side, and the share of a
        body, of MOST; all 0 where there is no body. TOP is added to the upper
        side where that is a top with its own water. Of shape (0, 0, 3) if there
        is no body.
    """
    spacing = terrain.grid.spacing
    height, under = (np.nan_to_num(a - terrain.bed) for a in (terrain.top, terrain.underside))
    things = (height > LOWEST) & (height < TALLEST)
    if not things.any():
        return NO_BODIES
    share = filters.gaussian_filter(things.astype(np.float32), MEAN_OVER / spacing)
    share = np.maximum(share, np.float32(1e-3))
    mean = filters.gaussian_filter(np.where(things, height, 0), MEAN_OVER / spacing) / share
    uneven = np.where(things, (height - mean) ** 2, 0).astype(np.float32)
    weight = filters.gaussian_filter(things.astype(np.float32), ROUGH_OVER / spacing)
    uneven = filters.gaussian_filter(uneven, ROUGH_OVER / spacing)
    smooth = things & (under < STANDS) & (uneven < ROUGHEST**2 * weight)
    if terrain.layer.size:  # where heights scatter, steps and walls have even patches by chance
        whole, _ = ndimage.label(things)
        smooth &= (np.bincount(whole.ravel()) * terrain.grid.cell_area < LARGEST)[whole]
    labels, count = ndimage.label(smooth)
    level = np.hypot(*np.gradient(height, spacing)) < STEEPEST
    area = np.bincount(labels.ravel(), level.ravel(), count + 1) * terrain.grid.cell_area
    tall = ndimage.mean(height, labels, np.arange(count + 1)) > TALL
    smooth &= ((area >= FEWEST) & ((area >= LARGE) | ~tall))[labels]
    rim = filters.distance(~smooth, RIM / spacing) <= RIM / spacing
    found = with_sides(height, under, things, things & rim, spacing)
    if found.size and len(terrain.tops):
        found[..., 1] |= np.uint8(TOP) * ((terrain.tops.index >= 0) & (found[..., 1] > 0))
    return found


def with_sides(height, underside, things, bodies, spacing):
    """Return a map as `body_map` does of heights [m] in the cells `bodies` and around them.

    Where a body and other `things` are one, its share fades out within some cells.
    """
    if not bodies.any():
        return NO_BODIES
    sigma, size = FADING / spacing, 2 * round(AROUND / spacing) + 1
    share = filters.gaussian_filter(bodies.astype(np.float32), sigma)
    share /= np.maximum(filters.gaussian_filter(things.astype(np.float32), sigma), 1e-3)
    share = np.where(things & (share > 0.02), np.minimum(share, 1), 0)
    there = share > 0
    share = filters.maximum_filter(share, size)
    high = filters.maximum_filter(np.where(there, height, 0), size)
    low = filters.minimum_filter(np.where(there, underside, np.inf), size)
    found = np.zeros((*height.shape, 3), np.uint8)
    found[..., 0] = np.clip(np.rint(np.where(high > 0, low, 0) / STEP), 0, HEIGHTS)
    found[..., 1] = np.clip(np.rint(high / STEP), 0, HEIGHTS)
    found[..., 2] = np.rint(share * MOST)
    return found


def stamped(bodies, terrain, time):
    """Return a map of `body_map` with the actors that move over a terrain at a time [s] on it.

    bodies : array (ny, nx, 3) or (0, 0, 3), uint8
    time : float [s]
    Returns ndarray
        parts : list of tuple of slice. Rows and columns in which it differs.
    """
    shadows, parts = shadows_on(terrain.grid, terrain.footprints, time), []
    if not shadows:
        return bodies, parts
    found = bodies.copy() if bodies.size else np.zeros((*terrain.grid.shape, 3), np.uint8)
    reach = round(AROUND / terrain.grid.spacing)
    for shadow in shadows:
        part, inner = widened(shadow.part, reach, terrain.grid.shape)
        steps = np.zeros([s.stop - s.start for s in part], np.uint8)
        height = np.nan_to_num((shadow.top - terrain.bed[shadow.part]) / STEP)
        steps[inner] = np.where(height < TALLEST / STEP, np.clip(height, 0, HEIGHTS), 0)
        steps = filters.maximum_filter(steps, 2 * reach + 1)
        for channel, value in enumerate((0, steps, MOST)):
            np.copyto(found[(*part, channel)], np.uint8(value), where=steps > 0)
        parts.append(part)
    return found, parts


@inlined_function
def body_share(bodies, u, v, height, upness):
    """Return how surely a place at column u and row v of the map is on a smooth body, 0 to 1.

    `upness` is the cosine of its normal to the vertical: what is level of a top shows the top's own
    water. `height` is over the bed [m].
    """
    i, j = int(u + HALF), int(v + HALF)
    high = np.int64(bodies[j, i, 1])
    if high == 0:
        return ZERO
    z = height * IN_STEPS
    below = (np.float32(high & HEIGHTS) + EDGE - z) * SOFT
    above = (z + EDGE - max(np.float32(bodies[j, i, 0]), FOOT)) * SOFT
    share = min(max(min(below, above), ZERO), ONE) * np.float32(bodies[j, i, 2]) * SHARE
    return share * (ONE - smoothstep(SLOPED, LEVEL, upness)) if high > HEIGHTS else share
