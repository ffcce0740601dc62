"""`benchmarks lod --whole`: a drive from one end of a long street to the other, without a gap.

Time and memory of each frame, the legs' maps included. The most
that the process held is counted for each frame by itself, so that the table says where it was.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.chart import COLORS, MARKERS, require_matplotlib, save
from benchmarks.suite import load_line, machine, markdown, peak, quiet, resident
from rainsim import pipeline

EVERY = 3  # frames of the drive, of which one is drawn; the water moves in all
PARTS = 10  # of the way, a row of the table each
FORGET_PEAK = "5"  # to clear_refs, see proc(5)


def measure_whole(scene, ground, path, config, say=quiet):
    """Return a row for each frame of a drive that is drawn, all in order.

    The scene is in chunks; `path` has a camera for each frame.
    """
    sequence, rows, pages = pipeline.FrameSequence(scene, ground, path, config), [], scene.pages
    begins = {-(-leg.first // EVERY) * EVERY for leg in ground.legs}
    before, made = (time.perf_counter(), time.process_time()), 0
    forget_peak()
    for _, report in sequence.frames(range(0, len(path), EVERY)):
        x = scene.ground_frame.to_ground(path[report.index].position)[0]
        number = pages.kept.made + pages.read.made
        rows.append({
            "frame": report.index, "x": float(x), "leg": report.index in begins,
            "ms": (time.perf_counter() - before[0]) * 1e3,
            "cpu_ms": (time.process_time() - before[1]) * 1e3, "read": number - made,
            "resident": resident(), "peak": peak(), "residual": report.ledger["residual"],
        })  # fmt: skip
        say(row_line(rows[-1]))
        before, made = (time.perf_counter(), time.process_time()), number
        forget_peak()
    return rows


def row_line(row):
    """Return a frame of the drive as text."""
    return (
        f"frame {row['frame']}, at {row['x']:4.0f} m: {row['cpu_ms']:6.0f} ms of processors, "
        f"{row['read']} pages read or made, {row['resident'] / 1e9:.2f} GB in all, "
        f"{row['peak'] / 1e9:.2f} GB at most" + ("; a leg begins" if row["leg"] else "")
    )


def forget_peak():
    """Let `peak` count from now on, where the system can."""
    try:
        with open("/proc/self/clear_refs", "w", encoding="ascii") as file:
            file.write(FORGET_PEAK)
    except OSError:
        return


# --- results --------------------------------------------------------------------------------------


def parts_of(rows):
    """Return the rows of a drive in PARTS of the way, without the first frame, which sets up."""
    ends = np.linspace(rows[0]["x"], rows[-1]["x"], PARTS + 1)[1:-1]
    part = np.searchsorted(ends, [row["x"] for row in rows], side="right")
    return [[row for row, k in zip(rows[1:], part[1:], strict=True) if k == n]
            for n in range(PARTS)]  # fmt: skip


def table(result):
    """Return the drive in Markdown, a line for each part of the way."""
    rows, made = result["drive"], result["cut"]
    cells = []
    for part in filter(None, parts_of(rows)):
        cpu, held = ([row[key] for row in part] for key in ("cpu_ms", "resident"))
        cells.append((
            f"{part[0]['x']:.0f} to {part[-1]['x']:.0f}", sum(row["leg"] for row in part),
            f"{np.median(cpu):.0f}", f"{np.percentile(cpu, 90):.0f}", f"{max(cpu):.0f}",
            f"{np.median(held) / 1e9:.2f}", f"{max(row['peak'] for row in part) / 1e9:.2f}",
        ))  # fmt: skip
    later, first = rows[1:], rows[0]
    return "\n".join([
        *markdown(("m along the street", "legs", "ms of processors, median", "tenth decile",
                   "most", "GB after a frame, median", "at most"), cells), "",
        f"{made['splats']} splats on {made['length']:.0f} m, {made['legs']} legs, "
        f"{len(rows)} frames, one of {EVERY} at {result['fps']:g} a second",
        f"set-up: {made['ground']:.1f} s of processors for the ground, then "
        f"{first['cpu_ms'] / 1e3:.1f} s to the first frame, {first['peak'] / 1e9:.2f} GB at most",
        f"then {np.median([row['cpu_ms'] for row in later]):.0f} ms of processors a frame in the "
        f"median, {np.mean([row['cpu_ms'] for row in later]):.0f} in the mean, "
        f"{max(row['peak'] for row in later) / 1e9:.2f} GB at most",
        f"ledger: {max(abs(row['residual']) for row in rows):.1e} of its water at most",
        load_line(result),
    ])  # fmt: skip


def draw(result, path):
    """Draw time and memory along the way to a PNG."""
    pyplot = require_matplotlib()
    figure, axes = pyplot.subplots(2, 1, figsize=(9, 4.6), sharex=True, layout="constrained")
    rows = result["drive"][1:]
    for begins, n, label in ((False, 0, "frames"), (True, 2, "that begin a leg")):
        shown = [row for row in rows if row["leg"] == begins]
        axes[0].plot([row["x"] for row in shown], [row["cpu_ms"] for row in shown], ls="",
                     color=COLORS[n], marker=MARKERS[n], ms=2.5 + n, label=label)  # fmt: skip
    axes[0].set(ylabel="ms of processors", yscale="log", ylim=(100, None))
    axes[0].legend(fontsize=8, loc="center right")
    for key, n, label in (("peak", 1, "at most"), ("resident", 0, "after a frame")):
        axes[1].plot([row["x"] for row in rows], [row[key] / 1e9 for row in rows],
                     color=COLORS[n], lw=1, label=label)  # fmt: skip
    axes[1].set(xlabel="m along the street", ylabel="memory [GB]", ylim=(0, None))
    axes[1].legend(fontsize=8, loc="lower right")
    save(figure, path)


def result_of(scene, ground, path, config, facts, say=quiet):
    """Return the results that `table` and `draw` take, of a drive along a street."""
    rows = measure_whole(scene, ground, path, config, say)
    return {"machine": machine(), "whole": True, "fps": config.fps, "cut": facts, "drive": rows}
