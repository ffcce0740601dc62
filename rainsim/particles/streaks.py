"""Rain in a picture: the path of each drop during the exposure, as the share of light it replaces.

Only the alpha of rain is made here; `shading.composite.compose` adds radiance. A drop of diameter
D at depth z covers (pi/4)(f D / z)^2 pixels at any instant, over the cosine of its angle off the
axis, so its alphas over the picture sum to that whatever the exposure is. Drops are combined as a
product of transmittances, summed as optical depths in whole numbers, so that neither their order
nor the number of threads matters.
"""

import math
import threading
from typing import NamedTuple

import numpy as np

from rainsim import jit
from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import prange
from rainsim.numerics.random import uniform_triple
from rainsim.particles.line_raster import (
    APERTURE,
    CX,
    CY,
    DEPTH_TILE,
    FAINTEST,
    FX,
    FY,
    LARGEST_RADIUS,
    NEAR,
    PER_FOCUS,
    Path,
    SceneDepth,
    draw_path,
    read_depth,
    resolve_band,
)
from rainsim.particles.shutter_view import (
    cube_corners,
    cube_in_view,
    cube_radius,
    require_pictures,
    seen_air,
    shutter_view,
    step_from,
    to_camera,
)
from rainsim.rain import poisson_cells
from rainsim.rain.heightfield import first_hit, flat_surfaces
from rainsim.scene.view import finest

HIDDEN, PARTLY, CLEAR = 0, 1, 2  # of a path, by the depths of the tiles that it touches
NO_LINES = np.zeros((0, 7))
_MOST_TILES = 24  # that are looked at; a longer path is drawn pixel by pixel against the depth
_NEAR = np.float32(NEAR)
_OPEN = flat_surfaces(1.0, 1.0, 1.0, origin=(1e9, 1e9))  # nothing to hit, far away


class Line(NamedTuple):
    """A drop on a straight path: place [m] when the shutter opens, velocity [m/s], diameter [m]."""

    x: float
    y: float
    z: float
    vx: float
    vy: float
    vz: float
    diameter: float


def draw_streaks(
    field, surfaces, camera, time, exposure, depth, far, alpha_out, camera_end=None,
    aperture=0.0, focus=math.inf, strength=1.0, more=NO_LINES,
):  # fmt: skip
    """Draw the drops between NEAR and `far` as they move during the exposure.

    surfaces : Surfaces or None. Drops end on them and there are none under cover;
        None for open air.
    time, exposure : float [s]. The shutter is open from `time` to `time +
        exposure`.
    depth : float32 array (height, width) [m]. Depth along the view axis of what
        the drops are in front of or behind; inf for sky.
    far : float or array (CLASSES,) [m]. Depth along the view axis at which drawn
        drops end and fog begins, counted at `time`; of each class if they differ
        (see `streak_reach`). Up to NEAR, none of the field is drawn.
    alpha_out : float32 array (height, width). Overwritten with the share of light
        that drops replace, in [0, 1].
    camera_end : Camera or None. The camera when the shutter closes, if it moves.
    aperture, focus : float [m]. Diameter of the lens's opening, 0 for a pinhole,
        and the depth that is in focus. A drop at depth z is spread over aperture
        f |1/z - 1/focus| pixels, its summed alpha unchanged.
    strength : float. Factor on what each drop covers; 1 is true.
    more : float64 array (n, 7). Drops that are not the field's, such as drips:
        the columns of `Line`.
    Raises ParameterError if the camera is orthographic, or the exposure or `far`
        is not positive.

    The split is a plane across the view axis, for drops and fog alike; beside the axis both count
    the longer way through the air.
    """
    require_pictures(camera, depth, alpha_out)
    view = shutter_view(camera, time, exposure, camera_end, aperture, focus, strength)
    air = seen_air(field, camera, view, far, aperture, focus)
    surfaces = _OPEN if surfaces is None else surfaces
    _draw_field(
        poisson_cells.slab_tasks(air.first, air.last), air, field.arrays(),
        surfaces.height_fields(), view, more, depth, *drawing_buffers(depth.shape), alpha_out,
    )  # fmt: skip


