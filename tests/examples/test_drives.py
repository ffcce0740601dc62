"""Models of Street Gaussians and drivestudio: nodes, their colours over time and their tracks."""

import importlib
import json
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from made_captures import capture_cameras, patio, random_splats, ring, splats_at
from made_drives import gaussian_weights, node_weights, street_ply, write_data
from rainsim.cli import cli
from rainsim.scene.folder import read_scene

FOLDER = Path(__file__).resolve().parents[2] / "examples/drives"
SIZE = (4.2, 1.8, 1.5)  # m
FRAMES, FIRST, LAST = 8, 2, 6  # of the data; those that the model was trained on
HEADING, OFFSET = 0.3, np.array([1200.0, -300.0, 40.0])  # of the vehicle in the world
TURN = [np.cos(0.2), 0, 0, np.sin(0.2)]


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


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Return a function from the words of the example to the scene that it writes."""
    monkeypatch.syspath_prepend(FOLDER)

    def made(*words):
        out = tmp_path / "drive"
        importlib.import_module("convert").main([*map(str, words), "--out", str(out)])
        return read_scene(out)

    yield made
    for path in FOLDER.glob("*.py"):
        sys.modules.pop(path.stem, None)


def test_nodes_their_colours_and_their_tracks(model, made):
    folder, data, body, terms = model
    scene = made(folder, "--tracks", data)
    assert len(scene.splats) == 3509  # with the sky
    first = [c.name for c in scene.cameras]
    assert first[:6] == ["000002_0", "000003_0", "000004_0", "000005_0", "000006_0", "000002_1"]
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
    there = {t: walker.track.at(t) is not None for t in (-0.5, -0.05, 0.05, 0.15, 0.25, 0.35)}
    assert there == {-0.5: False, -0.05: False, 0.05: True, 0.15: True, 0.25: True, 0.35: False}


def test_without_tracks_the_static_set_is_written(model, made, capsys):
    scene = made(model[0])
    assert scene.actors == () and len(scene.splats) == 3509
    assert "without tracks: vertex_obj_007, vertex_obj_012" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("track/track_info.txt", lambda t: t.replace("vehicle", "")),
        ("timestamps.json", lambda t: t.replace("000004", "000014")),
        ("ego_pose/000004.txt", lambda t: t.replace("e", "x")),
    ],
)
def test_data_that_are_refused(model, made, name, change, capsys):
    path = model[1] / name
    path.write_text(change(path.read_text()), encoding="utf-8")
    with pytest.raises(SystemExit):
        made(model[0], "--tracks", model[1])
    assert "cannot be read: " in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("degree_0", [False, True])
def test_a_checkpoint(tmp_path, monkeypatch, made, degree_0, capsys):
    """Two cars, one of them seen in frames 1, 2 and 4 only; degree 0 holds logits of colours."""
    cars = [random_splats(40, 4, 1), random_splats(30, 4, 2)]
    there = np.ones((6, 2), bool)
    there[[0, 3, 5], 1] = False
    places = np.zeros((6, 2, 3))
    places[:, 0, 0], places[:, 1, 1] = np.arange(6), 2.0 * np.arange(6)
    places[~there] = 99.0  # means nothing
    turns = np.broadcast_to(np.multiply(TURN, 3.0), (6, 2, 4))  # of any length
    sizes = [(4.0, 1.8, 1.5), (5.0, 2.0, 2.5)]
    bent = [random_splats(8, 4, 3)], sizes[:1], places[:, :1], turns[:, :1], there[:, :1]
    models = {
        "Background": gaussian_weights(splats_at(patio(3000), 4), degree_0),
        "RigidNodes": node_weights(cars, sizes, places, turns, there, degree_0=degree_0),
        "DeformableNodes": node_weights(*bent, degree_0=degree_0),
        "SMPLNodes": {"_means": np.zeros((4, 3), np.float32)},
    }
    reader = importlib.import_module("drivestudio")
    monkeypatch.setattr(reader, "weights_of", lambda file: models)  # as torch reads them
    file, cameras = tmp_path / "checkpoint_final.pth", tmp_path / "cams.json"
    file.write_bytes(b"PK")
    cameras.write_text(json.dumps(capture_cameras(ring())), encoding="utf-8")
    words = [file, "--cameras", cameras, "--fps", 5]
    scene = made(*words)
    one, two, bent = scene.actors
    assert len(scene.splats) == 3500 and len(scene.cameras) == len(ring())
    assert [a.id for a in scene.actors] == ["RigidNodes-0", "RigidNodes-1", "DeformableNodes-0"]
    assert (one.kind, bent.kind, one.turning) == ("vehicle", "deformable", False)
    for actor, splats in ((one, cars[0]), (two, cars[1])):
        for name in ("position", "scale", "opacity") if degree_0 else ("position", "scale", "sh"):
            wanted = getattr(splats, name)
            np.testing.assert_allclose(getattr(actor.splats, name), wanted, rtol=1e-4, atol=1e-6)
    color, found = (0.5 + 0.28209479177387814 * s.sh[:, 0] for s in (cars[0], one.splats))
    np.testing.assert_allclose(found, np.clip(color, 1e-3, 1 - 1e-3) if degree_0 else color,
                               atol=1e-5)  # fmt: skip
    np.testing.assert_allclose(two.box, [[0, 0, 0], [5.0, 2.0, 2.5]])
    pose = one.track.at(0.5)  # frame 2.5
    np.testing.assert_allclose(pose.position, [2.5, 0, 0], atol=1e-6)
    np.testing.assert_allclose(pose.rotation[:2, 0], [np.cos(0.4), np.sin(0.4)], atol=1e-6)
    seen = [two.track.at(t) is not None for t in (0.1, 0.25, 0.45, 0.65, 0.85, 1.05)]
    assert seen == [False, True, True, False, True, False]
    np.testing.assert_allclose(two.track.at(0.8).position, [0, 8, 0], atol=1e-6)
    said = capsys.readouterr().out
    assert "SMPLNodes is left out" in said and "0 nodes in no frame" in said
    del models["Background"]
    with pytest.raises(SystemExit):
        made(*words)
    assert "no background" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--info", "--lod", "--quiet"])
def test_the_program_names_the_example(tmp_path, option):
    """In one line, which begins with what the file is."""
    (tmp_path / "a.ply").write_bytes(street_ply([("vertex_background", random_splats(9), None)]))
    with zipfile.ZipFile(tmp_path / "a.pth", "w") as archive:
        archive.writestr("checkpoint_final/data.pkl", b".")
    for name, what in (("a.ply", "a model of Street Gaussians"), ("a.pth", "a checkpoint")):
        words = ["import", str(tmp_path / name), option]
        words += [] if option == "--info" else ["--out", str(tmp_path / "out"), "--overwrite"]
        result = CliRunner().invoke(cli, words)
        last = result.output.strip().splitlines()[-1]
        assert result.exit_code == 1, result.output
        assert f"{name} is {what}" in last and "examples/drives/convert.py" in last
