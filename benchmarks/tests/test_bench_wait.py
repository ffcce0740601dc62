"""The bench of what a user waits for has a row and a bar for each run."""

import pytest

from benchmarks import wait


def test_first_and_second_runs_have_rows_and_bars(monkeypatch, tmp_path):
    asked = []

    def waited(name, out, variables, backend, width):
        asked.append((name, sorted(variables)))
        used = {"seconds": 5.0, "processor": 8.0, "megabytes": 900.0}
        return {**used, "stages": {"reading": 1.0, "light": 4.0, "compiling beside": 3.0}}

    monkeypatch.setattr(wait, "waited", waited)
    lines = []
    result = wait.run(True, lines.append, compiled=False)
    assert [row["run"] for row in result["runs"]] == ["empty caches", "first run", "second run"]
    assert len(lines) == 3 and asked[0] == ("bicycle", ["NUMBA_CACHE_DIR", "RAINSIM_CACHE"])
    assert asked[1] == asked[2] == ("bicycle", ["RAINSIM_CACHE"])
    assert "| bicycle | second run | 5.0 | 8.0 | 900 | reading 1.0, light 4.0" in wait.table(result)
    pytest.importorskip("matplotlib")
    wait.draw(result, tmp_path / "wait.png")
    assert (tmp_path / "wait.png").stat().st_size > 1000
