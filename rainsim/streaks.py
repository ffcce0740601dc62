"""Rain in a picture: the path of each drop during the exposure, as the share of light it replaces.

Only the rain's alpha is made here; `shade` gives it radiance. A drop of diameter D at depth z
covers (pi/4)(f D / z)^2 pixels at any instant, over the cosine of its angle off the axis, so its
alphas over the picture sum to that whatever the exposure is. Drops are combined as a product of
transmittances, summed as optical depths in whole numbers, so that neither their order nor the
number of threads matters.
"""

from __future__ import annotations

import math
import threading

import numpy as np

from rainsim.cubes import (
    cube_key,
    drop_diameter,
    drop_id,
    drops_in_cube,
    left_out,
    slab_tasks,
)
from rainsim.errors import ParameterError, require_not_negative, require_positive
from rainsim.jit import cpu_kernel, lean_function, prange, set_threads
from rainsim.marks import FAINTEST, draw_path, read_depth, resolve_band
from rainsim.random import uniform_triple
from rainsim.spectrum import CLASSES, LARGEST
from rainsim.surfaces import BLOCK, first_hit, flat_surfaces

FOG_STEPS = 96
NEAR = 0.5  # m; drops nearer to the camera are out of any focus and are not drawn
HIDDEN, PARTLY, CLEAR = 0, 1, 2  # of a path, by the depths of the tiles that it touches
_MOST_TILES = 24  # that are looked at; a longer path is drawn pixel by pixel against the depth
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)

NO_FOG = np.zeros(FOG_STEPS + 3, np.float32)  # the fog table of dry air
NO_FOG[0] = 1.0
NO_LINES = np.zeros((0, 7))
_OPEN = flat_surfaces(1.0, 1.0, 1.0, origin=(1e9, 1e9))  # nothing to hit, far away


def draw_streaks(
    field, surfaces, camera, time, exposure, depth, far, alpha_out, camera_end=None,
    aperture=0.0, focus=math.inf, more=NO_LINES,
):  # fmt: skip
    """Draw the drops between NEAR and `far` as they move during the exposure.

    Parameters
    ----------
    field : RainField
    surfaces : Surfaces or None
        Drops end on them and there are none under cover; None for open air.
    camera : Camera
        Perspective, in the ground frame, in metres.
    time, exposure : float [s]
        The shutter is open from `time` to `time + exposure`.
    depth : ndarray of shape (height, width), float32 [m]
        Depth along the view axis of what the drops are in front of or behind; inf for sky.
    far : float or ndarray of shape (CLASSES,) [m]
        Depth along the view axis at which drawn drops end and fog begins, counted at `time`; of
        each class if they differ (see `streak_reach`).
    alpha_out : ndarray of shape (height, width), float32
        Overwritten with the share of light that drops replace, in [0, 1].
    camera_end : Camera or None
        The camera when the shutter closes, if it moves.
    aperture, focus : float [m]
        Diameter of the lens's opening, 0 for a pinhole, and the depth that is in focus. A drop at
        depth z is spread over aperture f |1/z - 1/focus| pixels, its summed alpha unchanged.
    more : ndarray of shape (n, 7), float64
        Drops that are not the field's, such as drips: see `draw_lines`.

    Raises
    ------
    ParameterError
        If the camera is orthographic, or the exposure or `far` is not positive.

    Notes
    -----
    The split is a plane across the view axis, for drops and fog alike; beside the axis both count
    the longer way through the air.
    """
    _check(camera, exposure, depth, alpha_out)
    far = _checked_far(far)
    camera_end = camera if camera_end is None else camera_end
    low, high, slack = _view_boxes(camera, camera_end, far, aperture, focus)
    drift, offset = field.velocity * exposure, field.velocity * time
    first, last = field.cube_range(
        low - np.maximum(drift, 0) - offset, high - np.minimum(drift, 0) - offset
    )
    tasks = slab_tasks(first, last)
    surfaces = _OPEN if surfaces is None else surfaces
    _draw_field(
        tasks, first, last, float(time), float(exposure), *field.arrays(),
        *_views(camera, camera_end, aperture, focus),
        np.float32(NEAR), far.astype(np.float32), slack, *surfaces.arrays(), more, depth,
        *_scratch(depth.shape), alpha_out,
    )  # fmt: skip


