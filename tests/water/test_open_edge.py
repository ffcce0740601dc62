"""Open edges: water leaves over last cells that are higher, water at rest stays, twins agree."""

import numpy as np
import pytest

from benchmarks import hydraulic_cases, hydraulics
from rainsim.grid import WaterSolver
from rainsim.water.conserving import depth_into_edge_cell, fill_edge_flux, speed_out

SCHEMES = ["accurate", "lean", "paper"]


def turned(a, edge):
    """A map made for the east edge, turned so that its east becomes `edge`."""
    return {"east": a, "west": a[:, ::-1], "north": a.T, "south": a.T[::-1]}[edge]


def channel(edge, scheme, dtype=np.float32, noise=0.0, cells=30):
    """A channel of 0.5 % that falls to `edge`, its last cell 0.05 m higher; and its supply."""
    x = np.tile(np.arange(cells) + 0.5, (6, 1))
    bed = -0.005 * x + noise * np.random.default_rng(4).random(x.shape)
    bed[:, -1] += 0.05
    supply = np.where(x < 5, 0.04, 0.0)  # 0.2 m2/s
    solver = WaterSolver(
        turned(bed, edge), 1.0, scheme=scheme, boundary={edge: "open"}, manning=0.02, dtype=dtype
    )
    return solver, turned(supply, edge)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_what_comes_in_leaves_over_a_higher_last_cell(scheme):
    depth = {}
    for edge in ("east", "west", "south", "north"):
        solver, supply = channel(edge, scheme)
        solver.advance(150.0, rain=supply)
        report = solver.advance(50.0, rain=supply)
        assert solver.discharge(edge) == pytest.approx(supply.sum(), rel=1e-2)
        assert abs(report.residual) < 1e-6
        assert report.min_depth >= 0
        # Critical flow over the sill and 0.05 m below it make 0.29 m; dammed up it was over 0.5 m.
        assert 0.15 < solver.depth.max() < 0.32
        depth[edge] = solver.depth
        if scheme != "paper":  # the same numbers whichever way the map lies
            np.testing.assert_allclose(
                depth[edge], turned(depth["east"], edge), rtol=0.02, atol=1e-4
            )


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_sill_of_the_bench_passes_all_at_the_depth_of_critical_flow(scheme):
    found = hydraulics.at_sill(scheme)
    assert found["leaves"] == pytest.approx(1.0, abs=1e-3)
    assert 0.2 < found["depth"] < 0.4  # 0.34 m in theory; 4.8 m when it was dammed up
    case = hydraulic_cases.sill()
    assert case.bed[0, -1] > case.bed[0, -2]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_lake_at_rest_at_a_rough_open_edge_stays(scheme, dtype):
    rng = np.random.default_rng(3)
    bed = 0.1 * rng.random((20, 24))
    solver = WaterSolver(bed, 0.5, scheme=scheme, boundary="open", dtype=dtype)
    solver.set_state(np.maximum(0.08 - bed, 0))
    before = solver.depth
    report = solver.advance(200.0)
    assert report.max_speed == 0 and report.ledger.outflow == 0
    np.testing.assert_array_equal(solver.depth, before)


@pytest.mark.parametrize(("sill", "leaves"), [(0.04, False), (0.02, True)])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_disturbed_lake_leaves_only_over_sills_that_are_lower(scheme, sill, leaves):
    rng = np.random.default_rng(1)
    bed = 0.002 * rng.random((32, 32))
    bed[[0, -1]] += sill
    bed[1:-1, [0, -1]] += sill
    solver = WaterSolver(bed, 0.05, scheme=scheme, boundary="open", manning=0.015)
    solver.set_state(np.maximum(0.03 - bed, 0))
    for _ in range(100):
        solver.deposit(*rng.integers(1, 31, (2, 30)), 2e-8 * rng.random(30))
        solver.advance(0.1)
    assert (solver.ledger.outflow > 0.05 * solver.ledger.initial) == leaves
    assert solver.ledger.outflow == 0 or leaves


@pytest.mark.parametrize("scheme", SCHEMES)
def test_rain_on_rough_ground_leaves_and_the_ledger_closes(scheme):
    solver, _ = channel("south", scheme, noise=0.02)
    report = solver.advance(600.0, rain=5e-4)
    assert report.ledger.outflow > 0 and report.min_depth >= 0
    assert abs(report.residual) < (1e-5 if scheme == "lean" else 1e-9)


def test_the_water_gains_speed_only_over_a_higher_cell_and_at_most_doubles_it():
    assert speed_out(1.0, 1.0, 0.7, 0.1) == pytest.approx(1.3)
    assert speed_out(1.0, 1.0, 0.7, 0.0) == 1.0
    assert speed_out(1.0, 1.0, 1.2, 0.1) == 1.0
    assert speed_out(1.0, 1.0, -2.0, 0.1) == 2.0
    assert speed_out(-1.0, 1.0, 0.7, 0.1) == 0.0
    assert depth_into_edge_cell(0.3, 0.1) == pytest.approx(0.2)
    assert depth_into_edge_cell(0.3, -0.1) == 0.3 and depth_into_edge_cell(0.1, 0.3) == 0.0


def test_only_faces_to_higher_last_cells_are_changed():
    rng = np.random.default_rng(5)
    ny, nx = 7 + 4, 9 + 4
    h, bed = rng.random((ny, nx)), 0.1 * rng.random((ny, nx))
    u, v = rng.random((ny, nx + 1)) - 0.5, rng.random((ny + 1, nx)) - 0.5
    qu, qv = np.full_like(u, 7.0), np.full_like(v, 7.0)
    fill_edge_flux(np.array([0, 1, 0, 1]), h, bed, u, v, qu, qv)
    wanted = (bed[2:-2, -3] > bed[2:-2, -4]) & (u[2:-2, -4] > 0)
    assert np.array_equal(qu[2:-2, -4] != 7, wanted) and wanted.any() and not wanted.all()
    assert (qu != 7).sum() == wanted.sum()
    j = 2 + np.flatnonzero(wanted)[0]
    deep = h[j, -4] - (bed[j, -3] - bed[j, -4])
    assert qu[j, -4] == pytest.approx(u[j, -4] * max(deep, 0))
    assert (qv != 7).sum() == (qv[-4, 2:-2] != 7).sum() > 0
