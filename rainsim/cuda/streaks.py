"""Rain in a picture on a CUDA device: twin of `rainsim.streaks`.

A thread looks at a cube of air; those in view its block goes through, a group of lanes a cube and a
lane a drop, and lists what may be seen. A thread follows each of those through the map, and a group
of lanes draws it, a lane a stretch of the path. Optical depths are whole numbers that are added up,
so that no order matters.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.cubes import cube_key, drop_diameter, drop_id, left_out
from rainsim.cuda.drops import BLOCKS, class_of
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.marks import TILE, read_depth, resolve
from rainsim.cuda.numbers import Numbers
from rainsim.cuda.warp import GROUP, GROUPS, THREADS, WHOLE, ballot, take_place
from rainsim.errors import ParameterError
from rainsim.marks import draw_path
from rainsim.random import uniform, uniform_triple
from rainsim.spectrum import CLASSES
from rainsim.streaks import (
    CLEAR,
    HIDDEN,
    NEAR,
    _check,
    _checked_far,
    _cube_in_view,
    _may_show,
    _to_camera,
    _view_boxes,
    _views,
)
from rainsim.surfaces import BLOCK, first_hit

LARGE = np.float32(400)  # px that a path touches, from which on a whole warp draws it
MANY = 2**14  # such paths that there is room for; more are drawn as the small ones are
ROOM = 2**15 if SIMULATED else 2**20  # drops that may be in view
PATH = 9  # numbers of a path
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)


@cuda.jit(device=True)
def _cube_of(task, counts, first, last):
    """Return the class and the place (i, j, k) of cube number `task` of all classes' boxes."""
    b, rest = class_of(task, counts)
    deep = last[b, 2] - first[b, 2] + 1
    wide = last[b, 1] - first[b, 1] + 1
    k = rest % deep
    rest //= deep
    return b, first[b, 0] + rest // wide, first[b, 1] + rest % wide, first[b, 2] + k


@cuda.jit(device=True)
def _see_cube(
    b, i, j, k, time, exposure, velocity, cube, frame, rotation, eye, rotation_end, eye_end,
    base_out, base_end_out,
):  # fmt: skip
    """Fill in where a cube's lower corner is for the camera, first and last."""
    side = cube[b]
    vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
    x, y = i * side + vx * time + frame[b, 0], j * side + vy * time + frame[b, 1]
    z = k * side + vz * time
    _to_camera(rotation, eye, x, y, z, base_out)
    x, y, z = x + vx * exposure, y + vy * exposure, z + vz * exposure
    _to_camera(rotation_end, eye_end, x, y, z, base_end_out)


