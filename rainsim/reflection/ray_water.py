"""Intersection of view rays with the water: distances, and the share of each pixel it covers."""

import math

import numpy as np

from rainsim.constants import FOUR, HALF, ONE, ZERO
from rainsim.jit import cpu_kernel, device_function, inlined_function, lean_function, prange
from rainsim.numerics.interpolation import bilinear, map_place, smoothstep
from rainsim.numerics.pixel_batches import CHUNK, CORNERS, interpolate
from rainsim.reflection.water_surface import WaterMap
from rainsim.scene.view import View, column_slope, pixel_ray, row_slope

HIDE_LOW, HIDE_HIGH = np.float32(0.004), np.float32(0.014)  # m above water: hides it, softly
SPECK, AROUND = np.float32(0.03), 4  # m above water, pixels around: less is noise, see `is_speck`
# m of water that begin to close over rough ground, and that hide it wholly; chosen by eye on a
# captured patio.
COVERING_DEPTHS = np.array([0.4e-3, 2.2e-3], np.float32)
NOTHING = np.float32(np.inf)  # m, depth of pixels that show nothing or the sky
LEAST_DIP = np.float32(-0.01)  # rays flatter than this meet water in the haze, if at all
LEAST_COVERAGE = np.float32(0.004)  # a smaller share does not change an 8-bit picture
CLOSE_ENOUGH = np.float32(5e-5)  # m of height between two steps towards the surface
MOST_STEPS = 6
MOST_PLACES = 8  # in a pixel, where the water's depth is looked up; two cells apart
FAR_OFF = np.float32(5e-3)  # m of height between the last two steps: they do not meet the surface

# Rows of a chunk's numbers: depth of the scene [m], the ray for a depth of 1, the depth [m] that
# the ray has reached, the surface's height [m] there and its change [m] in the last step, column
# and row of the cell.
(DEPTH, RAY_X, RAY_Y, RAY_Z, WAY, BEFORE, STEP, U, V) = (CHUNK * k for k in range(9))
NUMBERS = 9 * CHUNK


@cpu_kernel
def meet_water(
    depth, view: View, water_map: WaterMap, highest, row_order, cover, hit_out, coverage_out,
    count_out,
):  # fmt: skip
    """Find where each pixel's ray meets the water surface, and how much of the pixel it covers.

    depth : float32 array (height, width) [m]. Of the wet picture, along the view
        axis.
    highest : float32 [m]. Height of the highest water: pixels that show something
        higher are dry.
    row_order : int64 array (height,). Order in which rows are taken, see
        `jit.interleaved`.
    cover : float32 array (2,) [m]. Water depth where coverage begins and is full.
    hit_out : float32 array (height, width) [m]. Depth of the water along the view
        axis; only where it covers.
    coverage_out : float32 array (height, width). Share of the pixel that is
        water.
    count_out : int64 array (height,). Covered pixels of each row.
    """
    height = len(depth)
    for k in prange(height):
        row = row_order[k]
        count_out[row] = meet_row(
            row, depth, view, water_map, highest, cover, hit_out[row], coverage_out[row]
        )


@device_function
def meet_row(row, depth, view, water_map, highest, cover, hit_out, coverage_out):
    """Find the water in one row of pixels; return how many it covers. See `meet_water`."""
    width = depth.shape[1]
    s, place = np.empty(NUMBERS, np.float32), np.empty(CHUNK, np.uint32)
    corner = np.empty(CORNERS, np.float32)
    count, b = 0, row_slope(view, row)
    for left in range(0, width, CHUNK):
        n = min(CHUNK, width - left)
        here, hit = coverage_out[left : left + n], hit_out[left : left + n]
        low = aim(depth[row, left : left + n], view, highest, left, b, n, s)
        if low > 0:
            follow(view, water_map, n, s, place, corner)
            count += cover_chunk(
                depth, row, left, view, water_map, cover, n, s, place, corner, hit, here
            )
        else:
            here[:] = ZERO
    return count


