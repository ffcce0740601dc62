"""Conditions at edges in numba's CUDA simulator; `tests/cuda/test_cuda.py` runs this file."""

import numpy as np
import pytest
from click.testing import CliRunner

from rainsim.cli import cli
from rainsim.cuda import simulated
from rainsim.cuda.grid import GpuWaterSolver
from rainsim.errors import DivergedError
from rainsim.grid import WaterSolver
from rainsim.water.conditions import Discharge, Rating, Stage
from rainsim.water.series import Series

assert simulated()
N, RAIN = 7, 50 / 3.6e6
GIVEN = {
    "stage": lambda: [Stage("south", Series([0, 1], [0.03, 0.06]), span=(1, 6))],
    "discharge": lambda: [Discharge("west", Series([0, 1], [2e-3, 4e-3]), span=(2, 6))],
    "pump": lambda: [Discharge("north", -3e-3, span=(0, 5))],
    "rating": lambda: [Rating("east", [0.0, 0.1], [0.0, 0.01])],
    "all": lambda: [condition for name in ("stage", "discharge", "pump", "rating")
                    for condition in GIVEN[name]()],
}  # fmt: skip


def made(name, level=0.03, **changes):
    """Return a solver of a rough valley with conditions at its edges, and water in it."""
    y, x = np.mgrid[:N, : N + 3] / N
    bed = 0.02 * np.sin(5 * x) * np.cos(4 * y) - 0.02 * x
    options = {"scheme": "lean", "manning": 0.02, "conditions": GIVEN[name](), "storage": 1e-4,
               "boundary": {"east": "open"} if name == "discharge" else "wall"}  # fmt: skip
    solver = WaterSolver(bed, 0.1, **{**options, **changes})
    solver.set_state(np.maximum(level - bed, 0))
    return solver


@pytest.mark.parametrize("name", GIVEN)
def test_each_condition_acts_as_on_the_cpu(name):
    level = -1.0 if name == "discharge" else 0.03  # it comes onto dry ground
    solver = made(name, level)
    gpu, before = GpuWaterSolver(solver), solver.depth
    for _ in range(2):
        steps = solver.advance(0.15, RAIN).substeps
        assert gpu.advance(0.15, RAIN) == steps
        mine, theirs = gpu.on_host().flow, solver.flow  # which limit the steps, at corners too
        assert mine.water_speed == pytest.approx(theirs.water_speed, rel=1e-5)
        assert mine.wave_speed == pytest.approx(theirs.wave_speed, rel=1e-5)
    assert gpu.time == 0.3 and gpu.steps > 2
    np.testing.assert_allclose(gpu.depth, solver.depth, atol=1e-7)
    for found, wanted in zip(gpu.velocity, solver.velocity, strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-5)
    found, wanted = gpu.ledger.as_dict(), solver.ledger.as_dict()
    for volume in ("rain", "inflow", "outflow", "ground", "film"):
        assert found[volume] == pytest.approx(wanted[volume], rel=1e-5, abs=1e-9), volume
    assert abs(found["residual"]) < 1e-6
    for mine, theirs in zip(gpu.conditions, solver.conditions, strict=True):
        assert mine is not theirs
        assert mine.volume == pytest.approx(theirs.volume, rel=1e-5, abs=1e-9)
        assert mine.flow == pytest.approx(theirs.flow, rel=1e-5, abs=1e-9)
    # Without the conditions the water goes another way: they did something.
    without = made(name, level, conditions=None)
    assert without.advance(0.3, RAIN).substeps
    assert np.abs(without.depth - gpu.depth).max() > 1e-3
    assert np.abs(gpu.depth - before).max() > 1e-3


def test_a_lake_at_the_level_of_its_stage_rests_and_the_device_leaves_the_solver_as_it_is():
    solver = made("stage", storage=0.0, conditions=[Stage("west", 0.03)])
    gpu, before = GpuWaterSolver(solver), solver.depth
    gpu.advance(0.1)
    np.testing.assert_array_equal(gpu.depth, before)
    assert gpu.ledger.inflow == 0 and gpu.flow.largest_speed() == 0
    raised = made("stage", storage=0.0, conditions=[Stage("west", 0.04)])
    gpu = GpuWaterSolver(raised)
    gpu.advance(0.1)
    assert gpu.flow.largest_speed() > 0.05 and gpu.ledger.inflow > 1e-4
    assert raised.time == 0 and raised.conditions[0].volume == 0


