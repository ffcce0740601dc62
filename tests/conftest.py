"""Set up for all tests: a compile cache of the session's own, seeded numbers, poisoned outputs."""

import gc
import os
import tempfile
import time
from pathlib import Path

# Before anything imports numba: machine code of an older source must never answer for the new one.
# Processes that tests start inherit the folder, so that nothing is compiled twice.
if "RAINSIM_TEST_CACHE" not in os.environ:
    _CACHE = tempfile.TemporaryDirectory(prefix="rainsim-test-cache-")
    os.environ["RAINSIM_TEST_CACHE"] = _CACHE.name  # for the workers of `pytest -n`
# Set from outside it is, at one's own risk, a folder that outlives the session.
os.environ["NUMBA_CACHE_DIR"] = os.environ["RAINSIM_TEST_CACHE"]

# The setting of rainsim/io/allocator.py holds for the rest of a process. Set by one test it would
# make the arrays of all later ones fresh pages, which takes a fifth of the suite's time.
os.environ.setdefault("GLIBC_TUNABLES", "")

# The threads of numpy's linear algebra wait by spinning. Workers that share the cores have none to
# spare: looking for a ground took 24 s of processor time in place of 15, and as long by the clock.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Tests change constants of modules at will, which no entry's name takes in.
os.environ["RAINSIM_CACHE"] = "off"

import numpy as np
import pytest

import plain
from simulator import QUICK, Simulator


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


IN_THE_SIMULATOR = "test_the_twins_in_the_simulator[quick]"
WARMUP = "test_warmup_leaves_nothing_behind"
WAITS = pytest.StashKey()
LONGEST_WAIT = 1200  # s, of a machine with much else to do: a kernel is compiled twice after that
RARELY = 50_000  # new objects between searches for cycles; with Python's 700 they take 4 s of 5 s
# in which syntax trees are made


def turn_of(item):
    """Return where a test stands in the list of workers that share it."""
    if item.name == WARMUP:
        return 0
    if item.path.parent.name in ("cli", "examples", "golden"):
        return 1
    if item.path.parent.name == "actors":  # water in float64, as in tests/water: one compiles it
        return 4
    return 2 if item.name == IN_THE_SIMULATOR else 3


def in_turns(items):
    """Return the tests of workers so that kernels are compiled once, before most want them.

    Two workers begin with a half of the list each. While one has all recorded kernels compiled,
    the other begins with tests that compile nothing. Processes of command lines and of the
    simulator, which would compile them once more, come after that.
    """
    quick = [item for item in items if is_quick(item)]
    others = sorted((item for item in items if not is_quick(item)), key=turn_of)
    half = len(items) // 2
    return quick[:half] + others + quick[half:]


def is_quick(item):
    """Tell whether a test is of a kind that compiles nothing."""
    if item.path.parent.name == "house":
        return True
    return item.path.name in ("test_config.py", "test_key_texts.py", "test_pages.py")


def warm_mark():
    """Return the file that says that the recorded kernels are compiled."""
    return Path(os.environ["NUMBA_CACHE_DIR"]) / "warm"


def pytest_collection_modifyitems(config, items):
    """Leave out what takes minutes without the compiler; put the tests of workers into turns."""
    if plain.CHOSEN:
        items[:] = [item for item in items if item.originalname not in plain.SLOW]
    if hasattr(config, "workerinput"):
        items[:] = in_turns(items)
        config.stash[WAITS] = any(item.name == WARMUP for item in items)


def pytest_runtest_setup(item):
    """Let a test that may compile wait until the other worker has the recorded kernels."""
    if item.config.stash.get(WAITS, False) and item.name != WARMUP and not is_quick(item):
        end = time.monotonic() + LONGEST_WAIT
        while not warm_mark().exists() and time.monotonic() < end:
            time.sleep(0.2)
        item.config.stash[WAITS] = False


