"""Tyres on wet roads: water thrown by published relations, tracks, and their picture."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rainsim import pipeline
from rainsim.actors.actor import Actor
from rainsim.actors.actor_files import read_actors
from rainsim.actors.footprint import Footprint, with_footprints
from rainsim.actors.motion import BEFORE, Motion, Track
from rainsim.actors.wheels import wheels_of
from rainsim.config.settings import Config
from rainsim.drops import Weather
from rainsim.errors import InputError, ParameterError
from rainsim.particles.spray import lay_clouds, spray_seen
from rainsim.rain import throws
from rainsim.rain.tyres import FASTEST, LEFT, TICK, cars_of, rolled
from rainsim.render.renderer import Renderer
from rainsim.scene.folder import read_scene, write_scene
from rainsim.scene.types import GroundFrame
from rainsim.terrain.types import Grid
from rainsim.water.tracks import DEEP, FULL, KEPT, tracks_of
from scenes import looking, rolling_scene

CONFIG = Config.from_preset("downpour").replace(past=6e-3, extent=1.0, spacing=0.025)
WHEEL = np.array([[0.0, 0.0, 0.0, 0.2, 0.3]])  # x, y, z, width, radius [m]
BOX = np.array([[0.0, 0.6, 0.7], [4.2, 1.8, 1.4]])
CALM = Config().replace(rate=0.0, wind=(0.0, 0.0))
FOUR_WAYS = BOW, SIDE, TREAD, FILM = range(4)


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


def drive(speed, depth, time=0.25, wheels=WHEEL, film=0.0):
    """Return the ways of a car's tyres over water of one depth [m], and the terrain."""
    terrain = road()
    terrain.footprints = (driving(speed, wheels),)
    water, share = (np.full(terrain.grid.shape, value, np.float32) for value in (depth, film))
    cars = cars_of(terrain.footprints, CALM.render)
    return rolled(cars, terrain, water, share, time, Weather(CALM), CALM.rain), terrain


# --- the published relations ----------------------------------------------------------------------


def test_the_four_ways_are_those_that_were_published():
    """A lorry's twin tyre of 0.56 m at 100 km/h in 0.7 mm: rates in kg/s worked out by hand."""
    rates = 1000 * throws.thrown_rates(0.7e-3, 0.56, 100 / 3.6)
    np.testing.assert_allclose(rates[[FILM, TREAD]], [1.1667, 2.7222], rtol=1e-3)
    np.testing.assert_allclose(rates[[BOW, SIDE]], 3.5, rtol=1e-3)
    # Densities beside it, 0.0089 kg/m3 in all, are on the tool's scale of 0.005 to 0.03.
    density = throws.mist_share(100 / 3.6, 1.0) / (100 / 3.6)
    assert density @ rates == pytest.approx(0.0090, abs=3e-4)


@pytest.mark.parametrize("speed", [3.0, 10.0, 25.0])
@pytest.mark.parametrize("depth", [0.4e-3, 2e-3, 2e-2])
def test_the_mass_thrown_a_second_is_the_published_one(speed, depth):
    rolls, _ = drive(speed, depth)
    rolls = rolls.take((rolls.begin[:, 0] > -2) & (rolls.end[:, 0] < 6))  # whole ones
    drops, mist = throws.thrown_by(rolls)
    expected = throws.thrown_rates(depth - LEFT, 0.2, speed)
    dry = 1 - throws.mist_share(speed, BOX[1, 1] * BOX[1, 2])
    bow, side, tread, film = expected * dry
    wanted = [bow + side, tread, film]
    np.testing.assert_allclose(drops / TICK, np.tile(wanted, (len(rolls.tick), 1)), rtol=1e-5)
    total = drops.sum(axis=1) + mist
    np.testing.assert_allclose(total / TICK, expected.sum(), rtol=1e-5)


# --- where tyres roll -----------------------------------------------------------------------------


