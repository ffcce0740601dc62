"""A lidar in the rain: beams, drops in them, LISA's statistics, water that mirrors, files."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import factories
from rainsim import pipeline
from rainsim.actors.actor import scene_at
from rainsim.config.settings import Config
from rainsim.datasets.sample import View
from rainsim.datasets.shots import Shots
from rainsim.drops import Drops, RainField, RainSpectrum, flat_surfaces
from rainsim.errors import ParameterError
from rainsim.scene.types import GroundFrame, Scene
from rainsim.scene.view import pixel_rays
from rainsim.sensors import lidar as lidar_module
from rainsim.sensors import point_files
from rainsim.sensors.lidar import LidarScanner, Pose, Surface, drops_in_beams, pose_at
from rainsim.sensors.lidar_model import (
    KEPT,
    LOST,
    MIRRORED,
    SCATTERED,
    SENSORS,
    Lidar,
    echo_power,
    extinction_of,
    fresnel_of,
)
from rainsim.sensors.lisa import scattered_share
from rainsim.sensors.near_drops import near_drops
from rainsim.terrain.types import Grid
from scenes import BOX_SIZE, BOX_WAY, bed_height, looking, moving_scene, tiny_scene

OPEN_AIR = flat_surfaces(1.0, 1.0, 1.0, origin=(1e9, 1e9))
STILL = Pose(np.zeros(3), np.eye(3), np.zeros(3))
LEVEL = tuple(np.radians([-3.0, -1.0, 1.0, 3.0]))


class Room(LidarScanner):
    """A scanner in a world whose surfaces are known: a sphere around the sensor."""

    def __init__(self, distance, reflectivity):
        self.distance, self.reflectivity = distance, reflectivity

    def surfaces_at(self, time):
        return OPEN_AIR

    def trace(self, origin, direction, before=0.0, time=0.0):
        n = len(direction)
        return Surface(np.full(n, self.distance), origin + self.distance * direction, -direction,
                       np.full(n, self.reflectivity))  # fmt: skip


# --- beams ----------------------------------------------------------------------------------------


def test_beams_cover_the_turn():
    lidar = Lidar(LEVEL, columns=360, rate=5.0)
    direction, when = lidar.beams()
    assert direction.shape == (1440, 3)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1)
    np.testing.assert_allclose(np.degrees(np.arcsin(direction[:4, 2])), [-3, -1, 1, 3])
    assert (np.diff(when) >= 0).all() and 0 < when[0] < when[-1] < 0.2
    ahead = direction[len(direction) // 2]
    assert ahead[0] > 0.99 and direction[360 * 4 // 4, 1] > 0.9  # from behind by the left
    assert {"vlp16", "hdl32", "hdl64"} == set(SENSORS)


@pytest.mark.parametrize("wrong, message", [
    ({"far": 0.0}, "lidar far is 0.0"), ({"elevation": ()}, "elevations"),
    ({"near": 200.0}, "near must be less"), ({"elevation": (2.0,)}, "less than 90 degrees"),
])  # fmt: skip
def test_wrong_sensors_are_named(wrong, message):
    with pytest.raises(ParameterError, match=message):
        Lidar(**{"elevation": LEVEL, **wrong})


def test_drops_echo_up_to_their_reach():
    lidar = SENSORS["vlp16"]
    for diameter in (0.7e-3, 2e-3, 5e-3):
        reach = float(lidar.drop_reach(diameter))
        share = min((diameter / (math.tan(3e-3) * reach)) ** 2, 1) * (0.328 / 2.328) ** 2
        assert echo_power(share, reach, 0.0) == pytest.approx(lidar.least_power, rel=1e-6)


def test_drops_are_found_as_one_by_one(rng):
    """Each drop against each beam, at the beam's own time, with a moving and turned sensor."""
    lidar = Lidar(LEVEL, columns=90, rate=10.0, divergence=0.05)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    pose = Pose(np.array([1.0, 2.0, 3.0]), turn, np.array([3.0, -1.0, 0.0]))
    n = 4000
    drops = Drops(pose.position + rng.normal(0, 0.8, (n, 3)), rng.normal(0, 2, (n, 3)),
                  rng.uniform(1e-3, 5e-3, n), np.arange(n, dtype=np.uint64))  # fmt: skip
    local, when = lidar.beams()
    beam, place, diameter = drops_in_beams(lidar, pose, drops, local, when)
    expected = set()
    for b in range(len(local)):
        at = drops.position + drops.velocity * (when[b] - 0.05) - pose.position
        at = (at - pose.velocity * when[b]) @ turn
        along = at @ local[b]
        off = np.linalg.norm(at - along[:, None] * local[b], axis=1)
        inside = (along > 0) & (off < math.tan(0.05) / 2 * along)
        expected |= {(b, float(drops.diameter[k])) for k in np.flatnonzero(inside)}
    found = set(zip(beam.tolist(), diameter.tolist(), strict=True))
    assert len(expected) > 100 and found <= expected
    # A drop that outruns the turn, or comes round twice, may be missed: close by, or fast.
    assert len(found) > 0.97 * len(expected)
    assert (place > 0).all()


