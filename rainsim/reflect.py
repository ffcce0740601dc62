"""What water mirrors: by a mirrored pass, or by marching through the picture's own depth.

Each kernel takes the listed water (see `optics`) and fills in the radiance that comes to the
surface from the mirror direction, before Fresnel's factor, and where it was found. The slopes in a
pixel are taken for normally distributed, with the mean and covariance that its record holds, and
the light is the mean over SAMPLES of them. In a mirrored picture each stands for its neighbourhood:
the samples are drawn together, and looked up in a picture that is blurred for the rest.
"""

from __future__ import annotations

import numpy as np

from rainsim.jit import cpu_kernel, device_function, inlined_function, prange
from rainsim.light import bilinear_color
from rainsim.moments import root_of
from rainsim.optics import LEAST_COSINE, NEAREST, column_of, normal_of
from rainsim.shade import FAR_AWAY
from rainsim.sky import sample_environment
from rainsim.ssr import edge_fade, march

ENVIRONMENT, SCREEN, MIRROR, TRACED = 0, 1, 2, 3  # where mirrored light was found

ZERO = np.float32(0)
ONE = np.float32(1)
TWO = np.float32(2)
HALF = np.float32(0.5)

NOT_GROUND = np.float32(0.03)  # m over the bed: what stands higher can be reflected
EDGE_SHARE = np.float32(0.06)  # of the picture, over which reflections fade to the surroundings
SAME = np.float32(0.05)  # share of a depth within which two points are taken for one
MIRROR_FAR = np.float32(100)  # m, stands for the sky's distance
LEAST_VARIANCE = np.float32(2 * 0.003**2)  # of slopes, both axes: below that a mirror is smooth
HALVINGS = 3  # of the last step, in which something is met
SAMPLES = 7  # one in the middle, six around it
_RING = 2 * np.pi * np.arange(6) / 6
_RADIUS = np.sqrt(2 * 7 / 6)  # in deviations: keeps the variance of the slopes
SAMPLE_X = np.append(0, _RADIUS * np.cos(_RING)).astype(np.float32)
SAMPLE_Y = np.append(0, _RADIUS * np.sin(_RING)).astype(np.float32)
SPREAD = np.float32(1.25 / _RADIUS)  # of samples in a blurred picture, over that; see docs/light.md
BLUR = np.float32(np.sqrt(1 - SPREAD**2))  # of each of those, in deviations: the rest


@cpu_kernel
def march_light(
    which, record, picture, tall, bounds, ground_from_camera, eye, lens, environment, settings,
    light_out, source_out,
):  # fmt: skip
    """Find the mirrored light by marching through the picture's own depth (see `ssr`).

    Parameters
    ----------
    picture : ndarray of shape (height, width, 3), float32
    tall : ndarray of shape (height, width), float32 [m]
        Depth of what can be mirrored; infinite for the ground that the water lies on.
    bounds : ndarray of shape (rows, columns, 2), float32 [m]
        Of `tall`, see `ssr.block_bounds`.
    environment : ndarray of shape (rows, columns, 3), float32
        Mirrored where the picture shows nothing.
    settings : ndarray of shape (3,), float32
        Thickness [m], stride [px] and length [m] of the march.
    light_out, source_out
        As in `mirrorlight.mirror_light`; SCREEN or ENVIRONMENT.
    """
    m = ground_from_camera
    for k in prange(len(which)):
        n = which[k]
        r = record[n]
        vx, vy, vz, gx, gy = r[3], r[4], r[5], r[10], r[11]
        px, py, pz = r[0] - eye[0], r[1] - eye[1], r[2] - eye[2]
        cx, cy, cz = column_of(m, 0, px, py, pz), column_of(m, 1, px, py, pz), r[6]
        distance = march(
            tall, bounds, lens, cx, cy, cz, column_of(m, 0, vx, vy, -vz),
            column_of(m, 1, vx, vy, -vz), column_of(m, 2, vx, vy, -vz), settings[0], settings[1],
            settings[2],
        )  # fmt: skip
        samples, a, b, c = samples_of(r[12], r[13], r[14], ONE)
        light0, light1, light2, seen = ZERO, ZERO, ZERO, ZERO
        for s in range(samples):
            rx, ry, rz = sample_ray(vx, vy, vz, gx, gy, a, b, c, s)
            hu, hv, found = on_screen(
                tall, m, lens, cx, cy, cz, vx, vy, -vz, rx, ry, rz, distance, settings[0]
            )
            seen += found
            if found < ONE:
                c0, c1, c2 = sample_environment(environment, rx, ry, rz)
                rest = ONE - found
                light0, light1, light2 = light0 + rest * c0, light1 + rest * c1, light2 + rest * c2
            if found > ZERO:
                c0, c1, c2 = bilinear_color(picture, hu, hv)
                light0, light1 = light0 + found * c0, light1 + found * c1
                light2 += found * c2
        share = ONE / np.float32(samples)
        light_out[n, 0], light_out[n, 1] = light0 * share, light1 * share
        light_out[n, 2] = light2 * share
        source_out[n] = SCREEN if seen * share > HALF else ENVIRONMENT


