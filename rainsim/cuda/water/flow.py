"""The scheme "lean" on a CUDA device: twin of `rainsim.water.lean` and of the solver's step.

A step is one launch: flux, new depth, momentum, friction, rain and infiltration, ghost cells and
the account. A thread marches up a column of cells and keeps the numbers that the next row needs in
registers. The launch before has decided how long the step is (see `step_control.plan`); a launch
for which no time is left returns at once.

All fields are flat, ny + 1 rows of `step_control.pitch` numbers, with the `PAD` ghost cells of
`rainsim.water.conserving` in ny and nx and room for the last faces. Depth and velocity are kept
twice; `state[PARITY]` is the number of the present copy. Ghost cells never change: water only
leaves through the edges, so the upwind cell lies inside. The faces of walls stay 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rainsim.constants import QUARTER, ZERO
from rainsim.cuda.jit import SIMULATED, cuda, tight_kernel
from rainsim.cuda.warp import raise_to
from rainsim.cuda.water.step_control import (
    CAP,
    DEEPEST,
    EAST,
    EDGES_OPEN,
    FLOOR,
    GRAVITY,
    HIGHEST,
    LAST,
    LEAD,
    MOVE,
    NORTH,
    P_DRAINED,
    P_DRUNK,
    P_FILM,
    P_GROUND,
    P_OUT,
    PARITY,
    PUSH,
    RATE,
    REACH,
    REACH_NOW,
    RUBS,
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
    known,
    plan,
    raise_cap,
    raised,
)
from rainsim.grid import MAX_SPEED
from rainsim.water.conserving import PAD, depth_over_step, speed_out, wave_speed
from rainsim.water.friction import slowed
from rainsim.water.lean import accelerated, upwind_flux, upwind_gain
from rainsim.water.sources import infiltrate_and_fill

ROWS = 8, 64  # of cells that a thread marches through: fewest, most
BELOW = 3  # rows in time that a thread needs before its first one
RESIDENT = 5  # blocks of `step` that a multiprocessor holds
_ONE, _TWO = np.uint64(1), np.uint64(2)


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


class Maps(NamedTuple):
    """Maps of the ground: device arrays of shape (cells,), float32.

    bed : [m]
    roughness : [s2 m^(-2/3)]. Square of Manning's n.
    exposure : Share of the rain that falls here.
    infiltration : [m/s]. Rate that the ground takes; negative: rate that a drain
        takes.
    storage : [m]. Depth held back.
    """

    bed: object
    roughness: object
    exposure: object
    infiltration: object
    storage: object


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


class Limits(NamedTuple):
    """Gravity [m/s2], the rounding of levels and the depth [m] below which water does not flow."""

    gravity: np.float32
    rounding: np.float32
    dry: np.float32


@cuda.jit(device=True)
def _moved(place, by):
    """Return a place of 32 bits, moved, as an index: one instruction less than in 64 bits."""
    return np.uint64(np.uint32(place + by))


# long: a thread's march keeps some forty numbers in registers from row to row
@tight_kernel
def step(
    control, state, now, numbers, maps: Maps, layout: Layout, limits: Limits,
    w_out, remainder_out, film_out, depth_out, partial_out,
):  # fmt: skip
    """Advance depth from n to n+1, velocity from n+1/2 to n+3/2; then rain and infiltration.

    control, state, now, numbers. See the module's constants; the first two are
        modified.
    w_out : float32 device array (2 * 3 * cells,). Both copies of depth [m] and of
        the velocities of west and south faces [m/s].
    remainder_out, film_out : device arrays of shape (cells,), float32 [m]
    depth_out : float32 device array (ny - 4, nx - 4) [m]. Depth above the bed,
        film included; written by the last step of a frame.
    partial_out : float64 device array (PARTIAL, blocks). Sums of each block over
        the frame.
    """
    if state[RUNS] == 0:
        return
    bed, roughness = maps.bed, maps.roughness
    ny, nx, pitch, rows, kinds = layout
    gravity, rounding, dry = limits
    rubs = kinds & RUBS != 0  # the same for all threads: without it nothing of friction is done
    tops = cuda.shared.array(4, np.int32)
    room = cuda.shared.array(THREADS, np.float64)
    through = cuda.shared.array(THREADS, np.float64)  # there, not in registers: few add to it
    lane = cuda.threadIdx.x
    if lane < 4:
        tops[lane] = 0
    through[lane] = 0.0
    cuda.syncthreads()
    p, is_last = state[PARITY], state[LAST] == 1
    move, push, wets = control[MOVE], control[PUSH], control[TAKE] >= 0.0
    k = np.float32(move / numbers[SPACING])
    kg = np.float32(numbers[GRAVITY] * push / numbers[SPACING])
    drag = np.float32(numbers[GRAVITY] * push)
    laminar = np.float32(3.0 * numbers[VISCOSITY] * push)
    cap = np.float32(control[CAP])
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
                    if i == PAD:
                        passed -= np.float64(q_c)
                    if i == PAD + 1 and kinds & WEST:
                        w_out[_moved(place, to_u_out) - _ONE] = -speed_out(-x, -u_c, -u_e, -t_c)
                    if i == last_column:
                        passed += np.float64(q_e)
                        if kinds & EAST:
                            w_out[_moved(place, to_u_out) + _ONE] = speed_out(x, u_c, u_w, t_c)
                    if lowest and row == 1:
                        passed -= np.float64(q_s)
                    if lowest and row == 2 and kinds & SOUTH:
                        south_v = _moved(place, np.uint32(to_v_out - wide))
                        w_out[south_v] = -speed_out(-y, -v_c, -v_n, -t_s)
                    if highest and left == 0:
                        passed += np.float64(q_n)
                        if kinds & NORTH:
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
    block = cuda.blockIdx.y * cuda.gridDim.x + cuda.blockIdx.x
    edge = first == PAD or end == ny - PAD or cuda.blockIdx.x == 0
    if kinds & EDGES_OPEN != 0 and (edge or cuda.blockIdx.x == cuda.gridDim.x - 1):
        out = block_sum(room, lane, through[lane] * move)
        if lane == 0:
            partial_out[P_OUT, block] += out
    if wets or is_last:
        infiltrated, drained, ground, held = 0.0, 0.0, 0.0, 0.0
        if i < nx - PAD:
            infiltrated, drained, ground, held = _apply_sources(
                control, now, maps, first, end, i, pitch, 3 * (1 - p) * (ny + 1) * pitch, dry,
                wets, w_out, remainder_out, film_out, depth_out,
            )  # fmt: skip
        infiltrated, drained = block_sum(room, lane, infiltrated), block_sum(room, lane, drained)
        ground, held = block_sum(room, lane, ground), block_sum(room, lane, held)
        if lane == 0:
            partial_out[P_DRUNK, block] += infiltrated
            partial_out[P_DRAINED, block] += drained
            partial_out[P_GROUND, block] = ground
            partial_out[P_FILM, block] = held
    from_rest = wets and control[SWIFT_NOW] == 0.0
    if from_rest:  # the cap of dry ground would hold what fell on it
        deepest, highest = ZERO, ZERO
        if i < nx - PAD:
            floor = np.float32(numbers[FLOOR])
            for j in range(first, end):
                at = np.uint64(j * pitch + i + LEAD)
                here = w_out[np.uint64(3 * (1 - p) * (ny + 1) * pitch) + at]
                deepest = max(deepest, here)
                if here > ZERO:
                    highest = max(highest, bed[at] + here - floor)
        raise_to(tops, 2, deepest)
        raise_to(tops, 3, highest)
    cuda.syncthreads()
    if lane > 0:
        return
    planned = known(control, state, now, numbers)
    cuda.atomic.max(state, REACH, tops[0])
    cuda.atomic.max(state, SWIFT, tops[1])
    if from_rest:
        cuda.atomic.max(state, DEEPEST, tops[2])
        cuda.atomic.max(state, HIGHEST, tops[3])
    if is_last_block(state):
        waves, water = raised(state, REACH), raised(state, SWIFT)
        state[TICKET], state[PARITY] = 0, 1 - p
        control[REACH_NOW], control[SWIFT_NOW] = waves, water
        if from_rest:
            depth, level = raised(state, DEEPEST), raised(state, HIGHEST)
            raise_cap(control, numbers[GRAVITY], depth, level)
        if not waves <= MAX_SPEED:
            state[UNSOUND] = 1
        plan(control, state, planned, waves, water)


@cuda.jit(device=True)
def _apply_sources(
    control, now, maps, first, end, i, pitch, base, dry, wets,
    w_out, remainder_out, film_out, depth_out,
):  # fmt: skip
    """Add rain and take losses in a thread's cells, as `water.sources.apply_sources`.

    Returns sums over the cells [m]: taken by the ground, taken by drains, standing as water that
    can flow, standing as films.
    """
    exposure, infiltration, storage = maps.exposure, maps.infiltration, maps.storage
    take, rate = control[TAKE], np.float32(now[RATE])
    infiltrated, drained, ground, held_sum = 0.0, 0.0, 0.0, 0.0
    for j in range(first, end):
        at = np.uint64(j * pitch + i + LEAD)
        here = np.uint64(base) + at
        value, remainder, kept = w_out[here], remainder_out[at], film_out[at]
        if wets:
            film = np.float64(kept)
            free = (
                np.float64(value) + np.float64(remainder) + take * np.float64(rate * exposure[at])
            )
            loss = take * np.float64(infiltration[at])
            from_free, from_film, held = infiltrate_and_fill(
                free, film, max(loss, 0.0), np.float64(storage[at])
            )
            infiltrated += from_free + from_film
            kept = np.float32(film - from_film + held)
            free -= from_free + (np.float64(kept) - (film - from_film))
            stays = free - min(-loss, free) if loss < 0.0 else free
            value = np.float32(stays) if stays >= np.float64(dry) else ZERO
            remainder = np.float32(stays - np.float64(value))
            if loss < 0.0:
                drained += free - np.float64(value) - np.float64(remainder)
            w_out[here], remainder_out[at], film_out[at] = value, remainder, kept
        ground += np.float64(value) + np.float64(remainder)
        held_sum += np.float64(kept)
        depth_out[j - PAD, i - PAD] = kept + (value + remainder)
    return infiltrated, drained, ground, held_sum
