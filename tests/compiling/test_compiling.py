"""Kernels are compiled in other processes from a recorded list, which fits the code."""

import importlib
import json
import os
import subprocess
import sys
import textwrap
import time
from typing import NamedTuple

import numpy as np
import pytest

from benchmarks.record import write_list
from rainsim.commands.status import Status
from rainsim.compiling import waiting
from rainsim.compiling.folder import stamp
from rainsim.compiling.pool import VARIABLE, Pool, processes
from rainsim.compiling.recorded import Recorded, needed, read_list
from rainsim.compiling.source_key import source_key
from rainsim.compiling.start import missing, start
from rainsim.compiling.uses import ALL, USES, uses_like
from rainsim.config import Config

AGAIN = "run `python -m benchmarks.record` and commit the list"
without_jit = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="there are no kernels to compile"
)


class Pair(NamedTuple):
    """A bundle."""

    left: np.ndarray
    right: float


class Twins(NamedTuple):
    """A bundle of one type."""

    left: float
    right: float


# --- signatures as text ---------------------------------------------------------------------------


def _read_only(array):
    array.flags.writeable = False
    return array


VALUES = [
    1, 2.0, True, None, np.float32(1), np.uint8(3), (1, 2), (1, 2.0, (np.uint64(3), np.zeros(2))),
    np.zeros(3), np.zeros(4)[::2], np.zeros((2, 3), np.float32), np.zeros((3, 2)).T,
    np.zeros((4, 4, 4), np.int16)[:, ::2], np.zeros(5, bool), _read_only(np.zeros((2, 2))),
    Pair(np.zeros(3, np.float32), 1.0), Twins(1.0, 2.0), (Twins(1.0, 2.0), Pair(np.zeros(1), 2.0)),
]  # fmt: skip


@pytest.mark.parametrize("value", VALUES, ids=str)
def test_a_type_written_as_text_reads_back_as_itself(value):
    from numba import typeof

    from rainsim.compiling.signatures import from_text, to_text

    kind = typeof(value)
    assert from_text(to_text(kind)) == kind


def test_types_that_cannot_be_named_are_refused():
    from numba import types

    from rainsim.compiling.signatures import UnknownType, from_text, split, to_text

    with pytest.raises(UnknownType, match="has no text"):
        to_text(types.pyobject)
    for text in ("float33", "float32[::1, ::1, :]", "rainsim.nothing:Box(float32)", "Config"):
        with pytest.raises(UnknownType):
            from_text(text)
    here = f"{__name__}:Twins(float64, float64, float64)"
    with pytest.raises(UnknownType, match="has 2 fields, not 3"):
        from_text(here)
    assert split("float32[:, ::1], (int64, bool), x:Y(a, b[:, :])") == [
        "float32[:, ::1]", "(int64, bool)", "x:Y(a, b[:, :])",
    ]  # fmt: skip


# --- what machine code was compiled from ----------------------------------------------------------

SOURCE = """
import numpy as np
from rainsim.jit import device_function, inlined_function

HALF = np.float32(0.5)
TABLE = np.arange(4.0)

@device_function
def helper(x):
    '''Say what it is.'''
    return HALF * x + TABLE[0]

def kernel(x):
    return helper(x) + 1

def stranger(x):
    return x
"""


def _key_of(text, salt=""):
    scope = {"__name__": "made"}
    exec(compile(textwrap.dedent(text), "made.py", "exec"), scope)
    return source_key(scope["kernel"], salt)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("np.float32(0.5)", "np.float32(0.25)"),  # a constant
        ("np.float32(0.5)", "np.float64(0.5)"),  # its type
        ("np.arange(4.0)", "np.arange(1.0, 5.0)"),  # a table
        ("HALF * x + TABLE[0]", "HALF * x - TABLE[0]"),  # a helper
        ("@device_function", "@inlined_function"),  # how it is compiled
        ("helper(x) + 1", "helper(x) + 2"),  # the kernel
    ],
)
def test_the_key_changes_with_all_that_machine_code_depends_on(old, new):
    assert old in SOURCE
    assert _key_of(SOURCE) != _key_of(SOURCE.replace(old, new))


@pytest.mark.parametrize(
    ("own", "spins"),
    [({}, "2000"), ({"GOMP_SPINCOUNT": "7"}, "7"), ({"OMP_WAIT_POLICY": "active"}, None)],
)
def test_idle_threads_soon_sleep_unless_the_user_has_chosen(own, spins):
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("GOMP_", "OMP_"))}
    code = "import os, rainsim.compiling.folder; print(os.environ.get('GOMP_SPINCOUNT'))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment | own, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert done.stdout.strip() == str(spins)


