"""Rain in a picture on a CUDA device: twin of `rainsim.particles.streaks`.

A thread tests a cube of air; the cubes in view its block goes through, a group of lanes a cube and
a lane a drop, and lists the drops that may show. A thread follows each of those through the map,
and a group of lanes draws it, a lane a stretch of the path. Optical depths are whole numbers that
are added up, so that no order matters.
"""

import math

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.cuda.drops import BLOCKS, arrays_of, box_of, sent_surfaces
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.particles.line_raster import TILE, read_depth, resolve
from rainsim.cuda.warp import GROUP, GROUPS, THREADS, ballot, claim_row
from rainsim.errors import ParameterError
from rainsim.numerics.random import uniform
from rainsim.particles import line_raster
from rainsim.particles.shutter_view import (
    SeenAir,
    ShutterView,
    cube_corners,
    cube_in_view,
    cube_radius,
    require_pictures,
    seen_air,
    shutter_view,
    step_from,
)
from rainsim.particles.streaks import CLEAR, HIDDEN, drop_offset, may_show
from rainsim.rain import poisson_cells
from rainsim.rain.heightfield import HeightFields, first_hit
from rainsim.rain.size_distribution import CLASSES

ROOM = 2**15 if SIMULATED else 2**20  # drops that there is room for at first
MOST_ROOM = 8 * ROOM  # drops that may be in view: 60 bytes each
# Places in a row of `paths`: the path in the camera frame [m], whether nothing stands before it,
# the share of it that the drop goes, and the diameter [m].
PATH = 9
X, Y, Z, X_END, Y_END, Z_END, IS_CLEAR, SHARE, DIAMETER = range(PATH)
_NEAR = np.float32(line_raster.NEAR)


@cuda.jit(device=True)
def view_of(sent):
    """Return the `ShutterView` whose times stand in device arrays."""
    return ShutterView(
        sent.time[0], sent.exposure[0], sent.rotation, sent.eye, sent.rotation_end, sent.eye_end,
        sent.axes, sent.axes_end, sent.lens, sent.planes,
    )  # fmt: skip


@cuda.jit(device=True)
def _cube_of(task, counts, air):
    """Return the class and the place (i, j, k) of cube number `task` of all classes' boxes."""
    b, rest = box_of(task, counts)
    deep = air.last[b, 2] - air.first[b, 2] + 1
    wide = air.last[b, 1] - air.first[b, 1] + 1
    k = rest % deep
    rest //= deep
    return b, air.first[b, 0] + rest // wide, air.first[b, 1] + rest % wide, air.first[b, 2] + k


