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
FOUR = np.float32(4)
HALF = np.float32(0.5)

# Absorption of puddle water [1/m], red, green, blue. Clean water takes .35, .07, .02 (Pope and Fry
# 1997); puddles hold fine soil, which takes blue most. No measurement of it is used here: a guess.
ABSORB_R, ABSORB_G, ABSORB_B = np.float32(5), np.float32(5.5), np.float32(7)
NOT_GROUND = np.float32(0.03)  # m over the bed: what stands higher can be reflected
HIDE_LOW, HIDE_HIGH = np.float32(0.004), np.float32(0.014)  # m above water: hides it, softly
EDGE_SHARE = np.float32(0.06)  # of the picture, over which reflections fade to the surroundings
LEAST_DIP = np.float32(-0.01)  # rays flatter than this meet water in the haze, if at all
LEAST_COVERAGE = np.float32(0.004)  # a smaller share does not change an 8-bit picture
LEAST_COSINE = np.float32(0.02)
MOST_SLANT = np.float32(6)  # of the pixel's footprint on the water over its width
RIPPLE_LOW, RIPPLE_HIGH = np.float32(0.0008), np.float32(0.004)  # m of water: none, full rings
RIPPLE_REST = np.float32(0.07)  # share of the rings that runs in under cover
NEAREST = np.float32(0.05)  # m
LEAST_ROUGHNESS = np.float32(0.003)  # rms slope below which a mirror is smooth
ROUGH_SAMPLES = 7  # one in the middle, six around: the variance of the slopes is kept
_RING = 2 * np.pi * np.arange(6) / 6
_RADIUS = np.sqrt(2 * 7 / 6)
ROUGH_X = np.append(0, _RADIUS * np.cos(_RING)).astype(np.float32)
ROUGH_Y = np.append(0, _RADIUS * np.sin(_RING)).astype(np.float32)
MIRROR_FAR = np.float32(100)  # m, stands for the sky's distance
REFRACT_TOLERANCE = np.float32(0.04)  # m: what lies nearer than the bed by more is foreground


@device_function
def tile_level(footprint, cell):
    """Return which resolution of the ripple tile a pixel of `footprint` [m] can show, 0 to 4.

    A wave needs two pixels, so the finest cells that are used are as wide as one.
    """
    return min(math.log2(max(footprint / cell, ONE)), FOUR)


@device_function
def hidden_slope(rms_slopes, level):
    """Return the root mean square slope, along one axis, that `level` of the tile does not hold."""
    i = min(int(level), 3)
    f = level - np.float32(i)
    coarse = rms_slopes[i + 1] if i < 3 else ZERO
    held = rms_slopes[i] + (coarse - rms_slopes[i]) * f
    return math.sqrt(max(rms_slopes[0] * rms_slopes[0] - held * held, ZERO))


@device_function
def sample_tile(level0, level1, level2, level3, x, y, size, level, axis):
    """Return a slope of the ripple tile at ground point (x, y) at a resolution of 0 to 4.

    The levels hold the same tile, each at half the resolution of the one before; 4 is flat.
    """
    if level >= THREE:
        return _tile(level3, x, y, size, axis) * (FOUR - level)
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
    i, j = math.floor(u), math.floor(v)
    a, b = u - np.float32(i), v - np.float32(j)
    i0, j0 = i % n, j % n
    i1, j1 = (i0 + 1) % n, (j0 + 1) % n
    lower = slopes[axis, j0, i0] * (ONE - a) + slopes[axis, j0, i1] * a
    upper = slopes[axis, j1, i0] * (ONE - a) + slopes[axis, j1, i1] * a
    return lower * (ONE - b) + upper * b


