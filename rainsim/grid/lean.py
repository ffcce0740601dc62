"""The scheme "lean": the first-order part of `rainsim.grid.conserving`, fused into one pass.

Volume and momentum are conserved as in "accurate", but depths and velocities are carried upwind
without slopes, waves are second order, and the sums are of the fields' own type: rounding may
change the volume by some 1e-8 in a thousand steps, which the ledger's residual shows. Each value
is read and written once in a step; what a row of a tile needs of the row below is kept in buffers.
"""

import numpy as np

from rainsim.grid.conserving import HALF, PAD, TWO, ZERO, largest, reach
from rainsim.jit import cpu_kernel, device_function, prange

WIDTH = 68  # of a row buffer: the columns of a tile and a cell on each side


@device_function
def upwind_flux(speed, h_1, h_2, bed_1, bed_2, dry):
    """Volume flux [m2/s] through the face between the cells 1 and 2; depths under `dry` stay."""
    east = speed > ZERO
    centre = h_1 if east else h_2
    step = (bed_2 - bed_1) if east else (bed_1 - bed_2)
    over = max(centre - max(step, ZERO), ZERO)
    return speed * over if centre > dry else ZERO


@device_function
def upwind(flow, a_1, a_2):
    """Flux of `a` that `flow` carries from a_1 to a_2, or back."""
    return max(flow, ZERO) * a_1 + min(flow, ZERO) * a_2


@device_function
def pushed_lean(w, h_a, h_b, bed_a, bed_b, momentum, volume, still, k, kg, cap, rest, dry):
    """Face velocity after transport and pressure; `still` where the face is closed.

    As `conserving.pushed`; `dry` also tells wet cells from dry ones.
    """
    level_a, level_b = bed_a + h_a, bed_b + h_b
    rise = level_b - level_a
    noise = rest * (h_a + h_b + abs(bed_a) + abs(bed_b))
    carried = w - k * (momentum - w * volume) / max(HALF * (h_a + h_b), HALF * dry)
    turned = carried - kg * rise
    closed = (h_a <= dry) & ((h_b <= dry) | (bed_a + dry >= level_b))
    closed |= (h_b <= dry) & (bed_b + dry >= level_a)
    rests = (abs(rise) <= noise) & (abs(turned) <= TWO * kg * noise)
    turned = still if closed else turned
    return ZERO if rests else min(max(turned, -cap), cap)


@device_function
def flux_row(w, d, b, n, dry, q_out):
    """Fluxes through the n faces between the cells c and c + 1 of a row."""
    for c in range(n):
        q_out[c] = upwind_flux(w[c], d[c], d[c + 1], b[c], b[c + 1], dry)


@device_function
def flux_rows(w, d_0, d_1, b_0, b_1, n, dry, q_out):
    """Fluxes through the n faces between two rows."""
    for c in range(n):
        q_out[c] = upwind_flux(w[c], d_0[c], d_1[c], b_0[c], b_1[c], dry)


@device_function
def move_row(d, q_x, q_s, q_n, n, k, d_out):
    """Depths of n cells after the step; rounding must not make them negative."""
    for c in range(n):
        d_out[c] = max(d[c] - k * ((q_x[c + 1] - q_x[c]) + (q_n[c] - q_s[c])), ZERO)


