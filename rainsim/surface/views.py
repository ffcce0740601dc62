"""The depth pictures of a capture's cameras, without the sky."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.numerics.blocks import of_each
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS, linear
from rainsim.scene.cameras import look_at, resize_to
from rainsim.scene.view import lens_array

MOST_CAMERAS = 96  # of the capture, evenly spaced, that are asked
WIDTH, AT_ONCE = 324, 8  # px of their depth pictures; how many are drawn at once
NEAR = 0.05  # m from a camera, within which nothing is drawn
THIN = 0.1  # of its second axis, that a splat is thick: then its plane tells the depth
OPAQUE = np.float32(0.7)  # alpha from which a pixel shows a surface
ABOUT, PLAIN = 9, (0.1, 0.25)  # px, and range of log luminance about a pixel: plain, textured
LEAST_HALF, MOST_HALF, BEYOND = 6.0, 40.0, 4.0  # m, of what cameras look at; past the cameras
FEWEST_CAMERAS = 8  # of the capture, below which cameras are made too
# Cameras of a capture without enough: rings about its middle, as a person would walk them.
RINGS = ((0.35, 1.1), (0.6, 1.7), (0.85, 2.4))  # of half its width; m over the ground
ON_RING, MADE_FOV, MADE_SHAPE = 12, 70.0, 1.5  # cameras; degrees; width over height


class DepthView(NamedTuple):
    """A camera's depth and light, in metres of the ground frame; a kernel's bundle."""

    matrix: np.ndarray  # (3, 4) float32: camera frame from ground frame
    eye: np.ndarray  # (3,) float32
    lens: np.ndarray  # (4,) float32: fx, fy, cx, cy [px]
    depth: np.ndarray  # (height, width) float32 [m]; infinite where no surface is
    least: np.ndarray  # (height, width) float32 [m]: least depth of the pixels around
    light: np.ndarray  # (height, width, 3) float32, linear
    plain: np.ndarray  # (height, width) float32: 0 texture tells the depth, 1 none does


def window_of(position, cameras):
    """Return the middle [m] and half the width [m] of the area that cameras (ground frame) look at.

    Where they are few the splats, at `position` [m], say it.
    """
    if len(cameras) >= FEWEST_CAMERAS:
        eyes = np.array([camera.position for camera in cameras])
        middle = np.median(eyes, axis=0)
        reach = np.percentile(np.linalg.norm(eyes[:, :2] - middle[:2], axis=1), 90)
        half = 1.6 * reach + BEYOND
    else:
        middle = np.median(position, axis=0)
        # Of a disc, somewhat more than its radius, though half of the splats may be far sky.
        half = 1.6 * np.median(np.linalg.norm(position[:, :2] - middle[:2], axis=1))
    return middle.astype(np.float32), float(np.clip(half, LEAST_HALF, MOST_HALF))


def cameras_of(scene, middle, half):
    """Return the cameras that a surface is found from, in the capture frame.

    Those of the capture, evenly spaced; where they are few, rings of cameras about its middle too:
    few cameras take a wall for sky, and what throws a shadow stands outside their pictures.
    """
    if len(scene.cameras) >= FEWEST_CAMERAS:
        return asked_of(scene.cameras)
    made = list(scene.cameras)
    for share, high in RINGS:
        for k in range(ON_RING):
            turn = 2 * np.pi * (k + share) / ON_RING
            away = share * half * np.array([np.cos(turn), np.sin(turn)])
            eye = np.array([*(middle[:2] + away), high])
            at = np.array([*(middle[:2] - 0.3 * away), 0.3])
            camera = look_at(eye, at, (0, 0, 1), MADE_FOV, WIDTH, round(WIDTH / MADE_SHAPE))
            made.append(scene.ground_frame.camera_in_capture(camera))
    return made


def asked_of(cameras):
    """Return at most MOST_CAMERAS of some cameras, evenly spaced."""
    return cameras[:: -(-len(cameras) // MOST_CAMERAS)]


def has_thin_splats(splats):
    """Tell whether most splats are flat, as PGSR and 2DGS train them."""
    axes = np.sort(splats.scale, axis=1)
    return bool(np.median(axes[:, 0] / np.maximum(axes[:, 1], np.float32(1e-12))) < THIN)


def depth_views(scene, cameras, rasterizer):
    """Return the `DepthView` of each camera (capture frame), the sky not yet left out.

    `rasterizer` draws the scene's splats.

    The mean of the splats' centres lies before a surface of thick splats, since the nearer hide
    the farther, and the blended plane about as far behind it: the mean of both is taken. Of flat
    splats the plane is right.
    """
    frame, unit = scene.ground_frame, np.float32(scene.ground_frame.meters_per_unit)
    thin = has_thin_splats(scene.splats)
    cameras = [resize_to(camera, WIDTH) for camera in cameras]
    near = NEAR / frame.meters_per_unit

    def view(camera, layers):
        light = linear(layers.color / np.maximum(layers.alpha, np.float32(0.5))[..., None])
        plain = _plainness(light)
        share = 1.0 if thin else 0.5 + 0.5 * np.clip(2 * plain - 1, 0, 1)
        with np.errstate(invalid="ignore"):  # infinite where nothing is
            depth = layers.depth + share * (layers.plane_depth - layers.depth)
        depth = np.where(layers.alpha > OPAQUE, depth * unit, np.float32(np.inf))
        depth = depth.astype(np.float32)
        placed = frame.camera_in_ground(camera)
        return DepthView(
            np.ascontiguousarray(placed.camera_from_world[:3], np.float32),
            placed.position.astype(np.float32),
            lens_array(camera),
            depth, ndimage.minimum_filter(depth, 3),
            light.astype(np.float32), plain,
        )  # fmt: skip

    views = []
    for first in range(0, len(cameras), AT_ONCE):
        some = cameras[first : first + AT_ONCE]
        drawn = [rasterizer.draw(camera, near, depth="median") for camera in some]
        views += of_each(view, some, drawn)
    return views


def leave_out_sky(views, sky):
    """Write into the views that pixels of the sky, bool (height, width) each, show no surface."""

    def leave_out(view, shown):
        view.depth[shown] = np.inf
        ndimage.minimum_filter(view.depth, 3, output=view.least)

    of_each(leave_out, views, sky)


def _plainness(light):
    """Return how plain a picture (height, width, 3) of linear light is about each pixel, 0 to 1."""
    log = np.log(np.maximum(light @ LUMINANCE_WEIGHTS.astype(np.float32), np.float32(0.01)))
    log = ndimage.gaussian_filter(log, 0.7)
    spread = ndimage.maximum_filter(log, ABOUT) - ndimage.minimum_filter(log, ABOUT)
    low, high = PLAIN
    return np.clip((high - spread) / (high - low), 0, 1).astype(np.float32)
