"""`rainsim bench lod`: a long street in chunks: accuracy against memory and time, and a drive.

The built-in street's middle is repeated along its length and cut into chunks at several levels of
detail. Rainy frames at some places are compared with the same frames of all splats, over the
threshold that decides how fine each part is drawn. A drive from end to end shows whether time and
memory stay as they are.
"""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from rainsim import pipeline
from rainsim.bench.chart import COLORS, MARKERS, require_matplotlib
from rainsim.config.settings import Config
from rainsim.jit import set_threads
from rainsim.lod.cut import cut
from rainsim.render.renderer import Renderer
from rainsim.render.shutter import shutter_end
from rainsim.scene.actors import joined
from rainsim.scene.big import open_pages
from rainsim.scene.cameras import resize_to
from rainsim.scene.library import load_scene
from rainsim.scene.types import Scene

PRESET = "moderate"
MIDDLE = 0.0, 16.0  # m of the built-in street that are repeated: where it is densest
WIDE = 15.0  # m to either side
SKY = 100.0  # m from the middle from where on splats are sky
LENGTH = {False: 200.0, True: 40.0}  # m
DETAILS = {False: (0.35, 0.5, 0.7, 1.0, 1.5, 2.0, 4.0), True: (1.0, 8.0)}  # px
PLACES = {False: 4, True: 1}  # along the street, two frames each
WIDTH = {False: 648, True: 96}  # px
SPEED, FPS = 10.0, 2.0  # m/s, 1/s: of the drive that shows time and memory
NEXT = 1 / 24  # s from a frame to the next at a place
SPACING, EXTENT = {False: 0.05, True: 0.2}, {False: 12.0, True: 4.0}  # m, of the map
AWAY = 4.0  # m from either end of the street that the drive keeps
AHEAD = 4  # frames
FRAMES = {False: 9, True: 3}  # of a short drive at a place, NEXT apart
EVERYTHING = 64e9  # bytes: full detail is drawn whatever it takes


def run(quick=False, say=None, length=None, folder=None):
    """Run the whole bench.

    Parameters
    ----------
    quick : bool
        A short street, small pictures, two thresholds.
    say : callable, optional
        Called with a line of text for each step.
    length : float, optional [m]
        Of the street.
    folder : path-like, optional
        Where the chunks are kept, and taken from if they are there; without it they are deleted.

    Returns
    -------
    dict
        "machine", "cut" (splats, seconds, bytes), "rows" (a threshold each), "drive" (a frame
        each) and "alone" (a place each).
    """
    length = LENGTH[quick] if length is None else length
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "street" if folder is None else Path(folder)
        facts = {} if (folder / "lod-meta.json").is_file() else make(folder, length)
        if say and facts:
            say(f"cut: {facts['splats']} splats in {facts['seconds']:.0f} s")
        scene = long_street(folder, length)
        facts |= {"splats": scene.count, "length": length, "bytes": _bytes(folder)}
        config = Config.from_preset(PRESET).replace(
            frames=1, width=WIDTH[quick], spacing=SPACING[quick], extent=EXTENT[quick], fps=FPS
        )
        begin = time.perf_counter()
        terrain = pipeline.extract_terrain(scene, config)
        drive = measure_drive(folder, length, terrain, config, say)
        alone = measure_alone(folder, length, terrain, config, PLACES[quick], FRAMES[quick], say)
        rows = measure_details(folder, length, terrain, config, DETAILS[quick], PLACES[quick], say)
        facts["set_up"] = drive[0]["begin"] - begin
    machine = {"cores": os.cpu_count(), "threads": set_threads(None), "load": os.getloadavg()}
    return {"machine": machine, "quick": quick, "cut": facts, "rows": rows, "drive": drive,
            "alone": alone}  # fmt: skip


# --- the street -----------------------------------------------------------------------------------


def make(folder, length):
    """Cut a street of a length [m] into chunks in a folder; return its splats and the seconds."""
    begin = time.perf_counter()
    counts = cut(folder, lambda: street_blocks(length))
    return {"splats": counts[0], "seconds": time.perf_counter() - begin}


