"""The scheme "paper": the step of the RainyGS supplement, with dry faces that block.

Depth sits at cell centres (j, i), u at the west faces (j, i) of the cells, v at their south faces;
row 0 is south. The step from n to n+1 is

    u*      = u at the foot of the back-trace along (u, v) at n             (`flow`)
    h at n+1 = h - dt div(h u), h from the upwind cell, u at n              (`flow`)
    u at n+1 = u* - dt g grad(bed + h at n+1), then friction          (`accelerate_rough`)
    dry faces take the mean of their wet neighbours                         (`extrapolate`)

Kernels take arrays of one floating type and scalars of the same type. Their inner loops count from
0 and look forward (left, left + 1): where the compiler cannot see that an index like i - 1 is not
negative, it allows for indices from the end, and the loop runs 3 to 9 times slower.

References
----------
RainyGS, CVPR 2025, supplement, "Details of Rain Simulation on Height Maps"; after Chentanez and
Mueller 2010, "Real-time simulation of large bodies of water with small scale details". We differ:

- A face to a dry cell whose bed stands above the neighbour's water is closed. Their pressure term
  drives water out of a lake at rest there.
- Depths under `dry` (1e-6 m) do not flow, as in their clamp, but the water is kept (`remainder`),
  not deleted: 2.5 mm/h brings 1e-8 m in a step, so their clamp would delete all rain on dry ground.
- `remainder` also keeps the part of a depth that h cannot represent, so volume is conserved to
  float64 rounding in float32.
- The step is short enough that no cell gives more than it holds: no depth needs a repair.
- Differences of level within rounding do not push, so a lake at rest is exactly at rest.
- Manning friction, which they leave out, is offered.
"""

import numpy as np

from rainsim.constants import FOUR, ONE, QUARTER, TWO, ZERO
from rainsim.jit import cpu_kernel, inlined_function, prange
from rainsim.numerics.approximations import cube_root
from rainsim.water.bundles import Ground, StepNumbers

# Exact in every floating type, so kernels stay generic.
TINY = np.float32(2.0**-60)  # m/s, keeps 0 / 0 out of still faces

BLOCK = 16  # rows that one thread takes at a time, whatever the number of threads


@inlined_function
def sample(a, shift_x, shift_y, j, below, above, i, left, right):
    """Interpolate `a` bilinearly at (j + shift_y, i + shift_x), both shifts within one cell.

    The rows `below`, `above` and columns `left`, `right` are the neighbours of (j, i), or j and i
    themselves at an edge.
    """
    east, west = max(shift_x, ZERO), max(-shift_x, ZERO)
    north, south = max(shift_y, ZERO), max(-shift_y, ZERO)
    centre = ONE - east - west
    row = centre * a[j, i] + east * a[j, right] + west * a[j, left]
    row_above = centre * a[above, i] + east * a[above, right] + west * a[above, left]
    row_below = centre * a[below, i] + east * a[below, right] + west * a[below, left]
    return (ONE - north - south) * row + north * row_above + south * row_below


@inlined_function
def upwind_flux(speed, h_behind, h_ahead):
    """Flux through a face [m2/s] in float64, where the product of two float32 is exact."""
    return np.float64(speed) * np.float64(h_behind if speed > ZERO else h_ahead)


@inlined_function
def split_depth(j, i, total, dry, h_out, remainder_out):
    """Store depth `total` as flowing water and a remainder too little to flow or to represent."""
    h_out[j, i] = total if total >= dry else 0.0
    remainder_out[j, i] = total - np.float64(h_out[j, i])


@inlined_function
def move_depth(h, u, v, k, dry, j, below, above, i, left, right, h_out, remainder_out):
    """Update one cell's depth with the flux through its four faces; k = dt / spacing."""
    east = upwind_flux(u[j, i + 1], h[j, i], h[j, right])
    west = upwind_flux(u[j, i], h[j, left], h[j, i])
    north = upwind_flux(v[j + 1, i], h[j, i], h[above, i])
    south = upwind_flux(v[j, i], h[below, i], h[j, i])
    total = np.float64(h[j, i]) + np.float64(remainder_out[j, i])
    total -= np.float64(k) * ((east - west) + (north - south))
    split_depth(j, i, total, dry, h_out, remainder_out)


@inlined_function
def carry_u(u, v, k, j, below, above, left):
    """Back-trace the face between the cells `left` and left + 1 of row j; return u at its foot."""
    i = left + 1
    across = v[j, left] + v[j, i] + v[j + 1, left] + v[j + 1, i]
    shift_x, shift_y = -k * u[j, i], -k * QUARTER * across
    return sample(u, shift_x, shift_y, j, below, above, i, left, i + 1)


