"""Spherical harmonics of splat colours: the basis and the signs of the original 3DGS code."""

import numpy as np

from rainsim.jit import device_function

ZERO = np.float32(0)
HALF = np.float32(0.5)
TWO = np.float32(2)
THREE = np.float32(3)
FOUR = np.float32(4)

SH0 = np.float32(0.28209479177387814)
SH1 = np.float32(0.4886025119029199)
SH2 = tuple(np.float32(c) for c in (1.0925484305920792, 0.31539156525252005, 0.5462742152960396))
SH2A, SH2B, SH2C = SH2
SH3A, SH3B, SH3C, SH3D, SH3E = (
    np.float32(c)
    for c in (
        0.5900435899266435,
        2.890611442640554,
        0.4570457994644658,
        0.3731763325901154,
        1.445305721320277,
    )
)


@device_function
def sh_color(sh, s, channel, bands, x, y, z):
    """Return one colour channel of splat `s` seen along the unit direction (x, y, z)."""
    c = channel
    value = SH0 * sh[s, c] + HALF
    if bands > 1:
        value += SH1 * (z * sh[s, 6 + c] - y * sh[s, 3 + c] - x * sh[s, 9 + c])
    if bands > 2:
        xx, yy, zz = x * x, y * y, z * z
        value += (
            SH2A * (x * y * sh[s, 12 + c] - y * z * sh[s, 15 + c] - x * z * sh[s, 21 + c])
            + SH2B * (TWO * zz - xx - yy) * sh[s, 18 + c]
            + SH2C * (xx - yy) * sh[s, 24 + c]
        )
        if bands > 3:
            value += (
                SH3B * x * y * z * sh[s, 30 + c]
                - SH3A * y * (THREE * xx - yy) * sh[s, 27 + c]
                - SH3C * (FOUR * zz - xx - yy) * (y * sh[s, 33 + c] + x * sh[s, 39 + c])
                + SH3D * z * (TWO * zz - THREE * xx - THREE * yy) * sh[s, 36 + c]
                + SH3E * z * (xx - yy) * sh[s, 42 + c]
                - SH3A * x * (xx - THREE * yy) * sh[s, 45 + c]
            )
    return max(value, ZERO)
