"""Copies between host and device, and faults of the device.

All work is queued on the default stream, in the order of the calls; only a finished picture is
copied to the host beside it, see `Download`.
"""

import contextlib
from functools import partial

import numpy as np

from rainsim.cuda.jit import SIMULATED, cuda, pinned
from rainsim.errors import BackendError

if SIMULATED:
    driver = None
else:
    from cuda.bindings import driver


_ALIGN = 16  # bytes
_STAGED = 1 << 16  # bytes that are sent before the host waits, at least


def aligned(count):
    """Return the bytes that `count` of them take up where arrays lie one after another."""
    return -(-count // _ALIGN) * _ALIGN


def checked(result):
    """Return the value of a driver's call, or raise BackendError if it failed."""
    code = result[0]
    if code:
        raise BackendError(f"the CUDA driver answered {code.name} to a copy")
    return result[1] if len(result) > 1 else None


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


def copy_to_device(values, array):
    """Queue the copy of pinned memory to a contiguous device array, from its beginning on."""
    if SIMULATED:
        array.copy_to_device(values)
    else:
        checked(driver.cuMemcpyHtoDAsync(_place(array), values.ctypes.data, values.nbytes, 0))


def copy_to_host(array, values_out):
    """Copy a whole contiguous device array to pinned memory of its size; waits."""
    if SIMULATED:
        array.copy_to_host(values_out)
        return
    checked(driver.cuMemcpyDtoH(values_out.ctypes.data, _place(array), values_out.nbytes))


def _place(array):
    """Return the address of a device array, which numba looks up in some microseconds."""
    try:
        return array.place
    except AttributeError:
        array.place = array.__cuda_array_interface__["data"][0]
        return array.place


class Event:
    """A place in the queue of the default stream, or another, that is waited for.

    One that was never recorded keeps nobody waiting. In the simulator, where all work is done at
    once, nothing happens.
    """

    def __init__(self):
        if not SIMULATED:
            prepare()  # without a context there are no events
            flag = driver.CUevent_flags.CU_EVENT_DISABLE_TIMING
            self._handle = checked(driver.cuEventCreate(flag))

    def record(self, stream=0):
        """Mark the present end of a stream's queue."""
        if not SIMULATED:
            checked(driver.cuEventRecord(self._handle, stream))

    def wait(self, stream=0):
        """Let work that is queued on a stream from now on wait for the mark."""
        if not SIMULATED:
            checked(driver.cuStreamWaitEvent(stream, self._handle, 0))

    def synchronize(self):
        """Let the host wait for the mark."""
        if not SIMULATED:
            checked(driver.cuEventSynchronize(self._handle))

    def __del__(self):
        if hasattr(self, "_handle"):
            driver.cuEventDestroy(self._handle)


class Counted:
    """Small device arrays that the host reads, as soon as what was queued before is done."""

    def __init__(self, count, kind):
        self._seen = pinned(count, kind)

    def read(self, array):
        """Return the values of a device array, overwritten by the next call; waits."""
        copy_to_host(array, self._seen)
        return self._seen


class Download:
    """Copies pictures of the device to the host beside what is queued after them.

    A picture on the host is overwritten by the next copy but one.
    """

    def __init__(self):
        self._values, self._count = [np.zeros((0, 0, 3), np.uint8)] * 2, 0
        self._drawn, self._copied, self._stream = Event(), (Event(), Event()), None
        if not SIMULATED:
            flag = driver.CUstream_flags.CU_STREAM_NON_BLOCKING
            self._stream = checked(driver.cuStreamCreate(flag))

    def begin(self, image):
        """Queue the copy of a device array, uint8; return that on the host, and an `Event`.

        The latter is to be waited for.
        """
        self._count += 1
        which = self._count % 2
        copied = self._copied[which]
        if self._values[which].shape != image.shape:
            copied.synchronize()
            self._values[which] = pinned(image.shape, np.uint8)
        values = self._values[which]
        if SIMULATED:
            image.copy_to_host(values)
            return values, copied
        self._drawn.record()
        self._drawn.wait(self._stream)
        place, size = _place(image), values.nbytes
        checked(driver.cuMemcpyDtoHAsync(values.ctypes.data, place, size, self._stream))
        copied.record(self._stream)
        copied.wait()  # the next picture overwrites the one on the device
        return values, copied

    def __del__(self):
        if getattr(self, "_stream", None) is not None:
            driver.cuStreamDestroy(self._stream)


class Staging:
    """Pinned memory through which host arrays go to the device; nobody waits.

    From other memory the driver copies a map of 3 MB in 2 to 3 ms, from pinned memory in .2.
    """

    def __init__(self):
        self._bytes, self._used = np.zeros(0, np.uint8), 0

    def send(self, array, values, window=None):
        """Queue the copy of host values to a device array; they may be changed afterwards.

        values : ndarray. Of the shape of the array or with fewer rows, the first
            ones; or of that of the window.
        window : tuple of slice, optional. Rows and columns of the array, of which
            the others stay.
        """
        if SIMULATED:
            array[slice(len(values)) if window is None else window] = values
            return
        if self._used + values.nbytes > len(self._bytes):
            cuda.synchronize()  # it may still be read
            self._used = 0
            if values.nbytes > len(self._bytes):
                self._bytes = pinned(max(2 * values.nbytes, _STAGED), np.uint8)
        staged = self._bytes[self._used : self._used + values.nbytes]
        staged = staged.view(values.dtype).reshape(values.shape)
        staged[...] = values
        self._used += aligned(values.nbytes)
        if window is None:
            copy_to_device(staged, array)
        else:
            _copy_window(staged, array, window)


class SentRows:
    """Rows of the host on the device, in an array that grows where it must.

    array : device array (room, *shape)
    """

    def __init__(self, shape, kind):
        self.array, self._staging = cuda.device_array((1, *shape), kind), Staging()

    def send(self, values):
        """Queue the copy of rows to the first ones of `array`; return it."""
        if len(values) > len(self.array):
            shape, kind = self.array.shape[1:], self.array.dtype
            self.array = cuda.device_array((2 * len(values) + 1024, *shape), kind)
        if len(values):
            self._staging.send(self.array, np.ascontiguousarray(values, self.array.dtype))
        return self.array


def _copy_window(host, array, window):
    """Queue the copy of a contiguous host array to a window of a device array."""
    copy = driver.CUDA_MEMCPY2D()
    copy.srcMemoryType = driver.CUmemorytype.CU_MEMORYTYPE_HOST
    copy.srcHost, copy.srcPitch = host.ctypes.data, host[0].nbytes
    copy.dstMemoryType = driver.CUmemorytype.CU_MEMORYTYPE_DEVICE
    rows, columns = window
    place = _place(array) + rows.start * array.strides[0]
    copy.dstDevice, copy.dstPitch = place + columns.start * array.strides[1], array.strides[0]
    copy.WidthInBytes, copy.Height = host[0].nbytes, len(host)
    checked(driver.cuMemcpy2DAsync(copy, 0))
