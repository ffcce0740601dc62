"""Projection: each splat to an ellipse in the picture, its colour, and the tiles it meets."""

import math
from typing import NamedTuple

import numpy as np

from rainsim import jit
from rainsim.constants import FOUR, HALF, ONE, SH_0, SH_1, SH_2, SH_3, THREE, TWO, ZERO
from rainsim.jit import prange
from rainsim.splatting.prepared import LANES, OPACITY

BAND = 3 * LANES  # numbers of a chunk from one coefficient of a channel to the next
TILE, TILE_SHIFT = 16, 4  # px, and log2 of it
BLOCKS = 32  # parts of the scene with tile counts of their own; fixed, whatever the threads
RECORD = 16  # float32 numbers of a projected splat: one cache line
# Places in a record: image point [px], conic (3) and log2 opacity in eighths, colour (3), depth,
# normal (3), distance of the splat's plane, exponent at which the splat ends.
R_U, R_V, R_CONIC, R_LEVEL, R_COLOR, R_DEPTH = 0, 1, 2, 5, 6, 9
R_NORMAL, R_PLANE, R_REACH = 10, 13, 14

LOW_PASS = np.float32(0.3)  # px^2, added to the projected covariance (Kerbl et al. 2023)
BLOCK_HALF = np.float32(1.5)  # px from the centre of a block to those of its outer pixels
SLACK = np.float32(1.01)  # on the square of a splat's reach: for rounding
LOW_PASS_REACH = np.float32(2)  # px, rounded up
MIN_ALPHA_LOG2 = np.float32(np.log2(1 / 255))  # below this an 8-bit image does not change
FRUSTUM_MARGIN = np.float32(0.15)  # of the picture: where the linearised projection is clamped
NO_PLANE = np.array([0, 0, 0, -1], np.float32)  # cuts nothing away

TWO_LN2 = np.float32(2 * np.log(2))
# Exponents are kept as eighths of log2: e^x = (2^(x log2(e) / 8))^8.
EIGHTH = np.float32(0.125)
HALF_LOG2E = np.float32(0.125 * 0.5 / np.log(2))

# Factors of the spherical harmonics in single precision.
SH0, SH1 = np.float32(SH_0), np.float32(SH_1)
SH2A, SH2B, SH2C = (np.float32(factor) for factor in SH_2)
SH3A, SH3B, SH3C, SH3D, SH3E = (np.float32(factor) for factor in SH_3)

# Rows of a chunk's scratch: what the first pass leaves for the others.
# All lie in one array at fixed distances: so LLVM knows that they do not overlap, and vectorises.
X, Y, Z, U, V, CONIC_A, CONIC_B, CONIC_C, LEVEL, LEFT, RIGHT, FIRST, LAST, RED, GREEN, BLUE = (
    LANES * row for row in range(16)
)
DX, DY, DZ, SPREAD, NORMAL_X, NORMAL_Y, NORMAL_Z, PLANE, REST, SCRATCH = (
    LANES * row for row in range(16, 26)
)
REACH = SPREAD  # once the spread is no longer needed


class SplatChunks(NamedTuple):
    """Prepared splats, see `prepared.PreparedSplats`."""

    geometry: np.ndarray
    sh: np.ndarray
    fine: np.ndarray
    step: np.ndarray


class Frustum(NamedTuple):
    """The part of space that a camera sees.

    camera_from_world : float32 array (3 or 4, 4). Its first three rows are read.
    lens : float32 array (4,) [px]. Focal lengths and principal point: fx, fy, cx,
        cy.
    size : float32 array (2,) [px]. Width and height.
    near : float32 [world units]
    plane : float32 array (4,). (a, b, c, d): what has a x + b y + c z < d is cut
        away.
    orthographic : bool
    """

    camera_from_world: np.ndarray
    lens: np.ndarray
    size: np.ndarray
    near: np.float32
    plane: np.ndarray
    orthographic: bool