def test_drops_near_by_are_those_of_the_field():
    field, centre, time = RainField(RainSpectrum(25.0), (2.0, 1.0), 4), np.array([1.0, 2, 30]), 5.0
    reach = np.linspace(0.3, 2.5, len(field.velocity))
    found = near_drops(field, centre, reach, time, OPEN_AIR)
    every = field.drops_in_box(time, centre - 2.5, centre + 2.5)
    size = np.array([np.flatnonzero((field.velocity == v).all(axis=1))[0] for v in every.velocity])
    near = np.linalg.norm(every.position - centre, axis=1) <= reach[size]
    assert near.sum() > 500
    np.testing.assert_array_equal(found.id, every.id[near])
    np.testing.assert_allclose(found.position, every.position[near])
    np.testing.assert_array_equal(found.diameter, every.diameter[near])
    # A level roof over everything leaves those above it.
    roof = flat_surfaces(80.0, 80.0, 0.5, origin=(-40.0, -40.0), height=30.0)
    above = near_drops(field, centre, reach, time, roof)
    assert 0 < len(above) < len(found) and above.position[:, 2].min() >= 30


# --- LISA -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "rate",
    [10.0, pytest.param(25.0, marks=pytest.mark.slow), pytest.param(50.0, marks=pytest.mark.slow)],
)
def test_false_returns_are_as_many_as_lisa_expects(rate):
    """20 seeds of the rain that cameras see, against LISA's drops, drawn again for each beam."""
    lidar, spectrum = SENSORS["vlp16"], RainSpectrum(rate)
    expected = scattered_share(15.0, 0.3, lidar, spectrum) * lidar.columns * 16
    room, counts = Room(15.0, 0.3), []
    for seed in range(20):
        field = RainField(spectrum, (1.0, 0.5), seed)
        scan = room.scan(lidar, STILL, 3.0, np.random.default_rng(0), field)
        counts.append(int((scan.label == SCATTERED).sum()))
    spread = np.std(counts, ddof=1)
    assert expected > 5
    assert abs(np.mean(counts) - expected) < 3 * spread / math.sqrt(20) + 0.02 * expected
    assert min(counts) > 0 and len(set(counts)) > 5  # other seeds, other drops


