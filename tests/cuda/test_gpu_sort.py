"""The machine code of the library's sort: kept on disk, found by a second process, and right."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

pytestmark = pytest.mark.gpu

SORTED = """import json, time
import numpy as np
from numba import cuda
from rainsim.compiling import folder
from rainsim.cuda.raster import Workspace
from rainsim.cuda.splatting.sort import RADIX_SORT, sort_pairs

seconds = []
RADIX_SORT.watcher = lambda kinds, took: seconds.append(took)
random = np.random.default_rng(3)
key, value = random.integers(0, 2**32, (2, 4099), np.uint32)
lists = [cuda.to_device(array) for array in (key, value, 0 * key, 0 * value)]
begin, space = time.perf_counter(), Workspace()
for _ in range(2):
    sort_pairs(*lists, len(key), space)
order = np.argsort(key, kind="stable")
right = [bool((lists[2 + k].copy_to_host() == a[order]).all()) for k, a in enumerate((key, value))]
print(json.dumps([right, seconds, time.perf_counter() - begin]))
"""


def test_a_second_process_loads_what_the_first_compiled(tmp_path):
    variables = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "RAINSIM_KERNELS": "off",
        "NUMBA_CACHE_DIR": str(tmp_path),
    }  # fmt: skip
    found = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", SORTED], env=variables, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr[-3000:]
        found.append(json.loads(done.stdout.splitlines()[-1]))
    (first, compiled, slow), (second, loaded, quick) = found
    print(f"sort compiled in {slow:.2f} s, loaded in {quick:.2f} s")
    assert first == second == [True, True]
    assert len(compiled) == 1 and compiled[0] > 0.1  # once for both
    assert loaded == [None]
    assert np.isfinite(quick) and quick < slow
