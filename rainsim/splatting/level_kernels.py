"""The loops that merge splats cell by cell, see `rainsim.splatting.detail`."""

import math

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.jit import cpu_kernel, device_function, inlined_function, prange
from rainsim.splatting.prepared import GEOMETRY, LANES, LARGEST, OPACITY

# Thinnest over middle deviation below which a splat faces somewhere. Not 0.3, which the blades of
# the built-in lawn have: rounding would decide about each, and processors may round otherwise.
FLAT = 0.31
FAINT = np.float32(-20)  # log2 of the opacity up to which a splat is not merged
CHUNK_SLOTS = 2 * LANES  # of a group's table of cells for each chunk: twice as many as splats
CELLS = 1 << 19  # along an axis, on either side of the origin: a cell's key is one whole number
MIX = np.uint64(0x9E3779B97F4A7C15)  # Knuth's multiplier for hashes, 2^64 over the golden ratio
MIX_SHIFT = np.uint64(32)
ALONE, NOTHING = -1, -2  # in place of a merged splat's number
LEAST = np.float32(1e-30)
HALF_STOPPED = 1 / (2 * math.log(2))  # opacity over optical depth, where a half is stopped
TURNS, TILT = 3, 1e-3  # steps of inverse iteration, and what sets it going in any direction
TINY = 1e-150  # its square is still a number


@inlined_function
def minors_of(xx, xy, xz, yy, yz, zz):
    """Return the sum of the principal minors of order two of a covariance; arrays are fine, too."""
    return xx * yy - xy * xy + yy * zz - yz * yz + xx * zz - xz * xz


@inlined_function
def area_of(xx, xy, xz, yy, yz, zz):
    """Return a measure of a splat's mean shadow over all directions, from its covariance."""
    return math.sqrt(max(minors_of(xx, xy, xz, yy, yz, zz), 0.0))


@cpu_kernel
def find_cells(geometry, leading, size, side, number_out, count_out):
    """Number the cells of each group that hold several fine splats that face one way.

    geometry : float32 array (chunks, 13 * 256)
    leading : int. Chunks that are looked at.
    size : int. Chunks of a group.
    side : float32 [capture units]
    number_out : int16 array (256 leading,). Number of the merged splat in its
        group; ALONE for a splat that is kept, NOTHING for none.
    count_out : int64 array (groups, 2). Splats that each group keeps, and merged
        ones.
    """
    for group in prange(len(count_out)):
        many = size * CHUNK_SLOTS
        key, slots = np.empty(many, np.int64), np.zeros(many, np.int64)
        place = np.full(size * LANES, np.int64(NOTHING))
        first, end = group * size, min(group * size + size, leading)
        kept = 0
        for chunk in range(first, end):
            g = geometry[chunk]
            for i in range(LANES):
                o = (chunk - first) * LANES + i
                if not g[OPACITY * LANES + i] > -np.inf:
                    continue
                place[o] = ALONE
                this = cell_key(g, i, side)
                if this < 0:
                    continue
                slot = np.int64((np.uint64(this) * MIX) >> MIX_SHIFT) % many
                while slots[slot] > 0 and key[slot] != this:
                    slot = (slot + 1) % many
                key[slot] = this
                slots[slot] += 1
                place[o] = slot
        merged = 0
        for o in range((end - first) * LANES):
            slot = place[o]
            if slot >= 0:
                if slots[slot] == 1:
                    slot = ALONE
                else:
                    if slots[slot] > 1:  # the first of it: from here on its number, from 0 down
                        slots[slot] = -merged
                        merged += 1
                    slot = -slots[slot]
            kept += np.int64(slot == ALONE)
            number_out[first * LANES + o] = np.int16(slot)
        count_out[group, 0], count_out[group, 1] = kept, merged


