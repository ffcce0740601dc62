"""`benchmarks splat`: accuracy of a picture against its time, for each choice of the rasterizer.

The reference is the same capture in float64 (`splat_truth`). Within a group all choices take turns
on one thread, and processor time counts, so that ratios hold on a busy machine too. The gain of
more threads is measured as wall time, stage by stage, which needs an idle machine.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks import peers
from benchmarks.chart import draw_fronts
from benchmarks.splat_choices import all_choices
from benchmarks.splat_truth import draw_truth
from benchmarks.suite import decibels, load_line, machine, markdown, quiet, rms, scene_names
from rainsim import raster
from rainsim.jit import set_threads
from rainsim.scene.cameras import resize_to
from rainsim.scene.library import load_scene

SCENE = "bicycle"
WIDTH = {False: 648, True: 96}  # px
ROUNDS = {False: 15, True: 2}  # of which the least and the median count; one more warms up
NEAR = 0.01  # capture units
SOLID = 0.5  # alpha above which depth is compared
CHARTED = 6  # groups
PEERS_IN = "stop"  # the group beside which other programs stand in the chart
LEAST_DECIBEL = 90.0  # that a default has to reach against float64
# Kernels of a picture by stage: the module in which the rasterizer looks them up, and their names.
STAGES = {
    "cull": (raster.project, "find_chunks"), "project": (raster.project, "project_chunks"),
    "places": (raster, "tile_starts"), "list": (raster, "list_tiles"),
    "sort and blend": (raster, "blend_tiles"),
}  # fmt: skip


def run(quick=False, say=quiet):
    """Return "machine" and "records", one for each scene, group and choice; see `suite`."""
    records, sizes, scaling = [], {}, []
    for name in scene_names(False, (SCENE,)):
        scene = load_scene(name)
        camera = resize_to(scene.cameras[0], WIDTH[quick])
        size = {"width": camera.width, "height": camera.height, "splats": len(scene.splats)}
        sizes[name] = size
        say(f"{name}: float64")
        truth = draw_truth(scene.splats, camera, NEAR)
        prepared = raster.prepare(scene.splats)
        for group, choices in all_choices().items():
            say(f"{name}: {group}")
            if quick:
                choices = [c for k, c in enumerate(choices) if k == 0 or c.default]
            found = measure(choices, scene.splats, prepared, camera, truth, ROUNDS[quick])
            records += [{"scene": name, "group": group, **record} for record in found]
        say(f"{name}: threads")
        found = time_stages(prepared, camera, ROUNDS[quick])
        scaling += [{"scene": name, **record} for record in found]
    return {
        "machine": machine(dtype="float32") | {"threads": 1},
        "quick": quick, "rounds": ROUNDS[quick], "scenes": sizes, "records": records,
        "scaling": scaling,
    }  # fmt: skip


def measure(choices, splats, prepared, camera, truth, rounds):
    """Return a record for each choice: times of alternating drawings, errors of its picture."""
    drawers = [(choice, choice.rasterizer(splats, prepared)) for choice in choices]
    seconds = np.empty((rounds + 1, len(drawers)))
    layers = [None] * len(drawers)
    threads = set_threads(None)
    set_threads(1)
    for turn in range(rounds + 1):
        for k, (choice, drawer) in enumerate(drawers):
            begin = time.process_time()
            layers[k] = drawer.draw(camera, NEAR, **choice.options)
            seconds[turn, k] = time.process_time() - begin
    set_threads(threads)
    seconds = seconds[1:]
    standard = [choice.default for choice in choices].index(True)
    ratio = np.median(seconds / seconds[:, [standard]], axis=0)
    records = []
    for k, choice in enumerate(choices):
        depth = truth.median_depth if choice.options.get("depth") == "median" else truth.depth
        records.append({
            "choice": choice.name, "default": choice.default,
            "decibel": decibel(layers[k].color, truth.color),
            "worst": float(np.abs(layers[k].color - truth.color).max()),
            "depth_error": _depth_error(layers[k].depth, depth, truth.alpha),
            "plane_error": _depth_error(layers[k].plane_depth, truth.plane_depth, truth.alpha),
            "least_ms": float(seconds[:, k].min() * 1e3),
            "median_ms": float(np.median(seconds[:, k]) * 1e3), "ratio": float(ratio[k]),
        })  # fmt: skip
    return records


def time_stages(prepared, camera, rounds):
    """Return wall times of the stages on one thread and on all, in turns, median milliseconds."""
    threads, times = sorted({1, set_threads(None)}), {}
    drawer = raster.Rasterizer(prepared)
    kernels = {stage: getattr(*place) for stage, place in STAGES.items()}

    def timed(stage):
        def call(*arguments):
            begin = time.perf_counter()
            out = kernels[stage](*arguments)
            times.setdefault((count, stage), []).append(time.perf_counter() - begin)
            return out

        return call

    try:
        for stage, place in STAGES.items():
            setattr(*place, timed(stage))
        for _ in range(rounds + 1):
            for count in threads:
                set_threads(count)
                begin = time.perf_counter()
                drawer.draw(camera, NEAR)
                times.setdefault((count, "all"), []).append(time.perf_counter() - begin)
    finally:
        set_threads(threads[-1])
        for stage, place in STAGES.items():
            setattr(*place, kernels[stage])
    return [
        {"threads": count, "stage": stage, "least_ms": min(found[1:]) * 1e3,
         "median_ms": float(np.median(found[1:]) * 1e3)}
        for (count, stage), found in times.items()
    ]  # fmt: skip


def decibel(picture, truth):
    """Return the peak signal-to-noise ratio of a picture, peak 1; 200 at most."""
    return decibels(np.mean((picture - truth) ** 2), 1e-20)


def _depth_error(depth, truth, alpha):
    """Return the 99th percentile of the relative error of depth over solid pixels."""
    solid = (alpha > SOLID) & np.isfinite(truth)
    if not solid.any():
        return 0.0
    error = np.abs(depth[solid] / truth[solid] - 1)
    return float(np.percentile(np.where(np.isfinite(error), error, 1.0), 99))


def table(result):
    """Return the figures as text in Markdown, the defaults in bold."""
    lines = []
    for name, size in result["scenes"].items():
        choices = [
            (r["group"], f"**{r['choice']}**" if r["default"] else r["choice"],
             f"{r['decibel']:.1f}", f"{r['worst']:.4f}", f"{r['depth_error']:.0e}",
             f"{r['least_ms']:.1f}", f"{r['median_ms']:.1f}", f"{r['ratio']:.2f}")
            for r in result["records"] if r["scene"] == name
        ]  # fmt: skip
        times = {}
        for r in result["scaling"]:
            if r["scene"] == name:
                row = times.setdefault(r["threads"], {})
                row[r["stage"]] = f"{r['least_ms']:.1f} / {r['median_ms']:.1f}"
        stages = (*STAGES, "all")
        lines += [
            f"{name}: {size['splats']} splats, {size['width']} x {size['height']}", "",
            *markdown(("choice", "value", "dB", "worst", "depth, 99 %", "least ms", "median ms",
                       "x default"), choices), "",
            *markdown(("wall time, least / median ms", *stages), [
                (f"{count} thread{'s' if count > 1 else ''}", *(row[s] for s in stages))
                for count, row in times.items()
            ]), "",
        ]  # fmt: skip
    said = f"choices: processor time on one thread; {result['machine']['dtype']}; "
    return "\n".join([*lines, said + load_line(result).partition(", ")[2]])


def draw(result, path):
    """Draw error against time, a panel for each group of choices; the built-in scene only.

    Times are ratios to the default of the same turns, times the median of the default.
    """
    records = [r for r in result["records"] if r["scene"] == SCENE]
    panels = {}
    for group in list(dict.fromkeys(r["group"] for r in records))[:CHARTED]:
        own = [r for r in records if r["group"] == group]
        default = next(r for r in own if r["default"])
        lines = {
            r["choice"]: [(r["ratio"] * default["median_ms"] / 1e3, rms(r["decibel"]))] for r in own
        }
        panels[group] = {
            "lines": lines, "default": default["choice"], "least": rms(LEAST_DECIBEL),
        }  # fmt: skip
        if group == PEERS_IN and not result["quick"]:  # their pictures have the full size
            panels[group]["peers"] = peers.SPLATTING
    size = result["scenes"][SCENE]
    title = f"Splatting {size['splats']} splats at {size['width']} x {size['height']}, one thread"
    draw_fronts(
        path, panels, title, error="rms error (white is 1)", time="processor time", own=True
    )
