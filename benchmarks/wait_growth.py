"""`benchmarks wait --growth`: how the wait for the first picture grows with what is drawn.

One quantity varies at a time: the splats of the scene, the cells of its map, the pixels of the
picture. Each run is a process of its own, from the command to the exit: a first one without any
kept result, and second ones. The exponent is that of `growth.exponent`.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import imageio.v3 as imageio
import numpy as np

from benchmarks.chart import COLORS, MARKERS, log_ticks, require_matplotlib, save
from benchmarks.growth import exponent, halved
from benchmarks.suite import load_line, machine, markdown
from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.io.cache import VARIABLE
from rainsim.scene.folder import write_scene
from rainsim.scene.library import load_scene

SCENE = "bicycle"
SPLATS = {False: (0.5, 1, 2, 4), True: (1,)}  # times those of the scene
SPACINGS = {False: (0.04, 0.02, 0.014, 0.01), True: (0.08,)}  # m
WIDTHS = {False: (324, 648, 1296, 2592), True: (96,)}  # px
USUAL = {False: (0.02, 648), True: (0.08, 96)}  # m and px, of what does not vary
ROUNDS = {False: 3, True: 1}
QUANTITIES, RUNS = ("splats", "cells", "pixels"), ("first run", "second run")


def run(quick, say, waited, backend="cpu"):
    """Return the runs for each quantity, see `benchmarks.suite`; `waited` is `wait.waited`."""
    scene, rows = load_scene(SCENE), []
    spacing, width = USUAL[quick]
    with tempfile.TemporaryDirectory() as folder:
        scenes = {share: _written(scene, share, folder) for share in {1, *SPLATS[quick]}}
        whole = scenes[1]
        cases = [
            *(("splats", where, spacing, width) for _, where in sorted(scenes.items())),
            *(("cells", whole, cell, width) for cell in SPACINGS[quick]),
            *(("pixels", whole, spacing, wide) for wide in WIDTHS[quick]),
        ]
        cells = {cell: _cells(scene, cell) for _, _, cell, _ in cases}
        for n in range(ROUNDS[quick]):
            for k, (quantity, (count, where), cell, wide) in enumerate(cases):
                kept = {VARIABLE: f"{folder}/kept-{k}-{n}"}
                for state in RUNS:
                    out = Path(folder, "out")
                    row = waited(where, out, kept, backend, wide, "--spacing", str(cell))
                    counts = {"splats": count, "cells": cells[cell], "pixels": _pixels(out)}
                    row["count"] = counts[quantity]
                    rows.append({"quantity": quantity, "run": state, **row})
                    say(f"{quantity} {row['count']}, {state}: {row['seconds']:.2f} s")
    return {"machine": machine(backend=backend), "growth": rows}


def _written(scene, share, folder):
    """Write the scene with `share` times its splats; return their number and the folder."""
    splats = scene.splats
    if share < 1:
        splats = splats.take(slice(0, None, round(1 / share)))
    while len(splats) < share * len(scene.splats):
        splats = halved(splats)
    where = Path(folder, f"{SCENE}-{share}")
    write_scene(where, replace(scene, splats=splats))
    return len(splats), str(where)


def _cells(scene, spacing):
    config = Config.from_preset("downpour").replace(spacing=spacing)
    return int(np.prod(pipeline.extract_terrain(scene, config).grid.shape))


def _pixels(out):
    height, width = imageio.imread(next((out / "frames").glob("*.png"))).shape[:2]
    return height * width


def series(result):
    """Yield quantity, run and its rows: least seconds and processor seconds of each count."""
    for quantity in QUANTITIES:
        for state in RUNS:
            found = [r for r in result["growth"] if (r["quantity"], r["run"]) == (quantity, state)]
            counts = sorted({row["count"] for row in found})
            yield quantity, state, [
                {"count": count, **{key: min(row[key] for row in found if row["count"] == count)
                                    for key in ("seconds", "processor")}}
                for count in counts
            ]  # fmt: skip


def table(result):
    """Return the waits and exponents in Markdown."""
    cells = [
        (quantity, state, ", ".join(str(row["count"]) for row in rows),
         *(", ".join(f"{row[key]:.1f}" for row in rows) for key in ("seconds", "processor")),
         f"{exponent(rows, 'seconds'):.2f}")
        for quantity, state, rows in series(result)
    ]  # fmt: skip
    head = "quantity", "", "counts", "least s", "least s of processor time", "exponent"
    return "\n".join([*markdown(head, cells), "", load_line(result)])


def draw(result, path):
    """Draw the wait against each quantity to a PNG."""
    pyplot = require_matplotlib()
    figure, axes = pyplot.subplots(1, 3, figsize=(11, 3.4), layout="constrained", sharey=True)
    for quantity, state, rows in series(result):
        axis, n = axes[QUANTITIES.index(quantity)], RUNS.index(state)
        axis.plot(
            [row["count"] / 1000 for row in rows], [row["seconds"] for row in rows],
            color=COLORS[n], marker=MARKERS[n], label=f"{state}: exponent "
            f"{exponent(rows, 'seconds'):.2f}",
        )  # fmt: skip
        axis.set(xlabel=f"thousand {quantity}")
    axes[0].set(ylabel="s from the command to the exit")
    for axis in axes:
        log_ticks(axis)
        axis.legend(fontsize=8)
    save(figure, path)
