"""Rain in a picture on a CUDA device: twin of `rainsim.streaks`.

A warp looks at some cubes of air, a lane at each; those in view it goes through together, a lane a
drop, and lists what may be seen. A thread follows each of those through the map, and a warp draws
it, a lane a stretch of the path. Optical depths are whole numbers that are added up, so that no
order matters.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.cubes import cube_key, drop_diameter, drop_id, drops_in_cube, left_out
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.numbers import Numbers
from rainsim.cuda.warp import LANES, ballot, lane, lowest
from rainsim.errors import ParameterError
from rainsim.marks import alpha_of, draw_path
from rainsim.random import uniform_triple
from rainsim.spectrum import CLASSES
from rainsim.streaks import (
    CLEAR,
    HIDDEN,
    NEAR,
    _check,
    _checked_far,
    _cube_in_view,
    _may_show,
    _place,
    _to_camera,
    _view_boxes,
    _views,
)
from rainsim.surfaces import BLOCK, first_hit

WARPS = 1 if SIMULATED else 4  # of a block
BLOCKS = 2 if SIMULATED else 132 * 8
ABREAST = (
    1 if SIMULATED else 8
)  # cubes that a warp looks at before it goes through those that count
FOLLOWERS, THREADS = (2, 32) if SIMULATED else (132 * 8, 128)  # of `follow`
ROOM = 2**15 if SIMULATED else 2**20  # drops that may be in view
PATH = 9  # numbers of a path
_ZERO, _ONE = np.float32(0), np.float32(1)


@cuda_kernel
def read_depth(depth, columns_out, tile_depth_out):
    """Copy a depth picture column by column, and find each tile's greatest and least depth.

    Parameters
    ----------
    depth : device array of shape (height, width), float32 [m]
    columns_out : device array of shape (width * height,), float32 [m]
    tile_depth_out : device array of shape (2, rows, columns), float32 [m]
        One block of threads for each tile.
    """
    room = cuda.shared.array((BLOCK, BLOCK), np.float32)
    lows = cuda.shared.array(BLOCK, np.float32)
    highs = cuda.shared.array(BLOCK, np.float32)
    height, width = depth.shape
    left, top = cuda.blockIdx.x * BLOCK, cuda.blockIdx.y * BLOCK
    wide, high = min(BLOCK, width - left), min(BLOCK, height - top)
    x, y = cuda.threadIdx.x, cuda.threadIdx.y
    for row in range(y, high, cuda.blockDim.y):
        for column in range(x, wide, cuda.blockDim.x):
            room[row, column] = depth[top + row, left + column]
    cuda.syncthreads()
    for column in range(y, wide, cuda.blockDim.y):
        for row in range(x, high, cuda.blockDim.x):
            columns_out[(left + column) * height + top + row] = room[row, column]
    if y == 0:
        for column in range(x, wide, cuda.blockDim.x):
            highs[column] = lows[column] = room[0, column]
            for row in range(1, high):
                highs[column] = max(highs[column], room[row, column])
                lows[column] = min(lows[column], room[row, column])
    cuda.syncthreads()
    if x == 0 and y == 0:
        most, least = highs[0], lows[0]
        for column in range(1, wide):
            most, least = max(most, highs[column]), min(least, lows[column])
        tile_depth_out[0, cuda.blockIdx.y, cuda.blockIdx.x] = most
        tile_depth_out[1, cuda.blockIdx.y, cuda.blockIdx.x] = least


@cuda_kernel
def resolve(over, picture, alpha_out):
    """Turn summed optical depths into alpha, and blank them.

    Parameters
    ----------
    over : bool
        Whether to multiply to what `alpha_out` holds; else it is overwritten.
    picture : device array of shape (width * height,), int64
    alpha_out : device array of shape (height, width), float32
    """
    height, width = alpha_out.shape
    column, row = cuda.grid(2)
    if row >= height or column >= width:
        return
    at = column * height + row
    alpha = alpha_of(picture[at])
    picture[at] = 0
    if over:
        before = alpha_out[row, column]
        alpha = before + alpha * (_ONE - before)
    alpha_out[row, column] = alpha


@cuda.jit(device=True)
def _cube_of(task, counts, first, last):
    """Return the class and the place (i, j, k) of cube number `task` of all classes' boxes."""
    b, end = 0, CLASSES
    while end - b > 1:
        middle = (b + end) // 2
        if counts[middle] <= task:
            b = middle
        else:
            end = middle
    rest = task - counts[b]
    deep = last[b, 2] - first[b, 2] + 1
    wide = last[b, 1] - first[b, 1] + 1
    k = rest % deep
    rest //= deep
    return b, first[b, 0] + rest // wide, first[b, 1] + rest % wide, first[b, 2] + k


