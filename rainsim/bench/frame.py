"""`rainsim bench frame`: the whole rainy frame, accuracy against time over levels of quality.

The truth of a frame is the same rain, water and camera drawn at twice the size with traced
reflections and averaged down. Stage times are those that `rainsim run` reports; levels are drawn in
turn, so that the load of the machine falls on all of them alike.
"""

from __future__ import annotations

import os
import platform
import resource
import time

import numpy as np
from scipy import ndimage

from rainsim import pipeline
from rainsim.bench.chart import draw_fronts
from rainsim.config import REFLECTIONS, Config
from rainsim.jit import set_threads
from rainsim.render import Renderer
from rainsim.scene.cameras import orbit
from rainsim.scene.library import list_scenes, load_scene

PRESET = "moderate"
SCENES = ("bicycle", "street")
CAPTURE = "garden"  # measured too when a folder of RAINSIM_SCENES holds a scene of that name
WIDTHS = {False: (648, 1296), True: (96,)}  # px
SPACING = {False: 0.02, True: 0.08}  # m
ROUNDS = {False: 3, True: 1}  # drawings of each frame, of which the median counts
FRAMES = {False: 2, True: 1}  # compared with the truth
EXTENT = {False: None, True: 3.0}  # m
ORBIT = 240  # cameras of a full circle: a slow walk
TRUTH_SCALE = 2
TRUTH_WIDTH = 700  # px, up to which all levels are measured: the truth's traced rays take long
# What each level changes of the preset, and the share of the width that it is drawn at.
LEVELS = {
    "as set": ({}, 1.0),
    "half size": ({}, 0.5),
    "map 4 cm": ({"spacing": 2.0}, 1.0),
    "rain to 3 m": ({"streak_far": 3.0}, 1.0),
    **{
        name: ({"reflections": name}, 1.0) for name in REFLECTIONS if name not in ("auto", "traced")
    },
}
TRUTH = {"reflections": "traced" if "traced" in REFLECTIONS else "auto", "streak_far": 16.0}


def run(quick=False, tell=None):
    """Run the whole bench.

    Parameters
    ----------
    quick : bool
        One scene, small, one drawing of each.
    tell : callable, optional
        Called with a line of text for each result.

    Returns
    -------
    dict
        "machine" and "rows": scene, size, motion, level, milliseconds by stage, their sum and the
        root mean square error against the truth in shares of display white (None: not measured).
    """
    tell = tell or (lambda line: None)
    known = [name for name, _, _ in list_scenes()]
    names = SCENES[:1] if quick else (*SCENES, *([CAPTURE] if CAPTURE in known else []))
    rows = []
    for name in names:
        scene = load_scene(name)
        for width in WIDTHS[quick]:
            for motion in ("still", "moving"):
                for row in measure(scene, width, motion, quick):
                    rows.append(row)
                    tell(_line(row))
    machine = {
        "cpu": platform.processor() or platform.machine(), "cores": os.cpu_count(),
        "threads": set_threads(None), "load": os.getloadavg(),
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }  # fmt: skip
    return {"machine": machine, "quick": quick, "rows": rows}


def measure(scene, width, motion, quick=False):
    """Return a row of times and error for each level, one scene, width and motion.

    Wider pictures than TRUTH_WIDTH are only timed, as they are set.
    """
    count, rounds = FRAMES[quick], ROUNDS[quick]
    config = Config.from_preset(PRESET).replace(
        width=width, frames=count, spacing=SPACING[quick], extent=EXTENT[quick]
    )
    cameras = _cameras(scene, motion, count * rounds + 1)
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
    levels = {n: renderer(*level) for n, level in LEVELS.items() if small or n == "as set"}
    for own, states, sized in levels.values():
        own.draw(sized[-1], states[0])  # compiles, and sees a camera that is not timed
        if motion == "still":
            own.draw(sized[0], states[0])
    best, best_states, large = renderer(TRUTH, TRUTH_SCALE) if small else (None, None, None)
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
                    truth = _shrunk(best.draw(large[at], best_states[k])[0])
                errors[name].append(_error(picture, truth))
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


