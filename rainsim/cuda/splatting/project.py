"""Twin of `rainsim.splatting.project`: splats to ellipses, and their entries in the tiles' lists.

A block of threads takes a chunk of 256 splats. Each warp shares the writing of its splats' entries
among its lanes, so that the stores lie side by side and a splat of many tiles keeps no lane busy.

An entry is a 32-bit key, tile * levels + level of the depth, and a value: the splat in the lower 28
bits, above them one bit for each quarter of 8 x 8 pixels of the tile that the splat's box meets.
"""

import math

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.cuda.jit import (
    FULL,
    SIMULATED,
    cuda,
    cuda_device,
    cuda_kernel,
    fast_device,
    fast_kernel,
    load4,
    load_halves,
    store4,
)
from rainsim.cuda.scalars import bits_of
from rainsim.splatting import project
from rainsim.splatting.level_choice import is_drawn
from rainsim.splatting.prepared import LANES, OPACITY

RECORD = 16  # float32 numbers of a projected splat: 64 bytes
NUMBERS = 9 + 4  # rows of a chunk's geometry, see `rainsim.splatting.prepared`
SPLAT_BITS = 28
SPLAT_MASK = np.int64((1 << SPLAT_BITS) - 1)
MOST_SPLATS = 1 << SPLAT_BITS
WIDE = np.float64
OCTAVES = 20  # of depth beyond the scene's reach that levels tell apart
FAR_SHARE = 0.1  # of the levels that they get
FAR_TO_OFFSET = 256  # far depth over the offset within which levels lie evenly
FAINT = np.float32(-1000)  # log2 opacity of a place that holds nothing
EIGHT = np.float32(8)
WARPS = LANES // 32  # of a block
COUNTS = WARPS + 1

# Places of the numbers that a camera brings.
# In fours, for loads of 16 bytes; NEAR: near, width, height, detail; REST: what rounding took from
# the view matrix's third row.
VIEW, EYE, LENS, PLANE, NEAR, LIMITS, SCALE, REST, CAMERA = 0, 12, 16, 20, 24, 28, 32, 40, 44


@cuda_kernel
def start(
    chunks, box, span, around, view, lens, size, near, plane, orthographic, seen_out, begin_out,
    end_out, total_out,
):  # fmt: skip
    """Empty the lists of the picture before; mark the chunks that may touch the picture.

    chunks : int. Of which the others are left out.

    box, span, around : device array of shape (chunks, 6), (chunks, 2) and
        (chunks, 6), float32. `box`, `span` and `reach` of the prepared splats.
    view, lens, size, near, plane : device array. Numbers of the camera: pose (3,
        4), lens, width and height, the four from NEAR on, plane.
    """
    i = cuda.grid(1)
    if i == 0:
        total_out[0] = 0
    if i < begin_out.size:
        begin_out[i], end_out[i] = 0, 0
    if i < chunks:
        frustum = project.Frustum(view, lens, size, near[0], plane, orthographic)
        drawn = is_drawn(span[i], around[i], frustum, near[3])
        seen_out[i] = drawn and not project.chunk_is_out(box[i], frustum)


@fast_device
def splat_color(sh, chunk, lane, groups, bands, x, y, z):
    """Return a splat's colour seen along (x, y, z).

    Its coefficients lie in groups of eight halves, red, green and blue of each in turn.
    """
    at = 8 * (chunk * (groups * LANES) + lane)
    step = 8 * LANES
    r0, g0, b0, r1, g1, b1, r2, g2 = load_halves(sh, at)
    red, green, blue = (
        project.color_constant(r0),
        project.color_constant(g0),
        project.color_constant(b0),
    )
    if bands > 1:
        b2, r3, g3, b3, r4, g4, b4, r5 = load_halves(sh, at + step)
        red += project.color_degree_1(x, y, z, r1, r2, r3)
        green += project.color_degree_1(x, y, z, g1, g2, g3)
        blue += project.color_degree_1(x, y, z, b1, b2, b3)
        if bands > 2:
            g5, b5, r6, g6, b6, r7, g7, b7 = load_halves(sh, at + 2 * step)
            r8, g8, b8, r9, g9, b9, r10, g10 = load_halves(sh, at + 3 * step)
            red += project.color_degree_2(x, y, z, r4, r5, r6, r7, r8)
            green += project.color_degree_2(x, y, z, g4, g5, g6, g7, g8)
            blue += project.color_degree_2(x, y, z, b4, b5, b6, b7, b8)
            if bands > 3:
                b10, r11, g11, b11, r12, g12, b12, r13 = load_halves(sh, at + 4 * step)
                g13, b13, r14, g14, b14, r15, g15, b15 = load_halves(sh, at + 5 * step)
                red += project.color_degree_3(x, y, z, r9, r10, r11, r12, r13, r14, r15)
                green += project.color_degree_3(x, y, z, g9, g10, g11, g12, g13, g14, g15)
                blue += project.color_degree_3(x, y, z, b9, b10, b11, b12, b13, b14, b15)
    return max(red, ZERO), max(green, ZERO), max(blue, ZERO)


