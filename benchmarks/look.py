"""`benchmarks look`: accuracy against time of each method for the light on water.

The reference are rays traced through the splats, a mean over each pixel's area (see `truth`). The
methods are compared with it as radiance before Fresnel's factor, display white being 1, where the
traced ray ends on something that the camera sees; the other pixels are counted by cause. Lamps are
brighter than white: radiance is compared as it is and clipped at white. The paper's choices are
compared with the defaults: an image shift with Snell's law on the known bed, Schlick's reflectance
with the exact one, spheres with the height field.
"""

from __future__ import annotations

import time
import tracemalloc
from dataclasses import replace

import numpy as np

from benchmarks import whole
from benchmarks.chart import draw_fronts
from benchmarks.film import film_accuracy, film_line
from benchmarks.suite import SCENES, decibels, machine, quiet, rms, scene_names
from benchmarks.truth import DARK, clipped, compare, trace_truth
from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.reflection import water_pass
from rainsim.reflection.mirror_choice import mirror_step
from rainsim.reflection.mirrored_rays import ENVIRONMENT
from rainsim.reflection.water_pass import choice_of
from rainsim.reflection.water_record import SLOPES
from rainsim.render.renderer import Renderer
from rainsim.scene.cameras import resize_to
from rainsim.scene.library import load_scene

WIDTH = {False: 480, True: 120}  # px
SPACING = {False: 0.02, True: 0.08}  # m
EXTENT = {False: None, True: 3.0}  # m
PRESETS = {False: ("moderate", "flood"), True: ("flood",)}
ROUNDS = {False: 3, True: 1}  # of which the median counts
WHOLE = "moderate"  # preset of the whole frames by method

# Quality levels of the reflection: method, and what is set for it.
USUAL_MARCH = water_pass.REFLECTION_THICKNESS, water_pass.REFLECTION_STRIDE
MARCHES = {
    f"march {thickness * 100:.0f} cm, {stride} px": ("ssr", {"thickness": thickness, "px": stride})
    for thickness, stride in (
        (0.15, 1), (0.15, 2), (0.15, 4), (0.03, 1), (0.05, 1), (0.3, 1), (1.0, 1)
    )
}  # fmt: skip
LEVELS = {
    "auto": ("auto", {}),
    "auto, half-size mirrors": ("auto", {"mirror_size": "half"}),
    "mirror": ("mirror", {}),
    **MARCHES,
    "paper": ("paper", {}),
}
PAPER_CHOICES = {
    "image shift": {"refraction": "shift"},
    "Schlick": {"fresnel": "schlick"},
    "hard coverage": {"coverage": "hard"},
    "spheres": {"water_geometry": "spheres"},
    "all of the paper's": {
        "refraction": "shift", "fresnel": "schlick", "coverage": "hard", "reflections": "paper",
        "water_geometry": "spheres", "highlight": "blinn-phong",
    },
}  # fmt: skip


def run(quick=False, say=quiet):
    """Return all figures, see `benchmarks.suite`."""
    cases, frames = [], {}
    for name in scene_names(quick):
        scene = load_scene(name)
        for preset in PRESETS[quick]:
            say(f"{name}, {preset}")
            cases.append(measure(scene, preset, quick))
            say(_lines(cases[-1]))
        if not quick:
            frames[name] = whole.measure(name, WHOLE, WIDTH[quick])
            say(_whole(name, frames[name]))
    return {"cases": cases, "frames": frames, "machine": machine()}


def stage(scene, preset, quick):
    """Return a renderer of a scene that has drawn the first frame of a preset, and the state."""
    config = Config.from_preset(preset).replace(
        frames=1, spacing=SPACING[quick], extent=EXTENT[quick], width=WIDTH[quick]
    )
    camera = resize_to(scene.cameras[0], WIDTH[quick])
    terrain = pipeline.extract_terrain(scene, config)
    state = next(pipeline.simulate(terrain, config))
    renderer = Renderer(scene, terrain, config, camera)
    renderer.draw(camera, state)
    return renderer, camera, state


def measure(scene, preset, quick):
    """Return the figures of one scene and preset."""
    renderer, camera, state = stage(scene, preset, quick)
    chosen = choice_of(renderer.water)
    truth = trace_truth(renderer, camera, state)
    levels, rate = reflection_levels(renderer, camera, state, truth, ROUNDS[quick])
    choices = paper_choices(renderer, state, ROUNDS[quick])
    return {
        "scene": scene.name, "preset": preset, "size": [camera.width, camera.height],
        "water_pixels": len(renderer.water.pixel), "causes": truth["causes"], "auto": chosen,
        "view_dependence": truth["view_dependence"], "traced": truth["cost"], "levels": levels,
        "paper_choices": choices, "film": film_accuracy(renderer, camera),
        "march_rays_per_second": rate,
    }  # fmt: skip


