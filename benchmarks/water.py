"""`benchmarks water`: the cases on every scheme at several sizes, error and time per case."""

from __future__ import annotations

import time

import numpy as np

from benchmarks import cases, peers, water_cuda
from benchmarks.chart import draw_fronts, front
from benchmarks.flood_cases import Arrivals
from benchmarks.suite import machine, markdown, quiet
from rainsim.errors import ParameterError
from rainsim.grid import WaterSolver
from rainsim.jit import cpu_kernel, prange, set_threads

SCHEMES = ("auto", "accurate", "lean", "paper")
SUITE = {
    "stoker": (cases.stoker, (128, 256, 512), 0.0015),
    "ritter": (cases.ritter, (128, 256, 512), 0.0016),
    "bowl planar": (cases.bowl_planar, (50, 100, 200), 0.010),
    "bowl radial": (cases.bowl_radial, (50, 100, 200), 0.009),
    "ripple": (cases.ripple, (64, 128, 256), 0.012),
    "rain": (cases.rain, (64, 128, 250), 0.0075),
}
QUICK = {
    "stoker": (64, 128), "ritter": (64, 128), "bowl planar": (30, 50), "bowl radial": (30, 50),
    "ripple": (32, 64), "rain": (64,),
}  # fmt: skip
LAKE_CELLS = {False: 200, True: 32}
REPEATS = {False: 3, True: 1}  # runs of a case, of which the fastest counts
GAUGE_PERIOD = 2.0  # s, between readings of the rain gauge
SPEED_CELLS = {False: 1024, True: 128}
SPEED_ROUNDS = 5  # alternating, of which the median counts
COPY_SIZE = {False: 1 << 25, True: 1 << 20}  # numbers, more than caches hold


def solve(case, scheme, dtype=np.float32):
    """Run a case; return the solver, its last report, the steps, seconds and gauge readings.

    The readings of a flood are arrivals [s].
    """
    solver = WaterSolver(
        case.bed, case.spacing, scheme=scheme, boundary=case.boundary, manning=case.manning,
        gravity=cases.GRAVITY, dtype=dtype, conditions=case.extra.get("conditions", list)(),
    )  # fmt: skip
    solver.set_state(case.depth, u=case.extra.get("u"), v=case.v)
    steps, readings = 0, []
    start = time.perf_counter()
    if "flow" not in case.extra:
        watch = Arrivals(solver, case) if "gauges" in case.extra else None
        report = solver.advance(case.duration, case.extra.get("supply", 0.0), watch)
        steps, readings = report.substeps, watch.times if watch else readings
    else:
        period = case.extra.get("period", GAUGE_PERIOD)
        for n in range(round(case.duration / period)):
            falls = n * period < case.extra["until"]
            report = solver.advance(period, rain=case.extra["rate"] * falls)
            steps += report.substeps
            readings.append((solver.time, _gauge(case, solver)))
    return solver, report, steps, time.perf_counter() - start, readings


def _gauge(case, solver):
    """Return the flow per width [m2/s] from the two cells beside the gauge, or all [m3/s]."""
    if "edge" in case.extra:
        return solver.discharge(case.extra["edge"])
    middle, i = case.bed.shape[0] // 2, round(case.extra["gauge"] / case.spacing)
    u, _ = solver.velocity
    return float((u * solver.depth)[middle, i - 1 : i + 1].mean())


def measure(case, scheme, repeats=1, dtype=np.float32):
    """Return a record of error, time and balance of a case on a scheme."""
    best = None
    for _ in range(repeats):
        solver, report, steps, seconds, readings = solve(case, scheme, dtype)
        best = seconds if best is None else min(best, seconds)
    depth = solver.depth.astype(np.float64)
    if "flow" in case.extra:
        at, flow = np.array(readings).T
        exact = np.interp(at, case.extra["time"], case.extra["flow"])
        error = float(np.abs(flow - exact).sum() / exact.sum())
    else:
        error = cases.error_of(case, depth)
    record = {
        "case": case.name, "cells": case.cells, "scheme": scheme, "error": error,
        "seconds": best, "steps": steps, "max_speed": report.max_speed,
        "residual": report.residual, "reason": report.reason,
    }  # fmt: skip
    if "edge" in case.extra or "gauges" in case.extra:
        record["readings"] = readings
    if case.name == "ripple":
        record["crest"] = cases.crest_of(case, depth)
    return record


def throughput(cells, schemes=("accurate", "lean", "paper"), steps=32):
    """Return {scheme: cells per second} on a wavy lake, in alternating runs, medians."""
    solvers, rates = {scheme: cases.wavy_lake(cells, scheme) for scheme in schemes}, {}
    for scheme, solver in solvers.items():
        solver.advance(1e-3)
        rates[scheme] = []
    span = cases.span_of(cells, steps)
    for _ in range(SPEED_ROUNDS):
        for scheme, solver in solvers.items():
            start = time.perf_counter()
            report = solver.advance(span)
            rates[scheme].append(report.substeps * cells**2 / (time.perf_counter() - start))
    return {scheme: float(np.median(rate)) for scheme, rate in rates.items()}