@inlined_function
def carry_v(u, v, k, j, i, left, right):
    """Back-trace the south face (j, i) and return v at its foot; j is an inner row of faces."""
    across = u[j - 1, i] + u[j, i] + u[j - 1, i + 1] + u[j, i + 1]
    return sample(v, -k * QUARTER * across, -k * v[j, i], j, j - 1, j + 1, i, left, right)


@cpu_kernel
def flow(h, u, v, k, dry, remainder_out, h_out, u_out, v_out):
    """Carry velocity (semi-Lagrangian) and depth (upwind flux form) over one step.

    k : float [s/m]. dt / spacing, with k |u| at most 1/4.
    remainder_out : array (ny, nx) [m]. Depth beside `h` in the cell, read and
        rewritten.
    """
    ny, nx = h.shape
    for j in prange(ny):
        below, above = max(j - 1, 0), min(j + 1, ny - 1)
        for left in range(nx - 1):
            u_out[j, left + 1] = carry_u(u, v, k, j, below, above, left)
        if j > 0:
            v_out[j, 0] = carry_v(u, v, k, j, 0, 0, 1)
            for left in range(nx - 2):
                v_out[j, left + 1] = carry_v(u, v, k, j, left + 1, left, left + 2)
            v_out[j, nx - 1] = carry_v(u, v, k, j, nx - 1, nx - 2, nx - 1)
        move_depth(h, u, v, k, dry, j, below, above, 0, 0, 1, h_out, remainder_out)
        for left in range(nx - 2):
            move_depth(
                h, u, v, k, dry, j, below, above, left + 1, left, left + 2, h_out, remainder_out
            )
        move_depth(h, u, v, k, dry, j, below, above, nx - 1, nx - 2, nx - 1, h_out, remainder_out)


@inlined_function
def accelerated(speed, h_a, h_b, bed_a, bed_b, numbers):
    """Face velocity after pressure; zero where the face is closed.

    A face is closed between two dry cells, and to a dry cell over whose bed the other cell's level
    does not stand by `numbers.dry`. Level differences and speeds within rounding count as none.
    Written without branches, so that the compiler can take many faces at once.
    """
    kg, cap, dry = numbers.kg, numbers.cap, numbers.dry
    level_a, level_b = bed_a + h_a, bed_b + h_b
    rise = level_b - level_a
    noise = numbers.rounding * (h_a + h_b + abs(bed_a) + abs(bed_b))
    level = abs(rise) <= noise
    w = speed - kg * (ZERO if level else rise)
    closed = (h_a <= ZERO) & ((h_b <= ZERO) | (bed_a + dry >= level_b))
    closed |= (h_b <= ZERO) & (bed_b + dry >= level_a)
    closed |= level & (abs(w) <= kg * noise)
    return ZERO * w if closed else min(max(w, -cap), cap)


@inlined_function
def slowed(speed, along, h_a, h_b, bed_a, bed_b, drag, dry):
    """Face velocity after Manning friction over one step, implicit in the velocity.

    Solves w (1 + c sqrt(w^2 + t^2)) = speed, c = drag / h^(4/3), drag = dt g n^2, where t is the
    velocity `along` the face. Starting from the root for t = 0, which lies above the wanted one,
    two Newton steps leave 1e-4 of w.
    """
    depth = max(max(bed_a + h_a, bed_b + h_b) - max(bed_a, bed_b), dry)
    c = drag / (depth * cube_root(depth))
    wanted = abs(speed)
    w = TWO * wanted / (ONE + np.sqrt(ONE + FOUR * c * wanted))
    for _ in range(2):
        whole = max(np.sqrt(w * w + along * along), TINY)
        excess = w + c * w * whole - wanted
        w -= excess * whole / (whole + c * (whole * whole + w * w))
    return w if speed > ZERO else -w


@inlined_function
def fastest_signal(speed, h_a, h_b, gravity):
    """Speed that the time step must follow: a wave's, or twice the flow's if that is more.

    With k times this under 1/2, four outward faces take no more than a cell holds.
    """
    return abs(speed) + max(np.sqrt(gravity * max(h_a, h_b)), abs(speed))


