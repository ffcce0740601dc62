"""What water mirrors, looked up in mirrored pictures: many bent rays at a time, in vectors.

The rays of some records fill a chunk (see `chunks`); each pass over it does one thing for all of
them: bend, guess, march what the guess does not end, look up. `reflect.march_mirror` does the same
for one ray.
"""

from __future__ import annotations

import numpy as np

from rainsim.chunks import CHUNK, nearest
from rainsim.jit import cpu_kernel, inlined_function, prange, serial_kernel
from rainsim.optics import column_of, normal_of
from rainsim.pyramid import blurred_color
from rainsim.reflect import (
    ENVIRONMENT,
    HALVINGS,
    MIRROR,
    MIRROR_FAR,
    ONE,
    SAMPLE_X,
    SAMPLE_Y,
    SAMPLES,
    SPREAD,
    TWO,
    ZERO,
    blur_of,
    guessed_share,
    image_of,
    in_mirror,
    is_met,
    met_between,
    reflected_upwards,
    samples_of,
    step_share,
    vanishing_point,
)
from rainsim.shade import FAR_AWAY

GROUP = 512  # records that a thread takes at a time
# Rows of a chunk of rays: unit view direction, slopes there, the image point that the ray starts at
# and its depth [m], the way to its vanishing point, where it ends on that (0 to 1), blur [px] at
# its end, image point there and depth [m].
(VIEW_X, VIEW_Y, VIEW_Z, SLOPE_X, SLOPE_Y, U, V, Z, DU, DV, END, BLUR, AT_U, AT_V, THERE) = (
    CHUNK * k for k in range(15)
)
# Of the rays that are marched: as above, what the last steps found, and 1 from the hit on.
(FROM_U, FROM_V, FROM_Z, WAY_U, WAY_V, BEFORE, PAST, FREE, HIGH, MET) = (
    CHUNK * k for k in range(15, 25)
)
NUMBERS = 25 * CHUNK


