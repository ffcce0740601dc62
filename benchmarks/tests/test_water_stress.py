"""Where water schemes fail: every one of ours must hold, in both types, at every Courant number."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import stress
from rainsim.errors import ParameterError
from rainsim.grid import WaterSolver

SCHEMES = ("auto", "accurate", "lean")
TYPES = (np.float32, np.float64)


def require_hold(record, moved):
    """Fail unless a trial held, and its water moved by more than `moved` [m]."""
    assert record["outcome"] == "holds", record
    assert record["steps"] > 10
    assert record["moved"] > moved


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("scheme", ["accurate", "lean"])
@pytest.mark.parametrize("make", stress.TRIALS)
def test_where_methods_fail(make, scheme, dtype):
    trial = make(24)
    record = stress.endure(trial, scheme, 0.3, dtype)
    require_hold(record, 0.1 * trial.depth.max())
    if scheme == "accurate":
        # float32 too: what a depth cannot hold is kept beside it, itself rounded in thin films
        assert record["drift"] < (1e-9 if make is stress.thin_film else 1e-10)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_long_steps_are_bounded_or_refused(scheme):
    trial = stress.dam(24)
    for courant in (0.3, 0.7):
        require_hold(stress.endure(trial, scheme, 0.3, courant=courant), 0.05)
    for courant in (0.9, 1.1):
        assert stress.endure(trial, scheme, courant=courant)["outcome"] == "refused"
        with pytest.raises(ParameterError, match=f"courant is {courant}.*to 0.7"):
            WaterSolver(trial.bed, trial.spacing, scheme=scheme, courant=courant)


@pytest.mark.parametrize("scheme", ["accurate", "lean"])
def test_random_rain_on_uneven_ground(scheme):
    require_hold(stress.endure_rain(stress.bumps(24), scheme, 300), 1e-5)


def test_a_short_step_after_a_long_one_does_not_turn_friction_round():
    # Found by random rain: the velocity, half of the long step ahead, had to go back in time.
    trial = stress.bumps(24)
    solver = WaterSolver(trial.bed, trial.spacing, scheme="accurate", manning=0.02)
    solver.set_state(0.002)
    solver.advance(1e-4)
    solver.flow._lead = 0.1
    report = solver.advance(0.01)
    assert np.isfinite(report.max_speed) and report.max_speed > 0.0
    assert solver.flow._lead > 0.0


def test_a_failure_is_reported():
    watch = stress._Extremes(np.zeros((2, 2)), np.full((2, 2), 0.1))
    watch.update(np.full((2, 2), 0.2), WaterSolver(np.zeros((2, 2)), 1.0).advance(0.0))
    watch.speed = 2.0
    record = stress._record(stress._Run("x", "lean", np.float32), watch, 1.0, 1e-6, 3, 0.1)
    assert record["outcome"] == "changes volume, too fast"
    assert record["moved"] == pytest.approx(0.1)
    text = stress.table({"records": [{**record, "scheme": s} for s in stress.SCHEMES]})
    assert text.count("**1e+00 / 2.00 changes volume, too fast**") == 4


@pytest.mark.slow
@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_full_size(scheme, dtype):
    for make in stress.TRIALS:
        trial = make(64)
        require_hold(stress.endure(trial, scheme, 3.0, dtype), 0.1 * trial.depth.max())
    for courant in (0.3, 0.5, 0.7):
        require_hold(stress.endure(stress.dam(64), scheme, 3.0, dtype, courant), 0.05)


@pytest.mark.parametrize("scheme", ["accurate", "lean"])
@pytest.mark.parametrize("seed", range(10))
def test_the_account_holds_on_ten_terrains(seed, scheme):
    require_hold(stress.endure(stress.terrain(32, seed), scheme, 0.5), 0.01)


def test_what_the_solver_refuses_fails_where_it_is_forced_and_leaks_are_seen():
    trial = stress.dam(24)
    record = stress.endure(trial, "accurate", courant=2.0, forced=True)
    assert record["outcome"] != "holds" and record["steps"] > 10
    trial = stress.walls(24)
    wall = trial.bed > 2
    gap = np.where(wall & (np.cumsum(wall, axis=1) == 1) & (np.arange(24)[:, None] == 12), 0, 1)
    record = stress.endure(replace(trial, bed=trial.bed * gap), "lean", 1.0)
    assert record["outcome"] == "leaks"


@pytest.mark.parametrize("scheme", SCHEMES)
def test_ground_and_rain_without_numbers_are_refused(scheme):
    bed, rain = np.zeros((4, 4)), np.zeros((4, 4))
    rain[1, 2] = bed[3, 3] = np.nan
    with pytest.raises(ParameterError, match=r"bed is nan at row 3, column 3.*must be finite"):
        WaterSolver(bed, 1.0, scheme=scheme)
    solver = WaterSolver(0 * rain[:1].repeat(4, 0), 1.0, scheme=scheme)
    with pytest.raises(ParameterError, match="rain is nan"):
        solver.advance(1.0, rain=rain)
    assert solver.ledger.rain == 0 and np.isfinite(solver.depth).all()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["accurate", "lean", "paper"])
def test_the_account_of_a_million_steps_in_float32(scheme):
    trial = stress.bumps(64)
    require_hold(stress.endure_rain(trial, scheme, 1_000_000), 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_hundred_thousand_steps_of_rain(scheme):
    require_hold(stress.endure_rain(stress.bumps(96), scheme, 100_000), 0.01)


@pytest.mark.slow
def test_a_hundred_thousand_steps_of_rain_on_the_real_garden(tmp_path, shared):
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    run = [sys.executable, shared("data/unpack.py"), tmp_path]
    subprocess.run(run, check=True, env=environment, stdout=subprocess.DEVNULL)
    run = [sys.executable, "-m", "rainsim", "heightmap", tmp_path / "garden"]
    run += ["--spacing", "0.05", "--out", tmp_path / "map", "--quiet"]
    subprocess.run(run, check=True, env=environment, stdout=subprocess.DEVNULL)
    bed = np.load(tmp_path / "map/terrain.npz")["bed"].astype(np.float64)
    trial = stress.Trial("garden", bed, 0.05, np.zeros(bed.shape))
    for scheme in SCHEMES:
        require_hold(stress.endure_rain(trial, scheme, 100_000), 0.01)