@cpu_kernel
def mirror_rays(which, record, ground_from_camera, sample, direction_out, before_out):
    """Give the mirrored ray of each record in `which`, for one of the SAMPLES slopes.

    Parameters
    ----------
    sample : int
        Number of the slope; 0 is the mean of the pixel's.
    direction_out : ndarray of shape (k, 3), float32
        Unit, ground frame.
    before_out : ndarray of shape (k,), float32 [m]
        Way from the eye to the water.
    """
    m = ground_from_camera
    for k in prange(len(which)):
        r = record[which[k]]
        a, b, c = root_of(r[12], r[13], r[14])
        rx, ry, rz = sample_ray(r[3], r[4], r[5], r[10], r[11], a, b, c, sample)
        direction_out[k, 0], direction_out[k, 1], direction_out[k, 2] = rx, ry, rz
        before_out[k] = r[6] / column_of(m, 2, r[3], r[4], r[5])


def traced_light(record, ground_from_camera, lens, trace, light_out, source_out):
    """Trace the mirrored light of every record through the splats.

    Parameters
    ----------
    record, ground_from_camera, lens, light_out, source_out
        As in `mirrorlight.mirror_light`; the source is TRACED or, where the ray met little,
        ENVIRONMENT.
    trace : callable
        trace(origin [m], direction, before [m], pixel) returns radiance (k, 3), alpha (k,) and
        distance (k,) [m] from the eye of rays in the ground frame; `pixel` is the width of a pixel
        over the distance.

    Returns
    -------
    alpha : ndarray of shape (n,), float32
    end : ndarray of shape (n, 3), float32 [m]
        Where the rays of the mean slopes end.
    """
    alpha_of, end = None, None
    smooth = record[:, 12] + record[:, 13] < LEAST_VARIANCE
    for sample in range(SAMPLES):
        which = np.flatnonzero(~smooth) if sample else np.arange(len(record))
        direction = np.empty((len(which), 3), np.float32)
        before = np.empty(len(which), np.float32)
        mirror_rays(which, record, ground_from_camera, sample, direction, before)
        pixel = record[which, 6] / before / lens[0]
        light, alpha, distance = trace(record[which, :3], direction, before, pixel)
        if sample:
            light_out[which] += light
        else:
            light_out[:] = light
            alpha_of = alpha
            end = record[:, :3] + (distance - before)[:, None] * direction
            source_out[:] = np.where(alpha > HALF, TRACED, ENVIRONMENT)
    light_out[~smooth] /= SAMPLES
    return alpha_of, end


@cpu_kernel
def keep_tall(depth, clearance, tall_out):
    """Keep the depth of what water can mirror: level water cannot mirror the ground it lies on."""
    height, width = depth.shape
    for row in prange(height):
        for column in range(width):
            low = clearance[row, column] < NOT_GROUND
            tall_out[row, column] = np.float32(np.inf) if low else depth[row, column]


@device_function
def samples_of(xx, yy, xy, share):
    """Return the number of slopes to take, and the root of their covariance times `share`."""
    if xx + yy < LEAST_VARIANCE:
        return 1, ZERO, ZERO, ZERO
    a, b, c = root_of(xx, yy, xy)
    return SAMPLES, share * a, share * b, share * c