@inlined_function
def aim(depth, view, highest, left, b, n, s):
    """Start the rays of n pixels at the highest water; return how many may meet any."""
    m = view.ground_from_camera
    m00, m01, m02 = m[0, 0], m[0, 1], m[0, 2]
    m10, m11, m12 = m[1, 0], m[1, 1], m[1, 2]
    m20, m21, m22 = m[2, 0], m[2, 1], m[2, 2]
    up = view.eye[2]
    for i in range(n):
        s[DEPTH + i] = depth[i]
    low = 0
    for i in range(n):
        a = column_slope(view, left + i)
        x, y, z = m00 * a + m01 * b + m02, m10 * a + m11 * b + m12, m20 * a + m21 * b + m22
        # Where the picture shows nothing, the map goes on; a puddle there would hang in the air.
        down = (z <= LEAST_DIP) & (s[DEPTH + i] < NOTHING)
        down &= up + s[DEPTH + i] * z <= highest + SPECK
        z = z if down else -ONE
        s[RAY_X + i], s[RAY_Y + i], s[RAY_Z + i] = x, y, z
        s[WAY + i] = (highest - up) / z if down else -ONE
        s[BEFORE + i], s[STEP + i] = highest, ONE if down else ZERO
        low += np.int64(down)
    return low


@inlined_function
def follow(view, water_map, n, s, place, corner):
    """Follow n rays to the surface, as `meet_surface` does one, while any of them needs a step."""
    up = view.eye[2]
    for _ in range(MOST_STEPS):
        find_cells(view, water_map, n, s)
        interpolate(water_map.surface, n, s, U, V, place, corner)
        moving = 0
        for i in range(n):
            now, t, step = s[U + i], s[WAY + i], s[STEP + i]
            reached, moved = (now - up) / s[RAY_Z + i], abs(now - s[BEFORE + i])
            on = step >= CLOSE_ENOUGH
            t, step = reached if on else t, moved if on else step
            s[WAY + i], s[STEP + i], s[BEFORE + i] = t, step, now
            moving += np.int64(step >= CLOSE_ENOUGH)
        if moving == 0:
            break


@inlined_function
def find_cells(view, water_map, n, s):
    """Find the cells that n rays have reached."""
    eye, origin, spacing = view.eye, water_map.origin, water_map.spacing
    e0, e1, o0, o1 = eye[0], eye[1], origin[0], origin[1]
    for i in range(n):
        s[U + i] = (e0 + s[WAY + i] * s[RAY_X + i] - o0) / spacing - HALF
        s[V + i] = (e1 + s[WAY + i] * s[RAY_Y + i] - o1) / spacing - HALF


@inlined_function
def cover_chunk(
    depth, row, left, view, water_map, cover, n, s, place, corner, hit_out, coverage_out
):
    """Write where n rays have met the water and how much it covers; return how often it does.

    In vectors what `covered` does where one place of a pixel tells, and nothing stands above it.
    """
    ny, nx = water_map.surface.shape
    right, bottom, thin, full = np.float32(nx - 2), np.float32(ny - 2), cover[0], cover[1]
    find_cells(view, water_map, n, s)
    stretch = stretch_of(view, water_map)
    for i in range(n):  # the change in the last step gives way to what is to be done: 0: nothing
        u, v, t, x, y, z = s[U + i], s[V + i], s[WAY + i], s[RAY_X + i], s[RAY_Y + i], s[RAY_Z + i]
        met = (u > ONE) & (v > ONE) & (u <= right) & (v <= bottom)
        met &= (t > ZERO) & (s[STEP + i] <= FAR_OFF)
        long = t * stretch / z
        several = long * long * (x * x + y * y) >= FOUR
        s[STEP + i] = (ONE if several else HALF) if met else ZERO
    interpolate(water_map.depth, n, s, U, V, place, corner)
    for i in range(n):
        share, above = smoothstep(thin, full, s[U + i]), (s[DEPTH + i] - s[WAY + i]) * s[RAY_Z + i]
        share = share if (share > LEAST_COVERAGE) & (s[STEP + i] > ZERO) else ZERO
        asked = (s[STEP + i] == ONE) | ((share > ZERO) & (above > HIDE_LOW))
        s[U + i], s[STEP + i] = share, ONE if asked else ZERO
    count = 0
    for i in range(n):
        if s[STEP + i] > ZERO:
            ray = s[RAY_X + i], s[RAY_Y + i], s[RAY_Z + i]
            s[U + i] = covered(depth, view, water_map, row, left + i, ray, s[WAY + i], cover)
    for i in range(n):
        coverage_out[i], hit_out[i] = s[U + i], s[WAY + i]
        count += np.int64(s[U + i] > ZERO)
    return count


