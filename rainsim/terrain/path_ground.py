"""The ground along a path: a few legs, each one map of fine cells for a run of frames.

A coarse map of all of it, made once, says where the ground lies and sets up the light. Legs follow
from the cameras of the whole path and the cells' size alone, and the water of each begins at the
same time whichever frames are drawn: a frame by itself shows the water that it has in the sequence.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.actors.footprint import with_footprints
from rainsim.config.settings import TerrainConfig
from rainsim.errors import BackendError, ParameterError, counted
from rainsim.terrain.extract import MARGIN, arrays_over, is_photographed, pieces
from rainsim.terrain.kept_terrain import kept_terrain
from rainsim.terrain.map_size import MOST_CELLS, USUAL_SPACING, choose_grid
from rainsim.terrain.types import NO_TOPS, UNKNOWN, Grid, Terrain

BEHIND, AHEAD, ASIDE = 4.0, 20.0, 5.0  # m about a camera that a leg holds, along its view
HIGH = 4.0  # m above the ground: a higher camera needs what it looks at, not what is below it
FARTHEST = 200.0  # m that such a camera's ground may be away
STEP = 2.0  # m: the rims of legs lie on multiples of it
LEG_CELLS = 2_000_000  # of a leg that serves several frames
GROWN = 1.5  # times the cells of its first camera that such a leg may have in any case
CAMERA_CELLS = 6_000_000  # of a leg for a single camera
PIECE = 1_000_000  # cells of a leg's map that are made at once, with their margins
OVERLAP = 1.0  # s before its first frame that a leg's water is simulated
OVERVIEW_CELLS = 400_000  # of the coarse map
MAPS = "bed", "top", "underside", "source", "ground_class", "noise"
WIDE = 2500.0  # m2 of one map for all, from which on legs are taken: its cells would be coarse


class Leg(NamedTuple):
    """A part of a drive: its frames from `first` to before `end`, and the `Grid` of their map."""

    first: int
    end: int
    grid: Grid

    def start(self, config):
        """Return the number of the water's state with which the simulation begins."""
        return max(0, config.moment(self.first) - math.ceil(OVERLAP * config.fps))


class PathGround:
    """The ground of a scene along a path.

    `overview` is the coarse map, actors on it; `path` has a camera for each of the frames, or one
    for all, in the ground frame. Cells of `legs`, in the order of frames, are `spacing` [m] wide.
    """

    def __init__(self, overview, path, frames, spacing):
        self.overview = overview
        self.legs = legs_of(path, frames, spacing, self.height)

    @property
    def cells(self):
        """Cells that are held at once at most: of the whole and of a leg."""
        return self.overview.bed.size + max(math.prod(leg.grid.shape) for leg in self.legs)

    def height(self, x, y):
        """Return the height of the coarse map [m] at points, beyond it that of its rim."""
        grid = self.overview.grid
        places = [(np.asarray(y, float) - grid.origin[1]) / grid.spacing - 0.5,
                  (np.asarray(x, float) - grid.origin[0]) / grid.spacing - 0.5]  # fmt: skip
        return ndimage.map_coordinates(self.overview.bed, np.stack(places), order=1, mode="nearest")

    def leg(self, frame):
        """Return the leg that a frame is in."""
        return next(leg for leg in self.legs if leg.first <= frame < leg.end)

    def terrain(self, scene, leg):
        """Return the `Terrain` of a leg, actors on it.

        The scene is the one that the overview was made of. The map has no tops and no painted
        water, nor colours, by which only the light of the whole is set up.
        """
        (ny, nx), (x, y), spacing = leg.grid.shape, leg.grid.origin, leg.grid.spacing
        margin = cells_of(MARGIN, spacing)
        corner = x - margin * spacing, y - margin * spacing
        wide = Grid((ny + 2 * margin, nx + 2 * margin), corner, spacing)
        maps = {}
        for core, inner, _, part in pieces(wide, PIECE):
            found = arrays_over(scene, part, self.height)
            if found is None:
                found = self._unseen(part)
            for name in MAPS:
                whole = maps.setdefault(name, np.empty(wide.shape, found[name].dtype))
                whole[core] = found[name][inner]
        inside = slice(margin, -margin)
        maps = {name: values[inside, inside].copy() for name, values in maps.items()}
        black = np.broadcast_to(np.float32(0), (ny, nx, 3))  # takes no memory
        return with_footprints(Terrain(leg.grid, **maps, color=black), scene)

    def _unseen(self, grid):
        """Return the arrays of ground over which no splat lies: that of the coarse map."""
        x, y = np.meshgrid(*grid.centres())
        bed = self.height(x, y).astype(np.float32)
        rows, columns, _ = self.overview.grid.cells(x, y)
        return {
            "bed": bed, "top": bed, "underside": bed,
            "source": np.full(grid.shape, UNKNOWN, np.uint8),
            "ground_class": self.overview.ground_class[rows, columns],
            "noise": np.zeros(grid.shape, np.float32),
        }  # fmt: skip