def street_blocks(length):
    """Yield the splats of a street of a length [m]: the middle of the built-in one, and its sky."""
    scene = load_scene("street")
    frame = scene.ground_frame
    place = frame.to_ground(scene.splats.position.astype(np.float64))
    inside = (place[:, 0] >= MIDDLE[0]) & (place[:, 0] < MIDDLE[1]) & (np.abs(place[:, 1]) < WIDE)
    middle, step = scene.splats.take(inside), MIDDLE[1] - MIDDLE[0]
    for n in range(max(1, round(length / step))):
        shift = frame.rotation.T @ (n * step, 0, 0) / frame.meters_per_unit
        yield replace(middle, position=middle.position + shift.astype(np.float32))
    yield scene.splats.take(np.linalg.norm(place[:, :2], axis=1) > SKY)


def long_street(folder, length):
    """Return the Scene of a street in chunks, with the cameras of a drive from end to end."""
    built_in = load_scene("street")
    frame, first = built_in.ground_frame, built_in.cameras[0]
    pages, splats, digest, notes = open_pages(folder)
    view, step = frame.camera_in_ground(first), SPEED / FPS
    cameras = []
    for k in range(max(2, int((length - 2 * AWAY) / step))):
        moved = view.camera_from_world.copy()
        moved[:3, 3] -= moved[:3, :3] @ (AWAY + k * step, 0, 0)
        cameras.append(frame.camera_in_capture(replace(view, camera_from_world=moved)))
    source = Path(folder)
    return Scene("long street", splats, tuple(cameras), frame, source, digest, notes, pages=pages)


def _bytes(folder):
    return sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())


# --- measuring ------------------------------------------------------------------------------------


def measure_drive(folder, length, terrain, config, say=None):
    """Return a row for each frame of a drive along the street, in order, each drawn once.

    The frame in the middle is drawn by itself, too, by another renderer: its row says whether both
    are the `same` to the byte.
    """
    scene = long_street(folder, length)
    cameras = [resize_to(camera, config.width) for camera in scene.cameras]
    path = [scene.ground_frame.camera_in_ground(camera) for camera in cameras]
    state = next(iter(pipeline.simulate(terrain, config)))
    renderer = Renderer(scene, terrain, config, cameras[0])
    rows, kept, middle = [], scene.pages.kept, len(cameras) // 2
    for n, camera in enumerate(cameras):
        begin, cpu, made = time.perf_counter(), time.process_time(), kept.made
        renderer.read_ahead(cameras[min(n + AHEAD, len(cameras) - 1)])
        exposure = config.render.exposure
        end = shutter_end(path, n, exposure, config.fps)
        picture, report = renderer.draw(camera, state, end)
        if n == middle:
            wanted = picture.copy(), end
        rows.append({
            "x": float(path[n].position[0]), "begin": begin,
            "ms": (time.perf_counter() - begin) * 1e3, "cpu_ms": (time.process_time() - cpu) * 1e3,
            "splat_ms": report.milliseconds["splat"],
            "splats": seen_splats(renderer, camera),
            "kept": kept.size, "read": kept.made - made, "resident": resident(),
        })  # fmt: skip
        if say and n % 20 == 0:
            say(drive_line(rows[-1]))
    del renderer, scene, kept  # two scenes at once are not what is measured
    by_itself = Renderer(long_street(folder, length), terrain, config, cameras[0])
    found, _ = by_itself.draw(cameras[middle], state, wanted[1])
    rows[middle]["same"] = bool(np.array_equal(found, wanted[0]))
    return rows


def measure_details(folder, length, terrain, config, details, places, say=None):
    """Return a row for each threshold: accuracy of frames along the street, splats and time."""
    state = next(iter(pipeline.simulate(terrain, config)))
    truth, rows = None, []
    for detail in (0.0, *details):
        memory = EVERYTHING if detail == 0 else config.render.memory
        settings = config.replace(detail=detail, memory=memory)
        scene = long_street(folder, length)
        every = np.linspace(0, len(scene.cameras) - 1, places + 2).astype(int)[1:-1]
        cameras = [resize_to(scene.cameras[n], config.width) for n in every]
        renderer = Renderer(scene, terrain, settings, cameras[0])
        shown, splats, cpu = [], [], []
        for camera in cameras:
            renderer.draw(camera, state)  # reads what it needs
            pair = []
            for shift in (0.0, SPEED * NEXT):
                begin = time.process_time()
                pair.append(renderer.draw(ahead(scene, camera, shift), state)[0].astype(float))
                cpu.append((time.process_time() - begin) * 1e3)
            shown.append(pair)
            splats.append(seen_splats(renderer, camera))
        if truth is None:
            truth = shown
        error = [np.mean((a - b) ** 2) for pair, true in zip(shown, truth, strict=True)
                 for a, b in zip(pair, true, strict=True)]  # fmt: skip
        decibels = 10 * np.log10(255**2 / np.maximum(error, 1e-9))
        flicker = _flicker(shown) / _flicker(truth) - 1
        rows.append({
            "detail": detail, "median_db": float(np.median(decibels)),
            "worst_db": float(decibels.min()), "flicker": float(flicker),
            "splats": float(np.mean(splats)), "cpu_ms": float(np.median(cpu)),
            "kept": scene.pages.kept.size,
        })  # fmt: skip
        if say:
            say(detail_line(rows[-1]))
    return rows


