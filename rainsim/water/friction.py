"""Friction at the faces: Manning's for rough ground, laminar for thin films."""

import numpy as np

from rainsim.constants import FOUR, ONE, QUARTER, TWO, ZERO
from rainsim.jit import cpu_kernel, device_function, lean_function, prange
from rainsim.numerics.approximations import cube_root, quotient
from rainsim.water.bundles import FrictionNumbers, Ground, Water
from rainsim.water.conserving import depth_over_step, wave_speed
from rainsim.water.rows import ROOM, copy_row, stack_row, tile_maxima

TINY = np.float32(2.0**-60)  # m/s, keeps 0 / 0 out of still faces


@device_function
def slowed(speed, along, depth, drag, laminar):
    """Face velocity after friction over one step, implicit in the velocity.

    Solves w (1 + laminar / h^2 + c sqrt(w^2 + t^2)) = speed with c = drag / h^(4/3) and t the
    velocity `along` the face. The first guess is the root for t = 0, which is larger; two Newton
    steps leave an error of 1e-4 w.
    """
    share = quotient(ONE, depth)
    thin = ONE + laminar * share * share
    c = drag * share * cube_root(share)
    wanted, across = abs(speed), along * along + TINY * TINY
    w = quotient(TWO * wanted, thin + np.sqrt(thin * thin + FOUR * c * wanted))
    for _ in range(2):
        whole = np.sqrt(w * w + across)
        taken = thin + c * whole
        w -= quotient((w * taken - wanted) * whole, taken * whole + c * (w * w))
    return w if speed > 0 else -w


@lean_function
def slow_run(
    run, tiles, water: Water, ground: Ground, numbers: FrictionNumbers,
    u_out, v_out, wave_speed_out, speed_out,
):  # fmt: skip
    """Slow the faces of one run of tiles by friction; see `apply_friction`."""
    h, u, v = water.h, water.u, water.v
    bed, roughness = ground
    drag, laminar, gravity, dry = numbers
    south, north, west, east = run[0], run[1], run[2], run[3]
    new_u, new_v = stack_row(h, ROOM), stack_row(h, ROOM)
    far, fast = stack_row(h, ROOM), stack_row(h, ROOM)
    n, a = east - west, west - 1
    for c in range(n):
        far[c], fast[c] = ZERO, ZERO
    for j in range(south, north):
        d, b, r = h[j, a:east], bed[j, a:east], roughness[j, a:east]
        d_s, b_s, r_s = h[j - 1, west:east], bed[j - 1, west:east], roughness[j - 1, west:east]
        v_c, v_n, w = v[j, a:east], v[j + 1, a:east], u_out[j, west:east]
        u_s, u_c, x = u[j - 1, west : east + 1], u[j, west : east + 1], v_out[j, west:east]
        for c in range(n):
            depth = max(depth_over_step(d[c], d[c + 1], b[c + 1] - b[c]), dry)
            along = QUARTER * (v_c[c] + v_c[c + 1] + v_n[c] + v_n[c + 1])
            new_u[c] = slowed(w[c], along, depth, drag * max(r[c], r[c + 1]), laminar)
        for c in range(n):
            depth = max(depth_over_step(d_s[c], d[c + 1], b[c + 1] - b_s[c]), dry)
            along = QUARTER * (u_s[c] + u_s[c + 1] + u_c[c] + u_c[c + 1])
            s = slowed(x[c], along, depth, drag * max(r_s[c], r[c + 1]), laminar)
            new_v[c] = s
            fast[c] = max(fast[c], max(abs(new_u[c]), abs(s)))
            top = max(
                wave_speed(new_u[c], d[c], d[c + 1], gravity),
                wave_speed(s, d_s[c], d[c + 1], gravity),
            )
            far[c] = max(far[c], top)
        copy_row(new_u, n, w)
        copy_row(new_v, n, x)
    tile_maxima(run, tiles, far, wave_speed_out)
    tile_maxima(run, tiles, fast, speed_out)


@cpu_kernel
def apply_friction(
    runs, tiles, water: Water, ground: Ground, numbers: FrictionNumbers,
    u_out, v_out, wave_speed_out, speed_out,
):  # fmt: skip
    """Slow the velocities at the west and south faces of the cells in `runs` by friction.

    water : Water. Depth after the step and velocity before it. Friction takes the
        speed along a face from this velocity, because the neighbours' new one may
        be slowed already or not.
    u_out, v_out : ndarray of the shapes of `water.u` and `water.v` [m/s].
        Velocity after the step, which friction slows in place. Call
        `fill_velocity` afterwards: it sets the faces at the map's edges.
    """
    for t in prange(runs.shape[0]):
        slow_run(runs[t], tiles, water, ground, numbers, u_out, v_out, wave_speed_out, speed_out)
