"""The CUDA twins: their tests in numba's simulator, and what is said where there is no GPU."""

import os
import subprocess
import sys

import pytest

import rainsim.cuda
from rainsim.errors import BackendError

QUICK = ("raster", "shading", "water", "edges", "streaks", "drops", "drips")
"""What the default suite runs."""
LONG = ("simulate", "frame", "actors", "mirror", "bench", "chunks")


@pytest.mark.parametrize(
    "names",
    [
        pytest.param(QUICK, id="quick"),
        *(pytest.param((name,), id=name, marks=pytest.mark.slow) for name in LONG),
    ],
)
def test_the_twins_in_the_simulator(root, names):
    """In a process of its own: numba chooses the simulator when it is imported."""
    files = [f"tests/cuda/simulated_{name}.py" for name in names]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files],
        cwd=root, env=os.environ | {"NUMBA_ENABLE_CUDASIM": "1"}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-4000:]
    assert " passed" in done.stdout


def test_what_is_missing_is_named_with_its_remedy(monkeypatch):
    monkeypatch.setattr(rainsim.cuda, "_is_installed", lambda package: package != "numba_cuda")
    assert rainsim.cuda.trouble() == 'numba-cuda is not installed; pip install "rainsim[cuda]"'
    with pytest.raises(BackendError, match=r"pip install .rainsim"):
        rainsim.cuda.require()
    monkeypatch.setattr(rainsim.cuda, "_is_installed", lambda package: package != "cuda.compute")
    assert "cuda-cccl is not installed" in rainsim.cuda.trouble()