@cuda.jit(device=True)
def _turned(axes, x, y, z, px, py, pz):
    """Return p + axes (x, y, z), as `rainsim.streaks` adds it up."""
    return (
        px + axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z,
        py + axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z,
        pz + axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z,
    )


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
    places_out : device array of shape (room, 4), int32
        Class and cube.
    words_out : device array of shape (room,), uint64
        The drops' ids.
    paths_out : device array of shape (room, PATH), float32
        Places in the camera's frame when the shutter opens and closes [m], and whether nothing
        stands before them. The other arrays are those of the CPU's kernel.
    """
    seen = cuda.shared.array((THREADS, 4), np.int32)  # class and cube
    corners = cuda.shared.array((THREADS, 6), np.float32)  # of each, first and last
    many = cuda.shared.array(1, np.int32)
    time, exposure = times[0], times[1]
    high, wide = np.float32(height), np.float32(width)
    base, base_end = cuda.local.array(3, np.float32), cuda.local.array(3, np.float32)
    axes, axes_end = cuda.local.array((3, 3), np.float32), cuda.local.array((3, 3), np.float32)
    sides = cuda.local.array((3, 3), np.float32)
    for a in range(3):
        for c in range(3):
            axes[a, c], axes_end[a, c] = rotation[a, c], rotation_end[a, c]
    thread, lane = cuda.threadIdx.x, cuda.threadIdx.x % GROUP
    total, changes = counts[CLASSES], share.shape[1] > 1
    batches = (total + THREADS - 1) // THREADS
    for batch in range(cuda.blockIdx.x, batches, cuda.gridDim.x):
        if thread == 0:
            many[0] = 0
        cuda.syncthreads()
        # Threads look at cubes far from each other, so that all blocks find about as many in view.
        task, wanted = thread * batches + batch, False
        b, i, j, k = 0, first[0, 0], first[0, 0], first[0, 0]
        if task < total:
            b, i, j, k = _cube_of(task, counts, first, last)
            _see_cube(
                b, i, j, k, time, exposure, velocity, cube, frame, rotation, eye, rotation_end,
                eye_end, base, base_end,
            )  # fmt: skip
            vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
            moves = exposure * math.sqrt(vx * vx + vy * vy + vz * vz)
            radius = np.float32(0.87 * cube[b] + 0.5 * moves + slack[b])
            for a in range(3):
                for c in range(3):
                    sides[a, c] = axes[a, c] * np.float32(cube[b])
            wanted = _cube_in_view(base, base_end, sides, radius, planes, near, far[b])
        at = take_place(many, 0, wanted)
        if wanted:
            seen[at, 0], seen[at, 1], seen[at, 2], seen[at, 3] = b, i, j, k
            for a in range(3):
                corners[at, a], corners[at, 3 + a] = base[a], base_end[a]
        cuda.syncthreads()
        for begin in range(0, many[0], THREADS // GROUP):
            at, n, chance = begin + thread // GROUP, count.shape[1], 0.0
            word = key = class_key[0]
            if at < many[0]:
                b, i, j, k = seen[at, 0], seen[at, 1], seen[at, 2], seen[at, 3]
                key, n = cube_key(class_key[b], i, j, k), lane
                chance = uniform(key)
            while True:
                # The cube holds drop n if its number is beyond that chance, see `drops_in_cube`.
                there = n < count.shape[1] and chance >= count[b, n]
                if ballot(there) == 0:
                    break
                p, q, r, p_end, q_end, r_end = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
                shows = HIDDEN
                if there:
                    word = drop_id(key, n)
                    ux, uy, uz = uniform_triple(word)
                    # A cube's side is a power of two: the same numbers as with longer axes.
                    side = cube[b]
                    x, y, z = np.float32(ux * side), np.float32(uy * side), np.float32(uz * side)
                    p, q, r = _turned(axes, x, y, z, corners[at, 0], corners[at, 1], corners[at, 2])
                    if near <= r < far[b]:
                        p_end, q_end, r_end = _turned(
                            axes_end, x, y, z, corners[at, 3], corners[at, 4], corners[at, 5]
                        )
                        shows = _may_show(
                            p, q, r, p_end, q_end, r_end, lens, near, wide, high, tile_depth
                        )
                        if changes and left_out(
                            word, b, (k + uz) * cube[b], velocity[b, 2], share, frame
                        ):
                            shows = HIDDEN
                place = take_place(sought_out, 0, shows != HIDDEN)
                if shows != HIDDEN and place < words_out.shape[0]:
                    places_out[place, 0], places_out[place, 1] = b, i
                    places_out[place, 2], places_out[place, 3] = j, k
                    words_out[place] = word
                    paths_out[place, 0], paths_out[place, 1], paths_out[place, 2] = p, q, r
                    paths_out[place, 3], paths_out[place, 4] = p_end, q_end
                    paths_out[place, 5] = r_end
                    paths_out[place, 6] = _ONE if shows == CLEAR else _ZERO
                n = n + GROUP if there else count.shape[1]
        cuda.syncthreads()


@cuda_kernel
def follow(
    sought, places, words, times, velocity, cube, size, frame, lens,
    x0, y0, spacing, sky, ground, underside, top, block_high, paths_out, many_out, large_out,
):  # fmt: skip
    """Tell how much of their path the drops in view go before they meet something.

    Parameters
    ----------
    sought, places, words
        As `look` left them.
    times : device array of shape (2,), float64 [s]
        When the shutter opens, and for how long.
    paths_out : device array of shape (room, PATH), float32
        The share of the path, 0 for drops that are no more and less for large ones, and the
        diameter [m].
    many_out : device array of shape (1,), int32
        Raised by the number of large ones.
    large_out : device array of shape (MANY,), int32
        Which they are. The other arrays are those of the CPU's kernel.
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
        share = max(np.float32(min((stop - time) / exposure, 1.0)), _ZERO)
        paths_out[n, 8] = diameter = np.float32(drop_diameter(word, b, size))
        if share > _ZERO and _pixels(paths_out[n], diameter, lens) > LARGE:
            at = cuda.atomic.add(many_out, 0, 1)
            if at < large_out.shape[0]:
                large_out[at] = n
                share = -share
        paths_out[n, 7] = share


@cuda.jit(device=True)
def _pixels(path, diameter, lens):
    """Return about how many pixels a path in the camera's frame touches."""
    nearest = min(path[2], path[5])
    u = lens[0] * abs(path[3] / path[5] - path[0] / path[2])
    v = lens[1] * abs(path[4] / path[5] - path[1] / path[2])
    wide = lens[0] * diameter / nearest
    wide += lens[5] * max(abs(_ONE / path[2] - lens[6]), abs(_ONE / path[5] - lens[6]))
    return (wide + _TWO) * (u + v + wide + _TWO)