def draw_droplets(
    position, velocity, diameter, camera, exposure, depth, alpha_out, camera_end=None,
    aperture=0.0, focus=math.inf,
):  # fmt: skip
    """Draw given drops over an alpha picture, each along its path during the exposure.

    Parameters
    ----------
    position, velocity : ndarray of shape (n, 3), float64 [m], [m/s]
        When the shutter opens.
    diameter : ndarray of shape (n,), float64 [m]
    camera, exposure, depth, camera_end, aperture, focus
        As in `draw_streaks`.
    alpha_out : ndarray of shape (height, width), float32
        Modified in place: the transmittances of the droplets are multiplied to what it holds.
    """
    _check(camera, exposure, depth, alpha_out)
    own = np.empty_like(alpha_out)
    _draw_lines(
        np.column_stack([position, velocity, diameter]), float(exposure),
        *_views(camera, camera if camera_end is None else camera_end, aperture, focus),
        np.float32(NEAR), depth, *_scratch(depth.shape), own,
    )  # fmt: skip
    alpha_out += own * (1 - alpha_out)


def streak_reach(field, camera, exposure, far):
    """Return the depth [m] of each class, at most `far`, beyond which its drops are better fog.

    There even the largest drop of the class replaces less than FAINTEST in any pixel, so that an
    8-bit picture would not show it; what all of them replace together belongs to the fog.
    """
    focal = max(camera.fx, camera.fy)
    cover = math.pi / 4 * (focal * field.spectrum.edges[1:]) ** 2  # px m2: over depth squared
    length = focal * np.linalg.norm(field.velocity, axis=1) * exposure  # px m: over depth
    reach = np.minimum(cover / (length * FAINTEST), np.sqrt(cover / FAINTEST))
    return np.clip(reach, NEAR, far)


def fog_extinction(field):
    """Return the extinction [1/m] of the drops that are not drawn, before and beyond the split.

    Before it those are the drops too fine to track, beyond it all. Q = 1: a camera does not see
    the half of the extinction that is diffraction.
    """
    spectrum = field.spectrum
    return spectrum.fine_extinction, spectrum.fine_extinction + float(spectrum.extinction.sum())


def fog_optical_depth(field, depth, far):
    """Return the optical depth of the drops not drawn up to `depth` [m], when `far` [m] splits.

    `far` is a number or, as in `draw_streaks`, one for each class. Straight ahead; elsewhere it is
    more by one over the cosine of the angle off the axis.
    """
    spectrum = field.spectrum
    beyond = np.maximum(np.asarray(depth)[..., None] - np.asarray(far), 0)
    return spectrum.fine_extinction * depth + (beyond * spectrum.extinction).sum(axis=-1)


def fog_table(field, far):
    """Return what `shade.compose` needs to know of the fog, ndarray of shape (FOG_STEPS + 3,).

    The depth [m] up to which there are steps, the extinction [1/m] beyond it, and the optical depth
    at FOG_STEPS + 1 even steps of depth; float32.
    """
    last = float(np.max(far))
    steps = np.linspace(0.0, last, FOG_STEPS + 1)
    _, beyond = fog_extinction(field)
    depths = fog_optical_depth(field, steps, far)
    return np.concatenate([[last, beyond], depths]).astype(np.float32)


# ---- kernels


