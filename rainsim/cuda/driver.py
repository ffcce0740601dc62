"""Copies between host and device, and faults of the device.

All work is queued on the default stream, in the order of the calls. The host waits for copies but
for those of a finished picture, see `Download`, and of rows that change each frame, see `SentRows`.
"""

import contextlib
from functools import partial

import numpy as np

from rainsim.cuda.jit import SIMULATED, cuda
from rainsim.errors import BackendError

if SIMULATED:
    driver = None
else:
    from cuda.bindings import driver


@contextlib.contextmanager
def one_fault():
    """Raise BackendError, one line, if an error in the context has left the device dead."""
    try:
        yield
    except BackendError:
        raise
    except Exception:
        code = 0 if SIMULATED else driver.cuCtxSynchronize()[0]
        if int(code) == 0:
            raise
        raise BackendError(f"the CUDA device failed: {code.name}; start again") from None


def prepare():
    """Create the CUDA context; threads that have it free its memory, silently.

    Numba frees in whichever thread collects garbage. One without the context cannot, and on a dead
    device nobody can: numba would print a traceback for each array.
    """
    if SIMULATED:
        return
    context = cuda.current_context()
    for owner in (context, context.memory_manager):
        pending = getattr(owner, "deallocations", None)
        if pending is not None and "clear" not in vars(pending):
            pending.clear = partial(_free, pending.clear)


def _free(clear):
    code, context = driver.cuCtxGetCurrent()
    if int(code) == 0 and int(context) != 0:
        with contextlib.suppress(Exception):  # the next call that waits for the device tells
            clear()


class Download:
    """Copies pictures of the device to the host beside what the host does next.

    A picture on the host is overwritten by the next copy but one.
    """

    def __init__(self):
        self._pictures = [(np.zeros((0, 0, 3), np.uint8), cuda.event()) for _ in range(2)]
        self._stream = 0 if SIMULATED else cuda.default_stream()

    def begin(self, image):
        """Queue the copy of a device array, uint8; return that on the host, and an event.

        The latter is to be waited for.
        """
        values, copied = self._pictures.pop(0)
        if values.shape != image.shape:
            values = cuda.pinned_array(image.shape, np.uint8)
        image.copy_to_host(values, stream=self._stream)
        copied.record()
        self._pictures.append((values, copied))
        return values, copied


def send(array, values, window=None):
    """Copy host values to a device array; they may be changed afterwards.

    values : ndarray. Of the shape of the array or with fewer rows, the first
        ones; or of that of the window.
    window : tuple of slice, optional. Rows and columns of the array, of which
        the others stay.
    """
    if SIMULATED:
        array[slice(len(values)) if window is None else window] = values
        return
    values = np.ascontiguousarray(values, array.dtype)
    if window is None:
        _check(driver.cuMemcpyHtoD(_place(array), values.ctypes.data, values.nbytes))
        return
    copy, (rows, columns) = driver.CUDA_MEMCPY2D(), window
    copy.srcMemoryType = driver.CUmemorytype.CU_MEMORYTYPE_HOST
    copy.srcHost, copy.srcPitch = values.ctypes.data, values[0].nbytes
    copy.dstMemoryType = driver.CUmemorytype.CU_MEMORYTYPE_DEVICE
    place = _place(array) + rows.start * array.strides[0]
    copy.dstDevice, copy.dstPitch = place + columns.start * array.strides[1], array.strides[0]
    copy.WidthInBytes, copy.Height = values[0].nbytes, len(values)
    _check(driver.cuMemcpy2D(copy))


def fetch(array):
    """Return a copy of a contiguous device array; the host waits for what was queued before.

    It makes none of the checks that numba's `copy_to_host` makes before each copy.
    """
    if SIMULATED:
        return array.copy_to_host()
    values = np.empty(array.shape, array.dtype)
    _check(driver.cuMemcpyDtoH(values.ctypes.data, _place(array), values.nbytes))
    return values


class SentRows:
    """Rows of the host on the device, in an array that grows where it must.

    They go through page-locked memory, so that the host waits only if the rows that it sent before
    are still being copied.
    """

    def __init__(self, shape, kind):
        self._copied = cuda.event()
        self._make_room((1, *shape), kind)

    def _make_room(self, shape, kind):
        self.array, self._host = cuda.device_array(shape, kind), cuda.pinned_array(shape, kind)

    def send(self, values, first=0):
        """Queue the copy of rows to those of `array` from the first on; return it.

        Where it has no room for them, another takes its place, without the other rows.
        """
        self._copied.synchronize()
        if first + len(values) > len(self.array):
            shape = 2 * (first + len(values)) + 1024, *self.array.shape[1:]
            self._make_room(shape, self.array.dtype)
        there = self._host[: len(values)]
        there[...] = values
        if SIMULATED:
            self.array[first : first + len(values)] = there
        elif len(values):
            place = _place(self.array) + first * self.array.strides[0]
            _check(driver.cuMemcpyHtoDAsync(place, there.ctypes.data, there.nbytes, 0))
            self._copied.record()
        return self.array


def _place(array):
    """Return the address of a device array, which numba looks up in some microseconds."""
    try:
        return array.place
    except AttributeError:
        array.place = array.__cuda_array_interface__["data"][0]
        return array.place


def _check(result):
    if result[0]:
        raise BackendError(f"the CUDA driver answered {result[0].name} to a copy")
