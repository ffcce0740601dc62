"""Checkpoints of drivestudio: nodes and their tracks, and files that want more than weights."""

import json
import pickle
import zipfile
from collections import OrderedDict

import numpy as np
import pytest

from made_captures import capture_cameras, patio, random_splats, ring, splats_at
from made_checkpoints import (
    Parameter,
    archive_of,
    gaussian_weights,
    node_weights,
    saved_by_torch,
    torch_file,
)
from rainsim.errors import InputError
from rainsim.scene.drivestudio import read_checkpoint
from rainsim.scene.folder import import_scene, read_scene, write_scene
from rainsim.scene.torch_file import read_weights

FRAMES = 6
TURN = [np.cos(0.2), 0, 0, np.sin(0.2)]


def checkpoint(degree_0=False, **changes):
    """What a checkpoint holds, with two cars, one of them seen in frames 1, 2 and 4 only."""
    cars = [random_splats(40, 4, 1), random_splats(30, 4, 2)]
    there = np.ones((FRAMES, 2), bool)
    there[[0, 3, 5], 1] = False
    places = np.zeros((FRAMES, 2, 3))
    places[:, 0, 0], places[:, 1, 1] = np.arange(FRAMES), 2.0 * np.arange(FRAMES)
    places[~there] = 99.0  # means nothing
    turns = np.broadcast_to(np.multiply(TURN, 3.0), (FRAMES, 2, 4)).copy()  # of any length
    sizes = [(4.0, 1.8, 1.5), (5.0, 2.0, 2.5)]
    models = {
        "Background": gaussian_weights(splats_at(patio(3000), 4), degree_0),
        "RigidNodes": node_weights(cars, sizes, places, turns, there, degree_0=degree_0),
        "DeformableNodes": node_weights(
            [random_splats(8, 4, 3)], sizes[:1], places[:, :1], turns[:, :1], there[:, :1],
            degree_0=degree_0,
        ),
        "SMPLNodes": OrderedDict(_means=Parameter(np.zeros((4, 3), np.float32))),
        "Sky": OrderedDict(base=Parameter(np.zeros((6, 2, 2, 3), np.float32))),
    }  # fmt: skip
    return {"models": models | changes, "step": 30000}


