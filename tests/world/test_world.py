"""What `rainsim world` writes: meshes, lists of what falls, glTF and USD stages."""

from itertools import islice

import numpy as np
import pytest

from rainsim.config.settings import Config
from rainsim.drops import RainField, RainSpectrum, Weather
from rainsim.errors import RainsimError
from rainsim.particles.line_raster import NEAR
from rainsim.particles.splash_pass import draw_splashes
from rainsim.particles.streaks import draw_streaks, streak_reach
from rainsim.pipeline import extract_terrain, simulate
from rainsim.scene.shot import read_shot
from rainsim.scene.types import Camera, pose_at
from rainsim.simulation import surfaces_of
from rainsim.water.puddles import WET
from rainsim.world import falling
from rainsim.world.meshes import ground_mesh, water_mesh, write_glb
from rainsim.world.usd_files import Clock, RainLayer, camera_layer
from rainsim.world.write import write_parts
from scenes import looking, tiny_scene

DRY = RainField(RainSpectrum(0.0))
SHUTTER = falling.MOMENT  # s


@pytest.fixture(scope="module")
def scene():
    return tiny_scene()


@pytest.fixture(scope="module")
def config():
    config = Config.from_preset("downpour")
    return config.replace(frames=2, spacing=0.04, extent=1.0, exposure=SHUTTER, width=64)


@pytest.fixture(scope="module")
def terrain(scene, config):
    return extract_terrain(scene, config)


@pytest.fixture(scope="module")
def state(terrain, config):
    return next(simulate(terrain, config))


def alpha_of(lines, camera, state):
    """The share of light that drops on given paths replace."""
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    alpha = np.empty_like(depth)
    draw_streaks(DRY, None, camera, state.time, SHUTTER, depth, NEAR, alpha, more=lines)
    return alpha


def test_drops_and_splashes_are_those_of_the_pictures(terrain, config, state):
    field = Weather(config).field(state.time - 1, state.time + SHUTTER)
    surfaces, depth = surfaces_of(terrain), np.full((120, 160), np.inf, np.float32)
    drawn, landed = np.empty_like(depth), np.empty_like(depth)
    camera = looking((-1.3, -0.9, 0.3), (0.1, 0.0, 0.9), 160, 120)  # up: beside the map is no floor
    found = falling.falling_at(state, field, surfaces, camera, config.render, 1e-4)
    reach = streak_reach(field, camera, SHUTTER, config.render.streak_far)
    draw_streaks(field, surfaces, camera, state.time, SHUTTER, depth, reach, drawn)
    assert len(found.drops) > 100 and drawn.sum() > 1
    ours = alpha_of(found.drops, camera, state)
    assert np.abs(ours - drawn).sum() < 0.03 * drawn.sum()  # drips are ours alone
    camera = looking((-1.3, -0.9, 1.0), (0.1, 0.0, 0.1), 160, 120)
    found = falling.falling_at(state, field, surfaces, camera, config.render, 1e-4)
    depth[:] = 50  # something is seen where they land
    draw_splashes(field, surfaces, camera, state.time, SHUTTER, state.depth, 1e-4, depth, landed)
    threads = found.crowns.copy()
    way = threads[:, 3:6] - threads[:, :3]
    threads[:, 3:6] = way / SHUTTER
    threads[:, 6] = np.sqrt(4 / np.pi * threads[:, 6] * np.linalg.norm(way, axis=1))
    ours = alpha_of(np.concatenate([found.droplets, threads]), camera, state)
    assert len(found.droplets) > 5 and len(threads) > 10 and landed.sum() > 1
    assert ours.sum() == pytest.approx(landed.sum(), rel=0.1)
    assert np.corrcoef(ours.ravel(), landed.ravel())[0, 1] > 0.9


