"""`benchmarks lod`: a long street in chunks: accuracy against memory and time, and a drive.

The built-in street's middle is repeated along its length and cut into chunks at several levels of
detail. Rainy frames at some places are compared with the same frames of all splats, over the
threshold that decides how fine each part is drawn. Stretches of a drive show whether time and
memory stay as they are along the way. The ground is that of legs along the path.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import lod_whole
from benchmarks.chart import COLORS, MARKERS, require_matplotlib, save
from benchmarks.lod_whole import row_line
from benchmarks.suite import load_line, machine, markdown, peak, quiet, resident
from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.lod.cut import cut
from rainsim.render.renderer import Renderer
from rainsim.scene.big import open_pages
from rainsim.scene.cameras import resize_to
from rainsim.scene.formats.extra import load_extra
from rainsim.scene.harmonics import BANDS, turned
from rainsim.scene.library import load_scene
from rainsim.scene.splat_sets import joined, own_turns
from rainsim.scene.types import Scene
from rainsim.simulation import simulate

PRESET = "moderate"
MIDDLE = 0.0, 16.0  # m of the built-in street that are repeated: where it is densest
WIDE = 15.0  # m to either side
SKY = 100.0  # m from the middle from where on splats are sky
LENGTH = {False: 200.0, True: 40.0}  # m
DETAILS = {False: (0.35, 0.5, 0.7, 1.0, 1.5, 2.0, 4.0), True: (1.0, 8.0)}  # px
PLACES = {False: 3, True: 1}  # along the street, two frames each
WIDTH = {False: 648, True: 96}  # px
SPEED, FPS = 10.0, 24.0  # m/s, 1/s: of the drive
NEXT = 1 / FPS  # s from a frame to the next
APART = 5.0  # m between the cameras that the capture is said to have
SPACING = {False: 0.02, True: 0.1}  # m, of the legs' cells
STRETCHES, BEFORE, STRETCH = {False: 4, True: 1}, 32, 40  # of the drive; their frames
AWAY = 4.0  # m from either end of the street that the drive keeps
AHEAD = 4  # frames
FRAMES = {False: 5, True: 3}  # of a short drive at a place, NEXT apart
EVERYTHING = 64e9  # bytes: full detail is drawn whatever it takes


def run(quick=False, say=quiet, length=None, folder=None, whole=False):
    """Run the bench on a street of a length [m], see `benchmarks.suite`.

    Chunks are kept in `folder`, and taken from there if it has them; without one they are deleted.
    `whole`: only drive from end to end, see `lod_whole`. The result has "machine", "cut" (splats,
    seconds, bytes), "rows" (a threshold each), "drive" (a frame each) and "alone" (a place each).
    """
    length = LENGTH[quick] if length is None else length
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "street" if folder is None else Path(folder)
        facts = {} if (folder / "lod-meta.json").is_file() else make(folder, length)
        if facts:
            say(f"cut: {facts['splats']} splats in {facts['seconds']:.0f} s")
        scene = long_street(folder, length)
        facts |= {"splats": scene.count, "length": length, "bytes": _bytes(folder)}
        path = drive(scene, length, WIDTH[quick])
        config = Config.from_preset(PRESET).replace(
            frames=len(path), width=WIDTH[quick], spacing=SPACING[quick], fps=FPS,
            ground_map="path",
        )  # fmt: skip
        begin = time.process_time()
        ground = pipeline.ground_of(scene, config, path)
        facts["legs"], facts["ground"] = len(ground.legs), time.process_time() - begin
        if whole:
            return lod_whole.result_of(scene, ground, path, config, facts, say)
        del scene
        rows = measure_drive(folder, length, ground, path, config, STRETCHES[quick], say)
        facts["same"] = is_same_alone(folder, length, ground, path, config, rows)
        places = places_of(folder, length, ground, path, config, PLACES[quick])
        alone = measure_alone(folder, length, ground, places, config, FRAMES[quick], say)
        details = measure_details(folder, length, ground, places, config, DETAILS[quick], say)
    for row in rows:
        del row["picture"]
    return {"machine": machine(), "quick": quick, "cut": facts, "rows": details, "drive": rows,
            "alone": alone}  # fmt: skip


# --- the street -----------------------------------------------------------------------------------


def make(folder, length):
    """Cut a street of a length [m] into chunks in a folder; return its splats and the seconds."""
    load_extra(folder, "a street in chunks (SOG)", "imagecodecs")
    begin = time.perf_counter()
    counts = cut(folder, lambda: street_blocks(length))
    return {"splats": counts[0], "seconds": time.perf_counter() - begin}


def street_blocks(length):
    """Yield the splats of a street of a length [m]: the middle of the built-in one, and its sky.

    Every other repetition is mirrored, so that what meets at a joint is equally fine and wet.
    """
    scene = load_scene("street")
    frame = scene.ground_frame
    place = frame.to_ground(scene.splats.position.astype(np.float64))
    inside = (place[:, 0] >= MIDDLE[0]) & (place[:, 0] < MIDDLE[1]) & (np.abs(place[:, 1]) < WIDE)
    middle, step = scene.splats.take(inside), MIDDLE[1] - MIDDLE[0]
    repeated = middle, mirrored(middle, frame, 0.5 * sum(MIDDLE))
    for n in range(max(1, round(length / step))):
        shift = frame.rotation.T @ (n * step, 0, 0) / frame.meters_per_unit
        part = repeated[n % 2]
        yield replace(part, position=part.position + shift.astype(np.float32))
    yield scene.splats.take(np.linalg.norm(place[:, :2], axis=1) > SKY)


def mirrored(splats, frame, x):
    """Return splats mirrored at the plane of a place x [m] of the ground frame.

    A mirror image is half a turn about the plane's normal and an inversion. The inversion leaves
    covariances as they are and changes the sign of harmonics of odd degree.
    """
    normal = frame.rotation.T @ (1.0, 0.0, 0.0)
    turn = 2 * np.outer(normal, normal) - np.eye(3)
    away = frame.to_ground(splats.position.astype(np.float64))[:, :1] - x
    position = splats.position - 2 * away / frame.meters_per_unit * normal
    rotation = (Rotation.from_matrix(turn) * own_turns(splats)).as_quat(scalar_first=True)
    sh = turned(splats.sh, turn)
    for odd in BANDS[1::2]:
        sh[:, odd] *= -1
    return replace(splats, position=position.astype(np.float32),
                   rotation=rotation.astype(np.float32), sh=sh)  # fmt: skip


def long_street(folder, length):
    """Return the Scene of a street in chunks, with cameras APART from end to end."""
    street = load_scene("street")
    first, frame = street.cameras[0], street.ground_frame
    pages, splats, digest, notes = open_pages(folder)
    count = max(2, int((length - 2 * AWAY) / APART))
    cameras = tuple(ahead(frame, first, AWAY + k * APART) for k in range(count))
    return Scene("long street", splats, cameras, frame, Path(folder), digest, notes, pages=pages)


def drive(scene, length, width):
    """Return the cameras of a drive from end to end, a list with one per frame."""
    first = resize_to(scene.cameras[0], width)
    count = max(2, int((length - 2 * AWAY) / (SPEED * NEXT)))
    return [ahead(scene.ground_frame, first, k * SPEED * NEXT) for k in range(count)]


def _bytes(folder):
    return sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())


# --- measuring ------------------------------------------------------------------------------------


def measure_drive(folder, length, ground, path, config, stretches, say=quiet):
    """Return a row for each frame of some stretches of a drive, each drawn once, in order.

    In each stretch a leg of the drive begins; its first frame begins one, too, since the drive does
    not come to it from before.
    """
    scene = long_street(folder, length)
    pages, legs = scene.pages, ground.legs
    sequence, rows = pipeline.FrameSequence(scene, ground, path, config), []
    chosen = np.linspace(0, len(legs) - 1, stretches + 2).astype(int)[1:-1]
    begins = {leg.first for leg in legs}
    for n in chosen:
        start = max(legs[n].first - BEFORE, 0)
        frames = sequence.frames(range(start, min(start + STRETCH, len(path))))
        begin, cpu, made = time.perf_counter(), time.process_time(), _made(pages)
        for picture, report in frames:
            index = report.index
            x = scene.ground_frame.to_ground(path[index].position)[0]
            if rows:  # of all pictures but the last, only the numbers stay in memory
                rows[-1]["picture"] = None
            rows.append({
                "frame": index, "x": float(x), "jump": index == start,
                "leg": index in begins, "picture": picture,
                "ms": (time.perf_counter() - begin) * 1e3,
                "cpu_ms": (time.process_time() - cpu) * 1e3, "kept": pages.kept.size,
                "read": _made(pages) - made, "resident": resident(), "peak": peak(),
                "residual": report.ledger["residual"],
            })  # fmt: skip
            say(row_line(rows[-1]))
            begin, cpu, made = time.perf_counter(), time.process_time(), _made(pages)
    return rows


def _made(pages):
    """Return how many runs have been read, and pages of them made."""
    return pages.kept.made + pages.read.made


def is_same_alone(folder, length, ground, path, config, rows):
    """Tell whether the last frame of a drive has the same bytes where it is drawn by itself."""
    alone = pipeline.FrameSequence(long_street(folder, length), ground, path, config)
    ((picture, _),) = alone.frames([rows[-1]["frame"]])
    return bool(np.array_equal(picture, rows[-1]["picture"]))


def places_of(folder, length, ground, path, config, count):
    """Return some places of a drive: camera, `Terrain` of its leg, and `SimState`."""
    scene, found = long_street(folder, length), []
    for n in np.linspace(0, len(ground.legs) - 1, count + 2).astype(int)[1:-1]:
        leg = ground.legs[n]
        terrain = ground.terrain(scene, leg)
        for state in simulate(terrain, config, first=leg.start(config)):
            if state.index >= config.moment(leg.first):
                break
        found.append((path[leg.first], terrain, state))
    return found


def measure_details(folder, length, ground, places, config, details, say=quiet):
    """Return a row for each threshold: accuracy of frames along the street, splats and time."""
    truth, rows = None, []
    for detail in (0.0, *details):
        memory = EVERYTHING if detail == 0 else config.render.memory
        settings = config.replace(detail=detail, memory=memory)
        scene = long_street(folder, length)
        frame = scene.ground_frame
        renderer = Renderer(scene, ground.overview, settings, places[0][0])
        shown, splats, cpu = [], [], []
        for camera, terrain, state in places:
            renderer.conductor.take_ground(lambda made=terrain: made, state.time)
            renderer.draw(camera, state)  # reads what it needs
            pair = []
            for shift in (0.0, SPEED * NEXT):
                begin = time.process_time()
                pair.append(renderer.draw(ahead(frame, camera, shift), state)[0].astype(float))
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
        say(detail_line(rows[-1]))
    return rows


def measure_alone(folder, length, ground, places, config, frames, say=quiet):
    """Return a row for each place of a street: frames from its chunks, and of the seen part alone.

    The scene that is compared with holds whole the runs that the cameras of a short drive need,
    each at the finest level that one of them asks for, and the splats that are always drawn.
    """
    scene, rows = long_street(folder, length), []
    frame = scene.ground_frame
    paged = Renderer(scene, ground.overview, config, places[0][0])
    for first, terrain, state in places:
        cameras = [ahead(frame, first, k * SPEED * NEXT) for k in range(frames)]
        runs, drawn = {}, paged.conductor.wet_scene.capture.paged.whole
        for camera in cameras:
            for leaf, level in drawn.wanted(camera, paged.conductor.wet_scene.capture.near):
                runs[leaf] = min(level, runs.get(leaf, level))
        held = [scene.pages.splats(*run) for run in sorted(runs.items())]
        whole = replace(scene, splats=joined(held), pages=None)
        alone = Renderer(whole, ground.overview, config, first)
        cpu = {paged: [], alone: []}
        for renderer in cpu:
            renderer.conductor.take_ground(lambda made=terrain: made, state.time)
            renderer.draw(ahead(frame, first, -SPEED * NEXT), state)  # reads what it needs
        for k, camera in enumerate(cameras):
            for renderer in cpu:
                begin = time.process_time()
                if renderer is paged:
                    renderer.conductor.read_ahead(cameras[min(k + AHEAD, frames - 1)])
                renderer.draw(camera, state)
                cpu[renderer].append((time.process_time() - begin) * 1e3)
        rows.append({
            "splats": len(whole.splats), "cpu_ms": float(np.median(cpu[paged])),
            "alone_ms": float(np.median(cpu[alone])),
        })  # fmt: skip
        say(alone_line(rows[-1]))
    return rows


def seen_splats(renderer, camera):
    """Return how many splats the picture of a camera is drawn of."""
    capture = renderer.conductor.wet_scene.capture
    drawn = capture.paged.whole
    drawn.wanted(camera, capture.near)
    return drawn.used["splats"]


def ahead(frame, camera, distance):
    """Return a camera moved along the street by a distance [m]; `frame` is that of the ground."""
    view = frame.camera_in_ground(camera)
    moved = view.camera_from_world.copy()
    moved[:3, 3] -= moved[:3, :3] @ (distance, 0, 0)
    return frame.camera_in_capture(replace(view, camera_from_world=moved))


def _flicker(pairs):
    """Return the mean difference of the frames of each pair."""
    return float(np.mean([np.abs(b - a).mean() for a, b in pairs]))


# --- results --------------------------------------------------------------------------------------


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
    if result.get("whole"):
        return lod_whole.table(result)
    cells = []
    for row in result["rows"]:
        accuracy = row["detail"], f"{row['median_db']:.1f}", f"{row['worst_db']:.1f}"
        cells.append((
            *(accuracy if row["detail"] else ("all splats", "", "")), f"{row['splats']:.0f}",
            f"{row['cpu_ms']:.0f}", f"{row['kept'] / 1e6:.0f}", f"{row['flicker']:+.1%}",
        ))  # fmt: skip
    drive, made = result["drive"], result["cut"]
    own = [row["cpu_ms"] for row in drive if not row["jump"] and not row["leg"]]
    begun = [row["cpu_ms"] for row in drive if row["leg"]]
    jumps = [row["cpu_ms"] for row in drive if row["jump"]]
    return "\n".join([
        *markdown(("threshold [px]", "dB, median", "worst", "splats", "ms of processors",
                   "pages [MB]", "frame to frame"), cells), "",
        f"the last frame by itself: {'the same bytes' if made['same'] else 'OTHER BYTES'}",
        f"{made['splats']} splats on {made['length']:.0f} m, {made['bytes'] / 1e6:.0f} MB; "
        f"{made['legs']} legs",
        f"set-up: {made['ground']:.1f} s of processors for the ground, then {jumps[0] / 1e3:.1f} s "
        f"to the first frame; {np.median(jumps[1:] or jumps) / 1e3:.1f} s after a jump",
        f"drive of {len(drive)} frames: {min(own):.0f} to {max(own):.0f} ms of processors, "
        f"{np.median(own):.0f} in the median; {min(begun) / 1e3:.1f} to {max(begun) / 1e3:.1f} s "
        "where a leg begins",
        f"{min(row['resident'] for row in drive) / 1e9:.2f} to "
        f"{max(row['resident'] for row in drive) / 1e9:.2f} GB after a frame, "
        f"{drive[-1]['peak'] / 1e9:.2f} GB at most",
        *(alone_line(row) for row in result["alone"]),
        load_line(result),
    ])  # fmt: skip


def draw(result, path):
    """Draw accuracy over threshold, splats and time, and the drive, to a PNG."""
    if result.get("whole"):
        return lod_whole.draw(result, path)
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
    drive = [row for row in result["drive"] if not row["jump"]]
    for which, n, label in ((False, 0, "frames"), (True, 2, "that begin a leg")):
        shown = [row for row in drive if row["leg"] == which]
        axes[2].semilogy([row["x"] for row in shown], [row["cpu_ms"] for row in shown], ls="",
                         color=COLORS[n], marker=MARKERS[n], ms=4, label=label)  # fmt: skip
    axes[2].set(xlabel="m along the street", ylabel="ms of processors", ylim=(100, None))
    axes[2].legend(fontsize=8, loc="upper left")
    twin = axes[2].twinx()
    twin.plot([row["x"] for row in drive], [row["resident"] / 1e9 for row in drive], ls="",
              color=COLORS[1], marker=MARKERS[1], ms=4)  # fmt: skip
    twin.set(ylim=(0, None))
    twin.set_ylabel("memory of the process [GB]", color=COLORS[1])
    return save(figure, path)
