"""A queue of copies and launches, recorded once and replayed with one call: a CUDA graph.

A launch through numba costs the host 20 to 60 us; a whole recorded frame costs a few. What is
recorded is fixed: values that change lie in pinned arrays, which recorded copies read each time.
"""

from __future__ import annotations

import itertools

from rainsim.cuda.driver import Event, checked, driver, handle_of
from rainsim.cuda.frame_uniforms import recording
from rainsim.cuda.jit import SIMULATED, cuda

new_version = itertools.count(1).__next__
"""Return a number that nothing allocated before has.

What a queue was recorded with is known by such numbers. Sizes and ids come again: by them a queue
that holds the addresses of freed arrays would be taken for one of the arrays that are there.
"""


class Graph:
    """Work on a stream, recorded; in the simulator `launch` calls the function again.

    stream : numba.cuda.stream
    queue : callable. queue() puts the work on the stream; it must have run
        before, so that all is compiled, and must not wait, allocate or read
        results.
    """

    def __init__(self, stream, queue):
        self._stream = stream
        if SIMULATED:
            self._queue = queue
            return
        self._handle = handle_of(stream)
        mode = driver.CUstreamCaptureMode.CU_STREAM_CAPTURE_MODE_RELAXED
        stream.synchronize()
        with cuda.defer_cleanup():  # garbage is freed before or after, not in the recording
            checked(driver.cuStreamBeginCapture(self._handle, mode))
            try:
                with recording() as self._sent:
                    queue()
            finally:
                recorded = checked(driver.cuStreamEndCapture(self._handle))
        self._run = checked(driver.cuGraphInstantiate(recorded, 0))
        checked(driver.cuGraphDestroy(recorded))
        self._done_before = Event()
        self._done_before.record(stream)

    def launch(self):
        """Queue the recorded work once more, with the uniforms that are set now."""
        if SIMULATED:
            self._queue()
            return
        self._done_before.synchronize()  # its copies may still read the pinned arrays
        for uniforms in self._sent:
            uniforms.commit()
        checked(driver.cuGraphLaunch(self._run, self._handle))
        self._done_before.record(self._stream)

    def wait(self):
        """Wait until the last launch is finished."""
        if not SIMULATED:
            self._done_before.synchronize()

    def __del__(self):
        if hasattr(self, "_run"):
            driver.cuGraphExecDestroy(self._run)


class Repeated:
    """Work on a stream, queued as it is the first time, which compiles, and recorded from then on.

    Parameters are those of `Graph`.
    """

    def __init__(self, stream, queue):
        self._stream, self._queue, self._graph, self._is_compiled = stream, queue, None, False

    def launch(self):
        """Queue the work; the second time this waits for the stream."""
        if not self._is_compiled:
            self._is_compiled = True
            self._queue()
            return
        if self._graph is None:
            self._graph = Graph(self._stream, self._queue)
        self._graph.launch()


def chain(parts):
    """Return a function that calls all of `parts`."""

    def queue():
        for part in parts:
            part()

    return queue