@cpu_kernel
def shade_water(
    picture, depth, clearance, ground_from_camera, eye, lens,
    surface, water_depth, exposure_to_rain, origin, spacing,
    slopes0, slopes1, slopes2, slopes3, rms_slopes, tile_size, environment, mirrored, mirror,
    mirror_depth, settings, sun, picture_out, coverage_out,
):  # fmt: skip
    """Lay the water over the wet picture: surface hit, reflection, refraction, Fresnel.

    Parameters
    ----------
    picture, depth, clearance
        As `shade.grade_and_wet` left them.
    surface : ndarray of shape (ny, nx), float32 [m]
        Height of the water surface, continued below the ground beside the water.
    water_depth : ndarray of shape (ny, nx), float32 [m]
    slopes0 to slopes3 : ndarray of shape (2, n, n), float32
        Ripple slopes d eta/dx, d eta/dy on a periodic tile of `tile_size` [m], each level half.
    rms_slopes : ndarray of shape (4,), float32
        Root mean square slope along one axis that each level holds.
    mirrored : bool
        Whether reflections come from the mirrored pass; if not, from the march.
    mirror : ndarray of shape (height, width, 3), float32
        The wet picture that the camera's mirror image sees of what stands above the water.
    mirror_depth : ndarray of shape (height, width), float32 [m]
        Its depth along the view axis.
    settings : ndarray of shape (7,), float32
        Water depth [m] where coverage begins and is full; thickness [m], stride [px] and length
        [m] of the march; variance of the slopes below a pixel; level [m] of the mirror.
    sun : ndarray of shape (6,), float32
        Direction to the sun and its irradiance in three channels; zero for no sun.
    coverage_out : ndarray of shape (height, width), float32
        Share of the pixel that mirrors.
    """
    height, width = depth.shape
    ny, nx = surface.shape
    m = ground_from_camera
    tall = np.empty((height, width), np.float32)
    for row in prange(height):
        for column in range(width):
            # Level water cannot mirror the ground it lies on.
            low = clearance[row, column] < NOT_GROUND
            tall[row, column] = np.inf if low else depth[row, column]
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
            if z > LEAST_DIP:
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
            coverage = smoothstep(settings[0], settings[1], deep)
            # Hidden by what the picture shows above the water, softly at the contact.
            shown = eye[2] + depth[row, column] * z  # height of the scene in this pixel
            coverage *= ONE - smoothstep(HIDE_LOW, HIDE_HIGH, shown - sz)
            if not coverage > LEAST_COVERAGE:
                continue
            length = math.sqrt(x * x + y * y + z * z)
            vx, vy, vz = x / length, y / length, z / length
            # Ripples: none in a film, few where little rain falls, none below the pixels.
            slant = min(length / -z, MOST_SLANT)
            grow = smoothstep(RIPPLE_LOW, RIPPLE_HIGH, deep)
            grow *= RIPPLE_REST + (ONE - RIPPLE_REST) * bilinear(exposure_to_rain, u, v)
            gx, gy, rough = ZERO, ZERO, ZERO
            if grow > ZERO:
                scale = tile_level(t * length / lens[0] * slant, tile_size / slopes0.shape[1])
                gx = grow * sample_tile(
                    slopes0, slopes1, slopes2, slopes3, sx, sy, tile_size, scale, 0
                )
                gy = grow * sample_tile(
                    slopes0, slopes1, slopes2, slopes3, sx, sy, tile_size, scale, 1
                )
                rough = grow * hidden_slope(rms_slopes, scale)
            inv = ONE / math.sqrt(ONE + gx * gx + gy * gy)
            ux, uy, uz = -gx * inv, -gy * inv, inv  # the surface's normal
            cosine = max(-(vx * ux + vy * uy + vz * uz), LEAST_COSINE)
            mirror_share = fresnel(cosine)
            cx = _column(m, 0, sx - eye[0], sy - eye[1], sz - eye[2])
            cy = _column(m, 1, sx - eye[0], sy - eye[1], sz - eye[2])
            cz = _column(m, 2, sx - eye[0], sy - eye[1], sz - eye[2])
            distance = -ONE
            if mirrored:
                distance = min(mirror_depth[row, column], MIRROR_FAR) - t
                distance = max(distance * length, ZERO)
            else:
                distance = march(
                    tall, lens, cx, cy, cz, _column(m, 0, vx, vy, -vz), _column(m, 1, vx, vy, -vz),
                    _column(m, 2, vx, vy, -vz), settings[2], settings[3], settings[4],
                )  # fmt: skip
            # Slopes that the picture cannot resolve blur what is mirrored.
            samples = 1 if rough < LEAST_ROUGHNESS else ROUGH_SAMPLES
            light0, light1, light2 = ZERO, ZERO, ZERO
            for sample in range(samples):
                sx_, sy_ = gx, gy
                if samples > 1:
                    sx_ += rough * ROUGH_X[sample]
                    sy_ += rough * ROUGH_Y[sample]
                inv = ONE / math.sqrt(ONE + sx_ * sx_ + sy_ * sy_)
                rx, ry, rz = reflected_upwards(vx, vy, vz, -sx_ * inv, -sy_ * inv, inv)
                if mirrored:
                    hu, hv = _in_mirror(m, lens, settings[6], eye, distance, sx, sy, sz, rx, ry, rz)
                    light0 += bilinear_color(mirror, hu, hv, 0)
                    light1 += bilinear_color(mirror, hu, hv, 1)
                    light2 += bilinear_color(mirror, hu, hv, 2)
                    continue
                hu, hv, found = _on_screen(
                    tall, m, lens, cx, cy, cz, vx, vy, -vz, rx, ry, rz, distance, settings[2]
                )
                if found < ONE:
                    light0 += (ONE - found) * sample_environment(environment, rx, ry, rz, 0)
                    light1 += (ONE - found) * sample_environment(environment, rx, ry, rz, 1)
                    light2 += (ONE - found) * sample_environment(environment, rx, ry, rz, 2)
                if found > ZERO:
                    light0 += found * bilinear_color(picture, hu, hv, 0)
                    light1 += found * bilinear_color(picture, hu, hv, 1)
                    light2 += found * bilinear_color(picture, hu, hv, 2)
            share = ONE / np.float32(samples)
            light0, light1, light2 = light0 * share, light1 * share, light2 * share
            # Refraction: where on the bed does the bent view ray end, and what was seen there?
            eta = ONE / REFRACTIVE_INDEX
            k = ONE - eta * eta * (ONE - cosine * cosine)
            bend = eta * cosine - math.sqrt(k)
            qx, qy, qz = eta * vx + bend * ux, eta * vy + bend * uy, eta * vz + bend * uz
            path = deep / max(-qz, np.float32(0.1))
            bu, bv = _bed_seen_at(
                depth, m, lens, cx, cy, cz, qx * path, qy * path, qz * path,
                np.float32(column) + HALF, np.float32(row) + HALF,
            )  # fmt: skip
            glint = ZERO
            if sun[3] + sun[4] + sun[5] > ZERO:
                glint = sun_glint(vx, vy, vz, sun[0], sun[1], sun[2], gx, gy, settings[5])
            travel = path + deep  # down along the view, up again straight to the sky
            for c in range(3):
                absorb = ABSORB_R if c == 0 else (ABSORB_G if c == 1 else ABSORB_B)
                light = light0 if c == 0 else (light1 if c == 1 else light2)
                below = bilinear_color(picture, bu, bv, c) * math.exp(-absorb * travel)
                value = (ONE - mirror_share) * below + mirror_share * light + glint * sun[3 + c]
                picture_out[row, column, c] += coverage * (value - picture_out[row, column, c])
            coverage_out[row, column] = coverage


