"""The scheme "lean": the first-order part of `rainsim.water.conserving`, fused into one pass.

Volume and momentum are conserved as in "accurate", but depths and velocities are carried upwind
without slopes, waves are second order, and the sums are of the fields' own type: rounding may
change the volume by some 1e-8 in a thousand steps, which the ledger's residual shows. Each value
is read and written once in a step; what a row needs of the row below waits on the stack.

With q summed over the two halves of a face's own cell, what momentum gains less what volume does is

    (h u)' - u h' = max(q_west, 0) (u - u_west) + min(q_east, 0) (u_east - u) + the same across

which is Stelling and Duinmeijer's (2003) upwind form, exactly the flux form's.
"""

from rainsim.constants import TWO, ZERO
from rainsim.jit import cpu_kernel, device_function, inlined_function, lean_function, prange
from rainsim.numerics.approximations import quotient
from rainsim.water.bundles import StepNumbers, Water
from rainsim.water.conserving import depth_over_step, wave_speed
from rainsim.water.rows import ROOM, copy_row, stack_row, tile_maxima


@device_function
def upwind_flux(speed, h_1, h_2, step):
    """Volume flux [m2/s] from cell 1 to cell 2, whose bed is higher by `step`.

    The upwind cell gives what stands above the step.
    """
    east = speed > ZERO
    depth = (h_1 if east else h_2) - max(step if east else -step, ZERO)
    return speed * max(depth, ZERO)


@device_function
def upwind_gain(w, w_west, w_east, w_south, w_north, q_west, q_east, q_south, q_north):
    """Momentum less `w` times volume that leaves the cell of a face: upwind, q doubled."""
    along = max(q_west, ZERO) * (w - w_west) + min(q_east, ZERO) * (w_east - w)
    return along + (max(q_south, ZERO) * (w - w_south) + min(q_north, ZERO) * (w_north - w))


@device_function
def accelerated(w, h_a, h_b, step, noise, gain, k, kg, cap, dry):
    """Face velocity after transport and pressure; zero where the face is closed.

    A face is closed where the water stands by no more than `dry` above the higher bed. Water that
    a surface difference within rounding (`noise`) could have moved is at rest.
    """
    rise = (h_b - h_a) + step
    turned = w - quotient(k * gain, max(h_a + h_b, dry)) - kg * rise
    rests = (abs(rise) <= noise) & (abs(turned) <= TWO * kg * noise)
    return ZERO if rests | (depth_over_step(h_a, h_b, step) <= dry) else min(max(turned, -cap), cap)


@inlined_function
def flux_row(w, d, b, n, q_out):
    """Volume fluxes [m2/s], see `upwind_flux`, through the n faces between cells c and c + 1."""
    for c in range(n):
        q_out[c] = upwind_flux(w[c], d[c], d[c + 1], b[c + 1] - b[c])


@inlined_function
def flux_rows(w, d_0, d_1, b_0, b_1, n, q_out):
    """Volume fluxes [m2/s] from row 0 to row 1 through the n faces between them."""
    for c in range(n):
        q_out[c] = upwind_flux(w[c], d_0[c], d_1[c], b_1[c] - b_0[c])


@inlined_function
def move_row(d, q_x, q_s, q_n, n, k, d_out):
    """Depths of n cells after the step; rounding must not make them negative."""
    for c in range(n):
        d_out[c] = max(d[c] - k * ((q_x[c + 1] - q_x[c]) + (q_n[c] - q_s[c])), ZERO)


