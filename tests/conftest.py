"""Set up for all tests: a compile cache of the session's own, seeded numbers, poisoned outputs."""

import os
import tempfile
from pathlib import Path

# Before anything imports numba: machine code of an older source must never answer for the new one.
# Processes that tests start inherit the folder, so that nothing is compiled twice.
if "RAINSIM_TEST_CACHE" not in os.environ:
    _CACHE = tempfile.TemporaryDirectory(prefix="rainsim-test-cache-")
    os.environ["NUMBA_CACHE_DIR"] = _CACHE.name
else:
    # For work at one's own risk: a folder that outlives the session.
    os.environ["NUMBA_CACHE_DIR"] = os.environ["RAINSIM_TEST_CACHE"]

import numpy as np
import pytest

from simulator import QUICK, Simulator


def pytest_collection_finish(session):
    """Start the twins' simulator beside the other tests, which mostly compile in one thread."""
    wanted = any(item.name == "test_the_twins_in_the_simulator[quick]" for item in session.items)
    if wanted and not session.config.option.collectonly:
        session.config.stash[Simulator.KEY] = Simulator(session.config.rootpath, QUICK)


def pytest_sessionfinish(session):
    """Leave no process behind."""
    if Simulator.KEY in session.config.stash:
        session.config.stash[Simulator.KEY].end()


@pytest.fixture
def rng():
    """Random numbers, the same in every run."""
    return np.random.default_rng(20240817)


@pytest.fixture
def poisoned():
    """Return a function that makes arrays full of NaN (integers: their least value).

    A kernel that leaves an output alone would pass many a test on zeros.
    """

    def make(shape, dtype=np.float32):
        dtype = np.dtype(dtype)
        bad = np.nan if dtype.kind == "f" else (True if dtype.kind == "b" else np.iinfo(dtype).min)
        return np.full(shape, bad, dtype)

    return make


@pytest.fixture(scope="session")
def root():
    """The folder of the checkout."""
    return Path(__file__).resolve().parent.parent


@pytest.fixture
def threads():
    """Return a function that sets the number of threads for the rest of a test."""
    from rainsim.jit import set_threads

    before = set_threads(None)
    yield set_threads
    set_threads(before)
