"""Views of each splat by the capture's cameras: how many, and its colour without gloss.

A splat that few cameras saw was placed by few pictures: from their places it looks right, from
others it stands at a wrong distance. The main picture needs such splats, for its camera is near one
that saw them. A mirrored camera looks up from below the ground, where no camera stood: there they
would hide the sky.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import ONE, SH_0, ZERO
from rainsim.io import cache
from rainsim.jit import cpu_kernel, device_function, prange
from rainsim.raster import Rasterizer, prepare
from rainsim.scene.cameras import resize_to
from rainsim.scene.view import lens_array
from rainsim.shading.color import LUMA_B, LUMA_G, LUMA_R
from rainsim.splatting import project

MOST_CAMERAS = 64  # of the capture, evenly spaced, that are asked
WIDTH = 320  # px of their depth pictures
LEAST_SHARE = 0.04  # of the cameras; splats that fewer see are badly placed
SLACK, LEAST_SLACK = np.float32(1.15), np.float32(0.05)  # of the depth, and capture units: in sight
DARKEST = np.float32(0.05)  # display value that keeps black views from having all the weight
NEAR = np.float32(0.1)  # capture units


def badly_placed(scene, views):
    """Return which splats stand high and were seen by too few cameras, ndarray (n,) of bool.

    High is above the mean of the cameras: what is lower is ground and what stands on it, and hides
    little sky.

    views : Views or None. Of its splats; None: nothing is known, and no splat is
        taken to be badly placed.
    """
    if views is None:
        return np.zeros(len(scene.splats), np.bool_)
    eye = np.mean([camera.position for camera in scene.cameras], axis=0)
    above = (scene.splats.position - eye.astype(np.float32)) @ scene.ground_frame.up.astype("f4")
    return (views.seen < LEAST_SHARE * views.asked) & (above > 0)


class Views(NamedTuple):
    """Views of each splat by the capture's cameras: their number, its colour, their direction."""

    seen: np.ndarray  # (n,) uint8: cameras that see it
    asked: int  # cameras that were asked
    diffuse: np.ndarray  # (n, 3) float16: display-referred colour of its darker views
    toward: np.ndarray  # (n, 3) float16: mean of the unit directions to those cameras; 0 for none


def views_of_splats(scene):
    """Return the `Views` of a scene's splats, kept for the next run; None if nothing is known.

    Nothing is known without cameras, nor of a built-in scene, whose splats no picture placed.
    A camera sees a splat whose centre lies in its picture and is not behind what the picture shows.
    A splat that none sees has its colour of degree 0.
    """
    if scene.source is None or not scene.cameras or not len(scene.splats):
        return None
    step = -(-len(scene.cameras) // MOST_CAMERAS)
    cameras = [resize_to(camera, WIDTH) for camera in scene.cameras[::step]]
    splats = scene.splats

    def count():
        rasterizer = Rasterizer(prepare(splats))
        views, total = np.zeros(len(splats), np.uint8), np.zeros((len(splats), 7), np.float32)
        for camera in cameras:
            view = np.ascontiguousarray(camera.camera_from_world[:3], np.float32)
            lens = lens_array(camera)
            eye = camera.position.astype(np.float32)
            depth = rasterizer.draw(camera, NEAR).depth
            count_view(splats.position, splats.sh, view, eye, lens, depth, views, total)
        plain = np.float32(0.5) + np.float32(SH_0) * splats.sh[:, 0]
        weight = total[:, 3:4]
        seen = total[:, :3] / np.maximum(weight, np.float32(1e-20))
        toward = total[:, 4:] / np.maximum(views, 1)[:, None]
        return {"views": views, "diffuse": np.where(weight > 0, seen, plain).astype("f2"),
                "toward": toward.astype("f2")}  # fmt: skip

    found = cache.kept_arrays("views", count, splats, cameras)
    return Views(found["views"], len(cameras), found["diffuse"], found["toward"])


@cpu_kernel
def count_view(position, sh, view, eye, lens, depth, views_out, total_out):
    """Add one to the count of each splat that a camera sees; sum up its colour and the direction.

    The weight falls with the fourth power of the luminance: the mean is that of the darker views,
    which have the least gloss.

    position : float32 array (n, 3) [capture units]
    sh : float32 array (n, k, 3)
    view : float32 array (3, 4). Camera frame from capture frame.
    eye : float32 array (3,) [capture units]
    lens : float32 array (4,) [px]. fx, fy, cx, cy.
    depth : float32 array (height, width) [capture units]. Of what the camera
        sees.
    views_out : uint8 array (n,)
    total_out : float32 array (n, 7). Sums of weighted colours (3), of weights,
        and of unit directions to the cameras (3).
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
                add_color(sh[n], x - eye[0], y - eye[1], z - eye[2], total_out[n])


@device_function
def add_color(sh, x, y, z, total_out):
    """Add a splat that is seen along (x, y, z) to the sums of `count_view`, dark views the more."""
    length = ONE / math.sqrt(x * x + y * y + z * z)
    total_out[4] -= x * length
    total_out[5] -= y * length
    total_out[6] -= z * length
    r, g, b = (
        color_seen(sh, 0, x * length, y * length, z * length),
        color_seen(sh, 1, x * length, y * length, z * length),
        color_seen(sh, 2, x * length, y * length, z * length),
    )
    square = (DARKEST + LUMA_R * r + LUMA_G * g + LUMA_B * b) ** 2
    weight = ONE / (square * square)
    total_out[0] += weight * r
    total_out[1] += weight * g
    total_out[2] += weight * b
    total_out[3] += weight


@device_function
def color_seen(sh, c, x, y, z):
    """Return channel c of a splat's colour, seen along the unit vector (x, y, z), at least 0."""
    color = project.color_constant(sh[0, c])
    if len(sh) >= 4:
        color += project.color_degree_1(x, y, z, sh[1, c], sh[2, c], sh[3, c])
    if len(sh) >= 9:
        color += project.color_degree_2(x, y, z, sh[4, c], sh[5, c], sh[6, c], sh[7, c], sh[8, c])
    if len(sh) >= 16:
        color += project.color_degree_3(
            x, y, z, sh[9, c], sh[10, c], sh[11, c], sh[12, c], sh[13, c], sh[14, c], sh[15, c]
        )
    return max(color, ZERO)
