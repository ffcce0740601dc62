"""How well the ground is found, and how long it takes, on captures whose truth is known."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
from scipy import ndimage

from benchmarks import captures
from benchmarks.chart import draw_fronts
from benchmarks.suite import quiet
from rainsim.config.settings import TerrainConfig
from rainsim.errors import GroundError
from rainsim.scene.ground import estimate_ground_frame
from rainsim.terrain.extract import extract_terrain
from rainsim.terrain.types import MEASURED, UNKNOWN
from rainsim.water.fill_spill_merge import standing_water
from rainsim.water.puddles import WET, puddles_of

NOISES = (1e-3, 3e-3, 10e-3)  # m
RAIN = 5e-3  # m: fills dips that are 5 mm deep
SPACINGS = (0.04, 0.02, 0.01)  # m
USUAL = 0.02  # m, of the cells of a capture of a yard's density
UP_HINT_ERROR = 5.0  # degrees between the true up and the up given for captures without cameras
FRAMES = 50  # captures whose ground frame is estimated
FOLDS = ((4, 0.5), (8, 0.5), (15, 0.55), (25, 0.5), (-8, 0.5), (8, 0.7), (25, 0.7), (-15, 0.7))
WRONG = 2.0  # degrees: a ground found farther off than that counts as wrong


def run(quick=False, say=quiet):
    """Return figures on frames, beds, dips and a street; see `benchmarks.suite`."""
    seeds = 2 if quick else 10
    spacings = (0.02,) if quick else SPACINGS
    measure_bed(*captures.yard(0), 0.05)  # compiles; not timed
    number = seeds if quick else FRAMES
    say(f"ground frames of {number} captures")
    frames = []
    for seed in range(number):
        capture = captures.yard(seed, NOISES[seed % 3], kerb=seed % 2 == 1, step=0.05)
        frames.append(measure_frames(*capture, seed))
    folds = [measure_fold(*fold, seed) for seed in range(max(1, seeds // 2)) for fold in FOLDS]
    beds = []
    for noise in NOISES:
        say(f"beds with {noise * 1e3:g} mm of noise")
        made = [captures.yard(100 + seed, noise, kerb=seed % 2 == 1) for seed in range(seeds)]
        for spacing in spacings:
            rows = [measure_bed(*capture, spacing) for capture in made]
            beds.append({"noise_mm": noise * 1e3, "spacing_m": spacing, **_summary(rows)})
    say("a street of 300 m")
    return {
        "captures": seeds,
        "frame_captures": number,
        "frames": _summary(frames),
        "two_planes": _summary(folds),
        "beds": beds,
        "street": measure_street(),
    }


def table(result):
    """Return the figures as lines: mean and, in brackets, the worst over the captures."""
    lines = [f"{result['captures']} captures per case, mean (worst)"]
    lines += ["", f"ground frame, {result['frame_captures']} captures"]
    lines += [f"  {key:<22} {_shown(value)}" for key, value in result["frames"].items()]
    lines += ["", "two planes that meet"]
    lines += [f"  {key:<22} {_shown(value)}" for key, value in result["two_planes"].items()]
    for row in result["beds"]:
        lines += ["", f"bed, {row['noise_mm']:g} mm of noise, cells of {row['spacing_m']:g} m"]
        lines += [f"  {key:<22} {_shown(v)}" for key, v in row.items() if isinstance(v, dict)]
    lines += ["", "street"]
    lines += [f"  {key:<22} {value:.4g}" for key, value in result["street"].items()]
    return "\n".join(lines)


def _shown(value):
    return f"{value['mean']:.3g} ({value['worst']:.3g})"


def draw(result, path):
    """Draw the bed's error against time for each noise of the splats, by size of cell, as PNG."""
    panels = {}
    for row in result["beds"]:
        panel = panels.setdefault(f"{row['noise_mm']:g} mm of noise", {"lines": {}})
        point = row["terrain_seconds"]["mean"], row["bed_mm"]["mean"]
        panel["lines"][f"cells of {1e2 * row['spacing_m']:g} cm"] = [point]
    draw_fronts(
        path, panels, f"Ground of {result['captures']} generated yards, by noise of their splats",
        default=f"cells of {1e2 * USUAL:g} cm", error="rms error of the bed [mm]",
        time="processor time", own=True,
    )  # fmt: skip


def _summary(rows):
    """Return mean and worst (largest) of each figure over the captures.

    `rows` holds a dict for each capture. A figure that is None in a row is skipped there; one that
    is None in all is left out.
    """
    result = {}
    for key in rows[0]:
        values = [row[key] for row in rows if row[key] is not None]
        if values:
            result[key] = {"mean": float(np.mean(values)), "worst": float(np.max(values))}
    return result


def measure_frames(scene, truth, seed):
    """Return errors of the ground frame [degrees, share of the scale] with and without cameras."""
    start = time.perf_counter()
    found = estimate_ground_frame(scene.splats, scene.cameras)
    seconds = time.perf_counter() - start
    rng = np.random.default_rng(seed)
    hint = truth.frame.up + math.tan(math.radians(UP_HINT_ERROR)) * _across(truth.frame.up, rng)
    result = {
        "up_degrees": angle(found.up, truth.frame.up),
        "wrong_sign": float(found.up @ truth.frame.up < 0),
        "frame_seconds": seconds,
        "blind_degrees": None,
        "blind_refused": 0.0,
    }
    try:
        blind = estimate_ground_frame(
            scene.splats, (), up=hint, meters_per_unit=truth.frame.meters_per_unit
        )
        result["blind_degrees"] = angle(blind.up, truth.frame.up)
    except GroundError:
        result["blind_refused"] = 1.0
    return result


