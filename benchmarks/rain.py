"""`benchmarks rain`: rain in a gauge over the rate asked for, waves, and time of each stage."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from benchmarks.chart import COLORS, MARKERS, log_ticks, require_matplotlib, save
from benchmarks.suite import in_turn, load_line, machine, markdown, quiet
from rainsim.constants import GRAVITY
from rainsim.drops import RainField, RainSpectrum, flat_surfaces, impacts
from rainsim.grid import WaterSolver
from rainsim.particles.fog import fog_optical_depth
from rainsim.particles.splash import WET_FILM
from rainsim.particles.splash_pass import draw_splashes
from rainsim.particles.streaks import draw_streaks, streak_reach
from rainsim.scene.types import Camera
from rainsim.scene.view import slopes
from rainsim.water.ripples import RippleTile, angular_frequency, tile_impacts

RATES = (1.0, 10.0, 50.0, 100.0)  # mm/h
GAUGE_DROPS = {False: 100_000, True: 10_000}
GAUGE_SEEDS = {False: 12, True: 2}
RATE, WIND = 50.0, (2.6, 1.5)  # mm/h, m/s: the downpour preset
FAR = 8.0  # m, beyond which drops are fog if all classes have one depth
EXPOSURES = (1 / 250, 1 / 60, 1 / 15)  # s
SIZES = {"648 x 420": (648, 420, 480.0), "1297 x 840": (1297, 840, 961.0)}
FRAME = 1 / 30  # s
MAP_SIDE, MAP_SPACING = 8.0, 0.02  # m
DEPTHS = (2e-3, 1e-2, 1e-1)  # m of water
WAVELENGTHS = (0.1, 0.05, 0.02, 0.01, 0.005)  # m
TILE_CELLS = (128, 256, 512)
ROUNDS = {False: 15, True: 2}  # alternating, of which the least and the median count
EYE_HEIGHT = 1.5  # m


def run(quick=False, say=quiet):
    """Return all figures, see `benchmarks.suite`."""
    say("gauge")
    gauge = [read_gauge(rate, GAUGE_DROPS[quick], GAUGE_SEEDS[quick]) for rate in RATES]
    say("waves")
    waves = [fit_wave(length, depth) for depth in DEPTHS for length in WAVELENGTHS]
    say("streaks")
    streaks = time_streaks(ROUNDS[quick])
    say("frame")
    frame = time_frame(ROUNDS[quick])
    say("ripple tiles")
    tiles = time_tiles(ROUNDS[quick])
    return {
        "gauge": gauge, "waves": waves, "streaks": streaks, "frame": frame, "tiles": tiles,
        "machine": machine(),
    }  # fmt: skip


def read_gauge(rate, drops, seeds=1):
    """Return the mean reading of gauges over the rain rate asked for, and its standard error.

    There is a gauge for each of the `seeds`, and `drops` fall on each. The errors of one gauge and
    of the mean follow from the number and the sizes of the drops.
    """
    spectrum = RainSpectrum(rate)
    duration = drops / (spectrum.density @ spectrum.speed) / 16
    ratios, spreads, count = [], [], 0
    for seed in range(1, seeds + 1):
        rain = RainField(spectrum, WIND, seed=seed)
        volume = impacts(rain, flat_surfaces(4, 4, 0.1), 0.0, duration).volume
        read = volume.sum() / 16 + spectrum.fine_rate * duration
        ratios.append(read / (spectrum.rate * duration))
        spreads.append(math.sqrt((volume**2).sum()) / volume.sum())
        count += len(volume)
    one = float(np.mean(spreads))
    return {
        "rate": rate, "drops": count, "ratio": float(np.mean(ratios)), "first": ratios[0],
        "sampling": one, "error": one / math.sqrt(seeds),
    }  # fmt: skip


def fit_wave(wavelength, depth):
    """Return the frequency [rad/s] of a wave on the tile, of theory and of shallow water."""
    waves = round(0.1 / wavelength)
    tile = RippleTile(size=0.1, cells=48, depth=depth)
    k = 2 * math.pi * waves / tile.size
    x = np.arange(tile.cells) / tile.cells
    tile.set_elevation(np.broadcast_to(1e-4 * np.cos(2 * np.pi * waves * x), (tile.cells,) * 2))
    exact = float(angular_frequency(k, depth))
    step = 6 * math.pi / exact / 120
    height = [tile.elevation[0, 0]]
    for _ in range(120):
        tile.advance(step)
        height.append(tile.elevation[0, 0])
    height = np.array(height)
    before = np.flatnonzero(np.diff(np.sign(height)))
    at = before * step - height[before] * step / np.diff(height)[before]
    return {
        "wavelength": wavelength, "depth": depth, "wavenumber": k, "theory": exact,
        "fitted": float(math.pi / np.diff(at).mean()), "shallow": k * math.sqrt(GRAVITY * depth),
    }  # fmt: skip


def level_camera(width, height, focal):
    """Return a level camera at EYE_HEIGHT that looks along x, and the depth of level ground."""
    matrix = np.eye(4)
    matrix[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    matrix[1, 3] = EYE_HEIGHT
    below = (np.arange(height) + 0.5 - height / 2) / focal
    row = np.where(below > 0, EYE_HEIGHT / np.maximum(below, 1e-9), np.inf)
    depth = np.ascontiguousarray(np.broadcast_to(row[:, None], (height, width)), np.float32)
    return Camera(width, height, focal, focal, width / 2, height / 2, matrix), depth


def time_streaks(rounds):
    """Return time and optical depth of streaks with one depth of fog for all classes, and one each.

    Both ways alternate, so that the load of the machine affects both.
    """
    field, ground = RainField(RainSpectrum(RATE), WIND), _ground()
    records = []
    for name, size in SIZES.items():
        camera, depth = level_camera(*size)
        alpha = np.empty(depth.shape, np.float32)
        seen = np.minimum(depth, 30.0).astype(np.float64)
        for exposure in EXPOSURES:
            reach = streak_reach(field, camera, exposure, FAR)
            jobs = {"one split": np.full_like(reach, FAR), "by class": reach}
            arguments = (field, ground, camera, 1.0, exposure, depth)
            milliseconds = in_turn(
                {way: partial(draw_streaks, *arguments, far, alpha) for way, far in jobs.items()},
                rounds,
            )
            for way, far in jobs.items():
                draw_streaks(*arguments, far, alpha)
                drawn = float(-np.log1p(-alpha.astype(np.float64)).mean())
                fog = float((fog_optical_depth(field, seen, far) * _slant(camera)).mean())
                records.append(
                    {
                        "size": name,
                        "exposure": exposure,
                        "way": way,
                        **milliseconds[way],
                        "drops": _expected(field, camera, far),
                        "drawn": drawn,
                        "total": drawn + fog,
                    }
                )
    return records


def _slant(camera):
    """Return one over the cosine of each pixel's angle off the axis."""
    v, u = np.indices((camera.height, camera.width)) + 0.5
    return np.hypot(1, np.hypot(*slopes(camera, u, v)))


