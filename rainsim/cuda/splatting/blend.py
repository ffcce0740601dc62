"""Twin of `rainsim.splatting.blend`: each tile's list blended front to back.

A warp owns 8 x 8 pixels, two a lane, and needs no barrier with others. It tests 32 entries at once
against its square, packs those that reach it into its own shared memory, and blends them two a turn
without a branch (an empty one fills up). It stops when all its pixels let less than 1e-4 through.
"""

import math

import numpy as np

from rainsim.constants import FOUR, HALF, ONE, TWO, ZERO
from rainsim.cuda.jit import (
    FULL,
    cuda,
    cuda_device,
    cuda_kernel,
    fast_device,
    fast_kernel,
    load4,
    store4,
)
from rainsim.cuda.splatting.project import FAINT, LENS, NEAR, RECORD, SPLAT_BITS, SPLAT_MASK
from rainsim.splatting.blend import finish_pixel
from rainsim.splatting.lanes import LAST_LIGHT, MAX_ALPHA, TRANSMITTANCE_STOP
from rainsim.splatting.project import MIN_ALPHA_LOG2, TILE

SQUARE = 8  # px, side of what a warp owns
WARPS = 4  # of a block: the four quarters of a tile
SIZE = NEAR + 1  # place of the drawn part's width and height among a camera's numbers
SHARED = WARPS * (32 + 1) * RECORD
MOST = np.float32(MAX_ALPHA)
LAST = np.float32(LAST_LIGHT)
SEVEN = np.float32(7)
SMALL = np.float32(1e-4)


@cuda_device
def write_pixel(
    x, y, width, height, now, orthographic, median, sums,
    color_out, alpha_out, depth_out, plane_out, normal_out,
):  # fmt: skip
    """Finish a pixel and write it; compiled without the assumption that nothing is infinite.

    `sums` are nine float32: transmittance, colour (3), depth, normal (3) and plane distance, all
    but the first summed over the splats by their weights.
    """
    if x >= width or y >= height:
        return
    clear, red, green, blue, z, n0, n1, n2, distance = sums
    clear = abs(clear)  # negative in pixels that `drop_last` has ended
    alpha = ONE - clear
    a = (np.float32(x) + HALF - now[LENS + 2]) / now[LENS]
    b = (np.float32(y) + HALF - now[LENS + 3]) / now[LENS + 1]
    z, n0, n1, n2, plane = finish_pixel(alpha, z, n0, n1, n2, distance, a, b, orthographic, median)
    pixel = y * width + x
    alpha_out[pixel], depth_out[pixel], plane_out[pixel] = alpha, z, plane
    color_out[3 * pixel], color_out[3 * pixel + 1], color_out[3 * pixel + 2] = red, green, blue
    normal_out[3 * pixel], normal_out[3 * pixel + 1], normal_out[3 * pixel + 2] = n0, n1, n2


@fast_device
def square_is_met(u, v, a, b, c, level, left, right, top, bottom):
    """Return whether the splat reaches the rectangle of pixel centres.

    The least exponent on a rectangle is at its point nearest to the centre along x or along y, or
    at the minimum of the quadratic form on one of those two edges.
    """
    qx = min(max(u, left), right) - u
    qy = min(max(v, top), bottom) - v
    yy = min(max(-b * qx / (TWO * c), top - v), bottom - v)
    xx = min(max(-b * qy / (TWO * a), left - u), right - u)
    e1 = a * qx * qx + b * qx * yy + c * yy * yy
    e2 = a * xx * xx + b * xx * qy + c * qy * qy
    if qx == ZERO:
        e1 = e2
    if qy == ZERO:
        e2 = e1
    least = min(e1, e2)
    if qx == ZERO and qy == ZERO:
        least = ZERO
    return level - least >= MIN_ALPHA_LOG2