@pytest.mark.parametrize(
    "rate",
    [10.0, pytest.param(25.0, marks=pytest.mark.slow), pytest.param(50.0, marks=pytest.mark.slow)],
)
def test_points_are_lost_and_dimmed_as_lisa_has_it(rate):
    lidar, spectrum = SENSORS["vlp16"], RainSpectrum(rate)
    alpha = extinction_of(spectrum)
    field = RainField(spectrum, (0.0, 0.0), 1)
    near = Room(20.0, 0.4).scan(lidar, STILL, 0.0, np.random.default_rng(0), field)
    kept = near.label == KEPT
    assert kept.mean() > 0.99
    mean = np.log(near.reflectivity[kept] / 0.4).mean()
    assert mean == pytest.approx(-2 * alpha * 20.0, rel=1e-5)
    edge = 100 * math.sqrt(0.5 / 0.9)  # range of a target of 0.5 in clear air
    dry = Room(edge * 0.999, 0.5).scan(lidar, STILL, 0.0, np.random.default_rng(0))
    assert (dry.label == KEPT).all()
    wet = Room(edge * 0.999, 0.5).scan(lidar, STILL, 0.0, np.random.default_rng(0), field)
    assert (wet.label != KEPT).all() and not wet.point[wet.label == LOST].any()
    sky = Room(np.inf, 0.0).scan(lidar, STILL, 0.0, np.random.default_rng(0), field)
    assert set(np.unique(sky.label)) == {LOST, SCATTERED}


def test_same_seed_same_scan_and_noise_of_ranges():
    lidar, spectrum = Lidar(LEVEL, columns=600), RainSpectrum(25.0)
    one, two = (
        Room(30.0, 0.3).scan(
            lidar, STILL, 1.0, np.random.default_rng(5), RainField(spectrum, seed=2)
        )
        for _ in range(2)
    )
    np.testing.assert_array_equal(one.point, two.point)
    kept = one.label == KEPT
    away = np.linalg.norm(one.point[kept], axis=1)
    signal = echo_power(0.3, 30.0, extinction_of(spectrum)) / lidar.least_power
    assert away.std() == pytest.approx(lidar.accuracy / math.sqrt(2 * signal), rel=0.06)


# --- surfaces and water ---------------------------------------------------------------------------


class Yard(LidarScanner):
    """A level yard at z = 0 with a bright wall at x = 6 m, up to 3 m high."""

    def __init__(self):
        grid = Grid((40, 40), (-10.0, -10.0), 0.5)
        self.terrain = SimpleNamespace(grid=grid, bed=np.zeros(grid.shape, np.float32))

    def surfaces_at(self, time):
        return OPEN_AIR

    def trace(self, origin, direction, before=0.0, time=0.0):
        with np.errstate(divide="ignore", invalid="ignore"):
            down = np.where(direction[:, 2] < 0, -origin[:, 2] / direction[:, 2], np.inf)
            wall = np.where(direction[:, 0] > 0, (6 - origin[:, 0]) / direction[:, 0], np.inf)
            hit = np.abs(origin[:, 2] + wall * direction[:, 2] - 1.5) < 1.5
        wall = np.where(hit, wall, np.inf)
        way = np.minimum(down, wall)
        safe = np.where(np.isfinite(way), way, 0)
        place = origin + safe[:, None] * direction
        normal = np.where((wall < down)[:, None], (-1.0, 0, 0), (0, 0, 1.0))
        bright = np.where(wall < down, 0.8, 0.05)
        return Surface(way + before, place, normal, bright)


def test_puddles_mirror_the_beam_to_the_wall():
    lidar = Lidar(tuple(np.radians([-12.0, -10.0])), columns=720, accuracy=0.0)
    pose = Pose(np.array([0.0, 0, 1.0]), np.eye(3), np.zeros(3))
    depth = np.full((40, 40), 4e-3, np.float32)
    state, rng = SimpleNamespace(depth=depth), np.random.default_rng(0)
    dry = Yard().scan(lidar, pose, 0.0, rng)
    wet = Yard().scan(lidar, pose, 0.0, rng, None, state)
    assert not (dry.label == MIRRORED).any() and (dry.label == KEPT).mean() > 0.9
    ghosts = wet.label == MIRRORED
    assert ghosts.any()
    # The image of the wall behind the mirror: at x = 6, below the ground.
    np.testing.assert_allclose(wet.point[ghosts][:, 0], 6, atol=0.1)
    assert (wet.point[ghosts][:, 2] + 1.0 < 0).all()
    angle = np.arcsin(-wet.point[ghosts][:, 2] / np.linalg.norm(wet.point[ghosts], axis=1))
    share, _ = fresnel_of(np.sin(angle))
    np.testing.assert_allclose(wet.reflectivity[ghosts], share**2 * 0.8, rtol=1e-4)
    # Water dims what still echoes through it.
    both = (dry.label == KEPT) & (wet.label == KEPT) & (dry.point[:, 2] < -0.9)
    assert both.any() and (wet.reflectivity[both] < dry.reflectivity[both]).all()


