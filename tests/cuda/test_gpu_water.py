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
