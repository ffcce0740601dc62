"""`rainsim flow`: the water solver alone, from maps and tables to maps, gauges and a state."""

import csv
import itertools
import json
import math
import os
import signal

import numpy as np
import pytest

from rainsim.commands import flow
from rainsim.io import files
from rainsim.io.rasters import Raster, read_raster, write_raster
from run_folders import written

N = 12


@pytest.fixture
def valley(tmp_path):
    """A valley that falls to the east, as an ESRI ASCII grid; tables of rain, river and weir."""
    y, x = np.mgrid[:N, : 2 * N].astype(float)
    bed = 0.05 * np.abs(y - N / 2) - 0.01 * x
    write_raster(tmp_path / "valley.asc", bed, Raster(bed, 2.0, (100.0, 50.0), ".asc"))
    (tmp_path / "rain.csv").write_text("time_s,rain_mm_h\n0,60\n20,0\n")
    (tmp_path / "river.csv").write_text("time_s,m3_s\n0,0\n10,0.5\n60,0.5\n")
    (tmp_path / "weir.csv").write_text("level_m,m3_s\n-1,0\n0,2\n1,9\n")
    return bed


WORDS = ("valley.asc", "--rain", "rain.csv", "--manning", "0.03",
         "--discharge", "west:4:8=river.csv", "--rating", "east=weir.csv", "--gauge", "mid=6,12",
         "--period", "10")  # fmt: skip


def table(path):
    with open(path, newline="") as file:
        names, *rows = csv.reader(file)
    return names, np.array(rows, float)


def test_a_missing_device_is_said_before_any_work(rainsim, tmp_path, valley, monkeypatch):
    monkeypatch.setattr("rainsim.cuda.trouble", lambda: "the CUDA driver finds no GPU")
    monkeypatch.setattr(flow, "_solver", lambda *_: pytest.fail("the solver was made"))
    found = rainsim("flow", *WORDS, "--duration", "20", "--backend", "cuda", "--out", "out")
    assert found.code != 0 and "finds no GPU" in found.error and "\n" not in found.error.strip()
    assert not (tmp_path / "out").exists()


