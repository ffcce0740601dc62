"""Twin of `rainsim.reflection.planar_mirror`: the capture as mirrored cameras see it."""

from typing import NamedTuple

import numpy as np

from rainsim.cuda.driver import send
from rainsim.cuda.jit import cuda, cuda_device, cuda_kernel
from rainsim.cuda.reflection.mirror_choice import EVERYWHERE, THREADS, LevelChoice
from rainsim.cuda.shading.wet_pass import DeviceView
from rainsim.numerics.mipmap import COARSEST, coarse_shape, mean_of_four, top_of
from rainsim.reflection.mirror_choice import MOST_MIRRORS
from rainsim.reflection.water_pass import mirror_window
from rainsim.render.frame import is_same

SQUARE_CELLS = 1 << (COARSEST - 1)  # of half the resolution in one of the coarsest


class MirrorArrays(NamedTuple):
    """Mirrored pictures of all mirror levels, as device arrays."""

    # (k, 3) float32 [m]: level of each mirror and the heights from which and below which water
    # looks into it; water at other heights is marched.
    range: object
    window: object  # (6,) float32: lens, columns and rows [px] of all pictures
    ground_from_camera: object  # (3, 3) float32, of the mirrored camera: holds a reflection
    picture: object  # (k, rows, columns, 3) float32
    coarse: object  # (k, rows, columns // 2, 3) float32, see numerics.mipmap.coarsened
    depth: object  # (k, rows, columns) float32 [m]


@cuda_device
def mirror_of(mirror_range, z):
    """Return which mirror serves water at height z [m]; -1: none."""
    for k in range(mirror_range.shape[0]):
        if z >= mirror_range[k, 1] and z < mirror_range[k, 2]:
            return k
    return -1


@cuda_kernel
def coarsen(size, picture, coarse_out):
    """Write all coarser resolutions of a picture's window; see `rainsim.numerics.mipmap.coarsened`.

    size : float32 device array (2,). Columns and rows of the window.

    A block of threads takes a square that is one cell of the coarsest resolution.
    """
    cells = cuda.shared.array((SQUARE_CELLS, SQUARE_CELLS, 3), np.float32)
    tid = cuda.threadIdx.x
    width, height = int(size[0]), int(size[1])
    side = SQUARE_CELLS
    for level in range(1, COARSEST + 1):
        top, apart = top_of(height, level), 1 << (level - 1)
        for k in range(tid, side * side, THREADS):
            y, x = k // side, k % side
            row, column = cuda.blockIdx.y * side + y, cuda.blockIdx.x * side + x
            if row < height >> level and column < width >> level:
                # A finer cell lies where the first of those that it is the mean of has lain.
                j, i = y * apart, x * apart
                for c in range(3):
                    if level == 1:
                        value = mean_of_four(picture, 2 * row, 2 * column, 1, c)
                    else:
                        value = mean_of_four(cells, j, i, apart >> 1, c)
                    cells[j, i, c] = value
                    coarse_out[top + row, column, c] = value
        cuda.syncthreads()
        side //= 2


class Mirrors:
    """The wet capture as cameras mirrored at the levels of the water see it.

    tables : DeviceTables
    arrays : MirrorArrays. The pictures as kernels take them; only the window is
        drawn.
    """

    def __init__(self, tables):
        self._tables = tables
        self._levels = LevelChoice(float(tables.conductor.ground.terrain.bed.min()))
        self._views = [DeviceView() for _ in range(MOST_MIRRORS)]
        numbers = (cuda.device_array(shape, np.float32) for shape in ((MOST_MIRRORS, 3), 6, (3, 3)))
        self.arrays = MirrorArrays(*numbers, None, None, None)
        self._shape, self._shown = None, None
        self._allocate(1, 1)

    def _allocate(self, rows, columns):
        """Allocate pictures of at least a size [px]."""
        if self._shape is not None:
            if rows <= self._shape[0] and columns <= self._shape[1]:
                return
            rows, columns = max(rows, self._shape[0]), max(columns, self._shape[1])
        self._shape, f4, self._drawn = (rows, columns), np.float32, {}
        self.arrays = self.arrays._replace(picture=None, coarse=None, depth=None)
        self._clearance = None  # freed before more is asked for
        self.arrays = self.arrays._replace(
            picture=cuda.device_array((MOST_MIRRORS, rows, columns, 3), f4),
            coarse=cuda.device_array((MOST_MIRRORS, *coarse_shape(rows, columns)), f4),
            depth=cuda.device_array((MOST_MIRRORS, rows, columns), f4),
        )
        self._clearance = cuda.device_array((rows, columns), f4)
        self._each = [
            (self.arrays.picture[k], self.arrays.depth[k], self.arrays.coarse[k])
            for k in range(MOST_MIRRORS)
        ]

    def draw(self, seen, camera, scene, name, step):
        """Queue the mirrored pictures that water asks for; return their `MirrorArrays`; waits.

        Those of the frame before stay where camera, scene and level are the same.

        seen : tuple. Hit and coverage, as `ray_water.meet_water` left them.
        camera : Camera. In the capture frame.
        scene : WetScene
        name : str. Of reflections.
        step : int. See `WetScene.mirrored`.
        """
        shows, levels = (camera, scene.changes), []
        if not is_same(shows, self._shown):
            self._shown, self._drawn = shows, {}
        if name != "ssr":
            levels, extent = self._levels.choose(*seen, self._tables.view, name)
        served = np.tile(np.float32([0, EVERYWHERE, -EVERYWHERE]), (MOST_MIRRORS, 1))
        for k, level in enumerate(levels):
            served[k] = level
        send(self.arrays.range, served)
        if levels:
            left, top, right, bottom = extent
            shape, lens = (camera.height, camera.width), (camera.fx, camera.fy)
            ends = np.array([top * camera.width + left, bottom * camera.width + right])
            window = mirror_window(ends, shape, lens)
            rows, columns = ((window[k + 1] - window[k - 1]) // step for k in (2, 1))
            self._allocate(rows, columns)
        for k, (level, *_) in enumerate(levels):
            place = level, window, step
            if self._drawn.pop(k, None) != place:
                layers = scene.capture.mirrored_layers(camera, *place, on_device=True)
                self._draw(k, scene, *layers)
            self._drawn[k] = place
        return self.arrays

    def _draw(self, k, scene, camera, layers):
        """Queue the grading of a mirrored picture, whose splats are drawn, and its mip levels."""
        view, (picture, depth, coarse) = scene.view_of(camera), self._each[k]
        rows, columns = layers.alpha.shape
        send(self.arrays.window, [*view.lens, columns, rows])
        send(self.arrays.ground_from_camera, view.ground_from_camera)
        self._views[k].take(view, (rows, columns))
        self._tables.grade(layers, self._views[k], picture, depth, self._clearance, mirrored=True)
        blocks = -(-columns // (2 * SQUARE_CELLS)), -(-rows // (2 * SQUARE_CELLS))
        coarsen[blocks, THREADS](self._views[k].size, picture, coarse)