@cuda_kernel
def blend_pixel_by_pixel(
    value, begin, end, record, now, width, height, orthographic, median, drop_last,
    color_out, alpha_out, depth_out, plane_out, normal_out,
):  # fmt: skip
    """Blend each tile's list: the plain way, a thread a pixel."""
    x, y = cuda.grid(2)
    if x >= min(width, int(now[SIZE])) or y >= min(height, int(now[SIZE + 1])):
        return
    tile = y // TILE * ((width + TILE - 1) // TILE) + x // TILE
    px, py = np.float32(x) + HALF, np.float32(y) + HALF
    clear, red, green, blue, z = ONE, ZERO, ZERO, ZERO, ZERO
    n0, n1, n2, distance = ZERO, ZERO, ZERO, ZERO
    for k in range(begin[tile], end[tile]):
        r = RECORD * (np.int64(value[k]) & SPLAT_MASK)
        dx, dy = px - record[r], py - record[r + 1]
        power = (
            record[r + 5] - dx * (record[r + 2] * dx + record[r + 3] * dy)
            - record[r + 4] * dy * dy
        )  # fmt: skip
        if power < MIN_ALPHA_LOG2:
            continue
        weight = min(np.float32(math.exp2(power)), MOST) * clear
        after = clear - weight
        if drop_last and after <= LAST:
            break
        red += weight * record[r + 6]
        green += weight * record[r + 7]
        blue += weight * record[r + 8]
        if not median:
            z += weight * record[r + 9]
        elif clear > HALF and after <= HALF:
            z = record[r + 9]
        n0 += weight * record[r + 10]
        n1 += weight * record[r + 11]
        n2 += weight * record[r + 12]
        distance += weight * record[r + 13]
        clear = after
        if clear <= TRANSMITTANCE_STOP:
            break
    write_pixel(
        x, y, width, height, now, orthographic, median,
        (clear, red, green, blue, z, n0, n1, n2, distance),
        color_out, alpha_out, depth_out, plane_out, normal_out,
    )  # fmt: skip


@fast_device
def add_splat(shared, o, px, py, median, drop_last, upper_sums, lower_sums):
    """Blend one staged splat into a lane's two pixels, four rows apart; return their sums.

    The sums of a pixel are those of `write_pixel`.
    """
    t0, r0, g0, b0, z0, x0, y0, w0, d0 = upper_sums
    t1, r1, g1, b1, z1, x1, y1, w1, d1 = lower_sums
    u, v, a, b = load4(shared, o)
    c, level, red, green = load4(shared, o + 4)
    blue, z, n0, n1 = load4(shared, o + 8)
    n2, distance, _, _ = load4(shared, o + 12)
    dx, dy = px - u, py - v
    dz = dy + FOUR
    along, slope = level - a * dx * dx, b * dx
    upper, lower = along - dy * (slope + c * dy), along - dz * (slope + c * dz)
    s0, s1 = ZERO, ZERO
    if upper >= MIN_ALPHA_LOG2:
        s0 = min(math.exp2(upper), MOST) * t0
    if lower >= MIN_ALPHA_LOG2:
        s1 = min(math.exp2(lower), MOST) * t1
    after0, after1 = t0 - s0, t1 - s1
    if drop_last:  # a pixel that has ended has a negative transmittance, and takes no more
        if t0 <= ZERO:
            s0, after0 = ZERO, t0
        elif after0 <= LAST:
            s0, after0 = ZERO, -t0
        if t1 <= ZERO:
            s1, after1 = ZERO, t1
        elif after1 <= LAST:
            s1, after1 = ZERO, -t1
    if median:
        z0 = z if t0 > HALF and after0 <= HALF and after0 > ZERO else z0
        z1 = z if t1 > HALF and after1 <= HALF and after1 > ZERO else z1
    else:
        z0 += s0 * z
        z1 += s1 * z
    return (
        (after0, r0 + s0 * red, g0 + s0 * green, b0 + s0 * blue, z0,
         x0 + s0 * n0, y0 + s0 * n1, w0 + s0 * n2, d0 + s0 * distance),
        (after1, r1 + s1 * red, g1 + s1 * green, b1 + s1 * blue, z1,
         x1 + s1 * n0, y1 + s1 * n1, w1 + s1 * n2, d1 + s1 * distance),
    )  # fmt: skip


@fast_device
def square_at(tile, quarter, across, inverse_across):
    """Return the first column and row [px] of the square that a warp owns."""
    row = np.int32((np.float32(tile) + HALF) * inverse_across)
    column = np.int32(tile - np.int32(row * np.int32(across)))
    x = np.int32(np.int32(column * TILE) + np.int32(np.int32(quarter & 1) * SQUARE))
    y = np.int32(np.int32(row * TILE) + np.int32(np.int32(quarter >> 1) * SQUARE))
    return x, y


@fast_device
def no_sums(inside):
    """Return the sums of a pixel before any splat; one beside the picture lets nothing through."""
    clear = ONE if inside else ZERO
    return clear, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO


@fast_device
def stage(shared, o, record, place, first, second):
    """Copy a splat's record to shared memory; its first eight numbers have been read."""
    blue, z, n0, n1 = load4(record, np.int64(place) + 8)
    n2, distance, _, _ = load4(record, np.int64(place) + 12)
    store4(shared, o, first[0], first[1], first[2], first[3])
    store4(shared, o + 4, second[0], second[1], second[2], second[3])
    store4(shared, o + 8, blue, z, n0, n1)
    store4(shared, o + 12, n2, distance, ZERO, ZERO)


