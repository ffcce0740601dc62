"""The solver as a tool: rain by tables, progress, stop and continue, states and gauges in files."""

import csv

import numpy as np
import pytest

from rainsim.errors import InputError
from rainsim.grid import WaterSolver
from rainsim.water.conditions import Discharge, Stage
from rainsim.water.gauges import Gauges
from rainsim.water.series import Series, read_series

SCHEMES = ["accurate", "lean", "paper"]


def made(scheme, lifted=0.0, **changes):
    """A rough slope with an open edge, films, losses, drains and two conditions."""
    rng = np.random.default_rng(1)
    bed = -0.02 * np.arange(70.0) + 0.02 * rng.random((20, 70))
    options = {
        "scheme": scheme, "boundary": {"east": "open"}, "manning": 0.02, "storage": 1e-4,
        "infiltration": 1e-6, "drains": [(4, 4, 1e-4)],
        "conditions": [Discharge("west", 0.2, span=(2, 6)), Stage("north", -0.9, span=(30, 34))],
    }  # fmt: skip
    return WaterSolver(bed + lifted, 0.5, **{**options, **changes})


def test_a_series_is_interpolated_or_holds_and_has_exact_means():
    line, steps = Series([0, 10], [0, 1]), Series([0, 10, 20], [3, 1, 0], holds=True)
    assert line(5) == 0.5 and line(-1) == 0 and line(99) == 1
    assert line.mean(0, 20) == pytest.approx(0.75) and line.most(0, 5) == 0.5
    assert steps(9.9) == 3 and steps(10) == 1 and steps(-5) == 3
    assert steps.mean(5, 25) == pytest.approx((5 * 3 + 10 * 1) / 20)
    assert steps.most(5, 25) == 3 and steps.mean(4, 4) == 3


@pytest.mark.parametrize("holds", [True, False])
def test_rain_of_a_series_brings_its_volume(holds):
    rain = Series([0, 2.5, 7], np.array([20, 80, 0]) / 3.6e6, holds=holds)
    solver = WaterSolver(np.zeros((6, 6)), 0.1)
    ledger = solver.advance(10.0, rain=rain).ledger
    assert ledger.rain == pytest.approx(rain.mean(0, 10) * 10 * 0.36, rel=1e-6)
    assert ledger.ground == pytest.approx(ledger.rain, rel=1e-6)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_run_stopped_anywhere_goes_on_to_the_same_bytes(scheme, tmp_path):
    tide = Series([0, 40], [-0.6, -0.2])
    rain = Series([0, 7, 31], np.array([20, 90, 0]) / 3.6e6)  # cut into pieces of 1 s

    def begun():
        river = Discharge("west", 0.2, span=(2, 6))
        solver = made(scheme, conditions=[river, Stage("north", tide, span=(30, 34))])
        return solver, Gauges(solver, {"mid": (5, 30)})

    whole, read = begun()
    read.run(40.0, 3.0, rain)
    for stop in (0.4, 9.0, 9.1, 25.3):
        solver, gauges = begun()
        gauges.run(40.0, 3.0, rain, lambda now: now < stop)  # noqa: B023
        assert stop <= solver.time < stop + 2 and len(gauges.rows) == solver.time // 3
        solver.save(tmp_path / "s.npz")
        if solver.time == 9:
            gauges.rows.pop()  # killed before the reading of that time
        gauges.write(tmp_path / "g.csv")
        solver, gauges = begun()
        solver.load(tmp_path / "s.npz")
        gauges.load(tmp_path / "g.csv")
        gauges.run(40.0, 3.0, rain, begin=0.0)
        np.testing.assert_array_equal(solver.depth, whole.depth)
        assert solver.ledger == whole.ledger and len(gauges.rows) == 14
        np.testing.assert_allclose(gauges.rows, read.rows, rtol=1e-8, atol=1e-12)


def test_a_run_that_goes_on_under_another_rain_has_had_the_first_one():
    solver, rate = WaterSolver(np.zeros((6, 6)), 0.1), 2e-5
    solver.set_state(0.5)
    time = solver.advance(1.0, rate, lambda now: now < 0.3).time
    ledger = solver.advance(1.0 - time, 0.0).ledger
    assert time < 1 and ledger.rain == pytest.approx(rate * time * 0.36, rel=1e-6)


