"""`benchmarks growth`: how the time of a moving frame grows with splats, pixels and wet pixels.

One quantity varies at a time. The cases of a quantity are drawn in turn, so that the load of the
machine affects all of them alike. The exponent p of a quantity n is that of a fit of t = c n^p to
the least times: 1 means that the time doubles with the quantity.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.chart import COLORS, MARKERS, log_ticks, require_matplotlib, save
from benchmarks.suite import SCENES, load_line, machine, markdown, quiet, scene_names
from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.render.renderer import Renderer
from rainsim.scene.cameras import resize_to
from rainsim.scene.library import load_scene
from rainsim.scene.types import Splats

PRESET = "moderate"
WIDTH = {False: 648, True: 96}  # px, of what does not vary the pixels
SPLATS = {False: (0.25, 0.5, 1, 2, 4, 8), True: (0.5, 1)}  # times those of the scene
WIDTHS = {False: (324, 458, 648, 916, 1297), True: (64, 96)}  # px
LEVELS = {False: (None, 0.005, 0.01, 0.02, 0.04), True: (None, 0.03)}  # m of standing water
ROUNDS = {False: 9, True: 1}  # drawings of each case
SPACING, EXTENT = {False: 0.02, True: 0.08}, {False: None, True: 3.0}  # m
STEP = 0.003  # m by which the camera moves on from frame to frame
SHIFT = 0.5  # deviations from a splat's centre to those of its halves
NARROWED = np.sqrt(1 - SHIFT**2)  # keeps the variance along the axis that is divided
QUANTITIES = ("splats", "pixels", "wet pixels")
LOWEST, HIGHEST = 20, 500  # ms, of the chart's axes
WET_STAGES = ("find water", "mirror", "reflection", "water")


def run(quick=False, say=quiet):
    """Run the whole bench, see `benchmarks.suite`.

    The result has "machine" and "rows": scene, quantity, count, least_ms and median_ms of a frame
    and water_ms, the least of the stages that draw water.
    """
    rows = []
    for name in scene_names(quick):
        scene = load_scene(name)
        config = Config.from_preset(PRESET).replace(
            frames=1, width=WIDTH[quick], spacing=SPACING[quick], extent=EXTENT[quick]
        )
        terrain = pipeline.extract_terrain(scene, config)
        camera = resize_to(pipeline.view_of_water(scene, terrain), WIDTH[quick])
        world = scene, terrain, config, camera
        for quantity, cases in (
            ("splats", splat_cases(*world, SPLATS[quick])),
            ("pixels", pixel_cases(*world, WIDTHS[quick])),
            ("wet pixels", wet_cases(*world, LEVELS[quick])),
        ):
            for row in measure(cases, quantity, ROUNDS[quick]):
                rows.append({"scene": scene.name, "quantity": quantity, **row})
                say(_line(rows[-1]))
    return {"machine": machine(), "quick": quick, "rows": rows}


def splat_cases(scene, terrain, config, camera, shares):
    """Yield (count, renderer, camera, state): the scene with `shares` times as many splats."""
    state = next(iter(pipeline.simulate(terrain, config)))
    for share in shares:
        splats = scene.splats
        if share < 1:
            splats = splats.take(slice(0, None, round(1 / share)))
        while len(splats) < share * len(scene.splats):
            splats = halved(splats)
        other = replace(scene, splats=splats)
        yield len(splats), Renderer(other, terrain, config, camera), camera, state


def pixel_cases(scene, terrain, config, camera, widths):
    """Yield (count, renderer, camera, state): pictures of `widths` px."""
    state = next(iter(pipeline.simulate(terrain, config)))
    for width in widths:
        sized = resize_to(camera, width)
        settings = config.replace(width=width)
        renderer = Renderer(scene, terrain, settings, sized)
        yield sized.width * sized.height, renderer, sized, state


def wet_cases(scene, terrain, config, camera, levels):
    """Yield (None, renderer, camera, state): water that stands at `levels` [m]; None: puddles."""
    for level in levels:
        settings = config if level is None else config.replace(level=level)
        state = next(iter(pipeline.simulate(terrain, settings)))
        yield None, Renderer(scene, terrain, settings, camera), camera, state


def halved(splats):
    """Return splats of which each is two: apart along the longest axis, together as wide as it.

    The two stop as much light as the one: each has 1 - sqrt(1 - opacity).
    """
    longest = splats.scale.argmax(axis=1)
    every = np.arange(len(splats))
    turn = Rotation.from_quat(splats.rotation, scalar_first=True).as_matrix()
    size = splats.scale[every, longest]
    away = (SHIFT * size[:, None] * turn[every, :, longest]).astype(np.float32)
    scale = splats.scale.copy()
    scale[every, longest] *= np.float32(NARROWED)
    opacity = 1 - np.sqrt(1 - np.minimum(splats.opacity, np.float32(0.9999)))
    return Splats(
        np.concatenate([splats.position - away, splats.position + away]),
        np.tile(splats.rotation, (2, 1)), np.tile(scale, (2, 1)),
        np.tile(opacity, 2).astype(np.float32), np.tile(splats.sh, (2, 1, 1)),
    )  # fmt: skip


def measure(cases, quantity, rounds):
    """Return a row for each case; all are drawn once before the first is timed."""
    cases, times = list(cases), []
    for _, renderer, camera, state in cases:
        renderer.draw(camera, state)
        times.append([])
    for n in range(rounds):
        for (_, renderer, camera, state), found in zip(cases, times, strict=True):
            moved = camera.camera_from_world.copy()
            moved[0, 3] += STEP * (n + 1) / renderer.conductor.wet_scene.frame.meters_per_unit
            start = time.perf_counter()
            _, report = renderer.draw(replace(camera, camera_from_world=moved), state)
            whole = (time.perf_counter() - start) * 1e3
            found.append((whole, sum(report.milliseconds.get(name, 0) for name in WET_STAGES)))
    return [
        {
            "count": int(len(case[1].water.pixel) if quantity == "wet pixels" else case[0]),
            "least_ms": min(whole for whole, _ in found),
            "median_ms": float(np.median([whole for whole, _ in found])),
            "water_ms": min(water for _, water in found),
        }
        for case, found in zip(cases, times, strict=True)
    ]  # fmt: skip


def exponent(rows, key="least_ms"):
    """Return the exponent p of a fit of rows[key] = c count^p; NaN of fewer than two counts."""
    counts, times = [row["count"] for row in rows], [row[key] for row in rows]
    if len(set(counts)) < 2 or min(counts) <= 0:
        return float("nan")
    return float(np.polyfit(np.log(counts), np.log(times), 1)[0])


def _line(row):
    return (
        f"{row['scene']:8s} {row['quantity']:10s} {row['count']:9d} {row['least_ms']:8.1f} ms  "
        f"(median {row['median_ms']:.1f}, water {row['water_ms']:.1f})"
    )


def _series(result):
    """Yield scene, quantity and the rows of each."""
    for scene in dict.fromkeys(row["scene"] for row in result["rows"]):
        for quantity in QUANTITIES:
            rows = [r for r in result["rows"] if (r["scene"], r["quantity"]) == (scene, quantity)]
            yield scene, quantity, sorted(rows, key=lambda row: row["count"])


def table(result):
    """Return the times and exponents in Markdown."""
    cells = [
        (scene, quantity, *(", ".join(f"{row[key]:.0f}" for row in rows)
                            for key in ("count", "least_ms", "water_ms")),
         f"{exponent(rows):.2f}, {exponent(rows, 'water_ms'):.2f}")
        for scene, quantity, rows in _series(result)
    ]  # fmt: skip
    head = "scene", "quantity", "counts", "least ms of a frame", "of its water", "exponent, water's"
    return "\n".join([*markdown(head, cells), "", load_line(result)])


def draw(result, path):
    """Draw time against each quantity to a PNG; it shows the built-in scenes only."""
    pyplot = require_matplotlib()
    figure, axes = pyplot.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    for scene, quantity, rows in _series(result):
        if scene not in SCENES:
            continue
        axis, n = axes[QUANTITIES.index(quantity)], SCENES.index(scene)
        thousands = [row["count"] / 1000 for row in rows]
        axis.plot(
            thousands, [row["least_ms"] for row in rows], color=COLORS[n], marker=MARKERS[n],
            label=f"{scene}: exponent {exponent(rows):.2f}",
        )  # fmt: skip
    for axis, quantity in zip(axes, QUANTITIES, strict=True):
        axis.set(
            xlabel=f"thousand {quantity}",
            ylabel="least time of a frame [ms]",
            ylim=(LOWEST, HIGHEST),
        )
        log_ticks(axis)
        axis.legend(fontsize=8)
    save(figure, path)