@fast_device
def stage_nothing(shared, o):
    """Write a splat to shared memory that no pixel shows."""
    store4(shared, o, ZERO, ZERO, ZERO, ZERO)
    store4(shared, o + 4, ZERO, FAINT, ZERO, ZERO)
    store4(shared, o + 8, ZERO, ZERO, ZERO, ZERO)
    store4(shared, o + 12, ZERO, ZERO, ZERO, ZERO)


def _blend_squares(median, drop_last):
    """Return the kernel for the mean or the median depth, and for either stop.

    Its warps keep the sums of two pixels a lane in registers over a tile's whole list.
    """

    @fast_kernel
    def blend_squares(
        value, begin, end, record, now, width, height, orthographic, across, inverse_across,
        color_out, alpha_out, depth_out, plane_out, normal_out,
    ):  # fmt: skip
        """Blend each tile's list; a warp owns a quarter of a tile."""
        shared = cuda.shared.array(SHARED, np.float32, 16)
        tid = np.int32(cuda.threadIdx.x)
        lane, quarter = np.int32(tid & 31), np.int32(tid >> 5)
        staged = np.int32(quarter * ((32 + 1) * RECORD))
        tile = np.int32(cuda.blockIdx.x)
        sx, sy = square_at(tile, quarter, across, inverse_across)
        x, y = np.int32(sx + np.int32(lane & 7)), np.int32(sy + np.int32(lane >> 3))
        px, py = np.float32(x) + HALF, np.float32(y) + HALF
        if np.float32(sx) >= now[SIZE] or np.float32(sy) >= now[SIZE + 1]:
            return  # beyond what is drawn of the picture: no warp waits for this one
        left, top = np.float32(sx) + HALF, np.float32(sy) + HALF
        right, bottom = left + SEVEN, top + SEVEN
        at, stop = begin[tile], end[tile]
        lower_lanes = np.int32((np.int64(1) << lane) - 1)
        bit = np.uint32(np.uint32(1) << np.uint32(SPLAT_BITS + quarter))
        mask = np.uint32(SPLAT_MASK)
        upper = no_sums(x < width and y < height)
        lower = no_sums(x < width and y + 4 < height)
        # The next entries are read while these are blended.
        entry = value[at + lane] if at + lane < stop else np.uint32(0)
        reached = entry & bit != 0
        place = np.int32(RECORD * np.int32(entry & mask))
        u, v, a, b, c, level, red, green = ZERO, ZERO, ZERO, ZERO, ONE, ZERO, ZERO, ZERO
        if reached:
            u, v, a, b = load4(record, np.int64(place))
            c, level, red, green = load4(record, np.int64(place) + 4)
        following = value[at + 32 + lane] if at + 32 + lane < stop else np.uint32(0)
        while at < stop:
            hit = reached
            if hit:
                hit = square_is_met(u, v, a, b, c, level, left, right, top, bottom)
            hits = cuda.ballot_sync(FULL, hit)
            count = np.int32(cuda.popc(hits))
            if hit:
                o = np.int32(staged + np.int32(cuda.popc(hits & lower_lanes)) * RECORD)
                stage(shared, o, record, place, (u, v, a, b), (c, level, red, green))
            if lane < (count & 1):
                stage_nothing(shared, np.int32(staged + count * RECORD))
            cuda.syncwarp()
            at = np.int32(at + 32)
            entry = following
            reached = entry & bit != 0
            place = np.int32(RECORD * np.int32(entry & mask))
            if reached:
                u, v, a, b = load4(record, np.int64(place))
                c, level, red, green = load4(record, np.int64(place) + 4)
            following = value[at + 32 + lane] if at + 32 + lane < stop else np.uint32(0)
            o = staged
            last = np.int32(staged + count * RECORD)
            while o < last:
                upper, lower = add_splat(shared, o, px, py, median, drop_last, upper, lower)
                upper, lower = add_splat(
                    shared, o + RECORD, px, py, median, drop_last, upper, lower
                )
                o = np.int32(o + 2 * RECORD)
            if not cuda.any_sync(FULL, upper[0] > SMALL or lower[0] > SMALL):
                break
            cuda.syncwarp()
        write_pixel(
            x, y, width, height, now, orthographic, median, upper,
            color_out, alpha_out, depth_out, plane_out, normal_out,
        )  # fmt: skip
        write_pixel(
            x, y + 4, width, height, now, orthographic, median, lower,
            color_out, alpha_out, depth_out, plane_out, normal_out,
        )  # fmt: skip

    return blend_squares


# By whether the depth is the median one and whether the training codes' stop is taken.
BLEND_SQUARES = {
    (median, drop): _blend_squares(median, drop)
    for median in (False, True)
    for drop in (False, True)
}
