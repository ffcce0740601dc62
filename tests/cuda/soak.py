"""Many renderers in one process against fresh processes, by bytes.

`PYTHONPATH=.:tests:tests/cuda python tests/cuda/soak.py`, from the root of the repository.

Twelve cases differ in scene, size, rain, film, mirrors, map and actors. A fresh process draws each
and prints a digest of each picture. Then one process makes and frees renderers of the cases in
mixed order: some live beside others, some are left in the middle of a sequence, and between them
the CPU draws and garbage is collected. Each draws a sequence, and later frames of another
simulation one by one.

`--case NAME` is what a fresh process runs; `--each` draws each case once in this process, for
compute-sanitizer; `--tiny` is for numba's simulator.
"""

import argparse
import gc
import hashlib
import importlib
import itertools
import json
import os
import random
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

from guarded import MANAGER, SIMULATED, damaged, spoil_simulated

from benchmarks.frame_levels import cameras_of
from rainsim import pipeline
from rainsim.actors.footprint import with_footprints
from rainsim.config.settings import Config, mm_per_hour
from rainsim.cuda import trouble
from rainsim.render.renderer import Renderer as OnCpu
from rainsim.render.wet_scene import WetScene
from rainsim.scene.cameras import resize_to
from rainsim.scene.library import load_scene
from scenes import moving_scene, tiny_scene

CASES = {  # scene, preset, width [px], changes, layers
    "bicycle": ("bicycle", "moderate", 324, {}, ()),
    "bicycle drizzle": ("bicycle", "drizzle", 162, {"merge": 0.0}, ()),
    "bicycle downpour": ("bicycle", "downpour", 486, {"film": "environment"}, ()),
    "bicycle ssr": ("bicycle", "moderate", 324, {"reflections": "ssr", "film": "mirror"}, ()),
    "street": ("street", "moderate", 324, {}, ()),
    "street downpour": ("street", "downpour", 486, {"mirror_size": "full"}, ()),
    "street dusk": ("street", "dusk", 243, {}, ()),
    "street flood": ("street", "flood", 162, {"spacing": 0.03, "streak_far": 3.0}, ()),
    "traffic": ("traffic", "moderate", 243, {}, ()),
    "traffic downpour": ("traffic", "downpour", 324, {"film": "mirror"}, ()),
    "box": ("box", "downpour", 320, {"extent": 1.0, "spacing": 0.025}, ("flow", "actor_id")),
    "tiny": ("tiny", "downpour", 320, {"extent": 1.0, "spacing": 0.025, "film": "mirror"}, ()),
}
FRAMES, AGAIN = 5, 2  # of a sequence; then one by one
BESIDE = 3  # renderers that live at once, at most
FRESH_AT_ONCE = 4  # processes
LEFT, CPU_DRAWS = 0.2, 0.05  # shares left in the middle, and followed by a picture of the CPU
TINY = {
    "width": 16, "spacing": 0.2, "extent": 1.0, "frames": 3, "film": "environment",
    "rate": mm_per_hour(3.0),
}  # fmt: skip
_worlds = {}


def world(name, tiny):
    """Return scene, terrain, settings and cameras of a case; made once in a process."""
    if name not in _worlds:
        kind, preset, width, changes, _ = CASES[name]
        scene = {"box": moving_scene, "tiny": tiny_scene}.get(kind, lambda: load_scene(kind))()
        changes = {"width": width, "spacing": 0.06, **changes, "frames": FRAMES}
        settings = Config.from_preset(preset).replace(**changes | (TINY if tiny else {}))
        terrain = with_footprints(pipeline.extract_terrain(scene, settings), scene)
        count = settings.frames
        if kind in ("box", "tiny"):
            cameras = [resize_to(scene.cameras[0], settings.width)] * count
        else:
            cameras = cameras_of(scene, "moving", count + 1)[:count]
            cameras = [resize_to(camera, settings.width) for camera in cameras]
        _worlds[name] = scene, terrain, settings, cameras
    return _worlds[name]


def digest(picture):
    """Return a short digest of a picture's bytes."""
    return hashlib.sha256(picture.tobytes()).hexdigest()[:16]


class Run:
    """A renderer of a case, with the pictures that it draws."""

    def __init__(self, name, tiny=False):
        from rainsim.cuda.render.renderer import Renderer

        self.name, (scene, self.terrain, self.settings, self.cameras) = name, world(name, tiny)
        self.own = Renderer(scene, self.terrain, self.settings, self.cameras[0])

    def _shots(self):
        from rainsim.cuda.simulation import simulate

        states = simulate(self.terrain, self.settings)
        for camera, state in zip(self.cameras, states, strict=False):
            yield camera, state, None

    def sequence(self, stops=False):
        """Return digests of a sequence; if it `stops` it is left while the next frame is drawn."""
        film, count = self.own.film(self._shots()), self.settings.frames - 2 * stops
        return [digest(picture) for picture, _ in itertools.islice(film, count)]

    def again(self):
        """Return digests of the first frames of another simulation, drawn one by one."""
        names = CASES[self.name][-1]
        shots = itertools.islice(self._shots(), AGAIN)
        return [digest(self.own.draw(*shot, names)[0]) for shot in shots]


