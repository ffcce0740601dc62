"""Time of a whole frame and peak memory of a process that draws with one method of reflection.

Run as a module, so that the process's peak memory belongs to one method alone:
`python -m benchmarks.whole SCENE PRESET WIDTH METHOD` prints one line of JSON.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np

from benchmarks.suite import peak
from benchmarks.traced import trace_reflections

METHODS = ("ssr", "mirror", "auto", "traced")
FRAMES = 3  # of a moving camera, of which the median counts; one more before them compiles


def measure(scene, preset, width):
    """Return {method: {milliseconds, peak_mb, before_mb}} of a frame and of its process.

    `before_mb` is the peak before the first frame: what capture, ground and water take.
    """
    found = {}
    for method in METHODS:
        words = [sys.executable, "-m", "benchmarks.whole", scene, preset, str(width), method]
        done = subprocess.run(words, capture_output=True, text=True, check=True)
        found[method] = json.loads(done.stdout.splitlines()[-1])
    return found


def draw_frames(name, preset, width, method):
    """Draw FRAMES frames and return their figures."""
    from rainsim import pipeline
    from rainsim.config.settings import Config
    from rainsim.render.renderer import Renderer
    from rainsim.scene.cameras import resize_to
    from rainsim.scene.library import load_scene

    scene = load_scene(name)
    named = "auto" if method == "traced" else method
    config = Config.from_preset(preset).replace(frames=1, width=width, reflections=named)
    camera = resize_to(scene.cameras[0], width)
    terrain = pipeline.extract_terrain(scene, config)
    state = next(pipeline.simulate(terrain, config))
    before = peak() / 2**20
    renderer = Renderer(scene, terrain, config, camera)
    if method == "traced":
        trace_reflections(renderer)
    seconds = []
    for _ in range(FRAMES + 1):
        start = time.perf_counter()
        renderer.draw(replace(camera), state)  # a new camera object: the renderer keeps no picture
        seconds.append(time.perf_counter() - start)
    milliseconds = 1e3 * float(np.median(seconds[1:]))
    return {"milliseconds": milliseconds, "peak_mb": peak() / 2**20, "before_mb": before}


if __name__ == "__main__":
    name, preset, width, method = sys.argv[1:]
    print(json.dumps(draw_frames(name, preset, int(width), method)))
