"""The view of a camera as formulas of kernels take it: pose and lens in one read-only bundle.

Directions and offsets are in the ground frame (x and y level, z up) unless a name says otherwise;
the camera frame has x to the right, y down and z along the view axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF
from rainsim.jit import inlined_function


class View(NamedTuple):
    """Where a picture was taken from, and through which lens.

    Kernels read it only: numba drops writes through a bundle's arrays in parallel loops. A
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
        return np.array([self.fx, self.fy, self.cx, self.cy], np.float32)


class CameraArrays(NamedTuple):
    """A `View` as a device holds it: its numbers change between two replays of a recorded queue."""

    ground_from_camera: np.ndarray  # (3, 3) float32
    eye: np.ndarray  # (3,) float32 [m]
    lens: np.ndarray  # (4,) float32 [px], fx, fy, cx, cy


def view_of(camera):
    """Return the `View` of a `Camera` whose pose is in the ground frame."""
    return View(
        np.ascontiguousarray(camera.camera_from_world[:3, :3].T, dtype=np.float32),
        camera.position.astype(np.float32),
        *(np.float32(n) for n in (camera.fx, camera.fy, camera.cx, camera.cy)),
    )


@inlined_function
def view_from(camera):
    """Return the `View` of `CameraArrays`, inside a kernel."""
    lens = camera.lens
    return View(camera.ground_from_camera, camera.eye, lens[0], lens[1], lens[2], lens[3])


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