def test_tables_become_maps_and_gauges_with_a_closed_account(rainsim, tmp_path, valley):
    done = rainsim("flow", *WORDS, "--duration", "60", "--out", "out", "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    ledger = told["ledger"]
    assert ledger["rain"] == pytest.approx(60 / 3.6e6 * 20 * valley.size * 4, rel=1e-6)
    assert ledger["inflow"] == pytest.approx(0.5 * 55, rel=1e-3)
    assert ledger["outflow"] > 0 and abs(ledger["residual"]) < 1e-9 and told["steps"] > 10
    names, rows = table(tmp_path / "out/gauges.csv")
    assert names == ["time_s", "mid_depth_m", "mid_u_m_s", "mid_v_m_s",
                     "inflow_discharge_west_m3_s", "inflow_rating_east_m3_s"]  # fmt: skip
    assert rows[:, 0].tolist() == [0, 10, 20, 30, 40, 50, 60]
    depth = read_raster(tmp_path / "out/depth.asc")
    assert depth.spacing == 2 and depth.corner == (100, 50)
    assert depth.values.sum() * 4 == pytest.approx(ledger["ground"] + ledger["film"], rel=1e-5)
    assert depth.values[6, 12] == pytest.approx(rows[-1, 1], rel=1e-5)
    assert depth.values[6].mean() > 2 * depth.values[0].mean()  # rows are not upside down


def test_a_stopped_run_goes_on(rainsim, tmp_path, valley, monkeypatch):
    assert rainsim("flow", *WORDS, "--duration", "60", "--out", "whole").code == 0
    told, pressed = flow.Status.progress, []

    def presses(status, what, now, whole):
        if now > 25 and not pressed:
            pressed.append(now)
            os.kill(os.getpid(), signal.SIGINT)
        told(status, what, now, whole)

    monkeypatch.setattr(flow.Status, "progress", presses)
    stopped = rainsim("flow", *WORDS, "--duration", "60", "--out", "out")
    assert stopped.code == 130 and "--resume goes on" in stopped.err
    assert table(tmp_path / "out/gauges.csv")[1][-1, 0] == 20
    assert not (tmp_path / "out/depth.asc").exists()  # maps are those of the end
    done = rainsim("flow", *WORDS, "--duration", "60", "--out", "out", "--resume")
    assert done.code == 0, done.err
    for name in ("gauges.csv", "depth.asc", "u.asc", "v.asc"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    states = (np.load(tmp_path / name / "state.npz") for name in ("whole", "out"))
    with next(states) as whole, next(states) as again:
        for name in whole.files:
            np.testing.assert_array_equal(again[name], whole[name], err_msg=name)
    gauges = tmp_path / "out/gauges.csv"
    kept = gauges.read_text()
    gauges.write_text(kept + "7,x\n")
    broken = rainsim("flow", *WORDS, "--duration", "80", "--out", "out", "--resume")
    assert broken.code == 1 and "no table of readings" in broken.error
    gauges.write_text(kept)
    longer = rainsim("flow", *WORDS, "--duration", "80", "--out", "out", "--resume")
    assert longer.code == 0 and table(tmp_path / "out/gauges.csv")[1][-1, 0] == 80
    assert "between readings" not in longer.err
    straight = rainsim("flow", *WORDS, "--duration", "80", "--out", "straight")
    assert straight.code == 0
    for name in ("gauges.csv", "depth.asc", "u.asc", "v.asc"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "straight" / name).read_bytes()
    assert rainsim("flow", *WORDS, "--duration", "83", "--out", "out", "--resume").code == 0
    further = rainsim("flow", *WORDS, "--duration", "85", "--out", "out", "--resume")
    assert further.code == 0 and "ended at 83 s, between readings every 10 s" in further.err
    other = rainsim("flow", *WORDS[:-4], "--manning", "0", "--duration", "90", "--out", "out",
                    "--resume")  # fmt: skip
    assert other.code == 2 and "was another" in other.error
    assert "no friction" in rainsim("flow", "valley.asc", "--duration", "1", "--out", "n").err


@pytest.mark.parametrize("pressed", ["twice", "at once"])
def test_a_step_that_takes_long_may_be_ended(rainsim, tmp_path, valley, monkeypatch, pressed):
    steps = []

    def press(*_):
        steps.append(0)
        if len(steps) == 3 or pressed == "at once":
            os.kill(os.getpid(), signal.SIGINT)
            if pressed == "twice":
                os.kill(os.getpid(), signal.SIGINT)
            pytest.fail("the step went on")
        return 0.01

    monkeypatch.setattr("rainsim.grid.longest_step", press)
    done = rainsim("flow", *WORDS, "--duration", "60", "--out", "out")
    assert done.code == 130 and "interrupted" in done.err and "stopped at" not in done.err
    assert len(steps) == (3 if pressed == "twice" else 1)
    assert not (tmp_path / "out/state.npz").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.asc"], "none.asc"),
        (["valley.asc", "--spacing", "3"], "cells of 2 m"),
        (["valley.npy"], "give --spacing"),
        (["valley.asc", "--depth", "1", "--level", "2"], "leave one out"),
        (["valley.asc", "--depth", "small.npy"], "3 x 3 cells"),
        (["valley.asc", "--stage", "up=1"], "edge is 'up'"),
        (["valley.asc", "--stage", "west:1=1"], "west:8:12=river.csv"),
        (["valley.asc", "--rating", "west=2"], "no curve"),
        (["valley.asc", "--open", "all", "--stage", "west=1"], "west edge is open"),
        (["valley.asc", "--gauge", "a=99,0"], "row 99"),
        (["valley.asc", "--rain", "river.png"], "river.png"),
        (["valley.asc", "--rain", "-1"], "rain is -"),
        (["valley.asc", "--gauge", "a=1,1", "--gauge", "a=2,2"], "--gauge a is given twice"),
        (["valley.asc", "--gauge", "a=\u00b2,1"], "is not NAME=ROW,COLUMN"),
        (["valley.asc", "--manning", "1e30"], "manning is 1e+30; it must be from 0 to 100"),
        (["valley.asc", "--courant", "1e-9"], "from 0.001"),
        (["valley.asc", "--period", "1e-9"], "at most 1000000 readings"),
        (["empty.asc"], "no cell with a height"),
        (["holes.asc", "--stage", "west=1"], "--stage at west has 12 cells, 2 of them nodata"),
        (["text.txt"], "as many numbers"),
        (["valley.asc", "--duration", "0"], "must be positive"),
        (["valley.asc", "--period", "0"], "--period"),
    ],
)
def test_bad_input_ends_in_one_line(rainsim, tmp_path, valley, words, message):
    np.save("valley.npy", valley)
    np.save("small.npy", np.ones((3, 3)))
    (tmp_path / "text.txt").write_text("1 2\n3\n")
    like = Raster(valley, 2.0, (100.0, 50.0), ".asc")
    holes = valley.copy()
    holes[3:5, 0] = np.nan
    write_raster(tmp_path / "holes.asc", holes, like)
    write_raster(tmp_path / "empty.asc", np.full_like(valley, np.nan), like)
    done = rainsim("flow", *(["--duration", "1"] if "--duration" not in words else []), *words)
    assert done.code in (1, 2) and message in done.error, done.err