@device_function
def reflected_upwards(vx, vy, vz, ux, uy, uz):
    """Return the unit view direction v mirrored at the unit normal u, turned up if it goes down.

    A ripple that faces so far away that its mirror ray goes down mirrors the ripple before it,
    which mirrors the low sky.
    """
    dot = TWO * (vx * ux + vy * uy + vz * uz)
    rx, ry, rz = vx - dot * ux, vy - dot * uy, vz - dot * uz
    if rz < LEAST_COSINE:
        rz = LEAST_COSINE
        inv = ONE / math.sqrt(rx * rx + ry * ry + rz * rz)
        rx, ry, rz = rx * inv, ry * inv, rz * inv
    return rx, ry, rz


@device_function
def _in_mirror(m, lens, level, eye, distance, sx, sy, sz, rx, ry, rz):
    """Return where the mirrored picture shows the end of a ray r from surface point s.

    The end, mirrored at `level`, is where the mirrored camera sees it.
    """
    ex, ey = sx + distance * rx - eye[0], sy + distance * ry - eye[1]
    ez = TWO * level - (sz + distance * rz) - eye[2]
    pz = max(_column(m, 2, ex, ey, ez), NEAREST)
    u = lens[0] * _column(m, 0, ex, ey, ez) / pz + lens[2]
    return u, lens[1] * _column(m, 1, ex, ey, ez) / pz + lens[3]


@device_function
def _on_screen(tall, m, lens, cx, cy, cz, fx, fy, fz, rx, ry, rz, distance, thickness):
    """Return where the picture shows what the mirror ray meets, and the share to take from there.

    `distance` is what the march of the flat surface's ray f found. The end is moved to where the
    bent ray r ends at that distance, if that is seen too: marching bent rays gives noise.
    """
    if not distance > ZERO:
        return ZERO, ZERO, ZERO
    hu, hv, found = _seen_at(tall, m, lens, cx, cy, cz, rx, ry, rz, distance, thickness)
    if found <= ZERO:
        hu, hv, found = _seen_at(tall, m, lens, cx, cy, cz, fx, fy, fz, distance, thickness)
    return hu, hv, found


@device_function
def _column(matrix, i, x, y, z):
    """Return component i of a ground-frame vector in the camera frame."""
    return matrix[0, i] * x + matrix[1, i] * y + matrix[2, i] * z


@device_function
def _seen_at(depth, m, lens, cx, cy, cz, rx, ry, rz, distance, thickness):
    """Return where the end of a ray of length `distance` shows, and how far to trust it.

    The ray starts at camera point (cx, cy, cz) and goes along the ground-frame direction r. Trust
    is 0 if something in front hides the end, and falls to 0 at the picture's edge.
    """
    ex = cx + distance * _column(m, 0, rx, ry, rz)
    ey = cy + distance * _column(m, 1, rx, ry, rz)
    ez = cz + distance * _column(m, 2, rx, ry, rz)
    if ez < NEAREST:
        return ZERO, ZERO, ZERO
    h, w = np.float32(depth.shape[0]), np.float32(depth.shape[1])
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
    if ez < NEAREST:
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
    density = math.exp(-HALF * (ex * ex + ey * ey) / variance) / (np.float32(2 * np.pi) * variance)
    f = fresnel(-(vx * hx + vy * hy + vz * hz))
    n4 = hz * hz * hz * hz
    return f * density / (np.float32(4) * max(-vz, np.float32(0.05)) * n4)
