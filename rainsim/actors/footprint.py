"""Height fields of actors: the cells that an actor keeps the rain from, wherever it is.

An actor's highest and lowest surfaces are found once from its own splats, over an upright frame of
its own; at a time they are looked up for the cells of the map that the actor is over.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.actors.actor import SOLID
from rainsim.actors.motion import Motion
from rainsim.jit import cpu_kernel, prange
from rainsim.scene.splat_sets import own_turns

LEAST_SPACING = 0.03  # m, of an actor's own cells: what is finer shows gaps between its splats
CLOSING = 2  # cells: gaps up to twice as wide are closed
KEPT = 8  # times whose shadow a footprint keeps
HIGHER = np.float32(0.02)  # m over the bed that an actor must be in a cell to count there


class Shadow(NamedTuple):
    """The cells that an actor covers at one time.

    part : tuple of slice. Rows and columns of the map.
    top, underside : ndarray, float32 [m]. Of the actor in that part; NaN beside
        it.
    """

    part: tuple
    top: np.ndarray
    underside: np.ndarray


@dataclass(frozen=True)
class Footprint:
    """The heights of an actor over the cells around it, wherever it is.

    upright : float64 array (3, 3). Takes points of the actor frame [capture
        units] to the upright frame [m].
    low : float64 array (2,) [m]. Corner of the height fields in the upright
        frame.
    top, underside : float32 array (rows, columns) [m]. In the upright frame; NaN
        beside the actor.
    """

    motion: Motion
    upright: np.ndarray
    low: np.ndarray
    spacing: float
    top: np.ndarray
    underside: np.ndarray

    @property
    def parked(self):
        """Whether the actor stands in one place and is always there."""
        return self.motion.actor.track.parked

    @property
    def highest(self):
        """A height over z = 0 [m] that no part of the actor ever exceeds, however it turns."""
        ends = self.low, self.low + self.spacing * np.array(self.top.shape[::-1])
        across = np.abs(ends).max(axis=0)
        up = max(np.nanmax(np.abs(self.top)), np.nanmax(np.abs(self.underside)))
        way = self.motion.frame.to_ground(self.motion.actor.track.position)
        return float(way[:, 2].max() + np.hypot(np.hypot(*across), up))

    def ground_from_upright(self, pose):
        """Return rotation and shift [m] that take the upright frame to the ground at a pose."""
        scale = self.motion.frame.meters_per_unit
        return pose.rotation @ self._from_upright * scale, pose.position

    @cached_property
    def _from_upright(self):
        return np.linalg.inv(self.upright)

    def shadow(self, grid, time):
        """Return the `Shadow` on a `Grid` at a time [s]; None beside the map or while not there.

        Those of the last times are kept: a frame asks for each twice, on two threads.
        """
        found = self._found.get((grid, time), self)
        if found is self:
            found = self._shadow(grid, time)
            if len(self._found) >= KEPT:
                self._found.clear()
            self._found[grid, time] = found
        return found

    @cached_property
    def _found(self):
        return {}

    @cached_property
    def _corners(self):
        """The corners (4, 3) of the height fields [m], at their mean height."""
        rows, columns = self.top.shape
        steps = np.array([[0, 0], [columns, 0], [0, rows], [columns, rows]])
        return np.column_stack(
            [self.low + steps * self.spacing, np.full(4, float(np.nanmean(self.top)))]
        )

    def _shadow(self, grid, time):
        pose = self.motion.at(time)
        if pose is None:
            return None
        rotation, shift = self.ground_from_upright(pose)
        corners, middle = self._corners @ rotation.T + shift, self._corners[0, 2]
        (x0, y0), (ny, nx) = grid.origin, grid.shape
        first = np.floor((corners[:, :2].min(axis=0) - (x0, y0)) / grid.spacing).astype(int)
        last = np.ceil((corners[:, :2].max(axis=0) - (x0, y0)) / grid.spacing).astype(int)
        first, last = np.maximum(first, 0), np.minimum(last, (nx, ny))
        if (first >= last).any():
            return None
        x = x0 + (np.arange(first[0], last[0]) + 0.5) * grid.spacing - shift[0]
        y = y0 + (np.arange(first[1], last[1]) + 0.5) * grid.spacing - shift[1]
        heights = [np.empty((len(y), len(x)), np.float32) for _ in range(2)]
        _look_up(
            x - middle * rotation[0, 2], y - middle * rotation[1, 2],
            np.linalg.inv(rotation[:2, :2]), rotation[2], shift[2], self.low, self.spacing,
            self.top, self.underside, *heights,
        )  # fmt: skip
        part = slice(first[1], last[1]), slice(first[0], last[0])
        return Shadow(part, *heights)


@cpu_kernel
def _look_up(x, y, own, up, shift, low, spacing, top, underside, top_out, underside_out):
    """Write the heights of an actor over the cells of a map, NaN beside it.

    x, y : array (columns,) and (rows,), float64 [m]. Middles of the cells, from
        the middle of the actor's heights.
    own : float64 array (2, 2). Takes them to the upright frame.
    up : float64 array (3,). Height over the ground for each metre along the axes
        of the upright frame.
    shift : float [m]. Height of that frame's origin.
    """
    rows, columns = top.shape
    for j in prange(len(y)):
        for i in range(len(x)):
            u = own[0, 0] * x[i] + own[0, 1] * y[j]
            v = own[1, 0] * x[i] + own[1, 1] * y[j]
            column, row = math.floor((u - low[0]) / spacing), math.floor((v - low[1]) / spacing)
            high = deep = np.nan
            if row >= 0 and row < rows and column >= 0 and column < columns:
                slope = u * up[0] + v * up[1]
                high = slope + up[2] * top[row, column] + shift
                deep = slope + up[2] * underside[row, column] + shift
            top_out[j, i], underside_out[j, i] = high, deep


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
    solid = ndimage.binary_fill_holes(ndimage.binary_closing(hit, square, CLOSING))
    nearest = ndimage.distance_transform_edt(~hit, return_distances=False, return_indices=True)
    top, underside = (np.where(solid, a[tuple(nearest)], np.nan) for a in (top, underside))
    top, underside = top.astype(np.float32), underside.astype(np.float32)
    return Footprint(Motion(actor, frame), upright, low, spacing, top, underside)


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


def with_footprints(terrain, scene):
    """Return the terrain with the actors of a scene on it.

    Parked ones stand on the map as things do; of those that move it has the `footprints`. Without
    actors the terrain itself is returned.
    """
    if not scene.actors or terrain.footprints:
        return terrain
    footprints = footprints_of(scene, terrain.grid.spacing)
    parked, moving = (tuple(f for f in footprints if f.parked is still) for still in (True, False))
    top, underside = terrain.top.copy(), terrain.underside.copy()
    for shadow in shadows_on(terrain.grid, parked, 0.0):
        put_on(terrain.bed, top, underside, shadow)
    return replace(terrain, top=top, underside=underside, footprints=moving)


def shadows_on(grid, footprints, time):
    """Return the `Shadow` of each actor that is over a `Grid` at a time [s]."""
    shadows = (footprint.shadow(grid, time) for footprint in footprints)
    return [shadow for shadow in shadows if shadow is not None]


def put_on(bed, top, underside, shadow):
    """Put the actor of a `Shadow` onto height fields, in place; return the mask of its cells.

    A cell holds one column. Where something higher hangs over the actor, which keeps the rain off
    already, the cell stays as it is.
    """
    here = np.empty(shadow.top.shape, np.bool_)
    rows, columns = shadow.part
    _put_on(bed, shadow.top, shadow.underside, rows.start, columns.start, top, underside, here)
    return here


@cpu_kernel
def _put_on(bed, own_top, own_underside, first_row, first_column, top_out, underside_out, here_out):
    """Put an actor's cells onto height fields, see `put_on`; `here_out` is their mask."""
    rows, columns = here_out.shape
    for j in prange(rows):
        for i in range(columns):
            row, column = first_row + j, first_column + i
            low, high, above = bed[row, column], top_out[row, column], own_top[j, i]
            here = above > low + HIGHER and above > high
            here_out[j, i] = here
            if here:
                stands = underside_out[row, column] <= low and high > low
                underside_out[row, column] = low if stands else max(own_underside[j, i], low)
                top_out[row, column] = above
