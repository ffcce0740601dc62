"""The schemes "accurate" and "lean": formulas and kernels that conserve volume and momentum.

Depth h sits at cell centres (j, i), u at the west faces (j, i) of the cells, v at their south
faces; row 0 is south. All arrays have PAD rings of ghost cells, so the first cell is (PAD, PAD) and
no formula knows an edge. Depth is known at whole steps n, velocity at half steps. In one step

    q at n+1/2  = u h*,    h* from the upwind cell with a limited slope     (`volume_flux`)
    h at n+1    = h - dt div q                                              (`move_depth`)
    hu at n+3/2 = hu - dt div(q u*) - dt g h grad(bed + h), u* as h*        (`accelerate`)

The momentum of a face is that of half of each of its two cells, so the volume flux that carries it
is the mean of the neighbouring q, and what `div(q u*)` takes from one face it gives to the next.

References
----------
Stelling and Duinmeijer 2003, Int. J. Numer. Meth. Fluids 43, eq. (9) to (16): momentum flux of a
staggered cell, upwind depth. We differ: theirs and the usual second-order form of it takes slopes
in the advective form u du/dx, which does not conserve momentum and moves bores at a wrong speed;
here the slopes are in the flux. Slopes are van Leer's (1974).

"accurate" changes the pressure so that linear waves are fourth order in space and time at once:
grad eta becomes grad(eta - (1 - C^2)/12 d_xx eta + C^2/12 d_yy eta), C = dt sqrt(g h) / spacing,
which cancels the leading errors of the staggered leapfrog. It fades where the surface is not smooth
against the depth and where a neighbour is nearly dry.
"""

import numpy as np

from rainsim import jit
from rainsim.constants import HALF, ONE, THREE, TWO, ZERO
from rainsim.jit import prange
from rainsim.water.bundles import Flux, StepNumbers, Water
from rainsim.water.rows import ROOM, copy_row, stack_row, tile_maxima

# Exact in every floating type, so kernels stay generic.
TWELVE = np.float32(12)

PAD = 2  # ghost cells on each side: what a slope beside an edge reaches for

# The third difference of the surface over the depth: the fourth-order term is whole below
# SMOOTH_END - 1 / FADE, and gone above SMOOTH_END. Waves stay far below, bores far above.
SMOOTH_END = np.float32(0.1875)
FADE = np.float32(8)


@jit.device_function
def limited_slope(behind, ahead):
    """Return van Leer's slope from the differences on both sides: 0 where they disagree."""
    product = behind * ahead
    return TWO * product / (behind + ahead) if product > ZERO else ZERO


@jit.device_function
def upwind_value(flow, a_0, a_1, a_2, a_3):
    """Value that `flow` carries from a_1 to a_2 (or back), with a limited slope."""
    east = flow > ZERO
    centre, behind, ahead = (a_1, a_0, a_2) if east else (a_2, a_3, a_1)
    return centre + HALF * limited_slope(centre - behind, ahead - centre)


@jit.device_function
def face_flux(speed, h_0, h_1, h_2, h_3, bed_1, bed_2):
    """Volume flux [m2/s] through the face between the cells 1 and 2.

    The depth is the upwind cell's with a limited slope. Against a step in the bed it is only what
    stands above the step. At `speed` * dt under a quarter of a cell, what four faces take is never
    more than the cell holds: a slope adds to one face at most the depth of the cell.
    """
    east = speed > ZERO
    centre, behind, ahead = (h_1, h_0, h_2) if east else (h_2, h_3, h_1)
    step = (bed_2 - bed_1) if east else (bed_1 - bed_2)
    sloped = centre + HALF * limited_slope(centre - behind, ahead - centre)
    over = min(max(centre - max(step, ZERO), ZERO), centre)
    smooth = (centre > ZERO) & (ahead > ZERO) & (step < HALF * centre)
    return speed * (sloped if smooth else over)