class Pose(NamedTuple):
    """The first three rows of the view matrix as numbers: camera frame from world frame."""

    v00: np.float32
    v01: np.float32
    v02: np.float32
    v03: np.float32
    v10: np.float32
    v11: np.float32
    v12: np.float32
    v13: np.float32
    v20: np.float32
    v21: np.float32
    v22: np.float32
    v23: np.float32


class Lens(NamedTuple):
    """Focal lengths and principal point [px], and limits of x / z and y / z for linearising.

    Beyond `x_low` to `x_high` and `y_low` to `y_high` the projection is linearised at the limit.
    """

    fx: np.float32
    fy: np.float32
    cx: np.float32
    cy: np.float32
    x_low: np.float32
    x_high: np.float32
    y_low: np.float32
    y_high: np.float32
    orthographic: bool


@jit.device_function
def chunk_is_out(box, frustum):
    """Return whether no splat of the chunk's box can touch the picture; False if in doubt."""
    view, lens, size, near, plane, orthographic = frustum
    corners = 8
    beside0, beside1, beside2, beside3, behind, cut = 0, 0, 0, 0, 0, 0
    # With the margin at which projection is clamped, a box beside the picture holds no splat whose
    # linearised ellipse comes back into it.
    mx, my = FRUSTUM_MARGIN * size[0] + LOW_PASS_REACH, FRUSTUM_MARGIN * size[1] + LOW_PASS_REACH
    for corner in range(corners):
        px = box[0] if corner & 1 == 0 else box[3]
        py = box[1] if corner & 2 == 0 else box[4]
        pz = box[2] if corner & 4 == 0 else box[5]
        if plane[0] * px + plane[1] * py + plane[2] * pz < plane[3]:
            cut += 1
        z = view[2, 0] * px + view[2, 1] * py + view[2, 2] * pz + view[2, 3]
        if z < near:
            behind += 1
        x = view[0, 0] * px + view[0, 1] * py + view[0, 2] * pz + view[0, 3]
        y = view[1, 0] * px + view[1, 1] * py + view[1, 2] * pz + view[1, 3]
        w = ONE if orthographic else z  # u = lens * x / w + centre, without the division
        u, v = lens[0] * x + lens[2] * w, lens[1] * y + lens[3] * w
        beside0 += u < -mx * w
        beside1 += u > (size[0] + mx) * w
        beside2 += v < -my * w
        beside3 += v > (size[1] + my) * w
    if behind == corners or cut == corners:
        return True
    if behind > 0 and not orthographic:
        return False  # the linearised projection of what crosses the near plane may go anywhere
    return beside0 == corners or beside1 == corners or beside2 == corners or beside3 == corners


@jit.inlined_function
def project_splat(position, covariance, pose, lens):
    """Project one splat.

    position : tuple of 3 float32
    covariance : tuple of 6 float32. xx, xy, xz, yy, yz, zz.
    Returns tuple of 12 float32. Camera point (3), image point (2), conic in
        eighths of log2 (3), the variances along the picture's axes and the
        determinant with the low-pass, and the determinant before it.
    """
    px, py, pz = position
    c0, c1, c2, c3, c4, c5 = covariance
    v00, v01, v02, v03, v10, v11, v12, v13, v20, v21, v22, v23 = pose
    fx, fy, cx, cy, x_low, x_high, y_low, y_high, orthographic = lens
    x = v00 * px + v01 * py + v02 * pz + v03
    y = v10 * px + v11 * py + v12 * pz + v13
    z = v20 * px + v21 * py + v22 * pz + v23
    iz = ONE if orthographic else ONE / z
    tx, ty = x * iz, y * iz
    lx = ZERO if orthographic else min(max(tx, x_low), x_high)
    ly = ZERO if orthographic else min(max(ty, y_low), y_high)
    a, b = fx * iz, fy * iz
    # Rows of J V: the linearised projection (Zwicker et al. 2001).
    j00, j01, j02 = a * (v00 - lx * v20), a * (v01 - lx * v21), a * (v02 - lx * v22)
    j10, j11, j12 = b * (v10 - ly * v20), b * (v11 - ly * v21), b * (v12 - ly * v22)
    t0 = c0 * j00 + c1 * j01 + c2 * j02
    t1 = c1 * j00 + c3 * j01 + c4 * j02
    t2 = c2 * j00 + c4 * j01 + c5 * j02
    m00 = j00 * t0 + j01 * t1 + j02 * t2
    m01 = j10 * t0 + j11 * t1 + j12 * t2
    q0 = c0 * j10 + c1 * j11 + c2 * j12
    q1 = c1 * j10 + c3 * j11 + c4 * j12
    q2 = c2 * j10 + c4 * j11 + c5 * j12
    m11 = j10 * q0 + j11 * q1 + j12 * q2
    spread = m00 * m11 - m01 * m01
    m00 += LOW_PASS
    m11 += LOW_PASS
    determinant = m00 * m11 - m01 * m01
    scale = HALF_LOG2E / determinant
    u, v = fx * tx + cx, fy * ty + cy
    conic_a, conic_b, conic_c = m11 * scale, -TWO * m01 * scale, m00 * scale
    return x, y, z, u, v, conic_a, conic_b, conic_c, m00, m11, determinant, spread