def test_the_key_is_that_of_the_code_alone():
    assert _key_of(SOURCE) == _key_of(SOURCE)
    assert _key_of(SOURCE) != _key_of(SOURCE, "numba 99")
    assert _key_of(SOURCE) == _key_of("# a comment\n\n" + SOURCE)
    assert _key_of(SOURCE) == _key_of(SOURCE.replace("    return x\n", "    return 2 * x\n"))
    assert _key_of(SOURCE) == _key_of(SOURCE.replace("Say what it is.", "Say it better."))


def test_keys_are_the_same_in_each_process():
    code = (
        "import rainsim.splatting.blend, rainsim.water.conserving\n"
        "from rainsim.jit import KERNELS\n"
        "print(*(kernel._cache.key for _, kernel in sorted(KERNELS.items())))\n"
    )
    runs = []
    for seed in ("1", "2"):
        environment = os.environ | {"PYTHONHASHSEED": seed, "NUMBA_DISABLE_JIT": "0"}
        runs.append(
            subprocess.run(
                [sys.executable, "-c", code], env=environment, capture_output=True, text=True
            )
        )
    assert runs[0].returncode == 0, runs[0].stderr
    assert len(runs[0].stdout.split()) > 10
    assert runs[0].stdout == runs[1].stdout


# --- processes ------------------------------------------------------------------------------------