def fresh(name, tiny):
    """Return the digests of a case drawn by a process of its own, or end with what it said.

    Its memory is as the driver gives it, even if this process's is `guarded`.
    """
    plain = {key: value for key, value in os.environ.items() if key != MANAGER}
    command = [sys.executable, __file__, "--case", name, *(["--tiny"] if tiny else [])]
    done = subprocess.run(command, capture_output=True, text=True, env=plain)
    if done.returncode:
        sys.exit(f"{name}: a fresh process failed\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def drawn(name, tiny):
    """Return the digests of a case: of the sequence and of frames drawn one by one."""
    run = Run(name, tiny)
    return {"sequence": run.sequence(), "again": run.again()}


def soak(names, count, seed, tiny):
    """Make and free renderers in mixed order; return lines about pictures that differ."""
    rng, wrong, pictures, alive, left = random.Random(seed), [], 0, [], 0
    wanted = {names[0]: fresh(names[0], tiny)}  # compiles what most others load
    with ThreadPoolExecutor(FRESH_AT_ONCE) as pool:
        wanted |= zip(names[1:], pool.map(lambda name: fresh(name, tiny), names[1:]), strict=True)
    unlike = [n for n, found in wanted.items() if found["again"] != found["sequence"][:AGAIN]]
    wrong += [f"{name}: a fresh process's frames drawn one by one" for name in unlike]
    print(f"{len(names)} fresh processes done", flush=True)

    def compare(run, n, found, what):
        nonlocal pictures
        pictures += len(found)
        if found != wanted[run.name][what][: len(found)]:
            wrong.append(f"renderer {n}, {run.name}, {what}: {found}")
            print(wrong[-1], flush=True)

    for n in range(count):
        run = Run(rng.choice(names) if n >= len(names) else names[n], tiny)
        stops = rng.random() < LEFT
        compare(run, n, run.sequence(stops), "sequence")
        if stops:  # freed while the next frame is drawn
            left += 1
            del run
        else:
            alive.append((n, run))
        while len(alive) > (BESIDE - 1 if n + 1 < count else 0):
            k, run = alive.pop(rng.randrange(len(alive)))
            compare(run, k, run.again(), "again")
            del run
        if rng.random() < CPU_DRAWS:
            scene, terrain, settings, cameras = world(rng.choice(names), tiny)
            state = next(iter(pipeline.simulate(terrain, settings)))
            camera = resize_to(cameras[0], 96)
            OnCpu(scene, terrain, settings, camera).draw(camera, state)
            gc.collect()
        if n % 20 == 19:
            print(f"{n + 1} renderers, {pictures} pictures", flush=True)
        if behind := damaged():
            wrong.append(f"renderer {n}: written behind arrays of {behind} bytes")
    print(f"{count} renderers, {pictures} pictures, {left} sequences left in the middle")
    return wrong


def main():
    """Run what the command line asks for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--renderers", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", default="", help="names with commas between, or all")
    parser.add_argument("--case")
    parser.add_argument("--each", action="store_true")
    parser.add_argument("--tiny", action="store_true")
    parser.add_argument("--spoil", action="store_true", help="fresh memory in the simulator")
    chosen = parser.parse_args()
    if (why := trouble()) is not None:
        sys.exit(why)
    if SIMULATED:
        importlib.import_module("conftest")  # its threads take turns
    if chosen.tiny:  # six pictures of the surroundings are much for the simulator
        WetScene._surroundings = lambda self, position: self.sky.day
    if SIMULATED and chosen.spoil:
        spoil_simulated()
    names = chosen.cases.split(",") if chosen.cases else list(CASES)
    if chosen.case:
        print(json.dumps(drawn(chosen.case, chosen.tiny)))
        return 0
    begin = time.perf_counter()
    if chosen.each:
        for name in names:
            print(name, json.dumps(drawn(name, chosen.tiny)), flush=True)
        wrong = [f"written behind arrays of {sizes} bytes" for sizes in damaged()]
    else:
        wrong = soak(names, chosen.renderers, chosen.seed, chosen.tiny)
    print("\n".join(wrong))
    print(f"{len(wrong)} wrong in {time.perf_counter() - begin:.0f} s, seed {chosen.seed}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
