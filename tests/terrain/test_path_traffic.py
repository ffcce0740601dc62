"""Cars over windows of the ground: shadows, tracks, spray and labels, alone and in sequence."""

from dataclasses import replace

import numpy as np
import pytest

import factories
from made_road import CONFIG as ROAD
from made_road import DRIVE, camera, road, small  # noqa: F401
from rainsim import pipeline, simulation
from rainsim.actors.actor import Actor, with_actors
from rainsim.actors.motion import Track
from rainsim.config.settings import mm_per_hour
from rainsim.drops import GROUND
from rainsim.io.states import AT
from rainsim.lod.cut import cut
from rainsim.rain.throws import column
from rainsim.raster import prepare
from rainsim.scene.big import open_pages
from rainsim.simulation import steady_water
from rainsim.terrain.path_ground import follows_path, part_of, path_ground
from rainsim.water import window_tyres
from rainsim.water.window_tyres import tyres_of

SIZE = np.array([0.9, 0.6, 0.5])  # m, of the car
AXLES, WHEEL, TYRE = 0.3, 0.22, (0.1, 0.1)  # m: places of the wheels; width and radius
FIRST, SPEED = 3.6, 6.0  # m, m/s: it drives ahead of the camera, as fast
CONFIG = ROAD.replace(frames=16, past=6e-3)
LAST = CONFIG.frames - 1


