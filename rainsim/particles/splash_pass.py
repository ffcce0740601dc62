"""Splashes as a camera sees them: crowns, jets and droplets of the impacts in view, drawn.

Impacts of the rain are sought, tested and drawn in one pass; drips that have landed join them. The
same pass can list the impacts that show, for labels: nothing else lists splashes as a whole.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim import jit
from rainsim.jit import prange
from rainsim.particles import line_raster, splash
from rainsim.particles.crown import (
    FINE_PIXEL,
    JET_FROM,
    LONGEST_JET,
    crown_life,
    crown_shape,
    next_row,
    raise_crown,
    raise_jet,
)
from rainsim.particles.shutter_view import (
    beside_planes,
    footprint,
    require_pictures,
    shutter_view,
    to_camera,
)
from rainsim.particles.streaks import draw_lines, drawing_buffers
from rainsim.rain import poisson_cells
from rainsim.rain.heightfield import GROUND
from rainsim.rain.impacts import cubes_swept, landing, may_land, no_impacts
from rainsim.rain.size_distribution import CLASSES, terminal_speed
from rainsim.scene.view import finest

FARTHEST = 100.0  # m; beyond it no splash is drawn
MARGIN = 0.1  # m by which splashes reach into the picture from outside
_NEAREST = np.float32(0.05)  # m; what falls nearer to the camera is not drawn
_REACH = np.float32(MARGIN)
_ROOM = 1024  # lines that a worker lists before it draws
_MOST_LINES = 400  # of one splash
BOXES = 2 * CLASSES  # of cubes, see `Windows`
LISTED = 4096  # splashes of a worker, at first: with too little room all are drawn again


class WaterDepth(NamedTuple):
    """The water that drops fall on.

    ground : float32 array (ny, nx) [m]. On the ground of the map.
    film : float [m]. On all else, and at least that on the ground.
    """

    ground: np.ndarray
    film: float


class Windows(NamedTuple):
    """Where and when drops may have fallen whose splash shows, as BOXES of cubes, two a class.

    Those of class b have the numbers b and CLASSES + b.

    starts, stops : float64 array (BOXES,) [s]. A box whose stop is not after its
        start has no such drops.
    first, last : int64 array (BOXES, 3). First and last cubes.
    """

    starts: np.ndarray
    stops: np.ndarray
    first: np.ndarray
    last: np.ndarray


def draw_splashes(
    field, surfaces, camera, time, exposure, water_depth, film, depth, alpha_out, camera_end=None,
    aperture=0.0, focus=math.inf, strength=1.0, more=None,
):  # fmt: skip
    """Draw all that an exposure sees of splashes: crowns, jets and droplets.

    surfaces : Surfaces. What the drops fall on: ground, puddles, tables and
        roofs.
    water_depth : array (ny, nx) [m]. Water on the ground of the map, now.
    film : float [m]. Water on all else, and at least that on the ground: WET_FILM
        in the rain, 0 at its start.
    alpha_out : float32 array (height, width). Overwritten with the share of light
        that splashes replace.
    camera_end : Camera or None. The camera when the shutter closes, if it moves.
    aperture, focus : float [m]. As in `draw_streaks`, and strength : float.
    more : Impacts or None. Of drops that are not the field's: drips.
    """
    view = shutter_view(camera, time, exposure, camera_end, aperture, focus, strength)
    water = WaterDepth(np.asarray(water_depth, np.float32), float(film))
    _run_pass(field, surfaces, camera, view, water, depth, alpha_out, more, 0)


def seen_splashes(field, surfaces, camera, time, exposure, water_depth, film, depth, more=None):
    """Return the place (n, 3) [m] and the id of each impact whose splash is drawn, or hidden."""
    view = shutter_view(camera, time, exposure)
    water = WaterDepth(np.asarray(water_depth, np.float32), float(film))
    alpha, room = np.empty_like(depth), LISTED
    while True:
        found, position, ids = _run_pass(
            field, surfaces, camera, view, water, depth, alpha, more, room
        )
        if found.max() <= room:
            break
        room = int(found.sum())  # another pass may share them out differently
    listed = np.arange(room) < found[:, None]
    position, ids = position[listed], ids[listed]
    order = np.argsort(ids)
    return position[order], ids[order]


def _run_pass(field, surfaces, camera, view, water, depth, alpha_out, more, room):
    """Draw, or with `room` return each worker's list of splashes: number, places and ids."""
    require_pictures(camera, depth, alpha_out)
    least = smallest = smallest_drop(water.film)
    if not water.ground.max() > JET_FROM * smallest:
        nearest = max(float(depth.min()), line_raster.NEAR) / finest(camera)
        seen = splash.least_seen(nearest, view.exposure) / splash.LARGEST_SHARE
        least = max(smallest, seen)
    times = view.time, view.exposure
    windows = recent_windows(field, surfaces, camera, *times, smallest, least)
    tasks = poisson_cells.slab_tasks(windows.first, windows.last)
    tasks = tasks[(windows.starts < windows.stops)[tasks[:, 0]]]
    columns, tiles, pictures = drawing_buffers(depth.shape)
    workers = len(pictures)
    found = np.zeros(workers, np.int64)
    position, ids = np.empty((workers, room, 3)), np.empty((workers, room), np.uint64)
    drips = no_impacts() if more is None else more
    _draw_splashes(
        tasks, windows, field.arrays(), surfaces.height_fields(), water, drips.arrays(), view,
        depth, columns, tiles, pictures, alpha_out, found, position, ids,
    )  # fmt: skip
    return found, position, ids


