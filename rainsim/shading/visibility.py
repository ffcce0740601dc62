"""How many of the capture's cameras see each splat.

A splat that few cameras saw was placed by few pictures: from their places it looks right, from
others it stands at a wrong distance. The main picture needs such splats, for its camera is near one
that saw them. A mirrored camera looks up from below the ground, where no camera stood: there they
would hide the sky.
"""

from __future__ import annotations

import numpy as np

from rainsim.constants import SH_0
from rainsim.io import cache
from rainsim.jit import cpu_kernel, prange
from rainsim.raster import Rasterizer, prepare
from rainsim.shading.color import LUMA_B, LUMA_G, LUMA_R
from rainsim.shading.grading import SKY_BLUE, SKY_DULL

MOST_CAMERAS = 64  # of the capture, evenly spaced, that are asked
WIDTH = 320  # px of their depth pictures
LEAST_SHARE = 0.04  # of the cameras; splats that fewer see are badly placed
SLACK, LEAST_SLACK = np.float32(1.15), np.float32(0.05)  # of the depth, and capture units: in sight
GAMMA = 2.2  # of the display, near enough to tell a sky
PALE = 0.45  # linear luminance of a captured sky, at least; roofs are darker
NEAR = np.float32(0.1)  # capture units


def badly_placed(scene, prepared=None):
    """Return which splats stand high and were seen by too few cameras, ndarray (n,) of bool.

    High is above the mean of the cameras: what is lower is ground and what stands on it, and hides
    little sky. Without cameras nothing is known, and no splat is taken to be badly placed; nor is
    any of a built-in scene, whose splats no picture placed.

    Parameters
    ----------
    scene : Scene
    """
    if scene.source is None or not scene.cameras or not len(scene.splats):
        return np.zeros(len(scene.splats), np.bool_)
    seen, asked = views_of_splats(scene)
    eye = np.mean([camera.position for camera in scene.cameras], axis=0)
    above = (scene.splats.position - eye.astype(np.float32)) @ scene.ground_frame.up.astype("f4")
    return (seen < LEAST_SHARE * asked) & (above > 0)


def pale(splats):
    """Return which splats are as bright and as little green as a sky, ndarray (n,) of bool."""
    color = np.clip(np.float32(0.5) + np.float32(SH_0) * splats.sh[:, 0], 0, 1) ** np.float32(GAMMA)
    light = color @ np.array([LUMA_R, LUMA_G, LUMA_B])
    blue = color[:, 2] / np.maximum(color[:, :2].max(axis=1), np.float32(1e-3))
    return (light > PALE) & (blue > 0.5 * (SKY_DULL + SKY_BLUE))


def views_of_splats(scene):
    """Return how many cameras see each splat, ndarray (n,) of uint8, and how many were asked.

    A camera sees a splat whose centre lies in its picture and is not behind what the picture shows.
    The counts are kept for the next run.
    """
    step = -(-len(scene.cameras) // MOST_CAMERAS)
    cameras = [
        camera.resized(WIDTH, max(1, round(WIDTH * camera.height / camera.width)))
        for camera in scene.cameras[::step]
    ]

    def count():
        rasterizer = Rasterizer(prepare(scene.splats))
        views = np.zeros(len(scene.splats), np.uint8)
        for camera in cameras:
            view = np.ascontiguousarray(camera.camera_from_world[:3], np.float32)
            lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
            depth = rasterizer.draw(camera, NEAR).depth
            count_view(scene.splats.position, view, lens, depth, views)
        return {"views": views}

    found = cache.kept_arrays("views", "shading", count, scene.splats, cameras)
    return found["views"], len(cameras)


@cpu_kernel
def count_view(position, view, lens, depth, views_out):
    """Add one to the count of each splat that a camera sees.

    Parameters
    ----------
    position : ndarray of shape (n, 3), float32 [capture units]
    view : ndarray of shape (3, 4), float32
        Camera frame from capture frame.
    lens : ndarray of shape (4,), float32 [px]
        fx, fy, cx, cy.
    depth : ndarray of shape (height, width), float32 [capture units]
        Of what the camera sees.
    views_out : ndarray of shape (n,), uint8
    """
    height, width = depth.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    for n in prange(len(position)):
        x, y, z = position[n, 0], position[n, 1], position[n, 2]
        far = view[2, 0] * x + view[2, 1] * y + view[2, 2] * z + view[2, 3]
        if not far > NEAR:
            continue
        u = fx * (view[0, 0] * x + view[0, 1] * y + view[0, 2] * z + view[0, 3]) / far + cx
        v = fy * (view[1, 0] * x + view[1, 1] * y + view[1, 2] * z + view[1, 3]) / far + cy
        if u >= 0 and v >= 0 and u < width and v < height:
            if far < depth[int(v), int(u)] * SLACK + LEAST_SLACK:
                views_out[n] += np.uint8(1)