def measure_alone(folder, length, terrain, config, places, frames, say=None):
    """Return a row for each place of a street: frames from its chunks, and of what is seen alone.

    The scene that is compared with holds whole the runs that the cameras of a short drive need,
    each at the finest level that one of them asks for, and the splats that are always drawn.
    """
    scene = long_street(folder, length)
    state = next(iter(pipeline.simulate(terrain, config)))
    every = np.linspace(0, len(scene.cameras) - 1, places + 2).astype(int)[1:-1]
    start = resize_to(scene.cameras[every[0]], config.width)
    paged, rows = Renderer(scene, terrain, config, start), []
    for n in every:
        first = resize_to(scene.cameras[n], config.width)
        cameras = [ahead(scene, first, k * SPEED * NEXT) for k in range(frames)]
        runs, drawn = {}, paged.wet_scene.paged.whole
        for camera in cameras:
            for leaf, level in drawn.wanted(camera, paged.wet_scene.near):
                runs[leaf] = min(level, runs.get(leaf, level))
        held = [scene.pages.splats(*run) for run in sorted(runs.items())]
        whole = replace(scene, splats=joined(held), pages=None)
        alone = Renderer(whole, terrain, config, first)
        cpu = {paged: [], alone: []}
        for renderer in cpu:
            renderer.draw(ahead(scene, first, -SPEED * NEXT), state)  # reads what it needs
        for k, camera in enumerate(cameras):
            for renderer in cpu:
                begin = time.process_time()
                if renderer is paged:
                    renderer.read_ahead(cameras[min(k + AHEAD, frames - 1)])
                renderer.draw(camera, state)
                cpu[renderer].append((time.process_time() - begin) * 1e3)
        rows.append({
            "splats": len(whole.splats), "cpu_ms": float(np.median(cpu[paged])),
            "alone_ms": float(np.median(cpu[alone])),
        })  # fmt: skip
        if say:
            say(alone_line(rows[-1]))
    return rows


def seen_splats(renderer, camera):
    """Return how many splats the picture of a camera is drawn of."""
    drawn = renderer.wet_scene.paged.whole
    drawn.wanted(camera, renderer.wet_scene.near)
    return drawn.used["splats"]


def ahead(scene, camera, distance):
    """Return a camera moved along the street by a distance [m]."""
    view = scene.ground_frame.camera_in_ground(camera)
    moved = view.camera_from_world.copy()
    moved[:3, 3] -= moved[:3, :3] @ (distance, 0, 0)
    return scene.ground_frame.camera_in_capture(replace(view, camera_from_world=moved))


def _flicker(pairs):
    """Return the mean difference of the frames of each pair."""
    return float(np.mean([np.abs(b - a).mean() for a, b in pairs]))


def resident():
    """Return the bytes that this process holds in memory now; 0 where the system does not say."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


# --- results --------------------------------------------------------------------------------------


def drive_line(row):
    """Return a frame of the drive as text."""
    return (
        f"at {row['x']:6.0f} m: {row['ms']:6.0f} ms, {row['cpu_ms']:6.0f} ms of processors, "
        f"{row['splats']} splats, {row['read']} pages read or made, "
        f"{row['resident'] / 1e9:.2f} GB in all"
    )


def alone_line(row):
    """Return the comparison of a place as text."""
    return (
        f"{row['splats']} splats: {row['cpu_ms']:.0f} ms of processors from chunks, "
        f"{row['alone_ms']:.0f} ms where only these are held"
    )


def detail_line(row):
    """Return a threshold's row as text."""
    return (
        f"detail {row['detail']:4.2f} px: {row['median_db']:5.1f} dB, worst "
        f"{row['worst_db']:5.1f}, {row['splats']:9.0f} splats, {row['cpu_ms']:6.0f} ms of "
        f"processors, frame to frame {row['flicker']:+.1%}"
    )


