"""`benchmarks hydraulics`: analytic cases and hydrographs, and how errors fall with the grid.

Beside the dam breaks and a bowl of `benchmarks water` there are flows that stand still (a bump,
MacDonald's channels), rain on planes and a V-catchment, on every scheme in float32 and float64.
Floods through streets and over plains are compared with a run on cells of half the size.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import cases, flood_cases, held_cases, hydraulic_cases, water
from benchmarks.chart import draw_fronts, draw_orders
from benchmarks.flood_cases import PUBLISHED_SPAN
from benchmarks.suite import machine, markdown, quiet
from rainsim.jit import set_threads

# name of a method: scheme and type of the fields
METHODS = {
    "accurate": ("accurate", np.float32), "accurate 64": ("accurate", np.float64),
    "lean": ("lean", np.float32), "lean 64": ("lean", np.float64),
    "paper": ("paper", np.float32), "paper 64": ("paper", np.float64),
}  # fmt: skip
# case: what makes it, the sizes, the sizes of a quick run
SUITE = {
    "stoker": (cases.stoker, (128, 256, 512), (64, 128)),
    "ritter": (cases.ritter, (128, 256, 512), (64, 128)),
    "bowl planar": (cases.bowl_planar, (50, 100, 200), (30, 60)),
    "bump": (hydraulic_cases.bump, (140, 280, 560), (70, 140)),
    "bump, jump": (held_cases.bump_jump, (100, 200, 400), (50, 100)),
    "bump, tranquil": (held_cases.bump_tranquil, (100, 200, 400), (50, 100)),
    "macdonald, tranquil": (held_cases.macdonald_tranquil, (50, 100, 200), (30, 60)),
    "macdonald": (hydraulic_cases.macdonald, (50, 100, 200), (30, 60)),
    "macdonald rain": (hydraulic_cases.macdonald_rain, (50, 100, 200), (30, 60)),
    "macdonald rain, carried": (hydraulic_cases.macdonald_carried, (50, 100, 200), (30, 60)),
    "plane 0.5 %": (hydraulic_cases.plane_gentle, (60, 120, 240), (30, 60)),
    "plane 2 %": (hydraulic_cases.plane_middle, (60, 120, 240), (30, 60)),
    "plane 10 %": (hydraulic_cases.plane_steep, (60, 120, 240), (30, 60)),
    "catchment": (hydraulic_cases.catchment, (81, 162, 243), (81,)),
    "street": (flood_cases.street, (60, 120, 240), (30, 60)),
    "EA 2, hollows": (flood_cases.hollows, (20, 40, 80), (20,)),
    "EA 4, plain": (flood_cases.plain, (50, 100, 200), (25, 50)),
    "EA 6A, flume": (flood_cases.flume, (179, 358, 716), (179,)),
}
REPEATS = {False: 2, True: 1}  # runs of a case, of which the fastest counts
NEARLY = 0.95  # of the steady flow, whose time is compared
LEFT_OUT = {
    "EA 1, 3, 5, 6B, 7, 8A and 8B": "no description with numbers of their ground was opened",
    "channels that the water enters fast": "no edge takes depth and speed at once",
    "Dressler's dam break": "Chezy's friction, of which the solver has none, and it is asymptotic",
    "Thacker's bowl with friction": "linear in the velocity (Sampson et al. 2006); the solver has "
    "Manning's and a laminar film's",
}


def measure(name, cells, method, repeats=1, fine=None):
    """Return the record of `water.measure` of a case by its name in `SUITE`.

    A flood is compared with a run on `fine` cells, by default twice as many.
    """
    make = SUITE[name][0]
    case = make(cells)
    scheme, dtype = METHODS[method]
    if "gauges" in case.extra:
        depth, arrivals = flood_cases.refined(make, fine or 2 * cells, water.solve)
        case = replace(case, exact=flood_cases.mean_of(depth, case.bed.shape[0]))
    record = water.measure(case, scheme, repeats, dtype)
    record.update(case=name, scheme=method)
    readings = record.pop("readings", None)
    if "gauges" in case.extra:
        record["flood"] = _flood(readings, arrivals)
    elif readings:
        record["catchment"] = _hydrograph(case, readings)
    return record


def _flood(arrivals, exact):
    """Return how arrivals [s] compare with those of the refined run."""
    both = ~np.isnan(arrivals) & ~np.isnan(exact)
    late = np.abs(arrivals - exact)[both]
    return {
        "late": float(late.mean() / exact[both].mean()) if both.any() else math.nan,
        "reached": int(np.isfinite(arrivals).sum()), "should": int(np.isfinite(exact).sum()),
        "of": len(exact),
    }  # fmt: skip


def _hydrograph(case, readings):
    """Return how a hydrograph compares with kinematic theory, and with the balance of volume."""
    at, flow = (np.array(numbers) for numbers in zip(*readings, strict=True))
    exact = np.interp(at, case.extra["time"], case.extra["flow"])
    steady = case.extra["rate"] * case.bed.size * case.spacing**2
    volume = np.trapezoid(exact, at)
    return {
        "steady": float(flow[at <= case.extra["until"]][-1] / steady),
        "reached": float(at[np.argmax(flow >= NEARLY * steady)]),
        "reached_in_theory": float(at[np.argmax(exact >= NEARLY * steady)]),
        "volume": float(np.trapezoid(flow, at) / volume),
    }


def in_span(cells, method):
    """Return at how many places of `flood_cases.PUBLISHED_SPAN` a run of EA 4 is within it."""
    case, (scheme, dtype) = flood_cases.plain(cells), METHODS[method]
    solver, *_ = water.solve(case, scheme, dtype)
    return flood_cases.in_published_span(solver.depth, case.spacing)


def at_sill(method):
    """Return which share of the inflow leaves over `hydraulic_cases.sill`, and the depth [m].

    After the case's duration, over a third of it, and in the last cell but one at the end.
    """
    case, (scheme, dtype) = hydraulic_cases.sill(), METHODS[method]
    solver, *_ = water.solve(case, scheme, dtype)
    before, third, rain = solver.ledger.outflow, case.duration / 3, case.extra["supply"]
    after = solver.advance(third, rain=rain).ledger.outflow
    leaves = (after - before) / (float(rain.sum()) * case.spacing**2 * third)
    return {"leaves": leaves, "depth": float(solver.depth[0, -2])}


def orders(records):
    """Return {(case, method): order}: log of the errors' ratio over that of the cells.

    From the coarsest to the finest grid; cases of one size have none.
    """
    grouped = {}
    for record in records:
        key = record["case"], record["scheme"]
        grouped.setdefault(key, []).append((record["cells"], record["error"]))
    found = {}
    for key, points in grouped.items():
        (few, first), (many, last) = min(points), max(points)
        if many > few:
            found[key] = math.log(first / last) / math.log(many / few)
    return found


def run(quick=False, say=quiet):
    """Run the whole bench, see `benchmarks.suite`.

    The result has "machine", "quick", "records" (a list of dicts), "orders" ({case: {method:
    order}}), "sill" and "in_span" ({method: what `at_sill` and `in_span` return}) and "left_out"
    ({case: reason}).
    """
    threads = set_threads(None)
    set_threads(1)  # maps of four rows: a second thread only waits, long if the machine is busy
    try:
        return _run(quick, say)
    finally:
        set_threads(threads)


def _run(quick, say):
    records = []
    for method in METHODS:  # compile outside the clock
        measure("macdonald", 10, method)
        measure("plane 2 %", 20, method)
    for name, (_, *sizes) in SUITE.items():
        for cells in sizes[quick]:
            for method in METHODS:
                fine = 2 * sizes[quick][-1]
                records.append(measure(name, cells, method, REPEATS[quick], fine))
                say(water.line(records[-1]))
    water.mark_front(records)
    by_case = {}
    for (name, method), order in orders(records).items():
        by_case.setdefault(name, {})[method] = order
    return {
        "machine": machine(dtype="float32, float64"), "quick": quick, "records": records,
        "orders": by_case, "sill": {method: at_sill(method) for method in METHODS},
        "in_span": {method: in_span(50, method) for method in METHODS},
        "left_out": LEFT_OUT,
    }  # fmt: skip


def table(result):
    """Return errors and times [s], orders, and the catchment's hydrographs as Markdown tables."""
    orders_ = [
        (name, *(f"{order[method]:.2f}" for method in METHODS))
        for name, order in result["orders"].items()
    ]
    hydrographs = [
        (r["scheme"], r["cells"], f"{found['steady']:.4f}", f"{found['reached']:.0f}",
         f"{found['reached_in_theory']:.0f}", f"{found['volume']:.4f}")
        for r in result["records"] if (found := r.get("catchment"))
    ]  # fmt: skip
    floods = [
        (r["case"], r["cells"], r["scheme"], f"{found['late']:.1%}",
         f"{found['reached']} / {found['should']} / {found['of']}")
        for r in result["records"] if (found := r.get("flood")) and "64" not in r["scheme"]
    ]  # fmt: skip
    sill = [
        (name, *(format(result["sill"][method][key], form) for method in METHODS))
        for name, key, form in (
            ("share that leaves", "leaves", ".3f"), ("depth [m]", "depth", ".2f")
        )
    ]  # fmt: skip
    reached = f"{NEARLY:.0%} reached [s]", "in theory [s]"
    places = f"EA 4: depths within the packages' span, of {len(PUBLISHED_SPAN)}"
    sill.append((places, *(result["in_span"][method] for method in METHODS)))
    reached_of = "reached / should / gauges"
    return "\n".join([
        *water.front_lines(result["records"], METHODS), "",
        *markdown(("order", *METHODS), orders_), "",
        *markdown(
            ("catchment", "cells", "steady flow", *reached, "volume left over theory's"),
            hydrographs,
        ), "",
        *markdown(("flood", "cells", "scheme", "arrival off by", reached_of), floods),
        "",
        *markdown(("sill at an open edge, and EA 4", *METHODS), sill), "", "Left out:", "",
        *(f"- {name}: {reason}" for name, reason in result["left_out"].items()),
    ])  # fmt: skip


def draw(result, path):
    """Draw error against time to a PNG, and error against cells to one beside it, -orders."""
    panels, orders_ = {}, {}
    for record in result["records"]:
        lines = panels.setdefault(record["case"], {"lines": {}})["lines"]
        lines.setdefault(record["scheme"], []).append((record["seconds"], record["error"]))
        if "64" not in record["scheme"] and record["case"] in result["orders"]:
            lines = orders_.setdefault(record["case"], {})
            lines.setdefault(record["scheme"], []).append((record["cells"], record["error"]))
    beside = Path(path).with_name(f"{Path(path).stem}-orders.png")
    draw_orders(beside, orders_, "Hydraulics: how errors fall with the grid (float32)")
    draw_fronts(path, panels, "Hydraulics: error against time (one thread; 64: float64)")
