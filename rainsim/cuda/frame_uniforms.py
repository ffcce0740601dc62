"""Small arrays that change from frame to frame, sent to the device in one copy."""

import numpy as np

from rainsim.cuda.driver import send
from rainsim.cuda.jit import cuda

ALIGN = 16  # bytes


class FrameUniforms:
    """Named arrays of given (shape, dtype), in `host` and on the device in `device`."""

    def __init__(self, arrays):
        self.host, self.device, first = {}, {}, 0
        sizes = {
            name: int(np.prod(shape)) * np.dtype(dtype).itemsize
            for name, (shape, dtype) in arrays.items()
        }
        self._set = np.zeros(sum(-(-size // ALIGN) * ALIGN for size in sizes.values()), np.uint8)
        self._there = cuda.to_device(self._set)
        for name, (shape, dtype) in arrays.items():
            part = slice(first, first + sizes[name])
            self.host[name] = self._set[part].view(dtype).reshape(shape)
            self.device[name] = self._there[part].view(dtype).reshape(shape)
            first += -(-sizes[name] // ALIGN) * ALIGN

    def __getitem__(self, name):
        return self.device[name]

    def update(self, **values):
        """Set arrays on the host; `send` copies them to the device."""
        for name, value in values.items():
            self.host[name][...] = value

    def send(self):
        """Copy all arrays to the device."""
        send(self._there, self._set)
