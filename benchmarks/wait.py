"""What a user waits for: the first picture of a capture, from the command to the exit.

Each scene is drawn by `rainsim run` in a process of its own: first without any kept result (with
`--compile` without compiled kernels, too), then again. Figures are those of the whole process.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks import wait_growth
from benchmarks.chart import require_matplotlib, save
from benchmarks.suite import load_line, machine
from rainsim.io.cache import VARIABLE
from rainsim.scene.library import list_scenes

SCENES = "bicycle", "street", "garden", "south", "lund"  # those that RAINSIM_SCENES has
CAMERAS = {"garden": "DSC07965", "south": "P1180150", "lund": "02"}  # else the first one
WIDTH, SMALL = 648, 160  # px


def run(quick, say, backend="cpu", compiled=True, scene=(), growth=False):
    """Return time and memory of first and second runs, see `benchmarks.suite`."""
    if growth:
        return wait_growth.run(quick, say, waited, backend)
    known = {name for name, _, _ in list_scenes()}
    names = scene or [name for name in SCENES[: 1 if quick else None] if name in known]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            kept = {VARIABLE: f"{folder}/{name}"}
            states = [("first run", kept), ("second run", kept)]
            if not compiled:
                empty = {VARIABLE: f"{folder}/own", "NUMBA_CACHE_DIR": f"{folder}/kernels"}
                states.insert(0, ("empty caches", empty))
            for state, variables in states:
                where = Path(folder, "out")
                row = waited(name, where, variables, backend, SMALL if quick else WIDTH)
                rows.append({"scene": name, "run": state, **row})
                say(table_line(rows[-1]))
    return {"machine": machine(backend=backend), "runs": rows}


def waited(name, out, variables, backend, width, *more):
    """Return seconds, processor seconds, peak memory [MB] and stages [s] of one run.

    more : str. Options of the command besides.
    """
    command = [
        sys.executable, "-m", "rainsim", "run", "--scene", name, "--preset", "downpour",
        "--frames", "1", "--width", str(width), "--backend", backend, "--quiet", "--overwrite",
        "--out", str(out), *more,
    ]  # fmt: skip
    command += ["--camera", CAMERAS[name]] if name in CAMERAS else []
    begin = time.perf_counter()
    process = subprocess.Popen(command, env={**os.environ, **variables}, stdout=subprocess.DEVNULL)
    _, code, used = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - begin
    process.returncode = os.waitstatus_to_exitcode(code)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    stages = json.loads((out / "provenance.json").read_text(encoding="utf-8"))["stages"]
    return {
        "seconds": seconds, "processor": used.ru_utime + used.ru_stime,
        "megabytes": used.ru_maxrss / 1024, "stages": stages,
    }  # fmt: skip


def table_line(row):
    """Return a row of the table."""
    stages = ", ".join(f"{name} {time:.1f}" for name, time in row["stages"].items() if time >= 0.05)
    return (
        f"| {row['scene']} | {row['run']} | {row['seconds']:.1f} | {row['processor']:.1f} "
        f"| {row['megabytes']:.0f} | {stages} |"
    )


def table(result):
    """Return the figures as Markdown."""
    if "growth" in result:
        return wait_growth.table(result)
    head = "| scene | | s | s of processor time | MB at most | stages [s] |"
    head += "\n|---|---|---|---|---|---|"
    backend = result["machine"]["backend"]
    about = f"One frame to the disk ({backend}), the whole process; {load_line(result)}."
    return "\n".join([about, "", head, *map(table_line, result["runs"])])


def draw(result, path):
    """Draw the stages of all runs as bars."""
    if "growth" in result:
        return wait_growth.draw(result, path)
    pyplot = require_matplotlib()
    rows = result["runs"][::-1]
    names = [f"{row['scene']}, {row['run']}" for row in rows]
    figure, axis = pyplot.subplots(figsize=(8, 0.5 + 0.35 * len(rows)), layout="constrained")
    left = [0.0] * len(rows)
    for stage in dict.fromkeys(stage for row in result["runs"] for stage in row["stages"]):
        if "beside" in stage:
            continue
        wide = [row["stages"].get(stage, 0.0) for row in rows]
        axis.barh(names, wide, left=left, label=stage)
        left = [a + b for a, b in zip(left, wide, strict=True)]
    axis.set_xlabel("s from the command to the exit")
    axis.legend(fontsize=8)
    save(figure, path)
