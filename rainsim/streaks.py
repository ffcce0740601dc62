"""Rain in a picture: the path of each drop during the exposure, as the share of light it replaces.

Only the rain's alpha is made here; `shade` gives it radiance. A drop of diameter D at depth z
covers (pi/4)(f D / z)^2 pixels at any instant, so its alphas over the picture sum to that whatever
the exposure is. Drops are combined as a product of transmittances, summed as optical depths in
whole numbers, so that neither their order nor the number of threads matters.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.drops import cube_key, drop_diameter, drop_id, drops_in_cube, slab_tasks
from rainsim.errors import ParameterError, require_positive
from rainsim.jit import cpu_kernel, device_function, prange, set_threads
from rainsim.random import uniform_triple
from rainsim.spectrum import LARGEST
from rainsim.surfaces import BLOCK, first_hit, flat_surfaces, reduce_blocks

NEAR = 0.3  # m; drops nearer to the camera are out of any focus and are not drawn
_WIDE = np.float32(1.5)  # px; wider drops are drawn as discs
_STILL = np.float32(3.0)  # px; a shorter path of a drop nearly as wide as a pixel is a disc too
_WIDE_STILL = np.float32(0.9)  # px
_PIECES = np.float32(10.0)  # a path is cut where the depth has changed by a tenth
_MOST_PIECES = np.float32(63.0)

_SCALE = np.float32(2**23)  # units of the picture per unit of optical depth
_CEILING = np.int32(2**30)  # optical depth 128: black, and two of them still fit an int32
_OPAQUE = np.float32(0.9997)  # the most that one drop replaces in one pixel
_FAINT = np.float32(0.05)  # below it three terms give -log(1 - alpha) to 3e-5
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_TILE = np.float32(BLOCK)  # px; side of the tiles whose greatest depth is known
_THIRD, _QUARTER = np.float32(1 / 3), np.float32(0.25)
_QUARTER_PI = np.float32(math.pi / 4)
_SHORTEST = np.float32(0.05)  # px; length given to a path that hardly moves

_OPEN = flat_surfaces(1.0, 1.0, 1.0, origin=(1e9, 1e9))  # nothing to hit, far away


def draw_streaks(
    field, surfaces, camera, time, exposure, depth, far, alpha_out, camera_end=None
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
    far : float [m]
        Depth along the view axis at which drawn drops end and fog begins, counted at `time`.
    alpha_out : ndarray of shape (height, width), float32
        Overwritten with the share of light that drops replace, in [0, 1].
    camera_end : Camera or None
        The camera when the shutter closes, if it moves.

    Raises
    ------
    ParameterError
        If the camera is orthographic, or the exposure or `far` is not positive.

    Notes
    -----
    Both this alpha and `fog_optical_depth` count depth along the view axis, so they agree
    wherever the split lies; towards the corners of the picture both are low by the cosine of the
    angle off the axis.
    """
    _check(camera, exposure, depth, alpha_out)
    require_positive("far", far, "m")
    camera_end = camera if camera_end is None else camera_end
    low, high, slack = _view_box(camera, camera_end, far)
    drift, offset = field.velocity * exposure, field.velocity * time
    first, last = field.cube_range(
        low - np.maximum(drift, 0) - offset, high - np.minimum(drift, 0) - offset
    )
    tasks = slab_tasks(first, last)
    surfaces = _OPEN if surfaces is None else surfaces
    _draw_field(
        tasks, first, last, float(time), float(exposure), *field.arrays(),
        *_views(camera, camera_end),
        np.float32(NEAR), np.float32(far), slack, *surfaces.arrays(), depth.ravel(),
        reduce_blocks(np.maximum, depth), _blank(depth.shape), alpha_out,
    )  # fmt: skip