# long: its loops run in vectors only over rows on the stack of one loop (`rainsim.water.rows`)
@lean_function
def step_run(
    run, tiles, water: Water, bed, numbers: StepNumbers,
    h_out, u_out, v_out, wave_speed_out, speed_out,
):  # fmt: skip
    """Advance depth and velocity of one run of tiles by a step; see `step`."""
    h, u, v = water.h, water.u, water.v
    k, kg, gravity, cap = numbers.k, numbers.kg, numbers.gravity, numbers.cap
    rounding, dry = numbers.rounding, numbers.dry
    south, north, west, east = run[0], run[1], run[2], run[3]
    q_x, q_below = stack_row(h, ROOM), stack_row(h, ROOM)
    q_ss, q_s, q_n = stack_row(h, ROOM), stack_row(h, ROOM), stack_row(h, ROOM)
    new_u, new_v = stack_row(h, ROOM), stack_row(h, ROOM)
    d, d_below = stack_row(h, ROOM), stack_row(h, ROOM)
    far, fast = stack_row(h, ROOM), stack_row(h, ROOM)
    n, a = east - west, west - 1
    for c in range(n):
        far[c], fast[c] = ZERO, ZERO
    # Rows on the stack begin at the cell west of the run: cell or face c is c + west - 1.
    j = south - 1
    flux_rows(v[j, a:east], h[j - 1, a:east], h[j, a:east], bed[j - 1, a:east],
              bed[j, a:east], n + 1, q_s)  # fmt: skip
    for j in range(south - 1, north):
        flux_row(u[j, a : east + 1], h[j, a - 1 : east + 1], bed[j, a - 1 : east + 1], n + 2,
                 q_x)  # fmt: skip
        flux_rows(v[j + 1, a:east], h[j, a:east], h[j + 1, a:east], bed[j, a:east],
                  bed[j + 1, a:east], n + 1, q_n)  # fmt: skip
        move_row(h[j, a:east], q_x, q_s, q_n, n + 1, k, d)
        if j >= south:
            u_s, u_c, u_n = u[j - 1, west:east], u[j, a : east + 1], u[j + 1, west:east]
            v_s, v_c, v_n = v[j - 1, west:east], v[j, a : east + 1], v[j + 1, west:east]
            b_c, b_s = bed[j, a:east], bed[j - 1, west:east]
            for c in range(n):
                h_c, h_w, h_s = d[c + 1], d[c], d_below[c + 1]
                w = u_c[c + 1]
                gain = upwind_gain(
                    w, u_c[c], u_c[c + 2], u_s[c], u_n[c],
                    q_x[c] + q_x[c + 1], q_x[c + 1] + q_x[c + 2],
                    q_s[c] + q_s[c + 1], q_n[c] + q_n[c + 1],
                )  # fmt: skip
                step, noise = b_c[c + 1] - b_c[c], h_w + h_c + abs(b_c[c]) + abs(b_c[c + 1])
                east_speed = accelerated(w, h_w, h_c, step, rounding * noise, gain, k, kg, cap, dry)
                w = v_c[c + 1]
                gain = upwind_gain(
                    w, v_c[c], v_c[c + 2], v_s[c], v_n[c],
                    q_below[c + 1] + q_x[c + 1], q_below[c + 2] + q_x[c + 2],
                    q_ss[c + 1] + q_s[c + 1], q_s[c + 1] + q_n[c + 1],
                )  # fmt: skip
                step, noise = b_c[c + 1] - b_s[c], h_s + h_c + abs(b_s[c]) + abs(b_c[c + 1])
                north_speed = accelerated(
                    w, h_s, h_c, step, rounding * noise, gain, k, kg, cap, dry
                )
                new_u[c], new_v[c] = east_speed, north_speed
                fast[c] = max(fast[c], max(abs(east_speed), abs(north_speed)))
                top = wave_speed(east_speed, h_w, h_c, gravity)
                far[c] = max(far[c], max(top, wave_speed(north_speed, h_s, h_c, gravity)))
            copy_row(new_u, n, u_out[j, west:east])
            copy_row(new_v, n, v_out[j, west:east])
            copy_row(d[1:], n, h_out[j, west:east])
        q_x, q_below = q_below, q_x
        d, d_below = d_below, d
        q_ss, q_s, q_n = q_s, q_n, q_ss
    tile_maxima(run, tiles, far, wave_speed_out)
    tile_maxima(run, tiles, fast, speed_out)


@cpu_kernel
def step(
    runs, tiles, water: Water, bed, numbers: StepNumbers,
    h_out, u_out, v_out, wave_speed_out, speed_out,
):  # fmt: skip
    """Advance depth from n to n+1 and velocity from n+1/2 to n+3/2 in the tiles of `runs`.

    water : Water. Depth at n and velocity at n+1/2.
    h_out, u_out, v_out : as h, u and v. `fill_velocity` sets the edge faces
        afterwards.
    """
    for t in prange(runs.shape[0]):
        step_run(
            runs[t], tiles, water, bed, numbers, h_out, u_out, v_out, wave_speed_out, speed_out
        )