def streak_reach(field, camera, exposure, far):
    """Return the depth [m] of each class, at most `far`, beyond which its drops are better fog.

    There even the largest drop of the class replaces less than FAINTEST in any pixel, so that an
    8-bit picture would not show it; what all of them replace together belongs to the fog.
    """
    focal = finest(camera)
    cover = math.pi / 4 * (focal * field.spectrum.edges[1:]) ** 2  # px m2: over depth squared
    length = focal * np.linalg.norm(field.velocity, axis=1) * exposure  # px m: over depth
    reach = np.minimum(cover / (length * FAINTEST), np.sqrt(cover / FAINTEST))
    return np.clip(reach, NEAR, far)


# ---- kernels


@jit.cpu_kernel
def _draw_field(
    tasks, air, field, surfaces, view, lines, depth, columns_out, tiles_out, pictures, alpha_out
):
    """List the drops in view, slab by slab of cubes, and draw each, and the rows of `lines`.

    Each worker draws in a picture of its own, which it blanks itself, so that it has it in its
    cache; adding whole numbers makes their sum exact.
    """
    workers = pictures.shape[0]
    height, width = alpha_out.shape
    for band in prange(tiles_out.shape[1]):
        read_depth(np.int64(band), depth, columns_out, tiles_out)
    taken = jit.none_taken()
    for worker in prange(workers):
        scene, picture = SceneDepth(width, height, columns_out, tiles_out), pictures[worker]
        picture[:] = 0
        draw_lines(lines, np.int64(worker), len(lines), workers, view, scene, picture)
        t = jit.take_next(taken)
        while t < tasks.shape[0]:
            if air.far[tasks[t, 0]] > _NEAR:
                _draw_slab(tasks[t, 0], tasks[t, 1], air, field, surfaces, view, scene, picture)
            t = jit.take_next(taken)
    for band in prange(tiles_out.shape[1]):
        resolve_band(np.int64(band), pictures, alpha_out)


@jit.inlined_function
def _draw_slab(size_class, i, air, field, surfaces, view, scene, picture):
    """Draw the drops of the cubes of a class whose first number is i."""
    far, side = air.far[size_class], np.float32(field.cube[size_class])
    radius = cube_radius(size_class, field, view, air)
    for j in range(air.first[size_class, 1], air.last[size_class, 1] + 1):
        for k in range(air.first[size_class, 2], air.last[size_class, 2] + 1):
            cube = poisson_cells.Cube(size_class, i, j, k)
            corner, corner_end = cube_corners(cube, field, view)
            if cube_in_view(corner, corner_end, side, radius, far, view):
                _draw_cube(cube, corner, corner_end, far, field, surfaces, view, scene, picture)


@jit.inlined_function
def _draw_cube(cube, corner, corner_end, far, field, surfaces, view, scene, picture):
    """Draw the drops of a cube that may show, each as far as it gets."""
    b = cube.size_class
    vx, vy, vz = field.velocity[b, 0], field.velocity[b, 1], field.velocity[b, 2]
    key = poisson_cells.cube_key(cube, field)
    for n in range(poisson_cells.drops_in_cube(key, b, field)):
        word = poisson_cells.drop_id(key, n)
        x, y, z = drop_offset(word, cube, field)
        p, q, r = step_from(corner, view.axes, x, y, z)
        if not _NEAR <= r < far:
            continue
        p_end, q_end, r_end = step_from(corner_end, view.axes_end, x, y, z)
        path = Path(p, q, r, p_end, q_end, r_end)
        shows = may_show(path, view.lens, scene)
        if shows == HIDDEN:
            continue
        east, north, up = poisson_cells.drop_place(word, cube, field)
        if poisson_cells.thinned_out(word, b, up, field):
            continue
        stop, _, _, _ = first_hit(
            east, north, up, vx, vy, vz, -np.inf, view.time + view.exposure, surfaces
        )
        if stop > view.time:
            share = np.float32(min((stop - view.time) / view.exposure, 1.0))
            diameter = np.float32(poisson_cells.drop_diameter(word, b, field))
            draw_path(path, share, diameter, view.lens, scene, shows == CLEAR, picture)


