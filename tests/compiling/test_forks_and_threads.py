"""Processes that fork after kernels have run are warned; two threads may each have a solver."""

import os
import subprocess
import sys

import pytest

SOLVE = """
import os, sys, threading
import numpy as np
import rainsim

def run(out=None):
    solver = rainsim.WaterSolver(np.random.default_rng(1).random((40, 40)), 0.1)
    solver.set_state(0.02)
    total = solver.advance(0.3).ledger.ground
    return total if out is None else out.append(total)
"""
FORK = """
from rainsim.jit import numba
before = os.fork()
if not before:
    os._exit(0)
os.waitpid(before, 0)
print("first fork", file=sys.stderr)
run()
import subprocess
subprocess.run([sys.executable, "-c", ""], preexec_fn=os.getpid)  # as the encoder of a video
print(numba.threading_layer(), file=sys.stderr)
for _ in range(2):
    child = os.fork()
    if not child:
        os._exit(0)
    os.waitpid(child, 0)
"""
THREADS = """
alone, found = run(), []
threads = [threading.Thread(target=run, args=(found,)) for _ in range(4)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
assert found == [alone] * 4, (alone, found)
print("together")
"""


def run(code, **variables):
    return subprocess.run(
        [sys.executable, "-c", SOLVE + code], env=os.environ | variables, capture_output=True,
        text=True,
    )  # fmt: skip


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork on this system")
def test_a_fork_after_kernels_have_run_is_said_once():
    told = run(FORK)
    assert told.returncode == 0, told.stderr
    before, _, after = told.stderr.partition("first fork")
    assert "rainsim:" not in before
    expected = 1 if "omp" in after.splitlines()[1] else 0
    assert after.count("rainsim: this process forks") == expected


@pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="no threads without kernels")
def test_threads_with_a_solver_each_do_not_abort_the_simplest_threading_layer():
    told = run(THREADS, NUMBA_THREADING_LAYER="workqueue", NUMBA_NUM_THREADS="2")
    assert told.returncode == 0 and "together" in told.stdout, told.stderr
