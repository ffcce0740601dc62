"""Splashes on a CUDA device: twin of `rainsim.splash.draw_splashes`.

A thread takes an impact and tells whether it splashes in view; then a group of lanes takes each
that does and lists its droplets and the pieces of its crown, a lane for each. Another group draws
each piece.
"""

from __future__ import annotations

import numpy as np

from rainsim.crowns import (
    FINE_PIXEL,
    LONGEST_JET,
    crown_life,
    crown_shape,
    next_row,
    raise_crown,
    raise_jet,
)
from rainsim.cuda.drops import BLOCKS
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.numbers import Numbers
from rainsim.cuda.warp import GROUP, GROUPS, THREADS, take_place
from rainsim.drops import GROUND
from rainsim.splash import (
    _LARGEST_SHARE,
    _MARGIN,
    _WET,
    LONGEST_LIFE,
    SMALLEST_ON_FILM,
    SMALLEST_SPLASH,
    droplet,
    droplets_of,
    least_seen,
    relative_size,
    splashes_on,
)
from rainsim.streaks import draw_lines

ROOM = 2**18  # lines
NEAREST = 0.05  # m, as the CPU has it


@cuda.jit(device=True)
def seen_at(x, y, z, rotation, eye, lens, width, height):
    """Return the depth [m] at which the camera sees a splash there; negative if it does not."""
    x, y, z = x - eye[0], y - eye[1], z - eye[2]
    deep = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
    if not deep > NEAREST:
        return -1.0
    for axis in range(2):
        across = rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2] * z
        focal, centre = np.float64(lens[axis]), np.float64(lens[2 + axis])
        count = width if axis == 0 else height
        if focal * across + centre * deep <= -focal * _MARGIN:
            return -1.0
        if focal * across + (centre - count) * deep >= focal * _MARGIN:
            return -1.0
    return deep


@cuda.jit(device=True)
def splashes_still(diameter, speed, under, age, pixel):
    """Tell whether an impact on water of a depth [m] splashes, and still shows; far ones briefly.

    `pixel` is the width [m] of a pixel there.
    """
    if not splashes_on(under, diameter, speed):
        return False
    return pixel < FINE_PIXEL or (under > _WET and age < crown_life(diameter, speed))


@cuda.jit(device=True)
def list_splash(
    key, x, y, z, vx, vy, speed, diameter, under, age, pixel, exposure, count_out, lines_out
):  # fmt: skip
    """List what one impact throws up, a piece a lane; twin of `splashview.throw_up`."""
    size = relative_size(under / diameter)
    if pixel < FINE_PIXEL and diameter * _LARGEST_SHARE > least_seen(pixel, exposure):
        most = int(droplets_of(diameter, speed))
        for drop in range(cuda.threadIdx.x, most, GROUP):
            alive, px, py, pz, x_speed, y_speed, z_speed, wide, _ = droplet(
                key, drop, most, x, y, z, vx, vy, diameter * size, age, exposure
            )
            if alive:
                row = next_row(count_out)
                if row < lines_out.shape[0]:
                    lines_out[row, 0], lines_out[row, 1], lines_out[row, 2] = px, py, pz
                    lines_out[row, 3], lines_out[row, 4] = x_speed, y_speed
                    lines_out[row, 5], lines_out[row, 6] = z_speed, wide
    if under > _WET:
        life, growth, tall, jet = crown_shape(diameter, speed, under, size, pixel)
        if age < life:
            raise_crown(
                x, y, z, 0.1 * vx, 0.1 * vy, diameter, age, life, growth, tall, pixel, key,
                exposure, count_out, lines_out,
            )  # fmt: skip
        if jet and age < LONGEST_JET:
            raise_jet(x, y, z, diameter, age, pixel, exposure, count_out, lines_out)