@cpu_kernel
def accelerate_rough(
    h, ground: Ground, u, v, drag, numbers: StepNumbers, u_out, v_out, signal_out
):  # fmt: skip
    """Apply pressure and Manning friction to all inner faces.

    u, v : array (ny, nx + 1) and (ny + 1, nx) [m/s]. Velocity at n, from which
        the flow along a face is taken.
    numbers : StepNumbers. `cap` is the speed that no face may exceed, as in
        Chentanez and Mueller 2010; `dry` is also the least depth that friction
        sees.
    signal_out : array (blocks, nx) [m/s]. Largest `fastest_signal` in each column
        of each block of BLOCK rows. A maximum over a row would keep the compiler
        from taking many faces at once.
    """
    (bed, roughness), gravity, dry = ground, numbers.gravity, numbers.dry
    ny, nx = h.shape
    for block in prange(signal_out.shape[0]):
        signal_out[block] = ZERO
        for j in range(block * BLOCK, min((block + 1) * BLOCK, ny)):
            for left in range(nx - 1):
                i = left + 1
                h_a, h_b, bed_a, bed_b = h[j, left], h[j, i], bed[j, left], bed[j, i]
                w = accelerated(u_out[j, i], h_a, h_b, bed_a, bed_b, numbers)
                along = QUARTER * (v[j, left] + v[j, i] + v[j + 1, left] + v[j + 1, i])
                c = drag * max(roughness[j, left], roughness[j, i])
                w = slowed(w, along, h_a, h_b, bed_a, bed_b, c, dry)
                u_out[j, i] = w
                signal_out[block, i] = max(
                    signal_out[block, i], fastest_signal(w, h_a, h_b, gravity)
                )
            if j == 0:
                continue
            for i in range(nx):
                h_a, h_b, bed_a, bed_b = h[j - 1, i], h[j, i], bed[j - 1, i], bed[j, i]
                w = accelerated(v_out[j, i], h_a, h_b, bed_a, bed_b, numbers)
                along = QUARTER * (u[j - 1, i] + u[j, i] + u[j - 1, i + 1] + u[j, i + 1])
                c = drag * max(roughness[j - 1, i], roughness[j, i])
                w = slowed(w, along, h_a, h_b, bed_a, bed_b, c, dry)
                v_out[j, i] = w
                signal_out[block, i] = max(
                    signal_out[block, i], fastest_signal(w, h_a, h_b, gravity)
                )


@inlined_function
def extended(speed, h_a, h_b, h_0, h_1, h_2, h_3, u_0, u_1, u_2, u_3):
    """Return `speed`, at a dry face (h_a, h_b) the mean of those neighbours u_0.. that are wet.

    `h_0` .. are the largest depths at the neighbours, apart from the face's own cells.
    """
    a, b = ONE if h_0 > ZERO else ZERO, ONE if h_1 > ZERO else ZERO
    c, d = ONE if h_2 > ZERO else ZERO, ONE if h_3 > ZERO else ZERO
    mean = (a * u_0 + b * u_1 + c * u_2 + d * u_3) / max(a + b + c + d, ONE)
    return mean if (h_a <= ZERO) & (h_b <= ZERO) else speed


@inlined_function
def extend_u(h, u, j, below, above, left, west, east):
    """`extended` for the face between the cells `left` and left + 1 of row j.

    `west`, `east` are the columns beyond its cells. Off the map, rows and columns are the face's
    own, which are dry when they matter.
    """
    i = left + 1
    return extended(
        u[j, i], h[j, left], h[j, i], h[j, west], h[j, east],
        max(h[below, left], h[below, i]), max(h[above, left], h[above, i]),
        u[j, left], u[j, i + 1], u[below, i], u[above, i],
    )  # fmt: skip


@inlined_function
def extend_v(h, v, j, south, north, i, left, right):
    """`extended` for the south face (j, i); `south`, `north` are the rows beyond its cells."""
    return extended(
        v[j, i], h[j - 1, i], h[j, i], h[south, i], h[north, i],
        max(h[j - 1, left], h[j, left]), max(h[j - 1, right], h[j, right]),
        v[j - 1, i], v[j + 1, i], v[j, left], v[j, right],
    )  # fmt: skip


@cpu_kernel
def extrapolate(h, u, v, u_out, v_out):
    """Copy the velocity; each dry inner face gets the mean of those neighbours that touch water.

    Edge faces are left alone.
    """
    ny, nx = h.shape
    for j in prange(ny):
        below, above = max(j - 1, 0), min(j + 1, ny - 1)
        u_out[j, 1] = extend_u(h, u, j, below, above, 0, 0, min(2, nx - 1))
        for west in range(nx - 3):
            u_out[j, west + 2] = extend_u(h, u, j, below, above, west + 1, west, west + 3)
        if nx > 2:
            u_out[j, nx - 1] = extend_u(h, u, j, below, above, nx - 2, nx - 3, nx - 1)
        if j > 0:
            south = max(j - 2, 0)
            v_out[j, 0] = extend_v(h, v, j, south, above, 0, 0, 1)
            for left in range(nx - 2):
                v_out[j, left + 1] = extend_v(h, v, j, south, above, left + 1, left, left + 2)
            v_out[j, nx - 1] = extend_v(h, v, j, south, above, nx - 1, nx - 2, nx - 1)
