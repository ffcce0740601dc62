"""`benchmarks water --backend cuda`: cells a second of the GPU's solver beside a copy.

The roof is a copy within the device's memory of as many bytes as the least that a step can move:
depth, two velocities and bed read, depth and velocities written; with friction roughness is read
too. Times are wall times of `GpuWaterSolver.advance`, the host's share included.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.cases import CELL_BYTES, span_of, wavy_lake
from benchmarks.suite import machine, markdown, quiet
from rainsim.errors import DivergedError

SIZES = {False: (1024, 2048, 4096, 8192), True: (16,)}  # cells a side
STEPS = {False: 512, True: 4}  # of the smallest map; of larger ones fewer, 64 at least
ROUNDS = {False: 7, True: 1}
COPIES = {False: 20, True: 1}  # in a row
ROUGHNESS = {"without friction": 0.0, "with friction": 0.02}  # s m^(-1/3)
ROUGH_BYTES = 4  # a cell, that friction reads


def run(quick=False, say=quiet):
    """Run the bench; the result has "machine", "device" and "rows"."""
    from rainsim.cuda import require

    require()
    from benchmarks.frame_cuda import machine as gpu

    rows = []
    for cells in SIZES[quick]:
        for name, manning in ROUGHNESS.items():
            rows.append({"cells": cells, "what": name, **measure(cells, manning, quick)})
            say(_line(rows[-1]))
    return {"machine": machine(dtype="float32") | gpu(), "device": True, "quick": quick,
            "rows": rows}  # fmt: skip


def measure(cells, manning, quick):
    """Return steps, cells a second (median and most) and those of a copy of the same bytes."""
    from rainsim.cuda.grid import GpuWaterSolver

    gpu = GpuWaterSolver(wavy_lake(cells, "lean", manning=manning))
    span = span_of(cells, max(STEPS[quick] * SIZES[quick][0] // cells, min(64, STEPS[quick])))
    gpu.advance(span)  # compiles
    size = CELL_BYTES + ROUGH_BYTES * (manning > 0)  # bytes a cell
    limit = _copies(cells**2 * size, quick)
    rates, steps = [], 0
    for _ in range(ROUNDS[quick]):
        start = time.perf_counter()
        steps = gpu.advance(span)
        rates.append(steps * cells**2 / (time.perf_counter() - start))
    if not abs(gpu.ledger.residual) < 1e-4:
        raise DivergedError(f"the water of {cells} x {cells} cells does not stay: {gpu.ledger}")
    return {
        "steps": steps, "rate": float(np.median(rates)), "most": max(rates),
        "limit": cells**2 / limit, "bytes": size,
    }  # fmt: skip


def _copies(count, quick):
    """Return the seconds that the device takes to read and write `count` bytes in all; median."""
    from rainsim.cuda.jit import cuda

    found = []
    a, b = (cuda.to_device(np.zeros(count // 8, np.float32)) for _ in range(2))
    for _ in range(ROUNDS[quick] + 1):
        cuda.synchronize()
        start = time.perf_counter()
        for _ in range(COPIES[quick]):
            b.copy_to_device(a)
        cuda.synchronize()
        found.append((time.perf_counter() - start) / COPIES[quick])
    return float(np.median(found[1:]))


def _line(row):
    return (
        f"{row['cells']:5d} {row['what']:16s} {row['rate'] / 1e6:9.0f} million cells a second "
        f"(most {row['most'] / 1e6:.0f}), copy {row['limit'] / 1e6:.0f}, "
        f"{row['rate'] / row['limit']:.0%}, {row['steps']} steps"
    )


def table(result):
    """Return the rows as a Markdown table."""
    return "\n".join(
        markdown(
            ("cells", "what", "Mcell/s", "most", "a copy's", "share", "bytes a cell"),
            [
                (f"{row['cells']} x {row['cells']}", row["what"], f"{row['rate'] / 1e6:.0f}",
                 f"{row['most'] / 1e6:.0f}", f"{row['limit'] / 1e6:.0f}",
                 f"{row['rate'] / row['limit']:.0%}", row["bytes"])
                for row in result["rows"]
            ],
        )
    )  # fmt: skip
