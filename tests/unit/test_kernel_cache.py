"""Machine code of an edited helper is made anew; that of modules it does not touch is kept."""

import os
import shutil
import subprocess
import sys

HELPER = (
    "from rainsim.jit import device_function\n\n@device_function\ndef value():\n    return {}\n"
)
KERNEL = """from rainsim.jit import serial_kernel
from rainsim.{helper} import value

@serial_kernel
def kernel():
    return value()
"""


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
        environment = os.environ | {
            "PYTHONPATH": str(tmp_path),
            "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        }
        done = subprocess.run(
            [sys.executable, "-c", code],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    assert run() == ["1", "1", "1", "1"]
    assert run() == ["1", "1", "0", "0"]
    (package / "first.py").write_text(HELPER.format(2))
    assert run() == ["2", "1", "1", "0"]
    # What stands beside the code it calls does not matter to a kernel.
    text = (package / "first.py").read_text()
    (package / "first.py").write_text(f'"""A comment."""\n{text}\ndef other():\n    return 3\n')
    assert run() == ["2", "1", "0", "0"]


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
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(tmp_path), str(root)]),
            "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        }
        done = subprocess.run(
            [sys.executable, "-c", "import made"], env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    assert run("left", "right") == ["2.0", "1"]
    assert run("left", "right") == ["2.0"]
    assert run("right", "left") == ["2.0", "1"]
