"""Pictures encoded in other processes, so that the one that draws goes on undisturbed.

Python runs one thread of a process at a time. Threads that encode take turns with the one that
launches a device's kernels, some twenty times a picture: 3 of 7.5 ms a frame on an H200.
"""

import json
import mmap
import os
import select
import signal
import subprocess
import sys
from collections import deque
from contextlib import suppress
from pathlib import Path

import numpy as np

from rainsim.compiling.pool import child_environment
from rainsim.errors import RainsimError
from rainsim.io.fingerprint import hash_of_file

POSSIBLE = hasattr(os, "memfd_create")  # memory that processes share, on Linux


class PictureProcesses:
    """So many processes that encode a picture each; `submit` and `shutdown` as of an executor.

    Results are asked for in the order of pictures, and the first before a picture too many comes.
    """

    def __init__(self, count):
        self._processes = deque(_Process() for _ in range(count))

    def submit(self, picture, path):
        """Begin to write a picture (height, width, 3), uint8; return what has the `result`."""
        self._processes.rotate(-1)
        self._processes[-1].begin(picture, path)
        return self._processes[-1]

    def shutdown(self):
        """End the processes."""
        for process in self._processes:
            process.end()


class _Process:
    """A process that runs `_serve`, and the memory that it shares with this one."""

    def __init__(self):
        self._memory = os.memfd_create("picture")
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, str(self._memory)], pass_fds=[self._memory],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env=child_environment() | {"OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip

    def begin(self, picture, path):
        os.pwrite(self._memory, np.ascontiguousarray(picture).data, 0)
        with suppress(BrokenPipeError):  # `result` says so
            self._process.stdin.write(json.dumps([*picture.shape[:2], str(path)]).encode() + b"\n")
            self._process.stdin.flush()

    def done(self):
        return bool(select.select([self._process.stdout], [], [], 0)[0])

    def result(self):
        """Return the hash of the file that was begun, and the picture of a preview."""
        line = self._process.stdout.readline()
        if not line:
            raise RainsimError(
                f"a process that encodes pictures ended with status {self._process.wait()}; it "
                "must live as long as the run; see that memory suffices, and go on with --resume"
            )
        fault, digest, *shape = json.loads(line)
        if fault:
            raise OSError(*fault)
        small = os.pread(self._memory, int(np.prod(shape)), 0)
        return digest, np.frombuffer(small, np.uint8).reshape(shape)

    def end(self):
        self._process.communicate()
        os.close(self._memory)


def _serve(memory, requests, answers):
    """Write the pictures of requests, lines of JSON; leave previews in the memory."""
    from rainsim.io.images import shrunk, write_png

    for line in requests:
        height, width, path = json.loads(line)
        with mmap.mmap(memory, 0) as shared:
            picture = np.frombuffer(shared[: height * width * 3], np.uint8)
            picture = picture.reshape(height, width, 3)
            try:
                write_png(Path(path), picture)
                small = shrunk(picture)
                shared[: small.size] = small.tobytes()
                answer = [None, hash_of_file(path), *small.shape]
            except OSError as error:
                answer = [[error.errno, error.strerror, error.filename], None]
        answers.write(json.dumps(answer).encode() + b"\n")
        answers.flush()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # what has begun is finished
    _serve(int(sys.argv[1]), sys.stdin.buffer, sys.stdout.buffer)
