"""Twins of `rainsim.optics` and `rainsim.reflect`: the water in a picture, found and lit.

On the CPU the water's pixels are a list; here each pixel is a thread, so `shade_water` does for its
own pixel what list_water, tilt_water, mirror_light or march_light, and lay_water do there.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.cuda.jit import SIMULATED, cuda, cuda_device, cuda_kernel
from rainsim.light import (
    bilinear,
    bilinear_color,
    exp_minus,
    fresnel,
    pixel_ray,
    schlick,
    smoothstep,
)
from rainsim.meeting import HIDE_HIGH, LEAST_COVERAGE, LEAST_DIP, covered, meet_surface
from rainsim.moments import pixel_slopes
from rainsim.optics import (
    ABSORB_B,
    ABSORB_G,
    ABSORB_R,
    HALF,
    LEAST_COSINE,
    ONE,
    RIPPLE_HIGH,
    RIPPLE_LOW,
    RIPPLE_REST,
    ZERO,
    bed_seen_at,
    column_of,
    normal_of,
    phong_highlight,
    refracted,
    shifted,
    sun_glint,
)
from rainsim.pyramid import blurred_color
from rainsim.reflect import (
    NOT_GROUND,
    SPREAD,
    blur_of,
    march_mirror,
    on_screen,
    sample_ray,
    samples_of,
)
from rainsim.sky import sample_environment
from rainsim.ssr import BLOCK, joined_at, march
from rainsim.waterview import MIRROR_STEPS, MIRROR_THICKNESS

LEAST_DROP = np.float32(0.1)
THICKNESS = np.float32(MIRROR_THICKNESS)
NOWHERE = np.float32(np.inf)
WIDE = 32  # threads of a row of `keep_tall`; BLOCK such rows are a block of them
PATCH = (8, 4) if SIMULATED else (8, 32)  # threads of a block of `find_hits`: a warp has 8 x 4
JOINERS = 32 if SIMULATED else 128  # threads of a block of `join_bounds`


@cuda_kernel
def keep_tall(depth, clearance, tall_out, bounds_out):
    """Keep the depth of what water can mirror; see `rainsim.reflect`, `rainsim.ssr.block_bounds`.

    A block of threads takes a row of blocks of pixels.
    """
    lows = cuda.shared.array((BLOCK, WIDE), np.float32)
    highs = cuda.shared.array((BLOCK, WIDE), np.float32)
    column, row = cuda.grid(2)
    x, y = cuda.threadIdx.x, cuda.threadIdx.y
    height, width = depth.shape
    low, high = NOWHERE, -NOWHERE
    if row < height and column < width:
        value = NOWHERE if clearance[row, column] < NOT_GROUND else depth[row, column]
        tall_out[row, column] = value
        if value < NOWHERE:
            low, high = value, value
    lows[y, x], highs[y, x] = low, high
    cuda.syncthreads()
    if y == 0:
        for k in range(1, BLOCK):
            low, high = min(low, lows[k, x]), max(high, highs[k, x])
        lows[0, x], highs[0, x] = low, high
    cuda.syncthreads()
    if y == 0 and x % BLOCK == 0 and row < height and column < width:
        for k in range(1, BLOCK):
            low, high = min(low, lows[0, x + k]), max(high, highs[0, x + k])
        at = (row // BLOCK) * ((width + BLOCK - 1) // BLOCK) + column // BLOCK
        bounds_out[at, 0], bounds_out[at, 1] = low, high


@cuda_kernel
def join_bounds(height, width, bounds_out):
    """Write the bounds of blocks with their neighbours and of wide ones: see `block_bounds`."""
    rows, columns = (height + BLOCK - 1) // BLOCK, (width + BLOCK - 1) // BLOCK
    at = rows * columns + cuda.grid(1)
    if at < bounds_out.shape[0]:
        low, high = joined_at(bounds_out, rows, columns, at)
        bounds_out[at, 0], bounds_out[at, 1] = low, high


@cuda_kernel
def meet_water(
    depth, ground_from_camera, eye, lens, surface, water_depth, origin, spacing, highest, cover,
    hard, hit_out, coverage_out,
):  # fmt: skip
    """Find where each pixel's ray meets the water and how much it covers; see `rainsim.meeting`."""
    column, row = cuda.grid(2)
    height, width = depth.shape
    if row >= height or column >= width:
        return
    ny, nx = surface.shape
    m, top = ground_from_camera, highest[0]
    coverage_out[row, column] = ZERO
    x, y, z = pixel_ray(m, lens, row, column)
    there = depth[row, column]
    if z > LEAST_DIP or eye[2] + there * z > top + HIDE_HIGH:
        return
    t, u, v = meet_surface(surface, origin, spacing, eye, x, y, z, top)
    if not (t > ZERO and u > ONE and v > ONE):
        return
    if u > np.float32(nx - 2) or v > np.float32(ny - 2):
        return
    deep = bilinear(water_depth, u, v)
    covers = covered(deep, there - t, z, cover[0], cover[1], hard)
    if covers > LEAST_COVERAGE:
        coverage_out[row, column], hit_out[row, column] = covers, t


