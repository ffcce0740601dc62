"""Height fields of actors: the cells that an actor keeps the rain from, wherever it is.

An actor's highest and lowest surfaces are found once from its own splats, over an upright frame of
its own; at a time they are looked up for the cells of the map that the actor is over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.actors.actor import SOLID, Track
from rainsim.actors.wheels import Body
from rainsim.scene.splat_sets import own_turns

LEAST_SPACING = 0.03  # m, of an actor's own cells: what is finer shows gaps between its splats
CLOSING = 2  # cells: gaps up to twice as wide are closed
HIGHER = 0.02  # m over the bed that an actor must be in a cell to count there


class Shadow(NamedTuple):
    """The cells that actors cover at one time.

    Attributes
    ----------
    part : tuple of slice
        Rows and columns of the map.
    top, underside : ndarray, float32 [m]
        Of the actors in that part; NaN where there is none.
    """

    part: tuple
    top: np.ndarray
    underside: np.ndarray


@dataclass(frozen=True)
class Footprint:
    """The heights of an actor over the cells around it, wherever it is.

    Attributes
    ----------
    track : Track
        In the capture frame.
    upright : ndarray of shape (3, 3), float64
        Takes points of the actor frame [capture units] to the upright frame [m].
    turn : ndarray of shape (3, 3), float64
        Rotation from the capture frame to the ground frame.
    scale : float [m / capture unit]
    shift : ndarray of shape (3,), float64 [m]
        Of the ground frame.
    low : ndarray of shape (2,), float64 [m]
        Corner of the height fields in the upright frame.
    spacing : float [m]
    top, underside : ndarray of shape (rows, columns), float32 [m]
        In the upright frame; NaN beside the actor.
    body : Body or None
        For its wheels.
    """

    track: Track
    upright: np.ndarray
    turn: np.ndarray
    scale: float
    shift: np.ndarray
    low: np.ndarray
    spacing: float
    top: np.ndarray
    underside: np.ndarray
    body: Body | None = None

    def places(self, points, pose):
        """Take points (n, 3) of the actor frame, in metres, to the ground frame at a pose [m]."""
        place = self.turn @ pose.position * self.scale + self.shift
        return points @ (self.turn @ pose.rotation).T + place

    def ground_from_upright(self, pose):
        """Return rotation and shift [m] that take the upright frame to the ground at a pose."""
        rotation = self.turn @ pose.rotation @ np.linalg.inv(self.upright) * self.scale
        return rotation, self.turn @ pose.position * self.scale + self.shift

    def shadow(self, grid, time):
        """Return the `Shadow` on a `Grid` at a time [s]; None beside the map or while not there."""
        pose = self.track.at(time)
        if pose is None:
            return None
        rotation, shift = self.ground_from_upright(pose)
        middle = float(np.nanmean(self.top))
        rows, columns = self.top.shape
        ends = self.low + np.array([[0, 0], [columns, 0], [0, rows], [columns, rows]]) * (
            self.spacing
        )
        corners = np.column_stack([ends, np.full(4, middle)]) @ rotation.T + shift
        (x0, y0), (ny, nx) = grid.origin, grid.shape
        first = np.floor((corners[:, :2].min(axis=0) - (x0, y0)) / grid.spacing).astype(int)
        last = np.ceil((corners[:, :2].max(axis=0) - (x0, y0)) / grid.spacing).astype(int)
        first, last = np.maximum(first, 0), np.minimum(last, (nx, ny))
        if (first >= last).any():
            return None
        x = x0 + (np.arange(first[0], last[0]) + 0.5) * grid.spacing - shift[0]
        y = y0 + (np.arange(first[1], last[1]) + 0.5) * grid.spacing - shift[1]
        ahead = np.stack(np.meshgrid(x, y), axis=-1) - middle * rotation[:2, 2]
        own = ahead @ np.linalg.inv(rotation[:2, :2]).T
        column, row = np.moveaxis(np.floor((own - self.low) / self.spacing).astype(int), -1, 0)
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        row, column = np.where(inside, row, 0), np.where(inside, column, 0)
        heights = []
        for field in (self.top, self.underside):
            z = own @ rotation[2, :2] + rotation[2, 2] * field[row, column] + shift[2]
            heights.append(np.where(inside, z, np.nan).astype(np.float32))
        part = slice(first[1], last[1]), slice(first[0], last[0])
        return Shadow(part, *heights)


def footprint_of(actor, frame, spacing):
    """Return the `Footprint` of an actor on a map of a spacing [m]; None if none of it is solid."""
    splats = actor.splats.take(actor.splats.opacity > SOLID)
    if not len(splats):
        return None
    upright = frame.meters_per_unit * frame.rotation @ actor.track.first_seen.rotation
    points = _outline(splats) @ upright.T
    spacing = max(spacing, LEAST_SPACING)
    margin = (CLOSING + 1) * spacing
    low = points[:, :2].min(axis=0) - margin
    columns, rows = np.ceil((points[:, :2].max(axis=0) + margin - low) / spacing).astype(int)
    column, row = np.floor((points[:, :2] - low) / spacing).astype(int).T
    top = np.full((rows, columns), -np.inf)
    underside = np.full((rows, columns), np.inf)
    np.maximum.at(top, (row, column), points[:, 2])
    np.minimum.at(underside, (row, column), points[:, 2])
    hit = np.isfinite(top)
    square = np.ones((3, 3), bool)
    body = ndimage.binary_fill_holes(ndimage.binary_closing(hit, square, CLOSING))
    nearest = ndimage.distance_transform_edt(~hit, return_distances=False, return_indices=True)
    top, underside = (np.where(body, a[tuple(nearest)], np.nan) for a in (top, underside))
    return Footprint(
        actor.track, upright, frame.rotation, frame.meters_per_unit, frame.translation, low,
        spacing, top.astype(np.float32), underside.astype(np.float32),
        Body(actor.id, actor.kind, actor.box, actor.wheels),
    )  # fmt: skip


def _outline(splats):
    """Return the centres of splats and points one deviation away along their axes, (7 n, 3)."""
    axes = own_turns(splats).as_matrix()
    steps = np.swapaxes(axes * splats.scale[:, None, :], 1, 2)  # (n, 3 axes, 3)
    centre = splats.position.astype(np.float64)
    every = [centre, *(centre + s * steps[:, k] for k in range(3) for s in (-1, 1))]
    return np.concatenate(every)


def footprints_of(scene, spacing):
    """Return the `Footprint` of each solid actor of a scene, on maps of a spacing [m]."""
    made = (footprint_of(actor, scene.ground_frame, spacing) for actor in scene.actors)
    return tuple(footprint for footprint in made if footprint is not None)


def with_footprints(terrain, scene, footprints=None):
    """Return the terrain with the actors of a scene on it.

    Parked ones stand on the map as things do; of those that move it has the `footprints`. Without
    actors the terrain itself is returned. `footprints` are those of `footprints_of`, where they are
    known.
    """
    if not scene.actors or terrain.footprints:
        return terrain
    if footprints is None:
        footprints = footprints_of(scene, terrain.grid.spacing)
    top, underside = terrain.top.copy(), terrain.underside.copy()
    for footprint in footprints:
        if footprint.track.parked:
            put_on(terrain.bed, top, underside, footprint.shadow(terrain.grid, 0.0))
    moving = tuple(footprint for footprint in footprints if not footprint.track.parked)
    return replace(terrain, top=top, underside=underside, footprints=moving)


def put_on(bed, top, underside, shadow):
    """Put the actors of a `Shadow` onto height fields, in place; return the mask of its cells.

    A cell holds one column. Where something higher hangs over the actor, which keeps the rain off
    already, the cell stays as it is.
    """
    if shadow is None:
        return None
    part = shadow.part
    with np.errstate(invalid="ignore"):
        here = (shadow.top > bed[part] + HIGHER) & (shadow.top > top[part])
        lower = np.maximum(shadow.underside, bed[part])
        stands = underside[part] <= bed[part]
        there = top[part] > bed[part]
    under = np.where(there & stands, bed[part], lower)
    underside[part] = np.where(here, under, underside[part])
    top[part] = np.where(here, shadow.top, top[part])
    return here
