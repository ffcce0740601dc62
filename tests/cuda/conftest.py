"""numba's CUDA simulator, quicker: its threads take turns instead of racing for the interpreter.

The simulator polls the threads of a block while they run, and holds the interpreter's lock doing
so. Here a thread runs until it waits for the others or ends, and then hands over to the next; the
threads of a block that wait for nobody run in one of the system's. Those are kept from block to
block. Modules whose functions a kernel calls see the simulated `cuda` until it ends, not for each
call anew. Arrays are numpy's own in a kernel, as the simulator's shared ones are.
"""

import operator
import os
import threading
from collections import deque

import numpy as np

if os.environ.get("NUMBA_ENABLE_CUDASIM") == "1":
    from numba import cuda
    from numba.cuda.simulator import kernel as simulator
    from numba.cuda.simulator import kernelapi

    simulator.FakeWithinKernelCUDAArray = operator.attrgetter("_ary")

    class Caller:
        """Stands for `traceback`: where a shared array is made, without the lines of the source."""

        def extract_stack(self, frame):
            """Return the file and the line of the caller, last but one."""
            caller = frame.f_back
            return [(caller.f_code.co_filename, caller.f_lineno), None]

    kernelapi.traceback = Caller()

    class Lane(threading.Thread):
        """Runs threads of a block, one after the other until one waits; between blocks it waits."""

        def __init__(self):
            super().__init__(daemon=True)
            self.turn = threading.Lock()
            self.turn.acquire()
            self.start()

        def take(self, manager, block, job):
            """Get ready for the threads that no lane has begun."""
            self._manager, self.blockIdx, self.job, self.ended = manager, block, job, False

        def run(self):
            while True:
                self.turn.acquire()
                self._work()
                self.ended = True
                self.after.release()

        def _work(self):
            manager = self._manager
            try:
                while manager.waiting:
                    self.threadIdx, self.thread_id = manager.waiting.popleft()
                    self.job()
            except Exception as error:
                manager.failed = manager.failed or error

        def syncthreads(self):
            """Hand over until all others are here, too."""
            self.after.release()
            self.turn.acquire()
            if self._manager.failed is not None:
                raise RuntimeError("another thread of the block failed")

        syncthreads_count = simulator.BlockThread.syncthreads_count
        syncthreads_and = simulator.BlockThread.syncthreads_and
        syncthreads_or = simulator.BlockThread.syncthreads_or

    _idle = []  # lanes without work

    class BlockManager:
        """Runs a block, thread by thread."""

        def __init__(self, function, grid_dim, block_dim, debug):
            self._function = function
            self.block_state = np.zeros(block_dim, dtype=np.bool_)
            self._threads = [
                (simulator.Dim3(x, y, z), x + block_dim[0] * (y + block_dim[1] * z))
                for x, y, z in np.ndindex(*block_dim)
            ]
            self.turn = threading.Lock()
            self.turn.acquire()

        def run(self, grid_point, *arguments):
            """Run the block at a place of the grid."""
            self.waiting, self.failed, lanes = deque(self._threads), None, []
            while self.waiting and self.failed is None:
                lane = _idle.pop() if _idle else Lane()
                lane.take(self, simulator.Dim3(*grid_point), lambda: self._function(*arguments))
                lanes.append(lane)
                self._go([lane])
            while live := [lane for lane in lanes if not lane.ended]:
                self._go(live)
            _idle.extend(lanes)
            if self.failed is not None:
                raise self.failed

        def _go(self, lanes):
            """Let each lane run until its thread waits for the others, or all have ended."""
            for lane, following in zip(lanes, [*lanes[1:], self], strict=True):
                lane.after = following.turn
            lanes[0].turn.release()
            self.turn.acquire()

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
