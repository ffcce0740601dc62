"""`rainsim bench look`: accuracy against time of each way to draw what water does with light.

The truth of reflections are the same rays traced through the splats (`traced`), at the same slopes
of the water. They are compared as radiance before Fresnel's factor, display white being 1, where
the traced ray ends on something that the camera sees; the other pixels are counted by cause. The
other ingredients are compared with what they approximate: refraction with Snell's law on the known
bed, reflectance with the exact one, spheres with the height field.
"""

from __future__ import annotations

import os
import platform
import time
import tracemalloc
from dataclasses import replace

import numpy as np
from scipy import ndimage
from skimage.metrics import structural_similarity

from rainsim import pipeline, reflect
from rainsim.bench.chart import COLORS, MARKERS, require_matplotlib
from rainsim.bench.film import film_accuracy, film_line
from rainsim.config import Config
from rainsim.jit import set_threads
from rainsim.render import Renderer, Timer
from rainsim.scene.library import list_scenes, load_scene

SCENES = ("bicycle", "street")
CAPTURE = "garden"  # measured too when a folder of RAINSIM_SCENES holds a scene of that name
WIDTH = {False: 648, True: 120}  # px
SPACING = {False: 0.02, True: 0.08}  # m
EXTENT = {False: None, True: 3.0}  # m
PRESETS = {False: ("moderate", "flood"), True: ("flood",)}
ROUNDS = {False: 5, True: 1}  # of which the median counts
SEEN = 0.05, 0.15  # share of the depth and metres within which a traced end is what the camera sees
WINDOW = 7  # px, of the structural similarity
DARK = 0.5  # alpha of a ray that has met something

# Quality levels of the reflection: method, and what is set for it.
MARCHES = {
    f"march {thickness * 100:.0f} cm, {stride} px": ("ssr", {"thickness": thickness, "px": stride})
    for thickness, stride in (
        (0.15, 1), (0.15, 2), (0.15, 4), (0.03, 1), (0.05, 1), (0.3, 1), (1.0, 1)
    )
}  # fmt: skip
LEVELS = {
    "auto": ("auto", {}),
    "mirror": ("mirror", {}),
    "mirror, 0 steps": ("mirror", {"mirror_steps": 0}),
    "mirror, 32 steps": ("mirror", {"mirror_steps": 32}),
    "mirror, half size": ("mirror", {"mirror_share": 0.5}),
    "mirror, quarter size": ("mirror", {"mirror_share": 0.25}),
    **MARCHES,
    "paper": ("paper", {}),
}
OTHERS = {
    "image shift": {"refraction": "shift"},
    "Schlick": {"fresnel": "schlick"},
    "hard coverage": {"coverage": "hard"},
    "spheres": {"water_geometry": "spheres"},
    "all of the paper's": {
        "refraction": "shift", "fresnel": "schlick", "coverage": "hard", "reflections": "paper",
        "water_geometry": "spheres", "highlight": "blinn-phong",
    },
}  # fmt: skip


def run(quick=False, tell=lambda line: None):
    """Return all figures as plain values.

    Parameters
    ----------
    quick : bool
        One scene, small, each level once.
    tell : callable
        Called with a line on what is being done.
    """
    known = [name for name, _, _ in list_scenes()]
    names = SCENES[:1] if quick else (*SCENES, *([CAPTURE] if CAPTURE in known else []))
    cases = []
    for name in names:
        scene = load_scene(name)
        for preset in PRESETS[quick]:
            tell(f"{name}, {preset}")
            cases.append(measure(scene, preset, quick))
            tell(_lines(cases[-1]))
    return {
        "cases": cases,
        "machine": {
            "processor": platform.machine(), "threads": set_threads(None),
            "load": os.getloadavg(),
        },
    }  # fmt: skip


def stage(scene, preset, quick):
    """Return a renderer of a scene that has drawn the first frame of a preset, and the state."""
    config = Config.from_preset(preset).replace(
        frames=1, spacing=SPACING[quick], extent=EXTENT[quick], width=WIDTH[quick]
    )
    camera = scene.cameras[0]
    height = round(camera.height * WIDTH[quick] / camera.width)
    camera = camera.resized(WIDTH[quick], height)
    terrain = pipeline.extract_terrain(scene, config)
    state = next(pipeline.simulate(terrain, config))
    renderer = Renderer(scene, terrain, config, camera)
    renderer.draw(camera, state)
    return renderer, camera, state


