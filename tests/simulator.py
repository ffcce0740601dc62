"""The tests of the CUDA twins in numba's simulator, in a process of their own.

The simulator is chosen when numba is first imported, and runs in one thread.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile

import pytest

QUICK = ("raster", "shading", "water", "edges", "streaks", "drops", "drips")
"""What the default suite runs."""


class Simulator:
    """A running process of tests/cuda/simulated_NAME.py for each of the names."""

    KEY = pytest.StashKey()

    def __init__(self, root, names):
        own = {"NUMBA_ENABLE_CUDASIM": "1", "RAINSIM_TEST_CACHE": os.environ["NUMBA_CACHE_DIR"]}
        self.said = tempfile.TemporaryFile("w+")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider",
             *(f"tests/cuda/simulated_{name}.py" for name in names)],
            cwd=root, env=os.environ | own, stdout=self.said, stderr=subprocess.STDOUT,
        )  # fmt: skip

    def finish(self):
        """Wait for the end and return the exit code and the output."""
        code = self.process.wait()
        self.said.seek(0)
        said = self.said.read()
        self.said.close()
        return code, said

    def end(self):
        """Kill the process if nobody waited for it."""
        if self.process.poll() is None:
            self.process.kill()
            self.finish()
