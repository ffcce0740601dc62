"""Record which kernels each use calls: `python -m benchmarks.record [USE ...]`.

Writes the list that `rainsim.compiling` compiles from. Run it after a kernel, its arguments or what
it is called with have changed; it needs a minute or two once the kernels are compiled. With names
of uses only these are run, and the others keep what was recorded for them. Each use runs in a
process of its own: `... record --one USE` prints what it calls as lines of JSON. Uses on a GPU,
which begin with cuda, have a list of their own and are run if they are named, or with `--cuda`.
"""

import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace

from rainsim.compiling import recorded
from rainsim.compiling.pool import VARIABLE, processes
from rainsim.compiling.recorded import STAGES, TERRAIN, Recorded
from rainsim.compiling.uses import (
    ALL,
    ALL_CUDA,
    CAPTURE,
    CUDA,
    CUDA_LAYERS,
    CUDA_TRAFFIC,
    HEIGHTMAP,
    LAYERS,
    LIDAR,
    SCENES,
    SIMULATE,
    SPLAT,
    TRAFFIC,
    USES,
)

SCENE = "bicycle"
SIZE = ("--width", "96")
COARSE = ("--spacing", "0.05")  # a map on which tops slope that are level on the usual one


def command_lines(use, folder):
    """Return the command lines of a use: a command and its words; they write into `folder`."""
    height_map = ("heightmap", SCENE, "--spacing", "0.05", "--out", f"{folder}/map", "-q")
    if use == HEIGHTMAP:
        return [(*height_map, "--check")]
    if use == SIMULATE:
        states = ("--frames", "2", "--out", f"{folder}/states", "-q")
        return [height_map, ("simulate", f"{folder}/map", *states)]
    if use == SPLAT:
        words = {"expected": ["--hit"], "median": [], "plane": ["--compensate"]}
        return [
            ("splat", SCENE, "--width", "96", "--depth", depth, *more, "--out",
             f"{folder}/{depth}.npz")
            for depth, more in words.items()
        ]  # fmt: skip
    if use == LIDAR:
        return [("lidar", SCENE, "--rain", "0,25", "--spacing", "0.05", "--out",
                 f"{folder}/turns", "-q")]  # fmt: skip
    if use in ALL_CUDA:
        return _cuda_lines(use, folder)
    scene = f"{folder}/{CAPTURE}" if use == CAPTURE else use if use in SCENES else SCENE
    preset, changes = USES.get(use, USES["downpour" if use in SCENES else "drizzle"])
    words = [word for name, value in changes.items() for word in (f"--{name}", value)]
    words += ["--drive"] if use == TRAFFIC else []
    count = "4" if preset == "paper" else "2"  # its water moves from the third on
    if use == LAYERS:  # two frames of a slow circle: a cut has no flow
        words, count = [*words, "--layers", "all", "--orbit", "--frame-range", "0:2"], "240"
    return [
        ("run", "--scene", scene, "--preset", preset, *SIZE, *more, "--frames", count, *words,
         "--out", f"{folder}/frames{len(more)}", "-q")
        for more in ((), COARSE)
    ]  # fmt: skip


def _cuda_lines(use, folder):
    """Return the command lines of a use on a GPU: sequences, since frames are drawn ahead."""
    scene = SCENE if use in (CUDA, CUDA_LAYERS) else use.removeprefix(f"{CUDA}-")
    words = {CUDA_LAYERS: ["--layers", "all"], CUDA_TRAFFIC: ["--drive"]}.get(use, ["--orbit"])
    runs = [("downpour", ["--frames", "1"])] if use == CUDA else []
    runs += [(preset, ["--frames", "4", *words]) for preset in ("downpour", "drizzle", "flood")]
    return [
        ("run", "--backend", "cuda", "--scene", scene, "--preset", preset, *SIZE, *more,
         "--out", f"{folder}/{number}", "-q")
        for number, (preset, more) in enumerate(runs)
    ]  # fmt: skip


