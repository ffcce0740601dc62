"""What belongs to a captured wall but does not show it: windows, sills, edges.

Panes mirror, edges and sills are no plain surface: the places that cameras see there agree on no
plane, and would be lit and get wet as leaves do, beside a wall in the shade that stays dry. What
lies in the plane of a wall or a little behind it, at places that show it, belongs to the wall; so
does what lies in a hole of it, or farther behind that: a pane, and what it mirrors. What has a
plane of its own stays, the ground at its foot, a coping or a ledge, and so do leaves.
"""

import numpy as np
from scipy import ndimage

from rainsim.numerics.srgb import LUMINANCE_WEIGHTS
from rainsim.surface.walls import THICK

CELL = 0.1  # m along a wall, and up
CLOSED = 2  # cells: narrower gaps between places of a wall are no holes
BEFORE = 0.2  # m before its plane; behind it THICK
BESIDE = 0.15  # m from the wall's places
BEHIND = 1.0  # m behind its plane, within a hole
LOOSE = np.float32(0.5)  # how flat it is at most: what has a plane of its own keeps it
MOST_CELLS = 1 << 22  # of a wall
DARKER = 0.4  # of a wall's light: a pane, whose light is mirrored
GREEN = 0.1  # of the largest channel, that green is over the mean of the others: leaves


def laid_on_walls(surface):
    """Return a `CaptureSurface` of which what belongs to walls lies in their planes.

    Without a wall it is the one that was given. The places on walls are those that are wholly flat,
    with a normal that has no part upwards. What is much darker than its wall, as panes are, counts
    as half flat: its light is not the wall's.
    """
    shown = (surface.flat == 1) & (surface.normal[:, 2] == 0)
    if not shown.any():
        return surface
    position, normal, flat = (values.copy() for values in surface[:3])
    bright = surface.light @ LUMINANCE_WEIGHTS.astype(np.float32)
    offset = np.einsum("ij,ij->i", surface.position[shown], normal[shown])
    planes = np.column_stack([normal[shown], offset.round(2)])
    planes, wall = np.unique(planes, axis=0, return_inverse=True)
    wall = wall.ravel()
    rest = np.flatnonzero((flat <= LOOSE) & ~is_leaf(surface.light))
    for k, outwards in enumerate(planes[:, :3]):
        mine = wall == k
        places = surface.position[shown][mine]
        away = surface.position[rest] @ outwards - np.median(offset[mine])
        near = (away > -BEHIND) & (away < BEFORE)
        asked = _on_wall(surface.position[rest[near]], outwards)
        near[near] = _belongs(asked, _on_wall(places, outwards), away[near])
        which = rest[near]
        position[which] -= away[near, None] * outwards
        dark = bright[which] < DARKER * np.median(bright[shown][mine])
        normal[which], flat[which] = outwards, np.where(dark, 0.5, 1)
        rest = rest[~near]
    return surface._replace(position=position, normal=normal, flat=flat)


def is_leaf(light):
    """Return which colours (n, 3), linear, are those of leaves."""
    red, green, blue = light.T
    return 2 * green - red - blue > GREEN * 2 * light.max(axis=1, initial=0)


def _on_wall(position, outwards):
    """Return places along a wall and up [cells], (n, 2)."""
    along = position @ np.array([-outwards[1], outwards[0], 0], np.float32)
    return np.stack([along, position[:, 2]], -1) / CELL


def _belongs(asked, places, away):
    """Tell which places (n, 2) [cells], `away` [m] from its plane, belong to a wall."""
    first = places.min(axis=0) - 1
    shape = tuple((places.max(axis=0) - first).astype(int) + 2)
    if shape[0] * shape[1] > MOST_CELLS:
        return np.zeros(len(asked), bool)
    shown = np.zeros(shape, bool)
    shown[tuple((places - first).astype(int).T)] = True
    shown = ndimage.binary_closing(np.pad(shown, CLOSED), iterations=CLOSED)
    whole = ndimage.binary_fill_holes(shown)
    hole = whole & ~shown
    beside = CELL * ndimage.distance_transform_edt(~whole) < BESIDE
    at = tuple(np.clip((asked - first + CLOSED).astype(int), 0, np.array(shown.shape) - 1).T)
    return hole[at] | (beside[at] & (away > -THICK))
