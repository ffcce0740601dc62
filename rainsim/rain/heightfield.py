"""Height fields that drops hit: the ground, one solid column per cell, the first hit on a line.

The map is made of flat-topped cells. A drop's path is a straight line from the open sky; it ends
where it first meets a column's top or side or the ground.
"""

from copy import copy
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from rainsim.errors import ParameterError, require_positive
from rainsim.jit import device_function, lean_function

GROUND, OBSTACLE = 0, 1  # what was hit
_MISSED, _LOST = -1, -2  # nothing up to the end of the line; stopped before it entered the map
BLOCK = 16  # cells; side of the blocks whose lowest and highest heights bound the air to search
PATCH = 4  # cells; side of the patches that a path skips while it is above their highest top
_PER_PATCH = 1 / PATCH
_CLEARANCE = 0.01  # m; lines are followed from this far above the highest top
_SKIN = 1e-4  # m; how deep a point must lie in a solid for the cheap test to call it stopped
_INFINITY = np.inf


class HeightFields(NamedTuple):
    """The arrays of `Surfaces` that kernels read.

    sky : float [m]. A height above all tops: paths are followed from there.
    ground, underside, top : float32 array (ny, nx) [m]. As `Surfaces` has them.
    patch_high : ndarray of shape (ceil(ny / PATCH), ceil(nx / PATCH)), float32
        [m]. The highest top in each patch of PATCH x PATCH cells.
    around_low, around_high : ndarray of shape (ceil(ny / BLOCK), ceil(nx /
        BLOCK)), float32 [m]. The lowest ground and the highest top of each block
        and its eight neighbours.
    """

    x0: float
    y0: float
    spacing: float
    sky: float
    ground: np.ndarray
    underside: np.ndarray
    top: np.ndarray
    patch_high: np.ndarray
    around_low: np.ndarray
    around_high: np.ndarray


@dataclass(frozen=True)
class Surfaces:
    """The ground and all that stands or hangs above it, as flat-topped cells.

    Row 0 is south (smallest y), column 0 west (smallest x). In each cell the space from
    `underside` to `top` is solid, and so is everything below `ground`. Beyond the map's edge
    nothing stops a drop.

    ground : float32 array (ny, nx) [m]
    top : float32 array (ny, nx) [m]. Top of the occluder; equals `ground` where
        there is none. Values below it are raised to it.
    underside : float32 array (ny, nx) [m]. Bottom of the occluder; equals
        `ground` where it stands on the ground.
    Raises ParameterError if the shapes differ, a height is not finite or the
        spacing is not positive.
    """

    spacing: float
    origin: tuple
    ground: np.ndarray
    top: np.ndarray
    underside: np.ndarray
    patch_high: np.ndarray = field(init=False, repr=False)
    around_low: np.ndarray = field(init=False, repr=False)
    around_high: np.ndarray = field(init=False, repr=False)
    sky: float = field(init=False, repr=False)
    changes: list = field(init=False, repr=False)  # parts that `changed` has changed

    def __post_init__(self):
        require_positive("surface spacing", self.spacing, "m")
        shape = np.shape(self.ground)
        if len(shape) != 2 or 0 in shape:
            raise ParameterError(f"ground has shape {shape}; it must be (ny, nx), not empty")
        for name in ("ground", "top", "underside"):
            heights = np.ascontiguousarray(getattr(self, name), dtype=np.float32)
            if heights.shape != shape:
                raise ParameterError(f"{name} has shape {heights.shape}; it must be {shape}")
            if not np.isfinite(heights).all():
                raise ParameterError(f"{name} holds heights that are not finite; fill them first")
            self._set(**{name: heights})
        if not (self.top >= self.ground).all():  # else the array that was given will do
            self._set(top=np.maximum(self.top, self.ground))
        around_low = grow_blocks(np.minimum, reduce_blocks(np.minimum, self.ground))
        self._set(around_low=around_low, changes=[], **_highest(self.top))

    def changed(self, top, underside, parts):
        """Return these surfaces with other tops and undersides, which differ in `parts` alone.

        top, underside : float32 array (ny, nx) [m]. Not lower than the ground.
        """
        other = copy(self)
        other._set(top=top, underside=underside, changes=list(parts), **_highest(top))
        return other

    def _set(self, **values):
        for name, value in values.items():
            object.__setattr__(self, name, value)  # the class is frozen for its users

    @property
    def shape(self):
        """Rows and columns of the map."""
        return self.ground.shape

    @property
    def area(self):
        """Area of the map [m2]."""
        return self.ground.size * self.spacing**2

    def height_fields(self):
        """Return the map's arrays for kernels, `HeightFields`."""
        x0, y0 = map(float, self.origin)
        return HeightFields(
            x0, y0, float(self.spacing), self.sky, self.ground, self.underside, self.top,
            self.patch_high, self.around_low, self.around_high,
        )  # fmt: skip