@jit.inlined_function
def drop_offset(word, cube, field):
    """Return how far (x, y, z) [m] a drop is from its cube's low corner, float32, exactly."""
    side, (ux, uy, uz) = field.cube[cube.size_class], uniform_triple(word)
    return np.float32(ux * side), np.float32(uy * side), np.float32(uz * side)


@jit.called_function
def draw_lines(lines, first, end, step, view, scene, picture):
    """Draw every `step`-th row of `lines`, the columns of `Line`, from `first` on, up to `end`."""
    for d in range(first, end, step):
        line = Line(
            lines[d, 0], lines[d, 1], lines[d, 2], lines[d, 3], lines[d, 4], lines[d, 5],
            lines[d, 6],
        )  # fmt: skip
        draw_line(line, view, scene, picture)


@jit.inlined_function
def draw_line(line, view, scene, picture):
    """Draw one drop, a `Line`, into a picture of optical depths."""
    x, y, z = to_camera(view.rotation, view.eye, line.x, line.y, line.z)
    x_end, y_end, z_end = to_camera(
        view.rotation_end, view.eye_end, line.x + line.vx * view.exposure,
        line.y + line.vy * view.exposure, line.z + line.vz * view.exposure,
    )  # fmt: skip
    if z < _NEAR:
        return
    path = Path(x, y, z, x_end, y_end, z_end)
    shows = may_show(path, view.lens, scene)
    if shows != HIDDEN:
        diameter = np.float32(line.diameter)
        draw_path(path, ONE, diameter, view.lens, scene, shows == CLEAR, picture)


@jit.lean_function
def may_show(path, lens, scene):
    """Tell whether a path's image may be in the picture: HIDDEN, PARTLY or CLEAR."""
    if path.z_end < HALF * _NEAR:
        return HIDDEN
    width, height = np.float32(scene.width), np.float32(scene.height)
    per_z, per_z_end = ONE / path.z, ONE / path.z_end
    u, u_end = lens[FX] * path.x * per_z + lens[CX], lens[FX] * path.x_end * per_z_end + lens[CX]
    v, v_end = lens[FY] * path.y * per_z + lens[CY], lens[FY] * path.y_end * per_z_end + lens[CY]
    nearest = min(path.z, path.z_end)
    margin = lens[LARGEST_RADIUS] * max(per_z, per_z_end) + ONE  # one pixel more for the filter
    if lens[APERTURE] > ZERO:
        blur = max(abs(per_z - lens[PER_FOCUS]), abs(per_z_end - lens[PER_FOCUS]))
        margin += HALF * lens[APERTURE] * blur
    left, right = max(min(u, u_end) - margin, ZERO), min(max(u, u_end) + margin, width - ONE)
    low, high = max(min(v, v_end) - margin, ZERO), min(max(v, v_end) + margin, height - ONE)
    if left > right or low > high:
        return HIDDEN
    west, east = int(left) // DEPTH_TILE, int(right) // DEPTH_TILE
    top, bottom = int(low) // DEPTH_TILE, int(high) // DEPTH_TILE
    if (east - west + 1) * (bottom - top + 1) > _MOST_TILES:
        return PARTLY
    most, least = ZERO, np.float32(np.inf)
    for j in range(top, bottom + 1):
        for i in range(west, east + 1):
            most, least = max(most, scene.tiles[0, j, i]), min(least, scene.tiles[1, j, i])
    if most <= nearest:
        return HIDDEN
    return CLEAR if max(path.z, path.z_end) < least else PARTLY


# ---- memory of the drivers


_kept = threading.local()


def drawing_buffers(shape):
    """Return columns, tiles and a picture for each thread, not blank; kept from call to call."""
    wanted = (jit.set_threads(None), *shape)
    if getattr(_kept, "shape", None) != wanted:
        _kept.depth = np.empty(shape[0] * shape[1], np.float32)
        _kept.tiles = np.empty([2, *(-(-n // DEPTH_TILE) for n in shape)], np.float32)
        _kept.pictures = np.empty((wanted[0], shape[0] * shape[1]), np.int32)
        _kept.shape = wanted
    return _kept.depth, _kept.tiles, _kept.pictures