@jit.device_function
def fourth_order(square, h_mean, share, h_least, third, cross):
    """Correction to a surface difference that makes waves fourth order.

    `square` is C^2, `share` one over `h_mean`, `third` the third difference of the surface across
    the face, `cross` the difference across the face of the second difference along it.
    """
    change = ((square - ONE) * third + square * cross) / TWELVE
    fade = min(max((SMOOTH_END - abs(third) * share) * FADE, ZERO), ONE)
    return fade * change if h_least > HALF * h_mean else ZERO


@jit.device_function
def shoreline_velocity(h_a, h_b, bed_0, bed_a, bed_b, bed_3, behind, ahead):
    """Velocity of a closed face: that of the water beside it where the bed rises on evenly.

    The waterline lies inside the wet cell and moves with the water. If the face were at rest there,
    an advancing front would start from rest in every cell, and a receding one drag resting water.
    """
    rise = bed_b - bed_a
    runs_up = (h_a > ZERO) & (h_b <= ZERO) & (rise <= TWO * abs(bed_a - bed_0))
    runs_down = (h_b > ZERO) & (h_a <= ZERO) & (-rise <= TWO * abs(bed_3 - bed_b))
    return behind if runs_up else (ahead if runs_down else ZERO)


@jit.device_function
def depth_over_step(h_a, h_b, step):
    """Height of the water above the higher bed of two cells; b's is `step` above a's."""
    return max(h_a - max(step, ZERO), h_b + min(step, ZERO))


@jit.device_function
def accelerated(w, h_a, h_b, bed_a, bed_b, extra, gain, still, step):
    """Face velocity after transport and pressure; `still` where the face is closed.

    `extra` adds to the surface difference; `gain` is the momentum, less `w` times the volume, that
    leaves the face's own cell per k, over its depth. A face is closed where the water stands by
    less than `step.dry` above the higher bed. Water that a surface difference within rounding could
    have moved is at rest. No branches, so that the compiler can take many faces at once.
    """
    bed_step = bed_b - bed_a
    rise = bed_step + (h_b - h_a) + extra
    noise = step.rounding * (h_a + h_b + abs(bed_a) + abs(bed_b))
    speed = w - step.k * gain - step.kg * rise
    rests = (abs(rise) <= noise) & (abs(speed) <= TWO * step.kg * noise)
    speed = still if depth_over_step(h_a, h_b, bed_step) < step.dry else speed
    return ZERO if rests else min(max(speed, -step.cap), step.cap)


@jit.device_function
def wave_speed(speed, h_a, h_b, gravity):
    """Speed of the fastest wave at a face."""
    return abs(speed) + np.sqrt(gravity * max(h_a, h_b))


@jit.cpu_kernel
def volume_flux(tiles, h, bed, u, v, qu_out, qv_out):
    """Volume flux through the west and south faces of the cells of `tiles`, and the map's edges.

    tiles : int64 array (tiles, 4). First and last row + 1, first and last column
        + 1 of each tile.
    h, bed : array (ny + 4, nx + 4) [m]. Flowing depth at n and the height on
        which it flows.
    u, v : array (ny + 4, nx + 5) and (ny + 5, nx + 4) [m/s]. Face velocities at
        n+1/2.
    """
    ny, nx = h.shape
    for n in prange(tiles.shape[0]):
        south, north, west, east = tiles[n, 0], tiles[n, 1], tiles[n, 2], tiles[n, 3]
        last = east + (1 if east == nx - PAD else 0)
        for j in range(south, north):
            w, q_out = u[j, west:last], qu_out[j, west:last]
            d, b = h[j, west - 2 : last + 1], bed[j, west - 2 : last + 1]
            for c in range(last - west):
                q_out[c] = face_flux(w[c], d[c], d[c + 1], d[c + 2], d[c + 3], b[c + 1], b[c + 2])
        top = north + (1 if north == ny - PAD else 0)
        for j in range(south, top):
            w, q_out = v[j, west:east], qv_out[j, west:east]
            d_0, d_1 = h[j - 2, west:east], h[j - 1, west:east]
            d_2, d_3 = h[j, west:east], h[j + 1, west:east]
            b_1, b_2 = bed[j - 1, west:east], bed[j, west:east]
            for c in range(east - west):
                q_out[c] = face_flux(w[c], d_0[c], d_1[c], d_2[c], d_3[c], b_1[c], b_2[c])