@device_function
def sample_ray(vx, vy, vz, gx, gy, a, b, c, sample):
    """Return the mirrored ray of one of the slopes about (gx, gy), see `samples_of`."""
    p, q = SAMPLE_X[sample], SAMPLE_Y[sample]
    ux, uy, uz = normal_of(gx + a * p, gy + b * p + c * q)
    return reflected_upwards(vx, vy, vz, ux, uy, uz)


@device_function
def blur_of(m, lens, vx, vy, vz, gx, gy, spread):
    """Return how much to blur a mirrored picture of the sky for one of the samples [px].

    The deviation along one axis, a mean over the axes. A mirror's normal that moves by a solid
    angle w moves the mirrored ray by 4 cos w, cos that of the angle between the two; and that
    covers fx fy w / g^3 of the picture, g the cosine of the angle to the view axis.

    Parameters
    ----------
    spread : float32
        Determinant of the covariance of the slopes.
    """
    ux, uy, uz = normal_of(gx, gy)
    rx, ry, rz = reflected_upwards(vx, vy, vz, ux, uy, uz)
    cosine = max(-(vx * ux + vy * uy + vz * uz), LEAST_COSINE)
    g = max(column_of(m, 2, rx, ry, -rz), np.float32(0.1))
    area = np.float32(4) * cosine * uz * uz * uz * lens[0] * lens[1] / (g * g * g)
    return BLUR * np.sqrt(area * np.sqrt(max(spread, ZERO)))


@inlined_function
def reflected_upwards(vx, vy, vz, ux, uy, uz):
    """Return the unit view direction v mirrored at the unit normal u, turned up if it goes down.

    A ripple that faces so far away that its mirror ray goes down mirrors the ripple before it,
    which mirrors the low sky.
    """
    dot = TWO * (vx * ux + vy * uy + vz * uz)
    rx, ry, rz = vx - dot * ux, vy - dot * uy, vz - dot * uz
    if rz < LEAST_COSINE:
        rz = LEAST_COSINE
        inv = ONE / np.sqrt(rx * rx + ry * ry + rz * rz)
        rx, ry, rz = rx * inv, ry * inv, rz * inv
    return rx, ry, rz


@device_function
def in_mirror(m, lens, level, eye, distance, sx, sy, sz, rx, ry, rz):
    """Return where the mirrored picture shows the end of a ray r from surface point s.

    The end, mirrored at `level`, is where the mirrored camera sees it.
    """
    ex, ey = sx + distance * rx - eye[0], sy + distance * ry - eye[1]
    ez = TWO * level - (sz + distance * rz) - eye[2]
    inv = ONE / max(column_of(m, 2, ex, ey, ez), NEAREST)
    u = lens[0] * column_of(m, 0, ex, ey, ez) * inv + lens[2]
    return u, lens[1] * column_of(m, 1, ex, ey, ez) * inv + lens[3]


@device_function
def march_mirror(m, lens, level, eye, sx, sy, sz, rx, ry, rz, depth, steps, thickness):
    """Return where the mirrored picture shows what a ray r from surface point s meets.

    And how far that is on the way to the ray's vanishing point, 0 to 1, in the picture. The ray's
    virtual image starts at the pixel itself and ends at r's vanishing point; between them 1/z is
    linear in the picture: z = z0 / (1 - t). A ray that passes behind something, where the picture
    shows nothing of it, ends where it was last in front of all.
    """
    z0, u0, v0 = image_of(m, lens, level, eye, sx, sy, sz)
    u1, v1 = vanishing_point(m, lens, rx, ry, rz)
    du, dv = u1 - u0, v1 - v0
    # What level water would mirror here is often what the bent ray meets, too.
    guess = guessed_share(z0, _depth_at(depth, u0, v0))
    if is_met(z0, guess, _depth_at(depth, u0 + guess * du, v0 + guess * dv)):
        return u0 + guess * du, v0 + guess * dv, guess
    before, past, free = z0, ZERO, ZERO
    inv = ONE / np.float32(steps)
    for k in range(steps):
        t = step_share(k, inv)
        now = z0 / max(ONE - t, np.float32(1e-4))
        there = _depth_at(depth, u0 + t * du, v0 + t * dv)
        if met_between(before, now, there, thickness):
            low, high = past, t
            for _ in range(HALVINGS):
                middle = HALF * (low + high)
                if z0 >= _depth_at(depth, u0 + middle * du, v0 + middle * dv) * (ONE - middle):
                    high = middle
                else:
                    low = middle
            free = high
            break
        if now < there:
            free = t
        before, past = now, t
    return u0 + free * du, v0 + free * dv, free


