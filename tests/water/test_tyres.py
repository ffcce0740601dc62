"""Tyres on wet roads: water thrown by published relations, its account, its picture."""

import json
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage

from rainsim import pipeline
from rainsim.actors.actor import Actor
from rainsim.actors.actor_files import read_actors
from rainsim.actors.footprint import Footprint, with_footprints
from rainsim.actors.motion import Motion, Track
from rainsim.actors.wheels import wheels_of
from rainsim.config.settings import Config
from rainsim.drops import Weather
from rainsim.errors import InputError, ParameterError
from rainsim.grid import WaterSolver
from rainsim.io.states import AT, NO_THROWS, read_state, write_state
from rainsim.particles.spray import lay_clouds, spray_seen
from rainsim.rain import throws
from rainsim.rain.throws import (
    BOW,
    FILM,
    FLIGHT,
    SIDE,
    TREAD,
    KnownParcels,
    Puffs,
    column,
    cross_section,
    flown,
    landing_age,
    mean_diameter,
    mist_left,
    mist_puffs,
    mist_share,
    on_their_way,
    parcels_of,
    thrown_rates,
)
from rainsim.render.renderer import Renderer
from rainsim.scene.folder import read_scene, write_scene
from rainsim.scene.types import GroundFrame
from rainsim.terrain.types import Grid
from rainsim.water.tracks import REACH, blur_weights, lay_tracks
from rainsim.water.tyres import FASTEST, LEFT, Tyres
from scenes import looking, rolling_scene

CONFIG = Config.from_preset("downpour").replace(past=6e-3, extent=1.0, spacing=0.025)
WHEEL = np.array([[0.0, 0.0, 0.0, 0.2, 0.3]])  # x, y, z, width, radius [m]
BOX = np.array([[0.0, 0.6, 0.7], [4.2, 1.8, 1.4]])
CALM = Weather(Config().replace(rate=0.0, wind=(0.0, 0.0)))


def road(length=8.0, spacing=0.02):
    """A level road along x, 4 m wide, as far as tyres know a terrain."""
    shape = round(4.0 / spacing), round(length / spacing)
    bed = np.zeros(shape, np.float32)
    return SimpleNamespace(
        grid=Grid(shape, (-2.0, -2.0), spacing), bed=bed, top=bed.copy(), footprints=(),
        by_class=lambda name, part=(): np.full(shape, 3e-4, np.float32)[part],
    )  # fmt: skip


def driving(speed, wheels=WHEEL, kind="car", box=BOX, seconds=10.0, scale=1.0):
    """A car without splats that drives along x from x = 0 at time 0 on."""
    time = np.array([0.0, seconds])
    place = np.array([[0.0, 0, 0], [speed * seconds, 0, 0]])
    turn = np.tile([1.0, 0, 0, 0], (2, 1))
    track = Track(time, place, turn, np.ones(2, bool))
    field = np.zeros((1, 1), np.float32)
    motion = Motion(car(kind, wheels, box, track), GroundFrame(np.eye(3), scale, np.zeros(3)))
    return Footprint(motion, np.eye(3), np.zeros(2), 1.0, field, field)


def car(kind, wheels, box=BOX, track=None):
    """An actor without splats."""
    return Actor("a", kind, None, box, track, wheels=wheels)


def rolled(speed, depth, seconds=0.25, wheels=WHEEL, dtype=np.float64, steps=6):
    """Return `Tyres`, solver and ledger after a drive on standing water."""
    terrain = road()
    terrain.footprints = (driving(speed, wheels),)
    solver = WaterSolver(terrain.bed, terrain.grid.spacing, dtype=dtype)
    solver.set_state(depth)
    tyres = Tyres(terrain)
    times = np.linspace(0, seconds, steps + 1)
    for a, b in pairwise(times):
        tyres.roll(solver, a, b, CALM)
    return tyres, solver, times[-1]


# --- the published relations ----------------------------------------------------------------------


def test_the_four_ways_are_those_that_were_published():
    """A lorry's twin tyre of 0.56 m at 100 km/h in 0.7 mm: rates in kg/s worked out by hand."""
    rates = 1000 * thrown_rates(0.7e-3, 0.56, 100 / 3.6)
    np.testing.assert_allclose(rates[[FILM, TREAD]], [1.1667, 2.7222], rtol=1e-3)
    np.testing.assert_allclose(rates[[BOW, SIDE]], 3.5, rtol=1e-3)
    # Densities beside it, 0.0089 kg/m3 in all, are on the tool's scale of 0.005 to 0.03.
    density = mist_share(100 / 3.6, 1.0) / (100 / 3.6)
    assert density @ rates == pytest.approx(0.0090, abs=3e-4)