@jit.inlined_function
def half_extents(level, m00, m11):
    """Return how far [px] a splat of log2 opacity `level` reaches along each axis."""
    reach = TWO_LN2 * max(level - MIN_ALPHA_LOG2, ZERO)  # -2 ln(1/255 / opacity)
    return math.sqrt(reach * m00), math.sqrt(reach * m11)


@jit.inlined_function
def compensation(spread, determinant):
    """Return the term of Mip-Splatting (Yu et al. 2024, eq. 9) for a splat's log2 opacity.

    A splat widened by the low-pass keeps its light.
    """
    return HALF * math.log2(max(spread, ZERO) / determinant)


@jit.inlined_function
def color_constant(s0):
    """Return a channel's colour of degree 0 from its coefficient."""
    return SH0 * s0 + HALF


@jit.inlined_function
def color_degree_1(x, y, z, s1, s2, s3):
    """Return the part of degree 1 in a channel seen along the unit vector (x, y, z)."""
    return SH1 * (z * s2 - y * s1 - x * s3)


@jit.inlined_function
def color_degree_2(x, y, z, s4, s5, s6, s7, s8):
    """Return the part of degree 2 in the channel, arguments as for degree 1."""
    xx, yy, zz = x * x, y * y, z * z
    value = SH2A * (x * y * s4 - y * z * s5 - x * z * s7)
    value += SH2B * (TWO * zz - xx - yy) * s6
    value += SH2C * (xx - yy) * s8
    return value


@jit.inlined_function
def color_degree_3(x, y, z, s9, s10, s11, s12, s13, s14, s15):
    """Return the part of degree 3 in the channel, arguments as for degree 1."""
    xx, yy, zz = x * x, y * y, z * z
    value = SH3B * x * y * z * s10
    value -= SH3A * y * (THREE * xx - yy) * s9
    value -= SH3C * (FOUR * zz - xx - yy) * (y * s11 + x * s13)
    value += SH3D * z * (TWO * zz - THREE * xx - THREE * yy) * s12
    value += SH3E * z * (xx - yy) * s14
    value -= SH3A * x * (xx - THREE * yy) * s15
    return value


@jit.inlined_function
def facing_normal(normal, point, pose, orthographic):
    """Return a splat's normal in the camera frame, towards the camera, and its plane's distance.

    `normal` is in the world frame, `point` in the camera frame, tuples of three; `pose` is a Pose.
    """
    nx, ny, nz = normal
    x, y, z = point
    v00, v01, v02, _, v10, v11, v12, _, v20, v21, v22, _ = pose
    n0 = v00 * nx + v01 * ny + v02 * nz
    n1 = v10 * nx + v11 * ny + v12 * nz
    n2 = v20 * nx + v21 * ny + v22 * nz
    distance = n0 * x + n1 * y + n2 * z
    away = n2 if orthographic else distance
    if away > ZERO:
        n0, n1, n2, distance = -n0, -n1, -n2, -distance
    return n0, n1, n2, distance


