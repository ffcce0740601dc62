"""Splashes on a CUDA device: twin of `rainsim.splash.draw_splashes`.

A warp takes an impact: it tells whether it splashes in view, and lists the droplets and the pieces
of its crown, a lane for each. Then a warp takes each piece and draws it.
"""

from __future__ import annotations

import numpy as np

from rainsim.crowns import (
    FINE_PIXEL,
    LONGEST_CROWN,
    LONGEST_JET,
    crown_life,
    crown_shape,
    next_row,
    raise_crown,
    raise_jet,
)
from rainsim.cuda.drops import BLOCKS, WARPS, Impacts
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.cuda.numbers import Numbers
from rainsim.cuda.warp import LANES, lane
from rainsim.drops import GROUND
from rainsim.marks import draw_path
from rainsim.spectrum import terminal_speed
from rainsim.splash import (
    _BIG,
    _FARTHEST,
    _LARGEST_SHARE,
    _MARGIN,
    _WET,
    LONGEST_LIFE,
    SMALLEST_ON_FILM,
    SMALLEST_SPLASH,
    droplet,
    droplets_of,
    footprint,
    least_seen,
    relative_size,
    splashes_on,
)
from rainsim.streaks import CLEAR, HIDDEN, NEAR, _may_show, _to_camera

ROOM = 2**18  # lines
NEAREST = 0.05  # m, as the CPU has it
_ONE = np.float32(1)


@cuda.jit(device=True)
def _seen(x, y, z, rotation, eye, lens, width, height):
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


@cuda_kernel
def throw_up(
    found, values, labels, ids, velocity, times, rotation, eye, lens, width, height,
    water_depth, film, crowns, jets, droplets, count_out, lines_out,
):  # fmt: skip
    """List the droplets, crowns and jets of listed impacts that splash in view.

    Parameters
    ----------
    found, values, labels, ids
        As `drops.fill_impacts` left them.
    velocity : device array of shape (CLASSES, 3), float64 [m/s]
    times : device array of shape (2,), float64 [s]
        When the shutter opens, and for how long.
    rotation, eye, lens : device arrays
        As `streaks.draw_field` has them.
    width, height : int [px]
    water_depth : device array of shape (ny, nx), float32 [m]
    film : device array of shape (1,), float64 [m]
        Water on all else, and at least that on the ground.
    crowns, jets, droplets : bool
        What to list of these impacts.
    count_out : device array of shape (1,), int32
        Raised by the number of lines, also of those for which there is no room.
    lines_out : device array of shape (room, 7), float64
        Place [m], way over the exposure [m/s] and diameter [m].
    """
    time, exposure = times[0], times[1]
    listed = min(found[0], ids.shape[0])
    sharp = max(np.float64(lens[0]), np.float64(lens[1]))
    warp = cuda.blockIdx.x * WARPS + cuda.threadIdx.x // LANES
    for n in range(warp, listed, cuda.gridDim.x * WARPS):
        x, y, z, diameter = values[n, 0], values[n, 1], values[n, 2], values[n, 3]
        deep = _seen(x, y, z, rotation, eye, lens, width, height)
        if deep < 0.0:
            continue
        b, under = labels[n, 0], film[0]
        if labels[n, 1] == GROUND:
            under += np.float64(water_depth[labels[n, 2], labels[n, 3]])
        speed, pixel, age = abs(velocity[b, 2]), deep / sharp, time - values[n, 4]
        if not splashes_on(under, diameter, speed):
            continue
        size = relative_size(under / diameter)
        clear = diameter * _LARGEST_SHARE > least_seen(pixel, exposure) and pixel < FINE_PIXEL
        if droplets and clear and -exposure <= age < LONGEST_LIFE:
            most = int(droplets_of(diameter, speed))
            for which in range(lane(), most, LANES):
                alive, px, py, pz, vx, vy, vz, wide, _ = droplet(
                    ids[n], which, most, x, y, z, velocity[b, 0], velocity[b, 1],
                    diameter * size, age, exposure,
                )  # fmt: skip
                if alive:
                    row = next_row(count_out)
                    if row < lines_out.shape[0]:
                        lines_out[row, 0], lines_out[row, 1], lines_out[row, 2] = px, py, pz
                        lines_out[row, 3], lines_out[row, 4], lines_out[row, 5] = vx, vy, vz
                        lines_out[row, 6] = wide
        if not under > _WET:
            continue
        life, growth, tall, jet = crown_shape(diameter, speed, under, size, pixel)
        if crowns and age < life:
            raise_crown(
                x, y, z, 0.1 * velocity[b, 0], 0.1 * velocity[b, 1], diameter, age, life, growth,
                tall, pixel, ids[n], exposure, count_out, lines_out,
            )  # fmt: skip
        if jets and jet and age < LONGEST_JET:
            raise_jet(x, y, z, diameter, age, pixel, exposure, count_out, lines_out)


