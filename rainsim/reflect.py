"""What water mirrors: by a mirrored pass, or by marching through the picture's own depth.

Each kernel takes the listed water (see `optics`) and fills in the radiance that comes to the
surface from the mirror direction, before Fresnel's factor, and where it was found. Slopes that the
picture cannot resolve blur what is mirrored: the surface is taken at ROUGH_SAMPLES slopes.
"""

from __future__ import annotations

import numpy as np

from rainsim.jit import cpu_kernel, device_function, prange
from rainsim.light import bilinear_color
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
MIRROR_FAR = np.float32(100)  # m, stands for the sky's distance
LEAST_ROUGHNESS = np.float32(0.003)  # rms slope below which a mirror is smooth
ROUGH_SAMPLES = 7  # one in the middle, six around: the variance of the slopes is kept
_RING = 2 * np.pi * np.arange(6) / 6
_RADIUS = np.sqrt(2 * 7 / 6)
ROUGH_X = np.append(0, _RADIUS * np.cos(_RING)).astype(np.float32)
ROUGH_Y = np.append(0, _RADIUS * np.sin(_RING)).astype(np.float32)


@cpu_kernel
def mirror_light(
    which, record, ground_from_camera, eye, lens, level, mirror, mirror_depth,
    light_out, source_out,
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
    mirror_depth : ndarray of shape (rows, columns), float32 [m]
        Its depth along the view axis.
    light_out : ndarray of shape (n, 3), float32
    source_out : ndarray of shape (n,), uint8
        MIRROR or ENVIRONMENT.
    """
    m = ground_from_camera
    rows, columns = mirror_depth.shape
    for k in prange(len(which)):
        n = which[k]
        r = record[n]
        vx, vy, vz, gx, gy, rough = r[3], r[4], r[5], r[10], r[11], r[12]
        # Level water would mirror to this pixel what the mirrored camera sees in it.
        length = ONE / column_of(m, 2, vx, vy, vz)
        u = lens[0] * column_of(m, 0, vx, vy, vz) * length + lens[2]
        v = lens[1] * column_of(m, 1, vx, vy, vz) * length + lens[3]
        i, j = min(max(int(u), 0), columns - 1), min(max(int(v), 0), rows - 1)
        there = mirror_depth[j, i]
        distance = max((min(there, MIRROR_FAR) - r[6]) * length, ZERO)
        samples = 1 if rough < LEAST_ROUGHNESS else ROUGH_SAMPLES
        light0, light1, light2 = ZERO, ZERO, ZERO
        for s in range(samples):
            sx, sy = gx, gy
            if samples > 1:
                sx, sy = sx + rough * ROUGH_X[s], sy + rough * ROUGH_Y[s]
            ux, uy, uz = normal_of(sx, sy)
            rx, ry, rz = reflected_upwards(vx, vy, vz, ux, uy, uz)
            hu, hv = in_mirror(m, lens, level, eye, distance, r[0], r[1], r[2], rx, ry, rz)
            c0, c1, c2 = bilinear_color(mirror, hu, hv)
            light0, light1, light2 = light0 + c0, light1 + c1, light2 + c2
        share = ONE / np.float32(samples)
        light_out[n, 0], light_out[n, 1] = light0 * share, light1 * share
        light_out[n, 2] = light2 * share
        source_out[n] = MIRROR if there < FAR_AWAY else ENVIRONMENT


@cpu_kernel
def march_light(
    which, record, picture, tall, ground_from_camera, eye, lens, environment, settings,
    light_out, source_out,
):  # fmt: skip
    """Find the mirrored light by marching through the picture's own depth (see `ssr`).

    Parameters
    ----------
    picture : ndarray of shape (height, width, 3), float32
    tall : ndarray of shape (height, width), float32 [m]
        Depth of what can be mirrored; infinite for the ground that the water lies on.
    environment : ndarray of shape (rows, columns, 3), float32
        Mirrored where the picture shows nothing.
    settings : ndarray of shape (3,), float32
        Thickness [m], stride [px] and length [m] of the march.
    light_out, source_out
        As in `mirror_light`; SCREEN or ENVIRONMENT.
    """
    m = ground_from_camera
    for k in prange(len(which)):
        n = which[k]
        r = record[n]
        vx, vy, vz, gx, gy, rough = r[3], r[4], r[5], r[10], r[11], r[12]
        px, py, pz = r[0] - eye[0], r[1] - eye[1], r[2] - eye[2]
        cx, cy, cz = column_of(m, 0, px, py, pz), column_of(m, 1, px, py, pz), r[6]
        distance = march(
            tall, lens, cx, cy, cz, column_of(m, 0, vx, vy, -vz), column_of(m, 1, vx, vy, -vz),
            column_of(m, 2, vx, vy, -vz), settings[0], settings[1], settings[2],
        )  # fmt: skip
        samples = 1 if rough < LEAST_ROUGHNESS else ROUGH_SAMPLES
        light0, light1, light2, seen = ZERO, ZERO, ZERO, ZERO
        for s in range(samples):
            sx, sy = gx, gy
            if samples > 1:
                sx, sy = sx + rough * ROUGH_X[s], sy + rough * ROUGH_Y[s]
            ux, uy, uz = normal_of(sx, sy)
            rx, ry, rz = reflected_upwards(vx, vy, vz, ux, uy, uz)
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
    """Give the mirrored ray of each record in `which`, for one of the ROUGH_SAMPLES slopes.

    Parameters
    ----------
    sample : int
        Number of the slope; 0 is the one that the picture resolves.
    direction_out : ndarray of shape (k, 3), float32
        Unit, ground frame.
    before_out : ndarray of shape (k,), float32 [m]
        Way from the eye to the water.
    """
    m = ground_from_camera
    for k in prange(len(which)):
        r = record[which[k]]
        sx, sy = r[10] + r[12] * ROUGH_X[sample], r[11] + r[12] * ROUGH_Y[sample]
        ux, uy, uz = normal_of(sx, sy)
        rx, ry, rz = reflected_upwards(r[3], r[4], r[5], ux, uy, uz)
        direction_out[k, 0], direction_out[k, 1], direction_out[k, 2] = rx, ry, rz
        before_out[k] = r[6] / column_of(m, 2, r[3], r[4], r[5])


def traced_light(record, ground_from_camera, lens, trace, light_out, source_out):
    """Trace the mirrored light of every record through the splats.

    Parameters
    ----------
    record, ground_from_camera, lens, light_out, source_out
        As in `mirror_light`; the source is TRACED or, where the ray met little, ENVIRONMENT.
    trace : callable
        trace(origin [m], direction, before [m], pixel) returns radiance (k, 3) and alpha (k,) of
        rays in the ground frame; `pixel` is the width of a pixel over the distance.
    """
    smooth = record[:, 12] < LEAST_ROUGHNESS
    for sample in range(ROUGH_SAMPLES):
        which = np.flatnonzero(~smooth) if sample else np.arange(len(record))
        direction = np.empty((len(which), 3), np.float32)
        before = np.empty(len(which), np.float32)
        mirror_rays(which, record, ground_from_camera, sample, direction, before)
        pixel = record[which, 6] / before / lens[0]
        light, alpha = trace(record[which, :3], direction, before, pixel)
        if sample:
            light_out[which] += light
        else:
            light_out[:] = light
            source_out[:] = np.where(alpha > HALF, TRACED, ENVIRONMENT)
    light_out[~smooth] /= ROUGH_SAMPLES


@cpu_kernel
def keep_tall(depth, clearance, tall_out):
    """Keep the depth of what water can mirror: level water cannot mirror the ground it lies on."""
    height, width = depth.shape
    for row in prange(height):
        for column in range(width):
            low = clearance[row, column] < NOT_GROUND
            tall_out[row, column] = np.float32(np.inf) if low else depth[row, column]


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
