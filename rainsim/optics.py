"""Light on water: where it lies in the picture, what it mirrors and what shows through it."""

from __future__ import annotations

import math

import numpy as np

from rainsim.jit import cpu_kernel, device_function, prange
from rainsim.light import REFRACTIVE_INDEX, bilinear, bilinear_color, fresnel, smoothstep
from rainsim.shade import FAR_AWAY
from rainsim.sky import sample_environment
from rainsim.ssr import edge_fade, march

ZERO = np.float32(0)
ONE = np.float32(1)
TWO = np.float32(2)
THREE = np.float32(3)
HALF = np.float32(0.5)

# Absorption of clear water with some silt [1/m], red, green, blue. Clean water takes .35, .07, .02
# (Pope and Fry 1997); puddle water is turbid, and no measurement of it is used here: a guess.
ABSORB_R, ABSORB_G, ABSORB_B = np.float32(9), np.float32(6), np.float32(5)
NOT_GROUND = np.float32(0.03)  # m over the bed: what stands higher can be reflected
HIDE_LOW, HIDE_HIGH = np.float32(0.004), np.float32(0.014)  # m above water: hides it, softly
EDGE_SHARE = np.float32(0.06)  # of the picture, over which reflections fade to the surroundings
REFRACT_TOLERANCE = np.float32(0.04)  # m: what lies nearer than the bed by more is foreground


@device_function
def sample_tile(level0, level1, level2, level3, x, y, size, footprint, axis):
    """Return a slope of the ripple tile at ground point (x, y), filtered to `footprint` [m].

    The levels hold the same tile, each at half the resolution of the one before.
    """
    cell = size / np.float32(level0.shape[1])
    scale = max(footprint / cell, ONE)
    level = math.log2(scale)
    if level >= THREE:  # coarser than the coarsest: fade out
        return _tile(level3, x, y, size, axis) * max(ONE - (level - THREE), ZERO)
    if level >= TWO:
        f = level - TWO
        return _tile(level2, x, y, size, axis) * (ONE - f) + _tile(level3, x, y, size, axis) * f
    if level >= ONE:
        f = level - ONE
        return _tile(level1, x, y, size, axis) * (ONE - f) + _tile(level2, x, y, size, axis) * f
    return _tile(level0, x, y, size, axis) * (ONE - level) + _tile(level1, x, y, size, axis) * level


@device_function
def _tile(slopes, x, y, size, axis):
    n = slopes.shape[1]
    u, v = x / size * np.float32(n) - HALF, y / size * np.float32(n) - HALF
    i, j = int(math.floor(u)), int(math.floor(v))
    a, b = u - np.float32(i), v - np.float32(j)
    i0, j0 = i % n, j % n
    i1, j1 = (i0 + 1) % n, (j0 + 1) % n
    lower = slopes[axis, j0, i0] * (ONE - a) + slopes[axis, j0, i1] * a
    upper = slopes[axis, j1, i0] * (ONE - a) + slopes[axis, j1, i1] * a
    return lower * (ONE - b) + upper * b


