"""Windows of the ground that a moving camera needs over time: on a lattice, in turns.

The ground about a camera is mapped finely, and its water simulated, in a window. A window serves a
run of frames, its station, and is large enough for what the cameras of all of them need. The water
that stands in it at the start comes from a wider part of the path, so that two windows agree on the
puddles that they share. Stations follow from the cameras of the whole path and the cells' size
alone: a frame by itself belongs to the same station as in a sequence, and its water begins at the
same time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rainsim.errors import ParameterError

BEHIND, AHEAD, ASIDE = 3.0, 16.0, 5.0  # m about a camera that a window holds, along its view
HIGH = 4.0  # m above the ground: a higher camera needs what it looks at, not what is below it
FARTHEST = 200.0  # m that such a camera's ground may be away
STEP = 2.0  # m: the rims of windows lie on multiples of it
WINDOW_CELLS = 1_000_000  # of a window that serves several frames
GROWN = 1.5  # times the cells of its first camera that such a window may have in any case
MOST_CELLS = 6_000_000  # of a window for a single camera
REST = 16.0  # m along the path beyond a window from which water stands in it
REST_CELLS = 3_000_000  # of a window and what lies about it
STRIP = 8.0  # m of ground that are extracted at once: the rims of what lies about a window
LEAD = 0.2  # s before its first frame that a station's water is simulated


class Station(NamedTuple):
    """A window of the ground and the frames that it serves.

    Cells are the first and last row + 1, first and last column + 1 on the lattice of the window's
    cells, whose cell (0, 0) has its south-western corner at the origin of the ground frame.
    """

    first: int  # frame
    end: int  # frame, not served
    cells: tuple  # of the window
    around: tuple  # of the part of the ground from which water stands in the window
    spacing: float  # m

    @property
    def window(self):
        """Rows and columns of the window within its surroundings, as slices."""
        south, _, west, _ = self.around
        return (slice(self.cells[0] - south, self.cells[1] - south),
                slice(self.cells[2] - west, self.cells[3] - west))  # fmt: skip

    def start(self, config):
        """Return the number of the water's state with which the simulation of a station begins."""
        return max(0, config.moment(self.first) - math.ceil(LEAD * config.fps))


def stations_of(path, frames, spacing, height=None):
    """Return the stations of a path, a list of `Station` in the order of their frames.

    There is a camera for each of the frames, or one for all, in the ground frame. Cells are
    `spacing` [m] wide; height(x, y) is that of the ground [m], for arrays of points, 0 if left out.
    ParameterError if the part that a single camera needs has too many cells.
    """
    still = len(path) == 1
    eyes = np.array([camera.position for camera in path])
    ground = np.zeros(len(path)) if height is None else height(eyes[:, 0], eyes[:, 1])
    firsts, boxes, most = [], [], 0
    for n, camera in enumerate(path[: 1 if still else frames]):
        own = needed_cells(camera, float(ground[n]), spacing)
        if boxes and box_area(_union(boxes[-1], own)) <= most:
            boxes[-1] = _union(boxes[-1], own)
        else:
            firsts.append(n)
            boxes.append(own)
            most = max(WINDOW_CELLS, GROWN * box_area(own))
    stations = []
    for k, (first, end) in enumerate(zip(firsts, [*firsts[1:], frames], strict=True)):
        around = _around(boxes[k], boxes[max(k - 2, 0) : k + 3], spacing)
        stations.append(Station(first, end, boxes[k], around, spacing))
    return stations


def station_at(stations, frame):
    """Return the station that serves a frame."""
    return next(station for station in stations if station.first <= frame < station.end)


def needed_cells(camera, ground, spacing):
    """Return the cells that a camera needs, as `Station.cells`.

    A rectangle along its view on the ground; a high camera's lies where the view meets the ground.
    The camera is in the ground frame, `ground` the height of the ground below it [m].
    ParameterError if the cells are more than `MOST_CELLS`.
    """
    eye, view = camera.position, camera.forward
    level = math.hypot(view[0], view[1])
    ahead = view[:2] / level if level > 1e-6 else np.array([1.0, 0.0])
    begin, height = -BEHIND, eye[2] - ground
    if height > HIGH:
        away = FARTHEST if view[2] >= 0 else min(height * level / -view[2], FARTHEST)
        begin = away - (BEHIND + AHEAD) / 2
    along = eye[:2] + np.outer([begin, begin + BEHIND + AHEAD], ahead)
    aside = ASIDE * np.array([-ahead[1], ahead[0]])
    corners = np.concatenate([along - aside, along + aside])
    step = cells_of(STEP, spacing)
    low = np.floor(corners.min(axis=0) / (step * spacing)).astype(int) * step
    high = np.ceil(corners.max(axis=0) / (step * spacing)).astype(int) * step
    box = int(low[1]), int(high[1]), int(low[0]), int(high[0])
    if box_area(box) > MOST_CELLS:
        raise ParameterError(
            f"the ground about a camera has {box_area(box)} cells of {spacing:g} m; at most "
            f"{MOST_CELLS} fit the memory; give a larger --spacing"
        )
    return box


def _around(box, neighbours, spacing):
    """Return the cells from which water stands in a window.

    They reach along the path into the windows before and after it, as far as REST or as the memory
    allows, and on the longer side to the rims of strips.
    """
    beyond = box
    for other in neighbours:
        beyond = _union(beyond, other)
    strip, step = cells_of(STRIP, spacing), cells_of(STEP, spacing)
    for reach in range(cells_of(REST, spacing), -1, -step):
        part = [max(box[0] - reach, beyond[0]), min(box[1] + reach, beyond[1]),
                max(box[2] - reach, beyond[2]), min(box[3] + reach, beyond[3])]  # fmt: skip
        side = 2 * long_axis(part)
        part[side] = part[side] // strip * strip
        part[side + 1] = -(-part[side + 1] // strip) * strip
        if box_area(part) <= REST_CELLS:
            return tuple(part)
    return box


def long_axis(box):
    """Return 0 if cells span more rows than columns, else 1."""
    return int(box[3] - box[2] >= box[1] - box[0])


def cells_of(length, spacing):
    """Return how many cells a length [m] has at least, 8 or more."""
    return max(8, round(length / spacing))


def _union(a, b):
    return min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3])


def box_area(box):
    """Return the number of cells of a box: first row, end row, first column, end column."""
    return (box[1] - box[0]) * (box[3] - box[2])
