"""Ground along a path: legs, the water in them, and frames by themselves and in sequence."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import made_road
from made_road import CONFIG, DRIVE, SPACING, camera, frames, road
from rainsim import pipeline, simulation
from rainsim.config.settings import TerrainConfig, mm_per_hour
from rainsim.errors import BackendError, ParameterError
from rainsim.rain.exposure import rain_exposure
from rainsim.scene.cameras import look_at
from rainsim.scene.painted import PaintedClasses
from rainsim.simulation import simulate, steady_water
from rainsim.terrain import path_ground
from rainsim.terrain.path_ground import AHEAD, LEG_CELLS, follows_path, legs_of
from rainsim.terrain.types import UNKNOWN

small, scene = made_road.small, made_road.scene  # fixtures
ground, drive = made_road.ground, made_road.drive
LAST = CONFIG.frames - 1

# --- frames ---------------------------------------------------------------------------------------


def test_a_late_frame_makes_and_simulates_only_its_own_leg(scene, ground, drive, monkeypatch):
    begun = []

    def watched(terrain, config, first):
        for state in simulation.simulate(terrain, config, first=first):
            begun.append((first, state.index, state.depth.shape))
            yield state

    monkeypatch.setattr(pipeline, "simulate", watched)
    leg = ground.leg(LAST)
    assert frames(scene, ground, [LAST])[LAST] == drive[LAST]
    first = leg.start(CONFIG)
    assert 0 < first == leg.first - 3
    assert begun == [(first, n, leg.grid.shape) for n in range(first, LAST + 1)]


def test_a_frame_by_itself_is_that_of_the_drive_while_the_weather_changes(scene, ground, drive):
    keys = (
        (0.0, (("rate", 0.0), ("past", 0.0), ("cloudiness", 0.2))),
        (1.5, (("rate", mm_per_hour(60.0)), ("past", 3e-3), ("cloudiness", 1.0))),
    )
    config = CONFIG.replace(keyframes=keys)
    every = frames(scene, ground, range(CONFIG.frames), config=config)
    assert frames(scene, ground, [LAST], config=config)[LAST] == every[LAST] != drive[LAST]


def test_the_same_frame_by_the_legs_before_and_after_a_switch(scene, ground, drive):
    """Ground, light and drops agree; water has run for another time."""
    before, after = ground.legs[1:3]
    index = after.first - 1
    earlier = after._replace(first=index)
    other = pipeline.ground_of(scene, CONFIG, DRIVE)
    other.legs = [ground.legs[0], before._replace(end=index), earlier, *ground.legs[3:]]
    for config, least in ((CONFIG, 30.0), (CONFIG.replace(rate=0.0, past=0.0), 60.0)):
        pictures = [
            np.frombuffer(frames(scene, ground, [index], config=config)[index], np.uint8)
            for ground in (ground, other)
        ]
        error = np.mean((pictures[0] / 255.0 - pictures[1] / 255.0) ** 2)
        assert error <= 10 ** (-least / 10), (least, 10 * math.log10(error))


def test_rain_shows_in_a_late_leg(scene, ground, drive):
    dry = CONFIG.replace(rate=0.0, past=0.0)
    assert frames(scene, ground, [LAST], config=dry)[LAST] != drive[LAST]


def test_a_path_that_leaves_the_capture_goes_on_over_unknown_ground():
    path = [camera(18.0), camera(24.0), camera(200.0)]
    scene, config = road(path), CONFIG.replace(frames=3)
    ground = pipeline.ground_of(scene, config, path)
    far = ground.terrain(scene, ground.leg(2))
    assert (far.source == UNKNOWN).all() and np.isfinite(far.bed).all()
    rim = ground.terrain(scene, ground.leg(1))
    assert 0 < np.mean(rim.source == UNKNOWN) < 1
    assert len(frames(scene, ground, [1, 2], path, config)) == 2


def test_splats_without_a_place_change_nothing(scene, ground):
    bad = replace(scene.splats, position=scene.splats.position.copy())
    bad.position[::500] = np.nan
    broken, leg = replace(scene, splats=bad), ground.legs[1]
    found = pipeline.ground_of(broken, CONFIG, DRIVE).terrain(broken, leg)
    assert np.isfinite(found.bed).all()
    assert np.abs(found.bed - ground.terrain(scene, leg).bed).max() < 5e-3


# --- legs -----------------------------------------------------------------------------------------


def level(x, y):
    return np.zeros_like(x)


def far_camera(x, y=0.0, heading=0.0):
    ahead = x + 10 * math.cos(heading), y + 10 * math.sin(heading), 0.5
    return look_at((x, y, 1.5), ahead, (0, 0, 1), 60, 64, 48, f"{x}")


@pytest.fixture
def usual(monkeypatch):
    """Legs of the usual size."""
    sizes = {"BEHIND": 4.0, "AHEAD": AHEAD, "ASIDE": 5.0, "STEP": 2.0, "LEG_CELLS": LEG_CELLS}
    for name, value in (sizes | {"GROWN": 1.5}).items():
        monkeypatch.setattr(path_ground, name, value)


def test_each_frame_has_one_leg_that_holds_the_ground_ahead_of_it(usual):
    path = [far_camera(0.5 * n) for n in range(600)]
    legs = legs_of(path, len(path), 0.02, level)
    assert [leg.first for leg in legs[1:]] == [leg.end for leg in legs[:-1]]
    assert legs[0].first == 0 and legs[-1].end == len(path) and 4 < len(legs) < 9
    for leg in legs:
        for view in (path[leg.first], path[leg.end - 1]):
            x = view.position[0] + np.array([0.0, AHEAD - 0.1])
            assert leg.grid.cells(x, np.zeros(2))[2].all()
        assert np.allclose(np.array(leg.grid.origin) / 0.02 % 100, 0, atol=1e-6)  # one lattice
    assert max(np.prod(leg.grid.shape) for leg in legs) <= LEG_CELLS
    slant = [far_camera(0.3 * n, 0.3 * n, math.pi / 4) for n in range(160)]
    assert len(slant) / len(legs_of(slant, len(slant), 0.02, level)) > 12


def test_a_camera_that_stands_still_has_one_leg_and_one_that_turns_round_another(usual):
    assert len(legs_of([far_camera(3.0)], 500, 0.02, level)) == 1
    assert len(legs_of([far_camera(3.0)] * 500, 500, 0.02, level)) == 1
    there = [far_camera(0.5 * n) for n in range(160)]
    path = there + [far_camera(view.position[0], heading=math.pi) for view in there[::-1]]
    legs = legs_of(path, len(path), 0.02, level)
    assert legs[0].end < 160 < legs[-1].first


def test_a_high_camera_needs_the_ground_that_it_looks_at(usual):
    high = look_at((0, 0, 60), (80, 0, 0), (0, 0, 1), 60, 64, 48, "high")
    (leg,) = legs_of([high], 1, 0.1, level)
    assert leg.grid.cells(80.0, 0.0)[2] and not leg.grid.cells(0.0, 0.0)[2]


def test_too_many_cells_for_one_camera_are_refused(usual):
    with pytest.raises(ParameterError, match="larger --spacing"):
        legs_of([far_camera(0.0, heading=0.7)], 1, 0.005, level)


def test_a_path_that_turns_back_and_crosses_itself_finds_the_same_ground(scene):
    there = [camera(4.0 + 0.6 * n) for n in range(8)]
    back = [camera(view.position[0], heading=math.pi) for view in there[::-1]]
    across = [camera(6.0, -1.0 + 0.5 * n, math.pi / 2) for n in range(4)]
    path = there + back + across
    ground = pipeline.ground_of(scene, CONFIG.replace(frames=len(path)), path)
    assert ground.leg(2) != ground.leg(13)
    beds = [_bed_at(scene, ground, ground.leg(n)) for n in (2, 13, 18)]
    assert np.nanmax(np.abs(beds[0] - beds[1])) < 1e-4
    assert np.nanmax(np.abs(beds[0] - beds[2])) < 1e-4
    assert min(np.isfinite(bed).sum() for bed in beds) > 500


def _bed_at(scene, ground, leg):
    """The bed over (4 to 8, -1 to 1) m, NaN beyond what the leg has."""
    terrain = ground.terrain(scene, leg)
    x, y = np.meshgrid(np.arange(4.025, 8, SPACING), np.arange(-0.975, 1, SPACING))
    row, column, inside = terrain.grid.cells(x, y)
    return np.where(inside, terrain.bed[row, column], np.nan)


# --- water ----------------------------------------------------------------------------------------


def begun(terrain, config, number):
    """Depth, velocity and notes of the water with which a leg begins."""
    return steady_water(terrain, config, rain_exposure(terrain, (0.0, 0.0)), number / config.fps)


def test_the_ledger_of_a_leg_closes_and_says_what_leaves_at_its_borders(scene, ground):
    leg = ground.legs[2]
    terrain = ground.terrain(scene, leg)
    depth, _, _ = begun(terrain, CONFIG, leg.start(CONFIG))
    run = simulate(terrain, CONFIG, first=leg.start(CONFIG))
    for _ in range(12):
        ledger = next(run).ledger
    assert abs(ledger["residual"]) < 1e-6
    assert ledger["initial"] == pytest.approx(depth.sum() * SPACING**2, rel=1e-4)
    assert ledger["rain"] > 0 and ledger["outflow"] > 0


def test_rain_before_a_leg_stands_in_it_at_the_start(scene, ground):
    terrain, config = ground.terrain(scene, ground.legs[1]), CONFIG.replace(past=1e-4)
    early, late = (begun(terrain, config, n)[0].sum() for n in (0, 150))
    assert late > 1.5 * early > 0
    drier = config.replace(rate=0.0)
    first, last = (begun(terrain, drier, n)[0].sum() for n in (0, 150))
    assert last == pytest.approx(first) and 0 < first < early


def test_a_leg_begins_with_the_streams_of_the_rain_and_without_them_when_it_is_dry(scene, ground):
    wet = CONFIG.replace(rate=mm_per_hour(300.0), past=0.0)
    terrain = ground.terrain(scene, ground.legs[2])
    depth, velocity, _ = begun(terrain, wet, 0)
    assert depth.max() > 1e-3 and np.abs(velocity).max() > 0.02
    dry, still, _ = begun(terrain, wet.replace(rate=0.0), 0)
    assert not dry.any() and not still.any()


# --- which ground ---------------------------------------------------------------------------------


def test_auto_takes_legs_where_one_map_would_be_too_coarse(scene, monkeypatch):
    def auto(cameras=DRIVE, backend="cpu", mask=None, **changes):
        config = CONFIG.replace(ground_map="auto", **changes)
        return follows_path(scene, config, cameras, backend, mask)

    assert not auto() and not auto(spacing=None)
    monkeypatch.setattr(path_ground, "WIDE", 12.5)
    monkeypatch.setattr(path_ground, "MOST_CELLS", 20_000)
    assert auto() and auto(spacing=None)
    assert not auto(cameras=DRIVE[:1]) and not auto(backend="cuda") and not auto(extent=2.0)
    aloft = [replace(view, camera_from_world=_raised(view, 5.0)) for view in DRIVE]
    assert not auto(cameras=aloft)
    assert not auto(level=0.1) and not auto(mask=np.zeros((4, 4), int))
    assert not follows_path(scene, CONFIG.replace(ground_map="whole"), DRIVE)
    photographed = replace(scene, source=Path("street.ply"), cameras=DRIVE)
    assert not follows_path(photographed, CONFIG.replace(ground_map="auto"), DRIVE)


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