def measure_fold(degrees, share, seed):
    """Return whether two planes are refused or the ground is found; the first covers `share`.

    Planes as good as each other (0.5 to 0.6) must be refused, else the larger one must be found.
    """
    scene, truth = captures.fold(seed, degrees, share)
    try:
        found = angle(estimate_ground_frame(scene.splats, scene.cameras).up, truth.frame.up)
    except GroundError:
        found = None
    said = estimate_ground_frame(scene.splats, scene.cameras, up=truth.frame.up)
    return {
        "refused": float(found is None),
        "needlessly": float(found is None) if share > 0.6 else None,
        "wrong": float(found is not None and found > WRONG),
        "told_degrees": angle(said.up, truth.frame.up),
    }


def _across(up, rng):
    way = np.cross(up, rng.normal(size=3))
    return way / np.linalg.norm(way)


def angle(a, b):
    """Return the angle between two directions in degrees."""
    return math.degrees(math.atan2(np.linalg.norm(np.cross(a, b)), a @ b))


def measure_bed(scene, truth, spacing=0.02):
    """Return errors of the bed [mm] and of the puddles [share] with the true frame."""
    scene = replace(scene, ground_frame=truth.frame)
    start = time.process_time()
    terrain = extract_terrain(scene, TerrainConfig(spacing=spacing, extent=3.0))
    seconds = time.process_time() - start
    x, y = np.meshgrid(*terrain.grid.centres())
    bed = truth.bed(x, y)
    error = terrain.bed - bed
    kerb = truth.bed(3 * captures.KERB_X, 0.0) > truth.bed(-3 * captures.KERB_X, 0.0) + 0.05
    inside = np.maximum(np.abs(x), np.abs(y)) < truth.half - 0.15
    smooth = inside & (np.abs(x - captures.KERB_X) > 0.1) if kerb else inside
    tx, ty, half, height = captures.TABLE
    under = (np.abs(x - tx) < half - 0.05) & (np.abs(y - ty) < half - 0.05)
    top = terrain.top - truth.bed(x, y) - height
    beside = np.maximum(np.abs(x - tx), np.abs(y - ty)) > half + 0.15
    puddles = puddles_of(terrain)
    puddles.rain(RAIN)
    wet = puddles.depth >= WET
    lawn = np.maximum(np.abs(x), np.abs(y)) > truth.half
    true_depth = standing_water(bed, RAIN, spacing, permeable=lawn)[0]
    true_wet = ndimage.binary_dilation(true_depth >= WET / 2, iterations=2)
    dips = [np.hypot(x - cx, y - cy) < captures.DIP_WIDTH / 2 for cx, cy in truth.dips]
    held = [here for here in dips if (true_depth[here] >= WET).any()]
    found = sum((wet & here).any() for here in held)
    return {
        "bed_mm": float(np.sqrt(np.mean((error[smooth] - error[smooth].mean()) ** 2))) * 1e3,
        "bias_mm": abs(float(error[smooth].mean())) * 1e3,
        "under_table_mm": float(np.percentile(np.abs(error[under]), 95)) * 1e3,
        "under_table_unknown": float(np.mean(terrain.source[under] == UNKNOWN)),
        "table_top_mm": float(np.percentile(np.abs(top[under]), 95)) * 1e3,
        "false_cover": float(np.mean((terrain.top > terrain.bed)[beside])),
        "kerb_cells": _kerb_error(terrain, x, y) if kerb else None,
        "dips_missed": 1 - found / max(len(held), 1),
        "false_puddles": float(np.mean((wet & ~true_wet)[smooth])),
        "terrain_seconds": seconds,
    }


def _kerb_error(terrain, x, y):
    """Return the error of the kerb's edge in cells, 90th percentile over the rows."""
    rows = np.flatnonzero(np.abs(y[:, 0]) < 1.5)
    band = np.abs(x[0] - captures.KERB_X) < 0.3
    profile = terrain.bed[np.ix_(rows, np.flatnonzero(band))]
    middle = (profile[:, :3].mean(axis=1) + profile[:, -3:].mean(axis=1)) / 2
    first = np.argmax(profile > middle[:, None], axis=1)
    edge = x[0, band][first] - terrain.grid.spacing / 2
    return float(np.percentile(np.abs(edge - captures.KERB_X), 90)) / terrain.grid.spacing


def measure_street(spacing=0.1):
    """Return errors of the bed of a 300 m street [mm], its frame found, and the time."""
    scene, truth = captures.street(0)
    scene = replace(scene, ground_frame=truth.frame)
    start = time.perf_counter()
    terrain = extract_terrain(scene, TerrainConfig(spacing=spacing))
    seconds = time.perf_counter() - start
    x, y = np.meshgrid(*terrain.grid.centres())
    lane = (np.abs(y) < truth.half - 0.3) & (np.abs(x) < captures.STREET_LENGTH / 2 - 2)
    error = terrain.bed[lane] - truth.bed(x[lane], y[lane])
    return {
        "length_m": terrain.grid.size[0],
        "cells": terrain.bed.size,
        "measured": float(np.mean(terrain.source[lane] == MEASURED)),
        "bed_mm": float(np.sqrt(np.mean(error**2))) * 1e3,
        "terrain_seconds": seconds,
    }