@cuda_kernel
def draw_field(sought, paths, lens, near, width, height, depth, picture):
    """Draw the drops in view but the large ones, a group of lanes for each.

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
    listed = min(sought[0], paths.shape[0])
    first = cuda.blockIdx.x * cuda.blockDim.y + cuda.threadIdx.y
    for n in range(first, listed, cuda.gridDim.x * cuda.blockDim.y):
        if paths[n, 7] > _ZERO:
            _draw(paths[n], paths[n, 7], lens, near, width, height, depth, picture)


@cuda_kernel
def draw_large(many, large, paths, lens, near, width, height, depth, picture):
    """Draw the large drops in view, a warp for each; see `draw_field`.

    Parameters
    ----------
    many : device array of shape (1,), int32
    large : device array of shape (MANY,), int32
        As `follow` left them.
    paths, lens, near, width, height, depth, picture
    """
    listed = min(many[0], large.shape[0])
    first = cuda.blockIdx.x * cuda.blockDim.y + cuda.threadIdx.y
    for at in range(first, listed, cuda.gridDim.x * cuda.blockDim.y):
        n = large[at]
        _draw(paths[n], -paths[n, 7], lens, near, width, height, depth, picture)


@cuda.jit(device=True)
def _draw(path, share, lens, near, width, height, depth, picture):
    draw_path(
        path[0], path[1], path[2], path[3], path[4], path[5], share, path[8], lens, near, width,
        height, depth, path[6] > _ZERO, picture,
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
    sent : event
        When `launch` has sent the camera and the times.
    drips : cuda.drips.DripList or None
        Drips that are drawn too.
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
            "sought": ((1,), np.int32), "many": ((1,), np.int32),
        }  # fmt: skip
        for name, array in zip(_FIELD, field.arrays(), strict=True):
            names[name] = array.shape, array.dtype
        self.now, self.sent = Numbers(stream, names), cuda.event()
        tiles = 2, -(-height // BLOCK), -(-width // BLOCK)
        self.alpha = cuda.device_array((height, width), np.float32, stream=stream)
        self.columns = cuda.device_array(width * height, np.float32, stream=stream)
        self.tile_depth = cuda.device_array(tiles, np.float32, stream=stream)
        self._sought = (
            self.now["sought"],  # blanked by each `send`, as "many" is
            cuda.device_array((ROOM, 4), np.int32, stream=stream),
            cuda.device_array(ROOM, np.uint64, stream=stream),
        )
        self._paths = cuda.device_array((ROOM, PATH), np.float32, stream=stream)
        self._large = cuda.device_array(MANY, np.int32, stream=stream)
        self.picture = cuda.to_device(np.zeros(width * height, np.int64), stream)
        self.drips = None

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

    def launch(self, stream=None):
        """Queue the picture, on another stream than its own if given."""
        stream = self.stream if stream is None else stream
        width, height = self.size
        _, rows, columns = self.tile_depth.shape
        threads = (1, 1) if SIMULATED else (BLOCK, BLOCK)
        self.now.send(stream)
        self.sent.record(stream)
        read_depth[(columns, rows), threads, stream](self._depth, self.columns, self.tile_depth)
        now, near = self.now, np.float32(NEAR)
        names = "counts", "first", "last", "times", *_SOUGHT, *_VIEWS
        look[BLOCKS, THREADS, stream](
            *(now[name] for name in names), near, now["far"], now["slack"], width, height,
            self.tile_depth, *self._sought, self._paths,
        )  # fmt: skip
        follow[BLOCKS, THREADS, stream](
            *self._sought, *(now[name] for name in _FOLLOWED), *self._surfaces, self._paths,
            now["many"], self._large,
        )  # fmt: skip
        rest = now["lens"], near, width, height, self.columns, self.picture
        draw_large[BLOCKS, WHOLE, stream](now["many"], self._large, self._paths, *rest)
        draw_field[BLOCKS, GROUPS, stream](now["sought"], self._paths, *rest)
        if self.drips is not None:
            self.drips.draw(self.seen(), stream)
        self.resolve(self.alpha, False, stream)

    def seen(self):
        """Return what kernels need that draw lines into the picture, as `splash.draw_list` has it.

        Times and cameras, the depth column by column and that of tiles, and optical depths.
        """
        names = ("times", "rotation", "eye", "rotation_end", "eye_end", "lens")
        return (
            *(self.now[name] for name in names), np.float32(NEAR), *self.size, self.columns,
            self.tile_depth, self.picture,
        )  # fmt: skip

    def resolve(self, alpha_out, over, stream):
        """Queue the turning of what was drawn into alpha, and blank the picture."""
        width, height = self.size
        blocks, threads = (-(-width // TILE), -(-height // TILE)), (TILE, 8)
        threads = (4, 1) if SIMULATED else threads
        resolve[blocks, threads, stream](over, self.picture, alpha_out)


_FIELD = ("velocity", "cube", "class_key", "count", "size", "share", "frame")
_VIEWS = ("rotation", "eye", "rotation_end", "eye_end", "lens", "planes")
_SOUGHT = tuple(name for name in _FIELD if name != "size")  # what `look` needs of them
_FOLLOWED = ("times", "velocity", "cube", "size", "frame", "lens")