def test_rates_grow_with_depth_width_and_speed_and_sum_to_what_is_cleared(rng):
    depth, width, speed = rng.uniform((1e-6, 0.1, 1), (0.05, 0.4, 40), (200, 3)).T
    rates = thrown_rates(depth, width, speed)
    np.testing.assert_allclose(rates.sum(axis=-1), depth * width * speed, rtol=1e-12)
    assert (rates >= 0).all()
    np.testing.assert_allclose(thrown_rates(depth, width, 2 * speed), 2 * rates, rtol=1e-12)
    assert thrown_rates(0.0, 0.2, 10.0).sum() == 0
    share = mist_share(30.0, 2.6)
    assert (share > 0).all() and (share <= 0.5).all()
    assert (mist_share(5.0, 2.6)[[BOW, SIDE]] == 0).all()  # waves make no mist at walking pace


def test_drops_are_smaller_the_faster_the_tyre():
    assert mean_diameter(6.0) == pytest.approx(0.8e-3, rel=0.01)
    np.testing.assert_allclose(mean_diameter(12.0) / mean_diameter(24.0), 2.0)
    assert mean_diameter(0.0) <= 1.5e-3


@pytest.mark.parametrize("speed", [3.0, 10.0, 25.0])
@pytest.mark.parametrize("depth", [0.4e-3, 2e-3, 2e-2])
def test_the_mass_thrown_a_second_is_the_published_one(speed, depth):
    seconds = min(0.25, 5.0 / speed)
    tyres, solver, _ = rolled(speed, depth, seconds, steps=max(3, round(24 * seconds)))
    table, _ = tyres.throws()
    expected = thrown_rates(depth - LEFT, 0.2, speed)
    assert tyres.lifted / seconds == pytest.approx(expected.sum(), rel=0.04)  # whole cells
    ways = table[:, AT["bow"] : AT["mist"]].sum(axis=0) / seconds
    kept = 1 - mist_share(speed, BOX[1, 1] * BOX[1, 2])
    np.testing.assert_allclose(ways, expected * kept, rtol=0.04, atol=1e-9)
    total = ways.sum() * seconds + column(table, "mist").sum()
    assert total == pytest.approx(tyres.lifted, rel=1e-12)
    if speed >= 10:  # nothing has come down yet: the track
        assert solver.depth.min() == pytest.approx(LEFT, rel=1e-6)


# --- what throws nothing --------------------------------------------------------------------------


def test_a_dry_road_and_a_still_car_throw_nothing_and_a_wet_one_does():
    for speed, depth in ((10.0, 0.0), (10.0, LEFT), (0.1, 2e-3)):
        tyres, _, _ = rolled(speed, depth)
        assert tyres.lifted == 0 and len(tyres.throws()[0]) == 0
    assert rolled(10.0, 2e-3)[0].lifted > 0


def test_without_cars_nothing_changes(states, calm_states):
    for state in calm_states:
        assert len(state.throws) == 0 and state.tracks.size == 0
    assert len(states[-1].throws) > 0 and states[-1].tracks.min() < 255
    moved = np.abs(states[-1].depth - calm_states[-1].depth)
    assert moved.max() > 1e-3 and (moved > 1e-5).mean() < 0.5


# --- flight ---------------------------------------------------------------------------------------


def thrown(speed=15.0, depth=3e-3):
    table, ids = rolled(speed, depth, 0.25)[0].throws()
    return table, ids, parcels_of(table, ids)


def test_parcels_hold_what_was_thrown_and_leave_as_the_tyre_turns():
    table, _, parcels = thrown()
    for way, name in ((BOW, "bow"), (SIDE, "side"), (TREAD, "tread"), (FILM, "film")):
        mine = parcels.take(parcels.way == way)
        assert mine.volume.sum() == pytest.approx(column(table, name).sum(), rel=1e-12)
    tread = parcels.take(parcels.way >= TREAD)
    # Seen from the car the tyre's surface moves at the car's speed, tangentially.
    own = np.hypot(tread.velocity[:, 0] - 15.0, tread.velocity[:, 2])
    assert own.max() == pytest.approx(15.0, rel=1e-3)  # the car's floor stops the others
    assert (own < 15.0 * 1.001).all() and (tread.velocity[:, 2] > 0).all()
    waves = parcels.take(parcels.way == SIDE)
    outward = waves.velocity[:, 1] * np.repeat([1.0], len(waves.row))
    assert (outward > 0).any() and (outward < 0).any()
    assert np.median(parcels.diameter[parcels.way == FILM]) < np.median(tread.diameter)


