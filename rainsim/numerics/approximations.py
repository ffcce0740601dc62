"""Elementary functions without library calls, for loops that run in vectors.

The polynomials are our own minimax fits: exp(-x) up to 1.25, atan(x)/x in x^2.
"""

import numpy as np

from rainsim.constants import HALF_PI, PI, TWO, ZERO
from rainsim.jit import device_function, inlined_function

F0, F1, F2 = np.float32(0.999999886), np.float32(-0.999992266), np.float32(0.499910354)
F3, F4, F5 = np.float32(-0.166263489), np.float32(0.040776423), np.float32(-0.007285826)
F6 = np.float32(0.000734393271)
A0, A1, A2 = np.float32(0.999996091), np.float32(-0.333017824), np.float32(0.195822437)
A3, A4, A5 = np.float32(-0.121762629), np.float32(0.0580767676), np.float32(-0.0137205868)


@inlined_function
def exp_minus(x):
    """Return exp(-x) for x from 0 on, within 3e-6 of it; 0 from 20 on."""
    t = min(x, np.float32(20)) * np.float32(1 / 16)
    p = F0 + t * (F1 + t * (F2 + t * (F3 + t * (F4 + t * (F5 + t * F6)))))
    p = p * p
    p = p * p
    p = p * p
    return p * p


@inlined_function
def angle(y, x):
    """Return the angle [rad] of the point (x, y) as atan2 does, within 1e-5."""
    ax, ay = abs(x), abs(y)
    t = min(ax, ay) / max(max(ax, ay), np.float32(1e-30))
    s = t * t
    r = t * (A0 + s * (A1 + s * (A2 + s * (A3 + s * (A4 + s * A5)))))
    r = HALF_PI - r if ay > ax else r
    r = PI - r if x < ZERO else r
    return -r if y < ZERO else r


@device_function
def cube_root(x):
    """Cube root of x, 1e-6 to 100, within 3e-6 of itself.

    Two Halley steps from x^(5/16), in operations of which a processor does many at once. A CUDA
    device takes its own power function (`rainsim.cuda.scalars`).
    """
    fourth = np.sqrt(np.sqrt(x))
    root = fourth * np.sqrt(np.sqrt(fourth))
    for _ in range(2):
        cube = root * root * root
        root *= (cube + TWO * x) / (TWO * cube + x)
    return root


@device_function
def quotient(a, b):
    """Return a / b; a CUDA device may be off by two units in the last place."""
    return a / b
