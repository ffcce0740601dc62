"""Processes that compile the kernels of a run while the run begins.

numba compiles under a lock of its process, so a process compiles one kernel at a time: others
compile beside it and write the cache on disk. A run that comes to a kernel which has not been
compiled yet waits for that kernel alone, and it is taken next.
"""

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections import defaultdict
from pathlib import Path

from rainsim.compiling import waiting
from rainsim.compiling.recorded import TERRAIN

CONTAINER = Path("/sys/fs/cgroup")  # control group of a container, version 2
LIMIT_AND_USE = ("memory.max", "memory.current")
BYTES_OF_A_PROCESS = 700 << 20  # memory of one that compiles the largest kernels
VARIABLE = "RAINSIM_COMPILE_PROCESSES"


def cores():
    """Return how many cores this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def processes(most=None):
    """Return how many processes may compile.

    RAINSIM_COMPILE_PROCESSES gives the number if it is set; otherwise it is one a core, at most
    `most`, and no more than memory allows.
    """
    given = os.environ.get(VARIABLE, "")
    if given.isdecimal():
        return max(int(given), 1)
    count = min(cores(), most or cores())
    memory = free_memory()
    return count if memory is None else max(min(count, memory // BYTES_OF_A_PROCESS), 1)


def child_environment():
    """Return the environment in which a Python process, started with -P, imports as this one."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def free_memory():
    """Return the bytes that processes may take without swapping, None if that is unknown."""
    found = [_available(), _left_to_this_container()]
    return min((size for size in found if size is not None), default=None)


def _available():
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            for line in lines:
                if line.startswith("MemAvailable:"):
                    return int(line.split()[1]) << 10
    except (OSError, ValueError):
        pass
    return None


def _left_to_this_container():
    """Return the bytes left below a container's limit, file cache counted as free; None without."""
    try:
        files = (*LIMIT_AND_USE, "memory.stat")
        limit, used, facts = ((CONTAINER / name).read_text(encoding="ascii") for name in files)
        limit, used = int(limit), int(used)
        facts = dict(line.split() for line in facts.splitlines())
        return max(limit - used + int(facts.get("inactive_file", 0)), 0)
    except (OSError, ValueError):  # ValueError: the limit is "max"
        return None


class _Job:
    """A kernel and all lists of arguments that it must be compiled for."""

    def __init__(self, kernel, entries):
        self.kernel, self.room = kernel, tuple(kernel.split(".")[:2])
        self.arguments = [entry.arguments for entry in entries]
        self.seconds = sum(entry.seconds for entry in entries)
        self.first = any(entry.stage == TERRAIN for entry in entries)
        self.wanted = self.done = False

    def order(self, mine, taken):
        """The sort key: kernels that a run waits for, then its first ones; the longest first.

        Kernels of one room call the same functions, which a process compiles once: it goes on in
        its rooms before it begins a new one, and in those of others last.
        """
        far = 0 if self.room in mine else 2 if self.room in taken else 1
        return (not self.wanted, not self.first, far, -self.seconds)


class Pool:
    """Compiles recorded kernels in other processes until `close`.

    progress : callable, optional. progress(share, done, total, count): the share
        of the work from 0 to 1, kernels done and in all, processes; called from
        other threads as kernels are done.
    environment : dict, optional. Variables that the processes get besides those
        of this one.
    compiled : int. Kernels compiled so far, each list of arguments counted.
    seconds : float. Of one core that they took.
    """

    def __init__(self, entries, count, progress=None, environment=None):
        kernels = defaultdict(list)
        for entry in entries:
            kernels[entry.kernel].append(entry)
        self._jobs = {kernel: _Job(kernel, found) for kernel, found in kernels.items()}
        self._queue, self._rooms = list(self._jobs.values()), set()
        self._changed = threading.Condition()
        self._progress = progress or (lambda share, done, total, count: None)
        self._closed = False
        self._environment = child_environment() | (environment or {})
        self.count = min(count, len(self._jobs))
        self.compiled, self.seconds, self.stale = 0, 0.0, []
        self._processes = [self._start() for _ in range(self.count)]
        self._threads = [
            threading.Thread(target=self._serve, args=(process,), daemon=True)
            for process in self._processes
        ]
        waiting.POOLS.append(self)
        self._report()
        for thread in self._threads:
            thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.close()

    @property
    def finished(self):
        """Whether every kernel has been compiled, or found stale."""
        return all(job.done for job in self._jobs.values())

    def wait_for(self, kernel):
        """Wait until a kernel of this pool has been compiled; others are not waited for."""
        job = self._jobs.get(kernel)
        if job is None:
            return
        with self._changed:
            job.wanted = True
            self._changed.wait_for(lambda: job.done or self._closed)

    def join(self):
        """Wait until all kernels have been compiled."""
        with self._changed:
            self._changed.wait_for(lambda: self.finished or self._closed)

    def close(self):
        """End the processes; kernels that have not been compiled will be when they are called."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for process in self._processes:
            process.kill()
        for thread in self._threads:
            thread.join()
        for process in self._processes:
            process.wait()
            process.stdout.close()
        if self in waiting.POOLS:
            waiting.POOLS.remove(self)

    def _start(self):
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "rainsim.compiling.worker"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            text=True, env=self._environment,
        )  # fmt: skip

    def _serve(self, process):
        """Give a process one kernel after another, until none is left or it ends."""
        mine = set()
        while (job := self._next(mine)) is not None:
            try:
                request = {"kernel": job.kernel, "arguments": job.arguments}
                process.stdin.write(json.dumps(request) + "\n")
                process.stdin.flush()
                answer = json.loads(process.stdout.readline())
            except (OSError, ValueError):  # the process has ended: killed, or short of memory
                answer = {"compiled": 0, "seconds": 0.0, "stale": []}
                self._finish(job, answer)
                break
            self._finish(job, answer)
        with contextlib.suppress(OSError):  # what was not sent any more
            process.stdin.close()
        self._give_up_alone()

    def _next(self, mine):
        with self._changed:
            if self._closed or not self._queue:
                return None
            job = min(self._queue, key=lambda job: job.order(mine, self._rooms))
            self._queue.remove(job)
            mine.add(job.room)
            self._rooms.add(job.room)
            return job

    def _finish(self, job, answer):
        with self._changed:
            job.done = True
            self.compiled += answer["compiled"]
            self.seconds += answer["seconds"]
            self.stale += answer["stale"]
            self._report()
            self._changed.notify_all()

    def _give_up_alone(self):
        """End the wait for kernels that no process is left to compile."""
        with self._changed:
            others = [t for t in self._threads if t is not threading.current_thread()]
            if not any(thread.is_alive() for thread in others):
                for job in self._queue:
                    job.done = True
                self._queue.clear()
                self._report()
                self._changed.notify_all()

    def _report(self):
        """Report how much is done; with the lock held, so that reports come in order."""
        done = [job.seconds for job in self._jobs.values() if job.done]
        total = sum(job.seconds for job in self._jobs.values()) or 1.0
        if not self._closed:
            share = 1.0 if self.finished else sum(done) / total
            self._progress(share, len(done), len(self._jobs), self.count)