@jit.cpu_kernel
def move_depth(tiles, qu, qv, k, dry, h_out, remainder_out):
    """Change the depth by the flow through the four faces; k = dt / spacing.

    The sums are float64, where those of float32 are exact, and what `h` cannot represent or is
    too little to flow stays in `remainder`: volume is conserved to float64 rounding.
    """
    for n in prange(tiles.shape[0]):
        south, north, west, east = tiles[n, 0], tiles[n, 1], tiles[n, 2], tiles[n, 3]
        for j in range(south, north):
            q_x, q_s = qu[j, west : east + 1], qv[j, west:east]
            q_n, d, extra = qv[j + 1, west:east], h_out[j, west:east], remainder_out[j, west:east]
            for c in range(east - west):
                out = np.float64(q_x[c + 1]) - np.float64(q_x[c])
                out += np.float64(q_n[c]) - np.float64(q_s[c])
                total = np.float64(d[c]) + np.float64(extra[c]) - k * out
                d[c] = total if total >= dry else 0.0
                extra[c] = total - np.float64(d[c])


@jit.inlined_function
def momentum_flux_along(q, a, n, flux_out):
    """Write the momentum fluxes [m3/s2] at n places within a row of velocities.

    Flux c is what the mean of the volume fluxes q[c] and q[c + 1] [m2/s] carries from a[c + 1] to
    a[c + 2] [m/s], see `upwind_value`.
    """
    for c in range(n):
        flow = HALF * (q[c] + q[c + 1])
        flux_out[c] = flow * upwind_value(flow, a[c], a[c + 1], a[c + 2], a[c + 3])


@jit.inlined_function
def momentum_flux_across(q_0, q_1, a_0, a_1, a_2, a_3, n, flux_out):
    """Write the momentum fluxes [m3/s2] at n places between two rows of velocities.

    Flux c is what the mean of the volume fluxes q_0[c] and q_1[c] [m2/s] carries from a_1[c] to
    a_2[c] [m/s]; a_0 and a_3 lie behind and ahead of them, see `upwind_value`.
    """
    for c in range(n):
        flow = HALF * (q_0[c] + q_1[c])
        flux_out[c] = flow * upwind_value(flow, a_0[c], a_1[c], a_2[c], a_3[c])


@jit.inlined_function
def level_row(h, bed, n, level_out):
    """Levels of n cells of a row."""
    for c in range(n):
        level_out[c] = bed[c] + h[c]