def test_no_drop_is_listed_under_cover_or_without_rain(terrain, config, state):
    camera = looking((-1.3, -0.9, 1.0), (0.1, 0.0, 0.1), 160, 120)
    field, surfaces = Weather(config).field(0.0, 1.0), surfaces_of(terrain)
    drops = falling.falling_at(state, field, surfaces, camera, config.render, 0.0).drops
    row, column, inside = terrain.grid.cells(drops[:, 0], drops[:, 1])
    table = inside & (terrain.top > terrain.bed + 0.2)[row, column]
    above = drops[:, 2] >= terrain.top[row, column]
    assert above[table].sum() > 5  # and the wind blows few in under the edge
    assert above[table].mean() > 0.8 and not (drops[:, 2] < terrain.bed.min()).any()
    dry = falling.falling_at(state, None, surfaces, camera, config.render, 0.0)
    assert not (len(dry.drops) or len(dry.droplets) or len(dry.crowns))


def test_the_ground_faces_up_and_lies_on_the_cells(terrain):
    ground = ground_mesh(terrain)
    corners = ground.points[ground.quads].astype(float)
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 1])
    assert (faces[:, 2] > 0).all()
    np.testing.assert_allclose(ground.points[:, 2], terrain.bed.ravel())
    steep = np.abs(ground.normals[:, 2]).argmin()
    beside = [f for f, quad in zip(faces, ground.quads, strict=True) if steep in quad]
    mean = np.sum(beside, axis=0)
    np.testing.assert_allclose(ground.normals[steep], mean / np.linalg.norm(mean), atol=0.02)


def test_puddles_have_their_level_and_run_into_the_ground(terrain):
    depth = np.maximum(-terrain.bed - 4e-3, 0).astype(np.float32)  # a level of -4 mm
    velocity = np.stack([depth * 2, depth * 3])
    water = water_mesh(terrain, depth, velocity)
    deep = water.depth >= WET
    assert deep.sum() == (depth >= WET).sum() > 10
    np.testing.assert_allclose(water.points[deep, 2], -4e-3, atol=1e-6)
    assert (water.points[~deep, 2] <= -4e-3 + 1e-6).all()  # no sheet climbs the rim
    np.testing.assert_allclose(water.flow, water.depth[:, None] * [2, 3, 0], atol=1e-6)
    assert deep[water.quads].any(axis=1).all()
    none = water_mesh(terrain, depth * 0, velocity)
    assert none.points.shape == (0, 3) and none.quads.shape == (0, 4)


