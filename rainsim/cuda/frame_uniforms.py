"""Small arrays that change from frame to frame, sent to the device in one copy."""

import numpy as np

from rainsim.cuda.driver import Staging, aligned
from rainsim.cuda.jit import SIMULATED, cuda


class FrameUniforms:
    """Named arrays of given (shape, dtype), in `host` and on the device in `device`."""

    def __init__(self, arrays):
        self.host, self.device = {}, {}
        places, size = {}, 0
        for name, (shape, dtype) in arrays.items():
            count = int(np.prod(shape)) * np.dtype(dtype).itemsize
            places[name] = size, size + count
            size += aligned(count)
        self._set, self._staging = np.zeros(size, np.uint8), Staging()
        self._there = None if SIMULATED else cuda.to_device(self._set)
        for name, (shape, dtype) in arrays.items():
            first, end = places[name]
            self.host[name] = self._set[first:end].view(dtype).reshape(shape)
            if SIMULATED:
                self.device[name] = cuda.to_device(self.host[name])
            else:
                self.device[name] = self._there[first:end].view(dtype).reshape(shape)

    def __getitem__(self, name):
        return self.device[name]

    def update(self, **values):
        """Set arrays on the host; `send` copies them to the device."""
        for name, value in values.items():
            self.host[name][...] = value

    def send(self):
        """Queue the copy of all arrays to the device."""
        if SIMULATED:
            for name, values in self.host.items():
                self.device[name].copy_to_device(values)
            return
        self._staging.send(self._there, self._set)