def draw_droplets(
    position, velocity, diameter, camera, exposure, depth, alpha_out, camera_end=None
):  # fmt: skip
    """Draw given drops over an alpha picture, each along its path during the exposure.

    Parameters
    ----------
    position, velocity : ndarray of shape (n, 3), float64 [m], [m/s]
        When the shutter opens.
    diameter : ndarray of shape (n,), float64 [m]
    camera, exposure, depth, camera_end
        As in `draw_streaks`.
    alpha_out : ndarray of shape (height, width), float32
        Modified in place: the transmittances of the droplets are multiplied to what it holds.
    """
    _check(camera, exposure, depth, alpha_out)
    own = np.empty_like(alpha_out)
    _draw_list(
        np.ascontiguousarray(position), np.ascontiguousarray(velocity),
        np.ascontiguousarray(diameter),
        float(exposure), *_views(camera, camera if camera_end is None else camera_end),
        np.float32(NEAR), depth.ravel(),
        reduce_blocks(np.maximum, depth), _blank(depth.shape), own,
    )  # fmt: skip
    alpha_out += own * (1 - alpha_out)


def fog_extinction(field):
    """Return the extinction [1/m] of the drops that are not drawn, before and beyond the split.

    Before it those are the drops too fine to track, beyond it all. Q = 1: a camera does not see
    the half of the extinction that is diffraction.
    """
    spectrum = field.spectrum
    return spectrum.fine_extinction, spectrum.fine_extinction + float(spectrum.extinction.sum())


def fog_optical_depth(field, depth, far):
    """Return the optical depth of the drops not drawn up to `depth` [m], when `far` [m] splits."""
    before, beyond = fog_extinction(field)
    return before * np.minimum(depth, far) + beyond * np.maximum(depth - far, 0)


# ---- kernels


@cpu_kernel
def _draw_field(
    tasks, first, last, time, exposure, velocity, cube, class_key, count, size,
    rotation, eye, rotation_end, eye_end, lens, planes, near, far, slack,
    x0, y0, spacing, sky, ground, underside, top, block_high, depth, tile_depth, picture,
    alpha_out,
):  # fmt: skip
    """List the drops in view, slab by slab of cubes, and draw each.

    Each worker has a picture of its own; adding whole numbers makes their sum exact.
    """
    workers = picture.shape[0]
    height, width = alpha_out.shape
    high, wide = np.float32(height), np.float32(width)
    for worker in prange(workers):
        mine = picture[worker]
        base, base_end = np.empty(3, np.float32), np.empty(3, np.float32)
        axes, axes_end = np.empty((3, 3), np.float32), np.empty((3, 3), np.float32)
        for t in range(worker, tasks.shape[0], workers):
            b, i = tasks[t]
            side = cube[b]
            vx, vy, vz = velocity[b]
            moves = exposure * np.sqrt(vx * vx + vy * vy + vz * vz)
            radius = np.float32(0.87 * side + 0.5 * moves + slack)
            for a in range(3):
                for c in range(3):
                    axes[a, c] = rotation[a, c] * side
                    axes_end[a, c] = rotation_end[a, c] * side
            for j in range(first[b, 1], last[b, 1] + 1):
                for k in range(first[b, 2], last[b, 2] + 1):
                    x, y, z = i * side + vx * time, j * side + vy * time, k * side + vz * time
                    _to_camera(rotation, eye, x, y, z, base)
                    _to_camera(
                        rotation_end, eye_end,
                        x + vx * exposure, y + vy * exposure, z + vz * exposure, base_end,
                    )  # fmt: skip
                    if not _cube_in_view(base, base_end, axes, radius, planes, near, far):
                        continue
                    key = cube_key(class_key[b], i, j, k)
                    for n in range(drops_in_cube(key, b, count)):
                        word = drop_id(key, n)
                        ux, uy, uz = uniform_triple(word)
                        p, q, r = _place(base, axes, ux, uy, uz)
                        p_end, q_end, r_end = _place(base_end, axes_end, ux, uy, uz)
                        if not (near <= r < far) or not _may_show(
                            p, q, r, p_end, q_end, r_end, lens, near, wide, high, tile_depth
                        ):
                            continue
                        stop, _, _, _ = first_hit(
                            (i + ux) * side, (j + uy) * side, (k + uz) * side, vx, vy, vz,
                            -np.inf, time + exposure,
                            x0, y0, spacing, sky, ground, underside, top, block_high,
                        )  # fmt: skip
                        if stop <= time:
                            continue
                        _draw_path(
                            p, q, r, p_end, q_end, r_end,
                            np.float32(min((stop - time) / exposure, 1.0)),
                            np.float32(drop_diameter(word, b, size)),
                            lens, near, width, height, depth, mine,
                        )  # fmt: skip
    for row in prange(height):
        _resolve_row(row, picture, alpha_out)