def test_the_ground_as_glb_is_what_trimesh_reads(terrain, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    ground = ground_mesh(terrain)
    write_glb(tmp_path / "ground.glb", ground)
    mesh = trimesh.load(tmp_path / "ground.glb").geometry["Ground"]
    x, y, z = mesh.vertices.T
    np.testing.assert_allclose(np.column_stack([x, -z, y]), ground.points, atol=1e-6)
    assert len(mesh.faces) == 2 * len(ground.quads)
    assert (mesh.vertex_normals[:, 1] > 0.5).all()
    np.testing.assert_allclose(mesh.visual.vertex_colors[:, :3] / 255, ground.colors, atol=3e-3)


# --- USD


def shots():
    """Cameras of the ground frame with odd lenses that change."""
    rng = np.random.default_rng(3)
    for k in range(5):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turn *= np.linalg.det(turn)
        lens = 700.3 + 31 * k, 655.5 + 20 * k, 501.25 - k, 222.125 + k
        yield Camera(999, 431, *lens, pose_at(turn, rng.normal(size=3) * 30))


def test_a_camera_comes_back_to_one_in_a_million(tmp_path):
    pytest.importorskip("pxr")
    cameras = list(shots())
    camera_layer(cameras, Clock(1001, 5, 23.976), 0.02).write(tmp_path / "camera.usda")
    shot = read_shot(tmp_path / "camera.usda")
    assert (shot.fps, shot.first, len(shot.cameras)) == (23.976, 1001, 5)
    for one, other in zip(cameras, shot.cameras, strict=True):
        assert (one.width, one.height) == (other.width, other.height)
        np.testing.assert_allclose(other.camera_from_world, one.camera_from_world, atol=1e-12)
        # Pixels have one shape in a stage, that of the first frame.
        shape = other.fy / other.fx / (cameras[0].fy / cameras[0].fx)
        assert shape == pytest.approx(1, abs=1e-6)
    first, found = cameras[0], shot.cameras[0]
    for name in ("fx", "fy", "cx", "cy"):
        assert getattr(found, name) == pytest.approx(getattr(first, name), rel=1e-6)


def test_what_a_layer_has_saved_is_whole_and_a_full_disk_is_one_line(tmp_path, monkeypatch):
    Usd = pytest.importorskip("pxr.Usd")
    from pxr import Tf

    layer = RainLayer(Clock(0, 3, 24.0), tmp_path / "rain.usdc")
    for code in range(3):
        rows = np.full((code + 1, 7), code, float)
        layer.add(code, falling.Falling(rows, rows[:0], rows[:0]))
        layer.save()
    stage = Usd.Stage.Open(str(tmp_path / "rain.usdc"))
    points = stage.GetPrimAtPath("/World/Rain/Drops")
    assert [len(points.GetAttribute("points").Get(code)) for code in range(3)] == [1, 2, 3]

    def full(*_):
        raise Tf.ErrorException("Error in 'A' at line 1 in file b : 'No space left on device'")

    monkeypatch.setattr(type(layer.stage.GetRootLayer()), "Save", full)
    with pytest.raises(RainsimError, match=r"did not take a USD file \(No space left"):
        layer.save()


def test_the_stages_hold_all_parts_and_nothing_is_found_wrong(scene, terrain, config, tmp_path):
    Usd = pytest.importorskip("pxr.Usd")
    pytest.importorskip("trimesh")
    from pxr import UsdGeom, UsdValidation

    parts = ("camera", "ground", "water", "rain", "capture")
    names, notes = write_parts(
        tmp_path, scene, terrain, scene.cameras[:1], config, parts, 7, lambda *now: None
    )
    assert sorted(names) == sorted(path.name for path in tmp_path.iterdir()) and not notes
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    for name in names:
        if not name.endswith(".glb"):
            stage = Usd.Stage.Open(str(tmp_path / name))
            assert not UsdValidation.ValidationContext(validators).Validate(stage)
    stage = Usd.Stage.Open(str(tmp_path / "world.usda"))
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (7, 8)
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == config.fps

    def prim(path):
        return stage.GetPrimAtPath(f"/World/{path}")

    *_, state = islice(simulate(terrain, config), 2)
    water = water_mesh(terrain, state.depth, state.velocity)
    for name, want in (
        ("points", water.points), ("primvars:depth", water.depth), ("primvars:flow", water.flow),
    ):  # fmt: skip
        np.testing.assert_array_equal(np.array(prim("Water").GetAttribute(name).Get(8)), want)
    drops = prim("Rain/Drops")
    assert len(drops.GetAttribute("points").Get(7)) == len(drops.GetAttribute("widths").Get(7)) > 9
    assert np.median(np.array(drops.GetAttribute("velocities").Get(7))[:, 2]) < -2
    capture, splats = prim("Capture"), scene.splats
    place = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(capture))
    ground = np.array(capture.GetAttribute("positions").Get()) @ place[:3, :3] + place[3, :3]
    np.testing.assert_allclose(ground, scene.ground_frame.to_ground(splats.position), atol=1e-5)
    turn = [[q.real, *q.imaginary] for q in capture.GetAttribute("orientations").Get()]
    np.testing.assert_array_equal(np.array(turn), splats.rotation)
    harmonics = np.array(capture.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get())
    np.testing.assert_array_equal(harmonics.reshape(splats.sh.shape), splats.sh)
    assert capture.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == 0
