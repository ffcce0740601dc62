"""Files of the kernels' and results' folders, damaged between runs: the same frames again."""

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

from made_captures import write_model_folder
from scenes import tiny_scene

RUNS, EACH = 8, 20  # runs, and files that are damaged before each of them
ARGUMENTS = ["--meters-per-unit", "0.6", "--spacing", "0.04", "--extent", "1", "--frames", "2",
             "--width", "64", "--overwrite", "-q", "--out", "out"]  # fmt: skip


def damage(rng, file):
    """Flip two bits of a file, cut it, empty it or fill it with others."""
    data, change = bytearray(file.read_bytes()), rng.integers(4)
    if change == 0 and data:
        for place in rng.integers(len(data), size=2):
            data[place] ^= 1 << rng.integers(8)
    elif change == 1:
        data = data[: rng.integers(len(data) + 1)]
    elif change > 1:
        data = rng.bytes(int(rng.integers(1, 4000))) if change == 2 else b""
    file.write_bytes(data)


@pytest.mark.slow
def test_damaged_files_of_both_folders_change_no_frame(tmp_path):
    write_model_folder(tmp_path / "yard", tiny_scene(), ["a", "b", "c"])
    folders = {"NUMBA_CACHE_DIR": tmp_path / "kernels", "RAINSIM_CACHE": tmp_path / "results"}
    path = {"PYTHONPATH": os.pathsep.join(sys.path)}
    environment = os.environ | path | {name: str(folder) for name, folder in folders.items()}

    def frames():
        command = [sys.executable, "-m", "rainsim", "run", "--scene", "yard", *ARGUMENTS]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr[-2000:]
        found = sorted((tmp_path / "out/frames").glob("*.png"))
        return [hashlib.sha256(file.read_bytes()).hexdigest() for file in found]

    whole, rng, damaged = frames(), np.random.default_rng(3), {"kernels": 0, "results": 0}
    for _ in range(RUNS):
        for folder in folders.values():
            files = sorted(f for f in folder.rglob("*") if f.is_file() and f.suffix != ".lock")
            for k in rng.permutation(len(files))[:EACH]:
                damage(rng, files[k])
                damaged[folder.name] += 1
        assert len(whole) == 2 and frames() == whole
    print(f"{RUNS} runs after damage to files, {damaged}: the same frames")