def test_points_lie_on_the_captures_ground(rng):
    scene = tiny_scene()
    config = Config.from_preset("downpour").replace(extent=1.0, spacing=0.05)
    terrain = pipeline.extract_terrain(scene, config)
    scanner = LidarScanner(scene, terrain, 0.9)
    camera = scene.ground_frame.camera_in_ground(scene.cameras[0])
    pose = pose_at(camera, height=1.0)
    assert pose.rotation[2].tolist() == [0, 0, 1] and pose.position[2] == 1.0
    lidar = Lidar(tuple(np.radians(np.arange(-60, -20, 4.0))), columns=180, near=0.2, accuracy=0.0)
    scan = scanner.scan(lidar, pose, 0.0, rng)
    back = scan.label == KEPT
    assert 0.1 < back.mean() < 1
    place = scan.point[back] @ pose.rotation.T + pose.position
    low = (place[:, 2] < 0.15) & (np.abs(place[:, :2]) < 0.95).all(axis=1)
    assert low.mean() > 0.5
    off = place[low, 2] - bed_height(place[low, 0], place[low, 1])
    assert np.median(np.abs(off)) < 5e-3 and np.percentile(np.abs(off), 95) < 0.03
    assert 0.02 < np.median(scan.reflectivity[back]) < 0.6


def before_a_far_wall():
    """Level ground of thin discs that let a little light through, and a wall 400 m behind it."""
    step = 0.1
    x, y = (v.ravel() for v in np.meshgrid(np.arange(-1, 15, step), np.arange(-2, 2, step)))
    ground = np.column_stack([x, y, np.zeros(len(x))])
    size = np.tile([0.7 * step, 0.7 * step, 4e-4], (len(x), 1))
    wall = np.array([[400.0, 0.0, 0.0]])
    splats = factories.splats(
        np.concatenate([ground, wall]), scale=np.concatenate([size, [[0.5, 300.0, 300.0]]]),
        opacity=0.7,
    )  # fmt: skip
    frame = GroundFrame(np.eye(3), 1.0, np.zeros(3), 1.0, ("made for a test",))
    camera = looking((0.0, 0.0, 1.5), (12.0, 0.0, 0.3), 48, 24, focal=60)
    return Scene("road", splats, (camera,), frame, None, "0" * 64, ())


def ranges_in_pixels(scanner, camera):
    """Ranges [m] along the rays through the middles of pixels, from the camera's own place."""
    ray = pixel_rays(camera).reshape(-1, 3)
    toward = ray / np.linalg.norm(ray, axis=1)[:, None] @ camera.camera_from_world[:3, :3]
    return scanner.trace(np.tile(camera.position, (len(toward), 1)), toward)


