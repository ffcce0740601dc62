"""The images of lamps in wet ground: small sources far brighter than their surroundings.

A part of the lobe of `wet_ground_mirror` is one look-up in a blurred picture, as wide as the part
is at the depth of what it meets. A lamp is much smaller and hundreds of times brighter than what is
beside it: whether a look-up meets it, and at which depth, decides the light of a whole block. So
what is brighter than BRIGHT is taken out of the level picture and put together to a few sources.
Their light is that of a microfacet surface under a small source (Walter et al. 2007, EGSR, equation
20, with the visible slopes of `microfacet`), whose size widens the density of slopes.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import cpu_kernel, inlined_function, prange
from rainsim.scene.view import View
from rainsim.shading.fresnel import reflectance
from rainsim.shading.ground_slopes import GroundSlopes, block_ray, ground_met
from rainsim.shading.lamp_search import BRIGHT, brightest_of, lamps_in
from rainsim.shading.microfacet import LEAST_DIP, LEAST_RISE, shadowing

FINE_RESOLUTION = 320.0  # px per unit of tangent of the picture that shows how large lamps are
WORTH_FINE = 0.10  # share of the level picture's light that is lamps', from which it is drawn
TRIES = 12  # places of the way from the ground to a lamp at which something may stand in it
THICK, BEFORE = np.float32(1.0), np.float32(0.15)  # m behind what is seen within which a way ends
BY_THE_LAMP = np.float32(0.35)  # m from a lamp where its own housing does not count
FAINT = np.float32(1e-5)  # radiance below which nobody asks whether the lamp is hidden
AROUND = np.float32(1 / (2 * math.pi))


class LampView(NamedTuple):
    """Lamps and the depth of the level picture that shows them; read-only."""

    # (n, 8) float32: place [m], radiance times area in red, green and blue [m2], variances of its
    # places across the view and upwards [m2]
    lamps: np.ndarray
    depth: np.ndarray  # (height, width) float32 [m]
    lens: np.ndarray  # (4,) float32 [px]: fx, fy, cx, cy
    forward: np.ndarray  # (2,) float32, unit: where the axis points to on the ground


def lamps_seen(upright, draw_mirrored):
    """Return what a level camera sees, and the lamps in that as in `LampView`.

    upright : Camera. As `level_camera` returns it.
    draw_mirrored : callable. As `WetGroundMirror.add_to` takes it.
    """
    seen = draw_mirrored(upright)
    lamps, share = lamps_in(seen.picture, seen.depth, upright)
    if share > WORTH_FINE:  # coarse pixels show small lamps too large
        fine = scaled(upright, FINE_RESOLUTION)
        drawn = draw_mirrored(fine)
        lamps, _ = lamps_in(drawn.picture, drawn.depth, fine)
    return seen, lamps


def scaled(camera, resolution):
    """Return a level camera with so many pixels per unit of tangent."""
    grow = resolution / camera.fx
    width, height = math.ceil(camera.width * grow), math.ceil(camera.height * grow)
    return replace(
        camera, width=width, height=height, fx=resolution, fy=resolution, cx=camera.cx * grow,
        cy=camera.cy * grow,
    )  # fmt: skip


def without_lamps(picture):
    """Return a picture whose colours are no brighter than BRIGHT; their hue stays."""
    brightest, result = brightest_of(picture), picture.copy()
    bright = brightest > BRIGHT
    result[bright] *= (np.float32(BRIGHT) / brightest[bright])[:, None]
    return result


@cpu_kernel
def add_lamps(view: View, step, wanted, ground: GroundSlopes, seen: LampView, field_out):
    """Add the light of lamps that a full water film mirrors to each block of pixels.

    step : int [px]
    wanted : bool array (rows, columns). As `mirrored_field` takes it.
    ground : GroundSlopes
    seen : LampView
    field_out : float32 array (rows, columns, 3). As `mirrored_field` makes it,
        without lamps.
    """
    rows, columns = wanted.shape
    for j in prange(rows):
        for i in range(columns):
            if wanted[j, i]:
                x, y, z = block_ray(view, step, j, i)
                r, g, b = lamp_light(x, y, z, view.eye, ground, seen)
                field_out[j, i, 0] += r
                field_out[j, i, 1] += g
                field_out[j, i, 2] += b


@inlined_function
def lamp_light(x, y, z, eye, ground, seen):
    """Return the radiance of lamps that a water film on the ground mirrors to the eye.

    x, y, z : float32. Direction of view.
    eye : float32 array (3,) [m]
    ground : GroundSlopes
    seen : LampView
    """
    ux, uy, dip, span, here, gx, gy, slope = ground_met(x, y, z, eye, ground)
    px, py = eye[0] + span * ux, eye[1] + span * uy
    long = math.sqrt(ONE + dip * dip)
    vx, vy, vz = -ux / long, -uy / long, dip / long  # to the eye
    leave = ONE + shadowing(max(dip, LEAST_DIP) / slope)
    red, green, blue = ZERO, ZERO, ZERO
    for n in range(len(seen.lamps)):
        lamp = seen.lamps[n]
        dx, dy, dz = lamp[0] - px, lamp[1] - py, lamp[2] - here
        flat = max(math.sqrt(dx * dx + dy * dy), np.float32(1e-4))
        rise = dz / flat
        if rise < LEAST_RISE:
            continue
        square = flat * flat + dz * dz
        light = mirrored_share(
            vx, vy, vz, dx, dy, dz, flat, square, gx, gy, slope, lamp[6], lamp[7], leave,
            ground.law,
        )  # fmt: skip
        brightest = max(max(lamp[3], lamp[4]), lamp[5]) * light
        if brightest < FAINT:
            continue
        if not hidden(px, py, here, dx, dy, dz, eye, seen):
            red += light * lamp[3]
            green += light * lamp[4]
            blue += light * lamp[5]
    return red, green, blue


@inlined_function
def mirrored_share(vx, vy, vz, dx, dy, dz, flat, square, gx, gy, slope, wide, tall, leave, law):
    """Return the radiance that the ground mirrors to the eye of a source of unit flux [1/m2].

    F D G / (4 cos v d^2) with the density D of the facets' normals, which is the density of slopes
    over the fourth power of the normal's upward part. A source's variances `wide` and `tall` [m2]
    widen the density by what they turn the half vector.

    vx, vy, vz : float32. Unit vector to the eye.
    dx, dy, dz, flat, square : float32. Way to the source [m], its level length
        and the square of its length.
    gx, gy, slope : float32. Slopes of the ground and rms slope of the film.
    wide, tall : float32 [m2]
    leave : float32. One and Smith's Lambda of the view.
    law : int. Of reflectance, see `fresnel.LAWS`.
    """
    one = ONE / math.sqrt(square)
    lx, ly, lz = dx * one, dy * one, dz * one
    hx, hy, hz = vx + lx, vy + ly, vz + lz
    sx, sy = dx / flat, dy / flat
    ex, ey = -hx / hz - gx, -hy / hz - gy
    along, across = ex * sx + ey * sy, ey * sx - ex * sy
    # How fast the slope of the half vector changes with the source's elevation.
    turned = (lz * hz + (hx * sx + hy * sy) * flat * one) / (hz * hz)
    squared = slope * slope
    va = squared + tall / square * turned * turned
    vc = squared + wide / square / (hz * hz)
    density = AROUND / math.sqrt(va * vc) * math.exp(-HALF * (along * along / va
                                                             + across * across / vc))  # fmt: skip
    long = math.sqrt(hx * hx + hy * hy + hz * hz)
    up = hz / long
    facet = (vx * hx + vy * hy + vz * hz) / long
    smith = ONE / (leave + shadowing(dz / flat / slope))
    quarter = HALF * HALF
    weight = reflectance(law, facet) * density * smith * quarter
    return weight / (up * up * up * up * vz * square)


@inlined_function
def hidden(px, py, pz, dx, dy, dz, eye, seen):
    """Return whether something that the level picture shows stands between ground and lamp.

    A place of the way is within something if the picture shows a surface at most THICK before it.
    """
    depth, lens, forward = seen.depth, seen.lens, seen.forward
    rows, columns = depth.shape
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    for k in range(TRIES):
        share = (np.float32(k) + HALF) / np.float32(TRIES)
        if (ONE - share) * length < BY_THE_LAMP:
            break
        x, y, z = px + share * dx - eye[0], py + share * dy - eye[1], pz + share * dz
        ahead = x * forward[0] + y * forward[1]
        if ahead < BY_THE_LAMP:
            continue
        column = int(lens[2] + lens[0] * (x * forward[1] - y * forward[0]) / ahead)
        row = int(lens[3] + lens[1] * (z + eye[2]) / ahead)
        if column < 0 or row < 0 or column >= columns or row >= rows:
            continue
        gap = ahead - depth[row, column]
        if gap > BEFORE and gap < THICK:
            return True
    return False
