"""The scheme "lean" on a CUDA device: twin of `rainsim.grid.lean` and of the solver's step.

A step is one launch: flux, new depth, momentum, friction, rain and infiltration, ghost cells and
the account. A thread marches up a column of cells and keeps what the next row needs of this one in
registers. How long the step is, the launch before has decided (see `rainsim.cuda.account`); one for
which no time is left returns at once.

All fields are flat, row by row, with the `PAD` ghost cells of `rainsim.grid.conserving`; depth and
velocity are kept twice, and `state[PARITY]` tells which copy is the present one. Ghost cells stay
as they are: water only leaves through the edges, and what is upwind then is inside. The faces of
walls stay 0.
"""

from __future__ import annotations

import numpy as np

from rainsim.cuda.account import (
    CAP,
    EAST,
    GRAVITY,
    LAST,
    MOVE,
    NORTH,
    P_DRUNK,
    P_FILM,
    P_GROUND,
    P_OUT,
    PARITY,
    PUSH,
    RATE,
    REACH,
    REACH_NOW,
    RUNS,
    SOUTH,
    SPACING,
    SWIFT,
    SWIFT_NOW,
    TAKE,
    THREADS,
    TICKET,
    UNSOUND,
    VISCOSITY,
    WEST,
    block_sum,
    is_last_block,
    plan,
    raised,
)
from rainsim.cuda.jit import cuda, fast_kernel
from rainsim.cuda.scalars import bits_of
from rainsim.grid.conserving import PAD, ZERO, reach, standing
from rainsim.grid.friction import QUARTER, rubbed
from rainsim.grid.lean import pushed_lean, upwind_flux, upwind_gain
from rainsim.grid.solver import MAX_SPEED
from rainsim.grid.sources import soaked

ROWS = 8  # of cells that a thread marches through
S_OUT, S_DRUNK, S_GROUND, S_FILM = range(4)
_ONE, _TWO = np.uint32(1), np.uint32(2)


