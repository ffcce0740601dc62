"""Twins of `rainsim.shade`: from the dry picture to the wet one, and from light to 8 bit.

A thread takes a pixel. Kernels have the parameters of their brothers on the CPU; numbers that
change from frame to frame are arrays of one element, for a recorded frame reads them anew.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.light import bilinear_color, display_from_linear, exp_minus
from rainsim.shade import (
    FAR_AWAY,
    FLAT,
    HALF,
    LEAST_ALPHA,
    LEAST_SKY,
    ON_GROUND,
    ONE,
    TWO,
    WALL_SHARE,
    ZERO,
    field_place,
    film_cover,
    fog_thickness,
    glossed,
    is_edge,
    rainy,
    splash_light,
    undiluted,
    wet_state,
)
from rainsim.sky import sample_environment

BLOCK = (32, 8)  # threads: columns, rows
WHITE = np.float32(255)
NOWHERE = np.float32(np.inf)


def blocks(height, width):
    """Return the grid of blocks that covers a picture."""
    return -(-width // BLOCK[0]), -(-height // BLOCK[1])


@cuda_kernel
def grade_and_wet(
    size, color, alpha, depth, plane_depth, normal, meters_per_unit, ground_from_camera, eye, lens,
    bed, ground, origin, spacing, environment, day_sky, look, others,
    picture_out, depth_out, clearance_out, film_out,
):  # fmt: skip
    """Grade the dry picture, wet it, and measure it against the ground; see `rainsim.shade`.

    `size` (2,) holds the columns and rows [px] of the part that was drawn.
    """
    column, row = cuda.grid(2)
    if row >= size[1] or column >= size[0]:
        return
    m = ground_from_camera
    b = (np.float32(row) + HALF - lens[3]) / lens[1]
    a = (np.float32(column) + HALF - lens[2]) / lens[0]
    x = m[0, 0] * a + m[0, 1] * b + m[0, 2]
    y = m[1, 0] * a + m[1, 1] * b + m[1, 2]
    z = m[2, 0] * a + m[2, 1] * b + m[2, 2]
    length = math.sqrt(x * x + y * y + z * z)
    il = ONE / length
    n0, n1, n2 = normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]
    across = m[0, 0] * n0 + m[0, 1] * n1 + m[0, 2] * n2
    along = m[1, 0] * n0 + m[1, 1] * n1 + m[1, 2] * n2
    upness = m[2, 0] * n0 + m[2, 1] * n1 + m[2, 2] * n2
    d = plane_depth[row, column] if upness > FLAT else depth[row, column]
    d *= meters_per_unit
    over = alpha[row, column]
    solid = over >= LEAST_ALPHA
    e = plane_depth[row, column] * meters_per_unit
    e = e if abs(e - d) < WALL_SHARE * d else d
    clearance, above, lawn, damp, film, pores = wet_state(
        bed, ground, origin, spacing, others, solid, eye[0] + e * x, eye[1] + e * y,
        eye[2] + e * z, across, along, upness, e * length,
    )  # fmt: skip
    depth_out[row, column] = d if solid else NOWHERE
    clearance_out[row, column] = clearance
    red, green, blue = undiluted(
        color[row, column, 0], color[row, column, 1], color[row, column, 2],
        over if is_edge(over, look[5]) else ONE,
    )  # fmt: skip
    red, green, blue, gloss, through = rainy(
        red, green, blue, over, d * length, z * il,
        -(n0 * a + n1 * b + n2) * il, upness, above, lawn, damp, film, pores,
        look[0], look[1], look[2], look[3], look[4], look[5],
    )  # fmt: skip
    film_apart = film_out.shape[0] > 0
    if film_apart:
        film_out[row, column] = ZERO
    if film_apart and solid and upness > FLAT and above < ON_GROUND:
        film_out[row, column] = film_cover(
            ground, origin, spacing, eye[0] + e * x, eye[1] + e * y, clearance, upness, lawn, film
        )
    elif gloss > ZERO:
        e0, e1, e2 = glossed(environment, x * il, y * il, z * il)
        red, green, blue = red + gloss * e0, green + gloss * e1, blue + gloss * e2
    if through > LEAST_SKY:
        e0, e1, e2 = sample_environment(day_sky, x * il, y * il, z * il)
        red, green, blue = red + through * e0, green + through * e1, blue + through * e2
    picture_out[row, column, 0] = red
    picture_out[row, column, 1] = green
    picture_out[row, column, 2] = blue


@cuda_kernel
def compose(
    picture, depth, rain_alpha, splash_alpha, drop_radiance, around, air_radiance, fog, lens,
    brightness, image_out,
):  # fmt: skip
    """Put fog, streaks and splashes before the picture and encode it; see `rainsim.shade`."""
    column, row = cuda.grid(2)
    height, width = depth.shape
    if row >= height or column >= width:
        return
    a = (np.float32(column) + HALF - lens[2]) / lens[0]
    b = (np.float32(row) + HALF - lens[3]) / lens[1]
    z = depth[row, column]
    through = fog_thickness(fog, min(z, FAR_AWAY)) * math.sqrt(ONE + b * b + a * a)
    clear = exp_minus(through) if z < FAR_AWAY else ONE
    drops = bilinear_color(
        drop_radiance, field_place(column, width, drop_radiance.shape[1]) + HALF,
        field_place(row, height, drop_radiance.shape[0]) + HALF,
    )  # fmt: skip
    for c in range(3):
        drop, air = drops[c], air_radiance[c]
        value = air + (picture[row, column, c] - air) * clear
        thrown = splash_light(drop, around[c])
        value = thrown + (value - thrown) * (ONE - splash_alpha[row, column])
        value = (drop + (value - drop) * (ONE - rain_alpha[row, column])) * brightness[0]
        over = max(value - HALF, ZERO)
        value = min(value, HALF) + HALF * (ONE - exp_minus(over * TWO))
        shown = display_from_linear(max(value, ZERO))
        image_out[row, column, c] = np.uint8(min(shown, ONE) * WHITE + HALF)
