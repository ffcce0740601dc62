"""`python -m benchmarks frame --backend cuda` in the simulator: one level of a tiny scene."""

import numpy as np
import pytest

from benchmarks import frame, frame_cuda, frame_gsplat, frame_levels, water
from rainsim.cuda import simulated
from rainsim.errors import ParameterError
from rainsim.render.wet_scene import WetScene
from scenes import tiny_scene

assert simulated()
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


@pytest.fixture(autouse=True)
def sky_alone(monkeypatch):
    """The day's sky as surroundings: six pictures are much for the simulator."""
    monkeypatch.setattr(WetScene, "_surroundings", lambda self, position: self.sky.day)


def test_a_level_is_measured(monkeypatch):
    monkeypatch.setattr(frame_cuda, "SHOTS", {True: 1})
    monkeypatch.setattr(frame_cuda, "LEVELS", {"as set": ({"reflections": "ssr"}, 1.0)})
    monkeypatch.setattr(frame_levels, "LEVELS", {"paper": ({"reflections": "paper"}, 1.0)})
    monkeypatch.setattr(frame_cuda, "TRUTH", {})
    said = []
    rows = frame_cuda.measure(tiny_scene(), 24, "moving", True, said.append)
    assert [row["level"] for row in rows] == [frame_cuda.CPU, "as set"]
    assert len(said) == 1 and "backend cpu" in said[0]  # the paper's march is not on the GPU
    for row in rows:
        assert 0 < row["rmse"] < 0.3 and row["milliseconds"]["frame"] > 0
    assert {"splat", "water", "compose"} <= set(rows[1]["milliseconds"])
    assert np.isfinite(rows[1]["memory_mib"])
    machine = {"load": (1.0, 1.0, 1.0), "peak_mib": 500.0, "threads": 2}
    assert "| as set, CPU |" in frame.table({"rows": rows, "machine": machine})


def test_a_capture_is_measured_dry_and_in_sequences(monkeypatch):
    monkeypatch.setattr(frame_gsplat, "find_spec", lambda name: None)  # no peer in the simulator
    monkeypatch.setattr(frame_gsplat, "PRESETS", ("drizzle",))
    monkeypatch.setattr(frame_gsplat, "WIDTH", {True: 16})
    said = []
    rows = frame_gsplat.measure(tiny_scene(), True, said.append)
    what = ["dry, all layers", "drizzle, sequence", "drizzle, one by one"]
    assert [row["what"] for row in rows] == what and len(said) == 3
    assert all(0 < row["least_ms"] <= row["median_ms"] for row in rows)
    table = frame_gsplat.table([*rows, {**rows[0], "program": "gsplat", "splats": 8}])
    assert "| gsplat, dry, all layers | - | " in table and "| rainsim, dry, all layers | " in table


def test_the_water_stands_beside_a_copy_of_its_bytes(monkeypatch):
    monkeypatch.setattr(frame_cuda, "machine", dict)
    result = water.run(quick=True, backend="cuda")
    assert [row["bytes"] for row in result["rows"]] == [28, 32]
    for row in result["rows"]:
        assert row["steps"] >= 2 and 0 < row["rate"] <= row["most"] and row["limit"] > 0
    assert "| 16 x 16 | with friction |" in water.table(result)
    with pytest.raises(ParameterError, match="no chart"):
        water.draw(result, "water.png")