# long: its loops run in vectors only over rows on the stack of one loop (`rainsim.water.rows`)
@jit.lean_function
def accelerate_run(
    run, tiles, water: Water, bed, flux: Flux, step: StepNumbers,
    u_out, v_out, wave_speed_out, speed_out,
):  # fmt: skip
    """Carry momentum and apply pressure in one run of tiles; see `accelerate`."""
    h, remainder, u, v = water
    qu, qv = flux
    wave, gravity, dry = step.wave, step.gravity, step.dry
    south, north, west, east = run[0], run[1], run[2], run[3]
    below, above, across = stack_row(h, ROOM), stack_row(h, ROOM), stack_row(h, ROOM)
    low, high = stack_row(h, ROOM), stack_row(h, ROOM)
    eta_ss, eta_s, eta, eta_n = (
        stack_row(h, ROOM), stack_row(h, ROOM), stack_row(h, ROOM), stack_row(h, ROOM)
    )  # fmt: skip
    new_u, new_v = stack_row(h, ROOM), stack_row(h, ROOM)
    far, fast = stack_row(h, ROOM), stack_row(h, ROOM)
    n, a, z = east - west, west - 1, west - 2
    for c in range(n):
        far[c], fast[c] = ZERO, ZERO
    j = south
    momentum_flux_across(
        qv[j, a : east - 1], qv[j, west:east], u[j - 2, west:east], u[j - 1, west:east],
        u[j, west:east], u[j + 1, west:east], n, below,
    )  # fmt: skip
    momentum_flux_across(
        qv[j - 1, west:east], qv[j, west:east], v[j - 2, west:east], v[j - 1, west:east],
        v[j, west:east], v[j + 1, west:east], n, low,
    )  # fmt: skip
    level_row(h[j - 2, z : east + 1], bed[j - 2, z : east + 1], n + 3, eta_ss)
    level_row(h[j - 1, z : east + 1], bed[j - 1, z : east + 1], n + 3, eta_s)
    level_row(h[j, z : east + 1], bed[j, z : east + 1], n + 3, eta)
    for j in range(south, north):
        level_row(h[j + 1, z : east + 1], bed[j + 1, z : east + 1], n + 3, eta_n)
        d_ss, d_s = h[j - 2, west:east], h[j - 1, a : east + 1]
        d, d_n = h[j, z : east + 1], h[j + 1, a:east]
        b_ss, b_s, b_n = bed[j - 2, west:east], bed[j - 1, west:east], bed[j + 1, west:east]
        b, e, e_s = bed[j, z : east + 1], remainder[j, a:east], remainder[j - 1, west:east]
        q, q_below = qu[j, a : east + 1], qu[j - 1, west : east + 1]
        p_s, p, p_n = qv[j - 1, west:east], qv[j, a:east], qv[j + 1, a:east]
        w, x_s, x, x_n = (
            u[j, a : east + 1],
            v[j - 1, west:east],
            v[j, west:east],
            v[j + 1, west:east],
        )

        momentum_flux_across(
            p_n, p_n[1:], u[j - 1, west:east], u[j, west:east], u[j + 1, west:east],
            u[j + 2, west:east], n, above,
        )  # fmt: skip
        momentum_flux_along(q, u[j, z : east + 2], n + 1, across)
        for c in range(n):
            h_a, h_b, bed_a, bed_b = d[c + 1], d[c + 2], b[c + 1], b[c + 2]
            rise = eta[c + 2] - eta[c + 1]
            third = (eta[c + 3] - eta[c]) - THREE * rise
            cross = (eta_n[c + 2] - eta_n[c + 1]) + (eta_s[c + 2] - eta_s[c + 1]) - TWO * rise
            least = min(min(d[c], d[c + 3]), min(d_s[c], d_s[c + 1]))
            least = min(min(least, min(d_n[c], d_n[c + 1])), min(h_a, h_b))
            mean = HALF * (h_a + h_b)
            share = ONE / max(mean, HALF * dry)
            extra = e[c + 1] - e[c] + fourth_order(wave * mean, mean, share, least, third, cross)
            momentum = across[c + 1] - across[c] + above[c] - below[c]
            volume = q[c + 2] - q[c] + p_n[c] + p_n[c + 1] - p[c] - p[c + 1]
            gain = share * (momentum - HALF * w[c + 1] * volume)
            still = shoreline_velocity(h_a, h_b, b[c], bed_a, bed_b, b[c + 3], w[c], w[c + 2])
            new_u[c] = accelerated(w[c + 1], h_a, h_b, bed_a, bed_b, extra, gain, still, step)
        copy_row(new_u, n, u_out[j, west:east])

        momentum_flux_across(p[1:], p_n[1:], x_s, x, x_n, v[j + 2, west:east], n, high)
        momentum_flux_across(
            q_below, q[1:], v[j, z : east - 1], v[j, a:east], v[j, west : east + 1],
            v[j, west + 1 : east + 2], n + 1, across,
        )  # fmt: skip
        for c in range(n):
            h_a, h_b, bed_a, bed_b = d_s[c + 1], d[c + 2], b_s[c], b[c + 2]
            rise = eta[c + 2] - eta_s[c + 2]
            third = (eta_n[c + 2] - eta_ss[c + 2]) - THREE * rise
            cross = (eta[c + 3] - eta_s[c + 3]) + (eta[c + 1] - eta_s[c + 1]) - TWO * rise
            least = min(min(d_ss[c], d_n[c + 1]), min(d_s[c], d[c + 1]))
            least = min(min(least, min(d_s[c + 2], d[c + 3])), min(h_a, h_b))
            mean = HALF * (h_a + h_b)
            share = ONE / max(mean, HALF * dry)
            extra = e[c + 1] - e_s[c] + fourth_order(wave * mean, mean, share, least, third, cross)
            momentum = across[c + 1] - across[c] + high[c] - low[c]
            volume = p_n[c + 1] - p_s[c] + q_below[c + 1] + q[c + 2] - q_below[c] - q[c + 1]
            still = shoreline_velocity(h_a, h_b, b_ss[c], bed_a, bed_b, b_n[c], x_s[c], x_n[c])
            gain = share * (momentum - HALF * x[c] * volume)
            s = accelerated(x[c], h_a, h_b, bed_a, bed_b, extra, gain, still, step)
            new_v[c] = s
            fast[c] = max(fast[c], max(abs(new_u[c]), abs(s)))
            top = max(
                wave_speed(new_u[c], d[c + 1], h_b, gravity), wave_speed(s, h_a, h_b, gravity)
            )
            far[c] = max(far[c], top)
        copy_row(new_v, n, v_out[j, west:east])
        below, above = above, below
        low, high = high, low
        eta_ss, eta_s, eta, eta_n = eta_s, eta, eta_n, eta_ss
    tile_maxima(run, tiles, far, wave_speed_out)
    tile_maxima(run, tiles, fast, speed_out)