@cpu_kernel
def shade_water(
    picture, depth, clearance, ground_from_camera, eye, lens,
    surface, water_depth, bed, exposure_to_rain, origin, spacing,
    slopes0, slopes1, slopes2, slopes3, tile_size, environment, optics, sun,
    picture_out, coverage_out,
):  # fmt: skip
    """Lay the water over the wet picture: surface hit, reflection, refraction, Fresnel.

    Parameters
    ----------
    picture, depth, clearance
        As `grade_and_wet` left them.
    surface : ndarray of shape (ny, nx), float32 [m]
        Height of the water surface, continued below the ground beside the water.
    water_depth : ndarray of shape (ny, nx), float32 [m]
    slopes0 to slopes3 : ndarray of shape (2, n, n), float32
        Ripple slopes d eta/dx, d eta/dy on a periodic tile of `tile_size` [m], each level half.
    optics : ndarray of shape (6,), float32
        Water depth [m] where coverage begins and is full, thickness [m], stride [px] and length
        [m] of the reflection's march, variance of the slopes below a pixel.
    sun : ndarray of shape (6,), float32
        Direction to the sun and its irradiance in three channels; zero for no sun.
    coverage_out : ndarray of shape (height, width), float32
        Share of the pixel that mirrors.
    """
    height, width = depth.shape
    ny, nx = surface.shape
    w, h = np.float32(width), np.float32(height)
    m = ground_from_camera
    reflectable = np.empty((height, width), np.float32)
    for row in prange(height):
        for column in range(width):
            # Level water cannot mirror the ground it lies on.
            low = clearance[row, column] < NOT_GROUND
            reflectable[row, column] = np.inf if low else depth[row, column]
    for row in prange(height):
        for column in range(width):
            for c in range(3):
                picture_out[row, column, c] = picture[row, column, c]
            coverage_out[row, column] = ZERO
            a = (np.float32(column) + HALF - lens[2]) / lens[0]
            b = (np.float32(row) + HALF - lens[3]) / lens[1]
            x = m[0, 0] * a + m[0, 1] * b + m[0, 2]
            y = m[1, 0] * a + m[1, 1] * b + m[1, 2]
            z = m[2, 0] * a + m[2, 1] * b + m[2, 2]
            if z > np.float32(-0.01):
                continue
            # The water surface is nearly level: a few fixed-point steps meet it.
            t = (surface[ny // 2, nx // 2] - eye[2]) / z
            u, v = ZERO, ZERO
            for _ in range(4):
                u = (eye[0] + t * x - origin[0]) / spacing - HALF
                v = (eye[1] + t * y - origin[1]) / spacing - HALF
                t = (bilinear(surface, u, v) - eye[2]) / z
            sx, sy, sz = eye[0] + t * x, eye[1] + t * y, eye[2] + t * z
            u, v = (sx - origin[0]) / spacing - HALF, (sy - origin[1]) / spacing - HALF
            if not (t > ZERO and u > ONE and v > ONE):
                continue
            if u > np.float32(nx - 2) or v > np.float32(ny - 2):
                continue
            deep = bilinear(water_depth, u, v)
            coverage = smoothstep(optics[0], optics[1], deep)
            # Hidden by what the picture shows above the water, softly at the contact.
            shown = eye[2] + depth[row, column] * z  # height of the scene in this pixel
            coverage *= ONE - smoothstep(HIDE_LOW, HIDE_HIGH, shown - sz)
            if not coverage > np.float32(0.004):
                continue
            length = math.sqrt(x * x + y * y + z * z)
            il = ONE / length
            vx, vy, vz = x * il, y * il, z * il
            # Ripples: none in a film, none where no rain falls, none below the pixels.
            slant = min(length / max(-z, np.float32(0.05)), np.float32(6))
            footprint = t * length / lens[0] * slant
            rain = bilinear(exposure_to_rain, u, v)
            grow = smoothstep(np.float32(0.0008), np.float32(0.004), deep)
            grow *= np.float32(0.07) + np.float32(0.93) * rain
            gx = grow * sample_tile(
                slopes0, slopes1, slopes2, slopes3, sx, sy, tile_size, footprint, 0
            )
            gy = grow * sample_tile(
                slopes0, slopes1, slopes2, slopes3, sx, sy, tile_size, footprint, 1
            )
            inv = ONE / math.sqrt(ONE + gx * gx + gy * gy)
            nx_, ny_, nz_ = -gx * inv, -gy * inv, inv
            cosine = max(-(vx * nx_ + vy * ny_ + vz * nz_), np.float32(0.02))
            mirror = fresnel(cosine)
            # Reflected ray of the flat surface, marched; then bent by the ripple.
            cx = _column(m, 0, sx - eye[0], sy - eye[1], sz - eye[2])
            cy = _column(m, 1, sx - eye[0], sy - eye[1], sz - eye[2])
            cz = _column(m, 2, sx - eye[0], sy - eye[1], sz - eye[2])
            fx, fy, fz = vx, vy, -vz
            distance = march(
                reflectable, lens, cx, cy, cz,
                _column(m, 0, fx, fy, fz),
                _column(m, 1, fx, fy, fz),
                _column(m, 2, fx, fy, fz),
                optics[2], optics[3], optics[4],
            )  # fmt: skip
            dot = TWO * (vx * nx_ + vy * ny_ + vz * nz_)
            rx, ry, rz = vx - dot * nx_, vy - dot * ny_, vz - dot * nz_
            if rz < np.float32(0.02):  # a ripple that faces away mirrors the ripple before it
                rz = np.float32(0.02)
                inv = ONE / math.sqrt(rx * rx + ry * ry + rz * rz)
                rx, ry, rz = rx * inv, ry * inv, rz * inv
            screen = ZERO
            hu, hv = ZERO, ZERO
            if distance > ZERO:
                hu, hv, screen = _seen_at(
                    reflectable, m, lens, cx, cy, cz, rx, ry, rz, distance, optics[2], w, h
                )
                if screen <= ZERO:  # the bent ray sees something else: keep to the flat one
                    hu, hv, screen = _seen_at(
                        reflectable, m, lens, cx, cy, cz, fx, fy, fz, distance, optics[2], w, h
                    )
            # Refraction: where on the bed does the bent view ray end, and what was seen there?
            eta = ONE / REFRACTIVE_INDEX
            k = ONE - eta * eta * (ONE - cosine * cosine)
            bend = eta * cosine - math.sqrt(k)
            qx, qy, qz = eta * vx + bend * nx_, eta * vy + bend * ny_, eta * vz + bend * nz_
            path = deep / max(-qz, np.float32(0.1))
            bu, bv = _bed_seen_at(
                depth, m, lens, cx, cy, cz, qx * path, qy * path, qz * path,
                np.float32(column) + HALF, np.float32(row) + HALF,
            )  # fmt: skip
            glint = ZERO
            if sun[3] + sun[4] + sun[5] > ZERO:
                glint = sun_glint(vx, vy, vz, sun[0], sun[1], sun[2], gx, gy, optics[5])
            travel = path + deep  # down along the view, up again straight to the sky
            for c in range(3):
                absorb = ABSORB_R if c == 0 else (ABSORB_G if c == 1 else ABSORB_B)
                reflected = ZERO
                if screen < ONE:
                    reflected = (ONE - screen) * sample_environment(environment, rx, ry, rz, c)
                if screen > ZERO:
                    reflected += screen * bilinear_color(picture, hu, hv, c)
                below = bilinear_color(picture, bu, bv, c) * math.exp(-absorb * travel)
                value = (ONE - mirror) * below + mirror * reflected + glint * sun[3 + c]
                picture_out[row, column, c] += coverage * (value - picture_out[row, column, c])
            coverage_out[row, column] = coverage


@device_function
def _column(matrix, i, x, y, z):
    """Return component i of a ground-frame vector in the camera frame."""
    return matrix[0, i] * x + matrix[1, i] * y + matrix[2, i] * z


@device_function
def _seen_at(depth, m, lens, cx, cy, cz, rx, ry, rz, distance, thickness, w, h):
    """Return where the end of a ray of length `distance` shows, and how far to trust it.

    The ray starts at camera point (cx, cy, cz) and goes along the ground-frame direction r. Trust
    is 0 if something in front hides the end, and falls to 0 at the picture's edge.
    """
    ex = cx + distance * _column(m, 0, rx, ry, rz)
    ey = cy + distance * _column(m, 1, rx, ry, rz)
    ez = cz + distance * _column(m, 2, rx, ry, rz)
    if ez < np.float32(0.05):
        return ZERO, ZERO, ZERO
    u, v = lens[0] * ex / ez + lens[2], lens[1] * ey / ez + lens[3]
    if not (u >= ZERO and v >= ZERO and u < w and v < h):
        return ZERO, ZERO, ZERO
    there = depth[int(v), int(u)]
    if ez - there > thickness + distance * np.float32(0.3):
        return ZERO, ZERO, ZERO
    if not there < FAR_AWAY:
        return ZERO, ZERO, ZERO
    return u, v, edge_fade(u, v, w, h, EDGE_SHARE)


@device_function
def _bed_seen_at(depth, m, lens, cx, cy, cz, dx, dy, dz, u0, v0):
    """Return where the bed point at camera point c plus ground-frame offset d shows in the picture.

    The pixel itself, if foreground or the picture's edge hides it.
    """
    ex = cx + _column(m, 0, dx, dy, dz)
    ey = cy + _column(m, 1, dx, dy, dz)
    ez = cz + _column(m, 2, dx, dy, dz)
    if ez < np.float32(0.05):
        return u0, v0
    u, v = lens[0] * ex / ez + lens[2], lens[1] * ey / ez + lens[3]
    height, width = depth.shape
    if not (u >= ZERO and v >= ZERO and u < np.float32(width) and v < np.float32(height)):
        return u0, v0
    if ez - depth[int(v), int(u)] > REFRACT_TOLERANCE:
        return u0, v0
    return u, v


@device_function
def sun_glint(vx, vy, vz, lx, ly, lz, gx, gy, variance):
    """Return the radiance of the sun's glint over its irradiance.

    Cox and Munk 1954: F p(slope) / (4 cos(view) n_z^4), with a Gaussian slope density of `variance`
    about the slope (gx, gy) that the pixel resolves.
    """
    hx, hy, hz = lx - vx, ly - vy, lz - vz
    inv = ONE / max(math.sqrt(hx * hx + hy * hy + hz * hz), np.float32(1e-6))
    hx, hy, hz = hx * inv, hy * inv, hz * inv
    if hz < np.float32(0.05) or lz <= ZERO:
        return ZERO
    ex, ey = -hx / hz - gx, -hy / hz - gy
    density = math.exp(-HALF * (ex * ex + ey * ey) / variance) / (
        np.float32(2 * np.pi) * variance
    )
    f = fresnel(-(vx * hx + vy * hy + vz * hz))
    n4 = hz * hz * hz * hz
    return f * density / (np.float32(4) * max(-vz, np.float32(0.05)) * n4)