def run_one(use):
    """Run a use here and print each kernel that it calls as a line of JSON."""
    from rainsim.commands import film, heightmap, lidar, splat, status
    from rainsim.scene.folder import write_scene
    from rainsim.scene.library import load_scene

    stage = STAGES[0]
    tell = status.Status.progress

    def progress(self, name, done, total):
        nonlocal stage
        if name != status.READING and (name != TERRAIN or done == total):
            stage = STAGES[1]
        tell(self, name, done, total)

    def found(kernel, arguments, seconds):
        row = {"kernel": kernel, "arguments": arguments, "seconds": seconds, "stage": stage}
        print(json.dumps(row) + "\n", end="", flush=True)  # at once: two threads may compile

    commands = {"run": film.run, "simulate": film.simulate, "heightmap": heightmap.heightmap,
                "splat": splat.splat, "lidar": lidar.lidar}  # fmt: skip
    status.Status.progress = progress
    with tempfile.TemporaryDirectory() as folder:
        if use == CAPTURE:
            write_scene(f"{folder}/{CAPTURE}", load_scene(SCENE))
        _run(commands, use, folder, found)


def _run(commands, use, folder, found):
    from benchmarks.watching import watched, watched_cuda

    with watched(found), watched_cuda(found) if use in ALL_CUDA else nullcontext():
        for command, *words in command_lines(use, folder):
            commands[command].main(args=words, standalone_mode=False)


def record(use):
    """Run a use in a process of its own; return what it calls as `Recorded` by name."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.record", "--one", use],
        capture_output=True, text=True,
        env=os.environ | {VARIABLE: "1", "RAINSIM_CACHE": "off"},  # kept terrain calls no kernels
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{use} failed:\n{done.stderr}")
    found = {}
    for line in done.stdout.splitlines():
        if line.startswith('{"kernel"'):
            row = json.loads(line)
            new = Recorded(**{**row, "seconds": row["seconds"] or 0.0}, uses=(use,))
            found[new.name] = joined(found.get(new.name), new)
    return found


def joined(old, new):
    """Return one entry for two of the same kernel and arguments; a measured time beats none."""
    if old is None:
        return new
    stage = min(old.stage, new.stage, key=STAGES.index)
    seconds = round(new.seconds or old.seconds, 2)
    uses = tuple(sorted({*old.uses, *new.uses}))
    return Recorded(new.kernel, new.arguments, seconds, stage, uses)


def merged(old, found, use):
    """Return the entries of a list after a use was recorded again, by name; unused ones go."""
    times = {entry.kernel: entry.seconds for entry in old.values()}
    result = {}
    for name, entry in old.items():
        uses = tuple(kept for kept in entry.uses if kept != use and kept in (*ALL, *ALL_CUDA))
        if uses or name in found:
            result[name] = replace(entry, uses=uses)
    for name, entry in found.items():
        known = replace(entry, seconds=entry.seconds or times.get(entry.kernel, 0.0))
        result[name] = joined(result.get(name), known)
    return result


def main(words):
    """Record all uses, or those that are named, and write the list after each."""
    if words[:1] == ["--one"]:
        run_one(words[1])
        return
    words = [*ALL_CUDA] if words == ["--cuda"] else words
    known = (*ALL, *ALL_CUDA)
    if unknown := set(words) - set(known):
        sys.exit(f"no use is called {', '.join(sorted(unknown))}; the uses: {', '.join(known)}")
    first, *others = words or ALL
    _write(first, record(first))  # alone: it compiles what the others call, too
    with ThreadPoolExecutor(processes()) as threads:
        for use, found in zip(others, threads.map(record, others), strict=True):
            _write(use, found)


def _write(use, found):
    """Write the list with what a use calls, and say how long it is."""
    file = recorded.CUDA_FILE if use in ALL_CUDA else recorded.FILE
    old = {e.name: e for e in recorded.read_list(file)} if file.is_file() else {}
    entries = merged(old, found, use)
    write_list(entries.values(), file)
    seconds = sum(entry.seconds for entry in entries.values())
    line = f"{use}: {len(found)} kernels; {len(entries)} in all, {seconds:.0f} s to compile"
    print(line, file=sys.stderr, flush=True)


def write_list(entries, file):
    """Write the list, an entry a line in the order of the names, so that versions compare well."""
    rows = [
        json.dumps({**vars(entry), "uses": sorted(entry.uses)})
        for entry in sorted(entries, key=lambda entry: entry.name)
    ]
    file.write_text("[\n" + ",\n".join(rows) + "\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