def catchment(path):
    """A slope to the south within a square of nodata, without the line that says its value."""
    bed = np.full((14, 12), np.nan)
    bed[3:12, 2:10] = 1 + 0.05 * np.arange(9)[:, None]
    write_raster(path, bed, Raster(bed, 2.0, (0.0, 0.0), ".asc"))
    lines = [line for line in path.read_text().splitlines() if not line.startswith("NODATA")]
    path.write_text("\n".join(lines))
    return np.isnan(bed)


@pytest.mark.parametrize("way", ["closed", "open"])
def test_cells_without_a_height_are_walls_or_let_water_leave(rainsim, tmp_path, way):
    absent = catchment(tmp_path / "c.asc")
    words = ("--duration", "300", "--rain", "100", "--manning", "0.02", "--nodata", way)
    done = rainsim("flow", "c.asc", *words, "--out", "out", "--json")
    assert done.code == 0, done.err
    assert f"{absent.sum()} of {absent.size} cells have no height" in " ".join(done.err.split())
    ledger = json.loads(done.out)["ledger"]
    fallen = 100 / 3.6e6 * 300 * 4 * (~absent).sum()
    assert ledger["rain"] == pytest.approx(fallen, rel=1e-5)  # none falls where there is no ground
    assert abs(ledger["residual"]) < 1e-9
    depth = read_raster(tmp_path / "out/depth.asc").values
    np.testing.assert_array_equal(np.isnan(depth), absent)
    if way == "closed":
        assert ledger["drained"] == 0 and depth[3, 5] > 5 * depth[11, 5]  # it stands at the foot
        assert np.nansum(depth) * 4 == pytest.approx(fallen, rel=1e-4)
    else:
        assert 0.5 * fallen < ledger["drained"] < fallen and depth[3, 5] < 0.01
        assert f"{ledger['drained']:.6g} m3 left over the edge" in " ".join(done.err.split())


def test_a_run_that_is_over_gains_no_reading_and_keeps_its_period(rainsim, tmp_path, valley):
    words = ("valley.asc", "--duration", "10", "--manning", "0.03", "--rain", "9", "--out", "out")
    assert rainsim("flow", *words, "--period", "3").code == 0
    kept = (tmp_path / "out/gauges.csv").read_bytes()
    assert len(table(tmp_path / "out/gauges.csv")[1]) == 5
    for more in ((), ("--period", "3")):
        assert rainsim("flow", *words, *more, "--resume").code == 0
        assert (tmp_path / "out/gauges.csv").read_bytes() == kept
    other = rainsim("flow", *words, "--period", "4", "--resume")
    assert other.code == 2 and "has readings every 3 s" in other.error


class KilledError(BaseException):
    """Ends a run as a signal that cannot be caught does: nothing else is written."""


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("every", [pytest.param(1, marks=pytest.mark.slow), 5])
def test_a_run_that_is_killed_around_any_file_goes_on_to_the_same_bytes(
    rainsim, tmp_path, valley, monkeypatch, every, after
):
    words = ("flow", *WORDS, "--duration", "25", "--out")
    left = [math.inf]
    monkeypatch.setattr(flow, "SAVE_EVERY", -1.0)  # after each step
    put = files.put_in_place

    def counted(*paths):
        left[0] -= 1
        if left[0] < 0 and not after:
            raise KilledError
        put(*paths)
        if left[0] < 0:
            raise KilledError

    monkeypatch.setattr(files, "put_in_place", counted)
    assert rainsim(*words, "whole").code == 0
    whole = written(tmp_path / "whole")
    assert {"depth.png", "depth.asc", "gauges.csv", "state.npz"} <= set(whole)
    kills = 0
    for number in itertools.count(step=every):
        left[0] = number
        try:
            done = rainsim(*words, f"out{number}")
        except KilledError:
            kills += 1
        else:
            assert done.code == 0
            break
        left[0] = math.inf
        again = rainsim(*words, f"out{number}", "--resume")
        assert again.code == 0, again.err
        assert written(tmp_path / f"out{number}") == whole, number
    assert kills > 40 / every