def _cameras(scene, motion, count):
    """Return the cameras: one for all frames, a slow orbit, or the drive that a scene has."""
    if motion == "still":
        return [scene.cameras[0]] * (count - 1) + [scene.cameras[1]]
    away = np.linalg.norm(scene.cameras[1].position - scene.cameras[0].position)
    if away * scene.ground_frame.meters_per_unit < 0.5 and len(scene.cameras) >= count:
        return list(scene.cameras[:count])
    return orbit(scene.ground_frame, scene.cameras, count=ORBIT)[:count]


def _shrunk(picture):
    """Return the picture averaged over blocks, in linear light as a sensor does."""
    height, width = (n // TRUTH_SCALE * TRUTH_SCALE for n in picture.shape[:2])
    linear = (picture[:height, :width] / np.float32(255)) ** np.float32(2.2)
    shape = (height // TRUTH_SCALE, TRUTH_SCALE, width // TRUTH_SCALE, TRUTH_SCALE, 3)
    return linear.reshape(shape).mean(axis=(1, 3)) ** np.float32(1 / 2.2)


def _error(picture, truth):
    """Return the root mean square error against the truth; a smaller picture is enlarged."""
    picture = picture / np.float32(255)
    if picture.shape != truth.shape:
        zoom = [a / b for a, b in zip(truth.shape, picture.shape, strict=True)]
        picture = ndimage.zoom(picture, zoom, order=1, grid_mode=True, mode="nearest")
    return float(np.sqrt(np.mean((picture - truth) ** 2)))


def _line(row):
    return (
        f"{row['scene']:8s} {row['width']:5d} px  {row['motion']:6s} {row['level']:12s} "
        f"{row['milliseconds']['frame']:8.1f} ms  (least {row['least_ms']:.1f})  "
        f"{_decibel(row['rmse'])} dB"
    )


def _decibel(rmse):
    return "-" if rmse is None else f"{-20 * np.log10(max(rmse, 1e-9)):.1f}"


def table(result):
    """Return stage times of the setting itself, then time and error of all levels, in Markdown."""
    rows = result["rows"]
    own = [row for row in rows if row["level"] == "as set"]
    heads = [f"{r['scene']} {r['width']} x {r['height']} {r['motion']}" for r in own]
    lines = ["| ms | " + " | ".join(heads) + " |", "|---" * (len(own) + 1) + "|"]
    for stage in dict.fromkeys(s for row in own for s in row["milliseconds"]):
        cells = [f"{row['milliseconds'].get(stage, 0.0):.0f}" for row in own]
        lines.append(f"| {stage} | " + " | ".join(cells) + " |")
    heads = [h for h, row in zip(heads, own, strict=True) if row["rmse"] is not None]
    lines += ["", "| ms / dB | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for level in LEVELS:
        cells = [
            f"{row['milliseconds']['frame']:.0f} / {_decibel(row['rmse'])}"
            for row in rows
            if row["level"] == level and row["rmse"] is not None
        ]
        lines.append(f"| {level} | " + " | ".join(cells) + " |")
    load = ", ".join(f"{x:.1f}" for x in result["machine"]["load"])
    memory = result["machine"]["peak_mib"]
    return "\n".join(
        [*lines, "", f"{result['machine']['threads']} threads, load {load}, peak {memory:.0f} MiB"]
    )


def draw(result, path):
    """Draw the chart of a result of `run` to a PNG; a capture that is not built in stays out."""
    panels = {}
    for row in result["rows"]:
        if row["scene"] in SCENES and row["rmse"] is not None:
            panel = panels.setdefault(
                f"{row['scene']}, {row['width']} x {row['height']}, {row['motion']}", {"lines": {}}
            )
            point = (row["milliseconds"]["frame"] / 1e3, row["rmse"])
            panel["lines"].setdefault(row["level"], []).append(point)
    draw_fronts(path, panels, "A rainy frame: error against the frame at twice the size, and time")