def legs_of(path, frames, spacing, height):
    """Return the legs of a path, a list of `Leg` in the order of their frames.

    There is a camera for each of the frames, or one for all, in the ground frame. Cells are
    `spacing` [m] wide; height(x, y) is that of the ground [m], for arrays of points. ParameterError
    if the part that a single camera needs has too many cells.
    """
    eyes = np.array([camera.position for camera in path])
    ground = height(eyes[:, 0], eyes[:, 1])
    firsts, boxes, most = [], [], -1
    for n, camera in enumerate(path[:frames]):
        low, high = own = needed_cells(camera, float(ground[n]), spacing)
        if boxes:
            low, high = np.minimum(low, boxes[-1][0]), np.maximum(high, boxes[-1][1])
        if _area((low, high)) <= most:
            boxes[-1] = low, high
        else:
            firsts.append(n)
            boxes.append(own)
            most = max(LEG_CELLS, GROWN * _area(own))
    legs = []
    for first, end, (low, high) in zip(firsts, [*firsts[1:], frames], boxes, strict=True):
        shape, corner = (high - low)[::-1].tolist(), (low * spacing).tolist()
        legs.append(Leg(first, end, Grid(tuple(shape), tuple(corner), spacing)))
    return legs


def needed_cells(camera, ground, spacing):
    """Return the cells that a camera needs: first (column, row) and the ones after the last.

    They lie on a lattice whose cell (0, 0) has its south-western corner at the origin of the ground
    frame, in a rectangle along the view; a high camera's lies where the view meets the ground. The
    camera is in the ground frame, `ground` the height of the ground below it [m]. ParameterError if
    the cells are more than `CAMERA_CELLS`.
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
    if _area((low, high)) > CAMERA_CELLS:
        raise ParameterError(
            f"the ground about a camera has {_area((low, high))} cells of {spacing:g} m; at most "
            f"{CAMERA_CELLS} fit the memory; give a larger --spacing"
        )
    return low, high


def cells_of(length, spacing):
    """Return how many cells a length [m] has at least, 8 or more."""
    return max(8, round(length / spacing))


def _area(box):
    return int(np.prod(box[1] - box[0]))


def follows_path(scene, config, cameras, backend="cpu", mask=None):
    """Tell whether the ground of a scene is mapped along the path of the cameras.

    By `auto` it is where one map for all would need wider cells than usual, or more cells of the
    given size than the memory holds. Cameras from above, who see far, keep one map, and so does a
    photographed capture, whose ground is not known so finely. `mask` are classes of one map, or
    water on it. ParameterError if the path is asked for together with what needs one map,
    BackendError if the backend cannot draw it.
    """
    terrain, choice = config.terrain, config.terrain.ground_map
    if choice == "whole":
        return False
    flood = any(config.at(time).water.level is not None for time in config.key_times())
    painted = scene.painted is not None and "water" in scene.painted.name
    needs_one = (
        (terrain.extent is not None, "an extent is", "leave out --extent"),
        (flood, "a water level is", "leave out --water-level"),
        (mask is not None, "a mask is", "leave out --class-mask and --water-mask"),
        (painted, "painted water is", "paint no water"),
    )
    if choice == "path":
        for wrong, what, remedy in needs_one:
            if wrong:
                raise ParameterError(
                    f"ground_map is path and {what} given, which needs one map of the whole; "
                    f"{remedy}, or give --ground-map whole"
                )
        if backend != "cpu":
            raise BackendError(
                f"ground_map is path, which {backend} cannot draw; give --backend cpu or "
                "--ground-map whole"
            )
        return True
    eyes = scene.ground_frame.to_ground(np.array([camera.position for camera in cameras]))
    one_map = backend != "cpu" or len(cameras) == 1 or eyes[:, 2].max() > HIGH
    if one_map or is_photographed(scene) or any(wrong for wrong, _, _ in needs_one):
        return False
    area = np.prod(choose_grid(scene, TerrainConfig())[0].size)
    return bool(area > (WIDE if terrain.spacing is None else MOST_CELLS * terrain.spacing**2))


def path_ground(scene, config, cameras):
    """Return the `PathGround` of a scene along cameras in the capture frame, and notes on it.

    There is one camera per frame, or one for all.
    """
    spacing = config.terrain.spacing or USUAL_SPACING
    coarse = max(choose_grid(scene, TerrainConfig(), OVERVIEW_CELLS)[0].spacing, spacing)
    overview = kept_terrain(scene, TerrainConfig(spacing=coarse))
    path = [scene.ground_frame.camera_in_ground(camera) for camera in cameras]
    overview = with_footprints(replace(overview, tops=NO_TOPS), scene)
    ground = PathGround(overview, path, config.frames, spacing)
    side = max(max(leg.grid.size) for leg in ground.legs)
    note = (
        f"ground map along the path: {counted(len(ground.legs), 'leg')} of at most {side:.4g} m "
        f"with cells of {spacing:g} m; cells of {coarse:g} m beyond"
    )
    return ground, (note,)