@inlined_function
def cell_key(g, i, side):
    """Return the key of the cell and the way that splat i of a chunk faces; -1: it is not fine.

    A splat is fine if the squares of its deviations along its three axes add up to less than the
    square of the cell's side. What is no number, hardly there or absurdly far is not fine.
    """
    xx, xy, xz = g[3 * LANES + i], g[4 * LANES + i], g[5 * LANES + i]
    yy, yz, zz = g[6 * LANES + i], g[7 * LANES + i], g[8 * LANES + i]
    spread = xx + yy + zz
    x, y, z = (
        np.floor(g[i] / side), np.floor(g[LANES + i] / side), np.floor(g[2 * LANES + i] / side)
    )  # fmt: skip
    near = abs(x) < CELLS - 1 and abs(y) < CELLS - 1 and abs(z) < CELLS - 1
    opacity = g[OPACITY * LANES + i]
    if not (spread < side * side and near and opacity > FAINT and opacity <= ZERO):
        return np.int64(-1)
    n0, n1, n2 = g[9 * LANES + i], g[10 * LANES + i], g[11 * LANES + i]
    # The least variance is that along the normal; trace and minors tell the other two.
    least = n0 * (xx * n0 + xy * n1 + xz * n2) + n1 * (xy * n0 + yy * n1 + yz * n2)
    least = max(least + n2 * (xz * n0 + yz * n1 + zz * n2), ZERO)
    minors = minors_of(xx, xy, xz, yy, yz, zz)
    half = 0.5 * (spread - least)
    middle = half - math.sqrt(max(half * half - (minors - 2 * least * half), 0.0))
    facing = np.int64(0)
    if least < FLAT * FLAT * middle:
        a, b, c = abs(n0), abs(n1), abs(n2)
        facing = np.int64(1) if a >= b and a >= c else (np.int64(2) if b >= c else np.int64(3))
    key = (np.int64(x) + CELLS) * (2 * CELLS) + np.int64(y) + CELLS
    return (key * (2 * CELLS) + np.int64(z) + CELLS) * 4 + facing


@inlined_function
def row_of(number, kept, at):
    """Return a splat's row among a group's splats at a level; -1 if it is none of them.

    `at` counts the splats that are kept before it.
    """
    if number == NOTHING:
        return np.int64(-1)
    return at if number == ALONE else np.int64(kept + number)