@cpu_kernel
def step(
    tiles, h, bed, u, v, k, kg, gravity, cap, rest, dry,
    h_out, u_out, v_out, reach_out, fast_out,
):  # fmt: skip
    """Bring depth from n to n+1 and velocity from n+1/2 to n+3/2 in `tiles`.

    Parameters
    ----------
    tiles : ndarray of shape (tiles, 4), int64
        First and last row + 1, first and last column + 1 of each tile.
    h, bed : ndarray of shape (ny + 4, nx + 4) [m]
        Flowing depth at n and the height on which it flows.
    u, v : ndarray of shape (ny + 4, nx + 5) and (ny + 5, nx + 4) [m/s]
        Face velocities at n+1/2.
    k, kg : float [s/m], [1/s]
        dt / spacing, and that times gravity.
    gravity : float [m/s2]
    cap : float [m/s]
        Speed that no face may exceed.
    rest : float
        Relative rounding under which levels are equal.
    dry : float [m]
        Depths below do not flow.
    h_out, u_out, v_out : as h, u and v
        Edge faces are left alone.
    reach_out, fast_out : ndarray of shape (tiles,) [m/s]
        Largest `conserving.reach` and largest speed of each tile.
    """
    for t in prange(tiles.shape[0]):
        south, north, west, east = tiles[t, 0], tiles[t, 1], tiles[t, 2], tiles[t, 3]
        rows = np.empty((9, WIDTH), h.dtype)
        tops = np.zeros((2, WIDTH), h.dtype)
        far, fast = tops[0], tops[1]
        q_x, q_x_below, q_s, q_n = rows[0], rows[1], rows[2], rows[3]
        d, d_below, m_s, m_n, q_ss = rows[4], rows[5], rows[6], rows[7], rows[8]
        n = east - west
        # Buffers begin at the cell west of the tile: cell or face c stands at c + west - 1.
        j = south - 1
        a = west - 1
        flux_rows(
            v[j, a:east], h[j - 1, a:east], h[j, a:east], bed[j - 1, a:east], bed[j, a:east],
            n + 1, dry, q_s,
        )  # fmt: skip
        for j in range(south - 1, north):
            flux_row(u[j, a : east + 1], h[j, a - 1 : east + 1], bed[j, a - 1 : east + 1], n + 2,
                     dry, q_x)  # fmt: skip
            flux_rows(
                v[j + 1, a:east], h[j, a:east], h[j + 1, a:east], bed[j, a:east],
                bed[j + 1, a:east], n + 1, dry, q_n,
            )  # fmt: skip
            move_row(h[j, a:east], q_x, q_s, q_n, n + 1, k, d)
            u_0, u_1 = u[j, a - 1 : east + 1], u[j + 1, a : east + 1]
            for c in range(n):
                m_n[c] = upwind(HALF * (q_n[c] + q_n[c + 1]), u_0[c + 2], u_1[c + 1])
            if j >= south:
                first = 1 if west == PAD else 0  # the west edge's face is not ours
                w, b, b_s = u[j, a : east + 1], bed[j, a - 1 : east + 1], bed[j - 1, west:east]
                w_out, v_new, h_new = u_out[j, west:east], v_out[j, west:east], h_out[j, west:east]
                for c in range(n):
                    h_new[c] = d[c + 1]
                edge = w_out[0]
                for c in range(n):
                    h_a, h_b, bed_a, bed_b = d[c], d[c + 1], b[c + 1], b[c + 2]
                    momentum = upwind(HALF * (q_x[c + 1] + q_x[c + 2]), w[c + 1], w[c + 2])
                    momentum -= upwind(HALF * (q_x[c] + q_x[c + 1]), w[c], w[c + 1])
                    momentum += m_n[c] - m_s[c]
                    volume = HALF * (
                        q_x[c + 2] - q_x[c] + q_n[c] + q_n[c + 1] - q_s[c] - q_s[c + 1]
                    )
                    s = pushed_lean(
                        w[c + 1], h_a, h_b, bed_a, bed_b, momentum, volume, ZERO, k, kg, cap,
                        rest, dry,
                    )  # fmt: skip
                    w_out[c] = s
                    far[c] = max(far[c], reach(s, h_a, h_b, gravity))
                    fast[c] = max(fast[c], abs(s))
                if first:
                    w_out[0] = edge
                if j > PAD:
                    v_s, v_c, v_n = v[j - 1, west:east], v[j, a : east + 1], v[j + 1, west:east]
                    b_c = bed[j, west:east]
                    for c in range(n):
                        h_a, h_b, bed_a, bed_b = d_below[c + 1], d[c + 1], b_s[c], b_c[c]
                        w_c = v_c[c + 1]
                        momentum = upwind(HALF * (q_s[c + 1] + q_n[c + 1]), w_c, v_n[c])
                        momentum -= upwind(HALF * (q_ss[c + 1] + q_s[c + 1]), v_s[c], w_c)
                        q_w = HALF * (q_x_below[c + 1] + q_x[c + 1])
                        q_e = HALF * (q_x_below[c + 2] + q_x[c + 2])
                        momentum += upwind(q_e, w_c, v_c[c + 2]) - upwind(q_w, v_c[c], w_c)
                        volume = HALF * (q_n[c + 1] - q_ss[c + 1]) + q_e - q_w
                        s = pushed_lean(
                            w_c, h_a, h_b, bed_a, bed_b, momentum, volume, ZERO, k, kg, cap,
                            rest, dry,
                        )  # fmt: skip
                        v_new[c] = s
                        far[c] = max(far[c], reach(s, h_a, h_b, gravity))
                        fast[c] = max(fast[c], abs(s))
            q_x, q_x_below = q_x_below, q_x
            d, d_below = d_below, d
            m_s, m_n = m_n, m_s
            q_ss, q_s, q_n = q_s, q_n, q_ss
        reach_out[t], fast_out[t] = largest(far, n), largest(fast, n)