@cuda.jit(device=True)
def _see_cube(
    b, i, j, k, time, exposure, velocity, cube, frame, rotation, eye, rotation_end, eye_end,
    base_out, base_end_out, axes_out, axes_end_out,
):  # fmt: skip
    """Fill in where a cube's lower corner and its sides are for the camera, first and last."""
    side = cube[b]
    vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
    for a in range(3):
        for c in range(3):
            axes_out[a, c] = rotation[a, c] * side
            axes_end_out[a, c] = rotation_end[a, c] * side
    x, y = i * side + vx * time + frame[b, 0], j * side + vy * time + frame[b, 1]
    z = k * side + vz * time
    _to_camera(rotation, eye, x, y, z, base_out)
    x, y, z = x + vx * exposure, y + vy * exposure, z + vz * exposure
    _to_camera(rotation_end, eye_end, x, y, z, base_end_out)


@cuda_kernel
def look(
    counts, first, last, times, velocity, cube, class_key, count, share, frame,
    rotation, eye, rotation_end, eye_end, lens, planes, near, far, slack,
    width, height, tile_depth, sought_out, places_out, words_out, paths_out,
):  # fmt: skip
    """List the drops that may be in view, cube by cube.

    Parameters
    ----------
    counts : device array of shape (CLASSES + 1,), int64
        Cubes of the classes before each, and of all.
    first, last : device array of shape (CLASSES, 3), int64
        First and last cube of each class along x, y and z.
    times : device array of shape (2,), float64 [s]
        When the shutter opens, and for how long.
    sought_out : device array of shape (1,), int32
        Raised by the number of drops.
    places_out : device array of shape (room, 4), int64
        Class and cube.
    words_out : device array of shape (room,), uint64
        The drops' ids.
    paths_out : device array of shape (room, PATH), float32
        Places in the camera's frame when the shutter opens and closes [m], and whether nothing
        stands before them. The other arrays are those of the CPU's kernel.
    """
    time, exposure = times[0], times[1]
    high, wide = np.float32(height), np.float32(width)
    base, base_end = cuda.local.array(3, np.float32), cuda.local.array(3, np.float32)
    axes, axes_end = cuda.local.array((3, 3), np.float32), cuda.local.array((3, 3), np.float32)
    warp = cuda.blockIdx.x * WARPS + cuda.threadIdx.x // LANES
    warps = cuda.gridDim.x * WARPS
    total, changes = counts[CLASSES], share.shape[1] > 1
    chunks = (total + ABREAST - 1) // ABREAST
    for chunk in range(warp, chunks, warps):
        # Lanes look at cubes far from each other, so that all warps find about as many in view.
        task = lane() * chunks + chunk
        seen = False
        b, i, j, k = 0, first[0, 0], first[0, 0], first[0, 0]
        if lane() < ABREAST and task < total:
            b, i, j, k = _cube_of(task, counts, first, last)
            _see_cube(
                b, i, j, k, time, exposure, velocity, cube, frame, rotation, eye, rotation_end,
                eye_end, base, base_end, axes, axes_end,
            )  # fmt: skip
            vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
            moves = exposure * math.sqrt(vx * vx + vy * vy + vz * vz)
            radius = np.float32(0.87 * cube[b] + 0.5 * moves + slack[b])
            seen = _cube_in_view(base, base_end, axes, radius, planes, near, far[b])
        hits = ballot(seen)
        while hits != 0:
            source = lowest(hits)
            hits &= hits - 1
            task = source * chunks + chunk
            b, i, j, k = _cube_of(task, counts, first, last)
            _see_cube(
                b, i, j, k, time, exposure, velocity, cube, frame, rotation, eye, rotation_end,
                eye_end, base, base_end, axes, axes_end,
            )  # fmt: skip
            side, reach = cube[b], far[b]
            vz = velocity[b, 2]
            key = cube_key(class_key[b], i, j, k)
            for n in range(lane(), drops_in_cube(key, b, count), LANES):
                word = drop_id(key, n)
                ux, uy, uz = uniform_triple(word)
                p, q, r = _place(base, axes, ux, uy, uz)
                if not near <= r < reach:
                    continue
                p_end, q_end, r_end = _place(base_end, axes_end, ux, uy, uz)
                shows = _may_show(p, q, r, p_end, q_end, r_end, lens, near, wide, high, tile_depth)
                if changes and left_out(word, b, (k + uz) * side, vz, share, frame):
                    shows = HIDDEN
                if shows == HIDDEN:
                    continue
                at = cuda.atomic.add(sought_out, 0, 1)
                if at < words_out.shape[0]:
                    places_out[at, 0], places_out[at, 1] = b, i
                    places_out[at, 2], places_out[at, 3] = j, k
                    words_out[at] = word
                    paths_out[at, 0], paths_out[at, 1], paths_out[at, 2] = p, q, r
                    paths_out[at, 3], paths_out[at, 4], paths_out[at, 5] = p_end, q_end, r_end
                    paths_out[at, 6] = _ONE if shows == CLEAR else _ZERO


