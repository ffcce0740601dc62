"""Reflections in water by a planar mirror: look-ups in the picture of the mirrored camera.

The camera mirrored at the water's level sees, pixel for pixel, what level water mirrors. A ray
that ripples bend is followed through that picture: its image starts where the mirrored camera sees
the surface point, at depth z0, and ends at the ray's vanishing point; at a share t of the way the
ray's depth is z0 / (1 - t), for 1/z is linear in the picture.

`mirrored_light` does one pixel and is what a CUDA thread calls. Its twin is `mirror_pass`, which
does the same for many rays at a time in vectors: both call the formulas below, but who changes the
order or the number of the steps in one changes the other. One by one the rays would take more than
twice as long on a CPU. `tests/reflection/test_mirrors.py` fails when the two differ.
"""

from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import inlined_function, lean_function
from rainsim.numerics.mipmap import blurred_color
from rainsim.reflection.facets import light_weight, slope_samples
from rainsim.reflection.mirrored_rays import SPREAD, sample_blur, sample_ray
from rainsim.scene.view import camera_component, project

STEPS = 24  # of the march along a bent ray in the mirrored picture, see docs/light.md
THICKNESS = np.float32(0.1)  # m: how far behind its depth a surface still stops such a ray
HALVINGS = 2  # of the last step, in which something is met
SAME = np.float32(0.05)  # share of a depth within which two points are taken for one
MIRROR_FAR = np.float32(100)  # m, stands for the sky's distance


class MirrorPicture(NamedTuple):
    """The scene above the water as a mirrored camera sees it, wet."""

    picture: np.ndarray  # (rows, columns, 3) float32, linear light
    coarse: np.ndarray  # (rows, columns // 2, 3) float32, its mip levels: mipmap.coarsened
    depth: np.ndarray  # (rows, columns) float32 [m], along the mirrored camera's view axis


@lean_function
def mirrored_light(view, mirror, water):
    """Return the radiance (r, g, b) that a pixel of water mirrors, by a mirrored picture.

    view : View. Of the mirrored camera, its lens that of the picture: it may show
        a part of the frame.
    mirror : MirrorPicture
    water : WaterPixel
    """
    samples, a, b, c = slope_samples(water)
    blur = ZERO
    if samples > 1:
        blur = sample_blur(view, water)
    red, green, blue, total = ZERO, ZERO, ZERO, ZERO
    for sample in range(samples):
        rx, ry, rz = sample_ray(water, SPREAD * a, SPREAD * b, SPREAD * c, sample)
        u, v, share = march_mirror(view, mirror.depth, water, rx, ry, rz)
        r, g, b_ = blurred_color(mirror.picture, mirror.coarse, u, v, blur * share)
        weight = light_weight(water, a, b, c, sample)
        total += weight
        red, green, blue = red + weight * r, green + weight * g, blue + weight * b_
    gain = ONE / total
    return red * gain, green * gain, blue * gain


@lean_function
def march_mirror(view, depth, water, rx, ry, rz):
    """Return where the mirrored picture shows the hit of a ray r from a pixel's surface point.

    And the share of the way to the ray's vanishing point at which it does, 0 to 1. A ray that
    passes behind something, where the picture shows nothing of it, ends where it was last in front
    of everything.
    """
    u0, v0, z0 = image_of(view, water.x, water.y, water.z)
    u1, v1 = vanishing_point(view, rx, ry, rz)
    du, dv = u1 - u0, v1 - v0
    # What level water would mirror here is often what the bent ray meets, too.
    guess = guessed_share(z0, _depth_at(depth, u0, v0))
    if is_met(z0, guess, _depth_at(depth, u0 + guess * du, v0 + guess * dv)):
        return u0 + guess * du, v0 + guess * dv, guess
    before, end = z0, ZERO
    for k in range(STEPS):
        t = step_share(k)
        now = z0 * depth_gain(t)
        surface = _depth_at(depth, u0 + t * du, v0 + t * dv)
        if met_since(before, now, surface):
            low, end = end, t
            for _ in range(HALVINGS):
                middle = HALF * (low + end)
                surface = _depth_at(depth, u0 + middle * du, v0 + middle * dv)
                if is_behind(z0, middle, surface):
                    end = middle
                else:
                    low = middle
            break
        if now < surface:
            before, end = now, t
    return u0 + end * du, v0 + end * dv, end


@inlined_function
def image_of(view, x, y, z):
    """Return image point and depth of a surface point in the mirrored picture: its ray's start."""
    eye = view.eye
    return project(view, x - eye[0], y - eye[1], z - eye[2])


@inlined_function
def vanishing_point(view, rx, ry, rz):
    """Return where the mirrored picture shows the end of an endless ray r."""
    gain = max(camera_component(view, 2, rx, ry, rz), np.float32(0.02))
    u = view.fx * camera_component(view, 0, rx, ry, rz) / gain + view.cx
    return u, view.fy * camera_component(view, 1, rx, ry, rz) / gain + view.cy


@inlined_function
def guessed_share(z0, surface):
    """Return the share of its way at which a ray that starts at depth z0 gets to another depth."""
    return max(ONE - z0 / min(surface, MIRROR_FAR), ZERO)


@inlined_function
def is_met(z0, share, surface):
    """Tell whether a surface is as deep as a ray is at a share of its way."""
    surface = min(surface, MIRROR_FAR) * (ONE - share)
    return abs(surface - z0) < SAME * surface


@inlined_function
def step_share(k):
    """Return the share of the way at a step; finer near the water, where things in it begin."""
    t = np.float32(k + 1) * (ONE / np.float32(STEPS))
    return t * t


@inlined_function
def depth_gain(share):
    """Return the depth of a ray at a share of its way over that of its start."""
    return ONE / max(ONE - share, np.float32(1e-4))


@inlined_function
def is_behind(z0, share, surface):
    """Tell whether a ray that starts at depth z0 has passed a surface at a share of its way."""
    return z0 >= surface * (ONE - share)


@inlined_function
def met_since(before, now, surface):
    """Tell whether a ray has met a surface since it was last in front of all, at depth `before`.

    It may have met it where something else hid that: a wall goes on behind a post.
    """
    return (now >= surface) & (before <= surface + THICKNESS)


@lean_function
def _depth_at(depth, u, v):
    """Return the depth at image point (u, v), or at the edge next to it."""
    # Without a sign: negative places would count from the end, which costs a test at each.
    i = np.uint32(min(max(u, ZERO), np.float32(depth.shape[1] - 1)))
    j = np.uint32(min(max(v, ZERO), np.float32(depth.shape[0] - 1)))
    return depth[j, i]