@cuda_kernel
def list_drops(counts, air, sent, field, scene, sought_out, places_out, words_out, paths_out):
    """List the drops that may be in view, cube by cube.

    sent : ShutterView
    field : DropField. Of device arrays.
    sought_out : int32 device array (1,). Raised by the number of drops.
    places_out : int32 device array (room, 4). Class and cube.
    paths_out : float32 device array (room, PATH). X to IS_CLEAR.
    """
    seen = cuda.shared.array((THREADS, 4), np.int32)  # class and cube
    corners = cuda.shared.array((THREADS, 6), np.float32)  # of each, first and last
    many = cuda.shared.array(1, np.int32)
    view, most = view_of(sent), field.count.shape[1]
    thread, lane = cuda.threadIdx.x, cuda.threadIdx.x % GROUP
    total = counts[CLASSES]
    batches = (total + THREADS - 1) // THREADS
    for batch in range(cuda.blockIdx.x, batches, cuda.gridDim.x):
        if thread == 0:
            many[0] = 0
        cuda.syncthreads()
        # Threads test cubes far from each other, so that all blocks find about as many in view.
        task, wanted = thread * batches + batch, False
        b, i, j, k = 0, air.first[0, 0], air.first[0, 0], air.first[0, 0]
        corner = corner_end = (ZERO, ZERO, ZERO)
        if task < total:
            b, i, j, k = _cube_of(task, counts, air)
            corner, corner_end = cube_corners(poisson_cells.Cube(b, i, j, k), field, view)
            wanted = cube_in_view(
                corner, corner_end, np.float32(field.cube[b]), cube_radius(b, field, view, air),
                air.far[b], view,
            )  # fmt: skip
        at = claim_row(many, 0, wanted)
        if wanted:
            seen[at, 0], seen[at, 1], seen[at, 2], seen[at, 3] = b, i, j, k
            corners[at, 0], corners[at, 1], corners[at, 2] = corner
            corners[at, 3], corners[at, 4], corners[at, 5] = corner_end
        cuda.syncthreads()
        for begin in range(0, many[0], THREADS // GROUP):
            at, n, chance = begin + thread // GROUP, most, 0.0
            cube = poisson_cells.Cube(seen[0, 0], seen[0, 1], seen[0, 2], seen[0, 3])
            word = key = field.class_key[0]
            if at < many[0]:
                cube = poisson_cells.Cube(seen[at, 0], seen[at, 1], seen[at, 2], seen[at, 3])
                key, n = poisson_cells.cube_key(cube, field), lane
                chance = uniform(key)
            while True:
                # The cube holds drop n if its number is beyond that chance, see `drops_in_cube`.
                there = n < most and chance >= field.count[cube.size_class, n]
                if ballot(there) == 0:
                    break
                path, shows = line_raster.Path(ZERO, ZERO, ZERO, ZERO, ZERO, ZERO), HIDDEN
                if there:
                    word = poisson_cells.drop_id(key, n)
                    path, shows = _path_of(word, cube, corners[at], air, field, view, scene)
                place = claim_row(sought_out, 0, shows != HIDDEN)
                if shows != HIDDEN and place < words_out.shape[0]:
                    places_out[place, 0], places_out[place, 1] = cube.size_class, cube.i
                    places_out[place, 2], places_out[place, 3] = cube.j, cube.k
                    words_out[place] = word
                    paths_out[place, X], paths_out[place, Y] = path.x, path.y
                    paths_out[place, Z], paths_out[place, X_END] = path.z, path.x_end
                    paths_out[place, Y_END], paths_out[place, Z_END] = path.y_end, path.z_end
                    paths_out[place, IS_CLEAR] = ONE if shows == CLEAR else ZERO
                n = n + GROUP if there else most
        cuda.syncthreads()


@cuda.jit(device=True)
def _path_of(word, cube, corners, air, field, view, scene):
    """Return the `Path` of a drop, and how it shows; `corners` of its cube, first and last."""
    b = cube.size_class
    x, y, z = drop_offset(word, cube, field)
    p, q, r = step_from((corners[0], corners[1], corners[2]), view.axes, x, y, z)
    if not _NEAR <= r < air.far[b]:
        return line_raster.Path(ZERO, ZERO, ZERO, ZERO, ZERO, ZERO), HIDDEN
    p_end, q_end, r_end = step_from((corners[3], corners[4], corners[5]), view.axes_end, x, y, z)
    path = line_raster.Path(p, q, r, p_end, q_end, r_end)
    shows = may_show(path, view.lens, scene)
    _, _, height = poisson_cells.drop_place(word, cube, field)
    if shows != HIDDEN and poisson_cells.thinned_out(word, b, height, field):
        shows = HIDDEN
    return path, shows


@cuda_kernel
def follow(sought, places, words, sent, field, surfaces, paths_out):
    """Find how much of their path the drops in view go before they meet something.

    surfaces : HeightFields. Both of device arrays.
    paths_out : float32 device array (room, PATH). SHARE, 0 for drops that have
        ended, and DIAMETER.
    """
    time, exposure = sent.time[0], sent.exposure[0]
    for n in range(cuda.grid(1), min(sought[0], words.shape[0]), cuda.gridsize(1)):
        b, word = places[n, 0], words[n]
        x, y, z = poisson_cells.drop_place(
            word, poisson_cells.Cube(b, places[n, 1], places[n, 2], places[n, 3]), field
        )
        stop, _, _, _ = first_hit(
            x, y, z, field.velocity[b, 0], field.velocity[b, 1], field.velocity[b, 2], -np.inf,
            time + exposure, surfaces,
        )  # fmt: skip
        paths_out[n, SHARE] = max(np.float32(min((stop - time) / exposure, 1.0)), ZERO)
        paths_out[n, DIAMETER] = np.float32(poisson_cells.drop_diameter(word, b, field))


@cuda_kernel
def draw_field(sought, paths, lens, scene, picture):
    """Draw the drops in view, a group of lanes for each."""
    listed = min(sought[0], paths.shape[0])
    first = cuda.blockIdx.x * cuda.blockDim.y + cuda.threadIdx.y
    for n in range(first, listed, cuda.gridDim.x * cuda.blockDim.y):
        row, share = paths[n], paths[n, SHARE]
        if share > ZERO:
            path = line_raster.Path(row[X], row[Y], row[Z], row[X_END], row[Y_END], row[Z_END])
            clear = row[IS_CLEAR] > ZERO
            line_raster.draw_path(path, share, row[DIAMETER], lens, scene, clear, picture)


class Streaks:
    """The streaks of a rain in a picture, drawn on a CUDA device; twin of `streaks.draw_streaks`.

    field : RainField. Of the weather; `update` takes those of other times.
    surfaces : Surfaces or HeightFields. The latter of device arrays.
    drips : cuda.rain.drip_list.DripList or None. Drips that are drawn too.
    spray : cuda.particles.spray.Spray or None. What tyres throw, drawn too.
    field, surfaces, view : DropField, HeightFields, ShutterView. Of device arrays.
    """

    def __init__(self, field, surfaces, width, height):
        self._listed = None
        is_there = isinstance(surfaces, HeightFields)
        self.surfaces = surfaces if is_there else sent_surfaces(surfaces)
        f4, f8, i8 = np.float32, np.float64, np.int64
        names = {
            "counts": ((CLASSES + 1,), i8), "first": ((CLASSES, 3), i8), "last": ((CLASSES, 3), i8),
            "time": ((1,), f8), "exposure": ((1,), f8), "rotation": ((3, 3), f8), "eye": ((3,), f8),
            "rotation_end": ((3, 3), f8), "eye_end": ((3,), f8), "axes": ((3, 3), f4),
            "axes_end": ((3, 3), f4), "lens": ((8,), f4),
            "planes": ((4, 3), f4), "far": ((CLASSES,), f4), "slack": ((CLASSES,), f8),
            "sought": ((1,), np.int32),
        }  # fmt: skip
        self.now = FrameUniforms(names | arrays_of(field))
        tiles = 2, -(-height // line_raster.DEPTH_TILE), -(-width // line_raster.DEPTH_TILE)
        self.alpha = cuda.device_array((height, width), np.float32)
        self._make_room(ROOM)
        self.picture = cuda.to_device(np.zeros(width * height, np.int64))
        self.view, self._air, self.field = (
            kind(*(self.now[name] for name in kind._fields))
            for kind in (ShutterView, SeenAir, poisson_cells.DropField)
        )
        columns = cuda.device_array(width * height, np.float32)
        self.scene = line_raster.SceneDepth(
            width, height, columns, cuda.device_array(tiles, np.float32)
        )
        self.drips = self.spray = None

    def update(
        self, field, camera, time, exposure, far, camera_end=None, aperture=0.0, focus=np.inf,
        strength=1.0,
    ):  # fmt: skip
        """Set rain, camera and shutter of the next picture; arguments as in `draw_streaks`."""
        require_pictures(camera, self.alpha, self.alpha)
        view = shutter_view(camera, time, exposure, camera_end, aperture, focus, strength)
        air = seen_air(field, camera, view, far, aperture, focus)
        sides = np.maximum(air.last - air.first + 1, 0)
        cubes = sides[:, 0] * sides[:, 1] * sides[:, 2] * (air.far > line_raster.NEAR)
        if field is not self._listed:
            self._listed = field
            self.now.update(**field.arrays()._asdict())
        drops = float(cubes @ field.mean_count)
        wanted = drops + 6 * math.sqrt(drops)
        if wanted > MOST_ROOM:
            raise ParameterError(
                f"{drops:.3g} drops may be in view; on a CUDA device they must be fewer than "
                f'{MOST_ROOM}; let drawn drops end nearer (streak_far) or use backend "cpu"'
            )
        if self.room < wanted:
            self._make_room(int(2 * wanted))
        self.now.host["counts"][1:] = cubes.cumsum()
        self.now.update(**view._asdict(), **air._asdict())

    def _make_room(self, drops):
        """Allocate the lists of drops in view."""
        self.room = drops
        self._sought = (
            self.now["sought"],  # blanked by each `send`
            cuda.device_array((drops, 4), np.int32), cuda.device_array(drops, np.uint64),
        )  # fmt: skip
        self._paths = cuda.device_array((drops, PATH), np.float32)

    def draw(self, depth):
        """Queue the picture before what has a depth, float32 device array (height, width) [m]."""
        now, lens, scene = self.now, self.now["lens"], self.scene
        now.send()
        _, rows, columns = scene.tiles.shape
        threads = (1, 1) if SIMULATED else (line_raster.DEPTH_TILE, line_raster.DEPTH_TILE)
        read_depth[(columns, rows), threads](depth, scene.columns, scene.tiles)
        list_drops[BLOCKS, THREADS](
            now["counts"], self._air, self.view, self.field, scene, *self._sought, self._paths
        )
        follow[BLOCKS, THREADS](*self._sought, self.view, self.field, self.surfaces, self._paths)
        draw_field[BLOCKS, GROUPS](now["sought"], self._paths, lens, scene, self.picture)
        if self.drips is not None:
            self.drips.draw(self.view, scene, self.picture)
        if self.spray is not None:
            self.spray.draw(self.view, scene, self.picture)
        self.resolve(self.alpha)
        if self.spray is not None:
            self.spray.lay(lens, depth, self.alpha)

    def resolve(self, alpha_out):
        """Queue the conversion of the drawn picture into alpha, and blank the picture."""
        height, width = alpha_out.shape
        blocks, threads = (-(-width // TILE), -(-height // TILE)), (TILE, 8)
        resolve[blocks, (4, 1) if SIMULATED else threads](self.picture, alpha_out)