@jit.device_function
def pose_of(view):
    """Return the `Pose` of a view matrix."""
    return Pose(
        view[0, 0], view[0, 1], view[0, 2], view[0, 3], view[1, 0], view[1, 1], view[1, 2],
        view[1, 3], view[2, 0], view[2, 1], view[2, 2], view[2, 3],
    )  # fmt: skip


@jit.device_function
def project_chunk(g, frustum, compensate, s):
    """Fill the scratch rows `s` up to LAST; FIRST is above LAST for splats that are not seen."""
    view, lens, size, near, plane, orthographic = frustum
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    w, h = size[0], size[1]
    x_low, x_high = (-cx - FRUSTUM_MARGIN * w) / fx, (w - cx + FRUSTUM_MARGIN * w) / fx
    y_low, y_high = (-cy - FRUSTUM_MARGIN * h) / fy, (h - cy + FRUSTUM_MARGIN * h) / fy
    pose = pose_of(view)
    limited = Lens(fx, fy, cx, cy, x_low, x_high, y_low, y_high, orthographic)
    p0, p1, p2, p3 = plane[0], plane[1], plane[2], plane[3]
    for i in range(LANES):
        px, py, pz = g[i], g[1 * LANES + i], g[2 * LANES + i]
        covariance = (
            g[3 * LANES + i], g[4 * LANES + i], g[5 * LANES + i],
            g[6 * LANES + i], g[7 * LANES + i], g[8 * LANES + i],
        )  # fmt: skip
        x, y, z, u, v, a, b, c, m00, m11, determinant, spread = project_splat(
            (px, py, pz), covariance, pose, limited
        )
        s[SPREAD + i] = spread
        s[X + i], s[Y + i], s[Z + i] = x, y, z
        s[U + i], s[V + i] = u, v
        s[CONIC_A + i], s[CONIC_B + i], s[CONIC_C + i] = a, b, c
        s[LEFT + i], s[FIRST + i] = m00, m11
        s[RIGHT + i] = determinant
        kept = z >= near and determinant > ZERO and p0 * px + p1 * py + p2 * pz >= p3
        s[LEVEL + i] = g[OPACITY * LANES + i] if kept else np.float32(-np.inf)
    if compensate:
        for i in range(LANES):
            s[LEVEL + i] += compensation(s[SPREAD + i], s[RIGHT + i])
    for i in range(LANES):
        level = s[LEVEL + i]
        ex, ey = half_extents(level, s[LEFT + i], s[FIRST + i])
        u, v = s[U + i], s[V + i]
        # Pixels whose centres lie in the ellipse's box.
        left, right = np.ceil(max(u - ex - HALF, ZERO)), np.floor(min(u + ex - HALF, w - ONE))
        first, last = np.ceil(max(v - ey - HALF, ZERO)), np.floor(min(v + ey - HALF, h - ONE))
        seen = level > MIN_ALPHA_LOG2 and right >= left and last >= first
        s[REACH + i] = SLACK * EIGHTH * max(level - MIN_ALPHA_LOG2, ZERO)
        s[LEFT + i], s[RIGHT + i] = left, right
        s[FIRST + i], s[LAST + i] = (first if seen else ONE), (last if seen else ZERO)


