"""The part of `benchmarks frame` that runs on a GPU: the same levels, sizes and stages.

The simulation runs with the picture, as it does in use. The truth is the CPU's, see
`benchmarks.frame`; so is the row named CPU, for comparison on the same machine.
"""

from __future__ import annotations

import dataclasses
import gc
import itertools
import time

import numpy as np

from benchmarks import frame_levels
from benchmarks.frame_levels import TRUTH, TRUTH_SCALE
from benchmarks.traced import trace_reflections
from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.errors import ParameterError
from rainsim.render.renderer import Renderer
from rainsim.render.report import Timer

WIDTHS = {False: (648, 1296, 2592), True: (32,)}  # px
SHOTS = {False: 40, True: 2}  # frames drawn one by one of each level, of which the median counts
SETTLING = {False: 8, True: 0}  # frames before them, for which lists find their size
FRAMES = {False: 2, True: 1}  # compared with the truth
SPACING = {False: 0.02, True: 0.2}  # m
EXTENT = {False: None, True: 1.0}  # m
CPU = "as set, CPU"
# Besides `frame_levels.LEVELS`; wide pictures are drawn as set and with the finer map.
LEVELS = {"as set": ({}, 1.0), "map 1 cm": ({"spacing": 0.5}, 1.0)}
MEBIBYTE = 2.0**20


def measure(scene, width, motion, quick, say):
    """Return a row of times, memory and error for each level, one scene, width and motion."""
    count, shots = FRAMES[quick], SHOTS[quick]
    config = Config.from_preset(frame_levels.PRESET).replace(
        width=width, frames=count + SETTLING[quick] + shots, spacing=SPACING[quick],
        extent=EXTENT[quick],
    )  # fmt: skip
    cameras = frame_levels.cameras_of(scene, motion, config.frames + 1)[:-1]
    height = round(width * cameras[0].height / cameras[0].width)
    small = width <= frame_levels.TRUTH_WIDTH
    levels = LEVELS | {n: v for n, v in frame_levels.LEVELS.items() if small and n not in LEVELS}
    grounds, truths, rows = {}, [], []

    def setting(changes, scale):
        """Return settings, ground and cameras of a level."""
        changes = dict(changes)
        if "spacing" in changes:
            changes["spacing"] *= config.terrain.spacing
        settings = config.replace(**changes)
        if settings.terrain not in grounds:
            grounds[settings.terrain] = pipeline.extract_terrain(scene, settings)
        size = max(8, round(width * scale)), max(8, round(height * scale))
        return settings, grounds[settings.terrain], [camera.resized(*size) for camera in cameras]

    def row(name, milliseconds, least, pictures, ground, **more):
        errors = [frame_levels.error_of(*pair) for pair in zip(pictures, truths, strict=False)]
        return {
            "scene": scene.name, "width": width, "height": height, "motion": motion, "level": name,
            "milliseconds": milliseconds, "least_ms": least, "cells": ground.grid.shape,
            "rmse": float(np.sqrt(np.mean(np.square(errors)))) if errors else None, **more,
        }  # fmt: skip

    if small:
        truths = _true_pictures(scene, *setting(TRUTH, TRUTH_SCALE), count)
        rows.append(row(CPU, *_on_the_cpu(scene, *setting({}, 1.0), count)))
    for name, (changes, scale) in levels.items():
        settings, ground, sized = setting(changes, scale)
        try:
            found = _on_the_gpu(scene, settings, ground, sized, count, quick)
        except ParameterError as error:
            say(f"{name}: {error}")
            continue
        times, pictures, more = found
        rows.append(row(name, times, more.pop("least"), pictures, ground, **more))
    return rows


def _true_pictures(scene, settings, ground, cameras, count):
    best = trace_reflections(Renderer(scene, ground, settings, cameras[0]))
    states = itertools.islice(pipeline.simulate(ground, settings), count)
    return [
        frame_levels.shrunk(best.draw(camera, state)[0])
        for camera, state in zip(cameras, states, strict=False)
    ]


def _on_the_cpu(scene, settings, ground, cameras, count):
    """Draw the first `count` frames three times on the CPU, after one untimed, which compiles.

    Return the median time [ms] of each stage and, under "frame", of the whole; the fastest frame's
    time [ms]; the frames; and the ground, which `measure` needs for a row of its table.
    """
    own, times, pictures = Renderer(scene, ground, settings, cameras[0]), [], []
    states = list(itertools.islice(pipeline.simulate(ground, settings), count))
    own.draw(cameras[-1], states[0])
    for _ in range(3):
        for camera, state in zip(cameras, states, strict=False):
            begin = time.perf_counter()
            picture, report = own.draw(camera, state)
            times.append({**report.milliseconds, "frame": (time.perf_counter() - begin) * 1e3})
            pictures.append(picture)
    medians = {s: float(np.median([one.get(s, 0.0) for one in times])) for s in times[0]}
    return medians, min(one["frame"] for one in times), pictures[:count], ground


def _on_the_gpu(scene, settings, ground, cameras, count, quick):
    """Draw frames on the GPU and time them.

    Return the time [ms] of each stage and, under "frame", the median of the whole; the first
    `count` frames; and memory_mib, least (the fastest frame [ms]) and sequence_ms, the median time
    from frame to frame of a sequence, or None.
    """
    from rainsim.cuda.render.renderer import Renderer as OnGpu
    from rainsim.cuda.simulation import simulate

    before = _memory_in_use()
    own, pictures, times = OnGpu(scene, ground, settings, cameras[0]), [], []
    for n, camera, state in zip(itertools.count(), cameras, simulate(ground, settings)):
        begin = time.perf_counter()
        picture, _ = own.draw(camera, state)
        times.append((time.perf_counter() - begin) * 1e3)
        if n < count:
            pictures.append(picture.copy())
        if n + 1 == len(cameras):
            break
    times = times[count + SETTLING[quick] :]
    clocked = []
    for camera in cameras[-max(SETTLING[quick], 1) :]:  # apart: the host waits after each stage
        timer = Timer()
        own.draw(dataclasses.replace(camera), state, timer=timer)
        clocked.append(timer.stages)
    stages = {name: float(np.median([one[name] for one in clocked])) for name in clocked[0]}
    memory = (_memory_in_use() - before) / MEBIBYTE
    del own, picture, state
    sequence = []
    begin = time.perf_counter()
    states = itertools.islice(simulate(ground, settings), len(cameras))
    for _ in pipeline.render(scene, ground, states, cameras, settings, backend="cuda"):
        sequence.append(time.perf_counter() - begin)
    each = np.diff(sequence)[SETTLING[quick] :] * 1e3
    more = {
        "memory_mib": memory, "least": min(times),
        "sequence_ms": float(np.median(each)) if len(each) else None,
    }  # fmt: skip
    return {**stages, "frame": float(np.median(times))}, pictures, more


def _memory_in_use():
    """Return the bytes of device memory in use, after unused memory has been freed."""
    from rainsim.cuda.jit import SIMULATED, cuda

    if SIMULATED:
        return 0
    gc.collect()
    context = cuda.current_context()
    cuda.synchronize()
    context.memory_manager.deallocations.clear()
    free, total = context.get_memory_info()
    return total - free


def machine():
    """Return name and memory of the GPU, as a dict."""
    from rainsim.cuda import device

    found = device()
    return {"gpu": found["name"], "gpu_mib": found["total"] / MEBIBYTE}
