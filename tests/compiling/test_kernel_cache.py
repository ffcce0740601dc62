"""Machine code of an edited helper is made anew; that of modules it does not touch is kept."""

import os
import shutil
import subprocess
import sys

import pytest

from rainsim.commands.compile import compiled_beside
from rainsim.commands.status import Status
from rainsim.compiling import folder
from rainsim.compiling.checked_files import CheckedFiles

HELPER = (
    "from rainsim.jit import device_function\n\n@device_function\ndef value():\n    return {}\n"
)
KERNEL = """from rainsim.jit import serial_kernel
from rainsim.{helper} import value

@serial_kernel
def kernel():
    return value()
"""


def python(*words, places, cache):
    """Run Python on modules of `places` that keeps its kernels in `cache`; return its output."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(map(str, places)), "NUMBA_CACHE_DIR": str(cache),
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", *words], cwd=places[0], env=environment, capture_output=True,
        text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_an_edited_helper_recompiles_its_users_alone(root, tmp_path):
    package = tmp_path / "rainsim"
    package.mkdir()
    (package / "__init__.py").write_text("")
    shutil.copy(root / "rainsim" / "jit.py", package)
    shutil.copytree(root / "rainsim" / "compiling", package / "compiling")
    for helper, user in (("first", "uses_first"), ("second", "uses_second")):
        (package / f"{helper}.py").write_text(HELPER.format(1))
        (package / f"{user}.py").write_text(KERNEL.format(helper=helper))

    def run():
        code = (
            "from rainsim import uses_first as a, uses_second as b\n"
            "print(a.kernel(), b.kernel())\n"
            "for module in (a, b):\n"
            "    print(sum(module.kernel.stats.cache_misses.values()))\n"
        )
        return python(code, places=[tmp_path], cache=tmp_path / "cache").split()

    assert run() == ["1", "1", "1", "1"]
    assert run() == ["1", "1", "0", "0"]
    (package / "first.py").write_text(HELPER.format(2))
    assert run() == ["2", "1", "1", "0"]
    # What stands beside the code it calls does not matter to a kernel.
    text = (package / "first.py").read_text()
    (package / "first.py").write_text(f'"""A comment."""\n{text}\ndef other():\n    return 3\n')
    assert run() == ["2", "1", "0", "0"]
    with (package / "compiling" / "parts.py").open("a") as file:  # it rewrites every kernel
        file.write("# edited\n")
    assert run() == ["2", "1", "1", "1"]


LOOPS = """from rainsim.jit import serial_kernel

@serial_kernel
def kernel(n):
    total = 0.0
    for i in range(n):
        for j in range(i):
            total += (i * j) % 7 / (1.0 + j)
    return total
"""
DAMAGES = """import importlib, sys
from pathlib import Path
import numpy as np
import made
from rainsim.compiling import folder

count, rng, anew = int(sys.argv[1]), np.random.default_rng(int(sys.argv[2])), 0
right = made.kernel(12)
for n in range(count):
    files = sorted(f for f in folder.CACHE_FOLDER.rglob("*.nb?") if f.is_file())
    file, change = files[n % len(files)], n // len(files) % 4
    data = bytearray(file.read_bytes())
    for place in rng.integers(len(data), size=2 if change == 0 else 0):
        data[place] ^= 1 << rng.integers(8)
    if change == 1:
        data = data[:rng.integers(len(data))]
    if change > 1:
        data = rng.bytes(int(rng.integers(1, 2 * len(data)))) if change == 2 else b""
    file.write_bytes(data)
    importlib.reload(made)
    assert made.kernel(12) == right
    anew += sum(made.kernel.stats.cache_misses.values())