@cpu_kernel
def _draw_list(
    position, velocity, diameter, exposure,
    rotation, eye, rotation_end, eye_end, lens, planes, near, depth, tile_depth, picture, alpha_out,
):  # fmt: skip
    """Draw listed drops."""
    workers = picture.shape[0]
    height, width = alpha_out.shape
    high, wide = np.float32(height), np.float32(width)
    for worker in prange(workers):
        mine = picture[worker]
        here, there = np.empty(3, np.float32), np.empty(3, np.float32)
        for d in range(worker, position.shape[0], workers):
            x, y, z = position[d]
            _to_camera(rotation, eye, x, y, z, here)
            vx, vy, vz = velocity[d]
            _to_camera(
                rotation_end, eye_end,
                x + vx * exposure, y + vy * exposure, z + vz * exposure, there,
            )  # fmt: skip
            p, q, r = here
            p_end, q_end, r_end = there
            if near <= r and _may_show(
                p, q, r, p_end, q_end, r_end, lens, near, wide, high, tile_depth
            ):
                _draw_path(
                    p, q, r, p_end, q_end, r_end, _ONE, np.float32(diameter[d]),
                    lens, near, width, height, depth, mine,
                )  # fmt: skip
    for row in prange(height):
        _resolve_row(row, picture, alpha_out)


@device_function
def _to_camera(rotation, eye, x, y, z, out):
    """Take a point to the camera frame; the subtraction is in float64, the rest is near 0."""
    x, y, z = x - eye[0], y - eye[1], z - eye[2]
    for a in range(3):
        out[a] = rotation[a, 0] * x + rotation[a, 1] * y + rotation[a, 2] * z


@device_function
def _place(base, axes, ux, uy, uz):
    """Return the camera-frame place of a drop that is at (ux, uy, uz) of its cube."""
    x, y, z = np.float32(ux), np.float32(uy), np.float32(uz)
    return (
        base[0] + axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z,
        base[1] + axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z,
        base[2] + axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z,
    )


@device_function
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


@device_function
def _may_show(x, y, z, x_end, y_end, z_end, lens, near, width, height, tile_depth):
    """Tell whether a path's image may be in the picture and in front of something."""
    if z_end < _HALF * near:
        return False
    u, u_end = lens[0] * x / z + lens[2], lens[0] * x_end / z_end + lens[2]
    v, v_end = lens[1] * y / z + lens[3], lens[1] * y_end / z_end + lens[3]
    nearest = min(z, z_end)
    margin = lens[4] / nearest + _ONE  # half the largest drop, and the filter
    left, right = max(min(u, u_end) - margin, _ZERO), min(max(u, u_end) + margin, width - _ONE)
    low, high = max(min(v, v_end) - margin, _ZERO), min(max(v, v_end) + margin, height - _ONE)
    if left > right or low > high:
        return False
    if right - left > _TILE or low + _TILE < high:
        return True
    # not longer than a tile, so the tiles at its corners are all that it touches
    west, east = int(left) // BLOCK, int(right) // BLOCK
    top, bottom = int(low) // BLOCK, int(high) // BLOCK
    farthest = max(
        max(tile_depth[top, west], tile_depth[top, east]),
        max(tile_depth[bottom, west], tile_depth[bottom, east]),
    )
    return farthest > nearest


