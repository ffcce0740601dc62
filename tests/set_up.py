"""Set up for all tests: a compile cache of the session's own, seeded numbers, poisoned outputs."""

import gc
import os
import subprocess
import sys
import tempfile
from pathlib import Path

# What is compiled and what is kept of scenes begins empty; the processes that tests start and the
# workers of `pytest -n` share it. Set from outside it is a folder that outlives the session.
if "RAINSIM_TEST_CACHE" not in os.environ:
    _CACHE = tempfile.TemporaryDirectory(prefix="rainsim-test-cache-")
    os.environ["RAINSIM_TEST_CACHE"] = _CACHE.name
os.environ["NUMBA_CACHE_DIR"] = os.environ["RAINSIM_TEST_CACHE"]
KEPT = os.environ["RAINSIM_CACHE"] = os.path.join(os.environ["RAINSIM_TEST_CACHE"], "results")

# The setting of rainsim/io/allocator.py holds for the rest of a process. Set by one test it would
# make the arrays of all later ones fresh pages, which takes a fifth of the suite's time.
os.environ.setdefault("GLIBC_TUNABLES", "")

# The threads of numpy's linear algebra wait by spinning. Workers that share the cores have none to
# spare: looking for a ground took 24 s of processor time in place of 15, and as long by the clock.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest

import plain


def pytest_configure(config):
    """Let whole numbers wrap where the compiler is off."""
    if plain.CHOSEN:
        config.addinivalue_line("filterwarnings", plain.WARNINGS)


def pytest_ignore_collect(collection_path):
    """Leave out what needs the compiler where it is off."""
    if plain.CHOSEN and collection_path.suffix == ".py":
        return not plain.is_plain(collection_path)
    return None


@pytest.fixture(scope="session")
def scene_folder(tmp_path_factory):
    """A scene folder with `tiny_scene` in it, called tiny."""
    from rainsim.scene.folder import write_scene
    from scenes import tiny_scene

    folder = tmp_path_factory.mktemp("scenes") / "tiny"
    write_scene(folder, tiny_scene())
    return folder


def pytest_sessionstart(session):
    """Compile the recorded kernels on all cores, before workers share the whole suite.

    Else each of them would compile what the other is compiling.
    """
    config = session.config
    is_whole = config.args_source is config.ArgsSource.TESTPATHS
    shares = getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput")
    if is_whole and shares and not plain.CHOSEN:
        subprocess.run([sys.executable, "-m", "rainsim", "warmup", "--quiet"], check=True)


def pytest_collection_modifyitems(items):
    """Leave out what takes minutes without the compiler."""
    if plain.CHOSEN:
        items[:] = [item for item in items if item.originalname not in plain.SLOW]


def pytest_collection_finish():
    """Look for cycles rarely, and not in syntax trees and tests: that took 4 s of 5 s."""
    gc.freeze()
    gc.set_threshold(50_000)


@pytest.fixture
def monkeypatch(monkeypatch):
    """As pytest has it; from the first patch of code on nothing is kept, as no name tells of it."""
    patch = monkeypatch.setattr

    def setattr(*arguments, **more):
        if os.environ.get("RAINSIM_CACHE", "").startswith(KEPT):
            monkeypatch.setenv("RAINSIM_CACHE", "off")
        patch(*arguments, **more)

    monkeypatch.setattr = setattr
    return monkeypatch


AS_SHIPPED = ("examples", "farm", "golden", "rain", "water")


@pytest.fixture(scope="module", autouse=True)
def quick_set_up(request):
    """Rings of a moment before the first frame, and few pixels of the surroundings.

    Both take half a second of each renderer that is made, three quarters of a small frame. The
    rooms AS_SHIPPED have all of them, and so have modules that set AS_SHIPPED.
    """
    with pytest.MonkeyPatch.context() as patch:
        shipped = request.path.parent.name in AS_SHIPPED or hasattr(request.module, "AS_SHIPPED")
        if not shipped:
            patch.setenv("RAINSIM_CACHE", f"{KEPT}-quick")
            patch.setattr("rainsim.simulation.RIPPLE_WARM_UP", 0.2)  # s
            patch.setattr("rainsim.shading.environment.FACE", 32)  # px
        yield


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


@pytest.fixture(scope="session")
def bicycle_scene():
    """The built-in yard, for all tests: 300,000 splats take seconds."""
    from rainsim import load_scene

    return load_scene("bicycle")


@pytest.fixture(scope="session")
def street_scene():
    """The built-in street, for all tests."""
    from rainsim import load_scene

    return load_scene("street")


@pytest.fixture(scope="session")
def shared(root):
    """Return a function that finds data beside the checkout, and skips the test without it.

    The only place where tests look outside the repository.
    """

    def find(name):
        path = root.parent / "shared" / name
        if not path.exists():
            pytest.skip(f"../shared/{name} is not there")
        return path

    return find


@pytest.fixture
def threads():
    """Return a function that sets the number of threads for the rest of a test."""
    from rainsim.jit import set_threads

    before = set_threads(None)
    yield set_threads
    set_threads(before)