def table(result):
    """Return the thresholds and the drive in Markdown."""
    lines = [
        "| threshold [px] | dB, median | worst | splats | ms of processors | pages [MB] "
        "| frame to frame |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in result["rows"]:
        exact = row["detail"] == 0
        decibels = ("", "") if exact else (f"{row['median_db']:.1f}", f"{row['worst_db']:.1f}")
        lines.append(
            f"| {'all splats' if exact else row['detail']} | {decibels[0]} | {decibels[1]} | "
            f"{row['splats']:.0f} | {row['cpu_ms']:.0f} | {row['kept'] / 1e6:.0f} | "
            f"{row['flicker']:+.1%} |"
        )
    drive, made = result["drive"], result["cut"]
    half = len(drive) // 2
    first, second = (
        np.median([row["cpu_ms"] for row in part]) for part in (drive[1:half], drive[half:])
    )
    most = max(row["resident"] for row in drive)
    same = drive[len(drive) // 2]["same"]
    load = ", ".join(f"{x:.1f}" for x in result["machine"]["load"])
    return "\n".join([
        *lines, "",
        f"the middle frame by itself: {'the same bytes' if same else 'OTHER BYTES'}",
        f"{made['splats']} splats on {made['length']:.0f} m, {made['bytes'] / 1e6:.0f} MB; "
        f"set-up {made['set_up']:.0f} s",
        f"drive of {len(drive)} frames: {first:.0f} ms of processors in its first half, "
        f"{second:.0f} in its second; {most / 1e9:.2f} GB at most",
        *(alone_line(row) for row in result["alone"]),
        f"{result['machine']['threads']} threads, load {load}",
    ])  # fmt: skip


def draw(result, path):
    """Draw accuracy over threshold, splats and time, and the drive, to a PNG."""
    pyplot = require_matplotlib()
    figure, axes = pyplot.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    rows = [row for row in result["rows"] if row["detail"] > 0]
    whole = result["rows"][0]
    decibels = [row["median_db"] for row in rows]
    for n, (key, label) in enumerate((("median_db", "median"), ("worst_db", "worst"))):
        axes[0].semilogx(
            [row["detail"] for row in rows], [row[key] for row in rows], color=COLORS[n],
            marker=MARKERS[n], label=label,
        )  # fmt: skip
    axes[0].set(xlabel="threshold [px]", ylabel="dB from all splats")
    axes[0].set_xticks([row["detail"] for row in rows][::2])
    axes[0].set_xticklabels([f"{row['detail']:g}" for row in rows][::2])
    axes[0].minorticks_off()
    axes[0].legend(fontsize=8)
    axes[1].plot(
        [row["cpu_ms"] for row in rows], decibels, color=COLORS[0], marker=MARKERS[0],
        label="time",
    )  # fmt: skip
    axes[1].set(xlabel=f"ms of processors (all splats: {whole['cpu_ms']:.0f})",
                ylabel="dB, median", xlim=(0, None))  # fmt: skip
    twin = axes[1].twiny()
    millions = [row["splats"] / 1e6 for row in rows]
    twin.plot(millions, decibels, color=COLORS[1], marker=MARKERS[1])
    twin.set_xlim(0, None)
    label = f"millions of splats in the picture (all: {whole['splats'] / 1e6:.1f})"
    twin.set_xlabel(label, color=COLORS[1])
    for row in rows:
        if row["detail"] == Config().render.detail:
            axes[1].annotate("default", (row["cpu_ms"], row["median_db"]), xytext=(6, -10),
                             textcoords="offset points", fontsize=8)  # fmt: skip
    drive = result["drive"]
    axes[2].plot([row["x"] for row in drive], [row["cpu_ms"] for row in drive], color=COLORS[0])
    axes[2].set(xlabel="m along the street", ylabel="ms of processors", ylim=(0, None))
    twin = axes[2].twinx()
    twin.plot(
        [row["x"] for row in drive], [row["resident"] / 1e9 for row in drive], color=COLORS[1]
    )
    twin.set(ylim=(0, None))
    twin.set_ylabel("memory of the process [GB]", color=COLORS[1])
    figure.savefig(Path(path), dpi=110, format="png")
    pyplot.close(figure)
