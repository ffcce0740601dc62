"""Blending: each tile's list, sorted and blended front to back, in blocks of 4 x 4 pixels."""

import math

import numpy as np

from rainsim import jit
from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import prange
from rainsim.splatting.lanes import CHANNELS, LANES, blend_lanes, meets_blocks, prefetch, put_chosen
from rainsim.splatting.project import R_DEPTH, TILE
from rainsim.splatting.tiles import DIGITS, RECORD_MASK, sort_keys

SIDE = 4  # px of a block: sixteen pixels, one vector
SHIFT = 2  # log2 of the side
ROW = TILE // SIDE  # blocks across a tile
BLOCKS = ROW * ROW
BATCH = 128  # entries that are dealt to the blocks before these blend
LIST = BATCH + LANES  # places of a block's list: sixteen are written at a time
AHEAD = 24  # entries by which records are fetched before they are read

MIN_COVERAGE = np.float32(0.02)  # alpha below which a pixel has no depth
EDGE_ON = np.float32(0.02)  # cosine at which a blended plane no longer tells the depth
PLANE_LIMIT = np.float32(0.2)  # share of the depth by which the plane may correct it

# Unsigned numbers for indexing.
RED, GREEN, BLUE, DEPTH, NORMAL_X, NORMAL_Y, NORMAL_Z, PLANE = (
    np.uint64(row * LANES) for row in range(1, CHANNELS)
)
NEXT, AFTER, THREE = np.uint64(1), np.uint64(2), np.uint64(3)
WIDE_SHIFT, WIDE_MASK, WIDE_ROW = np.uint64(SHIFT), np.uint64(SIDE - 1), np.uint64(ROW)
BLOCK_NUMBERS = np.uint64(CHANNELS * LANES)

NOWHERE = np.float32(np.inf)


