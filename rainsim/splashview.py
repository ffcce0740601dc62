"""Splashes as a camera sees them: crowns, jets and droplets of what fell in view, drawn.

Impacts are sought, tested and drawn in one pass: nothing of it is listed as a whole.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.crowns import (
    FINE_PIXEL,
    JET_FROM,
    LONGEST_JET,
    crown_life,
    crown_lines,
    crown_shape,
    next_row,
    raise_crown,
    raise_jet,
)
from rainsim.cubes import (
    cube_key,
    drop_diameter,
    drop_id,
    drops_in_cube,
    slab_tasks,
    swept_cubes,
)
from rainsim.drops import GROUND, cubes_swept, joined, landing, may_land
from rainsim.drops import impacts as list_impacts
from rainsim.jit import cpu_kernel, lean_function, prange
from rainsim.marks import read_depth, resolve_band
from rainsim.spectrum import terminal_speed
from rainsim.splash import (
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
    splash_droplets,
    splashes,
    splashes_on,
)
from rainsim.streaks import NEAR, NO_LINES, _check, _scratch, _to_camera, _views, draw_lines

_NEAREST = np.float32(0.05)  # m; what falls nearer to the camera is not drawn
_LINES, _MOST_LINES = 1024, 400  # that a worker lists before it draws, and of one splash at most


def draw_splashes(
    field, surfaces, camera, time, exposure, water_depth, film, depth, alpha_out, camera_end=None,
    aperture=0.0, focus=math.inf, more=None,
):  # fmt: skip
    """Draw all that an exposure sees of splashes: crowns, jets and droplets.

    Parameters
    ----------
    field : RainField
    surfaces : Surfaces
        What the drops fall on: ground, puddles, tables and roofs.
    camera : Camera
        Perspective, in the ground frame, in metres.
    time, exposure : float [s]
        The shutter is open from `time` to `time + exposure`.
    water_depth : ndarray of shape (ny, nx) [m]
        Water on the ground of the map, now.
    film : float [m]
        Water on all else, and at least that on the ground: WET_FILM in the rain, 0 at its start.
    depth : ndarray of shape (height, width), float32 [m]
        Depth along the view axis of what the splashes are before or behind; inf for sky.
    alpha_out : ndarray of shape (height, width), float32
        Overwritten with the share of light that splashes replace.
    camera_end : Camera or None
        The camera when the shutter closes, if it moves.
    aperture, focus : float [m]
        As in `draw_streaks`.
    more : Impacts or None
        Of drops that are not the field's: drips.
    """
    _check(camera, exposure, depth, alpha_out)
    nearest = max(float(depth.min()), NEAR)
    starts, stops, regions = _windows(field, camera, time, exposure, water_depth, film, nearest)
    boxes, tasks = [], []
    for n in range(2):
        box = swept_cubes(field, surfaces, starts[n], stops[n], regions[n])[:2]
        own = slab_tasks(*box)
        own = own[(starts[n] < stops[n])[own[:, 0]]]
        tasks.append(np.column_stack([np.full(len(own), n), own]))
        boxes.append(box)
    lines = NO_LINES
    if more is not None and len(more):
        lines = _Wet(more, camera, water_depth, film).lines(time, exposure)
    _draw_splashes(
        np.concatenate(tasks), np.stack([b[0] for b in boxes]), np.stack([b[1] for b in boxes]),
        starts, stops, *field.arrays(), surfaces.around_low, surfaces.around_high,
        *surfaces.arrays(), np.asarray(water_depth, np.float32), float(film), float(time),
        float(exposure),
        *_views(camera, camera if camera_end is None else camera_end, aperture, focus),
        np.float32(NEAR), lines, depth, *_scratch(depth.shape), alpha_out,
    )  # fmt: skip


def seen_splashes(field, surfaces, camera, time, exposure, water_depth, film, more=None):
    """Return the impacts whose splash the camera may see; arguments as in `draw_splashes`."""
    smallest = SMALLEST_ON_FILM if film > _WET else SMALLEST_SPLASH
    found = list_impacts(
        field, surfaces, time - LONGEST_LIFE, time + exposure, smallest,
        footprint(camera, _FARTHEST),
    )  # fmt: skip
    parts = [_Wet(found, camera, water_depth, film).still_there(time, exposure)]
    if more is not None:
        parts.append(_Wet(more, camera, water_depth, film).still_there(time, exposure))
    return joined(*parts)


def _windows(field, camera, time, exposure, water_depth, film, nearest):
    """Return when and where what fell may show: starts and stops [s] per class, and regions.

    As two lists: the first has all whose crowns may still stand, the second those before near the
    camera, whose droplets and jets may be in the air. Stops are not after starts of classes whose
    drops are too small.
    """
    smallest = SMALLEST_ON_FILM if film > _WET else SMALLEST_SPLASH
    focal = max(camera.fx, camera.fy)
    least = max(smallest, least_seen(nearest / focal, exposure) / _LARGEST_SHARE)
    if water_depth.max() > JET_FROM * smallest:
        least = smallest
    largest = field.spectrum.edges[1:]  # of each class
    lately = time - crown_life(largest, terminal_speed(largest))
    starts = np.stack([lately, np.where(largest > least, time - LONGEST_LIFE, lately)])
    stops = np.stack([np.where(largest > smallest, time + exposure, lately), lately])
    return starts, stops, (footprint(camera, _FARTHEST), footprint(camera, FINE_PIXEL * focal))


@cpu_kernel
def _draw_splashes(
    tasks, first, last, starts, stops, velocity, cube, class_key, count, size, share, frame,
    low, high, x0, y0, spacing, sky, ground, underside, top, block_high,
    water_depth, film, time, exposure, rotation, eye, rotation_end, eye_end, lens, planes, near,
    more, depth_map, depth, tile_depth, picture, alpha_out,
):  # fmt: skip
    """List the drops that splash in view, slab by slab of cubes, and draw what they throw up.

    A task is a list, a class and a slab. Each worker draws its lines whenever it has enough.
    """
    workers, changes = picture.shape[0], share.shape[1] > 1
    height, width = alpha_out.shape
    for band in prange(tile_depth.shape[1]):
        read_depth(band, depth_map, depth, tile_depth)
    for worker in prange(workers):
        mine = picture[worker]
        here, there = np.empty(3, np.float32), np.empty(3, np.float32)
        lines, listed = np.empty((_LINES, 7)), np.zeros(1, np.int64)
        draw_lines(
            more, worker, len(more), workers, exposure, rotation, eye, rotation_end, eye_end, lens,
            near, width, height, depth, tile_depth, here, there, mine,
        )  # fmt: skip
        for t in range(worker, tasks.shape[0], workers):
            m, b, i = tasks[t]
            start, stop = starts[m, b], stops[m, b]
            side = cube[b]
            vx, vy, vz = velocity[b, 0], velocity[b, 1], velocity[b, 2]
            for j in range(first[m, b, 1], last[m, b, 1] + 1):
                k_first, k_last, lowest, highest = cubes_swept(
                    b, i, j, start, stop, velocity, cube, frame, low, high, x0, y0, spacing
                )
                if k_first > k_last:
                    continue
                middle = 0.5 * (start + stop)
                _to_camera(
                    rotation, eye, (i + 0.5) * side + frame[b, 0] + vx * middle,
                    (j + 0.5) * side + frame[b, 1] + vy * middle,
                    0.5 * (lowest + highest) + vz * middle, here,
                )  # fmt: skip
                wide = side + max(abs(vx), abs(vy)) * (stop - start)
                tall = highest - lowest + vz * (stop - start)
                radius = np.float32(0.5 * np.sqrt(2 * wide * wide + tall * tall) + _MARGIN)
                if not _ball_in_view(here, radius, planes):
                    continue
                for k in range(k_first, k_last + 1):
                    key = cube_key(class_key[b], i, j, k)
                    for n in range(drops_in_cube(key, b, count)):
                        word = drop_id(key, n)
                        if not may_land(
                            word, b, i, j, k, start, stop, lowest, highest, changes, velocity,
                            cube, share, frame, low, high, x0, y0, spacing, ground, underside, top,
                        ):  # fmt: skip
                            continue
                        fell, kind, row, column, x, y, z = landing(
                            word, b, i, j, k, start, stop, velocity, cube, frame, x0, y0, spacing,
                            sky, ground, underside, top, block_high,
                        )  # fmt: skip
                        if not start <= fell < stop:
                            continue
                        _to_camera(rotation, eye, x, y, z, here)
                        if not _ball_in_view(here, np.float32(_MARGIN), planes):
                            continue
                        under = film
                        if kind == GROUND:
                            under += water_depth[row, column]
                        throw_up(
                            word, x, y, z, vx, vy, vz, drop_diameter(word, b, size), under,
                            time - fell, here[2] / max(lens[0], lens[1]), exposure, listed, lines,
                        )  # fmt: skip
                        if listed[0] > _LINES - _MOST_LINES:
                            draw_lines(
                                lines, 0, listed[0], 1, exposure, rotation, eye, rotation_end,
                                eye_end, lens, near, width, height, depth, tile_depth, here, there,
                                mine,
                            )  # fmt: skip
                            listed[0] = 0
        draw_lines(
            lines, 0, listed[0], 1, exposure, rotation, eye, rotation_end, eye_end, lens, near,
            width, height, depth, tile_depth, here, there, mine,
        )  # fmt: skip
    for band in prange(tile_depth.shape[1]):
        resolve_band(band, picture, alpha_out)


@lean_function
def throw_up(key, x, y, z, vx, vy, vz, diameter, under, age, pixel, exposure, count, out):
    """Add the lines of one impact on water of depth `under` [m]: droplets, crown and jet."""
    speed = abs(vz)
    if not splashes_on(under, diameter, speed):
        return
    size = relative_size(under / diameter)
    clear = pixel < FINE_PIXEL and diameter * _LARGEST_SHARE > least_seen(pixel, exposure)
    if clear and -exposure <= age < LONGEST_LIFE:
        most = int(droplets_of(diameter, speed))
        for n in range(most):
            alive, px, py, pz, x_speed, y_speed, z_speed, wide, _ = droplet(
                key, n, most, x, y, z, vx, vy, diameter * size, age, exposure
            )
            row = next_row(count) if alive else len(out)
            if row < len(out):
                out[row, 0], out[row, 1], out[row, 2] = px, py, pz
                out[row, 3], out[row, 4], out[row, 5] = x_speed, y_speed, z_speed
                out[row, 6] = wide
    if not under > _WET:
        return
    life, growth, tall, jet = crown_shape(diameter, speed, under, size, pixel)
    if age < life:
        raise_crown(
            x, y, z, 0.1 * vx, 0.1 * vy, diameter, age, life, growth, tall, pixel, key, exposure,
            count, out,
        )  # fmt: skip
    if jet and age < LONGEST_JET:
        raise_jet(x, y, z, diameter, age, pixel, exposure, count, out)


@lean_function
def _ball_in_view(place, radius, planes):
    """Tell whether a ball at a place of the camera frame may be in the picture."""
    if place[2] + radius < _NEAREST:
        return False
    for a in range(4):
        aside = planes[a, 0] * place[0] + planes[a, 1] * place[1] + planes[a, 2] * place[2]
        if aside < -radius:
            return False
    return True


class _Wet:
    """Impacts that splash in the picture, with the water there and a pixel's width."""

    def __init__(self, found, camera, water_depth, film):
        found, pixel = _in_view(found, camera)
        under = np.where(found.kind == GROUND, water_depth[found.row, found.column], 0.0) + film
        splash = splashes(found, under)
        self.found, self.pixel, self.under = found.take(splash), pixel[splash], under[splash]

    def still_there(self, time, exposure):
        """Return the impacts of which something may show: a crown, or droplets large enough."""
        age = time - self.found.time
        stands = age < crown_life(self.found.diameter, np.abs(self.found.velocity[:, 2]))
        return self.found.take(stands | self._clear(exposure))

    def _clear(self, exposure):
        clear = self.found.diameter * _LARGEST_SHARE > least_seen(self.pixel, exposure)
        return clear & (self.pixel < FINE_PIXEL)

    def lines(self, time, exposure):
        """Return droplets, crowns and jets, as `streaks.draw_lines` takes them."""
        clear, wet = self._clear(exposure), self.under > _WET
        found, under = self.found.take(wet), self.under[wet]
        size = relative_size(under / found.diameter)
        parts = (
            splash_droplets(self.found.take(clear), self.under[clear], time, exposure),
            crown_lines(found, under, size, time, exposure, self.pixel[wet]),
        )
        return np.concatenate(
            [np.column_stack([p.position, p.velocity, p.diameter]) for p in parts]
        )


def _in_view(found, camera):
    """Return the impacts that the camera may see splash, and the size of a pixel there [m]."""
    local = found.position @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    z = local[:, 2]
    seen = z > 0.05
    for axis, focal, centre, count in (
        (0, camera.fx, camera.cx, camera.width),
        (1, camera.fy, camera.cy, camera.height),
    ):
        reach = focal * _MARGIN
        at = focal * local[:, axis]
        seen &= (at + centre * z > -reach) & (at + (centre - count) * z < reach)
    return found.take(seen), z[seen] / max(camera.fx, camera.fy)
