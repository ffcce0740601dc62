"""Device memory that shows what is read before it is written, after it is freed, or beyond its end.

`NUMBA_CUDA_MEMORY_MANAGER=guarded` has numba take it from here: fresh and
freed memory is full of one byte, that of RAINSIM_SPOIL (hexadecimal), and some bytes follow each
array that nobody may write. 3f makes plausible floats and whole numbers far beyond any list; ff
makes NaN and -1. Pictures must have the same bytes as without.

In the simulator `spoil_simulated` does it for fresh arrays.
"""

import os

import numpy as np

BYTE = int(os.environ.get("RAINSIM_SPOIL", "3f"), 16)
MANAGER = "NUMBA_CUDA_MEMORY_MANAGER"
GUARD = 256  # bytes after each array
SIMULATED = os.environ.get("NUMBA_ENABLE_CUDASIM") == "1"


def spoil_simulated():
    """Fill fresh arrays of numba's simulator."""
    from numba import cuda

    make = cuda.device_array

    def spoilt(shape, dtype=np.float64, **options):
        host = np.full(np.empty(shape, dtype).nbytes, BYTE, np.uint8)
        if np.dtype(dtype) == np.bool_:
            host[:] = 1
        array = make(shape, dtype, **options)
        if array.size:
            array.copy_to_device(host.view(dtype).reshape(shape))
        return array

    cuda.device_array = spoilt


if not SIMULATED and os.environ.get(MANAGER) == "guarded":
    from numba.cuda.cudadrv import driver as numba_driver

    driver = numba_driver.driver

    class _Spoiling(numba_driver._PendingDeallocs):
        """Frees later, but spoils at once; not while a queue is recorded, when clearing is off."""

        def add_item(self, dtor, handle, size=numba_driver._SizeNotSet):
            """Take what is to be freed."""
            if size and not self.is_disabled:
                try:
                    driver.cuMemsetD8(handle, BYTE, int(size))
                except numba_driver.CudaAPIError:  # of a thread without the context
                    pass
            super().add_item(dtor, handle, size)

    class _numba_memory_manager(numba_driver.NumbaCUDAMemoryManager):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            self.deallocations = _Spoiling()

        def memalloc(self, size):
            """Return spoilt memory with a guard behind it."""
            memory = super().memalloc(size + GUARD)
            memory._mem.size = memory._mem._cuda_memsize_ = size
            driver.cuMemsetD8(memory._mem.device_pointer, BYTE, size + GUARD)
            return memory


def damaged():
    """Return the sizes of living arrays that something was written behind; waits for the device."""
    from numba import cuda

    manager = None if SIMULATED else cuda.current_context().memory_manager
    if type(manager).__name__ != "_numba_memory_manager":
        return []
    cuda.synchronize()
    found, tail = [], np.empty(GUARD, np.uint8)
    for memory in list(manager.allocations.values()):
        place = int(memory.device_pointer) + memory.size
        driver.cuMemcpyDtoH(numba_driver.host_pointer(tail), place, GUARD)
        if (tail != BYTE).any():
            found.append(memory.size)
    return found