@cuda_device
def mirror_of(mirror_range, z):
    """Return which mirror serves water at height z [m]; -1: none."""
    for k in range(mirror_range.shape[0]):
        if z >= mirror_range[k, 1] and z < mirror_range[k, 2]:
            return k
    return -1


@cuda_kernel
def find_hits(
    hit, coverage, tall, bounds, ground_from_camera, eye, lens, settings, mirror_range, distance_out
):  # fmt: skip
    """March from the water that no mirror serves; see `rainsim.reflect.march_light`.

    In a kernel of its own, so that many threads are there to wait for memory.

    distance_out : ndarray of shape (height, width), float32 [m]
        What `rainsim.ssr.march` returns; only where it was asked.
    """
    column, row = cuda.grid(2)
    height, width = coverage.shape
    if row >= height or column >= width or coverage[row, column] == ZERO:
        return
    m = ground_from_camera
    x, y, z = pixel_ray(m, lens, row, column)
    t = hit[row, column]
    sx, sy, sz = eye[0] + t * x, eye[1] + t * y, eye[2] + t * z
    if mirror_of(mirror_range, sz) >= 0:
        return
    inv = ONE / math.sqrt(x * x + y * y + z * z)
    vx, vy, vz = x * inv, y * inv, z * inv
    px, py, pz = sx - eye[0], sy - eye[1], sz - eye[2]
    distance_out[row, column] = march(
        tall, bounds, lens, column_of(m, 0, px, py, pz), column_of(m, 1, px, py, pz), t,
        column_of(m, 0, vx, vy, -vz), column_of(m, 1, vx, vy, -vz),
        column_of(m, 2, vx, vy, -vz), settings[0], settings[1], settings[2],
    )  # fmt: skip


@cuda_device
def marched(
    picture, tall, m, lens, environment, thickness, distance, px, py, pz, t, vx, vy, vz,
    gx, gy, xx, yy, xy,
):  # fmt: skip
    """Return the mirrored light found by marching; see `rainsim.reflect.march_light`."""
    cx, cy, cz = column_of(m, 0, px, py, pz), column_of(m, 1, px, py, pz), t
    samples, a, b, c = samples_of(xx, yy, xy, ONE)
    light0, light1, light2 = ZERO, ZERO, ZERO
    for s in range(samples):
        rx, ry, rz = sample_ray(vx, vy, vz, gx, gy, a, b, c, s)
        hu, hv, found = on_screen(
            tall, m, lens, cx, cy, cz, vx, vy, -vz, rx, ry, rz, distance, thickness
        )
        if found < ONE:
            c0, c1, c2 = sample_environment(environment, rx, ry, rz)
            rest = ONE - found
            light0, light1, light2 = light0 + rest * c0, light1 + rest * c1, light2 + rest * c2
        if found > ZERO:
            c0, c1, c2 = bilinear_color(picture, hu, hv)
            light0, light1 = light0 + found * c0, light1 + found * c1
            light2 += found * c2
    share = ONE / np.float32(samples)
    return light0 * share, light1 * share, light2 * share


@cuda_device
def mirrored(
    mirror, coarse, mirror_depth, m, eye, lens, level, sx, sy, sz, vx, vy, vz, gx, gy, xx, yy, xy
):  # fmt: skip
    """Return the light found in the mirrored camera's picture; see `mirrorlight.mirror_light`."""
    samples, a, b, c = samples_of(xx, yy, xy, SPREAD)
    blur = ZERO
    if samples > 1:
        blur = blur_of(m, lens, vx, vy, vz, gx, gy, xx * yy - xy * xy)
    light0, light1, light2 = ZERO, ZERO, ZERO
    for s in range(samples):
        rx, ry, rz = sample_ray(vx, vy, vz, gx, gy, a, b, c, s)
        hu, hv, way = march_mirror(
            m, lens, level, eye, sx, sy, sz, rx, ry, rz, mirror_depth, MIRROR_STEPS, THICKNESS
        )
        c0, c1, c2 = blurred_color(mirror, coarse, hu, hv, blur * way)
        light0, light1, light2 = light0 + c0, light1 + c1, light2 + c2
    share = ONE / np.float32(samples)
    return light0 * share, light1 * share, light2 * share


