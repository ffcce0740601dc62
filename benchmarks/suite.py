"""The frame of all suites of `benchmarks`: machine, turns, accuracy, memory, Markdown.

A suite is a module with run(quick, say, ...), which returns figures as plain values, table(result),
which returns them as text, and draw(result, path), which draws them to a PNG. `quick` asks for
small sizes, a minute at most; `say` is called with a line of text for each result.
"""

from __future__ import annotations

import os
import platform
import resource
import time
from pathlib import Path

import numpy as np

from rainsim.jit import set_threads
from rainsim.scene.library import list_scenes

SCENES = ("bicycle", "street")
CAPTURE = "garden"  # also measured if a folder of RAINSIM_SCENES holds a scene named so
LEAST_ERROR = 1e-12  # mean squared error, white being 1, below which decibels do not tell


def quiet(line):
    """Hear a line of text and say nothing."""


def scene_names(quick, of=SCENES):
    """Return the scenes of a bench: the first built-in one if it is to be quick."""
    if quick:
        return of[:1]
    return (*of, *(name for name, _, _ in list_scenes() if name == CAPTURE))


def intrinsics(camera):
    """Return the matrix of the lens as three rows: camera frame to homogeneous image points."""
    return [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]


def machine(**more):
    """Return what times depend on, and `more`, as a dict."""
    return {
        "processor": platform.processor() or platform.machine(), "cores": os.cpu_count(),
        "threads": set_threads(None), "python": platform.python_version(),
        "numpy": np.__version__, "load": os.getloadavg(), **more,
    }  # fmt: skip


def load_line(result):
    """Return threads and load of the machine of a result as text."""
    load = ", ".join(f"{x:.1f}" for x in result["machine"]["load"])
    return f"{result['machine']['threads']} threads, load {load}"


def in_turn(jobs, rounds):
    """Run jobs, {name: callable}, in turn, so that the machine's load affects all alike.

    There are as many rounds as asked for and one before them, which compiles. Return {name:
    {least_ms, median_ms}}, processor time.
    """
    times = {name: [] for name in jobs}
    for _ in range(rounds + 1):
        for name, job in jobs.items():
            start = time.process_time()
            job()
            times[name].append((time.process_time() - start) * 1e3)
    return {
        name: {"least_ms": min(t[1:]), "median_ms": float(np.median(t[1:]))}
        for name, t in times.items()
    }


def decibels(squared_error, least=LEAST_ERROR):
    """Return the peak signal-to-noise ratio [dB] of a mean squared error, white being 1."""
    return float(-10 * np.log10(max(squared_error, least)))


def rms(decibel):
    """Return the root mean square error of a peak signal-to-noise ratio, peak 1."""
    return 10 ** (-decibel / 20)


def resident():
    """Return the bytes that this process holds in memory now; 0 where the system does not say."""
    try:
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def peak():
    """Return the most bytes that this process has held."""
    try:
        # getrusage would count the memory of the parent process, from which this one was forked.
        status = Path("/proc/self/status").read_text(encoding="ascii")
        return int(status.partition("VmHWM:")[2].split()[0]) << 10
    except (OSError, IndexError):  # no Linux
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def markdown(head, rows):
    """Return the lines of a Markdown table: `head` and each row a sequence of texts."""
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    return lines + ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
