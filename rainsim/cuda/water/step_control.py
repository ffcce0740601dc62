"""The account of the water on a CUDA device, and the plan of its steps without the host.

`rainsim.grid.WaterSolver` keeps times, speeds and the ledger in Python; here they stand in three
small device arrays, `control`, `state` and `now`. The last block of a launch plans the next step,
so that the host never waits for it. Sums are float64, in a fixed order.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.constants import ZERO
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.scalars import float_of
from rainsim.cuda.warp import raise_to
from rainsim.grid import QUIET_FALL, SOURCE_PERIOD
from rainsim.water.conserving import PAD
from rainsim.water.conserving_flow import MAX_STEP, ROUNDING_ROOM
from rainsim.water.sources import infiltrate_and_fill

THREADS = 32 if SIMULATED else 128  # of a block of `step`: columns
STRIPE = 8  # cells that a thread of `refresh` looks at
CLOSERS = 32 if SIMULATED else 512  # threads of `close`
# Threads of a block of the kernels that treat each cell alone.
SIDE, HEIGHT, SQUARE = (8, 4, 32) if SIMULATED else (32, 8, 256)

# `control`, float64: times [s], speeds [m/s], and sums over cells [m].
(LEFT, OWED, PENDING, MOVE, PUSH, TAKE, CAP, REACH_NOW, SWIFT_NOW) = range(9)
(OUTFLOW, RAINED, DROPPED, INFILTRATED, DRAINED, GROUND, FILM) = range(9, 16)
CONTROL = 16
# `state`, int32
(PARITY, RUNS, LAST, WAITS, SETTLED, SUBSTEPS, UNSOUND, TICKET) = range(8)
(REACH, SWIFT, DEEPEST, FALL, HIGHEST) = range(8, 13)  # bits of float32 that blocks raise
STATE = 13
# `now`, float64: what the host says of this frame
(DURATION, RATE, RAIN_SUM, RAIN_STEP, ADDED) = range(5)
NOW = 5
# `partial`, float64: sums of each block
(P_OUT, P_DROPPED, P_DRUNK, P_DRAINED, P_GROUND, P_FILM) = range(6)
PARTIAL = 6
# `numbers`, float64: constants of the map
(SPACING, GRAVITY, VISCOSITY, COURANT, FLOOR, LOSES, STORES) = range(7)

AFTER_SOURCES = 2  # in WAITS: a step from rest has had its sources, its push is to come
PLANNED = 1e-30  # s, of the time that is left when the last step is planned but has not run
NEXT = np.uint64(1)  # as an index: one that may be negative would be tested for it
LEAD = 32 - PAD  # floats before a row, so that the first cell begins a line of memory
UNIT = 2.0**-50  # m: drops wait as whole numbers of it, so that their order does not matter
WEST, EAST, SOUTH, NORTH = 1, 2, 4, 8  # bits of `kinds`: which edges are open
EDGES_OPEN, RUBS = 15, 16  # all of these, and the bit of friction


def pitch(nx):
    """Return the floats from one row of a map to the next: nx cells with ghosts, a face, a lead."""
    return -(-(LEAD + nx + 1) // 32) * 32


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
def known(control, state, now, numbers):
    """Read the numbers that `plan` needs, all at once: one wait for memory instead of a dozen."""
    return (
        control[LEFT], control[OWED], control[PENDING], control[RAINED], now[RAIN_SUM],
        now[RAIN_STEP], numbers[SPACING], numbers[GRAVITY], numbers[COURANT],
        numbers[LOSES] + numbers[STORES], numbers[LOSES], state[SETTLED], state[WAITS],
        state[SUBSTEPS],
    )  # fmt: skip


@cuda.jit(device=True)
def plan(control, state, planned, reach, swift):
    """Decide the next step as `WaterSolver.advance` does; none if no time is left.

    `planned` is what `known` has read, `reach` and `swift` the largest speeds of waves and water.
    """
    (
        left, owed, pending, rained, rain, rain_step, spacing, gravity, courant, takes, loses,
        settled, waits, substeps,
    ) = planned  # fmt: skip
    moves = swift > 0.0
    state[RUNS] = 0
    if waits == AFTER_SOURCES:
        state[RUNS], state[WAITS] = 1, 0
        control[MOVE], control[PUSH], control[PENDING], control[TAKE] = 0.0, pending, 0.0, -1.0
        return
    if left <= PLANNED:
        control[LEFT] = left = 0.0  # the step that was planned has run
    if settled == 1 and not moves and rain == 0.0 and loses == 0.0:
        control[LEFT] = left = 0.0  # a step would change no number
    if not left > 0.0:
        return
    room = ROUNDING_ROOM * spacing
    step = min(courant * room / max(reach, 1e-30), MAX_STEP * room / max(swift, 1e-30))
    step = min(step, left)
    if rain > 0.0:
        step = min(step, rain_step)
        if not moves:
            step = min(step, math.sqrt(QUIET_FALL * spacing / gravity))
    steps = max(math.ceil(left / step), 1.0)
    if pending > 0.0:
        steps = pending
        control[PENDING] = 0.0
    dt = left / steps
    state[RUNS] = 1
    control[TAKE] = -1.0
    if waits == 1:
        # Velocity is known at n like depth: half a step of pressure brings it on.
        state[WAITS], state[LAST] = 0, 0
        control[MOVE], control[PUSH], control[PENDING] = 0.0, 0.5 * dt, steps
        return
    state[SUBSTEPS] = substeps + 1
    state[LAST] = 1 if steps == 1.0 else 0
    control[MOVE] = dt if moves else 0.0
    control[PUSH] = dt
    control[LEFT] = 0.0 if steps == 1.0 else left - dt
    if rain > 0.0 or takes > 0.0:
        owed += dt
        if steps == 1.0 or owed >= SOURCE_PERIOD:
            control[TAKE] = owed
            control[RAINED] = rained + owed * rain
            owed = 0.0
            if not moves:  # gravity acts on the depth that is there once the rain has been added
                state[WAITS] = AFTER_SOURCES
                control[PUSH], control[PENDING] = 0.0, dt
        control[OWED] = owed
    state[SETTLED] = 1


@cuda.jit(device=True)
def raise_cap(control, gravity, deepest, highest):
    """Raise the cap for water of that depth and that height above the lowest bed [m]."""
    bound = 2.0 * math.sqrt(gravity * deepest) + math.sqrt(2.0 * gravity * highest)
    control[CAP] = max(control[CAP], bound)


@cuda.jit(device=True)
def is_last_block(state):
    """Tell one thread of each block whether all other blocks are done."""
    cuda.threadfence()
    done = cuda.atomic.add(state, TICKET, 1)
    return done == cuda.gridDim.x * cuda.gridDim.y - 1


@cuda.jit(device=True)
def raised(state, which):
    """Return the largest number that blocks have raised a slot to, and blank it."""
    return np.float64(float_of(cuda.atomic.exch(state, which, 0)))


@cuda_kernel
def take_in(
    state, now, waiting, storage, ny, nx, wide, dry, w_out, remainder_out, film_out, partial_out
):  # fmt: skip
    """Give the waiting drops to the film and the water of their cells.

    The other cells have had theirs in the last step of the frame before.

    state, now. See the module's constants.
    waiting : int64 device array (cells,). Depth of drops, in UNIT; blanked.
    storage : float32 device array (cells,) [m]
    ny, nx : int. Cells with their ghosts.
    wide : int. Floats from one row of a map to the next, see `pitch`; a map has
        ny + 1 rows.
    dry : float [m]
    w_out : float32 device array (2 * 3 * cells,). Both copies of depth [m] and
        face velocities [m/s].
    remainder_out, film_out : float32 device array (cells,) [m]
    partial_out : float64 device array (PARTIAL, blocks)
    """
    if now[ADDED] == 0.0:
        return
    room = cuda.shared.array(SQUARE, np.float64)
    i = cuda.blockIdx.x * SIDE + cuda.threadIdx.x + PAD
    first = (cuda.blockIdx.y * HEIGHT + cuda.threadIdx.y) * STRIPE + PAD
    total = 0.0
    for j in range(first, min(first + STRIPE, ny - PAD)):
        at = j * wide + i + LEAD
        if i >= nx - PAD or waiting[at] == 0:
            continue
        drops = np.float64(waiting[at])
        waiting[at] = 0
        total += drops
        here = state[PARITY] * 3 * (ny + 1) * wide + at
        free = np.float64(remainder_out[at] + np.float32(drops * UNIT)) + np.float64(w_out[here])
        film = np.float64(film_out[at])
        _, _, held = infiltrate_and_fill(free, film, 0.0, np.float64(storage[at]))
        film_out[at] = film + held
        free -= np.float64(film_out[at]) - film
        value = np.float32(free) if free >= dry else ZERO
        remainder_out[at] = free - np.float64(value)
        w_out[here] = value
    block = cuda.blockIdx.y * cuda.gridDim.x + cuda.blockIdx.x
    lane = cuda.threadIdx.y * SIDE + cuda.threadIdx.x
    total = block_sum(room, lane, total)
    if lane == 0:
        partial_out[P_DROPPED, block] += total


@cuda.jit(device=True)
def _fall(here, level, there, bed_there):
    """Return how far water may fall between two cells [m]."""
    drop = level - (bed_there + there)
    fall = drop if here > ZERO else ZERO
    return max(fall, -drop) if there > ZERO else fall


@cuda_kernel
def refresh(control, state, now, numbers, w, bed, ny, nx, wide):
    """Begin a frame: measure the maxima that set the first step and the cap, and plan that step.

    control, state, now, numbers. See the module's constants; the first two are
        modified.
    w : float32 device array (2 * 3 * cells,). Both copies of depth [m] and face
        velocities [m/s].
    bed : float32 device array (cells,) [m]
    ny, nx, wide : int. Cells with their ghosts, and from row to row.
    """
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
        h = w[state[PARITY] * 3 * plane :]
        u, v, lowest = h[plane:], h[2 * plane :], np.float32(numbers[FLOOR])
        at = np.uint64(first * wide + i + LEAD)
        here, floor, has_east = h[at], bed[at], i + 1 < nx - PAD
        swift = abs(v[at])
        for j in range(first, min(first + STRIPE, ny - PAD)):
            level, below = floor + here, here
            deepest = max(deepest, here)
            if here > ZERO:
                highest = max(highest, level - lowest)
            if has_east:
                fall = max(fall, _fall(here, level, h[at + NEXT], bed[at + NEXT]))
            swift = max(swift, max(abs(u[at]), abs(u[at + NEXT])))
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
    if lane > 0:
        return
    cuda.atomic.max(state, SWIFT, tops[0])
    cuda.atomic.max(state, DEEPEST, tops[1])
    cuda.atomic.max(state, FALL, tops[2])
    cuda.atomic.max(state, HIGHEST, tops[3])
    if not is_last_block(state):
        return
    state[TICKET] = 0
    swift, deepest = raised(state, SWIFT), raised(state, DEEPEST)
    fall, highest = raised(state, FALL), raised(state, HIGHEST)
    gravity, reach = numbers[GRAVITY], control[REACH_NOW]
    if now[ADDED] != 0.0:
        reach = swift + math.sqrt(gravity * max(deepest, fall))
        control[REACH_NOW], control[SWIFT_NOW] = reach, swift
        state[SETTLED] = 0
    else:
        swift = control[SWIFT_NOW]
    raise_cap(control, gravity, deepest, highest)
    control[LEFT] += now[DURATION]
    state[SUBSTEPS] = 0
    plan(control, state, known(control, state, now, numbers), reach, swift)


@cuda_kernel
def close(control, state, blocks, whole, partial_out):
    """Bring the account up to date at a frame's end; a block for each of the sums.

    control, state. See the module's constants; `control` is modified.
    blocks : int. Number of sums in each row of `partial_out`.
    whole : float [m]. Depth that a flux of 1 m2/s leaves in a cell in a second: 1
        / spacing, summed over time.
    partial_out : float64 device array (PARTIAL, blocks). Blanked.
    """
    room = cuda.shared.array(CLOSERS, np.float64)
    lane, which = cuda.threadIdx.x, cuda.blockIdx.x
    total = 0.0
    for block in range(lane, blocks, CLOSERS):
        total += partial_out[which, block]
        if which < P_GROUND:
            partial_out[which, block] = 0.0
    total = block_sum(room, lane, total)
    if lane > 0:
        return
    if which == P_OUT:
        control[OUTFLOW] += total * whole
        if state[RUNS] == 1 and control[LEFT] == 0.0:
            control[LEFT] = PLANNED
    elif which == P_DROPPED:
        control[DROPPED] += total * UNIT
    elif which == P_DRUNK:
        control[INFILTRATED] += total
    elif which == P_DRAINED:
        control[DRAINED] += total
    elif state[LAST] == 1:
        control[GROUND if which == P_GROUND else FILM] = total
