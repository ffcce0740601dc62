"""How much light each splat gives to parts of a picture."""

import numpy as np

from rainsim.constants import HALF, ONE, QUARTER, ZERO
from rainsim.jit import TAKERS, cpu_kernel, none_taken, prange, take_next
from rainsim.numerics.approximations import exp_minus
from rainsim.splatting.lanes import MAX_ALPHA, TRANSMITTANCE_STOP, prefetch
from rainsim.splatting.prepared import LANES
from rainsim.splatting.project import MIN_ALPHA_LOG2, R_CONIC, R_LEVEL, R_U, R_V, TILE
from rainsim.splatting.tiles import DIGITS, RECORD_MASK, sort_keys

LN2 = np.float32(np.log(2))
OPAQUE_MOST = np.float32(MAX_ALPHA)
EIGHT = np.float32(8)
EVERY = 8  # splats after which it is asked whether they hide all others
AHEAD = 16  # entries by which records are fetched before they are read


@cpu_kernel
def weigh_tiles(record, entry, start, width, part, step, weight_out):
    """Sort each tile's list and add up the light that splats give to three parts of a picture.

    record : float32 array (n, RECORD)
    entry : uint64 array. Lists of the tiles; sorted in place.
    start : int64 array (tiles + 1,)
    width : int [px]
    part : int8 array (height, width). -1 the first, 1 the second, 0 the third.
    step : int [px]. Every step-th pixel of every step-th row is asked.
    weight_out : float32 array (entries, 4). Of each entry, for each part: the sum
        of alpha times transmittance [px]; and the sum of alpha over the second,
        whatever stands before it.
    """
    across = (width + TILE - 1) // TILE
    tiles = len(start) - 1
    height = part.shape[0]
    longest = 0
    for tile in range(tiles):
        longest = max(longest, start[tile + 1] - start[tile])
    taken = none_taken()
    for _ in prange(TAKERS):
        tile = take_next(taken)
        if tile >= tiles:  # as in most iterations: no arrays are made
            continue
        clear, mine = np.empty(TILE * TILE, np.float32), np.empty(TILE * TILE, np.float32)
        spare, histogram = np.empty(longest, np.uint64), np.empty(DIGITS, np.int64)
        while tile < tiles:
            top, left = tile // across * TILE, tile % across * TILE
            columns = (min(TILE, width - left) + step - 1) // step
            rows = (min(TILE, height - top) + step - 1) // step
            for j in range(rows):
                for i in range(columns):
                    clear[j * columns + i] = ONE
                    mine[j * columns + i] = np.float32(part[top + j * step, left + i * step])
            begin, end = start[tile], start[tile + 1]
            sort_keys(entry[begin:end], spare, histogram, end - begin)
            sky = False
            for n in range(rows * columns):
                sky |= mine[n] > ZERO
            hidden = False  # all that follows, which counts over the second part only
            for k in range(begin, end):
                if hidden and not sky:
                    weight_out[k] = ZERO
                    continue
                if k + AHEAD < len(entry):
                    prefetch(record, np.int64(entry[k + AHEAD] & RECORD_MASK))
                o = np.int64(entry[k] & RECORD_MASK)
                level = record[o, R_LEVEL]
                a, b, c = record[o, R_CONIC], record[o, R_CONIC + 1], record[o, R_CONIC + 2]
                x = np.float32(left) + HALF - record[o, R_U]
                y = np.float32(top) + HALF - record[o, R_V]
                total, first, second, whole = ZERO, ZERO, ZERO, ZERO
                # Of a row of pixels the level is greatest where b dy = -2 a dx.
                fall = c - QUARTER * b * b / a
                for j in range(rows):
                    dy = y + np.float32(j * step)
                    if EIGHT * (level - fall * dy * dy) < MIN_ALPHA_LOG2 - HALF:
                        continue
                    for i in range(columns):
                        dx = x + np.float32(i * step)
                        log2 = EIGHT * (level - a * dx * dx - b * dx * dy - c * dy * dy)
                        now = clear[j * columns + i]
                        alpha = min(exp_minus(-LN2 * log2), OPAQUE_MOST)
                        alpha = alpha if log2 > MIN_ALPHA_LOG2 else ZERO
                        light = alpha * now if now > TRANSMITTANCE_STOP else ZERO
                        clear[j * columns + i] = now - light
                        total += light
                        second += light * max(mine[j * columns + i], ZERO)
                        whole += alpha * max(mine[j * columns + i], ZERO)
                        first += light * max(-mine[j * columns + i], ZERO)
                if k % EVERY == 0:
                    hidden = True
                    for n in range(rows * columns):
                        hidden &= clear[n] <= TRANSMITTANCE_STOP
                weight_out[k, 0], weight_out[k, 1] = first, second
                weight_out[k, 2], weight_out[k, 3] = total - first - second, whole
            tile = take_next(taken)


@cpu_kernel
def add_weights(entry, chunks, lane, order, weight, factor, threads, light_out):
    """Sum the weights of each splat's entries, in their order, times a factor.

    Each of the threads looks at all entries and adds those of its own records.

    entry : uint64 array. The sorted lists of `weigh_tiles`.
    chunks : int64 array. Those in sight, see `Rasterizer`.
    lane : uint8 array. Place in its chunk of each record.
    order : int32 array (n,). Splat of each prepared one.
    weight : float32 array (entries, 4)
    light_out : float64 array (n, 4)
    """
    for n in prange(len(light_out)):
        light_out[n] = 0
    records = len(chunks) * LANES
    for thread in prange(threads):
        first, stop = thread * records // threads, (thread + 1) * records // threads
        for k in range(len(weight)):
            o = np.int64(entry[k] & RECORD_MASK)
            # Many are hidden.
            if first <= o < stop and max(weight[k, 0], weight[k, 2], weight[k, 3]) > ZERO:
                n = order[chunks[o // LANES] * LANES + lane[o]]
                for part in range(4):
                    light_out[n, part] += factor * weight[k, part]