@pytest.mark.parametrize(
    "changes",
    [{"dtype": np.float64}, {"storage": 0.0}, {"conditions": None}, {"manning": 0.01},
     {"courant": 0.3}, {"lifted": 1.0}],
    ids=lambda changes: next(iter(changes)),
)  # fmt: skip
def test_a_state_of_another_solver_is_refused(changes, tmp_path):
    made("lean").save(tmp_path / "s.npz")
    with pytest.raises(InputError, match="made differently"):
        made("lean", **changes).load(tmp_path / "s.npz")
    (tmp_path / "t.npz").write_bytes(b"no state")
    with pytest.raises(InputError, match="state of the water solver"):
        made("lean").load(tmp_path / "t.npz")


def test_a_state_of_an_older_version_is_refused_in_one_line(tmp_path):
    made("lean").save(tmp_path / "s.npz")
    with np.load(tmp_path / "s.npz") as state:
        arrays = dict(state)
    made("lean").load(tmp_path / "s.npz")
    del arrays["rises"]
    for found in (1, None, 4):
        arrays |= {"times": arrays["times"][:6], "version": np.int64(found or 0)}
        if found is None:
            del arrays["version"]
        np.savez(tmp_path / "old.npz", **arrays)
        rule = "at most 3 is read" if found == 4 else "version 1, at least 3 is read"
        with pytest.raises(InputError, match=f"{rule}.*WaterSolver.save") as told:
            made("lean").load(tmp_path / "old.npz")
        assert "\n" not in str(told.value)


def test_progress_sees_every_step_and_stops_the_solver():
    solver, times = made("accurate"), []
    report = solver.advance(5.0, rain=1e-5, progress=times.append)
    assert len(times) == report.substeps and times[-1] == 5.0
    assert np.all(np.diff(times) > 0)
    report = solver.advance(5.0, rain=1e-5, progress=lambda time: time < 7.0)
    assert 7.0 <= report.time < 10.0
    cells = 20 * 70 * 0.25
    assert report.ledger.rain == pytest.approx(1e-5 * cells * report.time, rel=1e-5)
    assert abs(report.residual) < 1e-9
    assert solver.advance(1.0).time == report.time + 1.0


def test_gauges_write_a_table(tmp_path):
    solver = made("lean")
    gauges = Gauges(solver, {"foot": (10, 66)})
    report = gauges.run(25.0, period=10.0, rain=2e-5)
    assert report.time == 25.0 and [row[0] for row in gauges.rows] == [10.0, 20.0, 25.0]
    gauges.write(tmp_path / "g.csv")
    with open(tmp_path / "g.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert float(table[-1]["foot_depth_m"]) == pytest.approx(solver.depth[10, 66], rel=1e-6)
    assert float(table[-1]["outflow_east_m3_s"]) == pytest.approx(solver.discharge("east"), 1e-6)
    assert float(table[-1]["inflow_discharge_west_m3_s"]) == pytest.approx(0.2, rel=1e-3)
    u = solver.velocity[0]
    assert float(table[-1]["foot_u_m_s"]) == pytest.approx(u[10, 66], rel=1e-5)
    again = read_series(tmp_path / "g.csv", "foot_depth_m")
    assert again(25.0) == pytest.approx(solver.depth[10, 66], rel=1e-6)
    stopped = gauges.run(10.0, period=5.0, progress=lambda time: False)
    assert stopped.time < 30.0 and len(gauges.rows) == 3


def test_a_table_of_rain_is_read(tmp_path):
    path = tmp_path / "rain.csv"
    path.write_text("time_s, rain_mm_h, other\n0,36,1\n\n600, 72,2\n")
    rain = read_series(path, factor=1 / 3.6e6, holds=True)
    assert rain(300.0) == pytest.approx(1e-5) and rain(700.0) == pytest.approx(2e-5)
    assert read_series(path, "other")(300.0) == 1.5


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no table"),
        ("time_s,rain\n", "no table"),
        ("time_s,rain\n0,1\n1,x\n", "line 3 of .* has no number.*'rain'"),
        ("time_s,rain\n0\n", "line 2"),
        ("time_s,rain\n0,\u00b2\n", "line 2 of .* has no number"),
        ('time_s,rain\n0,"' + 200_000 * "1", "no CSV table"),
        ("time_s,rain\n5,1\n1,2\n", "1 s of a series follows 5"),
        ("time_s,rain\n0,1\n", "no column 'snow'; it has rain"),
        ("0,20\n600,100\n", "first line of .* holds numbers.*time_s,rain_mm_h"),
        ("time_min,rain\n0,1\n", "times under 'time_min'"),
        ("Time [h],rain\n0,1\n", "in s from the start"),
        ("time,rain\n2024-05-01 10:00,1\n", "no dates"),
    ],
)
def test_a_table_that_is_none_is_refused(text, words, tmp_path):
    path = tmp_path / "rain.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_series(path, "snow" if "snow" in words else None)
