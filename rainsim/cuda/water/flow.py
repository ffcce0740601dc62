"""The scheme "lean" on a CUDA device: twin of `rainsim.water.lean` and of the flow's measures.

A step is one launch: flux, new depth, momentum, friction and ghost cells. A thread marches up a
column of cells and keeps the numbers that the next row needs in registers. Each block writes its
largest speeds and what left through open edges, which the host puts together.

All fields are flat, ny + 1 rows of `pitch` numbers, with the `PAD` ghost cells of
`rainsim.water.conserving` in ny and nx and room for the last faces. Depth and velocity are kept
twice; `parity` is the number of the present copy. Ghost cells never change: water only leaves
through the edges, so the upwind cell lies inside. The faces of walls stay 0.
"""

from typing import NamedTuple

import numpy as np

from rainsim.constants import QUARTER, ZERO
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel, tight_kernel
from rainsim.cuda.scalars import float_of
from rainsim.cuda.warp import raise_to
from rainsim.water.bundles import FrictionNumbers, Ground, StepNumbers
from rainsim.water.conserving import PAD, depth_over_step, speed_out, wave_speed
from rainsim.water.friction import slowed
from rainsim.water.inputs import EDGES
from rainsim.water.lean import accelerated, upwind_flux, upwind_gain

THREADS = 32 if SIMULATED else 128  # of a block of `step`: columns
ROWS = 8, 64  # of cells that a thread marches through: fewest, most
BELOW = 3  # rows in time that a thread needs before its first one
RESIDENT = 5  # blocks of `step` that a multiprocessor holds
STRIPE = 8  # cells that a thread of `measure` or of the sources looks at
# Threads of a block of the kernels that treat each cell alone.
SIDE, HEIGHT, SQUARE = (8, 4, 32) if SIMULATED else (32, 8, 256)
LEAD = 32 - PAD  # floats before a row, so that the first cell begins a line of memory
UNIT = 2.0**-50  # m: drops wait as whole numbers of it, so that their order does not matter
WEST, EAST, SOUTH, NORTH = 1, 2, 4, 8  # bits of `kinds`: which edges are open
EDGES_OPEN, RUBS = 15, 16  # all of these, and the bit of friction
assert EDGES == ("west", "east", "south", "north")  # the order of these bits
# What each block finds, float64: rows of the arrays that `step` and `measure` write.
FAR, FAST, OUT = range(3)
SWIFT, DEEPEST, FALL, HIGHEST = range(4)
_NEXT, _ONE, _TWO = np.uint64(1), np.uint64(1), np.uint64(2)