@cpu_kernel
def copy(a, a_out):
    """Copy an array of shape (n,), float32, with all threads."""
    for c in prange(a.shape[0]):
        a_out[c] = a[c]


def memory_limit(numbers):
    """Return the cells per second of a one-pass step that moves memory as fast as a copy."""
    a, b, best = np.ones(numbers, np.float32), np.zeros(numbers, np.float32), np.inf
    for _ in range(SPEED_ROUNDS):
        start = time.perf_counter()
        copy(a, b)
        best = min(best, time.perf_counter() - start)
    return 2 * a.nbytes / best / cases.CELL_BYTES


def roof(cells, numbers, schemes=("accurate", "lean", "paper")):
    """Return {threads: {"limit": cells a second, scheme: the same}} for one and for all threads."""
    every, found = set_threads(None), {}
    try:
        for threads in sorted({1, every}):
            set_threads(threads)
            found[threads] = {"limit": memory_limit(numbers), **throughput(cells, schemes)}
    finally:
        set_threads(every)
    return found


def run(quick=False, say=quiet, backend="cpu"):
    """Run the whole bench, see `benchmarks.suite`; on a GPU `benchmarks.water_cuda.run`.

    The result has "machine", "records" (a list of dicts), "throughput" (cells per second by
    scheme), "memory_limit" (cells per second) and "roof", what `roof` returns.
    """
    if backend == "cuda":
        return water_cuda.run(quick, say)
    records = []
    for scheme in SCHEMES:  # compile outside the clock: kernels with and without friction
        measure(cases.rain(32), scheme)
        measure(cases.stoker(32), scheme)
    measure(cases.lake(8), "auto", dtype=np.float64)
    for name, (make, sizes, _) in SUITE.items():
        for cells in QUICK[name] if quick else sizes:
            case = make(cells)
            for scheme in SCHEMES:
                records.append(measure(case, scheme, REPEATS[quick]))
                say(line(records[-1]))
    still = cases.lake(LAKE_CELLS[quick])
    for dtype in (np.float32, np.float64):
        records.append(measure(still, "auto", dtype=dtype))
        records[-1]["case"] = f"lake {np.dtype(dtype).name}"
        say(line(records[-1]))
    mark_front(records)
    roofs = roof(SPEED_CELLS[quick], COPY_SIZE[quick])
    for threads, rates in roofs.items():
        limit = rates["limit"]
        for scheme, rate in rates.items():
            share = f"{rate / limit:.0%} of what memory allows a fused step"
            say(f"{scheme:9s} {rate / 1e6:7.1f} million cells a second, {threads} threads, {share}")
    rates = dict(roofs[max(roofs)])
    limit = rates.pop("limit")
    return {
        "machine": machine(dtype="float32"), "quick": quick, "records": records,
        "throughput": rates, "memory_limit": limit, "roof": roofs,
    }  # fmt: skip


def mark_front(records):
    """Note in each record of a case whether no other one beats it in both error and seconds."""
    for name in {record["case"] for record in records}:
        ours = [record for record in records if record["case"] == name]
        best = set(front([(record["seconds"], record["error"]) for record in ours]))
        for record in ours:
            record["front"] = (record["seconds"], record["error"]) in best


def line(record):
    """Return a record of `measure` as a line of text."""
    crest = f"  crest {record['crest']:.3f}" if "crest" in record else ""
    return (
        f"{record['case']:12s} {record['cells']:4d} {record['scheme']:9s} "
        f"error {record['error']:.5f}  {record['seconds']:8.3f} s  {record['steps']:5d} steps  "
        f"ledger {record['residual']:+.0e}{crest}"
    )


def table(result):
    """Return errors and times [s] as a Markdown table, a row per case and size, the front bold.

    On a GPU the table is that of `benchmarks.water_cuda`.
    """
    if "device" in result:
        return water_cuda.table(result)
    records = [record for record in result["records"] if record["case"] in SUITE]
    return "\n".join(front_lines(records, SCHEMES))


def front_lines(records, schemes):
    """Return the lines of `table` for records of some schemes."""
    rows = {}
    for record in records:
        text = f"{record['error']:.4f} / {record['seconds']:.3f}"
        row = rows.setdefault((record["case"], record["cells"]), {})
        row[record["scheme"]] = f"**{text}**" if record["front"] else text
    return markdown(
        ("case", "cells", *schemes),
        [(*key, *(row[scheme] for scheme in schemes)) for key, row in rows.items()],
    )


def draw(result, path):
    """Draw the chart of a result of `run` to a PNG.

    Raises
    ------
    ParameterError
        If it was measured on a GPU, where no errors are.
    """
    if "device" in result:
        raise ParameterError(
            "the bench of the water on a GPU has a table and no chart; leave --chart out"
        )
    panels = {}
    for name, (_, _, least) in SUITE.items():
        lines = {}
        for record in result["records"]:
            if record["case"] == name:
                lines.setdefault(record["scheme"], []).append((record["seconds"], record["error"]))
        panels[name] = {
            "least": least, "lines": lines, "peers": peers.SECONDS_AND_ERRORS.get(name, {}),
        }  # fmt: skip
    title = "Shallow water: error against time (grey: other codes, one thread, processor time)"
    draw_fronts(path, panels, title, default="auto")
