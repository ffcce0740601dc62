"""Windows of the ground along a path: which there are follows from the cameras alone."""

import math

import numpy as np
import pytest

from rainsim.errors import ParameterError
from rainsim.scene.cameras import look_at
from rainsim.terrain.path_ground import grid_of
from rainsim.terrain.stations import AHEAD, REST_CELLS, STRIP, WINDOW_CELLS, station_at, stations_of


def camera(x, y=0.0, heading=0.0, height=1.5):
    ahead = x + 10 * math.cos(heading), y + 10 * math.sin(heading), 0.5
    return look_at((x, y, height), ahead, (0, 0, 1), 60, 64, 48, f"{x}")


DRIVE = [camera(0.5 * n) for n in range(160)]


def test_each_frame_has_one_station_that_holds_the_ground_ahead_of_it():
    stations = stations_of(DRIVE, len(DRIVE), 0.02)
    assert [s.first for s in stations[1:]] == [s.end for s in stations[:-1]]
    assert stations[0].first == 0 and stations[-1].end == len(DRIVE) and len(stations) > 2
    for n, view in enumerate(DRIVE):
        station = station_at(stations, n)
        assert station.first <= n < station.end
        x = view.position[0] + np.array([0.0, AHEAD - 0.1])
        assert grid_of(station.cells, station.spacing).cells(x, np.zeros(2))[2].all()
    assert max(np.prod(grid_of(s.cells, 0.02).shape) for s in stations) <= WINDOW_CELLS


def test_windows_share_one_lattice():
    for station in stations_of(DRIVE, len(DRIVE), 0.02):
        assert np.allclose(np.array(grid_of(station.cells, 0.02).origin) / 0.02 % 100, 0, atol=1e-6)


def test_a_camera_that_stands_still_has_one_station_and_one_that_drives_has_more():
    assert len(stations_of([camera(3.0)], 500, 0.02)) == 1
    assert len(stations_of([camera(3.0)] * 500, 500, 0.02)) == 1
    assert len(stations_of(DRIVE, len(DRIVE), 0.02)) > 1


def test_a_path_that_turns_round_comes_to_other_stations():
    back = [camera(view.position[0], heading=math.pi) for view in DRIVE[::-1]]
    path = DRIVE + back
    stations = stations_of(path, len(path), 0.02)
    assert station_at(stations, 5) != station_at(stations, len(path) - 5)


def test_a_high_camera_needs_the_ground_that_it_looks_at():
    (station,) = stations_of(
        [look_at((0, 0, 60), (80, 0, 0), (0, 0, 1), 60, 64, 48, "high")], 1, 0.1
    )
    assert (
        grid_of(station.cells, station.spacing).cells(80.0, 0.0)[2]
        and not grid_of(station.cells, station.spacing).cells(0.0, 0.0)[2]
    )


def test_too_many_cells_for_one_camera_are_refused():
    with pytest.raises(ParameterError, match="larger --spacing"):
        stations_of([camera(0.0, heading=0.7)], 1, 0.005)


def test_windows_of_a_diagonal_path_serve_many_frames_too():
    slant = [camera(0.3 * n, 0.3 * n, math.pi / 4) for n in range(160)]
    assert len(slant) / len(stations_of(slant, len(slant), 0.02)) > 12


def test_water_stands_in_a_window_from_its_neighbours_along_the_path():
    stations = stations_of(DRIVE, len(DRIVE), 0.02)
    inner = range(1, len(stations) - 2)
    assert len(inner) > 1
    for before, station, after in (stations[k - 1 : k + 2] for k in inner):
        south, north, west, east = station.around
        assert (south, north) == station.cells[:2]
        assert station.cells[2] - west >= 800 and east - station.cells[3] >= 800
        assert west % round(STRIP / 0.02) == 0 and east % round(STRIP / 0.02) == 0
        assert before.cells[2] < station.cells[2] and after.cells[3] > station.cells[3]
        rows, columns = station.window
        assert rows == slice(0, north - south)
        assert columns == slice(station.cells[2] - west, station.cells[3] - west)
    assert max((s.around[1] - s.around[0]) * (s.around[3] - s.around[2]) for s in stations) <= (
        REST_CELLS
    )