def test_parcels_come_down_on_the_road_and_fall_as_drops_do():
    _, _, parcels = thrown()
    age = landing_age(parcels)
    place, velocity = flown(parcels, age)
    assert (age > 0).all() and (age < FLIGHT).all()
    np.testing.assert_allclose(place[:, 2], parcels.road, atol=1e-6)
    assert (velocity[:, 2] < 0).all()
    early = flown(parcels, 0.5 * age)[0]
    assert (early[:, 2] > parcels.road).all()
    step = 1e-6
    ahead = flown(parcels, age + step)[0]
    np.testing.assert_allclose((ahead - place) / step, velocity, atol=1e-3)


def test_mist_settles_and_spreads():
    table, _, _ = thrown(25.0)
    left = [mist_left(table, t).sum() for t in (0.25, 4.25)]
    assert left[1] / left[0] == pytest.approx(np.exp(-1), rel=0.03)
    young, old = mist_puffs(table, 0.25), mist_puffs(table, 4.25)
    assert old.deviation.min() > young.deviation.max() and len(old.section) < len(young.section)
    assert young.section.sum() == pytest.approx(cross_section(left[0], 1e-4), rel=1e-6)
    assert len(mist_puffs(table, -1.0).section) == 0


# --- account, frames ------------------------------------------------------------------------------


@pytest.mark.parametrize(("dtype", "limit"), [(np.float64, 1e-12), (np.float32, 1e-7)])
def test_the_account_of_thrown_water_closes(dtype, limit):
    tyres, solver, now = rolled(12.0, 2e-3, dtype=dtype)
    seen = []
    for _ in range(24):
        ledger = tyres.book(solver.advance(0.05).ledger, now).as_dict()
        assert abs(ledger["residual"]) < limit
        seen.append(ledger["airborne"])
        tyres.roll(solver, now, now + 0.05, CALM)
        now += 0.05
    assert seen[0] > 1e-4 and tyres.returned > 0 and ledger["drained"] == pytest.approx(0, abs=1e-9)


@pytest.fixture(scope="module")
def scene():
    return rolling_scene()


@pytest.fixture(scope="module")
def ground(scene):
    return pipeline.extract_terrain(scene, CONFIG)


@pytest.fixture(scope="module")
def states(ground):
    return [s for s, _ in zip(pipeline.simulate(ground, CONFIG, dtype=np.float64), range(13),
                              strict=False)]  # fmt: skip


@pytest.fixture(scope="module")
def calm_states(ground):
    """The same without spray."""
    config = CONFIG.replace(spray="off")
    return [s for s, _ in zip(pipeline.simulate(ground, config, dtype=np.float64), range(13),
                              strict=False)]  # fmt: skip


def test_the_account_of_a_run_closes(states):
    assert max(abs(s.ledger["residual"]) for s in states) < 1e-9
    assert all(v >= -1e-12 for s in states for v in s.ledger.values())


def test_the_same_frame_alone_and_in_sequence(scene, ground, threads):
    camera = scene.cameras[0].resized(160, 120)
    frames = pipeline.FrameSequence(scene, ground, [camera], CONFIG, layers=("rain_alpha",))
    (_, kept), (picture, report) = (
        (p.copy(), r.aovs["rain_alpha"].copy()) if r.index == 0 else (p.copy(), r)
        for p, r in frames.frames([0, 7])
    )
    threads(1)
    alone = pipeline.FrameSequence(scene, ground, [camera], CONFIG, layers=("rain_alpha",))
    ((again, same),) = alone.frames([7])
    np.testing.assert_array_equal(again, picture)
    np.testing.assert_array_equal(same.aovs["rain_alpha"], report.aovs["rain_alpha"])
    assert (kept != same.aovs["rain_alpha"]).any()


def test_spray_and_tracks_show_and_go_with_the_setting(scene, ground, states):
    camera, shown = scene.cameras[0].resized(160, 120), {}
    for spray in ("auto", "off"):
        state = states[12]
        if spray == "off":
            state = replace(state, throws=NO_THROWS, throw_id=np.zeros(0, np.uint64))
        dry = CONFIG.replace(rate=0.0)  # spray alone: no rain falls
        names = "rain_alpha", "spray_alpha", "rain_depth", "depth"
        _, report = Renderer(scene, ground, dry, camera).draw(camera, state, None, names)
        shown[spray] = alpha = report.aovs["rain_alpha"]
        np.testing.assert_array_equal(report.aovs["spray_alpha"], alpha)
        assert (np.isfinite(report.aovs["rain_depth"]) == (alpha > 0)).all()
        assert (report.aovs["rain_depth"][alpha > 0] <= report.aovs["depth"][alpha > 0]).all()
    assert shown["off"].max() == 0 and shown["auto"].max() > 0.004