@cpu_kernel
def mirror_light(
    which, record, ground_from_camera, eye, lens, level, mirror, coarse, mirror_depth, steps,
    thickness, light_out, source_out,
):  # fmt: skip
    """Look the mirrored light up in the picture that the mirrored camera took.

    Parameters
    ----------
    which : ndarray of shape (k,), int64
        Records that this mirror serves.
    record : ndarray of shape (n, 16), float32
    lens : ndarray of shape (4,), float32
        Of the mirrored camera: its picture may be a part of the whole one, or coarser.
    level : float32 [m]
        Of the mirror.
    mirror : ndarray of shape (rows, columns, 3), float32
        The wet picture that the mirrored camera sees of what stands above the water.
    coarse : ndarray of shape (rows, columns // 2, 3), float32
        That picture at coarser resolutions, see `pyramid.coarsened`.
    mirror_depth : ndarray of shape (rows, columns), float32 [m]
        Its depth along the view axis.
    steps : int
        Of the march along a bent ray in the mirrored picture; 0: every ray is taken to be as long
        as that of level water.
    thickness : float32 [m]
        How far behind its depth a surface still stops such a ray.
    light_out : ndarray of shape (n, 3), float32
    source_out : ndarray of shape (n,), uint8
        MIRROR or ENVIRONMENT.
    """
    m = ground_from_camera
    count = len(which)
    for group in prange((count + GROUP - 1) // GROUP):
        s, place = np.empty(NUMBERS, np.float32), np.empty(CHUNK, np.uint32)
        marched, owner = np.empty(CHUNK, np.uint32), np.empty(CHUNK, np.int64)
        first = np.int64(group) * GROUP
        last = min(first + GROUP, count)
        rays = 0
        for k in range(first, last):
            rays = add_rays(which[k], record, m, eye, lens, level, mirror_depth, rays, s, owner,
                            light_out, source_out)  # fmt: skip
            if rays > CHUNK - SAMPLES or k == last - 1:
                bend(m, lens, rays, s)
                if steps > 0:
                    march_rays(mirror_depth, steps, thickness, rays, s, place, marched)
                else:
                    take_level_ends(record, m, eye, lens, level, mirror_depth, rays, s, owner)
                for i in range(rays):
                    n = owner[i]
                    u, v = s[U + i] + s[END + i] * s[DU + i], s[V + i] + s[END + i] * s[DV + i]
                    r, g, b = blurred_color(mirror, coarse, u, v, s[BLUR + i] * s[END + i])
                    light_out[n, 0] += r
                    light_out[n, 1] += g
                    light_out[n, 2] += b
                rays = 0
        for k in range(first, last):
            r, n = record[which[k]], which[k]
            share = ONE / np.float32(samples_of(r[12], r[13], r[14], SPREAD)[0])
            light_out[n, 0] *= share
            light_out[n, 1] *= share
            light_out[n, 2] *= share


@inlined_function
def add_rays(n, record, m, eye, lens, level, depth, rays, s, owner, light_out, source_out):
    """Add the rays of record n to a chunk; return how many that has then."""
    r = record[n]
    vx, vy, vz, gx, gy = r[3], r[4], r[5], r[10], r[11]
    # Level water would mirror to this pixel what the mirrored camera sees in it.
    source_out[n] = MIRROR if level_depth(r, m, lens, depth) < FAR_AWAY else ENVIRONMENT
    light_out[n, 0], light_out[n, 1], light_out[n, 2] = ZERO, ZERO, ZERO
    z, u, v = image_of(m, lens, level, eye, r[0], r[1], r[2])
    samples, a, b, c = samples_of(r[12], r[13], r[14], SPREAD)
    blur = ZERO
    if samples > 1:
        blur = blur_of(m, lens, vx, vy, vz, gx, gy, r[12] * r[13] - r[14] * r[14])
    for k in range(samples):
        i = rays + k
        s[VIEW_X + i], s[VIEW_Y + i], s[VIEW_Z + i] = vx, vy, vz
        s[SLOPE_X + i] = gx + a * SAMPLE_X[k]
        s[SLOPE_Y + i] = gy + b * SAMPLE_X[k] + c * SAMPLE_Y[k]
        s[U + i], s[V + i], s[Z + i], s[BLUR + i] = u, v, z, blur
        owner[i] = n
    return rays + samples


@inlined_function
def level_depth(r, m, lens, depth):
    """Return the depth [m] of what level water of a record would mirror."""
    inv = ONE / column_of(m, 2, r[3], r[4], r[5])
    u = lens[0] * column_of(m, 0, r[3], r[4], r[5]) * inv + lens[2]
    v = lens[1] * column_of(m, 1, r[3], r[4], r[5]) * inv + lens[3]
    rows, columns = depth.shape
    return depth[min(max(int(v), 0), rows - 1), min(max(int(u), 0), columns - 1)]


@serial_kernel
def bend(m, lens, n, s):
    """Find the way of n rays from their images to their vanishing points."""
    for i in range(n):
        ux, uy, uz = normal_of(s[SLOPE_X + i], s[SLOPE_Y + i])
        x, y, z = reflected_upwards(s[VIEW_X + i], s[VIEW_Y + i], s[VIEW_Z + i], ux, uy, uz)
        u, v = vanishing_point(m, lens, x, y, z)
        s[DU + i], s[DV + i] = u - s[U + i], v - s[V + i]


@inlined_function
def take_level_ends(record, m, eye, lens, level, depth, n, s, owner):
    """End n rays as far away as those of level water."""
    for i in range(n):
        r = record[owner[i]]
        length = ONE / column_of(m, 2, r[3], r[4], r[5])
        # Where the water does not stand at the mirror's level, its virtual image stands off too.
        start = r[6] + TWO * (level - r[2]) * m[2, 2]
        there = level_depth(r, m, lens, depth)
        distance = max((min(there, MIRROR_FAR) - start) * length, ZERO)
        ux, uy, uz = normal_of(s[SLOPE_X + i], s[SLOPE_Y + i])
        x, y, z = reflected_upwards(r[3], r[4], r[5], ux, uy, uz)
        u, v = in_mirror(m, lens, level, eye, distance, r[0], r[1], r[2], x, y, z)
        s[END + i] = distance / (distance + start * length)
        inv = ONE / max(s[END + i], np.float32(1e-6))
        s[DU + i], s[DV + i] = (u - s[U + i]) * inv, (v - s[V + i]) * inv


@inlined_function
def march_rays(depth, steps, thickness, n, s, place, marched):
    """Find where n rays end, see `reflect.march_mirror`."""
    nearest(depth, n, s, U, V, THERE, place)
    guess_ends(n, s)
    nearest(depth, n, s, AT_U, AT_V, THERE, place)
    check_guesses(n, s)
    count = 0
    for i in range(n):
        marched[count] = np.uint32(i)
        count += np.int64(s[MET + i] == ZERO)
    if count == 0:
        return
    for k in range(count):
        i = marched[k]
        s[FROM_U + k], s[FROM_V + k], s[FROM_Z + k] = s[U + i], s[V + i], s[Z + i]
        s[WAY_U + k], s[WAY_V + k] = s[DU + i], s[DV + i]
    for k in range(count):
        s[BEFORE + k], s[PAST + k], s[FREE + k] = s[FROM_Z + k], ZERO, ZERO
        s[HIGH + k], s[MET + k] = ZERO, ZERO
    inv = ONE / np.float32(steps)
    for k in range(steps):
        share = step_share(k, inv)
        step_to(share, count, s)
        nearest(depth, count, s, AT_U, AT_V, THERE, place)
        if take_step(share, thickness, count, s) == count:
            break
    for _ in range(HALVINGS):
        halve_to(count, s)
        nearest(depth, count, s, AT_U, AT_V, THERE, place)
        take_half(count, s)
    for k in range(count):
        s[END + marched[k]] = s[HIGH + k] if s[MET + k] > ZERO else s[FREE + k]


@serial_kernel
def guess_ends(n, s):
    """End n rays where level water's would, first."""
    for i in range(n):
        share = guessed_share(s[Z + i], s[THERE + i])
        s[END + i] = share
        s[AT_U + i], s[AT_V + i] = s[U + i] + share * s[DU + i], s[V + i] + share * s[DV + i]


@serial_kernel
def check_guesses(n, s):
    """Tell which of n rays meet something where they were guessed to."""
    for i in range(n):
        s[MET + i] = ONE if is_met(s[Z + i], s[END + i], s[THERE + i]) else ZERO


@serial_kernel
def step_to(share, n, s):
    """Go to a share of the way."""
    for i in range(n):
        s[AT_U + i] = s[FROM_U + i] + share * s[WAY_U + i]
        s[AT_V + i] = s[FROM_V + i] + share * s[WAY_V + i]


@serial_kernel
def take_step(share, thickness, n, s):
    """Look whether n rays have met something since the last step; return how many have by now."""
    met = 0
    gone = ONE / max(ONE - share, np.float32(1e-4))
    for i in range(n):
        there, before, past, free, high = (
            s[THERE + i], s[BEFORE + i], s[PAST + i], s[FREE + i], s[HIGH + i]
        )  # fmt: skip
        now, done = s[FROM_Z + i] * gone, s[MET + i] > ZERO
        hit = met_between(before, now, there, thickness)
        clear = (now < there) & (not done)
        s[HIGH + i] = share if hit & (not done) else high
        s[FREE + i] = share if clear else free
        stays = hit | done
        s[PAST + i], s[BEFORE + i] = past if stays else share, before if stays else now
        s[MET + i] = ONE if stays else ZERO
        met += np.int64(stays)
    return met


@serial_kernel
def halve_to(n, s):
    """Go to the middle of the last step."""
    half = np.float32(0.5)
    for i in range(n):
        share = half * (s[PAST + i] + s[HIGH + i])
        s[AT_U + i] = s[FROM_U + i] + share * s[WAY_U + i]
        s[AT_V + i] = s[FROM_V + i] + share * s[WAY_V + i]


@serial_kernel
def take_half(n, s):
    """Take the half of the last step in which something is met."""
    half = np.float32(0.5)
    for i in range(n):
        low, high = s[PAST + i], s[HIGH + i]
        middle = half * (low + high)
        behind = s[FROM_Z + i] >= s[THERE + i] * (ONE - middle)
        s[PAST + i], s[HIGH + i] = low if behind else middle, middle if behind else high