@device_function
def _draw_path(
    x, y, z, x_end, y_end, z_end, share, diameter, lens, near, width, height, depth, picture
):  # fmt: skip
    """Draw the first `share` of a drop's straight path in the camera frame.

    A path towards or away from the camera is cut into pieces of equal time, each with its share of
    (pi/4) fx fy (D / z)^2, whose mean over a piece is that of 1 / (z0 z1); never so finely that
    pieces lie on each other in the picture.
    """
    dx, dy, dz = (x_end - x) * share, (y_end - y) * share, (z_end - z) * share
    z_end = max(z + dz, _HALF * near)
    z0 = z
    u0, v0 = lens[0] * x / z + lens[2], lens[1] * y / z + lens[3]
    u_end, v_end = lens[0] * (x + dx) / z_end + lens[2], lens[1] * (y + dy) / z_end + lens[3]
    nearest = min(z, z_end)
    long_enough = max(abs(u_end - u0), abs(v_end - v0)) / (_TWO + lens[0] * diameter / nearest)
    pieces = 1 + int(min(_PIECES * abs(dz) / nearest, min(long_enough, _MOST_PIECES)))
    step = _ONE / np.float32(pieces)
    area = _QUARTER_PI * lens[0] * lens[1] * diameter * diameter * share * step
    for piece in range(1, pieces + 1):
        passed = np.float32(piece) * step
        z1 = z + dz * passed
        u1 = lens[0] * (x + dx * passed) / z1 + lens[2]
        v1 = lens[1] * (y + dy * passed) / z1 + lens[3]
        wide = lens[0] * diameter * _TWO / (z0 + z1)
        alpha = area / (z0 * z1)
        across, along = abs(u1 - u0), abs(v1 - v0)
        if wide > _WIDE or (wide > _WIDE_STILL and max(across, along) < _STILL):
            _draw_disc(u0, v0, z0, u1, v1, z1, _HALF * wide, alpha, width, height, depth, picture)
        elif along >= across:
            _draw_thin(v0, u0, z0, v1, u1, z1, alpha, height, width, width, 1, depth, picture)
        else:
            _draw_thin(u0, v0, z0, u1, v1, z1, alpha, width, height, 1, width, depth, picture)
        z0, u0, v0 = z1, u1, v1


@device_function
def _draw_thin(
    s0, t0, z0, s1, t1, z1, alpha, s_count, t_count, s_stride, t_stride, depth, picture
):  # fmt: skip
    """Spread `alpha` evenly over a path; s is the image axis along which it is longer.

    Every point of the path is shared linearly between the pixel centres around it, along both
    axes, so that the streak's centroid is where it belongs and slides smoothly.
    """
    if s1 < s0:
        s0, s1, t0, t1, z0, z1 = s1, s0, t1, t0, z1, z0
    lacking = max(_SHORTEST - (s1 - s0), _ZERO) * _HALF
    s0, s1 = s0 - lacking - _HALF, s1 + lacking - _HALF  # from here on in pixel centres
    per_length = _ONE / (s1 - s0)
    # clipped before the conversion: a path may reach far outside the picture
    start = int(max(np.floor(s0), _ZERO))
    stop = int(min(np.floor(s1) + _ONE, np.float32(s_count - 1))) + 1
    for s in range(start, stop):
        centre = np.float32(s)
        part = (min(max(centre, s0), s1) - s0) * per_length
        across = t0 + (t1 - t0) * part - _HALF
        floor = np.floor(across)
        if floor < -_ONE or floor >= np.float32(t_count):
            continue
        t, right = int(floor), across - floor
        z = z0 + (z1 - z0) * part
        amount = alpha * (_hat_integral(s1 - centre) - _hat_integral(s0 - centre)) * per_length
        at = s * s_stride + t * t_stride
        if t >= 0:
            _deposit(at, amount * (_ONE - right), z, depth, picture)
        if t + 1 < t_count:
            _deposit(at + t_stride, amount * right, z, depth, picture)


@device_function
def _hat_integral(x):
    """Integral up to x of the hat 1 - |x| on [-1, 1]."""
    x = min(max(x, -_ONE), _ONE)
    return _HALF + x - _HALF * x * abs(x)