def test_nodes_and_their_tracks(tmp_path):
    file = tmp_path / "checkpoint_final.pth"
    file.write_bytes(torch_file(checkpoint()))
    static, actors, notes = read_checkpoint(file, fps=5.0)
    assert len(static) == 3500 and static.sh.shape[1] == 4
    one, two, bent = actors
    assert [a.id for a in actors] == ["RigidNodes-0", "RigidNodes-1", "DeformableNodes-0"]
    assert (one.kind, bent.kind) == ("vehicle", "deformable") and not one.turning
    for actor, splats in ((one, random_splats(40, 4, 1)), (two, random_splats(30, 4, 2))):
        for name in ("position", "scale", "opacity", "sh"):
            wanted = getattr(splats, name)
            np.testing.assert_allclose(getattr(actor.splats, name), wanted, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(two.box, [[0, 0, 0], [5.0, 2.0, 2.5]])
    pose = one.track.at(0.5)  # frame 2.5
    np.testing.assert_allclose(pose.position, [2.5, 0, 0], atol=1e-6)
    np.testing.assert_allclose(pose.rotation[:2, 0], [np.cos(0.4), np.sin(0.4)], atol=1e-6)
    there = [two.track.at(t) is not None for t in (0.1, 0.25, 0.45, 0.65, 0.85, 1.05)]
    assert there == [False, True, True, False, True, False]
    np.testing.assert_allclose(two.track.at(0.8).position, [0, 8, 0], atol=1e-6)
    text = " ".join(notes)
    assert "a network bends them" in text and "a skeleton bends" in text and "Sky: left out" in text


def test_colours_of_degree_0_are_logits(tmp_path):
    file = tmp_path / "a.pth"
    file.write_bytes(torch_file(checkpoint(degree_0=True)))
    _, actors, _ = read_checkpoint(file)
    color = 0.5 + 0.28209479177387814 * random_splats(40, 4, 1).sh[:, 0]
    found = 0.5 + 0.28209479177387814 * actors[0].splats.sh[:, 0]
    np.testing.assert_allclose(found, np.clip(color, 1e-3, 1 - 1e-3), atol=1e-5)


def test_a_checkpoint_becomes_a_scene_folder(tmp_path):
    (tmp_path / "checkpoint_final.pth").write_bytes(torch_file(checkpoint()))
    (tmp_path / "cams.json").write_text(json.dumps(capture_cameras(ring())), encoding="utf-8")
    given = {"cameras": tmp_path / "cams.json", "meters_per_unit": 1.0}
    scene = import_scene(tmp_path / "checkpoint_final.pth", **given)
    slow = import_scene(tmp_path / "checkpoint_final.pth", track_fps=5.0, **given)
    assert len(scene.actors) == 3 and scene.source_hash != slow.source_hash
    assert scene.actors[0].track.time[-1] == pytest.approx(0.5)
    assert slow.actors[0].track.time[-1] == pytest.approx(1.0)
    write_scene(tmp_path / "scene", scene)
    again = read_scene(tmp_path / "scene")
    np.testing.assert_array_equal(again.actors[1].track.visible, scene.actors[1].track.visible)
    assert [a.turning for a in again.actors] == [False] * 3
    for option in ({"tracks": tmp_path}, {"track_fps": 5.0}):  # of models that are not there
        with pytest.raises(InputError, match="leave it out"):
            import_scene(tmp_path / "scene", **option)


def test_a_file_of_torch_itself(tmp_path):
    (tmp_path / "a.pth").write_bytes(saved_by_torch())
    found = read_weights(tmp_path / "a.pth")
    weights = found["models"]["A"]
    np.testing.assert_array_equal(weights["_means"], np.arange(12).reshape(4, 3))
    assert weights["h"].dtype == np.float16 and (weights["h"] == 1).all()
    assert weights["b"].tolist() == [True, False] and found["size"] == (4, 6)
    np.testing.assert_array_equal(found["view"], np.arange(24).reshape(4, 6).T[1:3])
    assert found["step"] == 30000 and found["list"] == [1.5, "a", None]
    assert found["opt"]["lr"] == pytest.approx(0.1)


class Bomb:
    """Would run code if it were unpickled."""

    def __reduce__(self):
        import os

        return os.system, ("touch bomb",)


def test_code_is_refused_and_not_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for index, message in (
        (pickle.dumps({"models": Bomb()}), "asks for 'posix.system'|asks for 'nt.system'"),
        (pickle.dumps(np.float64(3.0)), "asks for 'numpy"),
        (b"cbuiltins\neval\n(S'1'\ntR.", "asks for 'builtins.eval'"),
        (pickle.dumps(print), "builtins.print"),
    ):
        (tmp_path / "a.pth").write_bytes(archive_of(index))
        with pytest.raises(InputError, match=message):
            read_weights(tmp_path / "a.pth")
    assert not (tmp_path / "bomb").exists()


def test_tensors_beyond_their_storage_are_refused(tmp_path):
    whole = torch_file({"a": np.arange(12, dtype=np.float32).reshape(3, 4)})
    (tmp_path / "a.pth").write_bytes(whole)
    np.testing.assert_array_equal(read_weights(tmp_path / "a.pth")["a"],
                                  np.arange(12).reshape(3, 4))  # fmt: skip
    with zipfile.ZipFile(tmp_path / "a.pth") as archive:
        index = archive.read("archive/data.pkl")
    for storages in ([np.zeros(11, np.float32)], []):
        (tmp_path / "b.pth").write_bytes(archive_of(index, storages))
        with pytest.raises(InputError, match="damaged"):
            read_weights(tmp_path / "b.pth")
    packed = archive_of(index, [np.zeros(12, np.float32)], compression=zipfile.ZIP_DEFLATED)
    for content, message in ((packed, "is packed"), (whole[:-30], "no zip"), (b"x", "no zip"),
                             (archive_of(index[:20]), "damaged")):  # fmt: skip
        (tmp_path / "c.pth").write_bytes(content)
        with pytest.raises(InputError, match=message):
            read_weights(tmp_path / "c.pth")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["models"].pop("Background"), "no Background"),
        (lambda d: d.pop("models"), "no models"),
        (lambda d: d["models"]["RigidNodes"].pop("instances_fv"), "instances_fv of RigidNodes"),
        (lambda d: d["models"]["Background"].update(_quats=np.zeros((5, 4), np.float32)), "_quats"),
        (lambda d: d["models"]["RigidNodes"].update(
            points_ids=np.full((70, 1), 9, np.int64)), "beyond 2"),
        (lambda d: d["models"]["RigidNodes"].update(
            instances_quats=np.zeros((FRAMES, 2, 4), np.float32)), "no poses"),
        (lambda d: d["models"]["Background"].update(
            _features_rest=np.zeros((3500, 4, 3), np.float32)), "0, 3, 8 or 15"),
    ],
)  # fmt: skip
def test_checkpoints_that_are_refused(tmp_path, change, message):
    data = checkpoint()
    change(data)
    (tmp_path / "a.pth").write_bytes(torch_file(data))
    with pytest.raises(InputError, match=message):
        read_checkpoint(tmp_path / "a.pth")
