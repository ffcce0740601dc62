"""Stages, discharges and rating curves at edges: volumes, levels at rest, the ledger, bad input."""

import numpy as np
import pytest

from rainsim.errors import ParameterError
from rainsim.grid import WaterSolver
from rainsim.water.conditions import Discharge, Rating, Stage
from rainsim.water.gauges import Gauges
from rainsim.water.series import Series

SCHEMES = ["accurate", "lean", "paper"]
CLOSES = {"accurate": 1e-12, "paper": 1e-12, "lean": 1e-5}


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_discharge_brings_its_volume_onto_dry_ground(scheme):
    flow = Series([0, 10, 30], [0.0, 0.8, 0.2])
    river = Discharge("west", flow, span=(1, 4))
    solver = WaterSolver(np.zeros((5, 40)), 1.0, scheme=scheme, conditions=[river])
    report = solver.advance(60.0)
    brought = flow.mean(0, 60) * 60
    assert report.ledger.inflow == pytest.approx(brought, rel=1e-6)
    assert river.volume == report.ledger.inflow
    assert river.flow == pytest.approx(0.2, rel=1e-3)
    assert solver.depth.sum(dtype=float) == pytest.approx(brought, rel=1e-5)
    assert abs(report.residual) < CLOSES[scheme]
    assert solver.depth[2, 30] > 1e-3  # it has run on


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_negative_discharge_takes_no_more_than_there_is(scheme):
    pump = Discharge("east", -1.0)
    solver = WaterSolver(np.zeros((4, 10)), 1.0, scheme=scheme, conditions=[pump])
    solver.set_state(0.1)
    report = solver.advance(2.0)
    assert 0.5 < report.ledger.outflow <= 2.0 * (1 + 1e-6)
    report = solver.advance(200.0)
    assert 3.9 < report.ledger.outflow <= 4.0 * (1 + 1e-6)
    assert report.min_depth >= 0 and abs(report.residual) < CLOSES[scheme]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_stage_fills_the_map_to_its_level_and_a_lake_at_that_level_rests(scheme):
    rng = np.random.default_rng(2)
    bed = 0.1 * rng.random((6, 20))
    sea = Stage("north", 0.3)
    solver = WaterSolver(bed, 1.0, scheme=scheme, manning=0.2, conditions=[sea], dtype=np.float64)
    report = solver.advance(400.0)
    np.testing.assert_allclose(solver.depth + bed, 0.3, atol=2e-3)
    assert report.ledger.inflow - report.ledger.outflow == pytest.approx(sea.volume)
    assert abs(report.residual) < 1e-9
    solver.set_state(np.maximum(0.3 - bed, 0))
    report = solver.advance(100.0)
    assert report.max_speed < 1e-9
    np.testing.assert_allclose(solver.depth + bed, 0.3, atol=1e-9)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_stage_and_a_discharge_hold_a_steady_flow(scheme):
    # A level channel without friction: 0.2 m2/s, 0.5 m deep, tranquil.
    river, sea = Discharge("west", 0.8), Stage("east", 0.5)
    solver = WaterSolver(
        np.zeros((4, 25)), 1.0, scheme=scheme, manning=0.01, conditions=[river, sea]
    )
    solver.set_state(0.5)
    gauges = Gauges(solver, {"middle": (2, 12)})
    gauges.run(400.0, period=100.0)
    assert gauges.names[-2:] == ["inflow_discharge_west_m3_s", "inflow_stage_east_m3_s"]
    last = dict(zip(gauges.names, gauges.rows[-1], strict=True))
    assert last["inflow_stage_east_m3_s"] == pytest.approx(-0.8, rel=0.01)
    assert last["middle_u_m_s"] * last["middle_depth_m"] == pytest.approx(0.2, rel=0.01)
    assert last["middle_depth_m"] == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_rating_curve_lets_out_what_comes_in_at_its_level(scheme):
    weir = Rating("east", [0.0, 0.4], [0.0, 1.6])
    river = Discharge("west", 0.8)
    solver = WaterSolver(np.zeros((4, 30)), 1.0, scheme=scheme, conditions=[river, weir])
    solver.set_state(0.1)
    report = solver.advance(400.0)
    assert weir.flow == pytest.approx(-0.8, rel=0.03)
    assert solver.depth[:, -1].mean() == pytest.approx(0.2, rel=0.03)
    assert abs(report.residual) < CLOSES[scheme]
    assert report.ledger.outflow == pytest.approx(-weir.volume)


def test_a_film_is_not_taken_and_a_rising_tide_floods_dry_ground():
    tide = Stage("south", Series([0, 50, 100], [0.0, 0.4, -1.0]))
    bed = np.full((20, 4), 0.1)
    solver = WaterSolver(bed, 1.0, storage=1e-3, conditions=[tide])
    report = solver.advance(50.0)
    assert report.substeps > 20 and solver.depth[10, 2] > 0.05
    solver.advance(51.0)
    assert solver.depth[0].min() >= 1e-3 - 1e-9  # the film


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Stage("up", 1.0), "'up'"),
        (lambda: _with(Stage("east", 1.0), boundary="open"), "east edge is open.*wall"),
        (lambda: _with(Stage("east", 1.0, span=(2, 9))), r"span is \(2, 9\).*0 and 4"),
        (lambda: _with(Stage("east", 1.0), Discharge("north", 1.0)), "share a cell"),
        (lambda: _with("east"), "'east' is no condition"),
        (lambda: Rating("east", [0, 1], [0, -1]), "-1 m3/s"),
        (lambda: Series([0, 0], [1, 2]), "0 s of a series follows 0"),
        (lambda: Series([0, 1], [1]), "one length"),
        (lambda: Series([0, np.nan], [1, 1]), "times of a series must be finite"),
        (lambda: Gauges(_with(), {"a": (4, 0)}), "gauge 'a' is at row 4"),
        (lambda: _with().advance(1.0, rain=Series([0], [-1.0])), "rain is -1"),
    ],
)
def test_bad_input_is_named(make, words):
    with pytest.raises(ParameterError, match=words):
        make()


def _with(*conditions, **options):
    return WaterSolver(np.zeros((4, 5)), 1.0, conditions=conditions, **options)
