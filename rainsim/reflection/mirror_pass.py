"""Reflections in water by a mirrored picture, on the CPU: many bent rays at a time, in vectors.

Twin of `planar_mirror.mirrored_light`, which does the same for one pixel: a CUDA thread is no worse
off with it. A CPU does eight rays in one instruction, but only where a loop holds one simple thing
to do: so the rays of some records fill a chunk (see `numerics.pixel_batches`), and each pass over
it does one thing for all of them: bend, guess, march what the guess does not end, look up. The
formulas are those of `planar_mirror`; only order and packing stand here again, and
`tests/reflection/test_mirrors.py` fails when the two differ.
"""

import numpy as np

from rainsim import jit
from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import prange
from rainsim.numerics.mipmap import blurred_color
from rainsim.numerics.pixel_batches import CHUNK, nearest
from rainsim.reflection import facets, mirrored_rays, planar_mirror
from rainsim.reflection.water_record import read_record
from rainsim.scene.view import View, project
from rainsim.shading.wetting import FAR_AWAY

GROUP = 512  # records that a thread takes at a time
# Rows of a chunk of rays: unit view direction, slopes there, the image point that the ray starts at
# and its depth [m], the way to its vanishing point, where it ends on that (0 to 1), blur [px] at
# its end, image point there and depth [m] of what the picture shows there; share of the light.
(VIEW_X, VIEW_Y, VIEW_Z, SLOPE_X, SLOPE_Y, U, V, Z, DU, DV, END, BLUR, AT_U, AT_V, SURFACE,
 SHARE) = (CHUNK * k for k in range(16))  # fmt: skip
# Of the rays that are marched: as above, depth and share of the way at which each was last in front
# of everything, the share at which it met something, and 1 from then on.
(FROM_U, FROM_V, FROM_Z, WAY_U, WAY_V, BEFORE, FREE, HIGH, MET) = (CHUNK * k for k in range(16, 25))
NUMBERS = 25 * CHUNK


@jit.cpu_kernel
def mirror_light(
    which, record, view: View, mirror: planar_mirror.MirrorPicture, light_out, source_out
):
    """Find the mirrored light of listed water in the picture that a mirrored camera took.

    which : int64 array (k,). Records that this mirror serves.
    record : float32 array (n, RECORD)
    view : View. Of the mirrored camera; its picture may be a part of the whole
        one.
    mirror : MirrorPicture
    light_out : float32 array (n, 3). Radiance that comes to the surface, before
        it is multiplied by the reflectance.
    source_out : uint8 array (n,). MIRROR, or ENVIRONMENT where level water
        mirrors the sky.
    """
    count = len(which)
    # Taken out of the bundle here: in the loop numba would count references at each use.
    picture, coarse, depth = mirror.picture, mirror.coarse, mirror.depth
    taken = jit.none_taken()
    for _ in prange(jit.TAKERS):
        first = jit.take_next(taken) * GROUP
        while first < count:
            mirror_group(
                which[first : min(first + GROUP, count)], record, view, picture, coarse, depth,
                light_out, source_out,
            )  # fmt: skip
            first = jit.take_next(taken) * GROUP


@jit.device_function
def mirror_group(which, record, view, picture, coarse, depth, light_out, source_out):
    """Find the mirrored light of some of the listed water; see `mirror_light`."""
    s, place = np.empty(NUMBERS, np.float32), np.empty(CHUNK, np.uint32)
    marched, owner = np.empty(CHUNK, np.uint32), np.empty(CHUNK, np.int64)
    rays = np.int64(0)
    for k in range(len(which)):
        n = which[k]
        light_out[n, 0], light_out[n, 1], light_out[n, 2] = ZERO, ZERO, ZERO
        sky = level_depth(record, n, view, depth) >= FAR_AWAY
        source_out[n] = mirrored_rays.ENVIRONMENT if sky else mirrored_rays.MIRROR
        rays = add_rays(record, n, view, rays, s, owner)
        if rays > CHUNK - facets.SAMPLES or k == len(which) - 1:
            bend(view, rays, s)
            march_rays(depth, rays, s, place, marched)
            for i in range(rays):
                n = owner[i]
                u, v = s[U + i] + s[END + i] * s[DU + i], s[V + i] + s[END + i] * s[DV + i]
                r, g, b = blurred_color(picture, coarse, u, v, s[BLUR + i] * s[END + i])
                light_out[n, 0] += s[SHARE + i] * r
                light_out[n, 1] += s[SHARE + i] * g
                light_out[n, 2] += s[SHARE + i] * b
            rays = np.int64(0)


@jit.inlined_function
def add_rays(record, n, view, rays, s, owner):
    """Add the rays of record n to a chunk that has `rays`; return how many it has then."""
    water = read_record(record, n)
    u, v, z = planar_mirror.image_of(view, water.x, water.y, water.z)
    samples, a, b, c = facets.slope_samples(water)
    blur = ZERO
    if samples > 1:
        blur = mirrored_rays.sample_blur(view, water)
    total = ZERO
    for k in range(samples):
        i = rays + k
        s[VIEW_X + i], s[VIEW_Y + i], s[VIEW_Z + i] = water.view_x, water.view_y, water.view_z
        s[SLOPE_X + i], s[SLOPE_Y + i] = facets.sample_slopes(
            water, mirrored_rays.SPREAD * a, mirrored_rays.SPREAD * b, mirrored_rays.SPREAD * c, k
        )
        s[U + i], s[V + i], s[Z + i], s[BLUR + i] = u, v, z, blur
        s[SHARE + i] = facets.light_weight(water, a, b, c, k)
        total += s[SHARE + i]
        owner[i] = n
    gain = ONE / total
    for k in range(samples):
        s[SHARE + rays + k] *= gain
    return rays + samples