def test_what_shines_through_a_surface_moves_no_point(monkeypatch):
    """On the ground a beam has the range that the plane has, whatever stands far behind."""
    scene = before_a_far_wall()
    config = Config.from_preset("downpour").replace(extent=1.0, spacing=0.05)
    camera = scene.cameras[0]
    scanner = LidarScanner(scene, pipeline.extract_terrain(scene, config), 0.9)
    ray = pixel_rays(camera).reshape(-1, 3) @ camera.camera_from_world[:3, :3]
    way = 1.5 / np.maximum(-ray[:, 2], 1e-9)  # to the ground, in lengths of the ray
    exact = way * np.linalg.norm(ray, axis=1)
    on = (exact > 3) & (exact < 12) & (np.abs(way * ray[:, 1]) < 1.5)

    def off():
        return np.abs(ranges_in_pixels(scanner, camera).distance[on] / exact[on] - 1)

    assert on.sum() > 100 and np.median(off()) < 1e-3 and np.percentile(off(), 99) < 0.02
    monkeypatch.setattr(lidar_module, "PASSED", 1e-4)
    assert np.percentile(off(), 90) > 0.1  # beams that go on are put off


def test_beams_from_the_camera_have_the_ranges_of_its_picture():
    """Through the middles of pixels lidar and label agree; half a pixel off, they do not."""
    scene = tiny_scene(96, 72)
    config = Config.from_preset("downpour").replace(extent=1.0, spacing=0.05)
    terrain = pipeline.extract_terrain(scene, config)
    camera = scene.ground_frame.camera_in_ground(scene.cameras[0])
    shots = Shots(scene, terrain, [View(0, "v", camera)], config, False)
    (sample,) = shots.draw(0.0, [0])
    scanner, seen = LidarScanner(scene, terrain, 0.9), sample.range.ravel()

    def off(shift):
        moved = replace(camera, cy=camera.cy - shift)
        found = ranges_in_pixels(scanner, moved)
        level = (found.normal[:, 2] > 0.7) & np.isfinite(found.distance) & np.isfinite(seen)
        assert level.sum() > 1000
        return np.abs(found.distance[level] / seen[level] - 1)

    assert np.median(off(0.0)) < 5e-4 and np.percentile(off(0.0), 90) < 5e-3
    assert np.median(off(0.5)) > 4 * np.median(off(0.0))


# --- actors ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def moving():
    scene = moving_scene()
    config = Config.from_preset("downpour").replace(extent=1.0, spacing=0.05)
    terrain = pipeline.extract_terrain(scene, config)
    return scene, terrain, LidarScanner(scene, terrain, 0.9)


