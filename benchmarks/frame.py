"""`benchmarks frame`: the whole rainy frame, accuracy against time over levels of quality.

The truth of a frame is the same rain, water and camera drawn at twice the size with traced
reflections and averaged down. Stage times are as `rainsim run` reports them; levels are drawn in
turn, so that the load of the machine affects all of them alike.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks import frame_cuda, frame_gsplat, frame_levels, suite
from benchmarks.chart import draw_fronts
from benchmarks.frame_levels import TRUTH_SCALE, TRUTH_WIDTH
from benchmarks.traced import trace_reflections
from rainsim import pipeline
from rainsim.backend import on_backend
from rainsim.config.settings import Config
from rainsim.render.renderer import Renderer
from rainsim.scene.library import load_scene

WIDTHS = {False: (648, 1296), True: (96,)}  # px
SPACING = {False: 0.02, True: 0.08}  # m
ROUNDS = {False: 3, True: 1}  # drawings of each frame, of which the median counts
FRAMES = {False: 2, True: 1}  # compared with the truth
EXTENT = {False: None, True: 3.0}  # m


def run(quick=False, say=suite.quiet, backend="cpu"):
    """Run the whole bench on a backend, see `benchmarks.suite` and `benchmarks.frame_cuda`.

    The result has "machine" and "rows": scene, size, motion, level, milliseconds by stage, their
    sum and the root mean square error against the truth in shares of display white (None: not
    measured); on a GPU also "peers", see `benchmarks.frame_gsplat`.
    """
    on_backend(backend)  # before anything is drawn
    rows = []
    for name in suite.scene_names(quick):
        scene = load_scene(name)
        if backend == "cuda":
            for width in frame_cuda.WIDTHS[quick]:
                for row in frame_cuda.measure(scene, width, "moving", quick, say):
                    rows.append(row)
                    say(_line(row))
            continue
        for width in WIDTHS[quick]:
            for motion in ("still", "moving"):
                for row in measure(scene, width, motion, quick):
                    rows.append(row)
                    say(_line(row))
    result = {
        "machine": suite.machine(peak_mib=suite.peak() / 2**20), "quick": quick, "backend": backend,
        "rows": rows,
    }  # fmt: skip
    if backend == "cuda":
        result["machine"] |= frame_cuda.machine()
        result["peers"] = frame_gsplat.measure(scene, quick, say)  # the capture, if it is there
    return result


def measure(scene, width, motion, quick=False):
    """Return a row of times and error for each level, one scene, width and motion.

    Wider pictures than TRUTH_WIDTH are only timed, as they are set.
    """
    count, rounds = FRAMES[quick], ROUNDS[quick]
    config = Config.from_preset(frame_levels.PRESET).replace(
        width=width, frames=count, spacing=SPACING[quick], extent=EXTENT[quick]
    )
    cameras = frame_levels.cameras_of(scene, motion, count * rounds + 1)
    height = round(width * cameras[0].height / cameras[0].width)
    worlds = {}

    def world(settings):
        key = settings.terrain.spacing
        if key not in worlds:
            ground = pipeline.extract_terrain(scene, settings)
            states = pipeline.simulate(ground, settings)
            worlds[key] = ground, [next(states) for _ in range(count)]
        return worlds[key]

    def renderer(changes, scale):
        changes = dict(changes)
        if "spacing" in changes:
            changes["spacing"] *= config.terrain.spacing
        settings = config.replace(**changes)
        ground, states = world(settings)
        size = max(8, round(width * scale)), max(8, round(height * scale))
        sized = [camera.resized(*size) for camera in cameras]
        return Renderer(scene, ground, settings, sized[0]), states, sized

    small = width <= TRUTH_WIDTH
    levels = {
        n: renderer(*level) for n, level in frame_levels.LEVELS.items() if small or n == "as set"
    }
    for own, states, sized in levels.values():
        own.draw(sized[-1], states[0])  # compiles, and draws a camera that is not timed
        if motion == "still":
            own.draw(sized[0], states[0])
    if small:
        best, best_states, large = renderer(frame_levels.TRUTH, TRUTH_SCALE)
        trace_reflections(best)
    times = {name: [] for name in levels}
    errors = {name: [] for name in levels}
    for n in range(count * rounds):
        truth = None
        for name, (own, states, sized) in levels.items():
            k = n % count
            at = 0 if motion == "still" else n
            start = time.perf_counter()
            picture, report = own.draw(sized[at], states[k])
            report.milliseconds["frame"] = (time.perf_counter() - start) * 1e3
            times[name].append(report.milliseconds)
            if n < count and small:
                if truth is None:
                    truth = frame_levels.shrunk(best.draw(large[at], best_states[k])[0])
                errors[name].append(frame_levels.error_of(picture, truth))
    rows = []
    for name in levels:
        stages = dict.fromkeys(stage for one in times[name] for stage in one)
        medians = {s: float(np.median([one.get(s, 0.0) for one in times[name]])) for s in stages}
        rows.append(
            {
                "scene": scene.name, "width": width, "height": height, "motion": motion,
                "level": name, "milliseconds": medians,
                "least_ms": min(one["frame"] for one in times[name]),
                "rmse": float(np.sqrt(np.mean(np.square(errors[name])))) if errors[name] else None,
            }
        )  # fmt: skip
    return rows


def _line(row):
    return (
        f"{row['scene']:8s} {row['width']:5d} px  {row['motion']:6s} {row['level']:12s} "
        f"{row['milliseconds']['frame']:8.1f} ms  (least {row['least_ms']:.1f})  "
        f"{_decibel(row['rmse'])} dB"
    )


def _decibel(rmse):
    return "-" if rmse is None else f"{suite.decibels(rmse**2, 1e-18):.1f}"


def table(result):
    """Return stage times of the setting itself, then time and error of all levels, in Markdown."""
    rows = result["rows"]
    own = [row for row in rows if row["level"].startswith(("as set", "map 1 cm"))]
    heads = [
        f"{r['scene']} {r['width']} x {r['height']} {r['motion']}"
        + r["level"].removeprefix("as set").replace("map", ", map")
        for r in own
    ]
    stages = dict.fromkeys(s for row in own for s in row["milliseconds"])
    cells = [
        (stage, *(_milliseconds(row["milliseconds"].get(stage, 0.0)) for row in own))
        for stage in stages
    ]
    for name, title in (("sequence_ms", "frame of a sequence"), ("memory_mib", "MiB of memory")):
        if any(row.get(name) is not None for row in own):
            cells.append((title, *(_milliseconds(row.get(name)) for row in own)))
    lines = suite.markdown(("ms", *heads), cells)
    measured = [row for row in rows if row["rmse"] is not None]
    heads = dict.fromkeys(
        f"{r['scene']} {r['width']} x {r['height']} {r['motion']}" for r in measured
    )
    levels = {}
    for row in measured:
        text = f"{_milliseconds(row['milliseconds']['frame'])} / {_decibel(row['rmse'])}"
        levels.setdefault(row["level"], [row["level"]]).append(text)
    memory, gpu = result["machine"]["peak_mib"], result["machine"].get("gpu")
    last = f"{suite.load_line(result)}, peak {memory:.0f} MiB"
    lines += ["", *suite.markdown(("ms / dB", *heads), levels.values())]
    lines += ["", last + (f", {gpu}" if gpu else "")]
    if result.get("peers"):
        lines += ["", frame_gsplat.table(result["peers"])]
    return "\n".join(lines)


def _milliseconds(value):
    """Return three digits of a number; - for None."""
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def draw(result, path):
    """Draw the chart of a result of `run` to a PNG; it shows the built-in scenes only."""
    panels, stages = {}, {}
    for row in result["rows"]:
        if row["scene"] not in suite.SCENES:
            continue
        case = f"{row['scene']}, {row['width']} x {row['height']}"
        if row["rmse"] is not None:
            panel = panels.setdefault(f"{case}, {row['motion']}", {"lines": {}})
            point = (row["milliseconds"]["frame"] / 1e3, row["rmse"])
            panel["lines"].setdefault(row["level"], []).append(point)
        if row.get("memory_mib") is not None and row["level"] in ("as set", "map 1 cm"):
            bar = dict(row["milliseconds"])
            bar.pop("frame")
            stages.setdefault(row["scene"], {})[f"{row['width']} px, {row['level']}"] = bar
    for scene, bars in stages.items():
        panels[f"{scene}: stages in turn"] = {"bars": bars}
    title = "A rainy frame: error against the frame at twice the size, and time"
    draw_fronts(path, panels, title, default="as set", error="rms error (white is 1)")