def pytest_runtest_logfinish(nodeid):
    """Say that the recorded kernels are compiled, or that they cannot be."""
    if nodeid.endswith(WARMUP):
        warm_mark().touch()


def pytest_collectstart():
    """Search for no cycles while tests are collected, which took a third of the time: all stays.

    The search begins again in `pytest_collection_finish`, without what was made until then.
    """
    gc.disable()


def pytest_collection_finish(session):
    """Start the twins' simulator beside the other tests, which mostly compile in one thread."""
    gc.freeze()
    gc.enable()
    gc.set_threshold(RARELY)
    wanted = any(item.name == IN_THE_SIMULATOR for item in session.items)
    alone = not hasattr(session.config, "workerinput")  # of `pytest -n`
    if wanted and alone and not session.config.option.collectonly:
        session.config.stash[Simulator.KEY] = Simulator(session.config.rootpath, QUICK)


def pytest_sessionfinish(session):
    """Leave no process behind."""
    if Simulator.KEY in session.config.stash:
        session.config.stash[Simulator.KEY].end()


SHORT_WARM_UP = 0.2  # s of rain that makes rings before the first frame
DRAWING = ("cli", "datasets", "render", "scene", "sensors", "shading", "splatting", "terrain",
           "view")  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def short_warm_up(request):
    """Rings of a moment before the first frame where frames are drawn for something else.

    Five seconds of them take a third of the time of a small frame. Tests of rain and water and the
    golden frames have all of them.
    """
    if request.path.parent.name not in DRAWING:
        yield
        return
    from rainsim import simulation

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "RIPPLE_WARM_UP", SHORT_WARM_UP)
        yield


SMALL_FACE = 32  # px


@pytest.fixture(scope="module", autouse=True)
def small_surroundings(request):
    """Few pixels of the surroundings, whose pictures took a third of a small frame's set-up.

    The golden frames have all of them, and so have modules with WHOLE_SURROUNDINGS.
    """
    if request.path.parent.name == "golden" or hasattr(request.module, "WHOLE_SURROUNDINGS"):
        yield
        return
    from rainsim.shading import environment

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(environment, "FACE", SMALL_FACE)
        yield


@pytest.fixture(scope="session", autouse=True)
def captures_seen_once():
    """Skyline, surface and planes of each capture are found once where no results are kept."""
    from rainsim.io import cache
    from rainsim.scene import ground_search, plane
    from rainsim.shading import environment, skyline
    from rainsim.surface import kept_surface

    keep, find, known = cache.kept_arrays, kept_surface.find_surface, {}
    fit = ground_search.find_plane

    def constants(*modules):  # which a test may change
        return [repr(value) for m in modules for name, value in vars(m).items() if name.isupper()]

    def once(name, compute):
        if name not in known:
            known[name] = compute()
        return known[name]

    def kept_arrays(kind, compute, *inputs):
        if cache.folder() or kind != "skyline":
            return keep(kind, compute, *inputs)
        now = constants(environment, skyline)
        return once(cache.name_of(*inputs, now), compute)

    def find_surface(scene):
        if cache.folder():
            return find(scene)
        place = scene.splats, scene.ground_frame, scene.cameras
        return once(cache.name_of(kept_surface.KIND, *place), lambda: find(scene))

    def find_plane(*points):
        return once(cache.name_of("scene", *points, constants(plane)), lambda: fit(*points))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cache, "kept_arrays", kept_arrays)
        patch.setattr(ground_search, "find_plane", find_plane)
        patch.setattr(kept_surface, "find_surface", find_surface)
        yield


@pytest.fixture(scope="session", autouse=True)
def scenes_made_once():
    """The built-in scenes, which take seconds each, are made once where no results are kept."""
    from rainsim.io import cache
    from rainsim.scene import library

    make, made = library._built_in, {}

    def built_in(name):
        if cache.folder():
            return make(name)
        known = name, str(library.BUILT_IN)  # which a test may change
        if known not in made:
            made[known] = make(name)
        return made[known]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(library, "_built_in", built_in)
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