@cuda_kernel
def draw_list(
    count, lines, times, rotation, eye, rotation_end, eye_end, lens, near, width, height,
    depth, tile_depth, picture,
):  # fmt: skip
    """Draw listed lines, a warp for each.

    Parameters
    ----------
    count, lines
        As `throw_up` left them.
    picture : device array of shape (width * height,), int64
        Added to. The other arrays are those of `streaks.draw_field`.
    """
    here, there = cuda.local.array(3, np.float32), cuda.local.array(3, np.float32)
    exposure = times[1]
    high, wide = np.float32(height), np.float32(width)
    warp = cuda.blockIdx.x * WARPS + cuda.threadIdx.x // LANES
    for n in range(warp, min(count[0], lines.shape[0]), cuda.gridDim.x * WARPS):
        x, y, z = lines[n, 0], lines[n, 1], lines[n, 2]
        _to_camera(rotation, eye, x, y, z, here)
        x, y = x + lines[n, 3] * exposure, y + lines[n, 4] * exposure
        _to_camera(rotation_end, eye_end, x, y, z + lines[n, 5] * exposure, there)
        if not near <= here[2]:
            continue
        shows = _may_show(
            here[0], here[1], here[2], there[0], there[1], there[2], lens, near, wide, high,
            tile_depth,
        )  # fmt: skip
        if shows != HIDDEN:
            draw_path(
                here[0], here[1], here[2], there[0], there[1], there[2], _ONE,
                np.float32(lines[n, 6]), lens, near, width, height, depth, shows == CLEAR, picture,
            )  # fmt: skip


class Splashes:
    """The splashes of a rain in a picture, drawn on a CUDA device.

    Parameters
    ----------
    streaks : cuda.streaks.Streaks
        Of the same picture; its depth, camera and times are used, so it is updated and launched
        before.
    field : RainField
    surfaces : Surfaces
    water_depth : device array of shape (ny, nx), float32 [m]
        Read by `launch`.
    room : int
        Lines that there is room for.

    Attributes
    ----------
    alpha : device array of shape (height, width), float32
        Share of light that splashes replace.
    """

    def __init__(self, streaks, field, surfaces, water_depth, room=ROOM):
        self._streaks, self._depth, stream = streaks, water_depth, streaks.stream
        self.stream = stream
        lately, rate = _lately(), (field.listed.density * field.listed.speed)
        self._lists = []
        for duration, smallest in (
            (lately + 0.1, SMALLEST_SPLASH), (LONGEST_CROWN - lately, _BIG),
            (LONGEST_LIFE - lately, SMALLEST_SPLASH),
        ):  # fmt: skip
            counted = rate[field.spectrum.edges[1:] > smallest].sum() * surfaces.area * duration
            self._lists.append(Impacts(field, surfaces, int(1.5 * counted) + 256, stream))
        self.now = Numbers(stream, {"film": ((1,), np.float64), "count": ((1,), np.int32)})
        self.lines = cuda.device_array((room, 7), np.float64, stream=stream)
        self.alpha = cuda.device_array(streaks.alpha.shape, np.float32, stream=stream)

    def update(self, field, camera, time, exposure, film):
        """Say what the next picture shows; arguments as `splash.draw_splashes` has them."""
        smallest = SMALLEST_ON_FILM if film > _WET else SMALLEST_SPLASH
        focal, lately = max(camera.fx, camera.fy), time - _lately()
        near, all_around = footprint(camera, FINE_PIXEL * focal), footprint(camera, _FARTHEST)
        for impacts, part in zip(self._lists, (
            (lately, time + exposure, smallest, all_around),
            (time - LONGEST_CROWN, lately, _BIG, all_around),
            (time - LONGEST_LIFE, lately, smallest, near),
        ), strict=True):  # fmt: skip
            impacts.update(field, *part)
        self.now.update(film=film)

    def launch(self):
        """Queue the picture, after the streaks'."""
        self.now.send()
        streaks, grid = self._streaks, (BLOCKS, WARPS * LANES, self.stream)
        width, height = streaks.size
        seen = streaks.now
        # What fell just now, the crowns of big drops, and what near drops threw up before.
        for impacts, (crowns, jets, droplets) in zip(
            self._lists, ((True, True, True), (True, False, False), (False, True, True)),
            strict=True,
        ):  # fmt: skip
            impacts.launch()
            throw_up[grid](
                impacts.found, impacts.values, impacts.labels, impacts.ids,
                impacts.now["velocity"], seen["times"], seen["rotation"], seen["eye"],
                seen["lens"], width, height, self._depth, self.now["film"], crowns, jets, droplets,
                self.now["count"], self.lines,
            )  # fmt: skip
        draw_list[grid](
            self.now["count"], self.lines, seen["times"], seen["rotation"], seen["eye"],
            seen["rotation_end"], seen["eye_end"], seen["lens"], np.float32(NEAR), width, height,
            streaks.columns, streaks.tile_depth, streaks.picture,
        )  # fmt: skip
        streaks.resolve(self.alpha, over=False)

    @property
    def counts(self):
        """Device arrays of one number: of lines, and of what each list held and what was sought."""
        of_lists = (a for i in self._lists for a in (i.found, i.now["sought"]))
        return [self.now["count"], *of_lists]

    @property
    def rooms(self):
        """How much each of `counts` has room for."""
        of_lists = (n for i in self._lists for n in (len(i.ids), len(i._words)))
        return [len(self.lines), *of_lists]

    def missing(self):
        """Return how many impacts and lines there was no room for; waits for them."""
        lines = int(self.now["count"].copy_to_host(stream=self.stream)[0]) - len(self.lines)
        return max(lines, 0) + sum(impacts.missing() for impacts in self._lists)


def _lately():
    """Return how long [s] a crown of the drops that count as big stands."""
    return float(crown_life(_BIG, float(terminal_speed(_BIG))))
