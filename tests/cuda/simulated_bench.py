"""`rainsim bench frame --backend cuda` in the simulator: one level of a tiny scene."""

import numpy as np
import pytest

from rainsim.bench import frame, frame_cuda, frame_levels
from rainsim.cuda import simulated
from rainsim.cuda.render import renderer as twin
from scenes import tiny_scene

assert simulated()
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


def test_a_level_is_measured(monkeypatch):
    for renderer in (frame.Renderer, twin.Renderer):
        monkeypatch.setattr(renderer, "_surroundings", lambda self, position: self.day)
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