def test_states_keep_what_is_in_the_air(states, ground, tmp_path):
    write_state(tmp_path / "s.npz", states[-1])
    again = read_state(tmp_path / "s.npz", ground)
    np.testing.assert_array_equal(again.throws, states[-1].throws)
    np.testing.assert_array_equal(again.tracks, states[-1].tracks)
    wrong = states[-1].throws.copy()
    wrong[0, AT["end"]] = wrong[0, AT["begin"]]
    write_state(tmp_path / "t.npz", replace(states[-1], throws=wrong))
    with pytest.raises(InputError, match="tyres do not roll"):
        read_state(tmp_path / "t.npz")
    write_state(tmp_path / "u.npz", replace(states[-1], tracks=states[-1].tracks[1:]))
    with pytest.raises(InputError, match="tracks"):
        read_state(tmp_path / "u.npz")


def test_parcels_of_known_throws_are_not_computed_again(monkeypatch):
    """Of a table that grows and shrinks, and of another; time goes on, and back."""
    table, ids, _ = thrown()
    known, computed = KnownParcels(), []
    monkeypatch.setattr(
        throws, "parcels_of", lambda *a: (computed.append(len(a[0])), parcels_of(*a))[1]
    )
    parts = (0, 3), (0, 3), (1, 5), (4, 6), (0, 2), (0, 2), (5, 6), (0, 0)
    for (first, end), time in zip(parts, (0.1, 0.12, 0.2, 0.25, 5.0, 0.15, 0.3, 0.4), strict=True):
        part = slice(first, end)
        every = on_their_way(parcels_of(table[part], ids[part]), time)
        over = flown(every, time - every.begin)[0][:, 2] > every.road
        found = known.flying(table[part], ids[part], time)
        over_too = flown(found, time - found.begin)[0][:, 2] > found.road
        for a, b in zip(found.take(over_too), every.take(over), strict=True):
            np.testing.assert_array_equal(a, b)
        assert len(found.row) <= len(every.row) and over.any() == (time < 1 and end > first)
    assert computed == [3, 0, 2, 1, 2, 2, 1, 0]


@pytest.mark.parametrize("shape", [(40, 31), (3, 50), (1, 1)])
def test_tracks_are_the_blurred_shares_of_the_film(shape):
    rng = np.random.default_rng(3)
    depth, passed = rng.uniform(0, 4e-4, shape).astype(np.float32), rng.random(shape) < 0.4
    classes, holds = (
        rng.integers(0, 3, shape).astype(np.uint8),
        np.array([0, 2e-4, 3e-4], np.float32),
    )
    full = np.maximum(holds[classes], np.float32(LEFT))
    share = np.where(passed, np.clip(depth / full, 0, 1), np.float32(1)).astype(np.float32)
    wanted = np.rint(ndimage.gaussian_filter(share, 1.3, truncate=REACH) * 255).astype(np.uint8)
    tracks = np.full(shape, 7, np.uint8)
    lay_tracks(depth, passed, classes, holds, np.float32(LEFT), blur_weights(1.3), tracks)
    np.testing.assert_array_equal(tracks, wanted)
    assert passed.size < 9 or np.ptp(tracks) > 20
    lay_tracks(depth, passed & False, classes, holds, np.float32(LEFT), blur_weights(1.3), tracks)
    assert (tracks == 255).all()


# --- the picture ----------------------------------------------------------------------------------


def behind(distance):
    """A camera that looks along x from `distance` behind x = 2, 0.5 m up."""
    return looking((2 - distance, 0, 0.5), (3 - distance, 0, 0.5), 240, 160, 200.0)


@pytest.mark.parametrize("distance", [3.0, 6.0, 30.0])
def test_drops_and_clouds_are_the_same_water_from_anywhere(distance):
    table, ids, parcels = thrown()
    now = 0.25
    lines, puffs = spray_seen(table, ids, behind(distance), now, 0.004)
    flies = (parcels.begin <= now) & (
        flown(parcels, now - parcels.begin)[0][:, 2] > parcels.road)  # fmt: skip
    whole = cross_section(parcels.volume, parcels.diameter)[flies].sum()
    whole += mist_puffs(table, now).section.sum()
    found = np.pi / 4 * (lines[:, 6] ** 2).sum() + puffs.section.sum()
    assert found == pytest.approx(whole, rel=0.12)  # a scattered drop may be in the road
    assert (len(lines) > 100) == (distance < 10)