def reflection_levels(renderer, camera, state, truth, rounds):
    """Return accuracy, time and memory of each quality level, drawn in turn."""
    water = renderer.water
    seen, known, sky = truth["seen"], truth["known"], truth["alpha"] <= DARK
    mean = (truth["light"][0] + truth["light"][1]) / 2
    rows = {name: {"name": name, "stage": [], "frame": []} for name in LEVELS}
    for turn in range(rounds + 1):
        for name, (method, settings) in LEVELS.items():
            step = _set(renderer, settings, camera.width)
            renderer.passes.forget_reflections()
            tracemalloc.start() if turn == 0 else None
            start = time.process_time()
            light_up(renderer, method, step)
            seconds = time.process_time() - start
            row = rows[name]
            if turn == 0:  # not timed: it compiles, and tracing memory is slow
                row["memory_mb"] = tracemalloc.get_traced_memory()[1] / 1e6
                tracemalloc.stop()
                row["seen"] = compare(water, water.light, truth["light"], seen)
                row["all"] = compare(water, water.light, truth["light"], known)
                row["clipped"] = clipped(water, water.light, truth)
                missed = water.source == ENVIRONMENT
                far = np.abs(water.light - mean).max(axis=1) > 0.1
                row["false_sky"] = float((missed & far & known & ~sky).mean())
            else:
                row["stage"].append(seconds)
                size = {k: v for k, v in settings.items() if k == "mirror_size"}
                row["frame"].append(_frame_time(renderer, camera, state, method, **size))
    _set(renderer, {}, camera.width)
    rate = march_rate(renderer, rounds)
    for row in rows.values():
        for part in ("stage", "frame"):
            row[part] = float(np.median(row[part])) if row[part] else None
        row["rays_per_second"] = len(water.pixel) / row["stage"] if row["stage"] else None
    traced = {
        "name": "traced", "stage": truth["cost"]["seconds"], "frame": None, "false_sky": 0.0,
        "memory_mb": truth["cost"]["memory_mb"],
        "rays_per_second": truth["cost"]["rays_per_second"],
        "seen": compare(water, truth["traced"], truth["light"], seen),
        "all": compare(water, truth["traced"], truth["light"], known),
        "clipped": clipped(water, truth["traced"], truth),
    }  # fmt: skip
    return [*rows.values(), traced], rate


def march_rate(renderer, rounds):
    """Return how many rays a second the march follows: one a pixel, on water without ripples."""
    water, sky = renderer.water, renderer.conductor.wet_scene.sky
    ripples = water.record[:, SLOPES].copy()
    water.record[:, SLOPES] = 0
    wet, tops, around = renderer.wet, renderer.frame["tops"], (sky.environment, sky.gloss)
    blocks, seconds = water_pass.depth_blocks(wet), []
    for _ in range(2 * rounds + 1):
        start = time.process_time()
        water_pass.light_up(water, "ssr", wet, tops, None, around, lambda: blocks)
        seconds.append(time.process_time() - start)
    water.record[:, SLOPES] = ripples
    return len(water.pixel) / float(np.median(seconds[1:]))


def light_up(renderer, method, step):
    """Find the light that the water drawn last mirrors by another method of reflection."""
    frame, passes = renderer.frame, renderer.passes
    others = {"methods": replace(frame["methods"], reflections=method), "mirror_step": step}
    mirrors = frame.call(passes.mirror, **others)
    frame.call(passes.reflect, mirrors=mirrors, **others)


def _set(renderer, settings, width):
    """Set a quality level of the reflection; return its `mirror_step`.

    Settings that it does not name get their defaults.
    """
    conductor, (thickness, stride) = renderer.conductor, USUAL_MARCH
    water_pass.REFLECTION_THICKNESS = settings.get("thickness", thickness)
    water_pass.REFLECTION_STRIDE = settings["px"] / width if "px" in settings else stride
    size = settings.get("mirror_size", conductor.methods.mirror_size)
    rain = conductor.now.rain.rate, conductor.now.water.surface_film
    return mirror_step(size, *rain, renderer.wet.view.lens)


def _frame_time(renderer, camera, state, method, **sizes):
    """Return the seconds of a whole frame of a moving camera with a method of reflection."""
    conductor = renderer.conductor
    before = conductor.methods
    conductor.methods = replace(before, reflections=method, **sizes)
    start = time.process_time()
    renderer.draw(replace(camera), state)
    seconds = time.process_time() - start
    conductor.methods = before
    return seconds


