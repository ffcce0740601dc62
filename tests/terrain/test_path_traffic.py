"""Cars over legs of a drive: shadows, tracks, spray and labels, alone and in sequence."""

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
from rainsim.lod.cut import cut
from rainsim.rain.exposure import rain_exposure
from rainsim.raster import prepare
from rainsim.scene.big import open_pages
from rainsim.terrain.path_ground import path_ground

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


# --- frames ---------------------------------------------------------------------------------------


def test_a_frame_with_traffic_by_itself_has_the_bytes_of_the_drive(scene, ground, drive, threads):
    switches = [leg.first for leg in ground.legs]
    assert len(switches) > 2
    for index in (switches[1], LAST):
        picture, numbers, *_ = shots(scene, ground, [index])[index]
        assert picture == drive[index][0] and (numbers == drive[index][1]).all(), index
    threads(1)
    assert shots(scene, ground, [LAST])[LAST][0] == drive[LAST][0]
    assert len({picture for picture, *_ in drive.values()}) == CONFIG.frames


def test_the_car_is_labelled_in_every_leg(drive):
    seen = [(numbers == 1).mean() for _, numbers, _, _ in drive.values()]
    assert min(seen) > 0.01 and all(set(np.unique(n)) <= {0, 1} for _, n, _, _ in drive.values())


def test_the_car_changes_the_picture_by_more_than_itself(scene, ground, drive):
    """Its spray, tracks and mirror image show; without spray the tracks and the drops are gone."""
    plain = shots(scene, ground, [LAST], CONFIG.replace(spray="off"))[LAST]
    assert plain[0] != drive[LAST][0]


def test_the_account_of_each_frame_closes(drive):
    assert all(abs(report.ledger["residual"]) < 1e-6 for _, _, report, _ in drive.values())


def test_chunks_with_traffic_follow_the_path(scene, tmp_path):
    pytest.importorskip("gsply")
    pytest.importorskip("imagecodecs")
    cut(tmp_path, lambda: iter([scene.splats]), leaf=2000)
    pages, splats, digest, _ = open_pages(tmp_path)
    static = replace(scene, splats=splats, pages=pages, source_hash=digest, actors=())
    chunks = with_actors(static, [car()])
    ground = path_ground(chunks, CONFIG, DRIVE)[0]
    two = ground.legs[1].first
    every = shots(chunks, ground, [two - 1, two, two + 1])
    alone = shots(chunks, ground, [two + 1])
    assert alone[two + 1][0] == every[two + 1][0]
    assert (every[two + 1][1] == 1).mean() > 0.01


# --- water ----------------------------------------------------------------------------------------


def test_no_rain_falls_under_the_car_in_a_leg(scene, ground):
    leg = ground.legs[1]
    start, terrain = leg.start(CONFIG), ground.terrain(scene, leg)
    heavy = CONFIG.replace(rate=mm_per_hour(200.0))
    rain = []
    for there in (terrain, replace(terrain, footprints=())):
        run = simulation.simulate(there, heavy, first=start)
        *_, last = (state for _, state in zip(range(leg.end - start), run, strict=False))
        rain.append(last.ledger["rain"])
    kept_off = (rain[1] - rain[0]) / (heavy.rain.rate * (leg.end - start - 1) / CONFIG.fps)
    assert 0.5 < kept_off / (SIZE[0] * SIZE[1]) < 1.6


def test_a_parked_car_keeps_its_ground_dry_in_a_leg(scene):
    x = DRIVE[LAST].position[0] + 1.5
    parked = with_actors(road(DRIVE), [car(first=x, parked=True)])
    ground = path_ground(parked, CONFIG, DRIVE)[0]
    terrain = ground.terrain(parked, ground.leg(LAST))
    row, column, _ = terrain.grid.cells(np.array([x, x]), np.array([0.0, 1.2]))
    reach = rain_exposure(terrain, (0.0, 0.0))[row, column]
    assert reach[0] == 0 and reach[1] > 0.9
    assert len(prepare(parked.splats)) and shots(parked, ground, [LAST])
