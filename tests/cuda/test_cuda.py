"""The CUDA twins: their tests in numba's simulator, and what is said where there is no GPU."""

import pytest

import rainsim.cuda
from rainsim.errors import BackendError
from simulator import QUICK, Simulator

LONG = ("film", "splash", "ripples", "simulate", "frame", "actors", "mirror", "bench", "chunks")


@pytest.mark.parametrize(
    "names",
    [
        pytest.param(QUICK, id="quick"),
        *(pytest.param((name,), id=name, marks=pytest.mark.slow) for name in LONG),
    ],
)
def test_the_twins_in_the_simulator(request, root, names):
    """In a process of its own; QUICK has run beside the tests before this one, without `-n`."""
    started = request.config.stash.get(Simulator.KEY, None) if names == QUICK else None
    code, said = (started or Simulator(root, names)).finish()
    assert code == 0, said[-4000:]
    assert " passed" in said


def test_what_is_missing_is_named_with_its_remedy(monkeypatch):
    monkeypatch.setattr(rainsim.cuda, "_is_installed", lambda package: package != "numba_cuda")
    assert rainsim.cuda.trouble() == 'numba-cuda is not installed; pip install "rainsim[cuda]"'
    with pytest.raises(BackendError, match=r"pip install .rainsim"):
        rainsim.cuda.require()
    monkeypatch.setattr(rainsim.cuda, "_is_installed", lambda package: package != "cuda.compute")
    assert "cuda-cccl is not installed" in rainsim.cuda.trouble()