def paper_choices(renderer, state, rounds):
    """Return the difference of each choice of the paper from the default picture, and its time."""
    frame, passes = renderer.frame, renderer.passes
    before, rows = renderer.conductor.methods, []
    timings = {name: [] for name in ("as set", *PAPER_CHOICES)}
    pictures = {}
    for _ in range(rounds):
        for name in timings:
            passes.forget_reflections()
            start = time.process_time()
            frame.put("methods", replace(before, **PAPER_CHOICES.get(name, {})))
            frame.make(("shown",), passes.work)
            timings[name].append(time.process_time() - start)
            pictures[name] = frame["shown"].copy(), frame["seen"].coverage.copy()
    frame.put("methods", before)
    frame.make(("shown",), passes.work)
    best, covered = pictures["as set"]
    wet = covered > 0
    for name, seconds in timings.items():
        picture, coverage = pictures[name]
        error = float(np.mean((picture[wet] - best[wet]) ** 2))
        rows.append({
            "name": name, "seconds": float(np.median(seconds)),
            "psnr": None if name == "as set" else decibels(error),
            "covers": float(coverage[wet].sum() / covered[wet].sum()),
        })  # fmt: skip
    return rows


def table(result):
    """Return all cases as text."""
    parts = [_lines(case) for case in result["cases"]]
    return "\n\n".join([*parts, *(_whole(*frame) for frame in result["frames"].items())])


def _whole(name, methods):
    """Return time and memory of whole frames by method as text."""
    lines = [f"{name}, {WHOLE}, whole frames of a moving camera, a process for each method"]
    for method, row in methods.items():
        lines.append(
            f"  {method:8s} {row['milliseconds']:9.1f} ms, peak {row['peak_mb']:.0f} MB "
            f"({row['before_mb']:.0f} before the first frame)"
        )
    return "\n".join(lines)


def _lines(case):
    """Return the table of one case."""
    seen = case["causes"].get("seen", 0) / max(case["water_pixels"], 1)
    cost = case["traced"]
    lines = [
        f"{case['scene']}, {case['preset']}, {case['size'][0]} x {case['size'][1]}: "
        f"{case['water_pixels']} pixels of water, {seen:.0%} mirror what the camera sees",
        "  the other pixels mirror: " + ", ".join(
            f"{name} {n / case['water_pixels']:.0%}" for name, n in case["causes"].items()
            if name != "seen"
        ),
        f"  traced: {cost['rays_per_second'] / 1e3:.1f} k rays/s, {cost['memory_mb']:.0f} MB; "
        f"colours seen from the camera instead: {_accuracy(case['view_dependence'])}",
        f"  auto: {case['auto']}",
        f"  march alone: {case['march_rays_per_second'] / 1e6:.2f} M rays/s",
        f"  {'reflection':27s} {'seen: dB, SSIM':>16s} {'all':>14s} {'clipped, seen':>14s} "
        f"{'all':>14s} {'false sky':>10s} "
        f"{'ms':>8s} {'M rays/s':>9s} {'MB':>6s} {'frame ms':>9s}",
    ]  # fmt: skip
    for row in case["levels"]:
        frame = "" if row["frame"] is None else f"{row['frame'] * 1e3:9.1f}"
        lines.append(
            f"  {row['name']:27s} {_accuracy(row['seen']):>16s} {_accuracy(row['all']):>14s} "
            f"{_accuracy(row['clipped']['seen']):>14s} {_accuracy(row['clipped']['all']):>14s} "
            f"{row['false_sky']:10.2%} {row['stage'] * 1e3:8.1f} "
            f"{row['rays_per_second'] / 1e6:9.2f} {row['memory_mb']:6.0f} {frame:>9s}"
        )
    for row in case["paper_choices"]:
        error = "the default" if row["psnr"] is None else f"{row['psnr']:.1f} dB from it"
        lines.append(
            f"  {row['name']:27s} {error:>16s}, {row['seconds'] * 1e3:.1f} ms, "
            f"covers {row['covers']:.0%}"
        )
    if case["film"] is not None:
        lines.append(film_line(case["film"]))
    return "\n".join(lines)


def _accuracy(found):
    if found["psnr"] is None:
        return "none"
    ssim = "" if found["ssim"] is None else f" {found['ssim']:.3f}"
    return f"{found['psnr']:.1f}{ssim}"


def draw(result, path):
    """Draw error against time of the reflection levels, a panel for each case, as PNG.

    The chart shows the built-in scenes only.
    """
    panels = {}
    for case in result["cases"]:
        if case["scene"] in SCENES:
            panels[f"{case['scene']}, {case['preset']}"] = {"lines": {
                row["name"]: [(row["stage"], rms(row["all"]["psnr"]))]
                for row in case["levels"] if row["all"]["psnr"] is not None
            }}  # fmt: skip
    draw_fronts(
        path, panels, "Mirrored radiance against the mean of traced rays over each pixel",
        default="auto", error="rms error (white is 1)",
        time="processor time",
    )  # fmt: skip