def measure(scene, preset, quick):
    """Return the figures of one scene and preset."""
    renderer, camera, state = stage(scene, preset, quick)
    truth = trace_truth(renderer)
    levels = reflection_levels(renderer, camera, state, truth, ROUNDS[quick])
    others = other_levels(renderer, camera, state, ROUNDS[quick])
    return {
        "scene": scene.name, "preset": preset, "size": [camera.width, camera.height],
        "water_pixels": len(renderer.water.pixel), "causes": truth["causes"],
        "view_dependence": truth["view_dependence"], "traced": truth["cost"], "levels": levels,
        "others": others, "film": film_accuracy(renderer, camera),
    }  # fmt: skip


def trace_truth(renderer):
    """Return the traced light, which records the camera sees the end of, and why not the others."""
    water = renderer.water
    renderer._traced(  # builds the hierarchy, which the time of tracing is counted without
        water.record[:1, :3], np.array([[0, 0, 1]], np.float32), np.zeros(1, np.float32), 1e-3
    )
    start = time.perf_counter()
    alpha, end = water.light_up("traced", None, renderer._traced, None, Timer())
    seconds = time.perf_counter() - start
    light = water.light.copy()
    sampled = (water.record[:, 12:14].sum(axis=1) >= reflect.LEAST_VARIANCE).sum()
    rays = len(light) + (reflect.SAMPLES - 1) * int(sampled)
    causes = why_unseen(water, alpha, end)
    # What the colours' dependence on the view alone makes: the same rays, colours as seen from the
    # camera, which is all that a march can show.
    eye = renderer.frame.to_capture(water.view.eye)

    def trace(*ray):
        return renderer._traced(*ray, color_eye=eye)

    water.light_up("traced", None, trace, None, Timer())
    seen = causes == "seen"
    return {
        "light": light, "seen": seen, "alpha": alpha,
        "causes": {str(name): int(n) for name, n in zip(*np.unique(causes, return_counts=True),
                                                        strict=True)},
        "view_dependence": compare(water, water.light, light, seen),
        "cost": {
            "seconds": seconds, "rays": rays, "rays_per_second": rays / max(seconds, 1e-9),
            "memory_mb": renderer._tracer.nbytes / 1e6,
        },
    }  # fmt: skip


def why_unseen(water, alpha, end):
    """Return for each record "seen", or why the camera does not see where its traced ray ends."""
    v = water.view
    local = (np.where(np.isfinite(end), end, v.eye) - v.eye) @ v.turn  # sky: nowhere
    height, width = v.depth.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        u = v.lens[0] * local[:, 0] / local[:, 2] + v.lens[2]
        w = v.lens[1] * local[:, 1] / local[:, 2] + v.lens[3]
    inside = (local[:, 2] > 0) & (u >= 0) & (w >= 0) & (u < width) & (w < height)
    column, row = (np.where(inside, a, 0).astype(int) for a in (u, w))
    there = v.depth[row, column]
    off = local[:, 2] - there
    near = np.abs(off) < np.maximum(SEEN[0] * local[:, 2], SEEN[1])
    cause = np.full(len(end), "hidden by something nearer", dtype=object)
    cause[off < 0] = "before what is seen"
    cause[near] = "seen"
    cause[near & (v.clearance[row, column] < reflect.NOT_GROUND)] = "ground"
    cause[~inside] = "outside the picture"
    cause[local[:, 2] <= 0] = "behind the camera"
    cause[~(alpha > DARK)] = "sky"
    return cause.astype(str)


