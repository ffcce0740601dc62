"""The CUDA twins: their tests in numba's simulator, and what is said where there is no GPU."""

import os
import subprocess
import sys

import pytest

import rainsim.cuda
from rainsim.errors import BackendError

QUICK = ("raster", "shading", "water", "streaks", "drops", "splash")
LONG = ("ripples", "simulate", "frame")


@pytest.mark.parametrize(
    "names", [QUICK, *(pytest.param((name,), marks=pytest.mark.slow) for name in LONG)]
)
def test_the_twins_in_the_simulator(root, names):
    """In a process of its own: the simulator is chosen when numba is first imported."""
    own = {"NUMBA_ENABLE_CUDASIM": "1", "RAINSIM_TEST_CACHE": os.environ["NUMBA_CACHE_DIR"]}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider",
         *(f"tests/cuda/simulated_{name}.py" for name in names)],
        cwd=root, env=os.environ | own, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-4000:]
    assert " passed" in done.stdout


def test_what_is_missing_is_named_with_its_remedy(monkeypatch):
    monkeypatch.setattr(rainsim.cuda, "_is_installed", lambda package: package != "numba_cuda")
    assert rainsim.cuda.trouble() == ("numba-cuda is not installed; pip install rainsim[cuda]")
    with pytest.raises(BackendError, match="pip install rainsim"):
        rainsim.cuda.require()
    monkeypatch.setattr(rainsim.cuda, "_is_installed", lambda package: package != "cuda.compute")
    assert "cuda-cccl is not installed" in rainsim.cuda.trouble()
