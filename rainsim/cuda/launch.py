"""Launches of kernels by the driver itself, with what numba has compiled.

numba looks up the types of all arguments and packs them again at each launch: 60 to
150 us of a frame that has a hundred. Here an array is packed once, and a list of kinds of
arguments finds the machine code.
"""

import struct
from array import array
from functools import partial

import numpy as np
from cuda.bindings import driver
from numba.cuda.cudadrv.devicearray import DeviceNDArray

_MOST = 512  # numbers of a launch
_PLACES = 8 * np.arange(_MOST, dtype=np.uint64)  # each number has eight bytes
_double, _single, _whole = (struct.Struct(kind).pack for kind in ("d", "f4x", "q"))
_SCALARS = {
    np.float32: _single, np.float64: _double, float: _double, int: _whole, bool: _whole,
    np.int32: _whole, np.int64: _whole,
}  # fmt: skip


class LaunchedKernel:
    """A kernel as numba's dispatcher is called: `kernel[grid, block](*arguments)`."""

    def __init__(self, dispatcher):
        self.dispatcher, self._handles = dispatcher, {}

    def __getattr__(self, name):
        return getattr(self.dispatcher, name)

    def __getitem__(self, shape):
        return partial(self._launch, *shape)

    def _launch(self, grid, block, *arguments):
        kinds, numbers = [], []
        if not _pack(arguments, kinds, numbers):
            self.dispatcher[grid, block](*arguments)
            return
        kinds = tuple(kinds)
        handle = self._handles.get(kinds)
        if handle is None:
            self.dispatcher[grid, block](*arguments)
            types = tuple(map(self.dispatcher.typeof_pyval, arguments))
            function = self.dispatcher.overloads[types]._codelibrary.get_cufunc()
            self._handles[kinds] = int(function.handle)
            return
        packed = array("q", b"".join(numbers))
        places = _PLACES[: len(packed)] + np.uint64(packed.buffer_info()[0])
        pointers = places.__array_interface__["data"][0]
        (code,) = driver.cuLaunchKernel(handle, *_three(grid), *_three(block), 0, 0, pointers, 0)
        if code:  # as where this thread has no context yet: numba makes one, or says what is wrong
            self.dispatcher[grid, block](*arguments)


def _three(shape):
    """Return a number or up to three of blocks or threads as three."""
    if isinstance(shape, tuple):
        return (*shape, 1, 1)[:3]
    return shape, 1, 1


def _pack(values, kinds, numbers):
    """Add the kinds of arguments and their numbers, eight bytes each; return if all are known."""
    for value in values:
        kind = type(value)
        if kind is DeviceNDArray:
            try:
                kind, number = value.packed
            except AttributeError:
                kind, number = value.packed = _packed(value)
            kinds.append(kind)
            numbers.append(number)
        elif kind in _SCALARS:
            kinds.append(kind)
            numbers.append(_SCALARS[kind](value))
        elif isinstance(value, tuple):
            kinds.append(kind)
            if not _pack(value, kinds, numbers):
                return False
        else:
            return False
    return True


def _packed(value):
    """Return kind and numbers of a device array: as numba passes arrays to its kernels."""
    place = value.__cuda_array_interface__["data"][0] or 0
    order = "C" if value.is_c_contiguous() else "F" if value.is_f_contiguous() else "A"
    numbers = 0, 0, value.size, value.dtype.itemsize, place, *value.shape, *value.strides
    return f"{value.dtype.str}{value.ndim}{order}", array("q", numbers).tobytes()
