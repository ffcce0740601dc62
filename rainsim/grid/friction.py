"""Friction at the faces: Manning's for rough ground, laminar for thin films."""

import numpy as np

from rainsim.grid.conserving import COLUMNS, PAD, largest, reach
from rainsim.grid.paper import cube_root
from rainsim.jit import cpu_kernel, device_function, prange

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
    thin = ONE + film / (depth * depth)
    c = drag / (depth * cube_root(depth) * thin)
    wanted = abs(speed) / thin
    w = TWO * wanted / (ONE + np.sqrt(ONE + FOUR * c * wanted))
    for _ in range(2):
        whole = max(np.sqrt(w * w + along * along), TINY)
        excess = w + c * w * whole - wanted
        w -= excess * whole / (whole + c * (whole * whole + w * w))
    return w if speed > 0 else -w


@cpu_kernel
def rub(
    tiles, h, bed, roughness, u, v, drag, film, gravity, dry, u_out, v_out, reach_out, fast_out
):  # fmt: skip
    """Slow all inner faces of `tiles` by friction.

    Parameters
    ----------
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
        Modified in place.
    reach_out, fast_out : ndarray of shape (tiles,) [m/s]
        Largest `conserving.reach` and largest speed of each tile.
    """
    for t in prange(tiles.shape[0]):
        south, north, west, east = tiles[t, 0], tiles[t, 1], tiles[t, 2], tiles[t, 3]
        tops = np.zeros((2, COLUMNS), h.dtype)
        far, fast = tops[0], tops[1]
        a = max(west, PAD + 1)
        for j in range(south, north):
            d, b, r = h[j, a - 1 : east], bed[j, a - 1 : east], roughness[j, a - 1 : east]
            v_s, v_n, w = v[j, a - 1 : east], v[j + 1, a - 1 : east], u_out[j, a:east]
            for c in range(east - a):
                level = max(b[c] + d[c], b[c + 1] + d[c + 1])
                depth = max(level - max(b[c], b[c + 1]), dry)
                along = QUARTER * (v_s[c] + v_s[c + 1] + v_n[c] + v_n[c + 1])
                s = rubbed(w[c], along, depth, drag * max(r[c], r[c + 1]), film)
                w[c] = s
                far[c] = max(far[c], reach(s, d[c], d[c + 1], gravity))
                fast[c] = max(fast[c], abs(s))
        for j in range(max(south, PAD + 1), north):
            d_0, b_0, r_0 = h[j - 1, west:east], bed[j - 1, west:east], roughness[j - 1, west:east]
            d_1, b_1, r_1 = h[j, west:east], bed[j, west:east], roughness[j, west:east]
            u_s, u_n = u[j - 1, west : east + 1], u[j, west : east + 1]
            w = v_out[j, west:east]
            for c in range(east - west):
                depth = max(max(b_0[c] + d_0[c], b_1[c] + d_1[c]) - max(b_0[c], b_1[c]), dry)
                along = QUARTER * (u_s[c] + u_s[c + 1] + u_n[c] + u_n[c + 1])
                s = rubbed(w[c], along, depth, drag * max(r_0[c], r_1[c]), film)
                w[c] = s
                far[c] = max(far[c], reach(s, d_0[c], d_1[c], gravity))
                fast[c] = max(fast[c], abs(s))
        reach_out[t], fast_out[t] = largest(far, COLUMNS), largest(fast, COLUMNS)
