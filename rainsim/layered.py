"""The mirrored picture in two layers: what is near, and what lies behind it.

Where a spoke and the sky behind it share a pixel of the mirrored picture, that pixel has the mean
of two depths, and a ray that ripples bend ends at neither; and the picture does not show what the
spoke hides, which a bent ray may see. So the splats nearer than a split are blended apart from the
others. The near layer holds how much of what lies behind comes through it (T) and what it adds (N),
such that N + T F is, pixel by pixel, the wet picture of both, F being the wet picture of what lies
behind alone; each of the two is looked up where the bent ray meets it, at a depth of its own.
"""

from __future__ import annotations

import numpy as np

from rainsim.jit import cpu_kernel, device_function, prange
from rainsim.light import linear_from_display
from rainsim.optics import column_of
from rainsim.pyramid import blurred_color, cell_of, coarsened, level_of
from rainsim.reflect import (
    ENVIRONMENT,
    MIRROR,
    SPREAD,
    blur_of,
    march_mirror,
    sample_ray,
    samples_of,
)  # fmt: skip
from rainsim.shade import FAR_AWAY, LEAST_ALPHA, grade_rays, is_edge

ZERO = np.float32(0)
ONE = np.float32(1)
TWO = np.float32(2)
FOUR = np.float32(4)

EYE_HEIGHTS = 5.0  # of the eye over the water: where the splats are split; see docs/light.md
SHOWS = np.float32(1 / 255)  # alpha from which a near thing is part of the near layer
CELL = 4  # px, side of the cells in which the near layer has a depth
TURNS = 2  # of finding the depth where a bent ray looks, after the first


def split_depth(eye_height):
    """Return where to split what the mirrored camera sees [m]."""
    return EYE_HEIGHTS * max(eye_height, 0.1)


def layered(near, far, view, unit, open_sky, grade):
    """Return what `layered_light` takes of splats drawn apart.

    Parameters
    ----------
    near, far : raster.Layers
    view : waterview.View
        Of `far`, graded and wet.
    unit : float32 [m]
        Of the depths of `near` and `far`.
    open_sky : float32
        As the last number of the `look` that `shade.grade_and_wet` takes.
    grade : callable
        grade(color, alpha, distance, plane_distance, normal, direction) returns the radiance of
        rays; parameters as `shade.grade_rays` takes them, distances in units.

    Returns
    -------
    far : ndarray of shape (rows, columns, 3), float32
        The wet picture of what lies behind.
    far_coarse : ndarray of shape (rows, columns // 2, 3), float32
        See `pyramid.coarsened`.
    far_depth : ndarray of shape (rows, columns), float32 [m]
    near : ndarray of shape (rows, columns, 4), float32
        Radiance that the near layer adds, and the share of what lies behind that it lets through.
    near_coarse : ndarray of shape (rows, columns // 2, 4), float32
    near_depth : ndarray of shape (rows // 4, columns // 4), float32 [m]
        Of cells of 4 pixels; where nothing is near, that of what is near around.
    """
    which = np.flatnonzero(near.alpha > SHOWS)
    rays = [np.empty((len(which), 3), np.float32) if vector else np.empty(len(which), np.float32)
            for vector in (True, False, False, False, True, True)]  # fmt: skip
    gather(
        which, near.color, near.alpha, near.depth, near.plane_depth, near.normal, far.color,
        far.alpha, view.turn, view.lens, *rays,
    )  # fmt: skip
    picture = np.empty((*near.alpha.shape, 4), np.float32)
    lay_apart(which, grade(*rays), near.alpha, far.alpha, open_sky, view.picture, picture)
    return (
        view.picture, coarsened(view.picture), view.depth, picture, coarsened(picture),
        spread_depth(near.alpha, near.depth) * unit,
    )  # fmt: skip


def grader(eye, unit, shading):
    """Return the `grade` that `layered` takes.

    Parameters
    ----------
    eye : ndarray of shape (3,), float32 [m]
    unit : float32 [m]
        Of the distances.
    shading : tuple
        What `shade.grade_rays` takes from the bed on.
    """

    def grade(color, alpha, distance, plane_distance, normal, direction):
        light = np.empty_like(color)
        grade_rays(
            color, alpha, distance * unit, plane_distance * unit, normal,
            np.ascontiguousarray(np.broadcast_to(eye, color.shape)), direction, *shading, light,
        )  # fmt: skip
        return light

    return grade


