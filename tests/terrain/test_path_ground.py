"""Ground along a path: windows, the water in them, and frames by themselves and in sequence."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

import made_road
from made_road import CONFIG, DRIVE, SPACING, camera, frames, road
from rainsim import pipeline, simulation
from rainsim.config.settings import TerrainConfig, mm_per_hour
from rainsim.errors import BackendError, ParameterError
from rainsim.render import window_ahead
from rainsim.scene.painted import PaintedClasses
from rainsim.simulation import steady_water
from rainsim.terrain import path_ground
from rainsim.terrain.path_ground import follows_path, part_of
from rainsim.terrain.types import UNKNOWN

small, scene = made_road.small, made_road.scene  # fixtures
ground, drive = made_road.ground, made_road.drive

# --- frames ---------------------------------------------------------------------------------------


def test_a_frame_by_itself_has_the_bytes_of_the_drive(scene, ground, drive):
    switches = [station.first for station in ground.stations]
    assert len(switches) > 2
    for index in (switches[1], switches[2] - 1, CONFIG.frames - 1):
        assert frames(scene, ground, [index])[index] == drive[index], index
    assert len(set(drive.values())) == CONFIG.frames


def test_other_threads_and_earlier_frames_again_give_the_same_bytes(scene, drive, threads):
    threads(1)
    ground = pipeline.ground_of(scene, CONFIG, DRIVE)
    sequence = pipeline.FrameSequence(scene, ground, DRIVE, CONFIG)
    for index in (9, 2, 3, 2):
        ((picture, report),) = sequence.frames([index])
        assert report.index == index and picture.tobytes() == drive[index], index


def test_a_late_frame_simulates_only_its_own_window(scene, ground, drive, monkeypatch):
    begun = []

    def watched(terrain, config, begin):
        for state in simulation.simulate(terrain, config, begin=begin):
            begun.append((begin.number, state.index, state.depth.shape))
            yield state

    monkeypatch.setattr(window_ahead, "simulate", watched)
    last = CONFIG.frames - 1
    station = ground.station(last)
    assert frames(scene, ground, [last])[last] == drive[last]
    first = station.start(CONFIG)
    assert 0 < first <= station.first - 3
    shape = station.cells[1] - station.cells[0], station.cells[3] - station.cells[2]
    assert begun == [(first, n, shape) for n in range(first, last + 1)]


def test_a_frame_by_itself_is_that_of_the_drive_while_the_weather_changes(scene, ground, drive):
    keys = (
        (0.0, (("rate", 0.0), ("past", 0.0), ("cloudiness", 0.2))),
        (1.5, (("rate", mm_per_hour(60.0)), ("past", 3e-3), ("cloudiness", 1.0))),
    )
    config = CONFIG.replace(keyframes=keys)
    last = CONFIG.frames - 1
    every = frames(scene, ground, range(CONFIG.frames), config=config)
    assert frames(scene, ground, [last], config=config)[last] == every[last] != drive[last]


def test_rain_shows_in_a_late_window(scene, ground, drive):
    dry = CONFIG.replace(rate=0.0, past=0.0)
    last = CONFIG.frames - 1
    assert frames(scene, ground, [last], config=dry)[last] != drive[last]


def test_a_path_that_leaves_the_capture_goes_on_over_unknown_ground():
    path = [camera(18.0), camera(24.0), camera(200.0)]
    scene, config = road(path), CONFIG.replace(frames=3)
    ground = pipeline.ground_of(scene, config, path)
    far = ground.around(scene, ground.station(2))
    assert (far.source == UNKNOWN).all() and np.isfinite(far.bed).all()
    rim = ground.around(scene, ground.station(1))
    assert 0 < np.mean(rim.source == UNKNOWN) < 1
    assert len(frames(scene, ground, [1, 2], path, config)) == 2


def test_splats_without_a_place_change_nothing(scene, ground):
    bad = replace(scene.splats, position=scene.splats.position.copy())
    bad.position[::500] = np.nan
    broken, station = replace(scene, splats=bad), ground.stations[1]
    found = pipeline.ground_of(broken, CONFIG, DRIVE).around(broken, station)
    assert np.isfinite(found.bed).all()
    assert np.abs(found.bed - ground.around(scene, station).bed).max() < 5e-3


# --- windows --------------------------------------------------------------------------------------


def test_a_path_that_turns_back_and_crosses_itself_finds_the_same_ground(scene):
    there = [camera(4.0 + 0.6 * n) for n in range(8)]
    back = [camera(view.position[0], heading=math.pi) for view in there[::-1]]
    across = [camera(6.0, -1.0 + 0.5 * n, math.pi / 2) for n in range(4)]
    path = there + back + across
    ground = pipeline.ground_of(scene, CONFIG.replace(frames=len(path)), path)
    assert ground.station(2) != ground.station(13)
    beds = [_bed_at(scene, ground, ground.station(n)) for n in (2, 13, 18)]
    assert np.nanmax(np.abs(beds[0] - beds[1])) < 1e-4
    assert np.nanmax(np.abs(beds[0] - beds[2])) < 1e-4
    assert min(np.isfinite(bed).sum() for bed in beds) > 500


def _bed_at(scene, ground, station):
    """The bed over (4 to 8, -1 to 1) m, NaN beyond what the station has."""
    around = ground.around(scene, station)
    x, y = np.meshgrid(np.arange(4.025, 8, SPACING), np.arange(-0.975, 1, SPACING))
    row, column, inside = around.grid.cells(x, y)
    return np.where(inside, around.bed[row, column], np.nan)


def test_a_camera_that_stands_still_has_one_window(scene):
    for path in ([camera(5.0)], [camera(5.0)] * 16):
        ground = pipeline.ground_of(scene, CONFIG, path)
        assert len(ground.stations) == 1
    assert len(pipeline.ground_of(scene, CONFIG, DRIVE).stations) > 1


def test_windows_share_the_strips_that_both_hold(scene, ground, monkeypatch):
    made = []
    original = path_ground.arrays_over
    monkeypatch.setattr(
        path_ground, "arrays_over", lambda *args: made.append(args[1]) or original(*args)
    )
    fresh = pickle.loads(pickle.dumps(ground))
    assert fresh._last[1] is None
    first = fresh.around(scene, fresh.stations[0])
    begun = len(made)
    fresh.around(scene, fresh.stations[1])
    assert 0 < len(made) - begun < begun
    again = fresh.around(scene, fresh.stations[0])
    assert again.bed.tobytes() == first.bed.tobytes()


def test_neighbours_agree_on_the_water_that_stands_in_both(scene, ground):
    def disagreement(neighbours):
        depths = []
        for station in neighbours:
            around = ground.around(scene, station)
            depth = steady_water(around, CONFIG, 5).depth
            depths.append((station, depth[station.window]))
        west, east = max(s.cells[2] for s, _ in depths), min(s.cells[3] for s, _ in depths)
        parts = [d[:, west - s.cells[2] : east - s.cells[2]] for s, d in depths]
        assert parts[0].shape == parts[1].shape and parts[0].max() > 3e-3
        return np.abs(parts[0] - parts[1]).mean()

    pair = ground.stations[1:3]
    cut = [station._replace(around=station.cells) for station in pair]
    assert disagreement(pair) < 0.1 * disagreement(cut)


def test_the_ledger_of_a_window_closes_and_says_what_leaves_at_its_borders(scene, ground):
    station = ground.stations[2]
    around = ground.around(scene, station)
    begin = steady_water(around, CONFIG, station.start(CONFIG))
    window = part_of(around, station.window)
    begin = begin.within(station.window)
    run = simulation.simulate(window, CONFIG, begin=begin)
    for _ in range(12):
        ledger = next(run).ledger
    assert abs(ledger["residual"]) < 1e-9
    assert ledger["initial"] == pytest.approx(begin.depth.sum() * SPACING**2)
    assert ledger["rain"] > 0 and ledger["outflow"] > 0


def test_rain_before_a_window_stands_in_it_at_the_start(scene, ground):
    around = ground.around(scene, ground.stations[1])
    config = CONFIG.replace(past=1e-4)
    early, late = (steady_water(around, config, n).depth.sum() for n in (0, 150))
    assert late > 1.5 * early > 0
    drier = config.replace(rate=0.0)
    first, last = (steady_water(around, drier, n).depth.sum() for n in (0, 150))
    assert last == pytest.approx(first) and 0 < first < early


# --- which ground ---------------------------------------------------------------------------------


def test_auto_takes_windows_where_one_map_would_be_too_coarse(scene, monkeypatch):
    def auto(cameras=DRIVE, backend="cpu", mask=None, **changes):
        config = CONFIG.replace(ground_map="auto", **changes)
        return follows_path(scene, config, cameras, backend, mask)

    assert not auto() and not auto(spacing=None)
    monkeypatch.setattr(path_ground, "AUTO_CELLS", 20_000)
    monkeypatch.setattr(path_ground, "MOST_CELLS", 20_000)
    assert auto() and auto(spacing=None)
    assert not auto(cameras=DRIVE[:1]) and not auto(backend="cuda") and not auto(extent=2.0)
    aloft = [replace(view, camera_from_world=_raised(view, 5.0)) for view in DRIVE]
    assert not auto(cameras=aloft)
    assert not auto(level=0.1) and not auto(mask=np.zeros((4, 4), int))
    assert not follows_path(scene, CONFIG.replace(ground_map="whole"), DRIVE)


def _raised(view, height):
    matrix = view.camera_from_world.copy()
    matrix[:3, 3] -= matrix[:3, :3] @ (0, 0, height)
    return matrix


@pytest.mark.parametrize(
    ("changes", "how", "text"),
    [
        ({"extent": 3.0}, {}, "leave out --extent"),
        ({"level": 0.1}, {}, "leave out --water-level"),
        ({}, {"mask": np.zeros((4, 4), int)}, "leave out --class-mask and --water-mask"),
    ],
)
def test_what_needs_one_map_is_refused_with_the_path(scene, changes, how, text):
    with pytest.raises(ParameterError, match=text):
        follows_path(scene, CONFIG.replace(**changes), DRIVE, **how)


def test_painted_water_and_other_backends_are_refused_with_the_path(scene):
    painted = PaintedClasses(("water",), np.zeros((4, 4), np.int16), (0.0, 0.0), 0.5)
    with pytest.raises(ParameterError, match="painted water is given"):
        follows_path(replace(scene, painted=painted), CONFIG, DRIVE)
    with pytest.raises(BackendError, match="--backend cpu or --ground-map whole"):
        follows_path(scene, CONFIG, DRIVE, "cuda")


def test_one_map_is_never_made_for_the_path(scene):
    with pytest.raises(ParameterError, match="give whole or auto"):
        pipeline.extract_terrain(scene, CONFIG)
    with pytest.raises(ParameterError, match="one of auto, whole, path"):
        TerrainConfig(ground_map="sideways").check()


def test_a_window_begins_with_the_streams_of_the_rain_and_without_them_when_it_is_dry(scene):
    wet = CONFIG.replace(rate=mm_per_hour(300.0), past=0.0)
    ground = pipeline.ground_of(scene, wet, DRIVE)
    around = ground.around(scene, ground.stations[2])
    begin = steady_water(around, wet, 0, ground.about(around.grid))
    assert begin.depth.max() > 1e-3 and np.abs(begin.velocity).max() > 0.02
    dry = steady_water(around, wet.replace(rate=0.0), 0)
    assert not dry.depth.any() and not dry.velocity.any()
    again = steady_water(around, wet, 0, ground.about(around.grid))
    assert again.depth.tobytes() == begin.depth.tobytes()


def test_windows_leave_nothing_in_the_folder_of_results(scene, ground, monkeypatch, tmp_path):
    monkeypatch.setenv("RAINSIM_CACHE", str(tmp_path))
    monkeypatch.setattr("rainsim.rain.dripping.LEAST_KEPT", 100)
    station = ground.stations[1]
    around = ground.around(scene, station)
    begin = steady_water(around, CONFIG, 0).within(station.window)
    next(simulation.simulate(part_of(around, station.window), CONFIG, begin=begin))
    assert not list(tmp_path.iterdir())
    next(simulation.simulate(around, CONFIG))
    assert list(tmp_path.glob("catchments-*"))