@jit.device_function
def color_chunk(g, sh, fine, step, eye, orthographic, bands, s):
    """Fill the scratch rows RED to RED + 2 with the colours seen from `eye`.

    Harmonics up to degree 1 are in `sh`, those above in `fine`, one factor per run in `step`.
    `eye` is the camera's position, or its view direction if orthographic.
    """
    e0, e1, e2 = eye[0], eye[1], eye[2]
    for i in range(LANES):
        dx = e0 if orthographic else g[i] - e0
        dy = e1 if orthographic else g[1 * LANES + i] - e1
        dz = e2 if orthographic else g[2 * LANES + i] - e2
        length = ONE / np.sqrt(dx * dx + dy * dy + dz * dz)
        s[DX + i], s[DY + i], s[DZ + i] = dx * length, dy * length, dz * length
    for c in range(3):
        color = RED + c * LANES
        if bands == 1:
            for i in range(LANES):
                s[color + i] = max(color_constant(sh[c * LANES + i]), ZERO)
            continue
        for i in range(LANES):
            q = c * LANES + i
            x, y, z = s[DX + i], s[DY + i], s[DZ + i]
            value = color_degree_1(x, y, z, sh[q + BAND], sh[q + 2 * BAND], sh[q + 3 * BAND])
            s[color + i] = value + color_constant(sh[q])
        if bands > 2:
            t4, t5, t6, t7, t8 = step[c], step[c + 3], step[c + 6], step[c + 9], step[c + 12]
            for i in range(LANES):
                q = c * LANES + i
                s[color + i] += color_degree_2(
                    s[DX + i], s[DY + i], s[DZ + i], t4 * fine[q], t5 * fine[q + BAND],
                    t6 * fine[q + 2 * BAND], t7 * fine[q + 3 * BAND], t8 * fine[q + 4 * BAND],
                )  # fmt: skip
        if bands > 3:
            t0, t1, t2, t3 = step[c + 15], step[c + 18], step[c + 21], step[c + 24]
            t4, t5, t6 = step[c + 27], step[c + 30], step[c + 33]
            for i in range(LANES):
                q = c * LANES + i
                s[color + i] += color_degree_3(
                    s[DX + i], s[DY + i], s[DZ + i], t0 * fine[q + 5 * BAND],
                    t1 * fine[q + 6 * BAND], t2 * fine[q + 7 * BAND], t3 * fine[q + 8 * BAND],
                    t4 * fine[q + 9 * BAND], t5 * fine[q + 10 * BAND], t6 * fine[q + 11 * BAND],
                )  # fmt: skip
        for i in range(LANES):
            s[color + i] = max(s[color + i], ZERO)


@jit.device_function
def face_chunk(g, frustum, deep, s):
    """Fill the scratch rows NORMAL_X to REST: normals, planes, rounding errors of depths."""
    pose, orthographic = pose_of(frustum.camera_from_world), frustum.orthographic
    d0, d1, d2, d3 = deep[0], deep[1], deep[2], deep[3]
    for i in range(LANES):
        normal = g[9 * LANES + i], g[10 * LANES + i], g[11 * LANES + i]
        point = s[X + i], s[Y + i], s[Z + i]
        s[NORMAL_X + i], s[NORMAL_Y + i], s[NORMAL_Z + i], s[PLANE + i] = facing_normal(
            normal, point, pose, orthographic
        )
    for i in range(LANES):
        exact = d0 * g[i] + d1 * g[1 * LANES + i] + d2 * g[2 * LANES + i] + d3
        s[REST + i] = np.float32(exact - np.float64(s[Z + i]))


