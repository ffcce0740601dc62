"""The bench of what a user waits for has a row and a bar for each run."""

import imageio.v3 as imageio
import numpy as np
import pytest

from benchmarks import wait, wait_growth


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


def test_the_wait_is_measured_over_splats_cells_and_pixels(monkeypatch, tmp_path):
    def waited(name, out, variables, backend, width, *spacing):
        asked.append((name, width, spacing))
        (out / "frames").mkdir(parents=True, exist_ok=True)
        imageio.imwrite(out / "frames" / "00000.png", np.zeros((width // 2, width), np.uint8))
        return {"seconds": width / 100, "processor": 8.0, "megabytes": 900.0, "stages": {}}

    asked = []
    monkeypatch.setattr(wait, "waited", waited)
    monkeypatch.setitem(wait_growth.WIDTHS, True, (100, 200))
    result = wait.run(True, print, growth=True)
    assert len(asked) == 2 * 4 and {width for _, width, _ in asked} == {96, 100, 200}
    pixels = [rows for quantity, _, rows in wait_growth.series(result) if quantity == "pixels"]
    assert [row["count"] for row in pixels[0]] == [5000, 20000]
    assert "| pixels | second run | 5000, 20000 | 1.0, 2.0 | 8.0, 8.0 | 0.50 |" in wait.table(
        result
    )
    pytest.importorskip("matplotlib")
    wait.draw(result, tmp_path / "growth.png")
    assert (tmp_path / "growth.png").stat().st_size > 1000
