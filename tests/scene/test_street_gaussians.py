"""Street Gaussians models: nodes, their colours over time and their tracks, read from files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from made_captures import capture_cameras, patio, random_splats, ring, splats_at
from made_streets import street_ply, write_data
from rainsim.errors import InputError
from rainsim.scene.folder import import_scene
from rainsim.scene.street_gaussians import in_order, read_street_ply

SIZE = (4.2, 1.8, 1.5)  # m
FRAMES, FIRST, LAST = 8, 2, 6  # of the data; those that the model was trained on
HEADING, OFFSET = 0.3, np.array([1200.0, -300.0, 40.0])  # of the vehicle in the world


def vehicle(frame):
    """world_from_vehicle: it drives along its heading, 1 m a frame."""
    c, s = np.cos(HEADING), np.sin(HEADING)
    pose = np.eye(4)
    pose[:3, :3] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    pose[:3, 3] = OFFSET + frame * np.array([c, s, 0])
    return pose


def car(frame):
    """Place and heading of the car in the vehicle's frame."""
    return (6.0 + 0.5 * frame, -2.0, 0.7), 0.1 * frame


@pytest.fixture
def model(tmp_path, rng):
    """A trained model's folder, its data, the car's splats and the terms of their colours."""
    body, terms = random_splats(60, 4, 1), rng.normal(size=(60, 5, 3)).astype(np.float32)
    walker = random_splats(20, 4, 2)
    background = splats_at(patio(3000), 4)
    folder = tmp_path / "model"
    file = folder / "point_cloud/iteration_30000/point_cloud.ply"
    file.parent.mkdir(parents=True)
    file.write_bytes(street_ply([
        ("vertex_background", background, None), ("vertex_obj_007", body, terms),
        ("vertex_obj_012", walker, walker.sh[:, :1]), ("vertex_sky", random_splats(9, 4, 3), None),
    ]))  # fmt: skip
    cameras = [replace(c, name=f"{2 + k % 5:06d}_{k // 5}") for k, c in enumerate(ring(count=10))]
    (folder / "cameras.json").write_text(json.dumps(capture_cameras(cameras)), encoding="utf-8")
    tracks = [(f, 7, "vehicle", SIZE, *car(f)) for f in range(1, FRAMES)]
    tracks += [(f, 12, "pedestrian", (1, 1, 2), (3, 1, 1), 0.0) for f in (3, 4)]
    data = tmp_path / "data"
    times = 1.5e9 + 0.1 * np.arange(FRAMES)
    write_data(data, tracks, [vehicle(f) for f in range(FRAMES)], times.tolist())
    return folder, data, body, terms


def test_nodes_their_colours_and_their_tracks(model):
    folder, data, body, terms = model
    scene = import_scene(folder, tracks=data, meters_per_unit=1.0)
    assert len(scene.splats) == 3509  # with the sky
    car_node, walker = scene.actors
    assert (car_node.id, car_node.kind, walker.kind) == ("7", "vehicle", "pedestrian")
    np.testing.assert_allclose(car_node.box, [[0, 0, 0], SIZE])
    np.testing.assert_allclose(car_node.splats.scale, body.scale, rtol=1e-5)
    np.testing.assert_allclose(car_node.splats.sh[:, 1:], body.sh[:, 1:])
    np.testing.assert_array_equal(car_node.series.terms, terms)
    assert not car_node.turning and walker.series is None
    np.testing.assert_allclose(walker.splats.sh[:, 0], random_splats(20, 4, 2).sh[:, 0])
    # The pose in the middle of the car's frames, from the data by hand.
    middle = np.mean([vehicle(f)[:3, 3] for f in range(FRAMES)], axis=0)
    for frame in (FIRST, 4):
        pose = car_node.track.at(0.1 * (frame - FIRST))
        place, heading = car(frame)
        world = vehicle(frame)
        wanted = world[:3, :3] @ place + world[:3, 3] - middle
        np.testing.assert_allclose(pose.position, wanted, atol=1e-6)
        turn = HEADING + heading
        np.testing.assert_allclose(pose.rotation[:2, 0], [np.cos(turn), np.sin(turn)], atol=1e-9)
    # The series runs over the frames that were trained on: at its middle, cos and sin of pi / 2 j.
    at = car_node.placed(car_node.track.at(0.2), 0.2).sh[:, 0]
    factor = np.array([1, 0, -1, 0, 1])  # 1, sin pi, cos pi, sin 2 pi, cos 2 pi
    np.testing.assert_allclose(at, np.einsum("nmc,m->nc", terms, factor), atol=1e-4)