def car(name="car", first=FIRST, speed=SPEED, aside=0.0, parked=False):
    """A box of splats on four wheels, along x."""
    axes = [np.arange(-s / 2, s / 2 + 1e-6, 0.04) for s in SIZE]
    places = np.stack(np.meshgrid(*axes), -1).reshape(-1, 3)
    places = places[(np.abs(places) > SIZE / 2 - 0.05).any(axis=1)] + (0, 0, SIZE[2] / 2)
    sh = np.tile([[1.5, -1.0, -1.0]], (len(places), 1, 1))
    splats = factories.splats(places, scale=0.025, sh=sh)
    time = np.array([0.0, 8.0])
    place = np.array([[first, aside, 0], [first + (0 if parked else speed * 8), aside, 0]])
    track = Track(time, place, np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    box = np.array([[0, 0, SIZE[2] / 2], SIZE])
    wheels = np.array([(x, y, 0, *TYRE) for x in (AXLES, -AXLES) for y in (WHEEL, -WHEEL)])
    return Actor(name, "car", splats, box, track, wheels=wheels)


@pytest.fixture(scope="module")
def scene():
    return with_actors(road(DRIVE), [car()])


@pytest.fixture(scope="module")
def ground(scene):
    return path_ground(scene, CONFIG, DRIVE)[0]


def shots(scene, ground, indices, config=CONFIG):
    """Bytes and actor numbers of frames by a new sequence, and what says more, by their indices."""
    sequence = pipeline.FrameSequence(scene, ground, DRIVE, config, layers=("actor_id",))
    return {r.index: (p.tobytes(), r.aovs["actor_id"].copy(), r, sequence._state)
            for p, r in sequence.frames(indices)}  # fmt: skip


@pytest.fixture(scope="module")
def drive(scene, ground):
    return shots(scene, ground, range(CONFIG.frames))


def begun(scene, ground, station, config=CONFIG):
    """What `simulate` takes of a station."""
    around = ground.around(scene, station)
    begin = steady_water(around, config, station.start(config))
    return around, part_of(around, station.window), begin.within(station.window, around)


# --- frames ---------------------------------------------------------------------------------------


def test_a_frame_with_traffic_by_itself_has_the_bytes_of_the_drive(scene, ground, drive, threads):
    switches = [station.first for station in ground.stations]
    assert len(switches) > 2
    for index in (switches[1], LAST):
        picture, numbers, *_ = shots(scene, ground, [index])[index]
        assert picture == drive[index][0] and (numbers == drive[index][1]).all(), index
    threads(1)
    assert shots(scene, ground, [LAST])[LAST][0] == drive[LAST][0]
    assert len({picture for picture, *_ in drive.values()}) == CONFIG.frames


def test_the_car_is_labelled_in_every_window(drive):
    seen = [(numbers == 1).mean() for _, numbers, _, _ in drive.values()]
    assert min(seen) > 0.01 and all(set(np.unique(n)) <= {0, 1} for _, n, _, _ in drive.values())


def test_the_car_changes_the_picture_by_more_than_itself(scene, ground, drive):
    """Its spray, tracks and mirror image show; without spray the tracks and the drops are gone."""
    plain = shots(scene, ground, [LAST], CONFIG.replace(spray="off"))[LAST]
    assert plain[0] != drive[LAST][0]
    assert not len(plain[3].throws) and not plain[3].tracks.size
    throws, tracks = drive[LAST][3].throws, drive[LAST][3].tracks
    assert len(throws) and tracks.min() < 128 and tracks.max() == 255


def test_the_account_of_each_frame_closes(drive):
    assert all(abs(report.ledger["residual"]) < 1e-6 for _, _, report, _ in drive.values())


def test_auto_takes_windows_with_traffic(scene, monkeypatch):
    config = CONFIG.replace(ground_map="auto")
    assert not follows_path(scene, config, DRIVE)
    monkeypatch.setattr("rainsim.terrain.path_ground.MOST_CELLS", 20_000)
    assert follows_path(scene, config, DRIVE)


def test_chunks_with_traffic_follow_the_path(scene, tmp_path):
    pytest.importorskip("gsply")
    pytest.importorskip("imagecodecs")
    cut(tmp_path, lambda: iter([scene.splats]), leaf=2000)
    pages, splats, digest, _ = open_pages(tmp_path)
    static = replace(scene, splats=splats, pages=pages, source_hash=digest, actors=())
    chunks = with_actors(static, [car()])
    ground = path_ground(chunks, CONFIG, DRIVE)[0]
    two = ground.stations[1].first
    every = shots(chunks, ground, [two - 1, two, two + 1])
    alone = shots(chunks, ground, [two + 1])
    assert alone[two + 1][0] == every[two + 1][0]
    assert (every[two + 1][1] == 1).mean() > 0.01 and len(every[two + 1][3].throws)


# --- water ----------------------------------------------------------------------------------------


def test_no_drop_lands_under_the_car_in_a_window(scene, ground):
    station = ground.stations[1]
    _, part, begin = begun(scene, ground, station)
    run = simulation.simulate(part, CONFIG.replace(rate=mm_per_hour(200.0)), begin=begin)
    under = beside = 0
    for _, state in zip(range(station.end - begin.number), run, strict=False):
        middle = state.time - 0.5 / CONFIG.fps
        away = np.abs(state.impact_position[:, :2] - (FIRST + SPEED * middle, 0.0))
        landed = state.impact_kind == GROUND
        under += (landed & (away < SIZE[:2] / 2 - 0.05).all(axis=1)).sum()
        beside += (landed & (away < SIZE[:2] / 2 + 0.3).all(axis=1)).sum()
    assert under == 0 and beside > 5


@pytest.mark.slow
def test_the_account_of_a_window_closes_with_cars_in_it_and_around_it(scene, ground):
    station = ground.stations[1]
    west, east = (c * CONFIG.terrain.spacing for c in station.cells[2:])
    start = station.start(CONFIG) / CONFIG.fps
    comes = car("comes", west - 0.8 - SPEED * start)  # rolls over the window's rim
    traffic = with_actors(road(DRIVE), [comes, car("ahead", east + 0.6 - SPEED * start, aside=0.6)])
    wide = path_ground(traffic, CONFIG, DRIVE)[0]
    around, part, begin = begun(traffic, wide, station)
    assert begin.around.depth.shape == around.grid.shape > part.grid.shape
    run = simulation.simulate(part, CONFIG, dtype=np.float64, begin=begin)
    ledgers, last = [], None
    for _ in range(10):
        last = next(run)
        ledgers.append(last.ledger)
    assert max(abs(ledger["residual"]) for ledger in ledgers) < 1e-9
    assert all(v >= -1e-12 for ledger in ledgers for k, v in ledger.items() if k != "residual")
    assert ledgers[-1]["airborne"] > 0 and last.tracks.shape == around.grid.shape
    columns = station.window[1]
    beyond = last.tracks[:, columns.stop + 4 :]
    assert last.tracks[station.window].min() < 200 > beyond.min()


def test_tracks_and_spray_go_on_from_window_to_window(scene, ground, monkeypatch):
    first, second = ground.stations[1:3]

    def at_the_switch(station):
        _, part, begin = begun(scene, ground, station)
        for state in simulation.simulate(part, CONFIG, begin=begin):
            if state.index == second.first:
                return state, station

    def seen_in(found):
        state, station = found
        y = round(WHEEL / CONFIG.terrain.spacing) - station.around[0]
        x = round((DRIVE[second.first].position[0] + 0.5) / CONFIG.terrain.spacing)
        there = column(state.throws, "x") > second.around[2] * CONFIG.terrain.spacing
        volume = state.throws[there, AT["bow"] :].sum(axis=1)
        thrown = dict(zip(state.throw_id[there].tolist(), volume, strict=True))
        return thrown, int(state.tracks[y, x - station.around[2]])

    (old, before), (new, after) = (seen_in(at_the_switch(s)) for s in (first, second))

    def shared(some, other):
        return sum(some[k] for k in some.keys() & other.keys()) / sum(some.values())

    # What spray has brought back under the rear tyres is thrown once more in the older one alone.
    assert len(old) > 20 and shared(old, new) > 0.7 and shared(new, old) > 0.9
    assert sum(new.values()) == pytest.approx(sum(old.values()), rel=0.35)
    assert before < 200 and abs(before - after) < 40
    monkeypatch.setattr(window_tyres, "REMEMBERED", 0.0)  # cars that come from nowhere
    assert shared(old, seen_in(at_the_switch(second))[0]) < 0.5


def test_film_comes_back_behind_a_car_and_pools_close(scene, ground):
    station = ground.stations[2]
    around, part, begin = begun(scene, ground, station)
    tyres = tyres_of(part, CONFIG, begin)
    weather = simulation.Weather(CONFIG)
    come = tyres.come(begin.depth, weather, begin.number)
    passed = tyres._passed[station.window]
    film = around.by_class("storage", station.window)
    shallow, deep = passed & (begin.depth <= film + 1e-4), passed & (begin.depth > film + 5e-3)
    assert shallow.sum() > 8 and (come[shallow] < 0.8 * begin.depth[shallow]).any()
    assert (come <= begin.depth).all() and (come[~passed] == begin.depth[~passed]).all()
    later = tyres._refilled(*np.nonzero(tyres._passed), begin.number / CONFIG.fps + 600.0)
    np.testing.assert_allclose(later, begin.around.depth[tyres._passed], rtol=1e-5)
    assert deep.any() and (come[deep] < 0.5 * begin.depth[deep]).any()
    pool = np.argwhere(deep) + [part.start for part in station.window]
    soon = tyres._refilled(*pool.T, begin.number / CONFIG.fps + 2.0)
    assert (soon > 0.9 * begin.depth[deep]).all()


def test_a_parked_car_keeps_its_ground_dry_in_a_window(scene):
    x = DRIVE[LAST].position[0] + 1.5
    parked = with_actors(road(DRIVE), [car(first=x, parked=True)])
    ground = path_ground(parked, CONFIG, DRIVE)[0]
    station = ground.station(LAST)
    around, _, begin = begun(parked, ground, station)
    row, column, _ = around.grid.cells(np.array([x, x]), np.array([0.0, 1.2]))
    assert begin.around is None and steady_water(around, CONFIG, 9).exposure[row, column][0] == 0
    assert steady_water(around, CONFIG, 9).exposure[row, column][1] > 0.9
    assert len(prepare(parked.splats)) and shots(parked, ground, [LAST])
