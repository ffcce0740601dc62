"""Actors: their splats, harmonics, shadows, mirror images, labels; the same every time."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.traced import trace_reflections
from made_actors import described
from rainsim import pipeline
from rainsim.actors.actor import Actor, ColorSeries, box_of, scene_at, with_actors
from rainsim.actors.actor_files import read_actors
from rainsim.actors.footprint import footprint_of, with_footprints
from rainsim.actors.motion import Track
from rainsim.config.settings import Config
from rainsim.errors import InputError, ParameterError
from rainsim.rain.moving_surfaces import MovingSurfaces
from rainsim.raster import Rasterizer, prepare
from rainsim.render.actor_labels import box_in_picture
from rainsim.render.renderer import Renderer
from rainsim.scene.folder import import_scene, read_scene, write_scene
from rainsim.scene.harmonics import basis, turned
from rainsim.scene.library import load_scene
from rainsim.splatting.merged import NOBODY, Merger
from rainsim.splatting.project import color_degree_1, color_degree_2, color_degree_3
from scenes import BOX_SIZE, moving_scene, one_splat, tiny_scene

CONFIG = Config.from_preset("downpour").replace(past=6e-3, extent=1.0, spacing=0.025)
BEHIND = 12  # frame at whose time, 0.5 s, the box stands behind the puddle
LAYERS = ("actor_id", "flow", "flow_mask", "coverage", "reflection", "class_id", "depth")
QUARTER = np.array([np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)])


def track(*keys, visible=None):
    """A track of keys (time, x, y, z) without turns."""
    keys = np.array(keys, float)
    turn = np.tile([1.0, 0, 0, 0], (len(keys), 1))
    seen = np.ones(len(keys), bool) if visible is None else np.array(visible)
    return Track(keys[:, 0], keys[:, 1:], turn, seen)


@pytest.fixture(scope="module")
def scene():
    return moving_scene()


@pytest.fixture(scope="module")
def ground(scene):
    return pipeline.extract_terrain(scene, CONFIG)


@pytest.fixture(scope="module")
def states(scene, ground):
    """The water up to the frame BEHIND, by frame."""
    return [s for s, _ in zip(pipeline.simulate(ground, CONFIG), range(BEHIND + 1), strict=False)]


@pytest.fixture(scope="module")
def camera(scene):
    return scene.cameras[0].resized(320, 240)


@pytest.fixture(scope="module")
def shot(scene, ground, states, camera):
    """A frame with labels: picture, report, renderer."""
    renderer = Renderer(scene, ground, CONFIG, camera)
    return *renderer.draw(camera, states[BEHIND], None, LAYERS), renderer


# --- harmonics and poses --------------------------------------------------------------------------


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_turned_harmonics_show_the_colours_of_turned_directions(rng, coefficients):
    sh = rng.normal(size=(40, coefficients, 3)).astype(np.float32)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    away = rng.normal(size=(200, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    before = np.einsum("dk,nkc->ndc", basis(away)[:, :coefficients], sh)
    after = np.einsum(
        "dk,nkc->ndc", basis(away @ rotation.T)[:, :coefficients], turned(sh, rotation)
    )
    np.testing.assert_allclose(after, before, atol=2e-5)
    if coefficients > 1:  # and not turned they would show others
        still = np.einsum("dk,nkc->ndc", basis(away @ rotation.T)[:, :coefficients], sh)
        assert np.abs(still - before).max() > 0.1


def test_the_basis_is_that_of_the_rasterizer(rng):
    x, y, z = away = rng.normal(size=3)
    x, y, z = (np.float32(v) for v in away / np.linalg.norm(away))
    value = basis(np.array([[x, y, z]]))[0]
    sh = rng.normal(size=16).astype(np.float32)
    bands = (color_degree_1(x, y, z, *sh[1:4]), color_degree_2(x, y, z, *sh[4:9]),
             color_degree_3(x, y, z, *sh[9:16]))  # fmt: skip
    assert value[1:] @ sh[1:] == pytest.approx(float(sum(bands)), abs=1e-5)


def test_a_track_is_interpolated_and_says_when_its_actor_is_there():
    turns = np.array([[1.0, 0, 0, 0], QUARTER * -3])  # any length, either sign
    way = Track(np.array([1.0, 3.0]), np.array([[0.0, 0, 0], [2.0, 4, 0]]), turns,
                np.array([True, False]))  # fmt: skip
    pose = way.at(2.0)
    np.testing.assert_allclose(pose.position, [1, 2, 0])
    np.testing.assert_allclose(pose.rotation @ [1, 0, 0], [0.5**0.5, 0.5**0.5, 0], atol=1e-12)
    np.testing.assert_array_equal(way.at(-5.0).position, [0, 0, 0])  # stays as at the first key
    assert way.at(2.999) is not None and way.at(3.0) is None and way.at(9.0) is None
    assert not way.parked and track((0, 1, 1, 1), (5, 1, 1, 1)).parked
    assert not track((0, 1, 1, 1), (5, 1, 1, 1), visible=(True, False)).parked


@pytest.mark.parametrize(
    ("time", "turn", "message"),
    [
        ([0.0, 0.0], QUARTER, "rise"),
        ([0.0, np.nan], QUARTER, "rise"),
        ([0.0, 1.0], QUARTER * 0, "no quaternion 0"),
        ([0.0], QUARTER, "must have one time"),
    ],
)
def test_tracks_that_are_none(time, turn, message):
    with pytest.raises(ParameterError, match=message):
        Track(np.array(time), np.zeros((2, 3)), np.tile(turn, (2, 1)), np.ones(2, bool))


def test_colours_over_time_are_a_fourier_series():
    terms = np.zeros((1, 5, 3), np.float32)
    terms[0, :, 0] = 1, 2, 3, 4, 5
    series = ColorSeries(terms, 2.0, 4.0)
    angle = np.pi * 0.25
    wanted = 1 + 2 * np.sin(2 * angle) + 3 * np.cos(2 * angle) + 4 * np.sin(4 * angle)
    wanted += 5 * np.cos(4 * angle)
    assert series.at(2.5)[0, 0] == pytest.approx(wanted, abs=1e-5)
    assert series.at(-1.0)[0, 0] == series.at(2.0)[0, 0] == pytest.approx(9)
    body = Actor("a", "car", one_splat(), box_of(one_splat()), track((0, 0, 0, 0)), series)
    pose = body.track.at(0)
    assert body.placed(pose, 2.0).sh[0, 0, 0] != body.placed(pose, 2.5).sh[0, 0, 0]


def test_harmonics_of_the_scene_stay_as_they_are(rng):
    sh = rng.normal(size=(1, 9, 3)).astype(np.float32)
    splat = replace(one_splat(), sh=sh)
    way = Track(np.zeros(1), np.zeros((1, 3)), QUARTER[None], np.ones(1, bool))
    body = Actor("a", "car", splat, box_of(splat), way, turning=False)
    np.testing.assert_array_equal(body.placed(way.at(0), 0).sh, sh)
    assert np.abs(replace(body, turning=True).placed(way.at(0), 0).sh - sh).max() > 0.1


# --- merged splats --------------------------------------------------------------------------------


def test_merged_sets_draw_what_one_set_draws(scene, camera):
    time, near = 0.4, 0.05
    whole = scene_at(scene, time).splats
    expected = Rasterizer(prepare(whole)).draw(camera, near, hit=True)
    actor, count = scene.actors[0], len(scene.splats)
    merger = Merger(prepare(scene.splats), len(actor.splats) + 700)
    merged = merger.merged(prepare(actor.placed(actor.track.at(time), time)), count)
    drawer = Rasterizer(merged)
    found = drawer.draw(camera, near, hit=True)
    for name in ("color", "alpha", "normal"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=2e-5)
    assert (found.hit == expected.hit).mean() > 0.999
    assert (found.hit >= count).sum() > 500 and NOBODY not in merged.order[merged.order >= 0]
    # Another moment leaves nothing of this one behind, and no actors leave the static set alone.
    drawer.put_actors(merger.merged(None, count))
    alone = Rasterizer(prepare(scene.splats)).draw(camera, near)
    np.testing.assert_array_equal(drawer.draw(camera, near).color, alone.color)


@pytest.mark.slow
def test_actors_that_nobody_sees_change_no_byte(scene, ground, states, camera):
    hidden = moving_scene(visible=(False, False))
    pictures = []
    for one in (replace(scene, actors=()), hidden, scene):
        terrain = with_footprints(replace(ground, footprints=()), one)
        pictures.append(Renderer(one, terrain, CONFIG, camera).draw(camera, states[BEHIND])[0])
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert (pictures[0] != pictures[2]).any(axis=-1).sum() > 1500


def test_the_same_frame_alone_in_sequence_and_on_any_threads(scene, ground, camera, threads):
    frames = pipeline.FrameSequence(scene, ground, [camera], CONFIG, layers=("actor_id",))
    together = {r.index: (p.copy(), r.facts["actors"]) for p, r in frames.frames([0, 5, 6])}
    for count, index in ((1, 6), (2, 5), (2, 0)):
        threads(count)
        alone = pipeline.FrameSequence(scene, ground, [camera], CONFIG, layers=("actor_id",))
        (picture, report), = alone.frames([index])  # fmt: skip
        np.testing.assert_array_equal(picture, together[index][0])
        assert report.facts["actors"] == together[index][1]
    assert (together[5][0] != together[6][0]).any()


# --- rain shadow ----------------------------------------------------------------------------------


def test_no_rain_falls_under_a_moving_box_and_water_keeps_its_account(scene, ground, states):
    heavy = CONFIG.replace(rate=200 / 3.6e6, fps=24)
    bare = replace(ground, footprints=())
    rain = []
    for terrain in (ground, bare):
        run = pipeline.simulate(terrain, heavy, dtype=np.float64)
        ledgers = [state.ledger for state, _ in zip(run, range(14), strict=False)]
        assert all(abs(ledger["residual"]) < 1e-9 for ledger in ledgers)
        rain.append(ledgers[-1]["rain"])
    kept_off = (rain[1] - rain[0]) / (heavy.rain.rate * 13 / 24)  # m2
    assert 0.8 < kept_off / (BOX_SIZE[0] * BOX_SIZE[1]) < 1.6
    moving, open_ground = MovingSurfaces(ground), np.ones(ground.grid.shape, np.float32)
    for time in (0.1, 0.4):
        centre = scene.ground_frame.to_ground(scene.actors[0].track.at(time).position)[:2]
        row, column, _ = ground.grid.cells(*(np.array([c]) for c in centre))
        share = moving.thinned(open_ground, time)
        assert share[row, column] < 0.1 and np.median(share) == 1


def test_what_was_found_ahead_is_what_is_found_at_the_time(scene, ground, states):
    """The map that drops meet, shelters and rings; also after a time that was not looked for."""
    camera = scene.cameras[0]
    direct, ahead = (Renderer(scene, ground, CONFIG, camera).conductor for _ in range(2))
    for index, coming in ((0, (1, 2)), (1, (2, 3)), (2, (1,)), (3, (3,)), (3, ())):
        found = []
        for conductor in (direct, ahead):
            conductor.take(camera, states[index])
            surfaces, shelters = conductor.ground.moving.moment(states[index].time)
            found.append((conductor.frame["rings"], surfaces.top, shelters[0][1]))
        for mine, wanted in zip(*found, strict=True):
            np.testing.assert_array_equal(mine, wanted)
        if coming:
            ahead.look_ahead([states[number].time for number in coming])
            assert sorted(ahead._coming) == [states[number].time for number in coming]
    assert not np.array_equal(found[0][0], direct.ground.rings)


def test_a_shelter_moves_with_its_actor_and_leaves_what_is_beside_it(scene, ground):
    moving = MovingSurfaces(ground)
    share = np.ones(ground.grid.shape, np.float32)
    for time in (0.2, 0.8):
        thin = moving.thinned(share, time)
        x, y = np.meshgrid(*ground.grid.centres())
        place = scene.ground_frame.to_ground(scene.actors[0].track.at(time).position)
        away = np.hypot(x - place[0], y - place[1])
        assert thin[away < 0.05].max() < 0.15 and thin[away > 0.4].min() > 0.99
        area = (1 - thin).sum() * ground.grid.cell_area
        assert area == pytest.approx(BOX_SIZE[0] * BOX_SIZE[1], rel=0.2)
    windy = MovingSurfaces(ground, (6.0, 0.0)).thinned(share, 0.2)
    still = moving.thinned(share, 0.2)
    column = (1 - windy).sum(axis=0) @ np.arange(windy.shape[1]) / (1 - windy).sum()
    before = (1 - still).sum(axis=0) @ np.arange(windy.shape[1]) / (1 - still).sum()
    assert column > before + 1  # the wind goes along x, and the dry patch with it
    assert moving.at(0.2).top.max() < moving.at(0.8).top.max() + 1  # finite


def test_a_parked_box_keeps_its_ground_dry_and_drips(ground):
    parked = moving_scene(way=((0.3, 0.35, 0.4),), visible=(True,))
    terrain = with_footprints(replace(ground, footprints=()), parked)
    assert terrain.footprints == () and (terrain.top - ground.top).max() > 0.2
    camera = parked.cameras[2].resized(160, 120)
    renderer = Renderer(parked, terrain, CONFIG, camera)
    dry = renderer.conductor.wet_scene.ground.reach < 0.2
    free = Renderer(replace(parked, actors=()), replace(ground, footprints=()), CONFIG, camera)
    more = dry.sum() - (free.conductor.wet_scene.ground.reach < 0.2).sum()
    assert more * terrain.grid.cell_area == pytest.approx(BOX_SIZE[0] * BOX_SIZE[1], rel=0.35)


# --- the picture and its labels -------------------------------------------------------------------


def test_a_box_in_the_picture_is_that_of_its_splats(scene, shot, camera):
    _, report, _ = shot
    (facts,) = report.facts["actors"]
    assert facts["track"] == "box" and facts["class"] == "parcel" and facts["number"] == 1
    np.testing.assert_allclose(np.linalg.norm(facts["box3d"]["velocity"]), 1.0, rtol=1e-3)
    # The upright box of the same size at the same place has the splats' outline in the picture.
    frame, actor, time = scene.ground_frame, scene.actors[0], report.time
    footprint = footprint_of(actor, frame, 0.025)
    rotation, shift = footprint.ground_from_upright(footprint.motion.at(time))
    half = BOX_SIZE / 2
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = (signs * half + [0, 0, half[2]]) @ rotation.T + shift  # its first heading is 0
    box = box_in_picture(corners, frame.camera_in_ground(camera))
    np.testing.assert_allclose(box, facts["box2d_seen"], atol=1.0)
    assert facts["pixels"] == (report.aovs["actor_id"] == 1).sum() > 1000
    left, top, right, bottom = facts["box2d"]
    assert left <= box[0] and top <= box[1] and right >= box[2] and bottom >= box[3]


def test_a_box_behind_or_beside_the_camera(camera, scene):
    view = scene.ground_frame.camera_in_ground(camera)
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    place = view.position - 3 * view.forward
    assert box_in_picture(place + 0.2 * signs, view) is None
    around = box_in_picture(view.position + 0.5 * signs, view)  # the camera is in it
    assert around == [0, 0, camera.width, camera.height]


def test_flow_of_an_actors_pixels_is_that_of_its_points(scene, shot, camera):
    _, report, _ = shot
    number, flow, mask = (report.aovs[n] for n in ("actor_id", "flow", "flow_mask"))
    mine = (number == 1) & (mask == 1)
    assert mine.sum() > 1000 and np.abs(flow[number == 0]).max() < 1e-9  # the camera stands still
    # Surfaces of the box by its truth: each pixel's ray meets the box, its point moves with it.
    frame, actor = scene.ground_frame, scene.actors[0]
    view = frame.camera_in_ground(camera)
    footprint = footprint_of(actor, frame, 0.025)
    now, then = (footprint.ground_from_upright(footprint.motion.pose(t))
                 for t in (report.time, report.time + 1 / CONFIG.fps))  # fmt: skip
    rows, columns = np.nonzero(mine)
    rays = np.stack([(columns + 0.5 - view.cx) / view.fx, (rows + 0.5 - view.cy) / view.fy,
                     np.ones(len(rows))], -1) @ view.camera_from_world[:3, :3]  # fmt: skip
    begin = (view.position - now[1]) @ now[0]
    way = rays @ now[0]
    low = np.array([-BOX_SIZE[0] / 2, -BOX_SIZE[1] / 2, 0])
    high = np.array([BOX_SIZE[0] / 2, BOX_SIZE[1] / 2, BOX_SIZE[2]])
    near = np.minimum((low - begin) / way, (high - begin) / way).max(axis=1)
    far = np.maximum((low - begin) / way, (high - begin) / way).min(axis=1)
    met = near < far
    point = begin + near[met, None] * way[met]
    moved = point @ then[0].T + then[1]
    seen = (moved - view.position) @ view.camera_from_world[:3, :3].T
    u = view.fx * seen[:, 0] / seen[:, 2] + view.cx
    v = view.fy * seen[:, 1] / seen[:, 2] + view.cy
    truth = np.stack([u - columns[met] - 0.5, v - rows[met] - 0.5], -1)
    error = np.linalg.norm(flow[rows, columns][met] - truth, axis=1)
    assert met.mean() > 0.9 and np.linalg.norm(truth, axis=1).min() > 2
    assert np.median(error) < 0.1 and np.percentile(error, 95) < 0.5


@pytest.mark.slow
def test_the_mirror_image_lies_where_the_traced_one_does(scene, ground, states, camera):
    calm, light = CONFIG.replace(rate=0.0), {}
    state = replace(states[BEHIND], slopes=np.zeros_like(states[BEHIND].slopes))
    bare = replace(scene, actors=())
    for name, one in (("mirror", scene), ("traced", scene), ("without", bare)):
        renderer = Renderer(one, replace(ground, footprints=()), calm, camera)
        if name == "traced":
            trace_reflections(renderer)
        _, report = renderer.draw(camera, state, None, ("reflection", "coverage"))
        light[name], water = report.aovs["reflection"], report.aovs["coverage"] > 0.5
    image = water & (np.abs(light["traced"] - light["without"]).max(axis=-1) > 0.05)

    def likeness(name, where):
        return -10 * np.log10(np.mean((light[name] - light["traced"])[where] ** 2))

    assert image.sum() > 500
    assert likeness("mirror", water) > 28 and likeness("mirror", image) > 28
    assert likeness("without", image) < 15


def test_a_box_hides_the_streaks_behind_it(scene, ground, states, camera):
    shown = {}
    for name, one in (("with", scene), ("without", replace(scene, actors=()))):
        renderer = Renderer(one, replace(ground, footprints=()), CONFIG, camera)
        _, report = renderer.draw(camera, states[BEHIND], None, ("rain_alpha", "actor_id"))
        shown[name] = report.aovs
    box = shown["with"]["actor_id"] > 0
    assert shown["with"]["rain_alpha"][box].sum() < 0.7 * shown["without"]["rain_alpha"][box].sum()


def test_a_data_set_carries_the_actors(scene, ground, camera):
    from rainsim.datasets import beside, kitti
    from rainsim.datasets.sample import Plan, View
    from rainsim.datasets.shots import Shots
    from rainsim.datasets.user_labels import UserLabels
    from rainsim.render.labels import class_names

    view = View(0, "a", scene.ground_frame.camera_in_ground(camera))
    labelled = replace(scene, actors=(replace(scene.actors[0], label=300),))
    ids = np.full(len(scene.splats), 7, np.uint16)
    own = UserLabels(labelled, ids, CONFIG.render)
    shots = Shots(labelled, ground, [view], CONFIG, False, user_labels=own)
    (sample,) = shots.draw(10.0, [0])
    assert (sample.labels[sample.actor_id == 1] == 300).all()
    assert set(np.unique(sample.labels[sample.actor_id == 0])) <= {7, 255}
    assert (sample.labels == 7).mean() > 0.3
    assert (sample.actor_id == 1).sum() == sample.facts["actors"][0]["pixels"] > 1000
    plan = Plan("a", (view,), (10.0,), False, None, None, class_names())
    files = {f.name: f for f in (*kitti.sample_files(sample, plan),
                                 *beside.sample_files(sample, plan))}  # fmt: skip
    (label,) = [f for name, f in files.items() if "label_2" in name]
    assert label.content.startswith("Misc ") and label.content.count("\n") == 1
    assert any("/actor_id/" in name for name in files)


# --- files ----------------------------------------------------------------------------------------


def test_a_description_is_read_and_a_scene_folder_keeps_it(scene, tmp_path):
    file = described(tmp_path, scene)
    for path in (file, tmp_path):
        found = import_scene(path)
        (actor,) = found.actors
        assert (actor.id, actor.kind) == ("7", "parcel") and found.name == tmp_path.name
        np.testing.assert_allclose(
            actor.splats.position, scene.actors[0].splats.position, atol=1e-6
        )
        np.testing.assert_array_equal(actor.track.position, scene.actors[0].track.position)
    assert load_scene(str(tmp_path)).source_hash == found.source_hash
    described(tmp_path, scene, id=8)
    assert import_scene(tmp_path).source_hash != found.source_hash  # results go by the hash
    series = ColorSeries(np.ones((len(actor.splats), 3, 3), np.float32), 0.0, 2.0)
    other = replace(actor, id="b", series=series, turning=False)
    write_scene(tmp_path / "kept", replace(found, actors=(replace(actor, label=26), other)))
    again = read_scene(tmp_path / "kept").actors
    assert [a.label for a in again] == [26, 255]
    assert [a.id for a in again] == ["7", "b"] and again[0].series is None
    np.testing.assert_array_equal(again[1].series.terms, series.terms)
    assert again[0].turning and not again[1].turning
    np.testing.assert_array_equal(again[0].splats.rotation, actor.splats.rotation)
    np.testing.assert_array_equal(again[1].track.rotation, actor.track.rotation)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"splats": "no.ply"}, "no.ply"),
        ({"splats": 3}, "splats is 3"),
        ({"id": None}, "id is None"),
        ({"box": {"centre": [0, 0, 0], "size": [1, 0, 1]}}, "size above 0"),
        ({"track": {"times": [0, 1], "positions": [[0, 0, 0]], "rotations": []}}, "positions"),
        ({"track": {"times": [1, 0], "positions": [[0, 0, 0]] * 2,
                    "rotations": [[1, 0, 0, 0]] * 2}}, "rise"),
        ({"track": {"times": [0], "positions": [[0, 0, 0]], "rotations": [[1, 0, 0, 0]],
                    "visible": [1]}}, "true or false"),
        ({"track": [1]}, "must be an object"),
        ({"harmonics": "world"}, "node or scene"),
        ({"label": 70000}, "whole number from 0 to 65535"),
    ],
)  # fmt: skip
def test_descriptions_that_are_refused(scene, tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        read_actors(described(tmp_path, scene, **changes))


def test_other_descriptions_that_are_refused(scene, tmp_path):
    file = described(tmp_path, scene)
    good = json.loads(file.read_text(encoding="utf-8"))
    for wrong, message in (
        ({}, "rainsim_actors"), (good | {"nodes": []}, "1 to"), (good | {"scene": "."}, "static"),
        (good | {"nodes": good["nodes"] * 2}, "two actors have the id"),
        (good | {"scene": 1}, "path"),
    ):  # fmt: skip
        file.write_text(json.dumps(wrong), encoding="utf-8")
        with pytest.raises(InputError, match=message):
            import_scene(file)
    write_scene(tmp_path / "kept", scene)
    whole = (tmp_path / "kept/actors.npz").read_bytes()
    (tmp_path / "kept/actors.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="import the scene again"):
        read_scene(tmp_path / "kept")


def test_actors_of_one_name_are_refused(scene):
    with pytest.raises(ParameterError, match="differ; rename one"):
        with_actors(tiny_scene(), scene.actors * 2)