def compare(water, light, truth, mask):
    """Return PSNR [dB] and structural similarity of mirrored radiance over the records in mask.

    The similarity is taken in windows that hold water only.
    """
    if not mask.any():
        return {"psnr": None, "ssim": None, "pixels": 0}
    error = float(np.mean((light[mask].astype(float) - truth[mask]) ** 2))
    shape = (*water.view.depth.shape, 3)
    pictures = []
    for values in (light, truth):
        picture = np.zeros(shape)
        picture.reshape(-1, 3)[water.pixel] = values
        pictures.append(picture)
    _, similar = structural_similarity(
        *pictures, win_size=WINDOW, data_range=1.0, channel_axis=-1, full=True
    )
    wet = np.zeros(shape[:2], bool)
    wet.ravel()[water.pixel] = True
    whole = ndimage.binary_erosion(wet, np.ones((WINDOW, WINDOW)))
    wanted = np.zeros_like(wet)
    wanted.ravel()[water.pixel[mask]] = True
    wanted &= whole
    ssim = float(similar[wanted].mean()) if wanted.any() else None
    return {"psnr": -10 * np.log10(max(error, 1e-12)), "ssim": ssim, "pixels": int(mask.sum())}


def reflection_levels(renderer, camera, state, truth, rounds):
    """Return accuracy, time and memory of each quality level, drawn in turn."""
    water = renderer.water
    seen, sky = truth["seen"], truth["alpha"] <= DARK
    rows = {name: {"name": name, "stage": [], "frame": []} for name in LEVELS}
    for turn in range(rounds + 1):
        for name, (method, settings) in LEVELS.items():
            _set(water, settings, camera.width)
            timer = Timer()
            water._mirrors, water._tall = {}, None
            tracemalloc.start() if turn == 0 else None
            start = time.perf_counter()
            water.light_up(method, renderer._mirrored, None, renderer.environment, timer)
            seconds = time.perf_counter() - start
            row = rows[name]
            if turn == 0:  # compiles, and tracing memory is slow: not timed
                row["memory_mb"] = tracemalloc.get_traced_memory()[1] / 1e6
                tracemalloc.stop()
                row["seen"] = compare(water, water.light, truth["light"], seen)
                row["all"] = compare(water, water.light, truth["light"], np.ones_like(seen))
                missed = water.source == reflect.ENVIRONMENT
                far = np.abs(water.light - truth["light"]).max(axis=1) > 0.1
                row["false_sky"] = float((missed & far & ~sky).mean())
            else:
                row["stage"].append(seconds)
                row["frame"].append(_frame_time(renderer, camera, state, method))
    _set(water, {}, camera.width)
    for row in rows.values():
        for part in ("stage", "frame"):
            row[part] = float(np.median(row[part])) if row[part] else None
        row["rays_per_second"] = len(water.pixel) / row["stage"] if row["stage"] else None
    return list(rows.values())


def _set(water, settings, width):
    """Set a quality level of the reflection; what is not named as by default."""
    fresh = type(water)(water.terrain, water.rings, water.config)
    for name in ("thickness", "mirror_share", "mirror_steps"):
        setattr(water, name, settings.get(name, getattr(fresh, name)))
    water.stride = settings["px"] / width if "px" in settings else fresh.stride


def _frame_time(renderer, camera, state, method):
    """Return the seconds of a whole frame of a moving camera with a method of reflection."""
    water = renderer.water
    before = water.config
    water.config = replace(before, reflections=method)
    start = time.perf_counter()
    renderer.draw(replace(camera), state)
    seconds = time.perf_counter() - start
    water.config = before
    return seconds


def other_levels(renderer, camera, state, rounds):
    """Return how far each other choice moves the water's picture from the default, and its time."""
    water = renderer.water
    before = water.config
    rows = []
    timings = {name: [] for name in ("as set", *OTHERS)}
    pictures = {}
    for _ in range(rounds):
        for name in timings:
            water.config = replace(before, **OTHERS.get(name, {}))
            water.coverage, water._mirrors = None, {}
            start = time.perf_counter()
            picture = water.draw(
                state, renderer._mirrored, None, renderer.environment, renderer._sun, Timer()
            )
            timings[name].append(time.perf_counter() - start)
            pictures[name] = picture.copy(), water.coverage.copy()
    water.config, water.coverage = before, None
    water.draw(state, renderer._mirrored, None, renderer.environment, renderer._sun, Timer())
    best, covered = pictures["as set"]
    wet = covered > 0
    for name, seconds in timings.items():
        picture, coverage = pictures[name]
        error = float(np.mean((picture[wet] - best[wet]) ** 2))
        rows.append({
            "name": name, "seconds": float(np.median(seconds)),
            "psnr": None if name == "as set" else -10 * np.log10(max(error, 1e-12)),
            "covers": float(coverage[wet].sum() / covered[wet].sum()),
        })  # fmt: skip
    return rows


