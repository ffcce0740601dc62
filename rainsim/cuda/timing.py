"""How long the parts of a queue take on the device, by events."""

from __future__ import annotations

import itertools
import time

import numpy as np

from rainsim.cuda.jit import SIMULATED, cuda

REPEATS = 1 if SIMULATED else 15
NAP = 100_000  # ns
NAPS = 200  # before the parts, so that the host has queued all parts when the first begins


@cuda.jit
def wait(naps):
    """Keep the stream waiting for `naps` times NAP nanoseconds."""
    for _ in range(naps):
        cuda.nanosleep(NAP)


def part_times(stream, parts):
    """Return the median milliseconds of each part of a queue, a dict by the names of `parts`.

    stream : numba.cuda.stream
    parts : dict of str to callable. Each puts its part on the stream; they run in
        this order, REPEATS times.
    """
    rows = []
    for _ in range(REPEATS):
        if SIMULATED:
            marks = [time.perf_counter()]
            for part in parts.values():
                part()
                marks.append(time.perf_counter())
            rows.append(np.diff(marks) * 1e3)
            continue
        events = [cuda.event()]
        wait[1, 1, stream](NAPS)
        events[0].record(stream)
        for part in parts.values():
            part()
            events.append(cuda.event())
            events[-1].record(stream)
        stream.synchronize()
        rows.append([a.elapsed_time(b) for a, b in itertools.pairwise(events)])
    return dict(zip(parts, np.median(rows, axis=0).tolist(), strict=True))
