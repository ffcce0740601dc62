"""`bench frame`: errors are those of pictures whose difference is known; a quick run is whole."""

import numpy as np
import pytest

from benchmarks import chart, frame, frame_levels


def test_error_of_known_pictures():
    truth = np.full((8, 12, 3), 0.5, np.float32)
    picture = np.full((8, 12, 3), 0.5 * 255 + 25.5)
    assert frame_levels.error_of(picture, truth) == pytest.approx(0.1, abs=1e-6)
    assert frame_levels.error_of(picture[::2, ::2], truth) == pytest.approx(
        0.1, abs=1e-6
    )  # enlarged


def test_shrinking_averages_light_not_display_values():
    picture = np.zeros((4, 4, 3), np.uint8)
    picture[::2] = 255
    assert frame_levels.shrunk(picture).mean() == pytest.approx(0.5 ** (1 / 2.2), abs=1e-4)
    assert frame_levels.shrunk(picture).shape == (2, 2, 3)


def test_table_has_a_column_for_each_size_and_errors_where_measured():
    def row(width, level, rmse):
        return {
            "scene": "bicycle", "width": width, "height": 432, "motion": "still", "level": level,
            "milliseconds": {"water": 3.0, "frame": 50.0}, "least_ms": 40.0, "rmse": rmse,
        }  # fmt: skip

    rows = [row(648, level, 0.01) for level in frame_levels.LEVELS] + [row(1296, "as set", None)]
    machine = {"load": (1.0, 1.0, 1.0), "peak_mib": 500.0, "threads": 2}
    text = frame.table({"rows": rows, "machine": machine}).splitlines()
    assert text[0] == "| ms | bicycle 648 x 432 still | bicycle 1296 x 432 still |"
    assert "| water | 3 | 3 |" in text and "| as set | 50 / 40.0 |" in text
    assert sum(line.endswith("50 / 40.0 |") for line in text) == len(frame_levels.LEVELS)


@pytest.mark.slow
def test_a_quick_run_measures_every_level(tmp_path):
    result = frame.run(quick=True)
    assert {row["level"] for row in result["rows"]} == set(frame_levels.LEVELS)
    assert {row["motion"] for row in result["rows"]} == {"still", "moving"}
    for row in result["rows"]:
        assert 0 < row["rmse"] < 0.3 and row["milliseconds"]["frame"] > 0
    own = {(r["motion"], r["level"]): r for r in result["rows"]}
    assert own["still", "half size"]["rmse"] > own["still", "as set"]["rmse"]
    assert own["moving", "as set"]["milliseconds"]["splat"] > 0
    assert own["still", "as set"]["milliseconds"].get("splat", 0) == 0
    assert "| as set |" in frame.table(result)
    chart.require_matplotlib()
    frame.draw(result, tmp_path / "c.png")
    assert (tmp_path / "c.png").stat().st_size > 10_000