def pitch(nx):
    """Return the floats from one row of a map to the next: nx cells with ghosts, a face, a lead."""
    return -(-(LEAD + nx + 1) // 32) * 32


def rows_for(ny, wide):
    """Return how many rows a thread takes so that `wide` blocks beside each other end soonest.

    Blocks run in rounds. A last round that is half empty costs as much as a full one, and short
    marches read more rows twice.
    """
    if SIMULATED:
        return ROWS[0]
    room = RESIDENT * cuda.get_current_device().MULTIPROCESSOR_COUNT
    return min(
        range(ROWS[0], ROWS[1] + 1),
        key=lambda rows: -(-wide * -(-ny // rows) // room) * (rows + BELOW),
    )


class Layout(NamedTuple):
    """Layout of the cells in memory and among threads.

    ny, nx, pitch : int. Cells with their ghosts, and numbers from one row to the
        next.
    rows : int. Of cells that a thread marches through.
    kinds : int. Bits of the open edges, WEST, EAST, SOUTH, NORTH, and RUBS where
        there is friction.
    """

    ny: int
    nx: int
    pitch: int
    rows: int
    kinds: int


def layout_of(shape, edge_is_open, rubs):
    """Return the `Layout` of maps of a shape, ghosts included."""
    ny, nx = shape
    kinds = sum(1 << k for k, is_open in enumerate(edge_is_open) if is_open) + RUBS * rubs
    rows = rows_for(ny - 2 * PAD, -(-(nx - 2 * PAD) // THREADS))
    return Layout(ny, nx, pitch(nx), rows, int(kinds))


def blocks_of_columns(layout):
    """Return the blocks of THREADS threads that take the columns of cells."""
    ny, nx = layout.ny - 2 * PAD, layout.nx - 2 * PAD
    return -(-nx // THREADS), -(-ny // layout.rows)


def blocks_of_cells(layout):
    """Return the blocks of (SIDE, HEIGHT) threads that take STRIPE cells of a column each."""
    ny, nx = layout.ny - 2 * PAD, layout.nx - 2 * PAD
    return -(-nx // SIDE), -(-ny // (HEIGHT * STRIPE))


@cuda.jit(device=True)
def block_sum(room, lane, value):
    """Sum `value` over the threads of a block, always in the same order."""
    room[lane] = value
    cuda.syncthreads()
    n = room.shape[0] // 2
    while n > 0:
        if lane < n:
            room[lane] += room[lane + n]
        cuda.syncthreads()
        n //= 2
    total = room[0]
    cuda.syncthreads()
    return total


@cuda.jit(device=True)
def _moved(place, by):
    """Return a place of 32 bits, moved, as an index: one instruction less than in 64 bits."""
    return np.uint64(np.uint32(place + by))


# long: a thread's march keeps some forty numbers in registers from row to row
@tight_kernel
def step(
    ground: Ground, layout: Layout, numbers: StepNumbers, friction: FrictionNumbers, parity,
    w_out, found_out,
):  # fmt: skip
    """Advance depth from n to n+1, velocity from n+1/2 to n+3/2.

    w_out : float32 device array (2 * 3 * cells,). Both copies of depth [m] and of
        the velocities of west and south faces [m/s].
    found_out : float64 device array (3, blocks). Largest speeds [m/s] of waves and
        of faces, and the flux [m2/s] out of open edges, summed.
    """
    bed, roughness = ground.bed, ground.roughness
    ny, nx, pitch, rows, kinds = layout
    k, kg, gravity, cap = numbers.k, numbers.kg, numbers.gravity, numbers.cap
    rounding, dry, drag, laminar = numbers.rounding, numbers.dry, friction.drag, friction.laminar
    rubs = kinds & RUBS != 0  # the same for all threads: without it nothing of friction is done
    tops = cuda.shared.array(2, np.int32)
    room = cuda.shared.array(THREADS, np.float64)
    through = cuda.shared.array(THREADS, np.float64)  # there, not in registers: few add to it
    lane = cuda.threadIdx.x
    if lane < 2:
        tops[lane] = 0
    through[lane] = 0.0
    cuda.syncthreads()
    p = parity
    # Numbers of 32 bit and offsets that have no sign: a third of all instructions were indices.
    i, last_column = np.int32(cuda.blockIdx.x * THREADS + lane + PAD), np.int32(nx - PAD - 1)
    first = np.int32(cuda.blockIdx.y * rows + PAD)
    end = np.int32(min(first + rows, ny - PAD))
    far, fast = ZERO, ZERO
    if i <= last_column:
        # `to_h` and so on lead from a cell to its numbers, in the present copy and in the new one.
        wide, plane = np.uint32(pitch), np.uint32((ny + 1) * pitch)
        to_h, to_h_out = np.uint32(3 * p * plane), np.uint32(3 * (1 - p) * plane)
        to_u, to_u_out = np.uint32(to_h + plane), np.uint32(to_h_out + plane)
        to_v, to_v_out = np.uint32(to_u + plane), np.uint32(to_u_out + plane)
        place = np.uint32((first - 1) * pitch + i + LEAD)
        below = np.uint32(place - wide)
        at, south = np.uint64(place), np.uint64(below)
        at_h, at_v, south_h = _moved(place, to_h), _moved(place, to_v), _moved(below, to_h)
        h_w, h_c, b_w, b_c = w_out[at_h - _ONE], w_out[at_h], bed[at - _ONE], bed[at]
        v_s, v_w, v_c = w_out[_moved(below, to_v)], w_out[at_v - _ONE], w_out[at_v]
        u_c = w_out[_moved(place, to_u)]
        t_s = b_c - bed[south]  # the step of the bed to the south
        q_sw = upwind_flux(v_w, w_out[south_h - _ONE], h_w, b_w - bed[south - _ONE])
        q_s = upwind_flux(v_c, w_out[south_h], h_c, t_s)
        d_s, e_s, r_s, q_ss, q_cs, q_es, u_s, u_es = (
            ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO,
        )  # fmt: skip
        lowest, highest = first == PAD, end == ny - PAD
        rim = (i <= PAD + 1) | (i == last_column) | lowest | highest
        row, faces = np.int32(0), np.int32(1 if lowest else 0)  # of which no face is to the south
        left = np.int32(end - first)  # rows to come
        while left >= 0:
            above = np.uint32(place + wide)
            at, north = np.uint64(place), np.uint64(above)
            at_h, at_u, at_v = _moved(place, to_h), _moved(place, to_u), _moved(place, to_v)
            north_h, north_v = _moved(above, to_h), _moved(above, to_v)
            # w, e, n: west, east, north of the cell; s: what the row below has left.
            u_w, u_e, u_n = w_out[at_u - _ONE], w_out[at_u + _ONE], w_out[_moved(above, to_u)]
            v_e, v_nw, v_n = w_out[at_v + _ONE], w_out[north_v - _ONE], w_out[north_v]
            h_e, h_nw, h_n = w_out[at_h + _ONE], w_out[north_h - _ONE], w_out[north_h]
            b_e, b_nw, b_n = bed[at + _ONE], bed[north - _ONE], bed[north]
            r_w, r_c = ZERO, ZERO
            if rubs:
                r_w, r_c = roughness[at - _ONE], roughness[at]
            t_c, t_n = b_c - b_w, b_n - b_c
            q_w = upwind_flux(u_w, w_out[at_h - _TWO], h_w, b_w - bed[at - _TWO])
            q_c = upwind_flux(u_c, h_w, h_c, t_c)
            q_e = upwind_flux(u_e, h_c, h_e, b_e - b_c)
            q_nw = upwind_flux(v_nw, h_w, h_nw, b_nw - b_w)
            q_n = upwind_flux(v_n, h_c, h_n, t_n)
            d_w = max(h_w - k * ((q_c - q_w) + (q_nw - q_sw)), ZERO)
            d = max(h_c - k * ((q_e - q_c) + (q_n - q_s)), ZERO)
            e = rounding * (d + abs(b_c))
            if row > 0:
                x, y = ZERO, ZERO
                if i > PAD:
                    gain = upwind_gain(
                        u_c, u_w, u_e, u_s, u_n, q_w + q_c, q_c + q_e, q_sw + q_s, q_nw + q_n
                    )
                    noise = rounding * (d_w + abs(b_w)) + e
                    x = accelerated(u_c, d_w, d, t_c, noise, gain, k, kg, cap, dry)
                    if rubs and x != ZERO:
                        deep = max(depth_over_step(d_w, d, t_c), dry)
                        along = QUARTER * (v_w + v_c + v_nw + v_n)
                        x = slowed(x, along, deep, drag * max(r_w, r_c), laminar)
                    w_out[_moved(place, to_u_out)] = x
                    far = max(far, wave_speed(x, d_w, d, gravity))
                    fast = max(fast, abs(x))
                if row > faces:
                    gain = upwind_gain(
                        v_c, v_w, v_e, v_s, v_n, q_cs + q_c, q_es + q_e, q_ss + q_s, q_s + q_n
                    )
                    y = accelerated(v_c, d_s, d, t_s, e_s + e, gain, k, kg, cap, dry)
                    if rubs and y != ZERO:
                        deep = max(depth_over_step(d_s, d, t_s), dry)
                        along = QUARTER * (u_s + u_es + u_c + u_e)
                        y = slowed(y, along, deep, drag * max(r_s, r_c), laminar)
                    w_out[_moved(place, to_v_out)] = y
                    far = max(far, wave_speed(y, d_s, d, gravity))
                    fast = max(fast, abs(y))
                w_out[_moved(place, to_h_out)] = d
                if rim:
                    passed = 0.0
                    if i == PAD and kinds & WEST:
                        passed -= np.float64(q_c)
                    if i == PAD + 1 and kinds & WEST:
                        w_out[_moved(place, to_u_out) - _ONE] = -speed_out(-x, -u_c, -u_e, -t_c)
                    if i == last_column and kinds & EAST:
                        passed += np.float64(q_e)
                        w_out[_moved(place, to_u_out) + _ONE] = speed_out(x, u_c, u_w, t_c)
                    if lowest and row == 1 and kinds & SOUTH:
                        passed -= np.float64(q_s)
                    if lowest and row == 2 and kinds & SOUTH:
                        south_v = _moved(place, np.uint32(to_v_out - wide))
                        w_out[south_v] = -speed_out(-y, -v_c, -v_n, -t_s)
                    if highest and left == 0 and kinds & NORTH:
                        passed += np.float64(q_n)
                        w_out[_moved(above, to_v_out)] = speed_out(y, v_c, v_s, t_s)
                    through[lane] += passed
            d_s, e_s, r_s, q_ss, q_cs, q_es, u_s, u_es = d, e, r_c, q_s, q_c, q_e, u_c, u_e
            t_s = t_n
            h_w, h_c, b_w, b_c, q_sw, q_s = h_nw, h_n, b_nw, b_n, q_nw, q_n
            v_s, v_w, v_c, u_c = v_c, v_nw, v_n, u_n
            place = above
            row, left = np.int32(row + 1), np.int32(left - 1)
    raise_to(tops, 0, far)
    raise_to(tops, 1, fast)
    block, out = cuda.blockIdx.y * cuda.gridDim.x + cuda.blockIdx.x, 0.0
    edge = first == PAD or end == ny - PAD or cuda.blockIdx.x == 0
    if kinds & EDGES_OPEN != 0 and (edge or cuda.blockIdx.x == cuda.gridDim.x - 1):
        out = block_sum(room, lane, through[lane])
    cuda.syncthreads()
    if lane == 0:
        found_out[FAR, block] = np.float64(float_of(tops[0]))
        found_out[FAST, block] = np.float64(float_of(tops[1]))
        found_out[OUT, block] = out


@cuda.jit(device=True)
def _fall(here, level, there, bed_there):
    """Return how far water may fall between two cells [m]."""
    drop = level - (bed_there + there)
    fall = drop if here > ZERO else ZERO
    return max(fall, -drop) if there > ZERO else fall


@cuda_kernel
def measure(w, bed, layout: Layout, parity, lowest, found_out):
    """Find the maxima that set the first step and the cap.

    found_out : float64 device array (4, blocks). Of each block the largest speed
        of a face [m/s], depth, fall between two cells and height above the lowest
        bed [m].
    """
    ny, nx, wide = layout.ny, layout.nx, layout.pitch
    tops = cuda.shared.array(4, np.int32)
    lane = cuda.threadIdx.y * SIDE + cuda.threadIdx.x
    if lane < 4:
        tops[lane] = 0
    cuda.syncthreads()
    i = cuda.blockIdx.x * SIDE + cuda.threadIdx.x + PAD
    first = (cuda.blockIdx.y * HEIGHT + cuda.threadIdx.y) * STRIPE + PAD
    row, plane = np.uint64(wide), (ny + 1) * wide
    swift, deepest, fall, highest = ZERO, ZERO, ZERO, ZERO
    if i < nx - PAD and first < ny - PAD:
        h = w[parity * 3 * plane :]
        u, v = h[plane:], h[2 * plane :]
        at = np.uint64(first * wide + i + LEAD)
        here, floor, has_east = h[at], bed[at], i + 1 < nx - PAD
        swift = abs(v[at])
        for j in range(first, min(first + STRIPE, ny - PAD)):
            level, below = floor + here, here
            deepest = max(deepest, here)
            if here > ZERO:
                highest = max(highest, level - lowest)
            if has_east:
                fall = max(fall, _fall(here, level, h[at + _NEXT], bed[at + _NEXT]))
            swift = max(swift, max(abs(u[at]), abs(u[at + _NEXT])))
            at += row
            here, floor = h[at], bed[at]
            swift = max(swift, abs(v[at]))
            if j + 1 < ny - PAD:
                fall = max(fall, _fall(below, level, here, floor))
    raise_to(tops, 0, swift)
    raise_to(tops, 1, deepest)
    raise_to(tops, 2, fall)
    raise_to(tops, 3, highest)
    cuda.syncthreads()
    if lane < 4:
        block = cuda.blockIdx.y * cuda.gridDim.x + cuda.blockIdx.x
        found_out[lane, block] = np.float64(float_of(tops[lane]))