def test_ways_of_a_tyre_follow_each_other_to_the_present():
    rolls, _ = drive(10.0, 2e-3, 0.26)
    np.testing.assert_allclose(rolls.begin[1:], rolls.end[:-1], atol=1e-12)
    assert rolls.begin[-1, 0] <= 2.6 < rolls.end[-1, 0]
    np.testing.assert_allclose(rolls.speed, 10.0, rtol=1e-9)
    # It came as it goes on, but the road begins at -2 m.
    assert rolls.begin[0, 0] < -1.5 and BEFORE * 10.0 > 2
    np.testing.assert_allclose(np.abs(rolls.out), np.tile([0.0, 1.0], (len(rolls.tick), 1)))
    assert (rolls.out[:, 1] < 0).all()  # the car's middle is to the left of its wheel
    assert len(set(rolls.id.tolist())) == len(rolls.id)


def test_a_still_car_and_one_off_the_road_do_not_roll_and_a_dry_road_throws_nothing():
    assert len(drive(0.1, 2e-3)[0].tick) == 0
    assert len(drive(10.0, 2e-3, wheels=WHEEL + np.array([0, 0, 0.5, 0, 0]))[0].tick) == 0
    for depth in (0.0, LEFT):
        assert drive(10.0, depth)[0].water.max() == 0
    assert drive(10.0, 2e-3)[0].water[1:].min() == pytest.approx(2e-3 - LEFT, rel=1e-5)
    half = drive(10.0, 0.0, film=0.5)[0]  # of 0.3 mm
    assert half.water.max() == pytest.approx(1.5e-4 - LEFT, rel=1e-5)


def test_tyres_behind_others_find_less_water():
    both, _ = drive(10.0, 2e-3, wheels=np.concatenate([WHEEL, WHEEL - np.array([2.5, 0, 0, 0, 0])]))
    assert 0 < both.water[~both.covered].max() < 0.5 * both.water[both.covered].min()


# --- flight ---------------------------------------------------------------------------------------


def test_parcels_hold_what_was_thrown_and_fly_on():
    rolls, _ = drive(15.0, 3e-3)
    parcels = throws.flying(rolls, 0.25)
    assert (parcels.place[:, 2] > parcels.road).all() and len(parcels.id) > 100
    volume = np.pi / 6 * parcels.number * parcels.diameter**3
    assert 0 < volume.sum() < throws.thrown_by(rolls)[0].sum()
    step = 1e-4
    later = throws.flying(rolls, 0.25 + step)
    _, old, new = np.intersect1d(parcels.id, later.id, return_indices=True)
    assert len(old) > 0.95 * len(parcels.id)
    moved = (later.place[new] - parcels.place[old]) / step
    np.testing.assert_allclose(moved, parcels.velocity[old], atol=0.2)
    assert len(throws.flying(rolls, 0.25 + throws.FLIGHT + 1.0).id) == 0
    assert (parcels.velocity[:, 2] < 0).any() and (parcels.velocity[:, 2] > 0).any()


def test_mist_settles_and_spreads():
    rolls, _ = drive(25.0, 3e-3)
    rolls = rolls.take(rolls.tick * TICK < 0.2)
    young, old = throws.mist_puffs(rolls, 0.25), throws.mist_puffs(rolls, 0.25 + throws.MIST_LIFE)
    assert old.section.sum() / young.section.sum() == pytest.approx(np.exp(-1), rel=0.01)
    assert old.deviation.min() > young.deviation.max() and len(old.section) < len(young.section)
    assert len(throws.mist_puffs(rolls, -2.0).section) == 0


# --- tracks ---------------------------------------------------------------------------------------


