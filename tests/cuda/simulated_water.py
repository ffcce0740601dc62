"""The water's twin in numba's CUDA simulator; `tests/cuda/test_cuda.py` runs this file."""

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.grid import GpuWaterSolver
from rainsim.errors import ParameterError
from rainsim.grid import WaterSolver
from rainsim.water.series import Series

assert simulated()
N = 16


def basin(**changes):
    """Return a solver on uneven, rough, thirsty ground with two open edges, and water in it."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:N, : N + 3] / N
    bed = 0.02 * np.sin(9 * x) * np.cos(7 * y) + 0.002 * rng.random(x.shape)
    bed[N // 3, N // 3 : N // 2] += 0.3
    options = {
        "scheme": "lean", "boundary": {"west": "open", "north": "open"}, "manning": 0.02,
        "kinematic_viscosity": 1e-6, "storage": 2e-4 * (x > 0.5), "infiltration": 2e-6 * (y > 0.4),
    }  # fmt: skip
    solver = WaterSolver(bed, 0.01, **{**options, **changes})
    solver.set_state(np.maximum(0.015 - bed, 0))
    return solver, rng.random(bed.shape).astype(np.float32)


def test_a_frame_is_that_of_the_cpu():
    solver, exposure = basin()
    water = GpuWaterSolver(solver, exposure)
    before = solver.depth
    rows, columns = np.array([3, 3, 9]), np.array([4, 4, 18])
    volumes = np.array([1e-8, 3e-8, 2e-8])
    solver.deposit(rows, columns, volumes)
    water.deposit(rows, columns, volumes)
    report = solver.advance(1 / 30, rain=np.float32(1e-5) * exposure)
    assert water.advance(1 / 30, 1e-5) == report.substeps > 3
    depth, (u, v) = water.depth, water.flow.faces()
    wanted_u, wanted_v = solver.flow.faces()
    assert np.abs(depth - before).max() > 1e-4
    np.testing.assert_allclose(depth, solver.depth, atol=1e-8)
    np.testing.assert_allclose(u, wanted_u, atol=1e-6)
    np.testing.assert_allclose(v, wanted_v, atol=1e-6)
    found, wanted = water.ledger.as_dict(), solver.ledger.as_dict()
    assert wanted["outflow"] > 0 and wanted["infiltrated"] > 0 and wanted["film"] > 0
    for name in ("rain", "infiltrated", "film", "outflow", "ground"):
        assert found[name] == pytest.approx(wanted[name], rel=1e-7), name
    assert abs(found["residual"]) < 1e-7


@pytest.mark.parametrize("edge", ["west", "east", "south", "north"])
def test_water_leaves_over_a_higher_last_cell_as_on_the_cpu(edge):
    bed = np.zeros((N, N))
    last = {"west": np.s_[:, 0], "east": np.s_[:, -1], "south": np.s_[0], "north": np.s_[-1]}[edge]
    bed[last] = 0.004
    step = WaterSolver(bed, 0.01, scheme="lean", boundary={edge: "open"})
    y, x = np.mgrid[:N, :N] / N
    rise = {"west": 1 - x, "east": x, "south": 1 - y, "north": y}[edge]
    away = {"west": -1, "south": -1}.get(edge, 1) * 0.05 * rise  # gains speed outward
    step.set_state(0.01 - bed, **({"u": away} if edge in ("west", "east") else {"v": away}))
    water = GpuWaterSolver(step)
    for _ in range(2):
        steps = step.advance(1 / 30).substeps
        assert water.advance(1 / 30) == steps
    depth, (u, v) = water.depth, water.flow.faces()
    wanted_u, wanted_v = step.flow.faces()
    np.testing.assert_allclose(depth, step.depth, atol=1e-8)
    np.testing.assert_allclose(u, wanted_u, atol=1e-6)
    np.testing.assert_allclose(v, wanted_v, atol=1e-6)
    inside, out = {"west": (u[:, 1], u[:, 0]), "east": (u[:, -2], u[:, -1]),
                   "south": (v[1], v[0]), "north": (v[-2], v[-1])}[edge]  # fmt: skip
    assert (np.abs(out) > 1.01 * np.abs(inside)).all()
    assert water.ledger.outflow == pytest.approx(step.ledger.outflow, rel=1e-6)


def test_the_solver_alone_takes_a_series_of_rain_as_on_the_cpu():
    solver, _ = basin()
    gpu, times = GpuWaterSolver(solver), []
    rain = Series([0, 0.02], [2e-5, 0.0], holds=True)
    steps = gpu.advance(1 / 30, rain, times.append)
    assert steps == solver.advance(1 / 30, rain).substeps == len(times) > 2
    assert 0.02 in times and times[-1] == gpu.time
    np.testing.assert_allclose(gpu.depth, solver.depth, atol=1e-7)
    assert gpu.ledger.rain == pytest.approx(solver.ledger.rain, rel=1e-6) and gpu.time == 1 / 30
    assert gpu.advance(0.1, rain, lambda time: False) == 1 and 1 / 30 < gpu.time < 0.1
    with pytest.raises(ParameterError, match="rain has shape"):
        gpu.advance(0.01, np.zeros((3, 3)))


def test_a_map_of_rain_falls_as_on_the_cpu():
    solver, _ = basin()
    solver.set_state(0.01 + 1e-4 * np.random.default_rng(4).random(solver.shape))
    gpu = GpuWaterSolver(solver)
    rain = 2e-3 * np.random.default_rng(5).random(solver.shape)
    for rate in (rain, 1e-5):  # one rate after a map falls everywhere again
        gpu.advance(0.005, rate)
        solver.advance(0.005, rate)
    np.testing.assert_allclose(gpu.depth, solver.depth, atol=1e-7)
    assert gpu.ledger.rain == pytest.approx(solver.ledger.rain, rel=1e-6)
    assert solver.ledger.rain == pytest.approx(0.005 * (rain.sum() + 1e-5 * rain.size) * 1e-4)


def test_drains_take_what_they_do_on_the_cpu():
    drains = [(10, 5, 4e-6), (11, 5, 1e-4), (2, 14, 1e-5)]  # the second takes all that comes
    solver, exposure = basin(drains=drains, infiltration=0.0)
    water = GpuWaterSolver(solver, exposure)
    drop = np.array([3]), np.array([4]), np.array([1e-8])
    for _ in range(2):
        solver.deposit(*drop)
        water.deposit(*drop)
        report = solver.advance(1 / 30, rain=np.float32(1e-5) * exposure)
        assert water.advance(1 / 30, 1e-5) == report.substeps
    np.testing.assert_allclose(water.depth, solver.depth, atol=1e-8)
    found, wanted = water.ledger.as_dict(), solver.ledger.as_dict()
    assert wanted["drained"] > 1e-7
    for name in ("drained", "ground", "outflow"):
        assert found[name] == pytest.approx(wanted[name], rel=1e-6), name
    assert abs(found["residual"]) < 1e-7


def test_water_at_rest_stays_and_costs_no_step():
    bed = np.zeros((N, N))
    bed[4:8, 4:8] = 0.02
    solver = WaterSolver(bed, 0.01, scheme="lean")
    solver.set_state(np.maximum(0.01 - bed, 0))
    water = GpuWaterSolver(solver)
    assert water.advance(0.1) == solver.advance(0.1).substeps == 1
    assert water.advance(0.1) == solver.advance(0.1).substeps == 0
    np.testing.assert_array_equal(water.depth, solver.depth)


def test_what_the_device_lacks_is_refused():
    for options in ({"scheme": "accurate"}, {"drains": [(10, 1, 1e-6)]}):
        with pytest.raises(ParameterError, match=r"lean|cpu"):
            GpuWaterSolver(basin(**options)[0])


def test_a_given_state_and_water_that_is_withdrawn_are_those_of_the_cpu():
    solver, _ = basin()
    gpu, depth = GpuWaterSolver(solver), 0.01 + 1e-3 * np.random.default_rng(1).random(solver.shape)
    at = np.array([3, 4]), np.array([5, 5]), np.array([4e-7, 1e-5])  # of the second all
    for each in (solver, gpu):
        each.set_state(depth, u=0.01)
        each.withdraw(*at)
        each.advance(0.01)
    np.testing.assert_allclose(gpu.depth, solver.depth, atol=1e-8)
    found, wanted = gpu.ledger, solver.ledger
    assert found.drained == pytest.approx(wanted.drained, rel=1e-6) and wanted.drained > 1e-6
    assert found.initial == pytest.approx(wanted.initial) and abs(found.residual) < 1e-7
    np.testing.assert_array_equal(gpu.on_host().depth, gpu.depth)
