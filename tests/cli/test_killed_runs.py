"""Real runs of every stage, killed at random moments and run again: the same bytes as in one go.

The slow lane kills each stage some times; by hand, any number of times:
`PYTHONPATH=.:tests python tests/cli/test_killed_runs.py STAGE KILLS SEED FOLDER`.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from rainsim.io.rasters import Raster, write_raster
from rainsim.scene.folder import write_scene
from run_folders import written
from scenes import tiny_scene

KILLS, SEED = 20, 16
IN_A_ROW = 4  # kills of one folder at most before its run may end
MAP = ["--spacing", "0.04", "--extent", "1"]
PICTURE = ["--width", "64", "--relight", "off"]
FRAMES = ["--frames", "6", "--preset", "downpour"]
STAGES = {
    "import": ["import", "tiny"],
    "heightmap": ["heightmap", "tiny", *MAP],
    "simulate": ["simulate", "map", *FRAMES],
    "render": ["render", "states", "--scene", "tiny", *PICTURE, "--layers", "depth"],
    "run": ["run", "--scene", "tiny", *MAP, *FRAMES, *PICTURE],
    "world": ["world", "tiny", *MAP, *FRAMES, "--width", "64"],
    "flow": ["flow", "hills.asc", "--rain", "60", "--manning", "0.03", "--duration", "1000"],
}
OFTEN = """  # some states a second, where a long run writes one a minute
from rainsim.commands import flow
from rainsim.cli import main
flow.SAVE_EVERY = 0.05
main()
"""
PROGRAM = {"flow": ["-c", OFTEN]}


def start(folder, stage, out):
    """Start a stage in a folder, with a folder for what is kept between runs."""
    kept = {"RAINSIM_CACHE": str(folder / "kept"), "RAINSIM_COMPILE_PROCESSES": "1"}
    program = PROGRAM.get(stage, ["-m", "rainsim"])
    command = [sys.executable, *program, *STAGES[stage], "--out", out, "--resume", "-q"]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    path = {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(command, cwd=folder, env=os.environ | kept | path, **pipes)


def finish(folder, stage, out):
    """Run a stage to its end; return the seconds that it took."""
    begun = time.perf_counter()
    process = start(folder, stage, out)
    _, said = process.communicate()
    assert process.returncode == 0, said.decode()
    return time.perf_counter() - begun


def prepared(folder, stage):
    """Make what a stage reads, and its result in one go; return the seconds of a second run."""
    write_scene(folder / "tiny", tiny_scene())
    bed = np.random.default_rng(1).random((120, 120))
    write_raster(folder / "hills.asc", bed, Raster(bed, 2.0, (0.0, 0.0), ".asc"))
    if stage in ("simulate", "render"):
        finish(folder, "heightmap", "map")
    if stage == "render":
        finish(folder, "simulate", "states")
    finish(folder, stage, "whole")
    return finish(folder, stage, "second")


def killed_and_run_again(folder, stage, kills, seed):
    """Kill a stage at random moments, let it end and compare; return how often it was at work."""
    rng, whole_takes = random.Random(seed), prepared(folder, stage)
    whole, hit, with_files, runs = written(folder / "whole"), 0, 0, 0
    while hit < kills:
        out, runs = f"out{runs}", runs + 1
        for _ in range(rng.randint(1, IN_A_ROW)):
            process = start(folder, stage, out)
            # Late moments are when files are written; the first half imports and loads.
            time.sleep(whole_takes * rng.uniform(0, 1) ** 0.5)
            process.send_signal(rng.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGTERM]))
            process.communicate()
            hit += process.returncode != 0
            with_files += process.returncode != 0 and (folder / out / "provenance.json").exists()
        finish(folder, stage, out)
        assert written(folder / out) == whole, out
        record = json.loads((folder / out / "provenance.json").read_text())
        assert record["complete"] and record["files"]
    return {"kills": hit, "while files were there": with_files, "runs": runs}


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES)
def test_killed_at_random_moments(tmp_path, stage):
    if stage == "world":
        pytest.importorskip("pxr")
        pytest.importorskip("trimesh")
    outcome = killed_and_run_again(tmp_path, stage, KILLS, SEED)
    assert outcome["kills"] >= KILLS and outcome["while files were there"] > 0, outcome


if __name__ == "__main__":
    chosen, count, number, place = sys.argv[1:]
    Path(place).mkdir(parents=True, exist_ok=True)
    print(chosen, killed_and_run_again(Path(place).resolve(), chosen, int(count), number))
