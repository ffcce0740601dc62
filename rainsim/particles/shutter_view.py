"""A camera while its shutter is open: its numbers for kernels, the air and ground that it sees."""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF
from rainsim.errors import ParameterError, require_not_negative, require_positive
from rainsim.jit import inlined_function, lean_function, serial_kernel
from rainsim.particles.line_raster import NEAR
from rainsim.rain.poisson_cells import DropField, cubes_along
from rainsim.rain.size_distribution import CLASSES, LARGEST
from rainsim.scene.view import corner_rays, edge_planes, finest, lens_array

_NEAR = np.float32(NEAR)


class ShutterView(NamedTuple):
    """A perspective camera when its shutter opens and closes, in the ground frame.

    On a device `time` and `exposure` are arrays of shape (1,), as a `View` has its numbers.

    time, exposure : float [s]. The shutter is open from `time` to `time +
        exposure`.
    rotation, eye : array (3, 3) and (3,), float64. camera_from_ground and the
        camera's place [m] when the shutter opens.
    rotation_end, eye_end : array (3, 3) and (3,), float64. The same when it
        closes.
    axes, axes_end : float32 array (3, 3). `rotation` and `rotation_end`, for
        steps from a place near the camera.
    lens : float32 array (8,). See `line_raster.FX` and its neighbours.
    planes : float32 array (4, 3). Inward normals of the picture's left, right,
        top and bottom, in the camera frame.
    """

    time: float
    exposure: float
    rotation: np.ndarray
    eye: np.ndarray
    rotation_end: np.ndarray
    eye_end: np.ndarray
    axes: np.ndarray
    axes_end: np.ndarray
    lens: np.ndarray
    planes: np.ndarray


def shutter_view(
    camera, time, exposure, camera_end=None, aperture=0.0, focus=np.inf, strength=1.0
):  # fmt: skip
    """Return the `ShutterView` of a camera; arguments as `streaks.draw_streaks` has them."""
    require_positive("exposure", exposure, "s")
    if camera.orthographic:
        raise ParameterError("the camera is orthographic; rain is drawn for perspective cameras")
    require_not_negative("aperture", aperture, "m", "0 is a pinhole")
    if not focus > 0:
        raise ParameterError(f"focus is {focus!r} m; it must be more than 0; inf is far away")
    camera_end = camera if camera_end is None else camera_end
    focal = finest(camera)
    blur = np.array([0.5 * LARGEST * focal, aperture * focal, 1 / focus, strength], np.float32)
    lens = np.concatenate([lens_array(camera), blur])
    rotation, rotation_end = (
        np.ascontiguousarray(c.camera_from_world[:3, :3], np.float64) for c in (camera, camera_end)
    )
    return ShutterView(
        float(time), float(exposure), rotation, camera.position, rotation_end, camera_end.position,
        rotation.astype(np.float32), rotation_end.astype(np.float32), lens,
        edge_planes(camera).astype(np.float32),
    )  # fmt: skip


def require_pictures(camera, depth, alpha_out):
    """Raise ParameterError unless both pictures have the camera's size."""
    shape = (camera.height, camera.width)
    if depth.shape != shape or alpha_out.shape != shape:
        raise ParameterError(
            f"depth has shape {depth.shape} and alpha_out {alpha_out.shape}; "
            f"both must have the camera's {shape}"
        )


class SeenAir(NamedTuple):
    """The air of each size class that a shutter's view may show.

    first, last : int64 array (CLASSES, 3). First and last cube of each class
        along x, y and z; none if the last is less.
    far : float32 array (CLASSES,) [m]. Depth along the view axis at which the
        drawn drops of the class end.
    slack : float64 array (CLASSES,) [m]. At least how far what the camera sees up
        to `far` moves while the shutter is open, and how far a drop's image
        reaches around its middle.
    """

    first: np.ndarray
    last: np.ndarray
    far: np.ndarray
    slack: np.ndarray


def seen_air(field, camera, view, far, aperture=0.0, focus=np.inf):
    """Return the `SeenAir` of a `ShutterView`; arguments as `streaks.draw_streaks` has them.

    Raises ParameterError if `far` is neither one number nor one for each class,
        or not positive.
    """
    far = np.asarray(far, dtype=np.float64)
    if far.shape not in ((), (CLASSES,)):
        raise ParameterError(f"far has shape {far.shape}; it must be one number or ({CLASSES},)")
    for value in {float(far.min()), float(far.max())}:
        require_positive("far", value, "m")
    far = np.full(CLASSES, far) if far.ndim == 0 else far
    first, last = np.empty((CLASSES, 3), np.int64), np.empty((CLASSES, 3), np.int64)
    slack = np.empty(CLASSES)
    lens = float(aperture), float(focus)
    find_air(corner_rays(camera), view, far, *lens, field.arrays(), first, last, slack)
    return SeenAir(first, last, far.astype(np.float32), slack)


def footprint(camera, reach, margin=0.0):
    """Return low and high corner (2, 2) [m] of a camera's view up to a depth, with a margin [m]."""
    points = reach * corner_rays(camera) @ camera.camera_from_world[:3, :3] + camera.position
    points = np.concatenate([points, camera.position[None]])[:, :2]
    return np.stack([points.min(axis=0) - margin, points.max(axis=0) + margin])


# ---- formulas for kernels