def smallest_drop(film):
    """Return the diameter [m] of the smallest drop that splashes where all is that wet [m]."""
    return splash.SMALLEST_ON_FILM if film > splash.WET_DEPTH else splash.SMALLEST_SPLASH


def recent_windows(field, surfaces, camera, time, exposure, smallest, least):
    """Return the `Windows` of impacts that may show in an exposure.

    The first box of a class has all whose crowns may still stand, the second those before near the
    camera, whose droplets and jets may be in the air: of drops over `smallest` and `least` [m].
    """
    largest = field.spectrum.edges[1:]  # of each class
    speeds = terminal_speed(largest)
    lately = time - crown_life(largest, speeds)
    before = np.where(largest > least, time - splash.longest_flight(speeds), lately)
    stops = np.where(largest > smallest, time + exposure, lately)
    windows = []
    for start, stop, reach in (
        (lately, stops, FARTHEST), (before, lately, FINE_PIXEL * finest(camera)),
    ):  # fmt: skip
        region = footprint(camera, reach, MARGIN)
        first, last, _, _ = poisson_cells.swept_cubes(field, surfaces, start, stop, region)
        windows.append(Windows(start, stop, first, last))
    return Windows(*(np.concatenate(parts) for parts in zip(*windows, strict=True)))


@jit.cpu_kernel
def _draw_splashes(
    tasks, windows, field, surfaces, water, drips, view, depth, columns_out, tiles_out, pictures,
    alpha_out, seen_out, position_out, ids_out,
):  # fmt: skip
    """List the drops that splash in view, slab by slab of cubes, and draw their splashes.

    Each worker draws its lines whenever it has enough of them, none if there is room for a list.
    """
    workers = pictures.shape[0]
    height, width = alpha_out.shape
    for band in prange(tiles_out.shape[1]):
        line_raster.read_depth(np.int64(band), depth, columns_out, tiles_out)
    taken = jit.none_taken()
    for worker in prange(workers):
        scene, picture = (
            line_raster.SceneDepth(width, height, columns_out, tiles_out),
            pictures[worker],
        )
        picture[:] = 0
        lines, listed = np.empty((_ROOM, 7)), np.zeros(1, np.int64)
        own_seen, own_position, own_ids = seen_out[worker:], position_out[worker], ids_out[worker]
        for n in range(worker, len(drips.id), workers):
            under = water.film
            if drips.kind[n] == GROUND:
                under += water.ground[drips.row[n], drips.column[n]]
            impact = splash.Impact(
                drips.id[n], drips.position[n, 0], drips.position[n, 1], drips.position[n, 2],
                drips.velocity[n, 0], drips.velocity[n, 1], abs(drips.velocity[n, 2]),
                drips.diameter[n], under, view.time - drips.time[n],
            )  # fmt: skip
            _draw_splash(
                impact, view, scene, listed, lines, own_seen, own_position, own_ids, picture
            )
        t = jit.take_next(taken)
        while t < tasks.shape[0]:
            _draw_slab(
                tasks[t], windows, field, surfaces, water, view, scene, listed, lines, own_seen,
                own_position, own_ids, picture,
            )  # fmt: skip
            t = jit.take_next(taken)
        draw_lines(lines, 0, listed[0], 1, view, scene, picture)
    for band in prange(tiles_out.shape[1]):
        line_raster.resolve_band(np.int64(band), pictures, alpha_out)