@cuda_kernel
def throw_up(
    found, values, labels, ids, per_list, velocity, times, rotation, eye, lens, width, height,
    water_depth, film, least, count_out, lines_out,
):  # fmt: skip
    """List the droplets, crowns and jets of listed impacts that splash in view.

    Parameters
    ----------
    found, values, labels, ids
        As `drops.fill_impacts` left them.
    per_list : int
        Blocks of threads for each list.
    velocity : device array of shape (CLASSES, 3), float64 [m/s]
    times : device array of shape (2,), float64 [s]
        When the shutter opens, and for how long.
    rotation, eye, lens : device arrays
        As `streaks.look` has them.
    width, height : int [px]
    water_depth : device array of shape (ny, nx), float32 [m]
    film : device array of shape (1,), float64 [m]
        Water on all else, and at least that on the ground.
    least : device array of shape (1,), int32
        The smallest class of drops that may splash.
    count_out : device array of shape (1,), int32
        Raised by the number of lines, also of those for which there is no room.
    lines_out : device array of shape (room, 7), float64
        Place [m], way over the exposure [m/s] and diameter [m].
    """
    chosen = cuda.shared.array(THREADS, np.int32)
    depths = cuda.shared.array((THREADS, 2), np.float64)  # of the scene and of the water there
    many = cuda.shared.array(1, np.int32)
    time, exposure = times[0], times[1]
    sharp = max(np.float64(lens[0]), np.float64(lens[1]))
    group = cuda.threadIdx.y
    thread = group * GROUP + cuda.threadIdx.x
    which, block = cuda.blockIdx.x // per_list, cuda.blockIdx.x % per_list
    listed = min(found[which], ids.shape[1])
    for begin in range(block * THREADS, listed, per_list * THREADS):
        if thread == 0:
            many[0] = 0
        cuda.syncthreads()
        n, deep, under, wanted = begin + thread, -1.0, film[0], False
        if n < listed:
            b, age = labels[which, n, 0], time - values[which, n, 4]
            if b >= least[0] and -exposure <= age < LONGEST_LIFE:
                deep = seen_at(
                    values[which, n, 0], values[which, n, 1], values[which, n, 2],
                    rotation, eye, lens, width, height,
                )  # fmt: skip
            if deep > 0.0:
                if labels[which, n, 1] == GROUND:
                    under += np.float64(water_depth[labels[which, n, 2], labels[which, n, 3]])
                wanted = splashes_still(
                    values[which, n, 3], abs(velocity[b, 2]), under, age, deep / sharp
                )
        at = take_place(many, 0, wanted)
        if wanted:
            chosen[at], depths[at, 0], depths[at, 1] = n, deep, under
        cuda.syncthreads()
        for at in range(group, many[0], THREADS // GROUP):
            n, b = chosen[at], labels[which, chosen[at], 0]
            list_splash(
                ids[which, n], values[which, n, 0], values[which, n, 1], values[which, n, 2],
                velocity[b, 0], velocity[b, 1], abs(velocity[b, 2]), values[which, n, 3],
                depths[at, 1], time - values[which, n, 4], depths[at, 0] / sharp, exposure,
                count_out, lines_out,
            )  # fmt: skip
        cuda.syncthreads()


@cuda_kernel
def draw_list(
    count, lines, times, rotation, eye, rotation_end, eye_end, lens, near, width, height,
    depth, tile_depth, picture,
):  # fmt: skip
    """Draw listed lines, a group of lanes for each.

    Parameters
    ----------
    count, lines
        As `throw_up` left them.
    picture : device array of shape (width * height,), int64
        Added to. The other arrays are those of `streaks.look` and `streaks.draw_field`.
    """
    here, there = cuda.local.array(3, np.float32), cuda.local.array(3, np.float32)
    first = cuda.blockIdx.x * cuda.blockDim.y + cuda.threadIdx.y
    draw_lines(
        lines, first, min(count[0], lines.shape[0]), cuda.gridDim.x * cuda.blockDim.y, times[1],
        rotation, eye, rotation_end, eye_end, lens, near, width, height, depth, tile_depth, here,
        there, picture,
    )  # fmt: skip


class Splashes:
    """The splashes of a rain in a picture, drawn on a CUDA device.

    Parameters
    ----------
    streaks : cuda.streaks.Streaks
        Of the same picture; its depth, camera and times are used, so it is updated and launched
        before.
    recent : cuda.recent.RecentImpacts
        What falls until the exposure's end.
    water_depth : device array of shape (ny, nx), float32 [m]
        Read by `launch`.
    room : int
        Lines that there is room for.

    Attributes
    ----------
    alpha : device array of shape (height, width), float32
        Share of light that splashes replace.
    count : device array of shape (1,), int32
        Lines, also those for which there was no room.
    """

    def __init__(self, streaks, recent, water_depth, room=ROOM):
        self._streaks, self._recent, self.depth = streaks, recent, water_depth
        self.stream = stream = streaks.stream
        self.now = Numbers(stream, {
            "film": ((1,), np.float64), "least": ((1,), np.int32), "count": ((1,), np.int32),
        })  # fmt: skip
        self.count = self.now["count"]  # blanked by each `send`
        self.make_room(room)
        self.alpha = cuda.device_array(streaks.alpha.shape, np.float32, stream=stream)

    def make_room(self, room):
        """Make room for so many lines."""
        self.lines = cuda.device_array((room, 7), np.float64, stream=self.stream)

    def update(self, field, film):
        """Say what the next picture shows; arguments as `splash.draw_splashes` has them."""
        smallest = SMALLEST_ON_FILM if film > _WET else SMALLEST_SPLASH
        least = np.searchsorted(field.spectrum.edges[1:], smallest, side="right")
        self.now.update(film=film, least=least)

    def launch(self):
        """Queue the picture, after the streaks'."""
        self.gather()
        self.draw()

    def gather(self, stream=None):
        """Queue the listing of what is seen, on another stream than its own if given."""
        stream = self.stream if stream is None else stream
        self.now.send(stream)
        recent, seen = self._recent, self._streaks.now
        width, height = self._streaks.size
        per_list = 2 if SIMULATED else -(-recent.room // THREADS)
        throw_up[per_list * len(recent.found), GROUPS, stream](
            recent.found, recent.values, recent.labels, recent.ids, per_list,
            seen["velocity"], seen["times"], seen["rotation"], seen["eye"], seen["lens"],
            width, height, self.depth, self.now["film"], self.now["least"], self.count, self.lines,
        )  # fmt: skip
        if (drips := self._streaks.drips) is not None:
            drips.gather(
                *recent.ground_and_top, seen["times"], seen["rotation"], seen["eye"], seen["lens"],
                width, height, self.depth, self.now["film"], self.count, self.lines, stream=stream,
            )  # fmt: skip

    def draw(self, stream=None):
        """Queue the drawing of what was gathered, after the streaks' picture."""
        stream = self.stream if stream is None else stream
        draw_list[BLOCKS, GROUPS, stream](self.count, self.lines, *self._streaks.seen())
        self._streaks.resolve(self.alpha, False, stream)

    def missing(self):
        """Return how many lines there was no room for; waits for them."""
        lines = int(self.count.copy_to_host(stream=self.stream)[0]) - len(self.lines)
        return max(lines, 0)