@fast_kernel
def step(
    control, state, now, numbers, bed, roughness, exposure, infiltration, storage, ny, nx, kinds,
    rough, gravity, rest, dry, h_out, u_out, v_out, damp_out, film_out, depth_out, partial_out,
):  # fmt: skip
    """Bring depth from n to n+1 and velocity from n+1/2 to n+3/2; then rain and infiltration.

    Parameters
    ----------
    control, state, now, numbers
        See the module's constants; the first two are modified.
    bed, roughness, exposure, infiltration, storage : device arrays of shape (ny * nx,), float32
        Height [m], square of Manning's n [s2 m^(-2/3)], share of the rain that falls here, rate
        that the ground takes [m/s], depth held back [m].
    ny, nx : int
        Cells with their ghosts.
    kinds : int
        Bits of the open edges.
    rough : bool
        Whether there is friction.
    gravity, rest, dry : float32
        As `grid.lean.step` has them.
    h_out, u_out, v_out : device arrays of shape (2 * ny * nx,) and so on, float32
        Both copies of depth [m] and face velocities [m/s].
    damp_out, film_out : device arrays of shape (ny * nx,), float32 [m]
    depth_out : device array of shape (ny - 4, nx - 4), float32 [m]
        Depth above the bed, film included; written by the last step of a frame.
    partial_out : device array of shape (PARTIAL, blocks), float64
        Sums of each block over the frame.
    """
    if state[RUNS] == 0:
        return
    tops = cuda.shared.array(2, np.int32)
    room = cuda.shared.array(THREADS, np.float64)
    sums = cuda.shared.array((4, THREADS), np.float64)  # kept there, not in registers
    lane = cuda.threadIdx.x
    if lane < 2:
        tops[lane] = 0
    for which in range(4):
        sums[which, lane] = 0.0
    cuda.syncthreads()
    p, is_last = state[PARITY], state[LAST] == 1
    move, push, wets = control[MOVE], control[PUSH], control[TAKE] >= 0.0
    k = np.float32(move / numbers[SPACING])
    kg = np.float32(numbers[GRAVITY] * push / numbers[SPACING])
    drag = np.float32(numbers[GRAVITY] * push)
    laminar = np.float32(3.0 * numbers[VISCOSITY] * push)
    cap = np.float32(control[CAP])
    cells, faces = ny * nx, ny * (nx + 1)
    i = cuda.blockIdx.x * THREADS + lane + PAD
    first = cuda.blockIdx.y * ROWS + PAD
    end = min(first + ROWS, ny - PAD)
    far, fast = ZERO, ZERO
    if i < nx - PAD:
        wide, wider = np.uint32(nx), np.uint32(nx + 1)
        at = np.uint32((first - 1) * nx + i)
        h_here, h_there = np.uint32(p * cells), np.uint32((1 - p) * cells)
        u_here, u_there = np.uint32(p * faces), np.uint32((1 - p) * faces)
        v_here, v_there = np.uint32(p * (cells + nx)), np.uint32((1 - p) * (cells + nx))
        face = np.uint32((first - 1) * (nx + 1) + i)
        hc, uc, vc = h_here + at, u_here + face, v_here + at
        h_w, h_c, b_w, b_c = h_out[hc - _ONE], h_out[hc], bed[at - _ONE], bed[at]
        v_s, v_w, v_c = v_out[vc - wide], v_out[vc - _ONE], v_out[vc]
        u_c = u_out[uc]
        q_sw = upwind_flux(v_w, h_out[hc - wide - _ONE], h_w, b_w - bed[at - wide - _ONE])
        q_s = upwind_flux(v_c, h_out[hc - wide], h_c, b_c - bed[at - wide])
        d_s, b_s, r_s, q_ss, q_cs, q_es, u_s, u_es = (
            ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO,
        )  # fmt: skip
        for j in range(first - 1, end):
            hc, uc, vc = h_here + at, u_here + face, v_here + at
            # w, e, n: west, east, north of the cell; s: what the row below has left.
            u_w, u_e, u_n = u_out[uc - _ONE], u_out[uc + _ONE], u_out[uc + wider]
            v_e, v_nw, v_n = v_out[vc + _ONE], v_out[vc + wide - _ONE], v_out[vc + wide]
            h_e, h_nw, h_n = h_out[hc + _ONE], h_out[hc + wide - _ONE], h_out[hc + wide]
            b_e, b_nw, b_n = bed[at + _ONE], bed[at + wide - _ONE], bed[at + wide]
            q_w = upwind_flux(u_w, h_out[hc - _TWO], h_w, b_w - bed[at - _TWO])
            q_c = upwind_flux(u_c, h_w, h_c, b_c - b_w)
            q_e = upwind_flux(u_e, h_c, h_e, b_e - b_c)
            q_nw = upwind_flux(v_nw, h_w, h_nw, b_nw - b_w)
            q_n = upwind_flux(v_n, h_c, h_n, b_n - b_c)
            d_w = max(h_w - k * ((q_c - q_w) + (q_nw - q_sw)), ZERO)
            d = max(h_c - k * ((q_e - q_c) + (q_n - q_s)), ZERO)
            r_w, r_c = ZERO, ZERO
            if rough:
                r_w, r_c = roughness[at - _ONE], roughness[at]
            if j >= first:
                if i > PAD:
                    gain = upwind_gain(
                        u_c, u_w, u_e, u_s, u_n, q_w + q_c, q_c + q_e, q_sw + q_s, q_nw + q_n
                    )
                    noise = rest * (d_w + abs(b_w)) + rest * (d + abs(b_c))
                    s = pushed_lean(u_c, d_w, d, b_c - b_w, noise, gain, k, kg, cap, dry)
                    if rough and s != ZERO:
                        deep = max(standing(d_w, d, b_c - b_w), dry)
                        along = QUARTER * (v_w + v_c + v_nw + v_n)
                        s = rubbed(s, along, deep, drag * max(r_w, r_c), laminar)
                    u_out[u_there + face] = s
                    if i == PAD + 1 and kinds & WEST:
                        u_out[u_there + face - _ONE] = min(s, ZERO)
                    if i == nx - PAD - 1 and kinds & EAST:
                        u_out[u_there + face + _ONE] = max(s, ZERO)
                    far = max(far, reach(s, d_w, d, gravity))
                    fast = max(fast, abs(s))
                if j > PAD:
                    gain = upwind_gain(
                        v_c, v_w, v_e, v_s, v_n, q_cs + q_c, q_es + q_e, q_ss + q_s, q_s + q_n
                    )
                    noise = rest * (d_s + abs(b_s)) + rest * (d + abs(b_c))
                    s = pushed_lean(v_c, d_s, d, b_c - b_s, noise, gain, k, kg, cap, dry)
                    if rough and s != ZERO:
                        deep = max(standing(d_s, d, b_c - b_s), dry)
                        along = QUARTER * (u_s + u_es + u_c + u_e)
                        s = rubbed(s, along, deep, drag * max(r_s, r_c), laminar)
                    v_out[v_there + at] = s
                    if j == PAD + 1 and kinds & SOUTH:
                        v_out[v_there + at - wide] = min(s, ZERO)
                    if j == ny - PAD - 1 and kinds & NORTH:
                        v_out[v_there + at + wide] = max(s, ZERO)
                    far = max(far, reach(s, d_s, d, gravity))
                    fast = max(fast, abs(s))
                if i == PAD:
                    sums[S_OUT, lane] -= np.float64(q_c)
                if i == nx - PAD - 1:
                    sums[S_OUT, lane] += np.float64(q_e)
                if j == PAD:
                    sums[S_OUT, lane] -= np.float64(q_s)
                if j == ny - PAD - 1:
                    sums[S_OUT, lane] += np.float64(q_n)
                value = d
                if wets:
                    take = control[TAKE]
                    fall = np.float64(np.float32(now[RATE]) * exposure[at])
                    film = np.float64(film_out[at])
                    free = np.float64(d) + np.float64(damp_out[at]) + take * fall
                    from_free, from_film, held = soaked(
                        free, film, take * np.float64(infiltration[at]), np.float64(storage[at])
                    )
                    sums[S_DRUNK, lane] += from_free + from_film
                    kept = np.float32(film - from_film + held)
                    film_out[at] = kept
                    free -= from_free + (np.float64(kept) - (film - from_film))
                    value = np.float32(free) if free >= np.float64(dry) else ZERO
                    damp_out[at] = np.float32(free - np.float64(value))
                h_out[h_there + at] = value
                if is_last:
                    damp, film_now = damp_out[at], film_out[at]
                    sums[S_GROUND, lane] += np.float64(value) + np.float64(damp)
                    sums[S_FILM, lane] += np.float64(film_now)
                    depth_out[j - PAD, i - PAD] = film_now + (value + damp)
            d_s, b_s, r_s, q_ss, q_cs, q_es, u_s, u_es = d, b_c, r_c, q_s, q_c, q_e, u_c, u_e

            h_w, h_c, b_w, b_c, q_sw, q_s = h_nw, h_n, b_nw, b_n, q_nw, q_n
            v_s, v_w, v_c, u_c = v_c, v_nw, v_n, u_n
            at, face = at + wide, face + wider
    cuda.atomic.max(tops, 0, bits_of(far))
    cuda.atomic.max(tops, 1, bits_of(fast))
    block = cuda.blockIdx.y * cuda.gridDim.x + cuda.blockIdx.x
    low, high = first < PAD + 2, end > ny - PAD - 2
    low = low or cuda.blockIdx.x == 0
    if kinds != 0 and (low or high or cuda.blockIdx.x == cuda.gridDim.x - 1):
        out = block_sum(room, lane, sums[S_OUT, lane] * move)
        if lane == 0:
            partial_out[P_OUT, block] += out
    if wets:
        drunk = block_sum(room, lane, sums[S_DRUNK, lane])
        if lane == 0:
            partial_out[P_DRUNK, block] += drunk
    if is_last:
        ground = block_sum(room, lane, sums[S_GROUND, lane])
        held = block_sum(room, lane, sums[S_FILM, lane])
        if lane == 0:
            partial_out[P_GROUND, block] = ground
            partial_out[P_FILM, block] = held
    cuda.syncthreads()
    if lane > 0:
        return
    cuda.atomic.max(state, REACH, tops[0])
    cuda.atomic.max(state, SWIFT, tops[1])
    if is_last_block(state):
        state[TICKET] = 0
        state[PARITY] = 1 - p
        control[REACH_NOW], control[SWIFT_NOW] = raised(state, REACH), raised(state, SWIFT)
        if not control[REACH_NOW] <= MAX_SPEED:
            state[UNSOUND] = 1
        plan(control, state, now, numbers)