@cpu_kernel
def merge_shapes(
    geometry, order, weight, leading, size, wanted, number, count, start, geometry_out, order_out
):  # fmt: skip
    """Write the splats of a level: of each wanted group those that it keeps, then the merged ones.

    geometry, order : ndarray. See `prepared.PreparedSplats`.
    weight : float32 array (256 leading,)
    leading, size : int
    wanted, number, count, start : ndarray. See `detail.Level`.
    geometry_out : float32 array (chunks, 13 * 256)
    order_out : int32 array (256 chunks,). Written only where there is a splat.
    """
    for w in prange(len(wanted)):
        group = wanted[w]
        kept, merged = count[group, 0], count[group, 1]
        row = np.zeros((kept + merged, GEOMETRY), np.float64)
        total, origin = np.zeros(kept + merged, np.float64), np.zeros((kept + merged, 3))
        member = np.empty(kept + merged, np.int32)
        at = np.int64(0)
        for o in range(group * size * LANES, min((group + 1) * size, leading) * LANES):
            n = row_of(number[o], kept, at)
            if n < 0:
                continue
            g, i = geometry[o // LANES], o % LANES
            if number[o] == ALONE:
                for k in range(GEOMETRY):
                    row[n, k] = g[k * LANES + i]
                at += 1
            else:
                if total[n] == 0:
                    for k in range(3):
                        origin[n, k] = g[k * LANES + i]
                total[n] += weight[o]
                add_to_row(g, i, np.float64(weight[o]), origin[n], row[n])
            member[n] = order[o]
        for n in range(kept, kept + merged):
            finish_row(row[n], origin[n], total[n])
        for q in range(start[w], start[w + 1]):
            begin = (q - start[w]) * LANES
            places = min(LANES, kept + merged - begin)
            g = geometry_out[q]
            for k in range(GEOMETRY):
                # Places that hold no splat must not widen the chunk's box.
                g[k * LANES : (k + 1) * LANES] = row[begin, k] if k < 3 else ZERO
                for i in range(places):
                    g[k * LANES + i] = row[begin + i, k]
            g[OPACITY * LANES + places : (OPACITY + 1) * LANES] = -np.inf
            for i in range(places):  # to assign an array takes a second to compile
                order_out[q * LANES + i] = member[begin + i]


@cpu_kernel
def merge_colors(
    sh, fine, step, weight, leading, size, number, count, place, sh_out, fine_out, step_out
):  # fmt: skip
    """Write the harmonics of the splats of all levels, in the order of `merge_shapes`.

    sh, fine, step : ndarray. See `prepared.PreparedSplats`.
    weight : float32 array (256 leading,)
    leading, size : int
    number : int16 array (levels, 256 leading)
    count : int64 array (levels, groups, 2). As `find_cells` writes them.
    place : int64 array (levels, groups). First chunk of each group at each level,
        -1 if it does not have that level.
    sh_out, fine_out, step_out : ndarray. As those that are read. Only the chunks
        of levels are written.
    """
    coarse, more = sh.shape[1] // LANES, step.shape[1]
    for group in prange(count.shape[1]):
        first, end = group * size, min((group + 1) * size, leading)
        splats = (end - first) * LANES
        # One row a splat: what is merged is then added up in vectors.
        value = np.empty((splats, coarse + more), np.float32)
        for chunk in range(first, end):
            rows = value[(chunk - first) * LANES : (chunk - first + 1) * LANES]
            for k in range(coarse):
                own = sh[chunk, k * LANES : (k + 1) * LANES]
                for i in range(LANES):
                    rows[i, k] = own[i]
            for k in range(more):
                whole = fine[chunk, k * LANES : (k + 1) * LANES]
                for i in range(LANES):
                    rows[i, coarse + k] = whole[i]
        share, into = np.empty(splats, np.float32), np.empty(splats, np.int32)
        for level in range(len(count)):
            begin = place[level, group]
            if begin < 0:
                continue
            kept, merged = count[level, group, 0], count[level, group, 1]
            found = number[level, first * LANES : end * LANES]
            weigh(found, weight[first * LANES : end * LANES], kept, kept + merged, share, into)
            chunks = (kept + merged + LANES - 1) // LANES
            total = np.zeros((chunks * LANES, coarse + more), np.float32)
            for o in range(splats):
                if share[o] > ZERO:
                    unit = step[first + o // LANES]
                    add_scaled(value[o], share[o], unit, coarse, total[into[o]])
            for q in range(chunks):
                rows = total[q * LANES : (q + 1) * LANES]
                for k in range(coarse):
                    own = sh_out[begin + q, k * LANES : (k + 1) * LANES]
                    for i in range(LANES):
                        own[i] = rows[i, k]
                for k in range(more):
                    whole = fine_out[begin + q, k * LANES : (k + 1) * LANES]
                    step_out[begin + q, k] = pack_fine(rows, coarse + k, whole)


@device_function
def weigh(number, weight, kept, rows, share_out, into_out):
    """Find into which of `rows` splats each of a group goes, and its share in that one's colour."""
    total = np.zeros(rows, np.float32)
    at = np.int64(0)
    for o in range(len(number)):
        n = row_of(number[o], kept, at)
        share_out[o], into_out[o] = ZERO, max(n, 0)
        if n >= 0:
            at += np.int64(number[o] == ALONE)
            share_out[o] = ONE if number[o] == ALONE else weight[o]
            total[n] += share_out[o]
    for o in range(len(number)):
        if share_out[o] > ZERO:
            share_out[o] /= total[into_out[o]]


@inlined_function
def add_scaled(value, share, unit, coarse, total_out):
    """Add a share of a splat's harmonics, of which those from `coarse` on count in units."""
    for k in range(coarse):
        total_out[k] += share * value[k]
    for k in range(len(unit)):
        total_out[coarse + k] += (share * unit[k]) * value[coarse + k]


@device_function
def pack_fine(rows, k, fine_out):
    """Write column k of a chunk's harmonics above degree 1 as 16-bit integers; return the factor.

    rows : float32 array (256, n)
    k : int
    fine_out : int16 array (256,)
    """
    column, most = np.empty(LANES, np.float32), ZERO
    for i in range(LANES):
        column[i] = rows[i, k]
        most = max(most, abs(column[i]))
    unit = most / LARGEST
    for i in range(LANES):
        whole = column[i] / unit if unit > ZERO else ZERO
        fine_out[i] = np.int16(np.rint(whole))
    return unit


@inlined_function
def add_to_row(g, i, weight, origin, row):
    """Add splat i of a chunk to the sums of a merged one.

    Places are taken from `origin`, a place of the same cell: the squares of large coordinates would
    leave no digits for the covariance.
    """
    xx, xy, xz = g[3 * LANES + i], g[4 * LANES + i], g[5 * LANES + i]
    yy, yz, zz = g[6 * LANES + i], g[7 * LANES + i], g[8 * LANES + i]
    x, y, z = g[i] - origin[0], g[LANES + i] - origin[1], g[2 * LANES + i] - origin[2]
    row[0] += weight * x
    row[1] += weight * y
    row[2] += weight * z
    row[3] += weight * (xx + x * x)
    row[4] += weight * (xy + x * y)
    row[5] += weight * (xz + x * z)
    row[6] += weight * (yy + y * y)
    row[7] += weight * (yz + y * z)
    row[8] += weight * (zz + z * z)
    n0, n1, n2 = g[9 * LANES + i], g[10 * LANES + i], g[11 * LANES + i]
    turned = weight if row[9] * n0 + row[10] * n1 + row[11] * n2 >= 0.0 else -weight
    row[9] += turned * n0
    row[10] += turned * n1
    row[11] += turned * n2


@inlined_function
def finish_row(row, origin, total):
    """Turn the sums of a merged splat into its place, covariance, normal and log2 opacity.

    Optical depth times area is kept; `rainsim.splatting.detail` explains the opacity.
    """
    share = 1 / total
    for k in range(9):
        row[k] *= share
    x, y, z = row[0], row[1], row[2]
    row[3] -= x * x
    row[4] -= x * y
    row[5] -= x * z
    row[6] -= y * y
    row[7] -= y * z
    row[8] -= z * z
    row[0] += origin[0]
    row[1] += origin[1]
    row[2] += origin[2]
    row[9], row[10], row[11] = thin_axis(row[3:9], unit_vector(row[9], row[10], row[11]))
    depth = total / max(area_of(row[3], row[4], row[5], row[6], row[7], row[8]), LEAST)
    row[OPACITY] = math.log2(max(max(-math.expm1(-depth), HALF_STOPPED * depth), LEAST))


@inlined_function
def thin_axis(covariance, normal):
    """Return the unit vector along which a merged splat is thin, near its splats' mean normal.

    These are steps of inverse iteration (Golub and Van Loan 2013, Matrix Computations, 7.6.1) from
    the mean normal: it stays where the splat is as thick in all directions, and turns where walls
    about a lid became a flat splat.

    covariance : float64 array (6,). xx, xy, xz, yy, yz, zz.
    normal : tuple of float. Unit vector.
    """
    xx, xy, xz, yy, yz, zz = covariance
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy  # the adjugate
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    x, y, z = normal[0] + TILT, normal[1] + TILT, normal[2] + TILT
    for _ in range(TURNS):
        u, v, w = a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z
        if u * u + v * v + w * w > 0.0:
            x, y, z = unit_vector(u, v, w)
    return unit_vector(x, y, z)


@inlined_function
def unit_vector(x, y, z):
    """Return a vector at unit length; (0, 0, 0) stays."""
    share = 1 / max(math.sqrt(x * x + y * y + z * z), TINY)
    return x * share, y * share, z * share
