"""`rainsim lidar`, end to end on a tiny scene."""

import json
from functools import partial

import numpy as np
import pytest

from rainsim.scene.folder import write_scene
from rainsim.sensors.drive import LidarFolder
from scenes import moving_scene

MAP = ["--spacing", "0.04", "--extent", "1"]


@pytest.fixture
def lidar(rainsim, scene_folder):
    """Return a function that scans the tiny scene into the folder `out`."""
    return partial(rainsim, "lidar", scene_folder, *MAP, "--out")


def test_turns_clear_and_in_rain(lidar, tmp_path):
    words = "--sensor", "hdl32", "--turns", "2", "--speed", "2", "--height", "0.8"
    done = lidar("turns", "--rain", "0,50", *words)
    assert done.code == 0, done.err
    folder = tmp_path / "turns"
    card = json.loads((folder / "lidar.json").read_text())
    assert [rain["folder"] for rain in card["rains"]] == ["clear", "rain/50mm"]
    assert card["rainsim_lidar"] == 1
    clear, rain = (entry["points"] for entry in card["rains"])
    assert clear["scattered"] == 0 and rain["scattered"] > 0 and clear["kept"] > 500
    assert sum(rain.values()) == 2 * 32 * 2170
    share = card["rains"][1]["scattered_share"]
    assert 0.5 < share / card["rains"][1]["scattered_share_by_lisa"] < 2
    points = np.fromfile(folder / "rain/50mm/velodyne/000001.bin", "<f4").reshape(-1, 4)
    labels = np.fromfile(folder / "rain/50mm/labels/000001.label", "<u4")
    assert len(points) == len(labels) and set(np.unique(labels)) <= {1, 2, 3}
    assert np.linalg.norm(points[labels == 1, :3], axis=1).max() < 6  # drops near by
    poses = np.loadtxt(folder / "poses.txt").reshape(2, 3, 4)
    assert np.linalg.norm(poses[1, :, 3] - poses[0, :, 3]) == pytest.approx(0.2)
    assert poses[0, 2, 3] == pytest.approx(0.8)
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert names == {*card["files"], "lidar.json"}


def test_only_turns_are_replaced(lidar, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("keep")
    for option in ((), ("--overwrite",)):
        done = lidar("mine", "--rain", "10", *option)
        assert done.code == 2 and ("not empty" in done.err or "holds notes.txt" in done.err)
    assert lidar("turns", "--rain", "10", "--format", "ply").code == 0
    (tmp_path / "turns/notes.txt").write_text("keep")
    done = lidar("turns", "--rain", "25", "--format", "pcd", "--overwrite")
    assert done.code == 0, done.err
    left = {p.relative_to(tmp_path / "turns").as_posix() for p in (tmp_path / "turns").rglob("*.*")}
    assert "notes.txt" in left and "rain/25mm/points/000000.pcd" in left
    assert not any("10mm" in name for name in left)


@pytest.mark.parametrize(
    "words, message",
    [(("--rain", "x"), "--rain is 'x'"), (("--speed", "500"), "--speed is 500"),
     (("--height", "1e300"), "--height is 1e+300 m; it must lie"),
     (("--camera", "nobody"), "has no camera 'nobody'")],
)  # fmt: skip
def test_wrong_options_are_named(lidar, words, message):
    done = lidar("out", *words)
    assert done.code == 2 and message in done.error


def test_actors_are_numbered_in_labels_and_have_boxes(rainsim, tmp_path):
    write_scene(tmp_path / "moving", moving_scene())
    done = rainsim("lidar", "moving", *MAP, "--out", "turns", "--rain", "0,50", "--turns", "2",
                   "--height", "0.6")  # fmt: skip
    assert done.code == 0, done.err
    card = json.loads((tmp_path / "turns/lidar.json").read_text())
    (node,) = card["nodes"]
    assert (node["number"], node["track"], node["class"]) == (1, "box", "parcel")
    first, second = (np.array(box["centre"]) for box in node["box3d"])
    assert np.linalg.norm(second - first) == pytest.approx(0.1, rel=0.01)  # 1 m/s
    label = np.fromfile(tmp_path / "turns/rain/50mm/labels/000001.label", "<u4")
    point = np.fromfile(tmp_path / "turns/rain/50mm/velodyne/000001.bin", "<f4").reshape(-1, 4)
    on = label >> 16 == 1
    assert on.sum() > 20 and set(np.unique(label & 0xFFFF)) <= {1, 2, 3}
    pose = np.loadtxt(tmp_path / "turns/poses.txt").reshape(-1, 3, 4)[1]
    place = point[on, :3] @ pose[:, :3].T + pose[:, 3]
    assert np.linalg.norm(place - second, axis=1).max() < 0.5


def test_an_interrupted_scan_goes_on_or_is_replaced(lidar, tmp_path, monkeypatch):
    words = "--turns", "2", "--rain", "0,50"
    assert lidar("whole", *words).code == 0
    add, added = LidarFolder.add, []

    def until_the_third(self, number, *more):
        added.append(number)
        if len(added) == 3:
            raise KeyboardInterrupt
        add(self, number, *more)

    monkeypatch.setattr(LidarFolder, "add", until_the_third)
    assert lidar("out", *words).code == 130
    assert not json.loads((tmp_path / "out/lidar.json").read_text())["complete"]
    assert lidar("out", *words).code == 2
    other = lidar("out", *words, "--speed", "1", "--resume")
    assert other.code == 2 and "was another" in other.error
    (tmp_path / "out/clear/labels/000000.label").write_bytes(b"damaged")
    (tmp_path / "out/clear/velodyne/.000001.bin.abcd1234.bin").write_bytes(b"half")
    done = lidar("out", *words, "--resume")
    assert done.code == 0 and added == [0, 1, 2, 0, 2, 3], done.err
    assert without_times(tmp_path / "out") == without_times(tmp_path / "whole")

    added[:] = []
    assert lidar("again", *words).code == 130
    done = lidar("again", "--rain", "0", "--format", "ply", "--overwrite")
    assert done.code == 0, done.err
    left = {p.relative_to(tmp_path / "again").as_posix() for p in (tmp_path / "again").rglob("*.*")}
    assert left == {"lidar.json", "turns.jsonl", "poses.txt", "clear/points/000000.ply"}


def without_times(folder):
    """The files of a scan; of its card what does not name the command."""
    card = json.loads((folder / "lidar.json").read_text())
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    content = {n: (folder / n).read_bytes() for n in names - {"lidar.json", "turns.jsonl"}}
    return content, {name: card[name] for name in card if name != "command"}