@serial_kernel
def find_air(
    rays, view: ShutterView, far, aperture, focus, field: DropField, first_out, last_out, slack_out
):  # fmt: skip
    """Write the `SeenAir` of a view, whose `rays` (4, 3) are its picture's corners."""
    moves, turns = 0.0, 0.0
    for a in range(3):
        moves += (view.eye_end[a] - view.eye[a]) ** 2
    for k in range(4):
        turn = 0.0
        for a in range(3):
            turn += (
                _component(rays, k, view.rotation_end, a) - _component(rays, k, view.rotation, a)
            ) ** 2
        turns = max(turns, turn)
    moves, turns = math.sqrt(moves), math.sqrt(turns)
    for a in range(3):
        least, most = _span(rays, view.rotation, a)
        least_end, most_end = _span(rays, view.rotation_end, a)
        eye, eye_end = view.eye[a], view.eye_end[a]
        for b in range(CLASSES):
            around = LARGEST + aperture * max(far[b] / focus, 1.0)  # of a drop's image
            slack_out[b] = around + moves + far[b] * turns
            low = min(eye + far[b] * least, eye_end + far[b] * least_end) - around
            high = max(eye + far[b] * most, eye_end + far[b] * most_end) + around
            first_out[b, a], last_out[b, a] = cubes_along(
                low, high, view.time, view.exposure, field.velocity[b, a],
                field.frame[b, a] if a < 2 else 0.0, field.cube[b],
            )  # fmt: skip


@lean_function
def _span(rays, rotation, a):
    """Return the least and the largest of 0 and component `a` of rays, in the ground frame."""
    least, most = 0.0, 0.0
    for k in range(4):
        component = _component(rays, k, rotation, a)
        least, most = min(least, component), max(most, component)
    return least, most


@lean_function
def _component(rays, k, rotation, a):
    """Return component `a` of the k-th ray of the camera frame in the ground frame."""
    return rays[k, 0] * rotation[0, a] + rays[k, 1] * rotation[1, a] + rays[k, 2] * rotation[2, a]


@lean_function
def to_camera(rotation, eye, x, y, z):
    """Return a point of the ground frame in the camera frame, float32 [m].

    The subtraction of the eye is in float64: what is left is small.
    """
    x, y, z = x - eye[0], y - eye[1], z - eye[2]
    return (
        np.float32(rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z),
        np.float32(rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z),
        np.float32(rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z),
    )


@lean_function
def cube_corners(cube, field, view):
    """Return where (x, y, z) the low corner of a `Cube` is in the camera frame, first and last."""
    b = cube.size_class
    side, vx, vy, vz = (
        field.cube[b], field.velocity[b, 0], field.velocity[b, 1], field.velocity[b, 2]
    )  # fmt: skip
    x = cube.i * side + vx * view.time + field.frame[b, 0]
    y = cube.j * side + vy * view.time + field.frame[b, 1]
    z = cube.k * side + vz * view.time
    first = to_camera(view.rotation, view.eye, x, y, z)
    x, y, z = x + vx * view.exposure, y + vy * view.exposure, z + vz * view.exposure
    return first, to_camera(view.rotation_end, view.eye_end, x, y, z)


@lean_function
def step_from(corner, axes, x, y, z):
    """Return the camera-frame place that lies (x, y, z) [m] of the ground frame from a corner."""
    return (
        corner[0] + axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z,
        corner[1] + axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z,
        corner[2] + axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z,
    )


@lean_function
def cube_radius(size_class, field, view, air):
    """Return the radius [m] of a ball around all places of a cube's drops during the exposure.

    The ball stands about the middle of the cube halfway through the exposure. The radius is half
    the cube's diagonal (0.87 sides), half the way that the drops move during the exposure, and
    `SeenAir.slack` for the camera's motion and the blur.
    """
    vx, vy, vz = (
        field.velocity[size_class, 0], field.velocity[size_class, 1], field.velocity[size_class, 2]
    )  # fmt: skip
    moves = view.exposure * np.sqrt(vx * vx + vy * vy + vz * vz)
    return np.float32(0.87 * field.cube[size_class] + 0.5 * moves + air.slack[size_class])


@inlined_function
def cube_in_view(corner, corner_end, side, radius, far, view):
    """Tell whether the ball around a moving cube may be in the picture, up to the depth `far`.

    `corner` and `corner_end` as `cube_corners` returns them; the cube's `side` [m] is float32.
    """
    axes = view.axes
    middle = (
        (corner[0] + corner_end[0] + axes[0, 0] * side + axes[0, 1] * side + axes[0, 2] * side)
        * HALF,
        (corner[1] + corner_end[1] + axes[1, 0] * side + axes[1, 1] * side + axes[1, 2] * side)
        * HALF,
        (corner[2] + corner_end[2] + axes[2, 0] * side + axes[2, 1] * side + axes[2, 2] * side)
        * HALF,
    )
    if middle[2] + radius < _NEAR or middle[2] - radius > far:
        return False
    return beside_planes(middle, radius, view.planes)


@lean_function
def beside_planes(place, radius, planes):
    """Tell whether a ball at a place of the camera frame reaches between a view's four planes."""
    for a in range(4):
        aside = planes[a, 0] * place[0] + planes[a, 1] * place[1] + planes[a, 2] * place[2]
        if aside < -radius:
            return False
    return True