@jit.device_function
def deal(entry, record, begin, end, left, top, is_open, bits, number, chosen_out, count_out):
    """Put each entry's record into the list of every open block of the tile that it can reach."""
    x, y = np.float32(left + SIDE // 2), np.float32(top + SIDE // 2)
    for k in range(begin, end):
        if k + AHEAD < len(entry):
            prefetch(record, np.int64(entry[k + AHEAD] & RECORD_MASK))
        o = np.int64(entry[k] & RECORD_MASK)
        number[k - begin] = o
        bits[k - begin] = meets_blocks(record, o, x, y)
    bits[end - begin : -(-(end - begin) // LANES) * LANES] = 0
    for block in range(BLOCKS):
        n = 0
        if is_open[block]:
            for k in range(0, end - begin, LANES):
                n += put_chosen(bits, number, k, block, chosen_out, block * LIST + n)
        count_out[block] = n


@jit.cpu_kernel
def blend_tiles(
    record, entry, start, height, width, lens, orthographic, background, halfway, drop_last,
    color_out, alpha_out, depth_out, plane_out, normal_out, half_out,
):  # fmt: skip
    """Sort each tile's list, blend it front to back and write the tile's pixels.

    Neighbours share splats, so a thread goes along a row of tiles. The outputs are flat. `halfway`
    asks for the record that stops half of the light: its depth is written as the pixel's, and one
    more than its number to `half_out`, 0 where there is none.
    """
    across = (width + TILE - 1) // TILE
    tiles = len(start) - 1
    longest = 0
    for tile in range(tiles):
        longest = max(longest, start[tile + 1] - start[tile])
    taken = jit.none_taken()
    for _ in prange(jit.TAKERS):
        row = jit.take_next(taken)
        while row * across < tiles:
            blend_row(
                record, entry, start, row * across, longest, height, width, lens, orthographic,
                background, halfway, drop_last,
                color_out, alpha_out, depth_out, plane_out, normal_out, half_out,
            )  # fmt: skip
            row = jit.take_next(taken)


@jit.device_function
def blend_row(
    record, entry, start, first, longest, height, width, lens, orthographic, background, halfway,
    drop_last, color_out, alpha_out, depth_out, plane_out, normal_out, half_out,
):  # fmt: skip
    """Sort, blend and write the row of tiles that begins with tile `first`; see `blend_tiles`."""
    across = (width + TILE - 1) // TILE
    spare = np.empty(longest, np.uint64)
    histogram = np.empty(DIGITS, np.int64)
    state = np.empty(BLOCKS * CHANNELS * LANES, np.float32)
    bits, number = np.empty(BATCH, np.uint32), np.empty(BATCH, np.uint32)
    chosen = np.empty(BLOCKS * LIST, np.uint32)
    count = np.empty(BLOCKS, np.int64)
    is_open = np.empty(BLOCKS, np.bool_)
    for tile in range(first, first + across):
        begin, end = start[tile], start[tile + 1]
        sort_keys(entry[begin:end], spare, histogram, end - begin)
        top, left = tile // across * TILE, tile % across * TILE
        state[:] = ZERO
        for block in range(BLOCKS):
            state[block * CHANNELS * LANES : block * CHANNELS * LANES + LANES] = ONE
            inside = top + block // ROW * SIDE < height and left + block % ROW * SIDE < width
            is_open[block] = inside
        any_open = True
        while begin < end and any_open:
            stop = min(begin + BATCH, end)
            deal(entry, record, begin, stop, left, top, is_open, bits, number, chosen, count)
            begin = stop
            any_open = False
            for block in range(BLOCKS):
                if count[block] == 0:
                    any_open |= is_open[block]
                    continue
                at = block * CHANNELS * LANES
                x = np.float32(left + block % ROW * SIDE) + HALF
                y = np.float32(top + block // ROW * SIDE) + HALF
                first, last = block * LIST, block * LIST + count[block]
                if drop_last and halfway:
                    more = blend_lanes(record, chosen, first, last, state, at, x, y, 1, 1)
                elif drop_last:
                    more = blend_lanes(record, chosen, first, last, state, at, x, y, 0, 1)
                elif halfway:
                    more = blend_lanes(record, chosen, first, last, state, at, x, y, 1, 0)
                else:
                    more = blend_lanes(record, chosen, first, last, state, at, x, y, 0, 0)
                is_open[block] = more
                any_open |= is_open[block]
        if halfway:
            write_halves(state, record, top, left, height, width, half_out)
        write_tile(
            state, top, left, height, width, lens, orthographic, background, halfway,
            color_out, alpha_out, depth_out, plane_out, normal_out,
        )  # fmt: skip


@jit.inlined_function
def finish_pixel(alpha, z, nx, ny, nz, distance, a, b, orthographic, median):
    """Turn a pixel's blended sums into depth, unit normal (3) and plane depth.

    (a, b, 1) is the pixel's ray. The plane depth is where the ray meets n.p = distance, with n and
    distance blended alike. That falls back on the depth where the plane is nearly edge-on or far
    from the splats that were blended.
    """
    z = z if median else z / max(alpha, MIN_COVERAGE)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    known = alpha >= MIN_COVERAGE and length > ZERO and z > ZERO
    share = ONE / length if known else ZERO
    flat = nx * a + ny * b
    along = nz if orthographic else flat + nz
    plane = (distance - flat if orthographic else distance) / along
    limit = NOWHERE if orthographic else PLANE_LIMIT * z
    plane = plane if along <= -EDGE_ON * alpha and abs(plane - z) < limit else z
    return (
        z if known else NOWHERE, nx * share, ny * share, nz * share, plane if known else NOWHERE
    )  # fmt: skip


@jit.device_function
def write_halves(state, record, top, left, height, width, half_out):
    """Write which records stop half of the light; put their depths in the depth rows."""
    bits = state.view(np.uint32)
    for block in range(BLOCKS):
        for i in range(LANES):
            at = (block * CHANNELS + 4) * LANES + i
            number = bits[at]
            state[at] = record[number - 1, R_DEPTH] if number > 0 else ZERO
            row = top + block // ROW * SIDE + (i >> SHIFT)
            column = left + block % ROW * SIDE + (i & SIDE - 1)
            if row < height and column < width:
                half_out[row * width + column] = number


@jit.device_function
def finish_block(rows, x, y, lens, orthographic, background, halfway):
    """Turn the blended sums of a block's pixels into colours, depths and unit normals; in place.

    Row 0 becomes alpha, rows 1 to 3 get the background's share, row 4 becomes the depth, rows 5 to
    7 the normal, row 8 the plane depth.
    """
    fx, fy = ONE / lens[0], ONE / lens[1]
    red, green, blue = background[0], background[1], background[2]
    x, y = x - lens[2], y - lens[3]
    for i in range(LANES):
        clear = abs(rows[i])  # negative in pixels that `drop_last` has ended
        alpha = ONE - clear
        z, n0, n1, n2, plane = finish_pixel(
            alpha, rows[4 * LANES + i], rows[5 * LANES + i], rows[6 * LANES + i],
            rows[7 * LANES + i], rows[8 * LANES + i],
            (x + np.float32(i & SIDE - 1)) * fx, (y + np.float32(i >> SHIFT)) * fy,
            orthographic, halfway,
        )  # fmt: skip
        rows[i] = alpha
        rows[1 * LANES + i] += clear * red
        rows[2 * LANES + i] += clear * green
        rows[3 * LANES + i] += clear * blue
        rows[4 * LANES + i], rows[8 * LANES + i] = z, plane
        rows[5 * LANES + i], rows[6 * LANES + i], rows[7 * LANES + i] = n0, n1, n2


@jit.device_function
def write_tile(
    state, top, left, height, width, lens, orthographic, background, halfway,
    color_out, alpha_out, depth_out, plane_out, normal_out,
):  # fmt: skip
    """Write the pixels of a finished tile into the pictures."""
    for block in range(BLOCKS):
        x, y = np.float32(left + block % ROW * SIDE), np.float32(top + block // ROW * SIDE)
        at = block * CHANNELS * LANES
        rows = state[at : at + CHANNELS * LANES]  # indices from 0: no look for negative ones
        finish_block(rows, x + HALF, y + HALF, lens, orthographic, background, halfway)
    # Unsigned, or numba would look for negative indices at each access.
    for j in range(np.uint64(min(TILE, height - top))):
        first = (np.uint64(top) + j) * np.uint64(width) + np.uint64(left)
        for i in range(np.uint64(min(TILE, width - left))):
            block = (j >> WIDE_SHIFT) * WIDE_ROW + (i >> WIDE_SHIFT)
            inside = (j & WIDE_MASK) * WIDE_ROW + (i & WIDE_MASK)
            at = block * BLOCK_NUMBERS + inside
            pixel = first + i
            three = pixel * THREE
            alpha_out[pixel] = state[at]
            color_out[three] = state[at + RED]
            color_out[three + NEXT] = state[at + GREEN]
            color_out[three + AFTER] = state[at + BLUE]
            depth_out[pixel] = state[at + DEPTH]
            normal_out[three] = state[at + NORMAL_X]
            normal_out[three + NEXT] = state[at + NORMAL_Y]
            normal_out[three + AFTER] = state[at + NORMAL_Z]
            plane_out[pixel] = state[at + PLANE]
