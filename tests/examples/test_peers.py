"""The scripts that run other hydraulics codes; those that are not installed are skipped."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.water import solve

FOLDER = Path(__file__).resolve().parents[2] / "examples/peers"
NEEDS = {"anuga": "anuga", "landlab": "landlab", "itzi": "itzi", "pyclaw": "clawpack"}


@pytest.fixture
def load(monkeypatch):
    """Return a function that imports a script of the folder."""
    monkeypatch.syspath_prepend(FOLDER)

    def load(name):
        spec = importlib.util.spec_from_file_location(f"peer_{name}", FOLDER / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    yield load
    sys.modules.pop("common", None)


def test_each_script_has_its_program_and_is_listed():
    scripts = sorted(path for path in FOLDER.glob("*.py") if path.name != "common.py")
    assert [path.stem for path in scripts] == sorted(f"{name}_cases" for name in NEEDS)
    listed = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert all(path.name in listed for path in scripts)


def test_a_program_is_given_the_bench_s_case_and_its_error(load, capsys):
    """rainsim's own solver in a program's place; standing still is an error."""
    common = load("common")

    def prepare(make, cells):
        return lambda: solve(make(cells), "accurate")[0].depth.astype(np.float64)

    error, seconds = common.measure(prepare, "stoker", 64)
    assert error < 0.01 < common.measure(lambda make, n: lambda: make(n).depth, "stoker", 64)[0]
    assert seconds >= 0

    def fails(make, cells):
        raise ArithmeticError("no number\nand more")

    common.main("ours", prepare, ["ritter", "--cells", "32"])
    common.main("none", fails, ["ritter"])
    ours, none = capsys.readouterr().out.splitlines()
    assert "ritter" in ours and 0 < float(ours.split()[4]) < 0.05
    assert none.split() == ["none", "ritter", "256", "fails:", "no", "number"]
    with pytest.raises(SystemExit):
        common.main("ours", prepare, ["pond"])


@pytest.mark.filterwarnings("ignore")  # what the programs leave open is theirs
@pytest.mark.parametrize("name", NEEDS)
def test_a_program_that_is_installed_solves_the_dam_break(load, name):
    pytest.importorskip(NEEDS[name])
    prepare = load(f"{name}_cases").prepare
    prepare = prepare("DE1") if name == "anuga" else prepare
    assert load("common").measure(prepare, "stoker", 64)[0] < 0.1
