"""Friction at the faces: Manning's for rough ground, laminar for thin films."""

import numpy as np

from rainsim.grid.conserving import quotient, reach, standing
from rainsim.grid.paper import cube_root
from rainsim.grid.rows import ROOM, copy_row, largest_of, stack_row
from rainsim.jit import cpu_kernel, device_function, prange

ZERO = np.float32(0)
ONE = np.float32(1)
TWO = np.float32(2)
FOUR = np.float32(4)
QUARTER = np.float32(0.25)
TINY = np.float32(2.0**-60)  # m/s, keeps 0 / 0 out of still faces


@device_function
def rubbed(speed, along, depth, drag, film):
    """Face velocity after friction over one step, implicit in the velocity.

    Solves w (1 + film / h^2 + c sqrt(w^2 + t^2)) = speed with c = drag / h^(4/3) and t the velocity
    `along` the face. From the root for t = 0, which lies above, two Newton steps leave 1e-4 of w.
    """
    share = quotient(ONE, depth)
    thin = ONE + film * share * share
    c = drag * share * cube_root(share)
    wanted, across = abs(speed), along * along + TINY * TINY
    w = quotient(TWO * wanted, thin + np.sqrt(thin * thin + FOUR * c * wanted))
    for _ in range(2):
        whole = np.sqrt(w * w + across)
        taken = thin + c * whole
        w -= quotient((w * taken - wanted) * whole, taken * whole + c * (w * w))
    return w if speed > 0 else -w


@cpu_kernel
def rub(
    runs, tiles, h, bed, roughness, u, v, drag, film, gravity, dry,
    u_out, v_out, reach_out, fast_out,
):  # fmt: skip
    """Slow the faces of `runs` by friction.

    Parameters
    ----------
    runs : ndarray of shape (runs, 6), int64
        See `rows.runs_of`.
    tiles : ndarray of shape (tiles, 4), int64
    h, bed : ndarray of shape (ny + 4, nx + 4) [m]
    roughness : ndarray of shape (ny + 4, nx + 4) [s2 m^(-2/3)]
        Square of Manning's n.
    u, v : ndarray of shape (ny + 4, nx + 5) and (ny + 5, nx + 4) [m/s]
        Velocity before the step, from which the flow along a face is taken.
    drag : float [m/s]
        gravity * dt.
    film : float [m2]
        3 * kinematic viscosity * dt: the drag of a laminar film over its depth squared.
    gravity : float [m/s2]
    dry : float [m]
        Least depth that friction sees.
    u_out, v_out : as u and v
        Modified in place; edge faces are to be set anew.
    reach_out, fast_out : ndarray of shape (tiles,) [m/s]
        Largest `conserving.reach` and largest speed of each tile.
    """
    for t in prange(runs.shape[0]):
        south, north, west, east = runs[t, 0], runs[t, 1], runs[t, 2], runs[t, 3]
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
                depth = max(standing(d[c], d[c + 1], b[c + 1] - b[c]), dry)
                along = QUARTER * (v_c[c] + v_c[c + 1] + v_n[c] + v_n[c + 1])
                new_u[c] = rubbed(w[c], along, depth, drag * max(r[c], r[c + 1]), film)
            for c in range(n):
                depth = max(standing(d_s[c], d[c + 1], b[c + 1] - b_s[c]), dry)
                along = QUARTER * (u_s[c] + u_s[c + 1] + u_c[c] + u_c[c + 1])
                s = rubbed(x[c], along, depth, drag * max(r_s[c], r[c + 1]), film)
                new_v[c] = s
                fast[c] = max(fast[c], max(abs(new_u[c]), abs(s)))
                top = max(
                    reach(new_u[c], d[c], d[c + 1], gravity), reach(s, d_s[c], d[c + 1], gravity)
                )
                far[c] = max(far[c], top)
            copy_row(new_u, n, w)
            copy_row(new_v, n, x)
        largest_of(runs[t], tiles, far, reach_out)
        largest_of(runs[t], tiles, fast, fast_out)
