"""The calls of the CUDA driver that each frame makes many times, without numba's wrappers.

A frame records and awaits some thirty events. Numba's own calls take the host five times as long.
"""

from __future__ import annotations

import contextlib
from functools import partial

import numpy as np

from rainsim.cuda.jit import SIMULATED, cuda, pinned
from rainsim.errors import BackendError

if SIMULATED:
    driver = None
else:
    from cuda.bindings import driver

    _NO_TIMES = driver.CUevent_flags.CU_EVENT_DISABLE_TIMING


_ALIGN = 16  # bytes


def aligned(count):
    """Return the bytes that `count` of them take up where arrays lie one after another."""
    return -(-count // _ALIGN) * _ALIGN


def checked(result):
    """Return the value of a driver's call, or raise BackendError if it failed."""
    code = result[0]
    if code:
        raise BackendError(f"the CUDA driver answered {code.name} to a frame's queue")
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


def handle_of(stream):
    """Return the driver's handle of a numba stream; 0: the default one."""
    return driver.CUstream(0 if stream == 0 else stream.__cuda_stream__()[1])


class Event:
    """A place in the queue of a stream that other streams or the host wait for.

    One that was never recorded keeps nobody waiting. In the simulator, where all work is done at
    once, nothing happens.
    """

    def __init__(self):
        if not SIMULATED:
            prepare()  # without a context there are no events
            self._handle = checked(driver.cuEventCreate(_NO_TIMES))

    def record(self, stream):
        """Mark the present end of the stream's queue."""
        if not SIMULATED:
            checked(driver.cuEventRecord(self._handle, handle_of(stream)))

    def record_outside(self, stream):
        """Mark it for who waits outside of a recorded queue: each launch of that marks it again."""
        if not SIMULATED:
            handle = handle_of(stream)
            is_recorded = int(checked(driver.cuStreamIsCapturing(handle))) != 0
            checked(driver.cuEventRecordWithFlags(self._handle, handle, int(is_recorded)))

    def wait(self, stream):
        """Let work that is queued on the stream from now on wait for the mark."""
        if not SIMULATED:
            checked(driver.cuStreamWaitEvent(handle_of(stream), self._handle, 0))

    @property
    def is_past(self):
        """Whether all work before the mark is done."""
        return SIMULATED or int(driver.cuEventQuery(self._handle)[0]) == 0

    def synchronize(self):
        """Let the host wait for the mark."""
        if not SIMULATED:
            checked(driver.cuEventSynchronize(self._handle))

    def __del__(self):
        if hasattr(self, "_handle"):
            driver.cuEventDestroy(self._handle)


def to_device(array, stream=0):
    """Return a copy of a host array on the device, once it is there.

    A copy from memory that is not pinned may read it after the call has returned, when the array
    may be gone. Nor would another stream wait for it.
    """
    found = cuda.to_device(array, stream)
    _wait(found, stream)
    return found


def send(array, values, stream=0):
    """Copy host values to a device array and wait until they are there, see `to_device`."""
    array.copy_to_device(values, stream=stream)
    _wait(array, stream)


def fetch(array, stream=0):
    """Return a copy of a device array on the host, once it is there."""
    found = array.copy_to_host(stream=stream)
    _wait(array, stream)
    return found


class Staging:
    """Pinned memory through which host arrays go to the device, on a stream; nobody waits.

    From other memory the driver copies a map of 3 MB in 2 to 3 ms, from pinned memory in .2.

    stream : numba.cuda.stream
    """

    def __init__(self, stream=0):
        self._stream, self._bytes, self._used = stream, np.zeros(0, np.uint8), 0

    def send(self, array, values, window=None):
        """Queue the copy of host values to a device array; they may be changed afterwards.

        array : device array. Contiguous, unless a window is sent.
        values : ndarray. Of the shape of the array, or of the window.
        window : tuple of slice, optional. Rows and columns of the array, of which
            the others stay.
        """
        if SIMULATED:
            array[... if window is None else window] = values
            return
        if self._used + values.nbytes > len(self._bytes):
            _wait(array, self._stream)  # it may still be read
            self._used = 0
            if values.nbytes > len(self._bytes):
                self._bytes = pinned(2 * values.nbytes, np.uint8)
        staged = self._bytes[self._used : self._used + values.nbytes]
        staged = staged.view(values.dtype).reshape(values.shape)
        staged[...] = values
        self._used += aligned(values.nbytes)
        if window is None:
            array.copy_to_device(staged, stream=self._stream)
        else:
            _copy_window(staged, array, window, self._stream)


def _copy_window(host, array, window, stream):
    """Queue the copy of a contiguous host array to a window of a device array."""
    copy = driver.CUDA_MEMCPY2D()
    copy.srcMemoryType = driver.CUmemorytype.CU_MEMORYTYPE_HOST
    copy.srcHost, copy.srcPitch = host.ctypes.data, host[0].nbytes
    copy.dstMemoryType = driver.CUmemorytype.CU_MEMORYTYPE_DEVICE
    rows, columns = window
    place = array.__cuda_array_interface__["data"][0] + rows.start * array.strides[0]
    copy.dstDevice, copy.dstPitch = place + columns.start * array.strides[1], array.strides[0]
    copy.WidthInBytes, copy.Height = host[0].nbytes, len(host)
    checked(driver.cuMemcpy2DAsync(copy, handle_of(stream)))


def _wait(array, stream):
    """Wait for the stream that numba has copied on: that of the array if none is given."""
    if not SIMULATED and (stream or array.stream):
        (stream or array.stream).synchronize()


def copy_to_host(array, host_out, stream):
    """Queue the copy of a whole contiguous device array to pinned memory of its size."""
    if SIMULATED:
        array.copy_to_host(host_out, stream=stream)
        return
    place = array.__cuda_array_interface__["data"][0]
    checked(
        driver.cuMemcpyDtoHAsync(host_out.ctypes.data, place, host_out.nbytes, handle_of(stream))
    )