@device_function
def image_of(m, lens, level, eye, sx, sy, sz):
    """Return depth and image point, in the mirrored picture, of the surface point s."""
    vz = TWO * level - sz - eye[2]
    vx, vy = sx - eye[0], sy - eye[1]
    z = column_of(m, 2, vx, vy, vz)
    u = lens[0] * column_of(m, 0, vx, vy, vz) / z + lens[2]
    return z, u, lens[1] * column_of(m, 1, vx, vy, vz) / z + lens[3]


@inlined_function
def vanishing_point(m, lens, rx, ry, rz):
    """Return where the mirrored picture shows the end of an endless ray r."""
    gain = max(column_of(m, 2, rx, ry, -rz), np.float32(0.02))
    u = lens[0] * column_of(m, 0, rx, ry, -rz) / gain + lens[2]
    return u, lens[1] * column_of(m, 1, rx, ry, -rz) / gain + lens[3]


@inlined_function
def guessed_share(z0, there):
    """Return the share of the way to the vanishing point at which a ray gets to a depth."""
    return max(ONE - z0 / min(there, MIRROR_FAR), ZERO)


@inlined_function
def is_met(z0, share, there):
    """Tell whether what is `there` is as far as a ray is at a share of its way."""
    there = min(there, MIRROR_FAR) * (ONE - share)
    return abs(there - z0) < SAME * there


@inlined_function
def step_share(k, inv):
    """Return the share of the way at a step; finer near the water, where things in it begin."""
    t = np.float32(k + 1) * inv
    return t * t


@inlined_function
def met_between(before, now, there, thickness):
    """Tell whether a ray has met what is `there` between two depths."""
    return (now >= there) & (before <= there + thickness)


@device_function
def _depth_at(depth, u, v):
    """Return the depth at image point (u, v), or at the edge next to it."""
    # Without a sign: negative places would count from the end, which costs a test at each.
    i = np.uint32(min(max(u, ZERO), np.float32(depth.shape[1] - 1)))
    j = np.uint32(min(max(v, ZERO), np.float32(depth.shape[0] - 1)))
    return depth[j, i]


@device_function
def on_screen(tall, m, lens, cx, cy, cz, fx, fy, fz, rx, ry, rz, distance, thickness):
    """Return where the picture shows what the mirror ray meets, and the share to take from there.

    `distance` is what the march of the flat surface's ray f found. The end is moved to where the
    bent ray r ends at that distance, if that is seen too: marching bent rays gives noise.
    """
    if not distance > ZERO:
        return ZERO, ZERO, ZERO
    hu, hv, found = seen_at(tall, m, lens, cx, cy, cz, rx, ry, rz, distance, thickness)
    if found <= ZERO:
        hu, hv, found = seen_at(tall, m, lens, cx, cy, cz, fx, fy, fz, distance, thickness)
    return hu, hv, found


@device_function
def seen_at(depth, m, lens, cx, cy, cz, rx, ry, rz, distance, thickness):
    """Return where the end of a ray of length `distance` shows, and how far to trust it.

    The ray starts at camera point (cx, cy, cz) and goes along the ground-frame direction r. Trust
    is 0 if something in front hides the end, and falls to 0 at the picture's edge.
    """
    ex = cx + distance * column_of(m, 0, rx, ry, rz)
    ey = cy + distance * column_of(m, 1, rx, ry, rz)
    ez = cz + distance * column_of(m, 2, rx, ry, rz)
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
