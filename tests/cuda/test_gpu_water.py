"""The water's twin on a real GPU: `pytest -m gpu`."""

import numpy as np
import pytest

from benchmarks.cases import wavy_lake
from rainsim.grid import WaterSolver

pytestmark = pytest.mark.gpu


def pond(n=256, sills=False):
    """A pond whose edges are open, without or with last cells higher than their neighbours."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:n, :n] / n
    bed = 0.02 * np.sin(19 * x) * np.cos(17 * y) + 0.002 * rng.random((n, n))
    bed[n // 3, n // 3 : n // 2] += 0.3
    if not sills:
        bed[[0, -1]], bed[:, [0, -1]] = bed[[1, -2]], bed[:, [1, -2]]
    solver = WaterSolver(
        bed, 0.01, scheme="lean", boundary="open", manning=0.015, storage=1e-4 * (x > 0.5),
        infiltration=1e-6 * (y > 0.4),
    )  # fmt: skip
    solver.set_state(np.maximum(0.03 - bed, 0))
    return solver, rng


def run(frames=100, sills=False):
    from rainsim.cuda.grid import GpuWaterSolver

    solver, rng = pond(sills=sills)
    water = GpuWaterSolver(solver)
    before = solver.depth
    for _ in range(frames):
        rows, columns = rng.integers(0, 256, (2, 300))
        volumes = rng.random(300) * 2e-8
        for each in (solver, water):
            each.deposit(rows, columns, volumes)
        solver.advance(1 / 30, rain=1e-5)
        water.advance(1 / 30, 1e-5)
    return solver, water, before


def test_a_hundred_frames_are_those_of_the_cpu():
    solver, water, before = run()
    depth = water.depth
    assert np.abs(depth - before).max() > 1e-3
    assert np.percentile(np.abs(depth - solver.depth), 99.9) < 1e-5
    found, wanted = water.ledger.as_dict(), solver.ledger.as_dict()
    for name, share in {"rain": 1e-12, "infiltrated": 1e-6, "film": 1e-6}.items():
        assert found[name] == pytest.approx(wanted[name], rel=share), name
    # Rounding makes a flow leave sooner or later; what stands and what left together agree.
    assert found["outflow"] == pytest.approx(wanted["outflow"], rel=2e-4)
    kept, asked = (ledger["ground"] + ledger["outflow"] for ledger in (found, wanted))
    assert kept == pytest.approx(asked, rel=1e-7)
    assert abs(found["residual"]) < 1e-6


def test_ten_frames_with_sills_are_those_of_the_cpu():
    """The pond stands above its sills: disturbed by drops it drains, and roundings grow with it."""
    solver, water, before = run(10, sills=True)
    depth = water.depth
    assert np.abs(depth - before).max() > 1e-4
    assert np.abs(depth - solver.depth).max() < 2e-6
    assert water.ledger.outflow == pytest.approx(solver.ledger.outflow, rel=1e-3)


def test_the_same_bytes_twice():
    first, second = (run(10)[1] for _ in range(2))
    fields = [(solver.depth, *solver.velocity) for solver in (first, second)]
    for a, b in zip(*fields, strict=True):
        np.testing.assert_array_equal(a, b)
    assert first.ledger == second.ledger


def test_waves_without_friction_are_those_of_the_cpu():
    """Its numbers are then not read."""
    from rainsim.cuda.grid import GpuWaterSolver

    solver = wavy_lake(300, "lean")
    before, gpu = solver.depth, GpuWaterSolver(solver)
    for _ in range(4):
        assert gpu.advance(0.5) == solver.advance(0.5).substeps > 16
    assert np.abs(solver.depth - before).max() > 1e-3
    assert np.abs(gpu.depth - solver.depth).max() < 2e-6


def test_conditions_act_as_on_the_cpu_and_a_saved_state_goes_on_to_the_same_bytes(tmp_path):
    from rainsim.cuda.grid import GpuWaterSolver
    from rainsim.water.conditions import Discharge, Rating, Stage
    from rainsim.water.series import Series

    def made():
        y, x = np.mgrid[:32, :48] / 32  # small: the CPU's still tiles, which sleep, set no step
        bed = 0.2 * np.sin(5 * x) * np.cos(4 * y) - 0.2 * x
        conditions = [
            Stage("south", Series([0, 10], [0.3, 0.5]), span=(5, 20)),
            Discharge("west", Series([0, 10], [0.2, 0.6]), span=(10, 20)),
            Discharge("north", -0.3, span=(0, 25)), Rating("east", [0.0, 1.0], [0.0, 2.0]),
        ]  # fmt: skip
        solver = WaterSolver(
            bed, 1.0, scheme="lean", manning=0.02, storage=1e-4, conditions=conditions
        )
        solver.set_state(np.maximum(0.3 - bed, 0))
        return solver

    solver, rain = made(), 50 / 3.6e6
    gpu, before = GpuWaterSolver(solver), solver.depth
    for _ in range(5):
        assert gpu.advance(1.0, rain) == solver.advance(1.0, rain).substeps
    assert np.abs(gpu.depth - solver.depth).max() < 1e-5
    assert np.abs(gpu.depth - before).max() > 0.03
    found, wanted = gpu.ledger, solver.ledger
    assert found.inflow == pytest.approx(wanted.inflow, rel=1e-4) and found.inflow > 1
    assert found.outflow == pytest.approx(wanted.outflow, rel=1e-4) and found.outflow > 1
    assert abs(found.residual) < 1e-6
    gpu.save(tmp_path / "s.npz")
    other = GpuWaterSolver(made())
    other.load(tmp_path / "s.npz")
    for each in (gpu, other):
        each.advance(3.0, rain)
    np.testing.assert_array_equal(gpu.depth, other.depth)
    for a, b in zip(gpu.velocity, other.velocity, strict=True):
        np.testing.assert_array_equal(a, b)


def test_rain_on_dry_ground_flows_as_on_the_cpu():
    from rainsim.cuda.grid import GpuWaterSolver

    slope = -0.05 * np.arange(200.0) * np.ones((64, 1))
    solver = WaterSolver(slope, 1.0, scheme="lean", boundary={"east": "open"}, manning=0.02)
    gpu = GpuWaterSolver(solver)
    for duration in (0.02, 5.0, 20.0):
        assert gpu.advance(duration, 2e-5) == solver.advance(duration, 2e-5).substeps
    assert np.abs(gpu.depth - solver.depth).max() < 1e-6 and gpu.flow.largest_speed() > 0.05