def _expected(field, camera, far):
    """Return the mean number of drops in the view up to `far` of each class, without occlusion."""
    window = camera.width * camera.height / (camera.fx * camera.fy)
    return float((field.spectrum.density * far**3).sum() * window / 3)


def time_frame(rounds):
    """Return the times of a frame's drops, deposits, ripples and splashes on the map."""
    field, ground = RainField(RainSpectrum(RATE), WIND), _ground()
    solver = WaterSolver(ground.ground, MAP_SPACING, boundary="open")
    solver.set_state(np.full(ground.shape, 2e-3))
    tile = RippleTile(depth=0.01, dtype=np.float32)
    camera, depth = level_camera(*SIZES["648 x 420"])
    alpha = np.empty(depth.shape, np.float32)
    water = np.full(ground.shape, 2e-3, np.float32)
    found = impacts(field, ground, 1.0, 1.0 + FRAME)
    falls = tile_impacts(found, ground.area, tile.size, 1.0 + FRAME)
    jobs = {
        "drops": lambda: impacts(field, ground, 1.0, 1.0 + FRAME),
        "deposits": lambda: solver.deposit(found.row, found.column, found.volume),
        "ripples": lambda: (tile.advance(FRAME, *falls), tile.slopes()),
        "splashes": lambda: draw_splashes(
            field, ground, camera, 1.0, 1 / 60, water, WET_FILM, depth, alpha
        ),
    }
    return {"impacts": len(found), **in_turn(jobs, rounds)}


