"""Small arrays that change from frame to frame, sent to the device in one copy.

The host sets the next frame's values while the device still draws the frame before, which may copy
late. So the copy reads a pinned buffer of its own, which `commit` fills: a recorded queue calls it
for all uniforms that it sends, just before it is launched.
"""

from __future__ import annotations

import contextlib

import numpy as np

from rainsim.cuda.driver import aligned
from rainsim.cuda.jit import SIMULATED, cuda, pinned
from rainsim.cuda.small_copies import copy_small

_recorded = []  # lists of those sent while a queue is recorded, see `recording`


@contextlib.contextmanager
def recording():
    """Yield the list of the `FrameUniforms` that are sent inside the context."""
    _recorded.append([])
    try:
        yield _recorded[-1]
    finally:
        _recorded.pop()


class FrameUniforms:
    """Named arrays, on the host in `host` and on the device in `device`, at fixed addresses.

    A captured graph reads what `commit` has last copied.

    stream : cuda.stream
    arrays : dict of str to (shape, dtype)
    """

    def __init__(self, stream, arrays):
        self.stream, self.host, self.device = stream, {}, {}
        places, size = {}, 0
        for name, (shape, dtype) in arrays.items():
            count = int(np.prod(shape)) * np.dtype(dtype).itemsize
            places[name] = size, size + count
            size += aligned(count)
        self._bytes, self._set = pinned(size, np.uint8), np.zeros(size, np.uint8)
        # Through these no copy lets go of Python's lock, which another thread may keep for long.
        self._views = memoryview(self._bytes), memoryview(self._set)
        self._sent = None if SIMULATED else cuda.to_device(self._bytes, stream)
        for name, (shape, dtype) in arrays.items():
            first, end = places[name]
            self.host[name] = self._set[first:end].view(dtype).reshape(shape)
            if SIMULATED:
                self.device[name] = cuda.to_device(self.host[name])
            else:
                self.device[name] = self._sent[first:end].view(dtype).reshape(shape)

    def __getitem__(self, name):
        return self.device[name]

    def update(self, **values):
        """Set arrays on the host; `send` copies them to the device."""
        for name, value in values.items():
            self.host[name][...] = value

    def commit(self):
        """Fill the pinned buffer with the present values; its last copy must be finished."""
        pinned_bytes, now = self._views
        pinned_bytes[:] = now

    def send(self, stream=None):
        """Queue the copy of all arrays to the device, on another stream than its own if given."""
        self.commit()
        for sent in _recorded:
            sent.append(self)
        if SIMULATED:
            for name, values in self.host.items():
                self.device[name].copy_to_device(values)
        else:
            copy_small(self._bytes, self._sent, self.stream if stream is None else stream)
