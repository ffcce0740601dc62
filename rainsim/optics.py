"""Light on water: where it lies in the picture, how ripples tilt it, and what shows through it.

The water that a picture shows, found by `meeting`, is a list: `list_water` makes it, one record of
RECORD numbers for each pixel (row n of `record`, pixel number `pixel[n]`). `tilt_water` adds the
ripples, `reflect` what is mirrored, `lay_water` puts it all into the picture.

Numbers of a record: 0 to 2 the surface point x, y, z [m]; 3 to 5 the unit view direction; 6 depth
of the point along the view axis [m]; 7 water depth [m]; 8 coverage; 9 share of the ripples that
show; 10, 11 mean slopes of the surface in the pixel; 12 to 14 how they vary in it: variances of the
slopes along x and y and their covariance; 15 width of the pixel there [m].
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.jit import cpu_kernel, device_function, inlined_function, prange
from rainsim.light import (
    REFRACTIVE_INDEX,
    bilinear,
    bilinear_color,
    exp_minus,
    fresnel,
    pixel_ray,
    schlick,
    smoothstep,
)
from rainsim.moments import pixel_slopes

ZERO = np.float32(0)
ONE = np.float32(1)
TWO = np.float32(2)
HALF = np.float32(0.5)

RECORD = 16  # numbers of a record: a cache line
# Absorption of puddle water [1/m], red, green, blue. Clean water takes .35, .07, .02 (Pope and Fry
# 1997); puddles hold fine soil, which takes blue most. No measurement of it is used here: a guess.
ABSORB_R, ABSORB_G, ABSORB_B = np.float32(5), np.float32(5.5), np.float32(7)
LEAST_COSINE = np.float32(0.02)
RIPPLE_LOW, RIPPLE_HIGH = np.float32(0.0008), np.float32(0.004)  # m of water: none, full rings
RIPPLE_REST = np.float32(0.07)  # share of the rings that runs in under cover
NEAREST = np.float32(0.05)  # m
REFRACT_TOLERANCE = np.float32(0.04)  # m: what lies nearer than the bed by more is foreground
SHIFT_PER_DEPTH = ONE - ONE / REFRACTIVE_INDEX  # of the paper's image shift, see `shifted`
PHONG_EXPONENT = np.float32(64)  # the paper gives none


@cpu_kernel
def list_water(
    hit, coverage, first, turn, ground_from_camera, eye, lens, water_depth, rings,
    origin, spacing, pixel_out, record_out,
):  # fmt: skip
    """Write the record of each covered pixel, row by row.

    `first` holds the place of each row's first record, `rings` the amplitude of rings in each cell
    over that in the open; the rest is as in `meeting.meet_water`. Slopes are left at zero.
    """
    height, width = coverage.shape
    m = ground_from_camera
    for k in prange(height):
        row = turn[k]
        n = first[row]
        for column in range(width):
            covers = coverage[row, column]
            if covers == ZERO:
                continue
            x, y, z = pixel_ray(m, lens, row, column)
            t = hit[row, column]
            sx, sy, sz = eye[0] + t * x, eye[1] + t * y, eye[2] + t * z
            u, v = (sx - origin[0]) / spacing - HALF, (sy - origin[1]) / spacing - HALF
            deep = bilinear(water_depth, u, v)
            grow = smoothstep(RIPPLE_LOW, RIPPLE_HIGH, deep)
            # Ripples: none in a film, few where little rain falls, a breath of wind everywhere.
            grow *= RIPPLE_REST + (ONE - RIPPLE_REST) * bilinear(rings, u, v)
            length = math.sqrt(x * x + y * y + z * z)
            inv = ONE / length
            r = record_out[n]
            r[0], r[1], r[2], r[3], r[4], r[5] = sx, sy, sz, x * inv, y * inv, z * inv
            r[6], r[7], r[8], r[9] = t, deep, covers, grow
            r[10], r[11], r[12], r[13], r[14] = ZERO, ZERO, ZERO, ZERO, ZERO
            r[15] = t * length / lens[0]
            pixel_out[n] = row * width + column
            n += 1


@cpu_kernel
def tilt_water(record, moments, tile_size):
    """Tilt the listed water by the ripples; modifies numbers 10 to 14 of `record`.

    Parameters
    ----------
    record : ndarray of shape (n, 16), float32
    moments : ndarray of shape (k, k + k // 2, 5), float32
        Of the ripples' slopes on a periodic tile of `tile_size` [m], see `moments`.
    tile_size : float32 [m]
    """
    for n in prange(len(record)):
        r = record[n]
        grow = r[9]
        gx, gy, xx, yy, xy = ZERO, ZERO, ZERO, ZERO, ZERO
        if grow > ZERO:
            gx, gy, xx, yy, xy = pixel_slopes(
                moments, tile_size, r[0], r[1], r[3], r[4], r[5], r[15]
            )
        square = grow * grow
        r[10], r[11] = grow * gx, grow * gy
        r[12], r[13], r[14] = square * xx, square * yy, square * xy


@cpu_kernel
def lay_water(
    pixel, record, light, picture, below, depth, ground_from_camera, lens, schlick_law,
    image_shift, phong, glint_variance, sun, picture_out,
):  # fmt: skip
    """Lay the water over the picture: what it mirrors, what shows through it, the sun's glint.

    Parameters
    ----------
    pixel, record
        The list of the water.
    light : ndarray of shape (n, 3), float32
        Radiance that each record mirrors, before Fresnel's factor.
    picture, below, depth
        The wet picture without water, what of it shows through water, and its depth [m].
    schlick_law, image_shift, phong : bool
        The paper's: Schlick's reflectance, refraction by shifting the image, (n.h)^p for the sun.
    glint_variance : float32
        Of the slopes below a pixel.
    sun : ndarray of shape (6,), float32
        Direction to the sun and its irradiance in three channels; zero for no sun.
    picture_out : ndarray of shape (height, width, 3), float32
        Only the listed pixels are written.
    """
    width = depth.shape[1]
    m = ground_from_camera
    for n in prange(len(pixel)):
        r = record[n]
        row, column = pixel[n] // width, pixel[n] % width
        b0, b1, b2, share, glint = terms_of(
            r, row, column, below, depth, m, lens, schlick_law, image_shift, phong,
            glint_variance, sun,
        )  # fmt: skip
        through, covers, dry = ONE - share, r[8], ONE - r[8]
        out = picture_out[row, column]
        out[0] = dry * picture[row, column, 0] + covers * (
            through * b0 + share * light[n, 0] + glint * sun[3]
        )
        out[1] = dry * picture[row, column, 1] + covers * (
            through * b1 + share * light[n, 1] + glint * sun[4]
        )
        out[2] = dry * picture[row, column, 2] + covers * (
            through * b2 + share * light[n, 2] + glint * sun[5]
        )


@cpu_kernel
def separate_water(
    pixel, record, picture, depth, ground_from_camera, lens, schlick_law, image_shift, phong,
    glint_variance, sun, through_out, share_out, glint_out,
):  # fmt: skip
    """Write the terms that `lay_water` adds up, apart; for layers.

    Parameters
    ----------
    through_out : ndarray of shape (n, 3), float32
        Radiance from below the water, before it is multiplied by 1 - Fresnel's factor.
    share_out : ndarray of shape (n,), float32
        Fresnel's factor.
    glint_out : ndarray of shape (n, 3), float32
        The sun's glint as it is added.
    """
    width = depth.shape[1]
    for n in prange(len(pixel)):
        b0, b1, b2, share, glint = terms_of(
            record[n], pixel[n] // width, pixel[n] % width, picture, depth, ground_from_camera,
            lens, schlick_law, image_shift, phong, glint_variance, sun,
        )  # fmt: skip
        through_out[n, 0], through_out[n, 1], through_out[n, 2] = b0, b1, b2
        share_out[n] = share
        for c in range(3):
            glint_out[n, c] = glint * sun[3 + c]


@device_function
def terms_of(r, row, column, picture, depth, m, lens, schlick_law, image_shift, phong,
             glint_variance, sun):  # fmt: skip
    """Return what shows through the water of a record (three numbers), the mirrored share, glint.

    The glint is per irradiance of the sun; the parameters are those of `lay_water`.
    """
    vx, vy, vz, deep, gx, gy = r[3], r[4], r[5], r[7], r[10], r[11]
    ux, uy, uz = normal_of(gx, gy)
    cosine = max(-(vx * ux + vy * uy + vz * uz), LEAST_COSINE)
    share = schlick(cosine) if schlick_law else fresnel(cosine)
    u, v = np.float32(column) + HALF, np.float32(row) + HALF
    if image_shift:
        bu, bv = shifted(m, lens, ux, uy, uz, deep, r[6], u, v)
        travel = ZERO  # the paper's water is clear
    else:
        # Where on the bed does the bent view ray end, and what was seen there?
        qx, qy, qz = refracted(vx, vy, vz, ux, uy, uz, cosine)
        path = deep / max(-qz, np.float32(0.1))
        t = r[6] / column_of(m, 2, vx, vy, vz)
        bu, bv = bed_seen_at(
            depth, m, lens, t * vx + path * qx, t * vy + path * qy, t * vz + path * qz, u, v
        )
        travel = path + deep  # down along the view, up again straight to the sky
    b0, b1, b2 = bilinear_color(picture, bu, bv)
    glint = ZERO
    if sun[3] + sun[4] + sun[5] > ZERO and phong:
        glint = share * phong_highlight(vx, vy, vz, sun[0], sun[1], sun[2], ux, uy, uz)
    elif sun[3] + sun[4] + sun[5] > ZERO:
        glint = sun_glint(
            vx, vy, vz, sun[0], sun[1], sun[2], gx, gy, glint_variance + r[12],
            glint_variance + r[13], r[14],
        )  # fmt: skip
    return (
        b0 * exp_minus(ABSORB_R * travel), b1 * exp_minus(ABSORB_G * travel),
        b2 * exp_minus(ABSORB_B * travel), share, glint,
    )  # fmt: skip


@inlined_function
def normal_of(gx, gy):
    """Return the unit normal of a surface with slopes gx and gy."""
    inv = ONE / math.sqrt(ONE + gx * gx + gy * gy)
    return -gx * inv, -gy * inv, inv


@inlined_function
def column_of(matrix, i, x, y, z):
    """Return component i of a ground-frame vector in the camera frame."""
    return matrix[0, i] * x + matrix[1, i] * y + matrix[2, i] * z


@device_function
def refracted(vx, vy, vz, ux, uy, uz, cosine):
    """Return the direction v bent into water at the normal u (Snell); v.u = -cosine."""
    eta = ONE / REFRACTIVE_INDEX
    bend = eta * cosine - math.sqrt(ONE - eta * eta * (ONE - cosine * cosine))
    return eta * vx + bend * ux, eta * vy + bend * uy, eta * vz + bend * uz


@device_function
def shifted(m, lens, ux, uy, uz, deep, distance, u, v):
    """Return the image point that the paper (RainyGS) shows through water, by shifting the image.

    I_src(u + k n_u, v + k n_v), n the normal on the screen, k "proportional to the water depth".
    The paper gives no factor: with (1 - 1/n) it is Snell's law for steep views.
    """
    k = SHIFT_PER_DEPTH * deep / distance
    return (
        u - lens[0] * k * column_of(m, 0, ux, uy, uz),
        v - lens[1] * k * column_of(m, 1, ux, uy, uz),
    )


@device_function
def bed_seen_at(depth, m, lens, x, y, z, u0, v0):
    """Return where the bed point at ground-frame offset (x, y, z) from the eye shows.

    The pixel itself, at (u0, v0), if foreground or the picture's edge hides it.
    """
    ez = column_of(m, 2, x, y, z)
    if ez < NEAREST:
        return u0, v0
    u = lens[0] * column_of(m, 0, x, y, z) / ez + lens[2]
    v = lens[1] * column_of(m, 1, x, y, z) / ez + lens[3]
    height, width = depth.shape
    if not (u >= ZERO and v >= ZERO and u < np.float32(width) and v < np.float32(height)):
        return u0, v0
    if ez - depth[int(v), int(u)] > REFRACT_TOLERANCE:
        return u0, v0
    return u, v


@device_function
def phong_highlight(vx, vy, vz, lx, ly, lz, ux, uy, uz):
    """Return the paper's highlight (n.h)^p (Blinn and Phong) of a sun in direction l."""
    hx, hy, hz = lx - vx, ly - vy, lz - vz
    inv = ONE / max(math.sqrt(hx * hx + hy * hy + hz * hz), np.float32(1e-6))
    return max((ux * hx + uy * hy + uz * hz) * inv, ZERO) ** PHONG_EXPONENT


@device_function
def sun_glint(vx, vy, vz, lx, ly, lz, gx, gy, xx, yy, xy):
    """Return the radiance of the sun's glint over its irradiance.

    Cox and Munk 1954: F p(slope) / (4 cos(view) n_z^4), with a Gaussian slope density about the
    pixel's mean slope (gx, gy), of variances xx and yy and covariance xy.
    """
    hx, hy, hz = lx - vx, ly - vy, lz - vz
    inv = ONE / max(math.sqrt(hx * hx + hy * hy + hz * hz), np.float32(1e-6))
    hx, hy, hz = hx * inv, hy * inv, hz * inv
    if hz < np.float32(0.05) or lz <= ZERO:
        return ZERO
    ex, ey = -hx / hz - gx, -hy / hz - gy
    spread = max(xx * yy - xy * xy, np.float32(1e-14))
    away = (yy * ex * ex - TWO * xy * ex * ey + xx * ey * ey) / spread
    density = math.exp(-HALF * away) / (np.float32(2 * np.pi) * math.sqrt(spread))
    f = fresnel(-(vx * hx + vy * hy + vz * hz))
    n4 = hz * hz * hz * hz
    return f * density / (np.float32(4) * max(-vz, np.float32(0.05)) * n4)