@jit.inlined_function
def _draw_slab(
    task, windows, field, surfaces, water, view, scene, listed, lines, seen_out, position_out,
    ids_out, picture,
):  # fmt: skip
    """Draw the splashes of the drops of one slab of cubes."""
    box, i = task[0], task[1]
    b, start, stop = box % CLASSES, windows.starts[box], windows.stops[box]
    vx, vy, speed = field.velocity[b, 0], field.velocity[b, 1], abs(field.velocity[b, 2])
    for j in range(windows.first[box, 1], windows.last[box, 1] + 1):
        k_first, k_last, lowest, highest = cubes_swept(b, i, j, start, stop, field, surfaces)
        if k_first > k_last:
            continue
        if not column_in_view(b, i, j, start, stop, lowest, highest, field, view):
            continue
        for k in range(k_first, k_last + 1):
            cube = poisson_cells.Cube(b, i, j, k)
            key = poisson_cells.cube_key(cube, field)
            for n in range(poisson_cells.drops_in_cube(key, b, field)):
                word = poisson_cells.drop_id(key, n)
                if not may_land(word, cube, start, stop, lowest, highest, field, surfaces):
                    continue
                fell, kind, row, column, x, y, z = landing(word, cube, start, stop, field, surfaces)
                if not start <= fell < stop:
                    continue
                under = water.film
                if kind == GROUND:
                    under += water.ground[row, column]
                diameter = poisson_cells.drop_diameter(word, b, field)
                impact = splash.Impact(
                    word, x, y, z, vx, vy, speed, diameter, under, view.time - fell
                )
                _draw_splash(
                    impact, view, scene, listed, lines, seen_out, position_out, ids_out, picture
                )


@jit.inlined_function
def column_in_view(size_class, i, j, start, stop, lowest, highest, field, view):
    """Tell whether splashes of a column of cubes may show; see `impacts.cubes_swept`."""
    side, middle, duration = field.cube[size_class], 0.5 * (start + stop), stop - start
    vx, vy, vz = (
        field.velocity[size_class, 0], field.velocity[size_class, 1], field.velocity[size_class, 2]
    )  # fmt: skip
    place = to_camera(
        view.rotation, view.eye, (i + 0.5) * side + field.frame[size_class, 0] + vx * middle,
        (j + 0.5) * side + field.frame[size_class, 1] + vy * middle,
        0.5 * (lowest + highest) + vz * middle,
    )  # fmt: skip
    wide = side + max(abs(vx), abs(vy)) * duration
    tall = highest - lowest + vz * duration
    radius = np.float32(0.5 * np.sqrt(2 * wide * wide + tall * tall) + MARGIN)
    return _ball_in_view(place, radius, view.planes)