MODULE = """
from rainsim.jit import serial_kernel

@serial_kernel
def double(values, out):
    for i in range(values.size):
        out[i] = 2 * values[i]

@serial_kernel
def triple(values):
    return 3 * values
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module with two kernels, of a name that no other test has used."""
    name = f"made_kernels_{time.monotonic_ns()}"
    (tmp_path / f"{name}.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    yield name
    sys.modules.pop(name, None)


def _entries(module, *rows):
    return [Recorded(f"{module}:{name}", text, 1.0, "frames", ("drizzle",)) for name, text in rows]


DOUBLE = ("double", "float32[::1], float32[::1]")
TRIPLE = ("triple", "int64")


@without_jit
def test_kernels_compiled_elsewhere_are_not_compiled_here(module):
    entries = _entries(module, DOUBLE, TRIPLE, ("triple", "float64"))
    assert missing(entries) == entries
    shares = []
    with Pool(entries, 2, lambda *now: shares.append(now)) as pool:
        pool.join()
        assert pool.finished and pool.stale == [] and pool.compiled == 3
        deadline = time.monotonic() + 10
        while (not shares or shares[-1] != (1.0, 2, 2, 2)) and time.monotonic() < deadline:
            time.sleep(0.05)
    assert shares[-1] == (1.0, 2, 2, 2)
    assert missing(entries) == []
    kernels = importlib.import_module(module)
    out = np.full(3, np.nan, np.float32)
    kernels.double(np.arange(3, dtype=np.float32), out)
    assert out.tolist() == [0, 2, 4] and kernels.triple(5) == 15
    for kernel in (kernels.double, kernels.triple):
        assert sum(kernel.stats.cache_misses.values()) == 0
        assert sum(kernel.stats.cache_hits.values()) == 1


@without_jit
def test_a_run_waits_for_the_kernel_that_it_calls(module):
    kernels = importlib.import_module(module)
    with Pool(_entries(module, DOUBLE, TRIPLE), 1) as pool:
        assert waiting.POOLS == [pool]
        assert kernels.triple(2) == 6
        assert sum(kernels.triple.stats.cache_misses.values()) == 0
    assert waiting.POOLS == []


@without_jit
def test_what_no_longer_fits_is_skipped_and_said(module):
    entries = _entries(module, TRIPLE, ("gone", "int64"), ("double", "int64"), ("triple", "int65"))
    with Pool(entries, 2) as pool:
        pool.join()
        assert pool.finished and pool.compiled == 1 and len(pool.stale) == 3
    assert importlib.import_module(module).triple(2) == 6


def test_a_process_goes_on_in_its_rooms_and_begins_those_of_others_last():
    rows = ("rainsim.rain.a:f", 1), ("rainsim.water.b:f", 3), ("rainsim.terrain.c:f", 2), ("m:f", 4)
    entries = [Recorded(name, "int64", float(n), "frames", ("after",)) for name, n in rows]
    with Pool(entries, 0) as pool:  # no process takes any
        pool._rooms = {("rainsim", "rain"), ("rainsim", "water")}
        pool._jobs["m:f"].wanted = True
        mine = {("rainsim", "rain")}
        taken = [pool._next(mine).kernel for _ in rows]
        assert taken == ["m:f", "rainsim.rain.a:f", "rainsim.terrain.c:f", "rainsim.water.b:f"]
        assert mine == {("m:f",), *pool._rooms} and pool._next(mine) is None


@without_jit
def test_a_pool_that_is_closed_or_killed_holds_nobody_up(module):
    kernels = importlib.import_module(module)
    pool = Pool(_entries(module, DOUBLE, TRIPLE), 2)
    pool.close()
    assert all(process.poll() is not None for process in pool._processes)
    pool.wait_for(f"{module}:triple")
    assert kernels.triple(2) == 6  # compiled here
    with Pool(_entries(module, DOUBLE, ("triple", "float32")), 2) as pool:
        for process in pool._processes:
            process.kill()
        pool.join()
        assert kernels.triple(np.float32(2)) == 6


def test_the_number_of_processes(monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    assert 1 <= processes() <= os.cpu_count()
    assert processes(1) == 1
    monkeypatch.setenv(VARIABLE, "5")
    assert processes() == 5
    monkeypatch.setenv(VARIABLE, "0")
    assert processes() == 1


def test_the_status_says_how_far_compiling_is_and_no_quick_stage(capsys):
    status = Status()
    with status:
        status.compiling(0.0, 0, 4, 2)
        status.progress("terrain", 0, 1)
        status.compiling(0.6, 2, 4, 2)
        status.progress("terrain", 1, 1)
        status.progress("frames", 0, 8)
        status.compiling(1.0, 4, 4, 2)
        status.progress("frames", 4, 8)
        status.compiling(1.0, 4, 4, 2)  # late: all is compiled
    assert capsys.readouterr().err.splitlines() == [
        "compiling 4 kernels for this machine in 2 processes, once", "compiling 2/4",
        "compiling 4/4",
    ]  # fmt: skip
    quiet = Status(quiet=True)
    quiet.compiling(0.0, 0, 4, 2)
    quiet.close()
    assert capsys.readouterr().err == ""


# --- the list -------------------------------------------------------------------------------------


def test_the_list_reads_back_as_it_was_written(tmp_path):
    entries = [Recorded("b:f", "int64", 2.0, "frames", ("after",)),
               Recorded("a:f", "int64", 1.5, "terrain", ("after", "drizzle"))]  # fmt: skip
    file = tmp_path / "list.json"
    write_list(entries, file)
    assert read_list(file) == entries[::-1]
    assert needed(["drizzle"], [file]) == entries[1:]
    assert needed(["flood"], [file]) == []


def test_each_use_is_recorded():
    assert {use for entry in read_list() for use in entry.uses} == set(ALL), AGAIN


@without_jit
@pytest.mark.parametrize("module", sorted({e.kernel.partition(":")[0] for e in read_list()}))
def test_the_list_names_kernels_that_exist(module):
    from rainsim.compiling.signatures import from_text, split
    from rainsim.jit import KERNELS

    importlib.import_module(module)
    for entry in read_list():
        if entry.kernel.startswith(f"{module}:"):
            assert entry.kernel in KERNELS, AGAIN
            kinds = [from_text(text) for text in split(entry.arguments)]
            code = KERNELS[entry.kernel].py_func.__code__
            assert len(kinds) == code.co_argcount, f"{entry.kernel}: {AGAIN}"


@without_jit
@pytest.mark.parametrize(
    "use", ["drizzle", *(pytest.param(use, marks=pytest.mark.slow) for use in ("paper", "capture"))]
)
def test_a_run_calls_what_the_list_says(use):
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.record", "--one", use],
        env=os.environ | {VARIABLE: "1", "RAINSIM_CACHE": "off"}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    called = {f"{row['kernel']}({row['arguments']})" for row in rows}
    assert len(called) > 20
    assert called == {entry.name for entry in needed([use])}, AGAIN


def test_a_run_compiles_what_the_recorded_run_most_like_it_calls():
    def config_of(preset, changes):
        return Config.from_preset(preset).replace(**changes)

    for name, use in USES.items():
        assert name in uses_like(config_of(*use), config_of)
    assert uses_like(Config.from_preset("paper"), config_of) == ["paper"]
    assert "layers" in uses_like(Config(), config_of, ["depth"])
    assert "capture" in uses_like(Config(), config_of, captured=True)
    assert "capture" not in uses_like(Config(), config_of)
    assert "traffic" in uses_like(Config(), config_of, scene="traffic:300")
    assert "street" not in uses_like(Config(), config_of, scene="bicycle")


def test_a_second_run_looks_at_nothing_but_a_stamp(monkeypatch, tmp_path):
    monkeypatch.setattr("rainsim.compiling.folder.CACHE_FOLDER", tmp_path)
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    entries = needed(["drizzle"])
    ready = stamp(entry.name for entry in entries)
    assert ready != stamp(entry.name for entry in entries[1:])
    ready.parent.mkdir()
    ready.touch()
    taken = []
    for _ in range(5):
        begin = time.process_time()
        assert start(["drizzle"]) is None
        taken.append(time.process_time() - begin)
    assert min(taken) < 0.05  # s
