"""Kernels of the GPU are compiled by other processes, without a GPU; loading them needs one."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec

import pytest

from rainsim.compiling import gpu
from rainsim.compiling.recorded import CUDA_FILE, Recorded, needed, on_gpu
from rainsim.compiling.start import start
from rainsim.compiling.uses import ALL_CUDA, CUDA, SIMULATE, cuda_uses

MADE = """import numpy as np
from rainsim.cuda.jit import cuda, cuda_kernel

@cuda_kernel
def scale(values_out, factor):
    i = cuda.grid(1)
    if i < values_out.size:
        values_out[i] = np.sqrt(values_out[i]) * factor

def _made(power):
    @cuda_kernel
    def raised(values_out):
        values_out[0] = values_out[0] ** power
    return raised

RAISED = [_made(power) for power in (2, 3)]
"""
COMPILE = """import json, os, sys
from rainsim.compiling import gpu, shipped
from rainsim.compiling.pool import Pool
from rainsim.compiling.recorded import Recorded

rows = [("made:scale", "float32[::1], float32"),
        *((f"made:_made.<locals>.raised[('power', {n})]", "float32[::1]") for n in (2, 3))]
entries = [Recorded(name, kinds, 1.0, "frames", ()) for name, kinds in rows]
found = []
for _ in range(2):
    with Pool(entries, 2, environment={gpu.CAPABILITY: "9.0"}) as pool:
        pool.join()
    found.append([pool.compiled, pool.stale])
os.environ[gpu.CAPABILITY] = "9.0"
from rainsim.compiling.signatures import from_text, split
import made
from rainsim.jit import KERNELS, held
for entry in entries:
    kernel, kinds = KERNELS[entry.kernel], tuple(map(from_text, split(entry.arguments)))
    library = kernel._cache.load_overload(kinds, kernel.targetctx)._codelibrary
    found.append([held(kernel, kinds), len(library._cubin_cache), library.get_llvm_str()])
    found.append(held(kernel, (kinds[0], from_text("float64"))))
print(json.dumps(found))
"""


@pytest.mark.skipif(find_spec("numba_cuda") is None, reason="numba-cuda is not installed")
def test_kernels_of_a_gpu_compile_elsewhere_without_one_and_are_found(tmp_path, root):
    (tmp_path / "made.py").write_text(MADE)
    variables = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, sys.path)]),
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "NUMBA_ENABLE_CUDASIM": "0",
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", COMPILE], env=variables, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-3000:]
    first, second, *each = json.loads(done.stdout)
    assert first == [3, []] and second == [0, []]
    assert each == 3 * [[True, 1, ""], False]


def test_without_a_gpu_its_kernels_are_left_out(monkeypatch):
    some = [Recorded("rainsim.cuda.none:kernel", "int64", 1.0, "frames", (CUDA,))]
    monkeypatch.setattr("rainsim.compiling.start.needed", lambda uses: some)
    monkeypatch.setattr(gpu, "capability", lambda: None)
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    assert start([CUDA]) is None
    assert gpu.versions(None) == [] and gpu.versions("9.0")[0] == "capability 9.0"


def test_a_run_on_a_gpu_is_like_a_recorded_one():
    assert cuda_uses(scene="traffic:300") == [SIMULATE, CUDA, "cuda-traffic"]
    assert cuda_uses(["depth"], captured=True) == [SIMULATE, CUDA, "cuda-layers", "capture"]


@pytest.mark.gpu
def test_a_run_on_a_gpu_calls_what_the_list_says():
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.record", "--one", CUDA],
        env=os.environ | {"RAINSIM_COMPILE_PROCESSES": "1"}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    called = {f"{row['kernel']}({row['arguments']})" for row in rows}
    recorded = [entry for entry in needed([CUDA], [CUDA_FILE]) if on_gpu(entry)]
    again = "run `python -m benchmarks.record --cuda` and commit the list"
    assert {name for name in called if name.startswith("rainsim.cuda.")} == {
        entry.name for entry in recorded
    }, again
    assert {use for entry in needed(ALL_CUDA) for use in entry.uses} >= set(ALL_CUDA), again
