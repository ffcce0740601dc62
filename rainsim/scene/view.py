"""The view of a camera: pose and lens in one read-only bundle, and all formulas of the pinhole.

The first part is for arrays: there a camera is a `Camera` or a `View`. The second part holds the
scalar formulas of kernels. A picture's place (u, v) [px] counts from its upper left corner; a slope
is the tangent of a ray's angle to the view axis, to the right or down. Directions and offsets are
in the ground frame (x and y level, z up) unless a name says otherwise; the camera frame has x to
the right, y down and z along the view axis.
"""

from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF
from rainsim.jit import inlined_function


class View(NamedTuple):
    """Where a picture was taken from, and through which lens.

    Kernels read a View only: numba drops writes through a bundle's arrays in parallel loops. A
    parallel kernel's module must import the bundle's class by its name (annotate the argument):
    numba looks the name up there when it takes the loop apart.
    """

    ground_from_camera: np.ndarray  # (3, 3) float32, rotation
    eye: np.ndarray  # (3,) float32 [m], ground frame
    fx: np.float32  # px, focal length over the width of a pixel
    fy: np.float32  # px
    cx: np.float32  # px, principal point from the picture's left edge
    cy: np.float32  # px, principal point from the picture's top edge

    @property
    def lens(self):
        """fx, fy, cx, cy [px] as an array (4,), float32, for a device."""
        return lens_array(self)


def view_of(camera):
    """Return the `View` of a `Camera` whose pose is in the ground frame."""
    return View(
        np.ascontiguousarray(camera.camera_from_world[:3, :3].T, dtype=np.float32),
        camera.position.astype(np.float32),
        *(np.float32(n) for n in (camera.fx, camera.fy, camera.cx, camera.cy)),
    )


# ---- the pinhole, for arrays


def lens_array(camera):
    """Return fx, fy, cx, cy [px], ndarray of shape (4,), float32."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)


def finest(camera):
    """Return the pixels per unit of slope, along the axis on which they are more."""
    return max(camera.fx, camera.fy)


def slopes(camera, u, v):
    """Return the slopes to the right and down of the rays through places (u, v) of a picture."""
    return (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy


def camera_points(camera, points):
    """Return points (n, 3) of the frame that a `Camera` is placed in, in the camera's own frame."""
    matrix = camera.camera_from_world
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def image_point(camera, x, y, z):
    """Return the place (u, v) [px] at which a picture shows a place of the camera frame."""
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy


def rays(camera, u, v):
    """Return the camera-frame rays (..., 3) through places of a picture, 1 along the view axis."""
    return np.stack([*slopes(camera, u, v), np.ones_like(u)], axis=-1)


def pixel_rays(camera):
    """Return the `rays` through the middles of a camera's pixels, (height, width, 3), float64."""
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    return rays(camera, u, v)


def corner_rays(camera):
    """Return the `rays` through a picture's corners: both left ones, then both right ones."""
    u, v = np.array([[u, v] for u in (0.0, camera.width) for v in (0.0, camera.height)]).T
    return rays(camera, u, v)


def edge_planes(camera):
    """Return inward unit normals (4, 3) of a picture's left, right, top and bottom edges."""
    planes = np.array(
        [
            [camera.fx, 0, camera.cx],
            [-camera.fx, 0, camera.width - camera.cx],
            [0, camera.fy, camera.cy],
            [0, -camera.fy, camera.height - camera.cy],
        ],
        dtype=np.float64,
    )
    return planes / np.sqrt((planes * planes).sum(axis=1, keepdims=True))


# ---- formulas for kernels


@inlined_function
def pixel_ray(view, row, column):
    """Return the ray (x, y, z) through a pixel's middle, ground frame, 1 along the view axis."""
    return ray_through(view.ground_from_camera, view.fx, view.fy, view.cx, view.cy, row, column)


@inlined_function
def ray_through(m, fx, fy, cx, cy, row, column):
    """Return `pixel_ray` of a pose `m` (ground_from_camera) and a lens."""
    return image_ray(m, fx, fy, cx, cy, np.float32(column) + HALF, np.float32(row) + HALF)


@inlined_function
def image_ray(m, fx, fy, cx, cy, u, v):
    """Return the ray (x, y, z) through a place (u, v) [px] of a picture, as `ray_through` does."""
    a, b = (u - cx) / fx, (v - cy) / fy
    return (
        m[0, 0] * a + m[0, 1] * b + m[0, 2], m[1, 0] * a + m[1, 1] * b + m[1, 2],
        m[2, 0] * a + m[2, 1] * b + m[2, 2],
    )  # fmt: skip


@inlined_function
def column_slope(view, column):
    """Return the slope to the right of the rays through the middles of a column of pixels."""
    return (np.float32(column) + HALF - view.cx) / view.fx


@inlined_function
def row_slope(view, row):
    """Return the slope down of the rays through the middles of a row of pixels."""
    return (np.float32(row) + HALF - view.cy) / view.fy


@inlined_function
def camera_component(view, i, x, y, z):
    """Return component i (0 right, 1 down, 2 ahead) of a ground-frame vector in the camera."""
    m = view.ground_from_camera
    return m[0, i] * x + m[1, i] * y + m[2, i] * z


@inlined_function
def in_camera(view, x, y, z):
    """Return the ground-frame vector (x, y, z) in the camera frame."""
    return (
        camera_component(view, 0, x, y, z), camera_component(view, 1, x, y, z),
        camera_component(view, 2, x, y, z),
    )  # fmt: skip


@inlined_function
def project(view, x, y, z):
    """Return image point (u, v) [px] and depth of a ground-frame offset from the eye."""
    cx, cy, cz = in_camera(view, x, y, z)
    return view.fx * cx / cz + view.cx, view.fy * cy / cz + view.cy, cz