@cuda_kernel
def shade_water(
    hit, coverage, distance, picture, below, depth, tall, ground_from_camera, eye, lens,
    water_depth, exposure_to_rain, origin, spacing, moments, tile_size, environment, settings,
    mirror_range, mirror_window, mirror, coarse, mirror_depth, schlick_law, image_shift, phong,
    glint_variance, sun, picture_out,
):  # fmt: skip
    """Lay the water over the picture: ripples, what it mirrors, what shows through, the glint.

    Parameters are those of the kernels that this one stands for, and:

    distance : ndarray of shape (height, width), float32 [m]
        As `find_hits` left it.
    mirror_range : ndarray of shape (k, 3), float32 [m]
        Level of each mirror and the heights from which and below which water looks into it; what
        stands elsewhere is marched.
    mirror_window : ndarray of shape (6,), float32
        Lens, columns and rows [px] of the mirrored pictures.
    mirror, mirror_depth : ndarray of shape (k, rows, columns, 3) and (k, rows, columns), float32
    coarse : ndarray of shape (k, rows, columns // 2, 3), float32
    """
    column, row = cuda.grid(2)
    height, width = depth.shape
    if row >= height or column >= width:
        return
    covers = coverage[row, column]
    if covers == ZERO:
        for c in range(3):
            picture_out[row, column, c] = picture[row, column, c]
        return
    m = ground_from_camera
    x, y, z = pixel_ray(m, lens, row, column)
    t = hit[row, column]
    sx, sy, sz = eye[0] + t * x, eye[1] + t * y, eye[2] + t * z
    u, v = (sx - origin[0]) / spacing - HALF, (sy - origin[1]) / spacing - HALF
    deep = bilinear(water_depth, u, v)
    grow = smoothstep(RIPPLE_LOW, RIPPLE_HIGH, deep)
    grow *= RIPPLE_REST + (ONE - RIPPLE_REST) * bilinear(exposure_to_rain, u, v)
    length = math.sqrt(x * x + y * y + z * z)
    inv = ONE / length
    vx, vy, vz = x * inv, y * inv, z * inv
    gx, gy, xx, yy, xy = ZERO, ZERO, ZERO, ZERO, ZERO
    if grow > ZERO:
        gx, gy, xx, yy, xy = pixel_slopes(
            moments, tile_size, sx, sy, vx, vy, vz, t * length / lens[0]
        )
        square = grow * grow
        gx, gy, xx, yy, xy = grow * gx, grow * gy, square * xx, square * yy, square * xy
    which = mirror_of(mirror_range, sz)
    if which >= 0:
        wide, high = int(mirror_window[4]), int(mirror_window[5])
        light0, light1, light2 = mirrored(
            mirror[which, :high, :wide], coarse[which], mirror_depth[which, :high, :wide], m, eye,
            mirror_window, mirror_range[which, 0], sx, sy, sz, vx, vy, vz, gx, gy, xx, yy, xy,
        )  # fmt: skip
    else:
        light0, light1, light2 = marched(
            picture, tall, m, lens, environment, settings[0], distance[row, column], sx - eye[0],
            sy - eye[1], sz - eye[2], t, vx, vy, vz, gx, gy, xx, yy, xy,
        )  # fmt: skip
    ux, uy, uz = normal_of(gx, gy)
    cosine = max(-(vx * ux + vy * uy + vz * uz), LEAST_COSINE)
    share = schlick(cosine) if schlick_law else fresnel(cosine)
    u, v = np.float32(column) + HALF, np.float32(row) + HALF
    travel = ZERO
    if image_shift:
        bu, bv = shifted(m, lens, ux, uy, uz, deep, t, u, v)
    else:
        qx, qy, qz = refracted(vx, vy, vz, ux, uy, uz, cosine)
        path = deep / max(-qz, LEAST_DROP)
        ahead = t / column_of(m, 2, vx, vy, vz)
        bu, bv = bed_seen_at(
            depth, m, lens, ahead * vx + path * qx, ahead * vy + path * qy,
            ahead * vz + path * qz, u, v,
        )  # fmt: skip
        travel = path + deep
    b0, b1, b2 = bilinear_color(below, bu, bv)
    glint = ZERO
    if sun[3] + sun[4] + sun[5] > ZERO:
        if phong:
            glint = share * phong_highlight(vx, vy, vz, sun[0], sun[1], sun[2], ux, uy, uz)
        else:
            glint = sun_glint(
                vx, vy, vz, sun[0], sun[1], sun[2], gx, gy, glint_variance + xx,
                glint_variance + yy, xy,
            )  # fmt: skip
    through, dry = ONE - share, ONE - covers
    picture_out[row, column, 0] = dry * picture[row, column, 0] + covers * (
        through * b0 * exp_minus(ABSORB_R * travel) + share * light0 + glint * sun[3]
    )
    picture_out[row, column, 1] = dry * picture[row, column, 1] + covers * (
        through * b1 * exp_minus(ABSORB_G * travel) + share * light1 + glint * sun[4]
    )
    picture_out[row, column, 2] = dry * picture[row, column, 2] + covers * (
        through * b2 * exp_minus(ABSORB_B * travel) + share * light2 + glint * sun[5]
    )
