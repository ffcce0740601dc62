"""`benchmarks`: what every suite does with its options; the suites have tests of their own."""

import json

import pytest
from click.testing import CliRunner

from benchmarks import chart, day, frame, ground, look, rain, splat, stress, water
from benchmarks.__main__ import benchmarks
from rainsim.errors import RainsimError


@pytest.mark.parametrize("suite", [day, frame, ground, look, rain, splat, stress, water])
def test_results_are_printed_and_written(suite, monkeypatch, tmp_path):
    seen = []

    def run(quick, say, **others):
        seen.append(quick)
        say("working")
        return {"error": 0.5}

    monkeypatch.setattr(suite, "run", run)
    monkeypatch.setattr(suite, "table", lambda result: f"error {result['error']}")
    name = suite.__name__.rpartition(".")[2]
    path = tmp_path / "r.json"
    done = CliRunner().invoke(benchmarks, [name, "--quick", "--json", str(path)])
    assert done.exit_code == 0 and "error 0.5" in done.stdout and "working" in done.stderr
    assert seen == [True] and json.loads(path.read_text()) == {"error": 0.5}


@pytest.mark.slow
@pytest.mark.parametrize("name", benchmarks.commands)
def test_a_quick_run_ends_in_a_table_and_a_chart(name, tmp_path):
    pytest.importorskip("matplotlib")
    files = "--json", str(tmp_path / "r.json"), "--chart", str(tmp_path / "c.png")
    done = CliRunner().invoke(benchmarks, [name, "--quick", *files], catch_exceptions=False)
    assert done.exit_code == 0 and done.stdout.strip(), done.stderr
    assert json.loads((tmp_path / "r.json").read_text())
    assert (tmp_path / "c.png").stat().st_size > 1000


def test_a_chart_without_matplotlib_is_told_before_anything_runs(monkeypatch, tmp_path):
    def missing():
        raise RainsimError('a chart needs matplotlib; pip install "rainsim[chart]"')

    monkeypatch.setattr(chart, "require_matplotlib", missing)
    monkeypatch.setattr(water, "run", lambda *a, **k: pytest.fail("ran"))
    done = CliRunner().invoke(benchmarks, ["water", "--chart", str(tmp_path / "c.png")])
    assert done.exit_code == 1 and "rainsim[chart]" in done.output
