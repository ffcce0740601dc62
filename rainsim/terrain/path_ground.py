"""The ground along a path: fine windows near the cameras, made while the drive goes on.

A coarse map of all of it, made once, says where the ground lies and sets up the light. What lies
about a window is extracted in strips across the path, each with a margin from the splats over it.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy import ndimage

from rainsim.actors.footprint import footprints_of, with_footprints
from rainsim.config.settings import TerrainConfig
from rainsim.errors import BackendError, ParameterError
from rainsim.terrain.extract import MARGIN, arrays_over
from rainsim.terrain.kept_terrain import kept_terrain
from rainsim.terrain.map_size import AUTO_CELLS, MOST_CELLS, USUAL_SPACING, choose_grid
from rainsim.terrain.stations import (
    HIGH,
    STRIP,
    box_area,
    cells_of,
    long_axis,
    station_at,
    stations_of,
)
from rainsim.terrain.types import NO_TOPS, UNKNOWN, Grid, Terrain

OVERVIEW_CELLS = 400_000  # of the coarse map
MAPS = "bed", "top", "underside", "source", "ground_class", "noise"
UPSTREAM = 100.0  # m about a window from which its streams may come
NEXT_SHARE = 0.3  # of the memory a cell, that a window takes which is not drawn yet
WIDER = 1.25  # times the usual cells: those of one map for all from which on windows are taken


class PathGround:
    """The ground of a scene along a path.

    `overview` is the coarse map, actors on it; `path` has a camera for each of the frames, or one
    for all, in the ground frame. Windows have cells of `spacing` [m]; `footprints` are those of the
    actors on such maps. `stations` are in the order of their frames.
    """

    def __init__(self, overview, path, frames, spacing, footprints=()):
        self.overview, self._footprints = overview, footprints
        self.stations = stations_of(path, frames, spacing, self.height)
        self._last = {}, None  # where the strips of the last `around` lie in it, by their cells

    def __getstate__(self):
        return {**self.__dict__, "_last": ({}, None)}

    @property
    def cells(self):
        """Cells that are held at once at most, as many as one map of the same memory has.

        Of the whole, of a window and of what lies around it; and a share of the next window's,
        which is made meanwhile and holds less than one that is drawn.
        """
        each = [box_area(s.cells) + box_area(s.around) for s in self.stations]
        return self.overview.bed.size + round((1 + NEXT_SHARE) * max(each))

    def height(self, x, y):
        """Return the height of the coarse map [m] at points, beyond it that of its rim."""
        grid = self.overview.grid
        places = [(np.asarray(y, float) - grid.origin[1]) / grid.spacing - 0.5,
                  (np.asarray(x, float) - grid.origin[0]) / grid.spacing - 0.5]  # fmt: skip
        return ndimage.map_coordinates(self.overview.bed, np.stack(places), order=1, mode="nearest")

    def station(self, frame):
        """Return the station that serves a frame."""
        return station_at(self.stations, frame)

    def around(self, scene, station, check=lambda: None):
        """Return the `Terrain` of a station's window and of its surroundings, actors on it.

        The scene is the one that the overview was made of; check() is called between the steps.
        """
        cells, spacing = station.around, station.spacing
        axis, strip = long_axis(cells), cells_of(STRIP, spacing)
        low, high = cells[2 * axis], cells[2 * axis + 1]
        rims = [low, *range((low // strip + 1) * strip, high, strip), high]
        grid, maps, places = grid_of(cells, spacing), {}, {}
        parts = [(*cells[:2], a, b) if axis else (a, b, *cells[2:]) for a, b in pairwise(rims)]
        before, last = self._last
        if not any((part, spacing) in before for part in parts):
            self._last = last = {}, None  # nothing of it is needed: its memory is free now
        for part in parts:
            start, stop = part[2 * axis :][:2]
            along = slice(start - low, stop - low)
            places[part, spacing] = (slice(None), along) if axis else (along, slice(None))
            kept = before.get((part, spacing))
            if kept is None:
                strip = self._made(scene, part, spacing, check)
            else:
                strip = {name: getattr(last, name)[kept] for name in MAPS}
            for name in MAPS:
                values = strip[name]
                if name not in maps:
                    maps[name] = np.empty((*grid.shape, *values.shape[2:]), values.dtype)
                maps[name][places[part, spacing]] = values
        self._last = places, Terrain(grid, **maps, color=no_color(grid))
        return with_footprints(self._last[1], scene, self._footprints)

    def about(self, grid):
        """Return the coarse `Terrain` of a `Grid` and of the ground around that may drain to it.

        None where the coarse map is as fine as the part.
        """
        whole = self.overview.grid
        if whole.spacing < 1.5 * grid.spacing:
            return None
        low = np.subtract(grid.origin, UPSTREAM)
        high = np.add(grid.origin, np.add(grid.size, UPSTREAM))
        first, last = (np.subtract(place, whole.origin) / whole.spacing for place in (low, high))
        columns, rows = (
            slice(max(int(a), 0), min(int(b) + 1, n))
            for a, b, n in zip(first, last, whole.shape[::-1], strict=True)
        )
        return part_of(self.overview, (rows, columns))

    def _made(self, scene, cells, spacing, check=lambda: None):
        """Return the arrays of a `Terrain` over some cells."""
        margin = cells_of(MARGIN, spacing)
        south, north, west, east = cells
        grid = grid_of((south - margin, north + margin, west - margin, east + margin), spacing)
        found = arrays_over(scene, grid, self.height, check)
        if found is None:
            found = self._unseen(grid)
        inner = slice(margin, -margin)
        return {name: found[name][inner, inner].copy() for name in MAPS}

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


def grid_of(cells, spacing):
    """Return cells of the lattice, as `Station.cells`, as a `Grid`."""
    south, north, west, east = cells
    return Grid((north - south, east - west), (west * spacing, south * spacing), spacing)


def part_of(terrain, window):
    """Return the `Terrain` of a window (rows, columns) of a map, its arrays copied.

    It has no tops and no painted water, nor colours, by which only the light of the whole is set
    up. What moves on the map moves on the part, too.
    """
    grid = terrain.grid
    rows, columns = window
    cells = rows.start, rows.stop, columns.start, columns.stop
    part = grid_of(cells, grid.spacing)
    origin = grid.origin[0] + part.origin[0], grid.origin[1] + part.origin[1]
    maps = {name: getattr(terrain, name)[window].copy() for name in MAPS}
    return Terrain(
        replace(part, origin=origin), **maps, color=no_color(part), footprints=terrain.footprints
    )


def no_color(grid):
    """Return black for each cell of a `Grid`, which takes no memory."""
    return np.broadcast_to(np.float32(0), (*grid.shape, 3))


def follows_path(scene, config, cameras, backend="cpu", mask=None):
    """Tell whether the ground of a scene is mapped along the path of the cameras.

    By `auto` it is where one map for all would need wider cells than usual, or more cells of the
    given size than the memory holds. Cameras from above, who see far, keep one map. `mask` are
    classes of one map, or water on it. ParameterError if the path is asked for together with what
    needs one map, BackendError if the backend cannot draw it.
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
    if one_map or any(wrong for wrong, _, _ in needs_one):
        return False
    area = np.prod(choose_grid(scene, TerrainConfig())[0].size)
    if terrain.spacing is None:
        return bool(area > AUTO_CELLS * (WIDER * USUAL_SPACING) ** 2)
    return bool(area > MOST_CELLS * terrain.spacing**2)


def path_ground(scene, config, cameras):
    """Return the `PathGround` of a scene along cameras in the capture frame, and notes on it.

    There is one camera per frame, or one for all.
    """
    spacing = config.terrain.spacing or USUAL_SPACING
    coarse = max(choose_grid(scene, TerrainConfig(), OVERVIEW_CELLS)[0].spacing, spacing)
    overview = kept_terrain(scene, TerrainConfig(spacing=coarse))
    path = [scene.ground_frame.camera_in_ground(camera) for camera in cameras]
    overview = with_footprints(replace(overview, tops=NO_TOPS), scene)
    ground = PathGround(overview, path, config.frames, spacing, footprints_of(scene, spacing))
    sides = [max(s.cells[1] - s.cells[0], s.cells[3] - s.cells[2]) for s in ground.stations]
    windows = f"{len(sides)} window" + ("s" if len(sides) > 1 else "")
    note = (
        f"ground map along the path: {windows} of at most {max(sides) * spacing:.4g} m with cells "
        f"of {spacing:g} m; cells of {coarse:g} m beyond"
    )
    return ground, (note,)