@cpu_kernel
def _draw_field(
    tasks, first, last, time, exposure, velocity, cube, class_key, count, size, share, frame,
    rotation, eye, rotation_end, eye_end, lens, planes, near, far, slack,
    x0, y0, spacing, sky, ground, underside, top, block_high, more, depth_map, depth, tile_depth,
    picture, alpha_out,
):  # fmt: skip
    """List the drops in view, slab by slab of cubes, and draw each, and `more`.

    Each worker has a picture of its own; adding whole numbers makes their sum exact.
    """
    workers, changes = picture.shape[0], share.shape[1] > 1
    height, width = alpha_out.shape
    high, wide = np.float32(height), np.float32(width)
    for band in prange(tile_depth.shape[1]):
        read_depth(band, depth_map, depth, tile_depth)
    for worker in prange(workers):
        mine = picture[worker]
        base, base_end = np.empty(3, np.float32), np.empty(3, np.float32)
        axes, axes_end = np.empty((3, 3), np.float32), np.empty((3, 3), np.float32)
        draw_lines(
            more, worker, len(more), workers, exposure, rotation, eye, rotation_end, eye_end, lens,
            near, width, height, depth, tile_depth, base, base_end, mine,
        )  # fmt: skip
        for t in range(worker, tasks.shape[0], workers):
            b, i = tasks[t]
            side = cube[b]
            vx, vy, vz = velocity[b]
            reach = far[b]
            if reach <= near:
                continue
            moves = exposure * np.sqrt(vx * vx + vy * vy + vz * vz)
            radius = np.float32(0.87 * side + 0.5 * moves + slack[b])
            for a in range(3):
                for c in range(3):
                    axes[a, c] = rotation[a, c] * side
                    axes_end[a, c] = rotation_end[a, c] * side
            for j in range(first[b, 1], last[b, 1] + 1):
                for k in range(first[b, 2], last[b, 2] + 1):
                    x, y = i * side + vx * time + frame[b, 0], j * side + vy * time + frame[b, 1]
                    z = k * side + vz * time
                    _to_camera(rotation, eye, x, y, z, base)
                    _to_camera(
                        rotation_end, eye_end,
                        x + vx * exposure, y + vy * exposure, z + vz * exposure, base_end,
                    )  # fmt: skip
                    if not _cube_in_view(base, base_end, axes, radius, planes, near, reach):
                        continue
                    key = cube_key(class_key[b], i, j, k)
                    for n in range(drops_in_cube(key, b, count)):
                        word = drop_id(key, n)
                        ux, uy, uz = uniform_triple(word)
                        p, q, r = _place(base, axes, ux, uy, uz)
                        if not near <= r < reach:
                            continue
                        p_end, q_end, r_end = _place(base_end, axes_end, ux, uy, uz)
                        shows = _may_show(
                            p, q, r, p_end, q_end, r_end, lens, near, wide, high, tile_depth
                        )
                        if shows == HIDDEN:
                            continue
                        if changes and left_out(word, b, (k + uz) * side, vz, share, frame):
                            continue
                        stop, _, _, _ = first_hit(
                            (i + ux) * side + frame[b, 0], (j + uy) * side + frame[b, 1],
                            (k + uz) * side, vx, vy, vz, -np.inf, time + exposure,
                            x0, y0, spacing, sky, ground, underside, top, block_high,
                        )  # fmt: skip
                        if stop <= time:
                            continue
                        draw_path(
                            p, q, r, p_end, q_end, r_end,
                            np.float32(min((stop - time) / exposure, 1.0)),
                            np.float32(drop_diameter(word, b, size)),
                            lens, near, width, height, depth, shows == CLEAR, mine,
                        )  # fmt: skip
    for band in prange(tile_depth.shape[1]):
        resolve_band(band, picture, alpha_out)


@cpu_kernel
def _draw_lines(
    lines, exposure, rotation, eye, rotation_end, eye_end, lens, planes, near, depth_map, depth,
    tile_depth, picture, alpha_out,
):  # fmt: skip
    """Draw listed drops."""
    workers = picture.shape[0]
    height, width = alpha_out.shape
    for band in prange(tile_depth.shape[1]):
        read_depth(band, depth_map, depth, tile_depth)
    for worker in prange(workers):
        here, there = np.empty(3, np.float32), np.empty(3, np.float32)
        draw_lines(
            lines, worker, len(lines), workers, exposure, rotation, eye, rotation_end, eye_end,
            lens, near, width, height, depth, tile_depth, here, there, picture[worker],
        )  # fmt: skip
    for band in prange(tile_depth.shape[1]):
        resolve_band(band, picture, alpha_out)


@lean_function
def draw_lines(
    lines, first, end, step, exposure, rotation, eye, rotation_end, eye_end, lens, near, width,
    height, depth, tile_depth, here, there, picture,
):  # fmt: skip
    """Draw every `step`-th of listed drops from `first` on, up to `end`.

    `lines` has seven columns: place [m] when the shutter opens, velocity [m/s] and diameter [m].
    `here` and `there` are scratch, three float32 each.
    """
    for d in range(first, end, step):
        draw_line(
            lines[d, 0], lines[d, 1], lines[d, 2], lines[d, 3], lines[d, 4], lines[d, 5],
            lines[d, 6], exposure, rotation, eye, rotation_end, eye_end, lens, near, width, height,
            depth, tile_depth, here, there, picture,
        )  # fmt: skip