def flat_surfaces(width, depth, spacing, origin=(0.0, 0.0), height=0.0):
    """Return Surfaces of level ground without occluders, `width` x `depth` m."""
    shape = (round(depth / spacing), round(width / spacing))
    level = np.full(shape, height, np.float32)
    return Surfaces(spacing, origin, level, level, level)


def _highest(top):
    """Return the attributes of `Surfaces` that follow from its tops."""
    patch_high = reduce_blocks(np.maximum, top, PATCH)
    around_high = grow_blocks(np.maximum, reduce_blocks(np.maximum, top))
    sky = float(patch_high.max()) + _CLEARANCE
    return {"patch_high": patch_high, "around_high": around_high, "sky": sky}


def reduce_blocks(reduce, values, side=BLOCK):
    """Reduce blocks of `side` x `side` values to minima or maxima; a third of `reduceat`'s time."""
    beyond = [(0, -n % side) for n in values.shape]
    if any(n for _, n in beyond):
        values = np.pad(values, beyond, "edge")
    rows = reduce.reduce(values.reshape(-1, side, values.shape[1]), 1)
    return reduce.reduce(rows.reshape(len(rows), -1, side), 2)


def grow_blocks(reduce, blocks):
    """Reduce each block with its eight neighbours: a step's side belongs to the cell behind it."""
    for axis in (0, 1):
        padded = np.pad(blocks, [(1, 1) if a == axis else (0, 0) for a in (0, 1)], mode="edge")
        n = blocks.shape[axis]
        parts = [np.take(padded, range(s, s + n), axis) for s in range(3)]
        blocks = reduce(reduce(parts[0], parts[1]), parts[2])
    return np.ascontiguousarray(blocks)


class _CellPath(NamedTuple):
    """A drop's path over the map: height [m] and place in cells at time 0, and their rates.

    `column_time` and `row_time` are the seconds a cell, with the sign of the motion; infinite for
    none. A path multiplies with them instead of dividing: a quotient takes many times as long.
    """

    z: float
    vz: float
    column_at: float
    row_at: float
    column_speed: float
    row_speed: float
    column_time: float
    row_time: float


@lean_function
def first_hit(x, y, z, vx, vy, vz, since, end, surfaces):
    """Find where a drop's path first meets the surfaces.

    The drop is at (x, y, z) at time 0 and moves with constant velocity, vz < 0.

    since, end : float64 [s]. The part of the path that counts; minus infinity for
        all of it from the open sky.
    surfaces : HeightFields
    Returns time : float64 [s]. Of the hit; infinite if there is none up to `end`,
        minus infinite if the path begins inside a solid, at `since` or at the
        map's edge, so that the drop was stopped before.
        kind : int. GROUND or OBSTACLE (top or side of an occluder), negative if
            there is no hit.
        row, column : int
    """
    if z + vz * end > surfaces.sky:
        return _INFINITY, _MISSED, 0, 0
    ny, nx = surfaces.ground.shape
    spacing, patch_high = surfaces.spacing, surfaces.patch_high
    column_at, row_at = (x - surfaces.x0) / spacing, (y - surfaces.y0) / spacing
    column_speed, row_speed = vx / spacing, vy / spacing
    column_time = 1 / column_speed if column_speed != 0 else _INFINITY
    row_time = 1 / row_speed if row_speed != 0 else _INFINITY
    path = _CellPath(z, vz, column_at, row_at, column_speed, row_speed, column_time, row_time)
    enter = (surfaces.sky - z) / vz
    begin, stop = _clip(column_at, column_time, nx, max(enter, since), end)
    begin, stop = _clip(row_at, row_time, ny, begin, stop)
    if begin >= stop:
        return _INFINITY, _MISSED, 0, 0
    midway = begin > enter

    # Patch by patch; only patches that reach up to the path are searched cell by cell.
    # A product and not a quotient of whole numbers, which takes a processor long; it is exact.
    i = int(np.floor((column_at + column_speed * begin) * _PER_PATCH))
    j = int(np.floor((row_at + row_speed * begin) * _PER_PATCH))
    i = min(max(i, 0), patch_high.shape[1] - 1)
    j = min(max(j, 0), patch_high.shape[0] - 1)
    now = begin
    while True:
        leave_i = _leave(i * PATCH, PATCH, column_at, column_time)
        leave_j = _leave(j * PATCH, PATCH, row_at, row_time)
        leave = min(leave_i, leave_j, stop)
        if z + vz * leave <= patch_high[j, i]:
            time, kind, row, column = _search_patch(
                j, i, now, leave, path, midway and now == begin, surfaces
            )
            if kind != _MISSED:
                return time, kind, row, column
        if leave >= stop:
            return _INFINITY, _MISSED, 0, 0
        now = max(now, leave)
        if leave_i <= leave_j:
            i += 1 if column_speed > 0 else -1
        else:
            j += 1 if row_speed > 0 else -1
        if i < 0 or j < 0 or i >= patch_high.shape[1] or j >= patch_high.shape[0]:
            return _INFINITY, _MISSED, 0, 0