def test_a_node_is_there_from_just_before_its_first_frame_to_its_last(model):
    folder, data, *_ = model
    walker = import_scene(folder, tracks=data, meters_per_unit=1.0).actors[1]
    there = {t: walker.track.at(t) is not None for t in (-0.5, -0.05, 0.05, 0.15, 0.25, 0.35)}
    assert there == {-0.5: False, -0.05: False, 0.05: True, 0.15: True, 0.25: True, 0.35: False}


def test_without_tracks_the_static_set_is_read(model):
    folder, *_ = model
    scene = import_scene(folder, meters_per_unit=1.0)
    assert scene.actors == () and any("2 actors are left out" in n for n in scene.notes)
    first = [c.name for c in scene.cameras]
    assert first[:6] == ["000002_0", "000003_0", "000004_0", "000005_0", "000006_0", "000002_1"]
    assert [c.name for c in in_order(ring(count=3))] == ["ring00", "ring01", "ring02"]
    with pytest.raises(InputError, match="no model of Street Gaussians"):
        from made_formats import write_splats

        write_splats(folder / "plain.ply", splats_at(patio(3000)))
        import_scene(folder / "plain.ply", tracks=folder, up=(0, 0, 1), meters_per_unit=1.0)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("track/track_info.txt", lambda t: t.replace("vehicle", ""), "line 2 is"),
        ("track/track_info.txt", lambda t: t.splitlines()[0], "has no tracks"),
        ("track/track_info.txt", lambda t: t + t.splitlines()[3] + "\n", "twice in one frame"),
        ("timestamps.json", lambda t: t.replace("FRAME", "CLOCK"), "lacks FRAME"),
        ("timestamps.json", lambda t: t.replace("000004", "000014"), "no time or no pose"),
        ("ego_pose/000004.txt", lambda t: t.replace("e", "x"), "no 4 x 4 numbers"),
        ("ego_pose/000004.txt", lambda t: "0 " * 16, "is no pose"),
        ("ego_pose/000004.txt", lambda t: "-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1", "not mirrored"),
        ("ego_pose/000004.txt", lambda t: "1 0 0 1e300 0 1 0 0 0 0 1 0 0 0 0 1", "no 4 x 4"),
    ],
)
def test_data_that_are_refused(model, name, change, message):
    folder, data, *_ = model
    path = data / name
    path.write_text(change(path.read_text()), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        import_scene(folder, tracks=data, meters_per_unit=1.0)


def test_models_that_are_refused_or_cut(tmp_path):
    back, node = ("vertex_background", random_splats(40), None), random_splats(5)
    file = tmp_path / "a.ply"
    for elements, message in (
        ([back, ("vertex_obj_x", node, None)], "must end in the number"),
        ([back, ("vertex_obj_1", node, None), ("vertex_obj_001", node, None)], "once"),
        ([back, ("vertex_obj_1", replace(node, scale=node.scale * np.nan), None)], "NaN"),
    ):
        file.write_bytes(street_ply(elements))
        with pytest.raises(InputError, match=message):
            read_street_ply(file)
    whole = street_ply([back, ("vertex_obj_1", node, None)])
    file.write_bytes(whole[:-40])
    with pytest.raises(InputError, match="truncated"):
        read_street_ply(file)
    file.write_bytes(whole.replace(b"f_dc_2", b"f_dc_9"))
    with pytest.raises(InputError, match="f_dc_2"):
        read_street_ply(file)
    file.write_bytes(street_ply([back, ("vertex_lamp", node, None)]))
    assert "lamp is not known" in " ".join(read_street_ply(file).notes)
