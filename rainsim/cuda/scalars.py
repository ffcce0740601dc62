"""Stand-ins for numpy's scalar functions in CUDA kernels, whose compiler knows only math's.

The compiler of the CPU kernels takes `np.sqrt(x)` of a number, that of CUDA does not. With these
stand-ins one formula serves both, in the type of its argument: no float64 sneaks in.
"""

import math

import numpy as np
from numba import cuda, types
from numba.extending import overload

from rainsim.numerics.approximations import cube_root, quotient

_THIRD = np.float32(1 / 3)
_SAME = {
    **{name: name for name in ("sqrt", "exp", "expm1", "log", "cos", "sin", "floor", "ceil")},
    "tanh": "tanh", "cosh": "cosh", "arccosh": "acosh", "arctan": "atan",
}  # fmt: skip


def _stand_in(function):
    def chosen(x):
        if isinstance(x, types.Float):
            return lambda x: function(x)
        return None

    return chosen


def _of_two(function):
    def chosen(x, y):
        if isinstance(x, types.Number) and isinstance(y, types.Number):
            return lambda x, y: function(x, y)
        return None

    return chosen


for _name, _known in _SAME.items():
    overload(getattr(np, _name), target="cuda")(_stand_in(getattr(math, _known)))
for _name, _builtin in (("minimum", min), ("maximum", max)):
    overload(getattr(np, _name), target="cuda")(_of_two(_builtin))


if cuda.config.ENABLE_CUDASIM:

    @cuda.jit(device=True)
    def bits_of(x):
        """Return the bits of a float32 as an int32: for numbers from 0 up they order alike."""
        return np.float32(x).view(np.int32)

    @cuda.jit(device=True)
    def float_of(bits):
        """Return the float32 with the given bits."""
        return np.int32(bits).view(np.float32)

else:
    from numba.cuda import libdevice

    @overload(quotient, target="cuda")
    def _quotient(a, b):
        quick = a == b == types.float32
        return (lambda a, b: libdevice.fast_fdividef(a, b)) if quick else (lambda a, b: a / b)

    @overload(cube_root, target="cuda")
    def _cube_root(x):
        # In two instructions, within some 1e-6 of itself; the CPU's is within 3e-6.
        return (lambda x: libdevice.fast_powf(x, _THIRD)) if x == types.float32 else None

    @cuda.jit(device=True)
    def bits_of(x):
        """Return the bits of a float32 as an int32: for numbers from 0 up they order alike."""
        return libdevice.float_as_int(np.float32(x))

    @cuda.jit(device=True)
    def float_of(bits):
        """Return the float32 with the given bits."""
        return libdevice.int_as_float(np.int32(bits))