@jit.cpu_kernel
def accelerate(
    runs, tiles, water: Water, bed, flux: Flux, step: StepNumbers,
    u_out, v_out, wave_speed_out, speed_out,
):  # fmt: skip
    """Carry momentum and apply pressure with the fourth-order term in the tiles of `runs`.

    water : Water. Depth at n+1 and velocity at n+1/2.
    flux : Flux. Volume flux at n+1/2, zero for a first half step.
    u_out, v_out : as u and v [m/s]. Velocity at n+3/2; edge faces are to be set
        again.
    wave_speed_out, speed_out : array (tiles,) [m/s]. Largest `wave_speed` and
        largest speed of each tile.
    """
    for t in prange(runs.shape[0]):
        accelerate_run(
            runs[t], tiles, water, bed, flux, step, u_out, v_out, wave_speed_out, speed_out
        )


@jit.serial_kernel
def fill_depth(kinds, a_out):
    """Fill the ghost cells of a cell map: mirrored at walls, as the edge cell at open edges.

    kinds : int64 array (4,). 1 where the west, east, south, north edge is open, 0
        where it is a wall.
    a_out : array (ny + 4, nx + 4)
    """
    ny, nx = a_out.shape
    for j in range(PAD, ny - PAD):
        a_out[j, 1], a_out[j, nx - 2] = a_out[j, 2], a_out[j, nx - 3]
        a_out[j, 0] = a_out[j, 2] if kinds[0] else a_out[j, 3]
        a_out[j, nx - 1] = a_out[j, nx - 3] if kinds[1] else a_out[j, nx - 4]
    for i in range(nx):
        a_out[1, i], a_out[ny - 2, i] = a_out[2, i], a_out[ny - 3, i]
        a_out[0, i] = a_out[2, i] if kinds[2] else a_out[3, i]
        a_out[ny - 1, i] = a_out[ny - 3, i] if kinds[3] else a_out[ny - 4, i]


@jit.device_function
def depth_into_edge_cell(deep, step):
    """Depth that flows into a last cell whose bed is `step` above that of its neighbour, `deep`."""
    return max(deep - max(step, ZERO), ZERO)


@jit.device_function
def speed_out(speed, here, behind, step):
    """Outward speed through an open edge.

    Water leaves at the speed that it has just inside. Over a last cell whose bed is `step` above
    its neighbour's it goes on gaining speed as it does before the edge; without that the sill holds
    whatever depth has gathered, with it the flow over it becomes critical. Water at rest stays.

    here, behind : float [m/s]. Outward, one step earlier, of that face and of the
        next one inward.
    """
    leaves = max(speed, ZERO)
    return leaves + (min(max(here - behind, ZERO), leaves) if step > ZERO else ZERO)


