"""Freed arrays go back to the system where big captures are drawn; threads share heaps."""

import platform
import subprocess
import sys

import pytest

from rainsim.io import allocator

PROBE = """
import os, sys
import numpy as np
from rainsim.io import allocator

def resident():
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

if sys.argv[1] == "set":
    assert allocator.return_large_blocks()
before = resident()
np.ones(30_000_000 // 8)  # freed: glibc alone now serves blocks of 30 MB from its heap
large, small = [], []
for _ in range(100):
    large.append(np.ones(250_000))  # 2 MB
    small.append(np.ones(10_000))  # 80 kB, which lies between two of these
del large
print(resident() - before)
"""


def left_over(how):
    """Bytes that a process still holds after 200 MB of arrays were freed."""
    run = subprocess.run(
        [sys.executable, "-c", PROBE, how], capture_output=True, text=True, check=True
    )
    return int(run.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the setting is glibc's")
def test_freed_arrays_leave_the_process(monkeypatch):
    for name in allocator.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    assert left_over("set") < 40e6
    assert left_over("not") > 150e6  # so the setting is what does it


THREADS = """
import sys, threading
from rainsim.io import allocator

if sys.argv[1] == "set":
    assert allocator.share_heaps()
together = threading.Barrier(8)

def work():
    together.wait()
    kept.append([bytearray(600) for _ in range(2000)])
    together.wait()

kept = []
threads = [threading.Thread(target=work) for _ in range(8)]
[thread.start() for thread in threads], [thread.join() for thread in threads]
with open("/proc/self/maps", encoding="ascii") as lines:  # a heap reserves 64 MB, in line
    unused = [line.split()[0].split("-") for line in lines if " ---p " in line]
ends = [[int(n, 16) for n in part] for part in unused]
print(sum(end - begin > 2**20 and begin % 2**26 != 0 == end % 2**26 for begin, end in ends))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the setting is glibc's")
def test_threads_share_heaps(monkeypatch):
    for name in allocator.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    heaps = [
        int(subprocess.run([sys.executable, "-c", THREADS, how], capture_output=True, text=True,
                           check=True).stdout)
        for how in ("set", "not")
    ]  # fmt: skip
    assert heaps[0] <= allocator.HEAPS < 6 <= heaps[1]


def test_a_users_own_setting_stays(monkeypatch):
    monkeypatch.setenv("MALLOC_MMAP_THRESHOLD_", "1000000")
    assert not allocator.return_large_blocks()


def test_another_c_library_is_left_alone(monkeypatch):
    for name in allocator.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(allocator.ctypes, "CDLL", lambda name: object())
    assert not allocator.return_large_blocks()