def table(result):
    """Return all cases as text."""
    return "\n\n".join(_lines(case) for case in result["cases"])


def _lines(case):
    """Return the table of one case."""
    seen = case["causes"].get("seen", 0) / max(case["water_pixels"], 1)
    cost = case["traced"]
    lines = [
        f"{case['scene']}, {case['preset']}, {case['size'][0]} x {case['size'][1]}: "
        f"{case['water_pixels']} pixels of water, {seen:.0%} mirror what the camera sees",
        "  others: " + ", ".join(
            f"{name} {n / case['water_pixels']:.0%}" for name, n in case["causes"].items()
            if name != "seen"
        ),
        f"  traced: {cost['rays_per_second'] / 1e3:.1f} k rays/s, {cost['memory_mb']:.0f} MB; "
        f"colours seen from the camera instead: {_accuracy(case['view_dependence'])}",
        f"  {'reflection':24s} {'seen: dB, SSIM':>16s} {'all':>14s} {'false sky':>10s} "
        f"{'ms':>8s} {'M rays/s':>9s} {'MB':>6s} {'frame ms':>9s}",
    ]  # fmt: skip
    for row in case["levels"]:
        lines.append(
            f"  {row['name']:24s} {_accuracy(row['seen']):>16s} {_accuracy(row['all']):>14s} "
            f"{row['false_sky']:10.2%} {row['stage'] * 1e3:8.1f} "
            f"{row['rays_per_second'] / 1e6:9.2f} {row['memory_mb']:6.0f} "
            f"{row['frame'] * 1e3:9.1f}"
        )
    for row in case["others"]:
        error = "the default" if row["psnr"] is None else f"{row['psnr']:.1f} dB from it"
        lines.append(
            f"  {row['name']:24s} {error:>16s}, {row['seconds'] * 1e3:.1f} ms, "
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
    """Draw accuracy against time of the reflection levels, a panel for each case, as PNG."""
    pyplot = require_matplotlib()
    cases = result["cases"]
    columns = min(2, len(cases))
    rows = -(-len(cases) // columns)
    figure, axes = pyplot.subplots(
        rows, columns, figsize=(6.4 * columns, 4.2 * rows), squeeze=False, layout="constrained"
    )
    for axis in axes.flat[len(cases) :]:
        axis.set_visible(False)
    for axis, case in zip(axes.flat, cases, strict=False):
        for n, row in enumerate(case["levels"]):
            if row["seen"]["psnr"] is None:
                continue
            axis.plot(
                row["stage"] * 1e3, row["all"]["psnr"], marker=MARKERS[n % len(MARKERS)],
                color=COLORS[n % len(COLORS)], linestyle="", label=row["name"], markersize=7,
                fillstyle="full" if n < len(MARKERS) else "none",
            )  # fmt: skip
        axis.axvline(case["traced"]["seconds"] * 1e3, color="0.4", linestyle=":", linewidth=1)
        axis.annotate(
            "traced", (case["traced"]["seconds"] * 1e3, 1), rotation=90, fontsize=8,
            xycoords=("data", "axes fraction"), xytext=(-9, -36), textcoords="offset points",
        )  # fmt: skip
        axis.set(
            title=f"{case['scene']}, {case['preset']}",
            xscale="log",
            xlabel="ms a frame",
            ylabel="PSNR of mirrored radiance, all water [dB]",
        )
        axis.grid(alpha=0.3, which="both")
    axes.flat[0].legend(fontsize=7)
    figure.suptitle("Reflections against traced rays")
    figure.savefig(path, dpi=110, format="png")
    pyplot.close(figure)
