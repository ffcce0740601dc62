"""The calls of the CUDA driver that each frame makes many times, without numba's wrappers.

A frame records and awaits some thirty events. Numba's own calls take the host five times as long.
"""

from __future__ import annotations

from rainsim.cuda.jit import SIMULATED, cuda
from rainsim.errors import BackendError

if SIMULATED:
    driver = None
else:
    from cuda.bindings import driver

    _NO_TIMES = driver.CUevent_flags.CU_EVENT_DISABLE_TIMING


def checked(result):
    """Return the value of a driver's call, or raise BackendError if it failed."""
    code, *values = result
    if int(code) != 0:
        raise BackendError(f"the CUDA driver answered {code.name} to a frame's queue")
    return values[0] if values else None


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
            cuda.current_context()  # without one there are no events
            self._handle = checked(driver.cuEventCreate(_NO_TIMES))

    def record(self, stream):
        """Mark the present end of the stream's queue."""
        if not SIMULATED:
            checked(driver.cuEventRecord(self._handle, handle_of(stream)))

    def wait(self, stream):
        """Let what is queued on the stream from now on wait for the mark."""
        if not SIMULATED:
            checked(driver.cuStreamWaitEvent(handle_of(stream), self._handle, 0))

    def synchronize(self):
        """Let the host wait for the mark."""
        if not SIMULATED:
            checked(driver.cuEventSynchronize(self._handle))

    def __del__(self):
        if hasattr(self, "_handle"):
            driver.cuEventDestroy(self._handle)


def copy_to_host(array, host_out, stream):
    """Queue the copy of a whole contiguous device array to pinned memory of its size."""
    if SIMULATED:
        array.copy_to_host(host_out, stream=stream)
        return
    place = array.__cuda_array_interface__["data"][0]
    checked(
        driver.cuMemcpyDtoHAsync(host_out.ctypes.data, place, host_out.nbytes, handle_of(stream))
    )