def spread_depth(alpha, depth):
    """Return mean depths of cells of CELL pixels, spread to those that show nothing.

    Parameters
    ----------
    alpha : ndarray of shape (rows, columns), float32
    depth : ndarray of shape (rows, columns), float32
        Infinite where there is none.
    """
    rows, columns = (n // CELL for n in alpha.shape)
    weight, sums = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.float32)
    _cell_sums(alpha, depth, weight, sums)
    levels = []
    while True:
        levels.append((weight, sums))
        if min(weight.shape) == 1:
            break
        weight, sums = (_halved(a) for a in (weight, sums))
    total = weight.sum()
    mean = np.full(weight.shape, sums.sum() / total if total > 0 else FAR_AWAY, np.float32)
    for weight, sums in reversed(levels):
        j, i = (np.minimum(np.arange(n) // 2, m - 1) for n, m in zip(weight.shape, mean.shape,
                                                                     strict=True))  # fmt: skip
        if weight.shape != mean.shape:
            mean = mean[j[:, None], i]
        mean = np.where(weight > SHOWS, sums / np.maximum(weight, SHOWS), mean)
    return np.ascontiguousarray(mean, np.float32)


def _halved(cells):
    """Return the sums of two by two cells; what has no partner is left out."""
    rows, columns = (n // 2 * 2 for n in cells.shape)
    return cells[:rows].reshape(rows // 2, 2, -1).sum(axis=1)[:, :columns].reshape(
        rows // 2, columns // 2, 2
    ).sum(axis=2)  # fmt: skip


@cpu_kernel
def _cell_sums(alpha, depth, weight_out, sum_out):
    rows, columns = weight_out.shape
    for j in prange(rows):
        for i in range(columns):
            weight, total = ZERO, ZERO
            for row in range(CELL * j, CELL * j + CELL):
                for column in range(CELL * i, CELL * i + CELL):
                    if depth[row, column] < FAR_AWAY:
                        weight += alpha[row, column]
                        total += alpha[row, column] * depth[row, column]
            weight_out[j, i], sum_out[j, i] = weight, total


@cpu_kernel
def gather(
    which, near_color, near_alpha, near_depth, near_plane, near_normal, far_color, far_alpha,
    ground_from_camera, lens, color_out, alpha_out, distance_out, plane_out, normal_out,
    direction_out,
):  # fmt: skip
    """List what some pixels show of both layers, as `shade.grade_rays` takes it.

    Parameters
    ----------
    which : ndarray of shape (n,), int64
        Pixels.
    near_color, near_alpha, near_depth, near_plane, near_normal, far_color, far_alpha
        Of `raster.Layers`: the splats nearer than the split, and the others.
    color_out, direction_out, normal_out : ndarray of shape (n, 3), float32
        Ground frame.
    alpha_out, distance_out, plane_out : ndarray of shape (n,), float32
        Distances along the pixel's ray in the unit of the depths.
    """
    columns = near_alpha.shape[1]
    m = ground_from_camera
    for n in prange(len(which)):
        row, column = which[n] // columns, which[n] % columns
        a = (np.float32(column) + np.float32(0.5) - lens[2]) / lens[0]
        b = (np.float32(row) + np.float32(0.5) - lens[3]) / lens[1]
        length = np.sqrt(a * a + b * b + ONE)
        through = ONE - near_alpha[row, column]
        for c in range(3):
            color_out[n, c] = near_color[row, column, c] + through * far_color[row, column, c]
            x, y, z = near_normal[row, column]
            normal_out[n, c] = m[c, 0] * x + m[c, 1] * y + m[c, 2] * z
            direction_out[n, c] = (m[c, 0] * a + m[c, 1] * b + m[c, 2]) / length
        alpha_out[n] = ONE - through * (ONE - far_alpha[row, column])
        distance_out[n] = near_depth[row, column] * length
        plane_out[n] = near_plane[row, column] * length


@cpu_kernel
def lay_apart(which, light, near_alpha, far_alpha, open_sky, far, near_out):
    """Write the near layer: what it adds to what lies behind, and what it lets through of that.

    Parameters
    ----------
    which : ndarray of shape (n,), int64
        Pixels that show something near.
    light : ndarray of shape (n, 3), float32
        The wet picture of both layers there.
    far : ndarray of shape (rows, columns, 3), float32
        The wet picture of what lies behind.
    near_out : ndarray of shape (rows, columns, 4), float32
    """
    rows, columns = near_alpha.shape
    for row in prange(rows):
        for column in range(columns):
            for c in range(3):
                near_out[row, column, c] = ZERO
            near_out[row, column, 3] = ONE
    for n in prange(len(which)):
        row, column = which[n] // columns, which[n] % columns
        through = ONE - near_alpha[row, column]
        # As the picture mixes: splats as they are displayed, what is open in linear light.
        if not is_edge(ONE - through * (ONE - far_alpha[row, column]), open_sky):
            through = linear_from_display(through)
        for c in range(3):
            near_out[row, column, c] = light[n, c] - through * far[row, column, c]
        near_out[row, column, 3] = through


@cpu_kernel
def layered_light(
    which, record, ground_from_camera, eye, lens, level, far, far_coarse, far_depth, near,
    near_coarse, near_depth, steps, thickness, light_out, source_out,
):  # fmt: skip
    """Look the mirrored light up in a mirrored picture of two layers.

    Parameters are those of `mirrorlight.mirror_light` and what `layered` returns.
    """
    m = ground_from_camera
    rows, columns = far_depth.shape
    for k in prange(len(which)):
        n = which[k]
        r = record[n]
        vx, vy, vz, gx, gy = r[3], r[4], r[5], r[10], r[11]
        # Where the mirrored picture shows the surface itself, at depth z0.
        wx, wy, wz = r[0] - eye[0], r[1] - eye[1], TWO * level - r[2] - eye[2]
        z0 = column_of(m, 2, wx, wy, wz)
        u0 = lens[0] * column_of(m, 0, wx, wy, wz) / z0 + lens[2]
        v0 = lens[1] * column_of(m, 1, wx, wy, wz) / z0 + lens[3]
        samples, a, b, c = samples_of(r[12], r[13], r[14], SPREAD)
        blur = ZERO
        if samples > 1:
            blur = blur_of(m, lens, vx, vy, vz, gx, gy, r[12] * r[13] - r[14] * r[14])
        light0, light1, light2 = ZERO, ZERO, ZERO
        for s in range(samples):
            rx, ry, rz = sample_ray(vx, vy, vz, gx, gy, a, b, c, s)
            gain = max(column_of(m, 2, rx, ry, -rz), np.float32(0.02))
            du = lens[0] * column_of(m, 0, rx, ry, -rz) / gain + lens[2] - u0
            dv = lens[1] * column_of(m, 1, rx, ry, -rz) / gain + lens[3] - v0
            t = way_to(near_depth, z0, u0, v0)
            for _ in range(TURNS):
                t = way_to(near_depth, z0, u0 + t * du, v0 + t * dv)
            n0, n1, n2, through = blurred_layer(
                near, near_coarse, u0 + t * du, v0 + t * dv, blur * t
            )
            if through > SHOWS:
                hu, hv, share = march_mirror(
                    m, lens, level, eye, r[0], r[1], r[2], rx, ry, rz, far_depth, steps, thickness
                )
                c0, c1, c2 = blurred_color(far, far_coarse, hu, hv, blur * share)
                n0, n1, n2 = n0 + through * c0, n1 + through * c1, n2 + through * c2
            light0, light1, light2 = light0 + n0, light1 + n1, light2 + n2
        share = ONE / np.float32(samples)
        light_out[n, 0], light_out[n, 1] = max(light0 * share, ZERO), max(light1 * share, ZERO)
        light_out[n, 2] = max(light2 * share, ZERO)
        i, j = min(max(int(u0), 0), columns - 1), min(max(int(v0), 0), rows - 1)
        solid = far_depth[j, i] < FAR_AWAY or near[j, i, 3] < ONE - LEAST_ALPHA
        source_out[n] = MIRROR if solid else ENVIRONMENT


@device_function
def way_to(near_depth, z0, u, v):
    """Return how far on the way to its vanishing point a ray is that meets what (u, v) shows."""
    rows, columns = near_depth.shape
    i = np.uint32(min(max(u, ZERO) / FOUR, np.float32(columns - 1)))
    j = np.uint32(min(max(v, ZERO) / FOUR, np.float32(rows - 1)))
    return max(ONE - z0 / near_depth[j, i], ZERO)


@device_function
def blurred_layer(near, coarse, u, v, blur):
    """Return the four numbers of the near layer at image point (u, v), blurred.

    As `pyramid.blurred_color`.
    """
    height, width = near.shape[0], near.shape[1]
    level = level_of(height, width, blur)
    j, i, a, b = cell_of(height, width, level, u, v)
    cells = coarse if level > 0 else near
    p, q, r, s = cells[j, i], cells[j, i + 1], cells[j + 1, i], cells[j + 1, i + 1]
    w0, w1, w2, w3 = (ONE - a) * (ONE - b), a * (ONE - b), (ONE - a) * b, a * b
    return (
        p[0] * w0 + q[0] * w1 + r[0] * w2 + s[0] * w3,
        p[1] * w0 + q[1] * w1 + r[1] * w2 + s[1] * w3,
        p[2] * w0 + q[2] * w1 + r[2] * w2 + s[2] * w3,
        p[3] * w0 + q[3] * w1 + r[3] * w2 + s[3] * w3,
    )  # fmt: skip