importlib.reload(made)
assert made.kernel(12) == right and not sum(made.kernel.stats.cache_misses.values())
print(f"{count} damaged files, {anew} kernels compiled again, {folder.unsaved}")
"""


def damaged(root, tmp_path, count, seed):
    """Damage the files of a kernel in turn, and call it after each; return what was seen."""
    (tmp_path / "made.py").write_text(LOOPS)
    words = DAMAGES, str(count), str(seed)
    return python(*words, places=[tmp_path, root], cache=tmp_path / "cache").strip()


def test_damaged_files_count_as_absent(root, tmp_path):
    assert damaged(root, tmp_path, 8, 1) == "8 damaged files, 8 kernels compiled again, None"


@pytest.mark.slow
def test_damaged_files_by_the_hundred(root, tmp_path):
    seen = damaged(root, tmp_path, 600, 2)
    print(seen)
    assert "600 kernels compiled again" in seen


CALL = """import made
from rainsim.compiling import folder
print(made.kernel(3), folder.unsaved)
"""


def test_kernels_that_cannot_be_kept_run_all_the_same(root, tmp_path):
    place = tmp_path / "cache" / "rainsim-kernels"
    place.mkdir(parents=True)
    (place / "made").write_text("a file where their folder would be")
    (tmp_path / "made.py").write_text(LOOPS)
    shown = python(CALL, places=[tmp_path, root], cache=place)
    assert shown.startswith("1.0 ")
    assert "File exists" in shown and str(place / "made") in shown


def test_what_could_not_be_kept_is_said_once(monkeypatch, capsys):
    monkeypatch.setattr(folder, "unsaved", "[Errno 28] No space left on device: 'a'")
    monkeypatch.setattr(folder, "REFUSED", ("others can write to b: delete b",))
    for _ in range(2):
        with compiled_beside(Status(), []):
            pass
    shown = capsys.readouterr().err
    assert "could not be kept ([Errno 28] No space left on device: 'a'); make room" in shown
    assert f"others can write to b: delete b; {folder.CACHE_FOLDER} is used" in shown


def test_a_folder_that_others_can_write_to_is_not_used(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "first"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "second"))
    first, second = (tmp_path / name / folder.NAME for name in ("first", "second"))
    assert folder._cache_folder() == (first, ()) and first.stat().st_mode & 0o777 == 0o700
    first.chmod(0o777)
    used, (refused,) = folder._cache_folder()
    assert used == second and f"others can write to {first}: " in refused
    second.chmod(0o755)
    (second / "module").mkdir()
    (second / "module").chmod(0o775)
    used, refused = folder._cache_folder()
    assert len(refused) == 2 and used.parent.name.startswith(folder.LOST)
    assert f"others can write to {second / 'module'}" in refused[1]


def test_files_and_folders_of_others_are_not_used(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    kept = CheckedFiles(str(tmp_path), "a", "stamp")
    kept._save_index({"key": "name"})
    assert kept._load_index() == {"key": "name"} and not kept.holds("key")
    kept.save("key", [1.0])
    assert kept.load("key") == [1.0] and kept.holds("key") and not kept.holds("other")
    monkeypatch.setattr(os, "geteuid", lambda: os.stat(tmp_path).st_uid + 1)
    assert kept._load_index() == {} and kept.load("key") is None
    assert "belongs to another user" in folder._cache_folder()[1][0]


BUNDLE = """from typing import NamedTuple
from rainsim.jit import serial_kernel

class Pair(NamedTuple):
    {}: float
    {}: float

@serial_kernel
def difference(pair):
    return pair.left - pair.right

print(difference(Pair(left=3.0, right=1.0)), *difference.stats.cache_misses.values())
"""


def test_fields_of_a_bundle_that_change_places_recompile_its_kernels(root, tmp_path):
    def run(*fields):
        (tmp_path / "made.py").write_text(BUNDLE.format(*fields))
        return python("import made", places=[tmp_path, root], cache=tmp_path / "cache").split()

    assert run("left", "right") == ["2.0", "1"]
    assert run("left", "right") == ["2.0"]
    assert run("right", "left") == ["2.0", "1"]