@device_function
def _draw_disc(u0, v0, z0, u1, v1, z1, radius, alpha, width, height, depth, picture):
    """Spread `alpha` over a moving disc by the share of time that it covers each pixel."""
    du, dv = u1 - u0, v1 - v0
    length = np.sqrt(du * du + dv * dv)
    if length > _ZERO:
        du, dv = du / length, dv / length
    reach = radius + _ONE
    top, bottom = int(np.floor(min(v0, v1) - reach)), int(np.floor(max(v0, v1) + reach))
    left, right = int(np.floor(min(u0, u1) - reach)), int(np.floor(max(u0, u1) + reach))
    total = _ZERO
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            total += _cover(row, column, u0, v0, du, dv, length, radius)
    scale = alpha / max(total, _SHORTEST)
    for row in range(max(top, 0), min(bottom, height - 1) + 1):
        for column in range(max(left, 0), min(right, width - 1) + 1):
            amount = scale * _cover(row, column, u0, v0, du, dv, length, radius)
            if amount > _ZERO:
                u, v = np.float32(column) + _HALF - u0, np.float32(row) + _HALF - v0
                part = min(max((u * du + v * dv) / max(length, _SHORTEST), _ZERO), _ONE)
                _deposit(row * width + column, amount, z0 + (z1 - z0) * part, depth, picture)


@device_function
def _cover(row, column, u0, v0, du, dv, length, radius):
    """Share of time for which the moving disc covers a pixel, from four points in it."""
    u, v = np.float32(column) + _HALF - u0, np.float32(row) + _HALF - v0
    if abs(u * dv - v * du) > radius + _ONE:
        return _ZERO
    covered = _ZERO
    for corner in range(4):
        a = u + (_QUARTER if corner & 1 else -_QUARTER)
        b = v + (_QUARTER if corner & 2 else -_QUARTER)
        along, aside = a * du + b * dv, a * dv - b * du
        if length <= _SHORTEST:  # still: inside or not
            covered += _QUARTER if a * a + b * b < radius * radius else _ZERO
            continue
        half_chord = radius * radius - aside * aside
        if half_chord > _ZERO:
            half_chord = np.sqrt(half_chord)
            inside = min(length, along + half_chord) - max(_ZERO, along - half_chord)
            covered += _QUARTER * max(inside, _ZERO) / length
    return covered


@device_function
def _deposit(at, alpha, z, depth, picture):
    """Add one drop's alpha in one pixel as optical depth, unless something stands before it."""
    if z >= depth[at]:
        return
    if alpha < _FAINT:
        optical = alpha * (_ONE + alpha * (_HALF + alpha * _THIRD))
    else:
        optical = -np.log(_ONE - min(alpha, _OPAQUE))
    picture[at] = min(picture[at] + np.int32(optical * _SCALE + _HALF), _CEILING)


@device_function
def _resolve_row(row, picture, alpha_out):
    """Turn the workers' summed optical depths of one row into alpha."""
    width = alpha_out.shape[1]
    for column in range(width):
        total = np.int64(0)
        for worker in range(picture.shape[0]):
            total += picture[worker, row * width + column]
        optical = np.float32(min(total, np.int64(_CEILING))) / _SCALE
        alpha_out[row, column] = -np.expm1(-optical)


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


def _views(camera, camera_end):
    """Return what the kernels need of the cameras at both ends of the exposure."""
    largest = 0.5 * LARGEST * max(camera.fx, camera.fy)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, largest], np.float32)
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


def _view_box(camera, camera_end, far):
    """Return the world box of what both cameras see up to `far`, and how far that moves between."""
    corners = np.array([[u, v] for u in (0.0, camera.width) for v in (0.0, camera.height)])
    rays = np.ones((4, 3))
    rays[:, :2] = (corners - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    points = np.concatenate([np.zeros((1, 3)), rays * far])
    worlds = [
        points @ c.camera_from_world[:3, :3] + c.position for c in (camera, camera_end)
    ]  # rows times R is R transposed times columns: world_from_camera
    both = np.concatenate(worlds)
    slack = float(np.linalg.norm(worlds[0] - worlds[1], axis=1).max()) + LARGEST
    return both.min(axis=0) - LARGEST, both.max(axis=0) + LARGEST, slack


def _blank(shape):
    """Return one empty picture of optical depths per worker."""
    return np.zeros((set_threads(None), shape[0] * shape[1]), np.int32)