@lean_function
def stopped_at(x, y, z, surfaces):
    """Tell whether the point lies well inside a solid of the map, a cheap test."""
    x0, y0 = surfaces.x0, surfaces.y0
    i, j = int((x - x0) / surfaces.spacing), int((y - y0) / surfaces.spacing)
    if x < x0 or y < y0 or i >= surfaces.ground.shape[1] or j >= surfaces.ground.shape[0]:
        return False
    if z < surfaces.ground[j, i] - _SKIN:
        return True
    return z < surfaces.top[j, i] - _SKIN and z > surfaces.underside[j, i] + _SKIN


@lean_function
def _search_patch(patch_j, patch_i, begin, stop, path, midway, surfaces):
    """Follow a `_CellPath` cell by cell through one patch, from time `begin` to `stop` [s].

    `midway`: at `begin` the path comes in over the map's edge or begins, below the open sky.
    """
    ground, underside, top = surfaces.ground, surfaces.underside, surfaces.top
    low_i, low_j = patch_i * PATCH, patch_j * PATCH
    high_i = min(low_i + PATCH, ground.shape[1]) - 1
    high_j = min(low_j + PATCH, ground.shape[0]) - 1
    i = min(max(int(np.floor(path.column_at + path.column_speed * begin)), low_i), high_i)
    j = min(max(int(np.floor(path.row_at + path.row_speed * begin)), low_j), high_j)
    now = begin
    while True:
        leave_i = _leave(i, 1, path.column_at, path.column_time)
        leave_j = _leave(j, 1, path.row_at, path.row_time)
        leave = min(leave_i, leave_j, stop)
        time, kind = _meet_cell(
            now, leave, path.z, path.vz, ground[j, i], underside[j, i], top[j, i]
        )
        if kind != _MISSED:
            if midway and now == begin and time == now:
                return -_INFINITY, _LOST, j, i
            return time, kind, j, i
        if leave >= stop:
            return _INFINITY, _MISSED, 0, 0
        now = max(now, leave)
        if leave_i <= leave_j:
            i += 1 if path.column_speed > 0 else -1
        else:
            j += 1 if path.row_speed > 0 else -1
        if i < low_i or j < low_j or i > high_i or j > high_j:
            return _INFINITY, _MISSED, 0, 0


@device_function
def _meet_cell(begin, leave, z, vz, ground, underside, top):
    """Meet one cell's column and ground between two times; return time and kind."""
    z_begin, z_leave = z + vz * begin, z + vz * leave
    if top > ground and z_begin > underside and z_leave <= top:
        if z_begin > top:
            return (top - z) / vz, OBSTACLE
        return begin, OBSTACLE  # the column's side
    if z_leave > ground:
        return _INFINITY, _MISSED
    if z_begin > ground:
        return (ground - z) / vz, GROUND
    return begin, GROUND  # the side of a step


@device_function
def _leave(cell, size, at, per_cell):
    """Time at which the path leaves [cell, cell + size) on one axis; `per_cell` [s] has a sign."""
    if per_cell == _INFINITY:
        return _INFINITY
    return (cell + size - at) * per_cell if per_cell > 0 else (cell - at) * per_cell


@device_function
def _clip(at, per_cell, count, begin, stop):
    """Clip the times [begin, stop] to those at which 0 <= at + time / per_cell < count."""
    if per_cell == _INFINITY:
        return (begin, stop) if 0 <= at < count else (_INFINITY, -_INFINITY)
    first, last = -at * per_cell, (count - at) * per_cell
    return max(begin, min(first, last)), min(stop, max(first, last))