@inlined_function
def stretch_of(view, water_map):
    """Return by how many cells a ray's place moves from row to row, over its depth and fall."""
    m = view.ground_from_camera
    across, down = m[2, 0] / view.fx, m[2, 1] / view.fy  # by which z changes from pixel to pixel
    return math.sqrt(across * across + down * down) / water_map.spacing


@inlined_function
def covered(depth, view, water_map, row, column, ray, t, cover):
    """Return the share of a pixel that the water covers, which its ray meets.

    At one place the share grows with the depth, from 0 to 1, as `cover` says. Far off a pixel is a
    metre long along its ray, and puddles are shorter: the mean of places along it is taken. What
    the picture shows above the water hides it, softly at the contact.

    `ray` is the ray for a depth of 1, t the depth of the water along the view axis [m].
    """
    x, y, z = ray
    above = (depth[row, column] - t) * z  # height of the scene over the water
    if above > SPECK:
        return ZERO
    long = t * stretch_of(view, water_map) / z
    du, dv, origin = long * x, long * y, water_map.origin
    u, v = map_place(view.eye[0] + t * x, view.eye[1] + t * y, origin, water_map.spacing)
    count = min(int(math.sqrt(du * du + dv * dv) * HALF) + 1, MOST_PLACES)
    share, part = ZERO, ONE / np.float32(count)
    for k in range(count):
        at = (np.float32(k) + HALF) * part - HALF
        deep = bilinear(water_map.depth, u + at * du, v + at * dv)
        share += part * smoothstep(cover[0], cover[1], deep)
    if share > ZERO and above > HIDE_LOW:
        if not is_speck(depth, view, row, column, view.eye[2] + t * z, above):
            share *= ONE - smoothstep(HIDE_LOW, HIDE_HIGH, above)
    return share if share > LEAST_COVERAGE else ZERO


@lean_function
def is_speck(depth, view, row, column, level, above):
    """Tell whether what a pixel shows just `above` water at a `level` [m] is noise of the depth.

    At an edge of what lies under water the depth of splats may be a centimetre or two too small,
    in a pixel here and there. Of what really stands out, four pixels around are half as high.
    """
    height, width = depth.shape
    standing = 0
    for j in range(max(row - 1, 0), min(row + 2, height)):
        for i in range(max(column - 1, 0), min(column + 2, width)):
            _, _, z = pixel_ray(view, j, i)
            standing += np.int64(view.eye[2] + depth[j, i] * z - level > HALF * above)
    return standing <= AROUND  # it is one of them


@lean_function
def meet_surface(view, water_map, x, y, z, start):
    """Return how far along (x, y, z) the ray from the eye meets the surface, and in which cell.

    The surface is nearly level: a few fixed-point steps from the height `start` meet it. Where
    they do not, at the foot of steps seen at a grazing angle, there is no hit: negative.
    """
    surface, origin, spacing = water_map.surface, water_map.origin, water_map.spacing
    eye, inv = view.eye, ONE / z
    t = (start - eye[2]) * inv
    u, v, step = ZERO, ZERO, ONE
    before = start
    for _ in range(MOST_STEPS):
        u, v = map_place(eye[0] + t * x, eye[1] + t * y, origin, spacing)
        now = bilinear(surface, u, v)
        t = (now - eye[2]) * inv
        step = abs(now - before)
        if step < CLOSE_ENOUGH:
            break
        before = now
    if step > FAR_OFF:
        return -ONE, u, v
    u, v = map_place(eye[0] + t * x, eye[1] + t * y, origin, spacing)
    return t, u, v
