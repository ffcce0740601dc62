"""numba's CUDA simulator, quicker: its threads take turns instead of racing for the interpreter.

The simulator polls the threads of a block while they run, and holds the interpreter's lock doing
so. Here a thread runs until it waits for the others or ends, and then hands over; threads are kept
from block to block. Modules whose functions a kernel calls see the simulated `cuda` until it ends,
not for each call anew.
"""

import os
import threading

import numpy as np

if os.environ.get("NUMBA_ENABLE_CUDASIM") == "1":
    from numba import cuda
    from numba.cuda.simulator import kernel as simulator

    class Lane(threading.Thread):
        """A thread of a block; between blocks it waits."""

        def __init__(self):
            super().__init__(daemon=True)
            self._mine, self._manager = threading.Lock(), None
            self._mine.acquire()
            self.start()

        def take(self, manager, block, place, thread_id, job):
            """Get ready for a thread's work; `go` does it."""
            self._manager, self.blockIdx, self.threadIdx = manager, block, place
            self.thread_id, self.job, self.error, self.ended = thread_id, job, None, False
            self.abort = False

        def go(self):
            """Run until the thread waits for the others, or ends."""
            self._mine.release()
            self._manager.handed_back.acquire()

        def run(self):
            while True:
                self._mine.acquire()
                try:
                    self.job()
                except Exception as error:
                    self.error = error
                self.ended = True
                self._manager.handed_back.release()

        def syncthreads(self):
            """Hand over until all others are here, too."""
            self._manager.handed_back.release()
            self._mine.acquire()
            if self.abort:
                raise RuntimeError("another thread of the block failed")

        syncthreads_count = simulator.BlockThread.syncthreads_count
        syncthreads_and = simulator.BlockThread.syncthreads_and
        syncthreads_or = simulator.BlockThread.syncthreads_or

    _idle = []  # lanes without work

    class BlockManager:
        """Runs a block, thread by thread."""

        def __init__(self, function, grid_dim, block_dim, debug):
            self._function, self._block_dim = function, block_dim
            self.block_state = np.zeros(block_dim, dtype=np.bool_)
            self.handed_back = threading.Lock()
            self.handed_back.acquire()

        def run(self, grid_point, *arguments):
            """Run the block at a place of the grid."""
            block, size = simulator.Dim3(*grid_point), self._block_dim
            lanes = []
            for x, y, z in np.ndindex(*size):
                lane = _idle.pop() if _idle else Lane()
                place, number = simulator.Dim3(x, y, z), x + size[0] * (y + size[1] * z)
                lane.take(self, block, place, number, lambda: self._function(*arguments))
                lanes.append(lane)
            live, failed = lanes, None
            while live:
                for lane in live:
                    lane.abort = failed is not None
                    lane.go()
                    failed = failed or lane.error
                live = [lane for lane in live if not lane.ended]
            _idle.extend(lanes)
            if failed is not None:
                raise failed

    _swapped = []  # namespaces whose `cuda` is the simulated one for now
    _names = {}  # by what each function calls `cuda`

    def _swap(function, stand_in):
        spaces, key = function.__globals__, function.__module__
        if key not in _names:
            _names[key] = [n for n, v in spaces.items() if v is cuda or v is stand_in]
        for name in _names[key]:
            if spaces[name] is cuda:
                spaces[name] = stand_in
                _swapped.append((spaces, name))

    whole = simulator.FakeCUDAKernel.__call__

    def call(self, *arguments):
        """Run a kernel or a function that one calls."""
        if self._device:
            _swap(self.fn, simulator._get_kernel_context())
            return self.fn(*arguments)
        try:
            return whole(self, *arguments)
        finally:
            while _swapped:
                spaces, name = _swapped.pop()
                spaces[name] = cuda

    simulator.FakeCUDAKernel.__call__ = call
    simulator.BlockManager = BlockManager