@pytest.mark.parametrize("name", ["all", None])
def test_a_saved_state_goes_on_to_the_same_bytes_and_on_the_cpu(name, tmp_path):
    def begun():
        rising = 0.06 + 0.02 * np.arange(N + 3) / N
        return made(name) if name else made("all", rising, conditions=None, boundary="open")

    whole, rain = GpuWaterSolver(begun()), Series([0, 0.2], [RAIN, 4 * RAIN])
    whole.advance(0.1, rain)
    whole.deposit([3], [4], [2e-6])  # not yet taken in
    whole.save(tmp_path / "s.npz")
    other, cpu = GpuWaterSolver(begun()), begun()
    other.load(tmp_path / "s.npz")
    cpu.load(tmp_path / "s.npz")
    for _ in range(2):
        steps = whole.advance(0.1, rain)
        assert other.advance(0.1, rain) == steps == cpu.advance(0.1, rain).substeps
    np.testing.assert_array_equal(other.depth, whole.depth)
    for solver in (other, whole):
        solver.save(tmp_path / f"{solver is other}.npz")
    states = []
    for same in (True, False):
        with np.load(tmp_path / f"{same}.npz") as state:
            states.append(dict(state))
    for field in states[0]:
        if field != "account":  # sums begin anew
            np.testing.assert_array_equal(states[0][field], states[1][field], err_msg=field)
    np.testing.assert_allclose(states[0]["account"], states[1]["account"], rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(cpu.depth, whole.depth, atol=1e-7)
    assert cpu.ledger.rain == pytest.approx(whole.ledger.rain, rel=1e-6)
    assert np.abs(whole.depth - begun().depth).max() > 1e-3


def test_rain_on_dry_ground_flows_as_on_the_cpu_whatever_the_calls():
    slope = -0.1 * np.arange(N + 3.0) * np.ones((N, 1))
    solver = WaterSolver(slope, 1.0, scheme="lean", boundary={"east": "open"})
    gpu = GpuWaterSolver(solver)
    for duration in (0.02, 0.02, 0.6):
        report = solver.advance(duration, 1e-3)
        assert gpu.advance(duration, 1e-3) == report.substeps
        speed = gpu.flow.largest_speed()
        assert speed == pytest.approx(report.max_speed, rel=1e-5) and speed > 0.9 * 0.0196
    np.testing.assert_allclose(gpu.depth, solver.depth, atol=1e-8)
    dry = GpuWaterSolver(WaterSolver(slope, 1.0, scheme="lean"))
    dry.advance(0.6)
    assert dry.flow.largest_speed() == 0


def test_water_that_is_too_fast_is_told():
    solver = made("all", courant=0.5)
    solver.set_state(0.1, u=2000.0)
    with pytest.raises(DivergedError, match=r"smaller courant than 0\.5"):
        GpuWaterSolver(solver).advance(1e-6)


def test_flow_runs_on_the_device_and_refuses_other_schemes_in_one_line(tmp_path, monkeypatch):
    def flow(*words):
        words = "flow", "bed.npy", "--spacing", "1", "--duration", "0.2", "--period", "0.1", *words
        return CliRunner().invoke(cli, [*words, "--backend", "cuda"], prog_name="rainsim")

    monkeypatch.chdir(tmp_path)
    np.save("bed.npy", np.zeros((N, N + 3)))
    for words in (["--scheme", "accurate"], ["--scheme", "paper"], ["--double"]):
        refused = flow(*words, "--out", "refused")
        (line,) = (line for line in refused.stderr.splitlines() if line.startswith("Error"))
        assert refused.exit_code == 2 and 'it must be "lean" in float32' in line
        assert refused.stderr.rstrip().endswith(line) and "Traceback" not in refused.output
        assert not list(tmp_path.glob("refused/*.np*"))
    done = flow("--discharge", "west=1", "--out", "done")
    assert done.exit_code == 0 and "auto: the scheme of a CUDA device" in done.stderr
    assert np.load("done/depth.npy").sum() == pytest.approx(0.2, rel=1e-3)
