"""Every scheme on cases with exact answers, and where methods fail. Full sizes are slow."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks import cases
from benchmarks.chart import front
from benchmarks.peers import SECONDS_AND_ERRORS
from benchmarks.stress import dam
from benchmarks.water import copy, measure, memory_limit, table
from rainsim.errors import ParameterError
from rainsim.grid import WaterSolver

G = 9.81
LEAST = [
    (cases.stoker, 512, 0.0015), (cases.ritter, 512, 0.0016), (cases.bowl_planar, 200, 0.010),
    (cases.bowl_radial, 200, 0.009), (cases.ripple, 128, 0.012), (cases.rain, 128, 0.0075),
]  # fmt: skip
SMALL = [
    (cases.stoker, 128, 0.0040), (cases.ritter, 128, 0.0062), (cases.bowl_planar, 50, 0.055),
    (cases.bowl_radial, 50, 0.048), (cases.ripple, 64, 0.11),
]  # fmt: skip


@pytest.mark.parametrize(("make", "cells", "bound"), SMALL)
def test_small_cases(make, cells, bound):
    case = make(cells)
    record = measure(case, "auto")
    assert record["error"] < bound
    assert abs(record["residual"]) < 1e-12
    if np.ndim(case.v) == 0 and make is not cases.bowl_radial:  # bowls come back to their start
        assert cases.error_of(case, case.depth) > 4 * bound


@pytest.mark.slow
@pytest.mark.parametrize(("make", "cells", "bound"), LEAST)
def test_full_cases(make, cells, bound):
    record = measure(make(cells), "auto")
    assert record["error"] < bound
    if "crest" in record:
        assert record["crest"] == pytest.approx(1, abs=0.02)
    near = measure(make(cells), "accurate")["error"]
    assert near < bound * (1 if make in (cases.ripple, cases.rain) else 3)


# First order: what it reaches now, not what it should; a change for the worse is to be seen.
LEAN = [
    (cases.stoker, 512, 0.0037), (cases.ritter, 512, 0.0062), (cases.bowl_planar, 200, 0.066),
    (cases.bowl_radial, 200, 0.027), (cases.ripple, 128, 0.100), (cases.rain, 128, 0.0070),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("make", "cells", "bound"), LEAN)
def test_full_cases_lean(make, cells, bound):
    record = measure(make(cells), "lean")
    assert record["error"] < bound
    assert abs(record["residual"]) < 3e-6


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["auto", "accurate", "lean"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_lake_stays_at_rest(scheme, dtype):
    record = measure(cases.lake(200), scheme, dtype=dtype)
    assert record["max_speed"] == 0.0
    rounding = 0.0 if dtype == np.float64 else 0.5 * np.finfo(dtype).eps
    assert record["error"] <= rounding  # the depths as they were given: float64


def test_still_tiles_sleep_and_moving_water_wakes_them():
    bed = np.zeros((64, 256))
    solver = WaterSolver(bed, 0.05, scheme="accurate")
    depth = np.full(bed.shape, 0.1)
    depth[:, :8] += 0.02
    solver.set_state(depth)
    solver.advance(0.3)
    flow = solver.flow
    assert 0 < len(flow.tiles(False)) < len(flow.tiles(True))
    np.testing.assert_array_equal(solver.depth[:, 200:], np.float32(0.1))
    report = solver.advance(15.0)
    assert np.abs(solver.depth[:, 200:] - 0.1).max() > 1e-3  # the wave has come through
    assert abs(report.residual) < 1e-12


@pytest.mark.parametrize("scheme", ["accurate", "lean"])
def test_threads_agree(scheme, threads):
    trial = dam(96)
    results = []
    for count in (1, 2):
        threads(count)
        solver = WaterSolver(
            trial.bed, trial.spacing, scheme=scheme, boundary={"east": "open"}, manning=0.02
        )
        solver.set_state(trial.depth)
        solver.advance(0.5)
        results.append((solver.depth, *solver.velocity))
    for one, two in zip(*results, strict=True):
        np.testing.assert_array_equal(one, two)


def test_drains_and_infiltration_are_booked():
    bed = np.zeros((16, 24))
    solver = WaterSolver(
        bed, 0.1, drains=[(8, 12, 4e-4), (8, 12, 6e-4), (3, 5, 0.0)], infiltration=1e-5,
        kinematic_viscosity=1e-6,
    )  # fmt: skip
    solver.set_state(0.02)
    ledger = solver.advance(4.0).ledger
    assert ledger.drained == pytest.approx(4e-3, rel=1e-3)
    assert ledger.infiltrated == pytest.approx(4 * 1e-5 * bed.size * 0.01, rel=0.03)
    assert abs(ledger.residual) < 1e-12


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"drains": [(1, 9, 1e-3)]}, r"drain \(1, 9\).*columns from 0 to 4"),
        ({"drains": [1, 2]}, "drains must be a list"),
        ({"kinematic_viscosity": 1e-6, "scheme": "paper"}, '"paper" does not have'),
        ({"kinematic_viscosity": math.nan}, "kinematic_viscosity is nan"),
        ({"infiltration": -1.0}, "infiltration is -1.0"),
        ({"scheme": "paper", "courant": 0.6}, "courant is 0.6.*to 0.5"),
    ],
)
def test_bad_input_is_named(given, words):
    with pytest.raises(ParameterError, match=words):
        WaterSolver(np.zeros((4, 5)), 0.1, **given)


def test_front_and_table():
    assert front([(1, 3), (2, 1), (3, 2), (2.5, 1)]) == [(1, 3), (2, 1)]
    records = [
        {
            "case": "stoker",
            "cells": 8,
            "scheme": s,
            "error": 0.5,
            "seconds": 1.0,
            "front": s == "lean",
        }
        for s in ("auto", "accurate", "lean", "paper")
    ]
    text = table({"records": records})
    assert "| stoker | 8 | 0.5000 / 1.000 |" in text and "**0.5000 / 1.000**" in text


def test_memory_limit_is_that_of_a_copy(poisoned):
    a, b = np.arange(100, dtype=np.float32), poisoned(100)
    copy(a, b)
    np.testing.assert_array_equal(a, b)
    assert memory_limit(1 << 12) > 0


def test_the_chart_has_plain_ticks_other_codes_and_the_front(monkeypatch, tmp_path):
    """Labels of ticks are apart, the default is marked, and each panel has its peers."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    from benchmarks import chart, peers, water

    figures = []
    monkeypatch.setattr(pyplot, "close", figures.append)
    records = [
        {"case": case, "scheme": scheme, "error": error / 10**n, "seconds": 1e-3 * 6**n}
        for case in water.SUITE
        for scheme, error in (("auto", 0.1), ("lean", 0.2))
        for n in range(3)
    ]
    water.draw({"records": records}, tmp_path / "chart.png")
    (figure,) = figures
    figure.canvas.draw()
    for axis, case in zip(figure.axes, water.SUITE, strict=False):
        labels = [t for t in axis.get_xticklabels() if t.get_text()]
        boxes = sorted(
            (t.get_window_extent() for t in labels if t.get_visible()), key=lambda b: b.x0
        )
        assert all(a.x1 < b.x0 for a, b in itertools.pairwise(boxes)), case
        names = {line.get_label() for line in axis.lines}
        assert {"auto (default)", "lean", "front"} <= names
        assert set(peers.SECONDS_AND_ERRORS.get(case, {})) <= names
    assert chart.front([(1, 3), (2, 4), (3, 1)]) == [(1, 3), (3, 1)]


def test_the_table_of_other_codes_has_the_points_of_the_chart():
    """The finest of each in docs/compared.md; a bowl that a code did not finish fails."""
    names = {
        "ANUGA, DE1": "ANUGA DE1", "ANUGA, DE0": "ANUGA DE0", "Itzi": "Itzi",
        "PyClaw with GeoClaw's solver": "PyClaw", "Landlab OverlandFlow": "Landlab",
    }  # fmt: skip
    page = (Path(__file__).parents[2] / "docs/compared.md").read_text(encoding="utf-8")
    rows = [[cell.strip(" *") for cell in line.split("|")[1:-1]] for line in page.splitlines()]
    found = {names[row[0]]: row[1:] for row in rows if row and row[0] in names}
    assert set(found) == set(names.values())
    for code, cells in found.items():
        for cell, points in zip(cells, SECONDS_AND_ERRORS.values(), strict=True):
            if cell == "fails":
                assert code == "PyClaw" and len(points.get(code, ())) < 2
                continue
            error, seconds = (float(number.strip(" *")) for number in cell.split("/"))
            assert (seconds, error) == pytest.approx(points[code][-1], rel=0.07), (code, cell)