def test_tracks_are_as_wide_as_the_tyre_and_end_at_it_and_fade():
    rolls, terrain = drive(2.0, 2e-4, 1.0)
    water = np.full(terrain.grid.shape, 2e-4, np.float32)
    tracks = tracks_of(rolls, terrain, water, 1.0, 0.0)
    row = terrain.grid.shape[0] // 2
    reached = np.flatnonzero(tracks[row] < FULL)
    assert -2 + 0.02 * (reached[-1] + 1) == pytest.approx(2.0, abs=0.03)  # where the tyre is
    assert (np.diff(tracks[row, reached].astype(int)) <= 0).all()  # older ones are fuller
    assert tracks[row, reached[-1]] == pytest.approx(KEPT * FULL, abs=2)
    assert (tracks[:, reached[-5]] < FULL).sum() == pytest.approx(0.2 / 0.02, abs=2)
    later = tracks_of(rolls, terrain, water, 5.0, 0.0)
    assert (later[row, reached] >= tracks[row, reached]).all() and later.min() > tracks.min()
    assert tracks_of(rolls, terrain, water, 60.0, 0.0).size == 0
    filled = tracks_of(rolls, terrain, water, 5.0, 1e-4)  # the rain fills them in 2 s
    assert filled.size == 0 or (filled >= later).all()
    water[:, : reached[-1] - 20] = 2 * DEEP
    closed = tracks_of(rolls, terrain, water, 1.0, 0.0)
    assert (closed[row, : reached[-1] - 20] == FULL).all() and closed.min() == tracks.min()


# --- frames ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene():
    return rolling_scene()


@pytest.fixture(scope="module")
def ground(scene):
    return pipeline.extract_terrain(scene, CONFIG)


def test_spray_and_tracks_show_and_go_with_the_setting(scene, ground):
    camera, shown, maps = scene.cameras[0].resized(160, 120), {}, {}
    state = next(pipeline.simulate(ground, CONFIG)).shown_at(0.5)
    for spray in ("auto", "off"):
        dry = CONFIG.replace(rate=0.0, spray=spray)  # spray alone: no rain falls
        names = "rain_alpha", "spray_alpha", "rain_depth", "depth"
        renderer = Renderer(scene, ground, dry, camera)
        _, report = renderer.draw(camera, state, None, names)
        shown[spray] = alpha = report.aovs["rain_alpha"]
        maps[spray] = renderer.conductor.wet_scene.ground.map
        np.testing.assert_array_equal(report.aovs["spray_alpha"], alpha)
        assert (np.isfinite(report.aovs["rain_depth"]) == (alpha > 0)).all()
        assert (report.aovs["rain_depth"][alpha > 0] <= report.aovs["depth"][alpha > 0]).all()
    assert shown["off"].max() == 0 and shown["auto"].max() > 0.004
    assert (maps["auto"] <= maps["off"]).all() and (maps["auto"] < maps["off"]).any()


# --- the picture ----------------------------------------------------------------------------------


def behind(distance):
    """A camera that looks along x from `distance` behind x = 2, 0.5 m up."""
    return looking((2 - distance, 0, 0.5), (3 - distance, 0, 0.5), 240, 160, 200.0)


@pytest.mark.parametrize("distance", [3.0, 6.0, 30.0])
def test_drops_and_clouds_are_the_same_water_from_anywhere(distance):
    now, (rolls, _) = 0.25, drive(15.0, 3e-3)
    lines, puffs = spray_seen(rolls, behind(distance), now, 0.004)
    parcels = throws.flying(rolls, now)
    whole = np.pi / 4 * (parcels.number * parcels.diameter**2).sum()
    whole += throws.mist_puffs(rolls, now).section.sum()
    found = np.pi / 4 * (lines[:, 6] ** 2).sum() + puffs.section.sum()
    assert found == pytest.approx(whole, rel=0.12)  # a scattered drop may be in the road
    assert (len(lines) > 100) == (distance < 10)


def test_a_cloud_replaces_the_light_of_its_cross_section_and_hides_behind_things():
    puff = throws.Puffs(np.array([[2.0, 0.1, 0.6]]), np.array([0.15]), np.array([0.02]))
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
        cars_of(terrain.footprints, CALM.render)


def test_a_track_that_no_car_drives():
    terrain = road()
    terrain.footprints = (driving(1.01 * FASTEST),)
    with pytest.raises(ParameterError, match="moves at 101 m/s"):
        cars_of(terrain.footprints, CALM.render)
    terrain.footprints = (driving(0.99 * FASTEST),)
    assert len(cars_of(terrain.footprints, CALM.render)) == 1


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