@lean_function
def draw_line(
    x, y, z, vx, vy, vz, diameter, exposure, rotation, eye, rotation_end, eye_end, lens, near,
    width, height, depth, tile_depth, here, there, picture,
):  # fmt: skip
    """Draw one drop, given as a row of `draw_lines`' `lines`."""
    _to_camera(rotation, eye, x, y, z, here)
    _to_camera(
        rotation_end, eye_end, x + vx * exposure, y + vy * exposure, z + vz * exposure, there
    )
    if near > here[2]:
        return
    shows = _may_show(
        here[0], here[1], here[2], there[0], there[1], there[2], lens, near, np.float32(width),
        np.float32(height), tile_depth,
    )  # fmt: skip
    if shows != HIDDEN:
        draw_path(
            here[0], here[1], here[2], there[0], there[1], there[2], _ONE, np.float32(diameter),
            lens, near, width, height, depth, shows == CLEAR, picture,
        )  # fmt: skip


@lean_function
def _to_camera(rotation, eye, x, y, z, out):
    """Take a point to the camera frame; the subtraction is in float64, the rest is near 0."""
    x, y, z = x - eye[0], y - eye[1], z - eye[2]
    for a in range(3):
        out[a] = rotation[a, 0] * x + rotation[a, 1] * y + rotation[a, 2] * z


@lean_function
def _place(base, axes, ux, uy, uz):
    """Return the camera-frame place of a drop that is at (ux, uy, uz) of its cube."""
    x, y, z = np.float32(ux), np.float32(uy), np.float32(uz)
    return (
        base[0] + axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z,
        base[1] + axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z,
        base[2] + axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z,
    )


@lean_function
def _cube_in_view(base, base_end, axes, radius, planes, near, far):
    """Tell whether a moving cube's bounding sphere meets the view; base is its lower corner."""
    x = (base[0] + base_end[0] + axes[0, 0] + axes[0, 1] + axes[0, 2]) * _HALF
    y = (base[1] + base_end[1] + axes[1, 0] + axes[1, 1] + axes[1, 2]) * _HALF
    z = (base[2] + base_end[2] + axes[2, 0] + axes[2, 1] + axes[2, 2]) * _HALF
    if z + radius < near or z - radius > far:
        return False
    for a in range(4):
        if planes[a, 0] * x + planes[a, 1] * y + planes[a, 2] * z < -radius:
            return False
    return True


@lean_function
def _may_show(x, y, z, x_end, y_end, z_end, lens, near, width, height, tile_depth):
    """Tell whether a path's image may be in the picture: HIDDEN, PARTLY or CLEAR.

    Clear is what lies in front of all that its image touches.
    """
    if z_end < _HALF * near:
        return HIDDEN
    per_z, per_z_end = _ONE / z, _ONE / z_end
    u, u_end = lens[0] * x * per_z + lens[2], lens[0] * x_end * per_z_end + lens[2]
    v, v_end = lens[1] * y * per_z + lens[3], lens[1] * y_end * per_z_end + lens[3]
    nearest = min(z, z_end)
    margin = lens[4] * max(per_z, per_z_end) + _ONE  # half the largest drop, and the filter
    if lens[5] > _ZERO:
        blur = max(abs(per_z - lens[6]), abs(per_z_end - lens[6]))
        margin += _HALF * lens[5] * blur
    left, right = max(min(u, u_end) - margin, _ZERO), min(max(u, u_end) + margin, width - _ONE)
    low, high = max(min(v, v_end) - margin, _ZERO), min(max(v, v_end) + margin, height - _ONE)
    if left > right or low > high:
        return HIDDEN
    west, east = int(left) // BLOCK, int(right) // BLOCK
    top, bottom = int(low) // BLOCK, int(high) // BLOCK
    if (east - west + 1) * (bottom - top + 1) > _MOST_TILES:
        return PARTLY
    most, least = _ZERO, np.float32(np.inf)
    for j in range(top, bottom + 1):
        for i in range(west, east + 1):
            most, least = max(most, tile_depth[0, j, i]), min(least, tile_depth[1, j, i])
    if most <= nearest:
        return HIDDEN
    return CLEAR if max(z, z_end) < least else PARTLY