@jit.lean_function
def seen_at(x, y, z, view, scene):
    """Tell whether a splash at a place may be in view, and how wide [m] a pixel is there."""
    place = to_camera(view.rotation, view.eye, x, y, z)
    pixel = place[2] / max(view.lens[line_raster.FX], view.lens[line_raster.FY])
    seen = _ball_in_view(place, _REACH, view.planes)
    return seen and not stands_on_nothing(*place, view.lens, scene), pixel


@jit.called_function
def _draw_splash(impact, view, scene, listed, lines, seen_out, position_out, ids_out, picture):
    """List the lines of one impact, if they may show, and draw the list before it is full.

    `position_out` and `ids_out` take the impacts that have lines; `seen_out[0]` counts them, also
    those for which there is no room.
    """
    seen, pixel = seen_at(impact.x, impact.y, impact.z, view, scene)
    if not seen:
        return
    before = listed[0]
    list_splash(impact, pixel, view.exposure, listed, lines)
    if listed[0] == before:
        return
    if seen_out[0] < len(ids_out):
        position_out[seen_out[0], 0], position_out[seen_out[0], 1] = impact.x, impact.y
        position_out[seen_out[0], 2] = impact.z
        ids_out[seen_out[0]] = impact.key
    seen_out[0] += 1
    if len(ids_out) > 0:
        listed[0] = 0
    if listed[0] > _ROOM - _MOST_LINES:
        draw_lines(lines, 0, listed[0], 1, view, scene, picture)
        listed[0] = 0


@jit.inlined_function
def stands_on_nothing(x, y, z, lens, scene):
    """Tell whether the picture shows nothing but sky at a place of the camera frame [m].

    The map goes on where nothing was captured: no drop is seen to land there.
    """
    if not z > _NEAREST:
        return False
    column = math.floor(lens[line_raster.FX] * x / z + lens[line_raster.CX])
    row = math.floor(lens[line_raster.FY] * y / z + lens[line_raster.CY])
    if not (0 <= column < scene.width and 0 <= row < scene.height):
        return False
    return not scene.columns[int(column) * scene.height + int(row)] < math.inf


@jit.lean_function
def list_splash(impact, pixel, exposure, count, lines_out):
    """Add the lines of one impact: droplets, crown and jet.

    count, lines_out. As `crown.raise_crown` has them. Threads that draw a mark
        together share the pieces.
    """
    diameter, speed, age = impact.diameter, impact.speed, impact.age
    if not splash.splashes_on(impact.depth, diameter, speed):
        return
    size = splash.relative_size(impact.depth / diameter)
    fine = pixel < FINE_PIXEL and diameter * splash.LARGEST_SHARE > splash.least_seen(
        pixel, exposure
    )
    if fine and -exposure <= age < splash.longest_flight(speed):
        most = int(splash.droplets_of(diameter, speed))
        for n in range(line_raster.lane(), most, line_raster.lanes()):
            seen, x, y, z, vx, vy, vz, wide, _ = splash.droplet(impact, n, most, size, exposure)
            row = next_row(count) if seen else len(lines_out)
            if row < len(lines_out):
                lines_out[row, 0], lines_out[row, 1], lines_out[row, 2] = x, y, z
                lines_out[row, 3], lines_out[row, 4], lines_out[row, 5] = vx, vy, vz
                lines_out[row, 6] = wide
    if not impact.depth > splash.WET_DEPTH:
        return
    crown = crown_shape(impact, size, pixel)
    if age < crown.life:
        raise_crown(impact, crown, pixel, exposure, count, lines_out)
    if crown.jet and age < LONGEST_JET:
        raise_jet(impact, pixel, exposure, count, lines_out)


@jit.lean_function
def _ball_in_view(place, radius, planes):
    """Tell whether a ball at a place of the camera frame may be in the picture."""
    return place[2] + radius >= _NEAREST and beside_planes(place, radius, planes)