@jit.device_function
def write_records(s, across, place, record_out, depth_out, box_out, lane_out, count_out):
    """Write the seen splats of a chunk one after the other; return their number."""
    # Unsigned numbers: numba then need not ask whether an index counts from the end.
    o, wide = np.uint64(place), np.uint64(across)
    for i in range(LANES):
        if s[FIRST + i] > s[LAST + i]:
            continue
        record_out[o, R_U], record_out[o, R_V] = s[U + i], s[V + i]
        record_out[o, R_CONIC] = s[CONIC_A + i]
        record_out[o, R_CONIC + 1] = s[CONIC_B + i]
        record_out[o, R_CONIC + 2] = s[CONIC_C + i]
        record_out[o, R_LEVEL] = s[LEVEL + i] * EIGHTH
        record_out[o, R_COLOR] = s[RED + i]
        record_out[o, R_COLOR + 1] = s[GREEN + i]
        record_out[o, R_COLOR + 2] = s[BLUE + i]
        record_out[o, R_DEPTH] = s[Z + i]
        record_out[o, R_NORMAL] = s[NORMAL_X + i]
        record_out[o, R_NORMAL + 1] = s[NORMAL_Y + i]
        record_out[o, R_NORMAL + 2] = s[NORMAL_Z + i]
        record_out[o, R_PLANE] = s[PLANE + i]
        record_out[o, R_REACH] = s[REACH + i]
        depth_out[o] = np.float64(s[Z + i]) + np.float64(s[REST + i])
        left, right = np.int32(s[LEFT + i]), np.int32(s[RIGHT + i])
        first, last = np.int32(s[FIRST + i]), np.int32(s[LAST + i])
        box_out[o, 0], box_out[o, 1], box_out[o, 2], box_out[o, 3] = left, right, first, last
        lane_out[o] = i
        for j in range(np.uint64(first >> TILE_SHIFT), np.uint64((last >> TILE_SHIFT) + 1)):
            for k in range(np.uint64(left >> TILE_SHIFT), np.uint64((right >> TILE_SHIFT) + 1)):
                count_out[j * wide + k] += 1
        o += np.uint64(1)
    return np.int64(o) - place


@jit.cpu_kernel
def find_chunks(box, frustum: Frustum, seen_out):
    """Mark the chunks that may touch the picture; `box` (chunks, 6) holds the chunks' boxes."""
    for chunk in prange(len(box)):
        seen_out[chunk] = not chunk_is_out(box[chunk], frustum)


@jit.cpu_kernel
def project_chunks(
    splats: SplatChunks, chunks, frustum: Frustum, deep, eye, compensate, degree, across,
    record_out, depth_out, box_out, lane_out, visible_out, count_out,
):  # fmt: skip
    """Project the splats of the listed chunks and count those that each tile meets.

    The visible splats of the k-th listed chunk are written from place 256 k on.

    splats : SplatChunks
    chunks : int64 array (n,). Numbers of the chunks that may be in sight.
    deep : float64 array (4,). Third row of the view matrix.
    eye : float32 array (3,). Position of the camera, or its view direction if
        orthographic.
    compensate : bool. Weaken splats that the low-pass widens.
    degree, across : int. Highest degree of harmonics used; tiles across the
        picture.
    record_out : float32 array (256 n, RECORD)
    depth_out : float64 array (256 n,) [world units]. Of the splats' centres, for
        the order of the lists.
    box_out : int16 array (256 n, 4). First and last column and row of each
        visible splat.
    lane_out : uint8 array (256 n,). Its place in its chunk.
    visible_out : int64 array (n,). Visible splats of each chunk.
    count_out : int64 array (BLOCKS, tiles). Splats that each tile meets, for each
        block of chunks; added to.
    """
    geometry, sh, fine, step = splats
    n = len(chunks)
    taken = jit.none_taken()
    for _ in prange(jit.TAKERS):
        block = jit.take_next(taken)
        if block >= BLOCKS:
            continue
        s = np.empty(SCRATCH, np.float32)
        while block < BLOCKS:
            count = count_out[block]
            for k in range(block * n // BLOCKS, (block + 1) * n // BLOCKS):
                c = chunks[k]
                g = geometry[c]
                project_chunk(g, frustum, compensate, s)
                seen = False
                for i in range(LANES):
                    seen |= s[FIRST + i] <= s[LAST + i]
                visible_out[k] = 0
                if not seen:
                    continue
                color_chunk(g, sh[c], fine[c], step[c], eye, frustum.orthographic, degree + 1, s)
                face_chunk(g, frustum, deep, s)
                visible_out[k] = write_records(
                    s, across, k * LANES, record_out, depth_out, box_out, lane_out, count
                )
            block = jit.take_next(taken)