# ---- drivers' helpers


def _check(camera, exposure, depth, alpha_out):
    require_positive("exposure", exposure, "s")
    if camera.orthographic:
        raise ParameterError("the camera is orthographic; rain is drawn for perspective cameras")
    shape = (camera.height, camera.width)
    if depth.shape != shape or alpha_out.shape != shape:
        raise ParameterError(
            f"depth has shape {depth.shape} and alpha_out {alpha_out.shape}; "
            f"both must have the camera's {shape}"
        )


def _views(camera, camera_end, aperture, focus):
    """Return what the kernels need of the cameras at both ends of the exposure and of the lens."""
    require_not_negative("aperture", aperture, "m", "0 is a pinhole")
    if not focus > 0:
        raise ParameterError(f"focus is {focus!r} m; it must be more than 0; inf is far away")
    largest = 0.5 * LARGEST * max(camera.fx, camera.fy)
    lens = np.array(
        [
            camera.fx, camera.fy, camera.cx, camera.cy, largest,
            aperture * max(camera.fx, camera.fy), 1 / focus,
        ],
        np.float32,
    )  # fmt: skip
    planes = np.array(
        [
            [camera.fx, 0, camera.cx],
            [-camera.fx, 0, camera.width - camera.cx],
            [0, camera.fy, camera.cy],
            [0, -camera.fy, camera.height - camera.cy],
        ],
        dtype=np.float64,
    )
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    return (
        np.ascontiguousarray(camera.camera_from_world[:3, :3]), camera.position,
        np.ascontiguousarray(camera_end.camera_from_world[:3, :3]), camera_end.position,
        lens, planes.astype(np.float32),
    )  # fmt: skip


def _view_boxes(camera, camera_end, far, aperture, focus):
    """Return what both cameras see up to each class's `far`, and how far that moves between.

    As the low and high corners (CLASSES, 3) of boxes of the world and a length (CLASSES,).
    """
    corners = np.array([[u, v] for u in (0.0, camera.width) for v in (0.0, camera.height)])
    rays = np.zeros((5, 3))
    rays[1:, :2] = (corners - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    rays[1:, 2] = 1.0
    worlds = [
        far[:, None, None] * (rays @ c.camera_from_world[:3, :3]) + c.position
        for c in (camera, camera_end)
    ]  # rows times R is R transposed times columns: world_from_camera
    both = np.concatenate(worlds, axis=1)
    around = LARGEST + aperture * np.maximum(far / focus, 1.0)  # how far a drop's image reaches
    slack = np.linalg.norm(worlds[0] - worlds[1], axis=2).max(axis=1) + around
    around = around[:, None]
    return both.min(axis=1) - around, both.max(axis=1) + around, slack


def _checked_far(far):
    """Return the depth of each class, (CLASSES,), from one for all or one for each."""
    far = np.asarray(far, dtype=np.float64)
    if far.shape not in ((), (CLASSES,)):
        raise ParameterError(f"far has shape {far.shape}; it must be one number or ({CLASSES},)")
    for value in {float(far.min()), float(far.max())}:
        require_positive("far", value, "m")
    return np.broadcast_to(far, (CLASSES,))


_kept = threading.local()


def _scratch(shape):
    """Return room for depths, the tiles' depths and a blank picture of optical depths per worker.

    Kept from call to call, for fresh memory costs as much as the drawing; `resolve_band` leaves
    the pictures blank.
    """
    wanted = (set_threads(None), *shape)
    if getattr(_kept, "shape", None) != wanted:
        _kept.depth = np.empty(shape[0] * shape[1], np.float32)
        _kept.tiles = np.empty([2, *(-(-n // BLOCK) for n in shape)], np.float32)
        _kept.pictures = np.zeros((wanted[0], shape[0] * shape[1]), np.int32)
        _kept.shape = wanted
    return _kept.depth, _kept.tiles, _kept.pictures
