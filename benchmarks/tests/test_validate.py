"""`benchmarks validate`: the rule of its verdicts, its rows and the texts that it prints."""

import numpy as np
import pytest

from benchmarks import validate


def test_a_verdict_follows_from_the_tolerance_alone():
    def verdict(ours, published, tolerance, why):
        row = validate.row_of("figure", 10.0, ours, published, "m", tolerance, why, "law")
        return row["verdict"]

    assert (
        verdict(1.2, 1.0, 0.25, "law") == "agrees" and verdict(0.7, 1.0, 0.25, "law") == "differs"
    )
    assert verdict(-0.47, -0.5, 0.05, "power") == "agrees"
    assert verdict(-0.9, -0.5, 0.05, "power") == "differs"
    assert verdict(0.01, 0.039, 0, "bound") == "agrees"
    assert verdict(0.04, 0.039, 0, "bound") == "differs"
    assert verdict(float("nan"), 1.0, 0.25, "law") == "differs"


def test_wrong_rain_is_found(monkeypatch):
    """Twice the rain that is asked for, and drops of one speed, do not agree."""
    real = validate.RainSpectrum
    monkeypatch.setattr(validate, "RainSpectrum", lambda rate: real(2 * rate))
    monkeypatch.setattr(validate, "RATES", (10.0,))
    rows, _ = validate.drops_on_a_path(True)
    verdicts = {row["what"]: row["verdict"] for row in rows}
    assert verdicts["rate along the path"] == verdicts["decay of sizes"] == "differs"
    monkeypatch.setattr(validate, "RainSpectrum", lambda rate: real(rate, "paper"))
    rows, _ = validate.drops_on_a_path(True)
    assert sum(row["verdict"] == "differs" for row in rows) > 8


def test_the_rate_is_read_back_from_a_share():
    sensor = validate.SENSORS["vlp16"]
    share = validate.scattered_share(
        validate.TARGET, validate.REFLECTIVITY, sensor, validate.RainSpectrum(25.0)
    )
    assert validate._rate_of(share, sensor) == pytest.approx(25, rel=0.01)


@pytest.fixture(scope="module")
def quick():
    return validate.run(quick=True)


def test_the_quick_rows_hold(quick):
    differ = {(row["what"], row["rate"]) for row in quick["rows"] if row["verdict"] == "differs"}
    assert differ == {
        ("radar at 24 GHz", 1.0), ("power of exposure in contrast, faint drops as fog", 25.0)
    }  # fmt: skip
    assert {row["rate"] for row in quick["rows"] if row["what"].startswith("targets")} == {
        10, 25, 50}  # fmt: skip
    assert all(np.isfinite(row["ours"]) for row in quick["rows"])


def test_table_and_chart_hold_every_figure(quick, tmp_path):
    text = validate.table(quick)
    assert f"of {len(quick['rows'])} figures agree" in text
    assert text.count(" / ") >= len(quick["rows"]) and "bring the data" in text
    assert all(row["source"] in text for row in quick["rows"])
    pytest.importorskip("matplotlib")
    validate.draw(quick, tmp_path / "c.png")
    assert (tmp_path / "c.png").stat().st_size > 10_000