@cuda_kernel
def follow(
    sought, places, words, times, velocity, cube, size, frame,
    x0, y0, spacing, sky, ground, underside, top, block_high, paths_out,
):  # fmt: skip
    """Tell how much of their path the drops in view go before they meet something.

    Parameters
    ----------
    sought, places, words
        As `look` left them.
    times : device array of shape (2,), float64 [s]
        When the shutter opens, and for how long.
    paths_out : device array of shape (room, PATH), float32
        The share of the path, 0 for drops that are no more, and the diameter [m]. The other arrays
        are those of the CPU's kernel.
    """
    time, exposure = times[0], times[1]
    for n in range(cuda.grid(1), min(sought[0], words.shape[0]), cuda.gridsize(1)):
        b, word = places[n, 0], words[n]
        side, (ux, uy, uz) = cube[b], uniform_triple(word)
        stop, _, _, _ = first_hit(
            (places[n, 1] + ux) * side + frame[b, 0], (places[n, 2] + uy) * side + frame[b, 1],
            (places[n, 3] + uz) * side, velocity[b, 0], velocity[b, 1], velocity[b, 2], -np.inf,
            time + exposure, x0, y0, spacing, sky, ground, underside, top, block_high,
        )  # fmt: skip
        paths_out[n, 7] = max(np.float32(min((stop - time) / exposure, 1.0)), _ZERO)
        paths_out[n, 8] = drop_diameter(word, b, size)


@cuda_kernel
def draw_field(sought, paths, lens, near, width, height, depth, picture):
    """Draw the drops in view, a warp for each.

    Parameters
    ----------
    sought : device array of shape (1,), int32
        Drops in view.
    paths : device array of shape (room, PATH), float32
        As `look` and `follow` left them.
    lens, near, depth
        As the CPU's kernel has them.
    width, height : int [px]
    picture : device array of shape (width * height,), int64
        Added to.
    """
    warp = cuda.blockIdx.x * WARPS + cuda.threadIdx.x // LANES
    for n in range(warp, min(sought[0], paths.shape[0]), cuda.gridDim.x * WARPS):
        if paths[n, 7] > _ZERO:
            draw_path(
                paths[n, 0], paths[n, 1], paths[n, 2], paths[n, 3], paths[n, 4], paths[n, 5],
                paths[n, 7], paths[n, 8], lens, near, width, height, depth, paths[n, 6] > _ZERO,
                picture,
            )  # fmt: skip


