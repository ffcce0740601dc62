"""Which way splats face that belong to a wall but do not show it: windows, sills, edges.

Panes mirror, edges and sills are no plain surface: the places that cameras see there agree on
nothing, and splats lie as training left them. One would be wet through beside a dry wall. What lies
in the plane of a wall or a little behind it, at places that show it, faces as the wall does; so
does what lies in a hole of it, or farther behind that: a pane, and what it mirrors. The ends of a
wall are left alone: a coping faces upwards, and so does the ground at its foot.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from rainsim.surface.walls import THICK

CELL = 0.1  # m along a wall, and up
CLOSED = 2  # cells: narrower gaps between places of a wall are no holes
BEFORE = 0.2  # m before its plane; behind it THICK
BESIDE = 0.1  # m from the wall's places, from which on a splat in its plane is less surely of it
BEHIND = 1.0  # m behind its plane, within a hole
ENDS = 3  # cells at the ends of a wall, above and below
MOST_CELLS = 1 << 22  # of a wall


def wall_normals(position, surface):
    """Return normals of walls at places (n, 3), and how surely those belong to them (n,), float32.

    Parameters
    ----------
    position : ndarray of shape (n, 3), float32 [m]
        In the ground frame.
    surface : rainsim.surface.fuse.CaptureSurface
        Places on walls are wholly flat, and their normals have no part upwards.
    """
    normal, share = np.zeros((len(position), 3), np.float32), np.zeros(len(position), np.float32)
    shown = np.flatnonzero((surface.flat == 1) & (surface.normal[:, 2] == 0))
    towards, wall = np.unique(surface.normal[shown], axis=0, return_inverse=True)
    for k, outwards in enumerate(towards):
        places = surface.position[shown[wall.ravel() == k]]
        away = position @ outwards - np.median(places @ outwards)
        which = np.flatnonzero((away > -BEHIND) & (away < BEFORE))
        surely = _share(
            _on_wall(position[which], outwards), _on_wall(places, outwards), away[which]
        )
        more = surely > share[which]
        normal[which[more]], share[which[more]] = outwards, surely[more]
    return normal, share


def _on_wall(position, outwards):
    """Return places along a wall and up [cells], (n, 2)."""
    along = position @ np.array([-outwards[1], outwards[0], 0], np.float32)
    return np.stack([along, position[:, 2]], -1) / CELL


def _share(asked, places, away):
    """Return how surely places (n, 2) [cells], `away` [m] from its plane, belong to a wall."""
    first = places.min(axis=0) - 1
    shape = tuple((places.max(axis=0) - first).astype(int) + 2)
    if shape[0] * shape[1] > MOST_CELLS:
        return np.zeros(len(asked), np.float32)
    shown = np.zeros(shape, bool)
    shown[tuple((places - first).astype(int).T)] = True
    shown = ndimage.binary_closing(np.pad(shown, ENDS), iterations=CLOSED)
    whole = ndimage.binary_fill_holes(shown)
    hole = whole & ~shown
    whole &= np.roll(whole, -ENDS, axis=1) & np.roll(whole, ENDS, axis=1)  # the rim is empty
    far = CELL * ndimage.distance_transform_edt(~whole)
    at = np.clip((asked - first + ENDS).astype(int), 0, np.array(shown.shape) - 1)
    at = tuple(at.T)
    beside = np.where(away > -THICK, np.clip(2 - far[at] / BESIDE, 0, 1), 0)
    return np.where(hole[at], 1, beside).astype(np.float32)
