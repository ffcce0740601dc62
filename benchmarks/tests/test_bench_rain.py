"""The rain benchmark measures what it says."""

import pytest

from benchmarks import rain


def test_the_gauge_and_the_waves_are_read():
    gauge = rain.read_gauge(10.0, 20_000)
    assert gauge["ratio"] == pytest.approx(1, abs=3 * gauge["sampling"])
    assert gauge["sampling"] == gauge["error"] == pytest.approx(0.016, rel=0.1)
    both = rain.read_gauge(10.0, 5_000, 2)
    assert both["drops"] == pytest.approx(10_000, rel=0.05)
    assert both["error"] == pytest.approx(both["sampling"] / 2**0.5)
    wave = rain.fit_wave(0.01, 0.1)
    assert wave["fitted"] == pytest.approx(wave["theory"], rel=0.03)
    assert wave["shallow"] > 3 * wave["theory"]


def test_the_table_holds_every_figure(monkeypatch):
    monkeypatch.setattr(rain, "SIZES", {"648 x 420": (32, 24, 24.0)})
    monkeypatch.setattr(rain, "EXPOSURES", (1 / 60,))
    monkeypatch.setattr(rain, "FAR", 2.0)
    monkeypatch.setattr(rain, "RATES", (10.0,))
    monkeypatch.setattr(rain, "TILE_CELLS", (16, 32))
    monkeypatch.setattr(rain, "MAP_SIDE", 2.0)
    result = rain.run(quick=True)
    text = rain.table(result)
    assert "| 10 | 19" in text or "| 10 | 20" in text
    assert text.count("648 x 420") == 2 and "splashes" in text and "threads, load" in text
    one, by_class = result["streaks"]
    assert by_class["drops"] < one["drops"]