class Streaks:
    """The streaks of a rain in a picture, drawn on a CUDA device; twin of `streaks.draw_streaks`.

    Parameters
    ----------
    field : RainField
        Of the weather; `update` takes those of other times.
    surfaces : Surfaces
    width, height : int [px]
    depth : device array of shape (height, width), float32 [m]
        Read by `launch`.
    stream : cuda.stream

    Attributes
    ----------
    alpha : device array of shape (height, width), float32
        Share of light that drops replace.
    columns, tile_depth, picture : device arrays
        The depth column by column, that of tiles, and blank optical depths: for what else is drawn
        in the same picture.
    """

    def __init__(self, field, surfaces, width, height, depth, stream=0):
        self.stream, self.size, self._depth = stream, (width, height), depth
        x0, y0, spacing, sky, *maps = surfaces.arrays()
        self._surfaces = [x0, y0, spacing, sky, *(cuda.to_device(m, stream) for m in maps)]
        f4, f8, i8 = np.float32, np.float64, np.int64
        names = {
            "counts": ((CLASSES + 1,), i8), "first": ((CLASSES, 3), i8), "last": ((CLASSES, 3), i8),
            "times": ((2,), f8), "rotation": ((3, 3), f8), "eye": ((3,), f8),
            "rotation_end": ((3, 3), f8), "eye_end": ((3,), f8), "lens": ((7,), f4),
            "planes": ((4, 3), f4), "far": ((CLASSES,), f4), "slack": ((CLASSES,), f8),
            "sought": ((1,), np.int32),
        }  # fmt: skip
        for name, array in zip(_FIELD, field.arrays(), strict=True):
            names[name] = array.shape, array.dtype
        self.now = Numbers(stream, names)
        tiles = 2, -(-height // BLOCK), -(-width // BLOCK)
        self.alpha = cuda.device_array((height, width), np.float32, stream=stream)
        self.columns = cuda.device_array(width * height, np.float32, stream=stream)
        self.tile_depth = cuda.device_array(tiles, np.float32, stream=stream)
        self._sought = (
            self.now["sought"],  # blanked by each `send`
            cuda.device_array((ROOM, 4), np.int64, stream=stream),
            cuda.device_array(ROOM, np.uint64, stream=stream),
        )
        self._paths = cuda.device_array((ROOM, PATH), np.float32, stream=stream)
        self.picture = cuda.to_device(np.zeros(width * height, np.int64), stream)

    def update(
        self, field, camera, time, exposure, far, camera_end=None, aperture=0.0, focus=np.inf
    ):
        """Say what the next picture shows; arguments as `streaks.draw_streaks` has them."""
        _check(camera, exposure, self.alpha, self.alpha)
        far = _checked_far(far)
        camera_end = camera if camera_end is None else camera_end
        low, high, slack = _view_boxes(camera, camera_end, far, aperture, focus)
        drift, offset = field.velocity * exposure, field.velocity * time
        first, last = field.cube_range(
            low - np.maximum(drift, 0) - offset, high - np.minimum(drift, 0) - offset
        )
        cubes = np.prod(np.maximum(last - first + 1, 0), axis=1) * (far > NEAR)
        drops = float((cubes * field.listed.density * field.cube**3).sum())
        if drops + 6 * math.sqrt(drops) > ROOM:
            raise ParameterError(
                f"{drops:.3g} drops may be in view; on a CUDA device they must be fewer than "
                f'{ROOM}; let drawn drops end nearer (streak_far) or use backend "cpu"'
            )
        self.now.update(
            counts=np.concatenate([[0], np.cumsum(cubes)]), first=first, last=last,
            times=(time, exposure), far=far, slack=slack,
            **dict(zip(_VIEWS, _views(camera, camera_end, aperture, focus), strict=True)),
            **dict(zip(_FIELD, field.arrays(), strict=True)),
        )  # fmt: skip

    def launch(self):
        """Queue the picture."""
        width, height = self.size
        _, rows, columns = self.tile_depth.shape
        threads = (1, 1) if SIMULATED else (BLOCK, BLOCK)
        self.now.send()
        read_depth[(columns, rows), threads, self.stream](
            self._depth, self.columns, self.tile_depth
        )
        now, near = self.now, np.float32(NEAR)
        names = "counts", "first", "last", "times", *_SOUGHT, *_VIEWS
        look[BLOCKS, WARPS * LANES, self.stream](
            *(now[name] for name in names), near, now["far"], now["slack"], width, height,
            self.tile_depth, *self._sought, self._paths,
        )  # fmt: skip
        follow[FOLLOWERS, THREADS, self.stream](
            *self._sought, *(now[name] for name in _FOLLOWED), *self._surfaces, self._paths
        )
        draw_field[BLOCKS, WARPS * LANES, self.stream](
            now["sought"], self._paths, now["lens"], near, width, height, self.columns,
            self.picture,
        )  # fmt: skip
        self.resolve(self.alpha, over=False)

    def resolve(self, alpha_out, over):
        """Queue the turning of what was drawn into alpha, and blank the picture."""
        width, height = self.size
        threads = (8, 4) if SIMULATED else (32, 8)
        blocks = -(-width // threads[0]), -(-height // threads[1])
        resolve[blocks, threads, self.stream](over, self.picture, alpha_out)


_FIELD = ("velocity", "cube", "class_key", "count", "size", "share", "frame")
_VIEWS = ("rotation", "eye", "rotation_end", "eye_end", "lens", "planes")
_SOUGHT = tuple(name for name in _FIELD if name != "size")  # what `look` needs of them
_FOLLOWED = ("times", "velocity", "cube", "size", "frame")