def time_tiles(rounds):
    """Return the time of a frame's step of ripple tiles of several sizes and types."""
    field, ground = RainField(RainSpectrum(RATE), WIND), _ground()
    found = impacts(field, ground, 1.0, 1.0 + FRAME)
    jobs = {}
    for cells in TILE_CELLS:
        for dtype in ("float32", "float64"):
            tile = RippleTile(cells=cells, dtype=dtype)
            falls = tile_impacts(found, ground.area, tile.size, 1.0 + FRAME)
            jobs[f"{cells} {dtype}"] = lambda tile=tile, falls=falls: tile.advance(FRAME, *falls)
    return in_turn(jobs, rounds)


def _ground():
    return flat_surfaces(MAP_SIDE, MAP_SIDE, MAP_SPACING, (0.0, -MAP_SIDE / 2))


def table(result):
    """Return the figures as text in Markdown."""
    parts = {k: v for k, v in result["frame"].items() if k != "impacts"}
    times = {**parts, **{f"ripple tile {name}": t for name, t in result["tiles"].items()}}
    total = sum(t["least_ms"] for t in parts.values())
    return "\n".join([
        *markdown(
            ("rain mm/h", "drops", "mean gauge / asked", "error of the mean", "error of one gauge"),
            [(f"{g['rate']:g}", g["drops"], f"{g['ratio']:.4f}", f"{g['error']:.4f}",
              f"{g['sampling']:.4f}") for g in result["gauge"]],
        ), "",
        *markdown(
            ("depth mm", "wavelength mm", "fitted / theory", "shallow water / theory"),
            [(f"{w['depth'] * 1e3:g}", f"{w['wavelength'] * 1e3:g}",
              f"{w['fitted'] / w['theory']:.4f}", f"{w['shallow'] / w['theory']:.2f}")
             for w in result["waves"]],
        ), "",
        *markdown(
            ("streaks", "exposure ms", "split", "drops", "least ms", "median ms", "drawn + fog"),
            [(s["size"], f"{s['exposure'] * 1e3:.3g}", s["way"], f"{s['drops']:.0f}",
              f"{s['least_ms']:.1f}", f"{s['median_ms']:.1f}", f"{s['total']:.5f}")
             for s in result["streaks"]],
        ), "",
        *markdown(
            ("part of a frame", "least ms", "median ms"),
            [(name, f"{t['least_ms']:.2f}", f"{t['median_ms']:.2f}") for name, t in times.items()],
        ),
        f"| drops, deposits, ripples, splashes | {total:.2f} | |", "", load_line(result),
    ])  # fmt: skip


def draw(result, path):
    """Draw the dispersion of tile, theory and shallow water, and the times of ripple tiles."""
    pyplot = require_matplotlib()
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(8.4, 3.8), layout="constrained")
    for n, depth in enumerate(DEPTHS):
        own = [w for w in result["waves"] if w["depth"] == depth]
        k = np.geomspace(50, 1600, 200)
        style, water = {"color": COLORS[n], "linewidth": 1.2}, f"{depth * 1e3:g} mm of water"
        left.plot(k, angular_frequency(k, depth), **style)
        left.plot(k, k * math.sqrt(GRAVITY * depth), **style, linestyle=":")
        left.plot([w["wavenumber"] for w in own], [w["fitted"] for w in own], MARKERS[n],
                  color=COLORS[n], markersize=5, label=f"tile, {water}")  # fmt: skip
    left.plot([], [], color="0.3", linewidth=1.2, label="theory")
    left.plot([], [], color="0.3", linewidth=1.2, linestyle=":", label="shallow water alone")
    left.set(xlabel="wavenumber [rad/m]", ylabel="frequency [rad/s]", title="Dispersion of waves")
    for n, dtype in enumerate(("float32", "float64")):
        cost = [result["tiles"][f"{cells} {dtype}"]["least_ms"] for cells in TILE_CELLS]
        label, width = (f"{dtype} (default)", 2.2) if n == 0 else (dtype, 1.2)
        right.plot(TILE_CELLS, cost, marker=MARKERS[n], color=COLORS[n], label=label,
                   linewidth=width, markersize=7 if n == 0 else 5)  # fmt: skip
    right.set(xlabel="cells along a side", ylabel="least processor time of a frame [ms]",
              title="Cost of a ripple tile")  # fmt: skip
    for axis in (left, right):
        log_ticks(axis)
        axis.legend(fontsize=8)
    right.set_xticks(TILE_CELLS, [str(cells) for cells in TILE_CELLS])
    save(figure, path)
