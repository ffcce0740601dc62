"""The paper's (RainyGS) water as baselines: spheres for its surface, a point test for reflections.

Its other choices are single formulas and stand where ours do: the image shift of refraction and
the highlight (n.h)^p in `optics`, Schlick's reflectance in `light`.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.jit import cpu_kernel, device_function, prange, serial_kernel
from rainsim.optics import column_of, normal_of
from rainsim.reflect import ENVIRONMENT, SCREEN, reflected_upwards
from rainsim.sky import sample_environment
from rainsim.ssr import NEAR

RADIUS = np.float32(0.006)  # m of the spheres; the paper's unit is unknown, metres are taken
EPSILON = 0.03  # m, thickness of the paper's point test
LEAST_WATER = np.float32(1e-6)  # m of water that a cell must hold

ZERO = np.float32(0)
ONE = np.float32(1)
HALF = np.float32(0.5)


@serial_kernel
def meet_spheres(
    depth, ground_from_camera, eye, lens, surface, water_depth, origin, spacing,
    hit_out, coverage_out, count_out,
):  # fmt: skip
    """Draw the water as spheres at the height map's cells; arguments as in `meeting.meet_water`.

    Between cells wider than the spheres there are holes.
    """
    height, width = depth.shape
    ny, nx = surface.shape
    m = ground_from_camera
    hit_out[:] = np.float32(np.inf)
    coverage_out[:] = ZERO
    for j in range(1, ny - 1):
        for i in range(1, nx - 1):
            if not water_depth[j, i] > LEAST_WATER:
                continue
            x = origin[0] + (np.float32(i) + HALF) * spacing - eye[0]
            y = origin[1] + (np.float32(j) + HALF) * spacing - eye[1]
            z = surface[j, i] - eye[2]
            cz = column_of(m, 2, x, y, z)
            if cz < NEAR + RADIUS:
                continue
            u = lens[0] * column_of(m, 0, x, y, z) / cz + lens[2]
            v = lens[1] * column_of(m, 1, x, y, z) / cz + lens[3]
            reach = lens[0] * RADIUS / cz
            for row in range(max(int(v - reach), 0), min(int(v + reach) + 1, height)):
                for column in range(max(int(u - reach), 0), min(int(u + reach) + 1, width)):
                    du, dv = np.float32(column) + HALF - u, np.float32(row) + HALF - v
                    inside = reach * reach - du * du - dv * dv
                    if inside < ZERO:
                        continue
                    t = cz - math.sqrt(inside) * cz / lens[0]
                    if t < hit_out[row, column] and t < depth[row, column]:
                        hit_out[row, column] = t
                        coverage_out[row, column] = ONE
    for row in range(height):
        count = 0
        for column in range(width):
            if coverage_out[row, column] > ZERO:
                count += 1
        count_out[row] = count


@cpu_kernel
def paper_light(
    which, record, picture, tall, ground_from_camera, eye, lens, environment, settings,
    light_out, source_out,
):  # fmt: skip
    """Find the mirrored light as the paper (RainyGS, supplement, "Screen-space reflection") does.

    The ray of each pixel's own rippled normal is marched pixel by pixel; a point test with the
    thickness settings[0] is the hit; the environment is the fallback. Arguments as in
    `march_light`, without `bounds`.
    """
    m = ground_from_camera
    for k in prange(len(which)):
        n = which[k]
        r = record[n]
        ux, uy, uz = normal_of(r[10], r[11])
        rx, ry, rz = reflected_upwards(r[3], r[4], r[5], ux, uy, uz)
        px, py, pz = r[0] - eye[0], r[1] - eye[1], r[2] - eye[2]
        row, column = march_points(
            tall, lens, column_of(m, 0, px, py, pz), column_of(m, 1, px, py, pz), r[6],
            column_of(m, 0, rx, ry, rz), column_of(m, 1, rx, ry, rz), column_of(m, 2, rx, ry, rz),
            settings[0], settings[2],
        )  # fmt: skip
        if row >= 0:
            light_out[n, 0], light_out[n, 1] = picture[row, column, 0], picture[row, column, 1]
            light_out[n, 2] = picture[row, column, 2]
            source_out[n] = SCREEN
        else:
            c0, c1, c2 = sample_environment(environment, rx, ry, rz)
            light_out[n, 0], light_out[n, 1], light_out[n, 2] = c0, c1, c2
            source_out[n] = ENVIRONMENT


@device_function
def march_points(depth, lens, x, y, z, dx, dy, dz, epsilon, farthest):
    """Find a ray's hit as the paper (RainyGS) does: the first pixel with D <= Z < D + epsilon.

    Arguments as in `march`, steps of one pixel.

    Returns
    -------
    row, column : int
        Negative if nothing was met within the picture.
    """
    height, width = depth.shape
    length = farthest
    if dz < ZERO:
        length = min(length, (z - NEAR) / -dz)
    if length <= ZERO:
        return -1, -1
    iz0, iz1 = ONE / z, ONE / (z + dz * length)
    u0, v0 = lens[0] * x * iz0 + lens[2], lens[1] * y * iz0 + lens[3]
    du = lens[0] * (x + dx * length) * iz1 + lens[2] - u0
    dv = lens[1] * (y + dy * length) * iz1 + lens[3] - v0
    steps = int(max(abs(du), abs(dv)))
    for k in range(1, steps + 1):
        t = np.float32(k) / np.float32(steps)
        u, v = u0 + du * t, v0 + dv * t
        if not (u >= ZERO and v >= ZERO and u < np.float32(width) and v < np.float32(height)):
            break
        now = ONE / (iz0 + (iz1 - iz0) * t)
        surface = depth[int(v), int(u)]
        if surface <= now and now < surface + epsilon:
            return int(v), int(u)
    return -1, -1