@jit.serial_kernel
def fill_edge_flux(kinds, h, bed, u, v, qu_out, qv_out):
    """Let only what stands above a higher last cell flow into it, towards an open edge.

    With the whole depth of its neighbour the cell would gain more than it passes on, and dam up.

    qu_out, qv_out : as u and v [m2/s]. Volume flux, in which the faces of such
        cells are changed.
    """
    ny, nx = h.shape
    for j in range(PAD, ny - PAD):
        step = bed[j, 2] - bed[j, 3]
        if kinds[0] and step > ZERO and u[j, 3] < ZERO:
            qu_out[j, 3] = u[j, 3] * depth_into_edge_cell(h[j, 3], step)
        step = bed[j, nx - 3] - bed[j, nx - 4]
        if kinds[1] and step > ZERO and u[j, nx - 3] > ZERO:
            qu_out[j, nx - 3] = u[j, nx - 3] * depth_into_edge_cell(h[j, nx - 4], step)
    for i in range(PAD, nx - PAD):
        step = bed[2, i] - bed[3, i]
        if kinds[2] and step > ZERO and v[3, i] < ZERO:
            qv_out[3, i] = v[3, i] * depth_into_edge_cell(h[3, i], step)
        step = bed[ny - 3, i] - bed[ny - 4, i]
        if kinds[3] and step > ZERO and v[ny - 3, i] > ZERO:
            qv_out[ny - 3, i] = v[ny - 3, i] * depth_into_edge_cell(h[ny - 4, i], step)


@jit.serial_kernel
def fill_velocity(kinds, bed, u, v, u_out, v_out):
    """Set the velocity of the edge faces and of the ghost faces beyond them.

    Nothing crosses a wall, and beyond it the flow is mirrored. Water leaves through an open edge as
    `speed_out` says; none comes in. `u` and `v` are the velocity one step earlier.
    """
    ny, nx = v_out.shape[0] - 1, u_out.shape[1] - 1
    for j in range(PAD, ny - PAD):
        step = bed[j, 2] - bed[j, 3]
        west = -speed_out(-u_out[j, 3], -u[j, 3], -u[j, 4], step)
        step = bed[j, nx - 3] - bed[j, nx - 4]
        east = speed_out(u_out[j, nx - 3], u[j, nx - 3], u[j, nx - 4], step)
        u_out[j, 2] = west if kinds[0] else ZERO
        u_out[j, nx - 2] = east if kinds[1] else ZERO
        u_out[j, 1] = u_out[j, 2] if kinds[0] else -u_out[j, 3]
        u_out[j, nx - 1] = u_out[j, nx - 2] if kinds[1] else -u_out[j, nx - 3]
        u_out[j, 0], u_out[j, nx] = u_out[j, 1], u_out[j, nx - 1]
    for i in range(PAD, nx - PAD):
        step = bed[2, i] - bed[3, i]
        south = -speed_out(-v_out[3, i], -v[3, i], -v[4, i], step)
        step = bed[ny - 3, i] - bed[ny - 4, i]
        north = speed_out(v_out[ny - 3, i], v[ny - 3, i], v[ny - 4, i], step)
        v_out[2, i] = south if kinds[2] else ZERO
        v_out[ny - 2, i] = north if kinds[3] else ZERO
        v_out[1, i] = v_out[2, i] if kinds[2] else -v_out[3, i]
        v_out[ny - 1, i] = v_out[ny - 2, i] if kinds[3] else -v_out[ny - 3, i]
        v_out[0, i], v_out[ny, i] = v_out[1, i], v_out[ny - 1, i]
    for i in range(PAD, nx - PAD + 1):  # u slides along the south and north edges
        u_out[1, i], u_out[ny - 2, i] = u_out[2, i], u_out[ny - 3, i]
        u_out[0, i], u_out[ny - 1, i] = u_out[3, i], u_out[ny - 4, i]
    for j in range(PAD, ny - PAD + 1):  # v along the west and east edges
        v_out[j, 1], v_out[j, nx - 2] = v_out[j, 2], v_out[j, nx - 3]
        v_out[j, 0], v_out[j, nx - 1] = v_out[j, 3], v_out[j, nx - 4]