def in_groups(sh):
    """Return coefficients (chunks, 3 k, 256) as `splat_color` reads them, rows of float16."""
    chunks, count, _ = sh.shape
    groups = -(-count // 8)
    rows = np.zeros((chunks, groups * 8, LANES), np.float16)
    rows[:, :count] = np.clip(sh, -6e4, 6e4)
    return rows.reshape(chunks, groups, 8, LANES).transpose(0, 1, 3, 2).reshape(chunks, -1)


@fast_device
def depth_level(z, now):
    """Return which level of depth z is in: increasing, dense where most of the scene lies.

    The bits of a positive float count evenly within an octave. With an offset added, what is near
    takes no octaves; beyond the scene's usual reach a smaller share of the levels is left.
    """
    offset, first, reach = now[SCALE], now[SCALE + 1], now[SCALE + 2]
    k = np.float32(bits_of(z + offset) - bits_of(first))
    dense = min(k, reach)
    return np.int32(dense * now[SCALE + 3] + (k - dense) * now[SCALE + 4])


def depth_scale(near, far, levels):
    """Return the five numbers that `depth_level` reads."""
    offset = np.float32(far / FAR_TO_OFFSET)
    first = np.float32(near) + offset
    ends = np.array([np.float32(far) + offset, first], np.float32).view(np.int32).astype(np.int64)
    reach = max(float(ends[0] - ends[1]), 1.0)
    beyond = FAR_SHARE * levels / (OCTAVES << 23)
    return offset, first, reach, (1 - FAR_SHARE) * levels / reach, beyond


@fast_device
def record_splat(
    geometry, sh, chunk, lane, now, orthographic, compensate, bands, groups, low, record_out
):  # fmt: skip
    """Project a splat and store its record.

    Returns whether it is seen, the level of its depth and its box in units of 8 pixels.
    """
    g = chunk * (NUMBERS * LANES) + lane
    px, py, pz = geometry[g], geometry[g + LANES], geometry[g + 2 * LANES]
    level = geometry[g + OPACITY * LANES]
    v20, v21, v22, v23 = load4(now, VIEW + 8)
    p0, p1, p2, p3 = load4(now, PLANE)
    near, width, height, _ = load4(now, NEAR)
    ahead = v20 * px + v21 * py + v22 * pz + v23 >= near
    above = p0 * px + p1 * py + p2 * pz >= p3
    none = np.int32(0)
    if not (ahead and above and level > project.MIN_ALPHA_LOG2):
        return False, none, none, none, none, none
    v00, v01, v02, v03 = load4(now, VIEW)
    v10, v11, v12, v13 = load4(now, VIEW + 4)
    fx, fy, cx, cy = load4(now, LENS)
    x_low, x_high, y_low, y_high = load4(now, LIMITS)
    pose = project.Pose(v00, v01, v02, v03, v10, v11, v12, v13, v20, v21, v22, v23)
    lens = project.Lens(fx, fy, cx, cy, x_low, x_high, y_low, y_high, orthographic)
    covariance = (
        geometry[g + 3 * LANES], geometry[g + 4 * LANES], geometry[g + 5 * LANES],
        geometry[g + 6 * LANES], geometry[g + 7 * LANES], geometry[g + 8 * LANES],
    )  # fmt: skip
    x, y, z, u, v, a, b, c, m00, m11, determinant, spread = project.project_splat(
        (px, py, pz), covariance, pose, lens
    )
    if not determinant > ZERO:
        return False, none, none, none, none, none
    if compensate:
        level += project.compensation(spread, determinant)
    ex, ey = project.half_extents(level, m00, m11)
    # Pixels whose centres lie in the ellipse's box, as in `rainsim.splatting.project`.
    left, right = max(u - ex - HALF, ZERO), min(u + ex - HALF, width - ONE)
    first, last = max(v - ey - HALF, ZERO), min(v + ey - HALF, height - ONE)
    left, first = np.float32(math.ceil(left)), np.float32(math.ceil(first))
    right, last = np.float32(math.floor(right)), np.float32(math.floor(last))
    if not (level > project.MIN_ALPHA_LOG2 and right >= left and last >= first):
        return False, none, none, none, none, none
    ax, ay, az, _ = load4(now, EYE)
    dx = ax if orthographic else px - ax
    dy = ay if orthographic else py - ay
    dz = az if orthographic else pz - az
    share = ONE / math.sqrt(dx * dx + dy * dy + dz * dz)
    red, green, blue = splat_color(
        sh, chunk, lane, groups, bands, dx * share, dy * share, dz * share
    )
    normal = geometry[g + 9 * LANES], geometry[g + 10 * LANES], geometry[g + 11 * LANES]
    n0, n1, n2, distance = project.facing_normal(normal, (x, y, z), pose, orthographic)
    at = RECORD * (chunk * LANES + lane)
    # The conic in whole log2: alpha = 2^(level - a dx^2 - b dx dy - c dy^2).
    store4(record_out, at, u, v, EIGHT * a, EIGHT * b)
    store4(record_out, at + 4, EIGHT * c, level, red, green)
    # Depth to more digits than a float32 has decides the order: what was rounded away is kept.
    l0, l1, l2, l3 = load4(now, REST)
    exact = (WIDE(v20) + WIDE(l0)) * WIDE(px) + (WIDE(v21) + WIDE(l1)) * WIDE(py)
    exact += (WIDE(v22) + WIDE(l2)) * WIDE(pz) + (WIDE(v23) + WIDE(l3))
    z = np.float32(exact)
    store4(record_out, at + 8, blue, z, n0, n1)
    store4(record_out, at + 12, n2, distance, np.float32(exact - WIDE(z)), ZERO)
    return (
        True, min(max(depth_level(z, now), none), low),
        np.int32(left) >> 3, np.int32(right) >> 3, np.int32(first) >> 3, np.int32(last) >> 3,
    )  # fmt: skip


@cuda_device
def quarters(x, y, left, right, first, last):
    """Return which quarters of tile (x, y) the box meets, one bit each, rows first."""
    bits = np.int32(0)
    if left <= 2 * x:
        bits |= 1
    if right > 2 * x:
        bits |= 2
    both = bits << 2
    if not first <= 2 * y:
        bits = np.int32(0)
    if last > 2 * y:
        bits |= both
    return np.int32(bits)


@cuda_kernel
def list_splat_by_splat(
    geometry, sh, seen, now, orthographic, compensate, bands, groups, across, levels,
    record_out, key_out, value_out, total,
):  # fmt: skip
    """Project the splats of the seen chunks and list them: the plain way, a thread a splat."""
    i = cuda.grid(1)
    chunk, lane = i // LANES, i % LANES
    if chunk >= seen.size or not seen[chunk]:
        return
    visible, level, left, right, first, last = record_splat(
        geometry, sh, chunk, lane, now, orthographic, compensate, bands, groups, levels - 1,
        record_out,
    )  # fmt: skip
    if not visible:
        return
    count = ((right >> 1) - (left >> 1) + 1) * ((last >> 1) - (first >> 1) + 1)
    place = cuda.atomic.add(total, 0, count)
    for y in range(first >> 1, (last >> 1) + 1):
        for x in range(left >> 1, (right >> 1) + 1):
            if place < key_out.size:
                bits = quarters(x, y, left, right, first, last)
                key_out[place] = np.uint32((y * across + x) * levels + int(level))
                value_out[place] = np.uint32(i | bits << SPLAT_BITS)
            place += 1


@fast_kernel
def list_splats(
    geometry, sh, seen, now, orthographic, compensate, bands, groups, across, levels,
    record_out, key_out, value_out, total,
):  # fmt: skip
    """Project the splats of the seen chunks and list them; a block of 256 threads takes a chunk."""
    chunk = np.int32(cuda.blockIdx.x)
    if not seen[chunk]:
        return
    tid = np.int32(cuda.threadIdx.x)
    lane, warp = np.int32(tid & 31), np.int32(tid >> 5)
    counts = cuda.shared.array(COUNTS, np.int32)
    visible, level, left, right, first, last = record_splat(
        geometry, sh, chunk, tid, now, orthographic, compensate, bands, groups,
        np.int32(levels - 1), record_out,
    )  # fmt: skip
    count = np.int32(0)
    if visible:
        rows = np.int32(np.int32(last >> 1) - np.int32(first >> 1) + 1)
        count = np.int32(rows * np.int32(np.int32(right >> 1) - np.int32(left >> 1) + 1))
    # Inclusive sums within the warp, then the block's place in the lists.
    inclusive = count
    for k in range(5):
        before = cuda.shfl_up_sync(FULL, inclusive, 1 << k)
        if lane >= 1 << k:
            inclusive = np.int32(inclusive + before)
    if lane == 31:
        counts[warp] = inclusive
    cuda.syncthreads()
    if tid == 0:
        whole = np.int32(0)
        for k in range(WARPS):
            mine = counts[k]
            counts[k] = whole
            whole = np.int32(whole + mine)
        counts[WARPS] = cuda.atomic.add(total, 0, whole) if whole > 0 else np.int32(0)
    cuda.syncthreads()
    base = np.int32(counts[WARPS] + counts[warp])
    entries = cuda.shfl_sync(FULL, inclusive, 31)
    exclusive = np.int32(inclusive - count)
    across_box = np.int32(left | right << 16)
    down_box = np.int32(first | last << 16)
    capacity = np.int32(key_out.size)
    splat = np.int32(chunk * LANES + np.int32(warp << 5))
    for begin in range(0, entries, 32):
        j = np.int32(begin + lane)
        owner = np.int32(0)  # the lane whose splat entry j belongs to, by bisection
        for k in range(5):
            half = np.int32(16 >> k)
            if cuda.shfl_sync(FULL, inclusive, np.int32(owner + half - 1)) <= j:
                owner = np.int32(owner + half)
        within = np.int32(j - cuda.shfl_sync(FULL, exclusive, owner))
        columns = cuda.shfl_sync(FULL, across_box, owner)
        rows = cuda.shfl_sync(FULL, down_box, owner)
        mine = cuda.shfl_sync(FULL, level, owner)
        place = np.int32(base + j)
        if j < entries and place < capacity:
            l8, r8 = np.int32(columns & 0xFFFF), np.int32(columns >> 16)
            f8, b8 = np.int32(rows & 0xFFFF), np.int32(rows >> 16)
            width = np.int32(np.int32(r8 >> 1) - np.int32(l8 >> 1) + 1)
            row = np.int32((np.float32(within) + HALF) / np.float32(width))
            x = np.int32(np.int32(l8 >> 1) + within - np.int32(row * width))
            y = np.int32(np.int32(f8 >> 1) + row)
            tile = np.uint32(np.int32(y * np.int32(across)) + x)
            bits = np.uint32(quarters(x, y, l8, r8, f8, b8))
            key_out[place] = np.uint32(np.uint32(tile * np.uint32(levels)) + np.uint32(mine))
            value_out[place] = np.uint32(
                np.uint32(splat + owner) | np.uint32(bits << np.uint32(SPLAT_BITS))
            )


@cuda_device
def comes_before(splat, other, rank):
    """Return whether a splat is taken before another one of the same depth."""
    here, there = rank[splat // LANES], rank[other // LANES]
    return here < there or (here == there and splat < other)


@cuda_kernel
def find_ranges(n, levels, key, value, record, rank, begin_out, end_out, value_out):
    """Find where each tile's entries lie, and put entries of one key in order.

    Keys hold a rounded depth. Among entries of one key the whole depth decides, then the rank of
    the splat's chunk, then its place in it: so the order does not depend on that in which they were
    written. Each entry counts those that come before it: a wall that faces the camera has hundreds
    of one key in a tile.
    """
    i = cuda.grid(1)
    if i >= n:
        return
    mine = key[i]
    tile = mine // np.uint32(levels)
    if i == 0 or key[i - 1] // np.uint32(levels) != tile:
        begin_out[tile] = i
    if i + 1 == n or key[i + 1] // np.uint32(levels) != tile:
        end_out[tile] = i + 1
    entry, place, end = value[i], i, i + 1
    while place > 0 and key[place - 1] == mine:
        place -= 1
    while end < n and key[end] == mine:
        end += 1
    if end - place > 1:
        splat = np.int64(entry) & SPLAT_MASK
        depth, rest = record[RECORD * splat + 9], record[RECORD * splat + 14]
        for j in range(place, end):
            other = np.int64(value[j]) & SPLAT_MASK
            there, more = record[RECORD * other + 9], record[RECORD * other + 14]
            if there < depth or (
                there == depth
                and (more < rest or (more == rest and comes_before(other, splat, rank)))
            ):
                place += 1
    value_out[place] = entry


@cuda_kernel
def number_records(places, divisor, base, record):
    """Replace the depths of records by a digit of their numbers, plus 1.

    The entries must be sorted. A picture of the median depth then shows which record stops half of
    the light. A digit is the number over the `divisor`, modulo the `base`, at most 2^24: exact.
    """
    i = cuda.grid(1)
    if i < places:
        record[RECORD * i + 9] = np.float32(i // divisor % base + 1)


def list_kernel(plain):
    """Return the kernel that lists splats, and whether it takes a block a chunk."""
    return list_splat_by_splat if plain or SIMULATED else list_splats