def test_beams_meet_an_actor_where_it_is_as_each_is_sent(moving, rng):
    scene, terrain, scanner = moving
    n = 3000
    origin = np.column_stack([rng.uniform(0.4, 1.1, n), rng.uniform(-1, 0.6, n), np.full(n, 1.5)])
    direction = rng.normal((0, 0, -1.0), 0.15, (n, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    which = np.arange(n) % 3
    times = np.array([0.1, 0.45, 0.8])[which]
    found, hits = scanner.trace(origin, direction, 0.0, times), []
    for k, time in enumerate((0.1, 0.45, 0.8)):
        here = which == k
        alone = LidarScanner(scene_at(scene, time), terrain, 0.9).trace(
            origin[here], direction[here]
        )
        same = np.isclose(found.distance[here], alone.distance, rtol=0, atol=2e-3)
        assert np.mean(same) > 0.97 and alone.actor is None
        assert np.mean(np.abs(found.reflectivity[here] - alone.reflectivity) < 0.02) > 0.97
        hits.append(found.actor[here] == 1)
        top = found.place[here][hits[-1]][:, 2].max()
        assert top == pytest.approx(0.002 + BOX_SIZE[2], abs=0.02)
    assert all(20 < hit.sum() < 0.5 * len(hit) for hit in hits)
    still = scanner.trace(origin, direction, 0.0, 0.1)
    assert not np.array_equal(still.actor, found.actor)  # it is elsewhere for the other two


def test_points_of_a_turn_say_which_actor_they_lie_on(moving, rng):
    scene, _, scanner = moving
    lidar = Lidar(tuple(np.radians(np.arange(-70, -20, 2.0))), columns=360, near=0.2, accuracy=0.0,
                  rate=2.0)  # fmt: skip
    pose = Pose(np.array([0.3, -0.3, 1.0]), np.eye(3), np.zeros(3))
    scan = scanner.scan(lidar, pose, 0.2, rng)
    on = scan.actor == 1
    assert 30 < on.sum() < 0.3 * len(on) and set(np.unique(scan.actor)) == {0, 1}
    # In its own frame each point lies on the box: half a second of its way would tear it apart.
    frame, actor = scene.ground_frame, scene.actors[0]
    place = frame.to_capture(scan.point[on].astype(float) @ pose.rotation.T + pose.position)
    rotation, position, visible = actor.track.poses(0.2 + scan.time[on].astype(float))
    own = np.einsum("nji,nj->ni", rotation, place - position)
    off = np.abs(own - actor.box[0]) - 0.5 * actor.box[1]
    assert visible.all() and off.max() * frame.meters_per_unit < 0.01
    labels = np.frombuffer(point_files.kitti_labels(scan), "<u4")
    back = scan.label != LOST
    np.testing.assert_array_equal(labels >> 16, scan.actor[back])
    np.testing.assert_array_equal(labels & 0xFFFF, scan.label[back])
    header, _, body = point_files.ply_bytes(scan).partition(b"end_header\n")
    rows = np.frombuffer(body, list(point_files.fields_of(scan)))
    assert b"property uint node" in header and (rows["node"] == scan.actor[back]).all()
    header, _, body = point_files.pcd_bytes(scan, len(lidar.elevation)).partition(b"DATA binary\n")
    assert b"time label node" in header and b"TYPE F F F F F U U" in header
    assert len(body) == len(scan.actor) * 28


def test_an_actor_that_is_not_there_sends_nothing_back(rng):
    scene = moving_scene(visible=(False, True))
    config = Config.from_preset("downpour").replace(extent=1.0, spacing=0.05)
    scanner = LidarScanner(scene, pipeline.extract_terrain(scene, config), 0.9)
    down = np.array([[0.78, -0.6, 1.5]]), np.array([[0.0, 0.0, -1.0]])
    there = [int(scanner.trace(*down, 0.0, time).actor[0]) for time in (0.15, 1.0)]
    over = np.array([[*BOX_WAY[1][:2], 1.5]])
    assert there == [0, 0] and scanner.trace(over, down[1], 0.0, 1.0).actor[0] == 1


# --- files ----------------------------------------------------------------------------------------


def test_files_come_back(rng):
    lidar = Lidar(LEVEL, columns=50)
    scan = Room(90.0, 0.9).scan(lidar, STILL, 0.0, rng, RainField(RainSpectrum(25.0), seed=3))
    back = scan.label != LOST
    rows = np.frombuffer(point_files.kitti_bin(scan), "<f4").reshape(-1, 4)
    np.testing.assert_array_equal(rows[:, :3], scan.point[back])
    np.testing.assert_array_equal(rows[:, 3], scan.reflectivity[back])
    labels = np.frombuffer(point_files.kitti_labels(scan), "<u4")
    np.testing.assert_array_equal(labels, scan.label[back])
    kind = list(point_files.FIELDS)
    header, _, body = point_files.pcd_bytes(scan, 4).partition(b"DATA binary\n")
    assert b"WIDTH 50\nHEIGHT 4\n" in header and b"FIELDS x y z intensity time label" in header
    assert b"TYPE F F F F F U" in header
    grid = np.frombuffer(body, kind).reshape(4, 50)
    np.testing.assert_array_equal(grid["label"].T.ravel(), scan.label)
    assert np.isnan(grid["x"].T.ravel()[~back]).all()
    header, _, body = point_files.ply_bytes(scan).partition(b"end_header\n")
    rows = np.frombuffer(body, kind)
    assert f"element vertex {back.sum()}\n".encode() in header
    np.testing.assert_array_equal(rows["z"], scan.point[back, 2])