@jit.inlined_function
def level_depth(record, n, view, depth):
    """Return the depth [m] of the point that level water of record n would mirror."""
    water = read_record(record, n)
    u, v, _ = project(view, water.view_x, water.view_y, -water.view_z)
    rows, columns = depth.shape
    return depth[min(max(int(v), 0), rows - 1), min(max(int(u), 0), columns - 1)]


@jit.serial_kernel
def bend(view, n, s):
    """Find the way of n rays from their images to their vanishing points."""
    for i in range(n):
        ux, uy, uz = facets.normal_of(s[SLOPE_X + i], s[SLOPE_Y + i])
        x, y, z = mirrored_rays.reflected_upwards(
            s[VIEW_X + i], s[VIEW_Y + i], s[VIEW_Z + i], ux, uy, uz
        )
        u, v = planar_mirror.vanishing_point(view, x, y, z)
        s[DU + i], s[DV + i] = u - s[U + i], v - s[V + i]


@jit.inlined_function
def march_rays(depth, n, s, place, marched):
    """Find where n rays end, see `planar_mirror.march_mirror`."""
    nearest(depth, n, s, U, V, SURFACE, place)
    guess_ends(n, s)
    nearest(depth, n, s, AT_U, AT_V, SURFACE, place)
    check_guesses(n, s)
    count = np.int64(0)  # not the literal 0, for which numba would compile the callees once more
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
        s[BEFORE + k], s[FREE + k], s[HIGH + k], s[MET + k] = s[FROM_Z + k], ZERO, ZERO, ZERO
    for k in range(planar_mirror.STEPS):
        share = planar_mirror.step_share(k)
        step_to(share, count, s)
        nearest(depth, count, s, AT_U, AT_V, SURFACE, place)
        if check_step(share, count, s) == count:
            break
    for _ in range(planar_mirror.HALVINGS):
        halve_to(count, s)
        nearest(depth, count, s, AT_U, AT_V, SURFACE, place)
        keep_half(count, s)
    for k in range(count):
        s[END + marched[k]] = s[HIGH + k] if s[MET + k] > ZERO else s[FREE + k]


@jit.serial_kernel
def guess_ends(n, s):
    """End n rays where level water's would, first."""
    for i in range(n):
        share = planar_mirror.guessed_share(s[Z + i], s[SURFACE + i])
        s[END + i] = share
        s[AT_U + i], s[AT_V + i] = s[U + i] + share * s[DU + i], s[V + i] + share * s[DV + i]


@jit.serial_kernel
def check_guesses(n, s):
    """Mark which of n rays meet something where they were guessed to end."""
    for i in range(n):
        s[MET + i] = ONE if planar_mirror.is_met(s[Z + i], s[END + i], s[SURFACE + i]) else ZERO


@jit.serial_kernel
def step_to(share, n, s):
    """Take n rays to a share of their way."""
    for i in range(n):
        s[AT_U + i] = s[FROM_U + i] + share * s[WAY_U + i]
        s[AT_V + i] = s[FROM_V + i] + share * s[WAY_V + i]


@jit.serial_kernel
def check_step(share, n, s):
    """Mark which of n rays have met something since the last step; return how many have by now."""
    met = 0
    gain = planar_mirror.depth_gain(share)
    for i in range(n):
        surface, before, free, high = s[SURFACE + i], s[BEFORE + i], s[FREE + i], s[HIGH + i]
        now, done = s[FROM_Z + i] * gain, s[MET + i] > ZERO
        hit = planar_mirror.met_since(before, now, surface) & (not done)
        clear = (now < surface) & (not done)
        s[HIGH + i] = share if hit else high
        s[FREE + i], s[BEFORE + i] = share if clear else free, now if clear else before
        stays = hit | done
        s[MET + i] = ONE if stays else ZERO
        met += np.int64(stays)
    return met


@jit.serial_kernel
def halve_to(n, s):
    """Take n rays to the middle of the way on which they meet something."""
    for i in range(n):
        share = HALF * (s[FREE + i] + s[HIGH + i])
        s[AT_U + i] = s[FROM_U + i] + share * s[WAY_U + i]
        s[AT_V + i] = s[FROM_V + i] + share * s[WAY_V + i]


@jit.serial_kernel
def keep_half(n, s):
    """Keep the half of the way in which a ray meets something; those that meet nothing stay."""
    for i in range(n):
        low, high, met = s[FREE + i], s[HIGH + i], s[MET + i] > ZERO
        middle = HALF * (low + high)
        behind = planar_mirror.is_behind(s[FROM_Z + i], middle, s[SURFACE + i])
        s[FREE + i] = middle if met & (not behind) else low
        s[HIGH + i] = middle if behind else high