def test_a_cloud_replaces_the_light_of_its_cross_section_and_hides_behind_things():
    puff = Puffs(np.array([[2.0, 0.1, 0.6]]), np.array([0.15]), np.array([0.02]))
    camera = behind(5.0)
    shape = camera.height, camera.width
    sums = {}
    for name, depth in (("open", np.inf), ("half", 5.0), ("before", 4.0)):
        alpha = np.zeros(shape, np.float32)
        lay_clouds(puff, camera, np.full(shape, depth, np.float32), alpha)
        sums[name] = -np.log1p(-alpha.astype(float)).sum()
    assert sums["open"] == pytest.approx(0.02 * (camera.fx / 5) ** 2, rel=0.03)
    # The nearer half looks larger, by two of its mean distances from the middle (0.8 deviations).
    nearer = 1 + 2 * 0.798 * 0.15 / 5
    assert sums["half"] == pytest.approx(0.5 * nearer * sums["open"], rel=0.01)
    assert sums["before"] < 0.01 * sums["open"]
    rain = np.full(shape, 0.3, np.float32)
    lay_clouds(puff, camera, np.full(shape, np.inf, np.float32), rain)
    assert rain.min() == pytest.approx(0.3, abs=1e-5) and rain.max() < 1  # one behind the other


# --- wheels ---------------------------------------------------------------------------------------


def test_wheels_of_a_box_and_of_a_description():
    wheels = wheels_of(car("Car", None), 1.0)
    assert wheels.shape == (4, 5)
    np.testing.assert_allclose(wheels[:, 0].max() - wheels[:, 0].min(), 0.6 * 4.2)
    np.testing.assert_allclose(np.unique(wheels[:, 2]), 0.0, atol=1e-12)
    assert 0.15 < wheels[0, 3] < 0.25 and 0.25 < wheels[0, 4] < 0.35
    np.testing.assert_allclose(wheels_of(car("x", WHEEL), 2.0), 2 * WHEEL)
    for kind in ("pedestrian", "object"):
        assert len(wheels_of(car(kind, None), 1.0)) == 0
    assert len(wheels_of(car("car", WHEEL[:0]), 1.0)) == 0


@pytest.mark.parametrize("scale", [0.01, 10.0])
def test_boxes_that_are_no_car(scale):
    terrain = road()
    terrain.footprints = (driving(10.0, None, scale=scale),)
    with pytest.raises(ParameterError, match="road vehicle"):
        Tyres(terrain)


def test_a_track_that_no_car_drives():
    terrain = road()
    terrain.footprints = (driving(1.01 * FASTEST),)
    with pytest.raises(ParameterError, match="moves at 101 m/s"):
        Tyres(terrain)
    terrain.footprints = (driving(0.99 * FASTEST),)
    Tyres(terrain)


def test_wheels_in_files(scene, tmp_path):
    from made_actors import described

    wheel = {"at": [1, 2, 0], "width": 0.2, "radius": 0.3}
    (actor,) = read_actors(described(tmp_path, scene, wheels=[wheel, wheel])).actors
    np.testing.assert_array_equal(actor.wheels, np.tile([1, 2, 0, 0.2, 0.3], (2, 1)))
    (none,) = read_actors(described(tmp_path, scene, wheels=[])).actors
    assert none.wheels.shape == (0, 5)
    (auto,) = read_actors(described(tmp_path, scene)).actors
    assert auto.wheels is None
    actors = [replace(a, id=str(k)) for k, a in enumerate((actor, none, auto))]
    write_scene(tmp_path / "kept", replace(scene, actors=tuple(actors)))
    kept = [a.wheels for a in read_scene(tmp_path / "kept").actors]
    assert kept[0].shape == (2, 5) and kept[1].shape == (0, 5) and kept[2] is None
    for wrong in (3, [3], [{"at": [0, 0, 0], "width": 0, "radius": 1}],
                  [wheel | {"radius": -1}], [wheel | {"width": 9}], [wheel] * 65,
                  [wheel | {"at": [0, 0]}]):  # fmt: skip
        with pytest.raises(InputError, match="wheels is"):
            read_actors(described(tmp_path, scene, wheels=wrong))
    assert json.loads((tmp_path / "actors.json").read_text())["nodes"][0]["wheels"]


def test_actors_know_their_wheels(scene, ground):
    (footprint,) = with_footprints(replace(ground, footprints=()), scene).footprints
    motion = footprint.motion
    low = motion.pose(0.0).places(motion.wheels[:, :3])[:, 2]
    np.testing.assert_allclose(low, 0.002, atol=1e-6)  # they stand where the box does
