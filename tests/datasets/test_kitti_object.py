"""KITTI's object and tracking layout: clouds, boxes and classes that belong together."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_datasets import plan_with, sample_of

from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.datasets import beside, kitti, kitti_object, semantic_kitti
from rainsim.datasets.data_files import write_file
from rainsim.datasets.sample import Plan, View
from rainsim.datasets.shots import Shots
from rainsim.datasets.splits import held_out
from rainsim.render.labels import class_names
from rainsim.scene.cameras import resize_to
from scenes import moving_scene

RATES = 0.0, 50.0


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A box that drives past the dip, two views that follow each other, dry and in the rain."""
    scene = moving_scene()
    scene = replace(
        scene, actors=tuple(replace(a, kind="car", wheels=np.zeros((0, 5))) for a in scene.actors)
    )
    config = Config.from_preset("downpour").replace(
        past=6e-3, extent=1.0, spacing=0.04, relight="off", fps=2.0
    )
    camera = scene.ground_frame.camera_in_ground(resize_to(scene.cameras[0], 96))
    views = held_out([View(k, f"v{k}", camera) for k in range(2)], 2)
    plan = Plan("yard", views, RATES, True, np.zeros((0, 3), np.float32),
                np.zeros((0, 3), np.uint8), class_names())  # fmt: skip
    terrain = pipeline.extract_terrain(scene, config)
    shots = Shots(scene, terrain, views, config, True, lidar="vlp16")
    folder, samples = tmp_path_factory.mktemp("kitti"), {}
    for rate in RATES:
        for sample in shots.draw(rate, range(2)):
            samples[rate, sample.view.index] = sample
            for file in (*kitti_object.sample_files(sample, plan),
                         *beside.sample_files(sample, plan)):  # fmt: skip
                write_file(folder, file)
    for file in kitti_object.plan_files(plan, folder):
        write_file(folder, file)
    return folder, samples


def points_in(folder, name="000000"):
    """Return points and labels of a cloud, as SemanticKITTI's API splits them."""
    points = np.fromfile(folder / f"training/velodyne/{name}.bin", "<f4").reshape(-1, 4)
    label = np.fromfile(folder / f"training/labels/{name}.label", "<u4")
    assert len(points) == len(label)
    return points, label & 0xFFFF, label >> 16


def calib(folder):
    lines = (folder / "training/calib/000000.txt").read_text().splitlines()
    rows = {k: np.array(v.split(), float) for k, v in (line.split(":") for line in lines)}
    return rows["P2"].reshape(3, 4), rows["Tr_velo_to_cam"].reshape(3, 4)


def test_points_lie_on_what_the_picture_shows(exported):
    """By P2 and Tr_velo_to_cam each point of the dry cloud has the depth of its pixel."""
    folder, samples = exported
    points, kind, node = points_in(folder / "clear")
    projection, turn = calib(folder / "clear")
    place = np.column_stack([points[:, :3], np.ones(len(points))]) @ turn.T
    place = place[place[:, 2] > 0.3]
    u, v, w = (np.column_stack([place, np.ones(len(place))]) @ projection.T).T
    column, row = np.rint(u / w).astype(int), np.rint(v / w).astype(int)
    depth = samples[0.0, 0].depth
    inside = (column >= 0) & (row >= 0) & (column < depth.shape[1]) & (row < depth.shape[0])
    there = depth[row[inside], column[inside]]
    off = np.abs(place[inside, 2] - there) / there
    assert inside.sum() > 100 and np.median(off) < 0.005
    assert {40, 72} & set(kind) and set(kind) <= {0, 1, 10, 40, 72, 252}
    assert set(node) <= {0, 1} and (kind[node == 1] == 252).all()  # it moves


def test_boxes_hold_the_points_of_their_actor(exported):
    """The box in space has them; this camera looks down, KITTI's boxes are upright to it."""
    folder, samples = exported
    points, _, node = points_in(folder / "clear")
    _, turn = calib(folder / "clear")
    text = (folder / "clear/training/label_2/000000.txt").read_text().split()
    assert text[0] == "Car" and 0 <= float(text[1]) < 0.5 and text[2] == "0"
    camera = samples[0.0, 0].view.camera
    own = np.column_stack([points[node == 1][:, :3], np.ones((node == 1).sum())]) @ turn.T
    own = own @ camera.camera_from_world[:3, :3] + camera.position
    box = samples[0.0, 0].facts["actors"][0]["box3d"]
    axes = Rotation.from_quat(box["rotation"], scalar_first=True)
    own = axes.inv().apply(own - box["centre"])
    assert len(own) > 3
    assert (np.abs(own) < np.array(box["size"]) / 2 + 0.02).all(axis=1).mean() > 0.95


def test_drops_are_outliers_in_the_rain_alone(exported):
    folder, _ = exported
    dry, wet = (points_in(folder / place) for place in ("clear", "rain/50mm"))
    assert not (dry[1] == 1).any() and (wet[1] == 1).sum() > 5
    echoes = (wet[1] != 1).sum()  # beams to the sky have drops alone
    assert 0.7 * len(dry[0]) < echoes <= len(dry[0]) < len(wet[0])


def test_tracks_and_lists(exported):
    folder, _ = exported
    lines = (folder / "rain/50mm/training/label_02/0000.txt").read_text().splitlines()
    frames = [line.split() for line in lines]
    assert [f[:3] for f in frames] == [["0", "0", "Car"], ["1", "0", "Car"]]
    assert all(len(f) == 17 for f in frames) and frames[0][13:16] != frames[1][13:16]
    own = (folder / "rain/50mm/training/label_2/000001.txt").read_text().split()
    assert frames[1][6:] == own[4:] or frames[1][5:] == own[3:]
    assert (folder / "clear/ImageSets/train.txt").read_text() == "000000\n"
    assert (folder / "clear/ImageSets/val.txt").read_text() == "000001\n"
    facts = json.loads((folder / "rain/50mm/rainsim/v0.json").read_text())
    assert facts["actors"][0]["hidden"] < 0.1


def test_semantic_kitti_as_its_tools_read_it(exported, tmp_path):
    """By the rules of its generate_sequential.py: Tr and poses lay all clouds in one frame."""
    _, samples = exported
    plan = replace(plan_with(), interval=0.5)
    for sample in (samples[50.0, 0], samples[50.0, 1]):
        for file in semantic_kitti.sample_files(sample, plan):
            write_file(tmp_path, file)
    for file in semantic_kitti.plan_files(plan, tmp_path):
        write_file(tmp_path, file)
    root = tmp_path / "rain/50mm/sequences/00"
    scan = np.fromfile(root / "velodyne/000001.bin", np.float32).reshape(-1, 4)
    label = np.fromfile(root / "labels/000001.label", np.uint32)
    assert len(scan) == len(label) > 100 and 252 in label & 0xFFFF
    assert len(list((root / "image_2").iterdir())) == 2
    root = tmp_path / "rain/10mm/sequences/00"

    def matrix(text):
        return np.vstack([np.array(text.split(), float).reshape(3, 4), (0, 0, 0, 1)])

    rows = dict(line.split(":") for line in (root / "calib.txt").read_text().splitlines())
    assert list(rows) == ["P0", "P1", "P2", "P3", "Tr"]
    turn = matrix(rows["Tr"])
    found = []
    lines = (root / "poses.txt").read_text().splitlines()
    for view, line in zip(plan.views, lines, strict=True):
        point = np.linalg.inv(turn) @ view.camera.camera_from_world @ (1.0, 2.0, 3.0, 1.0)
        found.append(np.linalg.inv(turn) @ matrix(line) @ turn @ point)
    np.testing.assert_allclose(found, np.tile(found[0], (len(found), 1)), atol=1e-6)
    assert not np.allclose(plan.views[0].camera.position, plan.views[1].camera.position)
    np.testing.assert_allclose(np.loadtxt(root / "times.txt"), 0.5 * np.arange(len(plan.views)))
    # KITTI's odometry benchmark has the poses elsewhere, in the same form.
    assert (tmp_path / "rain/10mm/poses/00.txt").read_bytes() == (root / "poses.txt").read_bytes()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_pykitti_reads_a_sequence(exported, tmp_path):
    pykitti = pytest.importorskip("pykitti")
    _, samples = exported
    plan = plan_with()
    plan = replace(plan, views=plan.views[:2], rates=(50.0,), interval=0.5)
    views = plan.views
    for k in range(2):
        for file in semantic_kitti.sample_files(samples[50.0, k], plan):
            write_file(tmp_path, file)
    for file in semantic_kitti.plan_files(plan, tmp_path):
        write_file(tmp_path, file)
    found = pykitti.odometry(tmp_path / "rain/50mm", "00")
    assert len(found) == len(found.poses) == 2
    assert [t.total_seconds() for t in found.timestamps] == [0.0, 0.5]
    first = views[0].camera.camera_from_world
    pose = first @ np.linalg.inv(views[1].camera.camera_from_world)
    np.testing.assert_allclose(found.poses[1], pose, atol=1e-6)
    assert np.linalg.norm(found.poses[1][:3, 3]) > 1e-3
    camera, points = views[0].camera, found.get_velo(0)
    np.testing.assert_allclose(
        found.calib.K_cam2, [[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5],
                             [0, 0, 1]],
    )  # fmt: skip
    np.testing.assert_array_equal(points, samples[50.0, 0].cloud[0])
    np.testing.assert_array_equal(np.array(found.get_cam2(1)), samples[50.0, 1].picture)


def test_occlusion_by_the_share_that_is_hidden():
    assert [kitti.occlusion(h) for h in (None, 0.0, 0.09, 0.3, 0.5, 0.9)] == [3, 0, 0, 1, 2, 2]


def test_torchvision_reads_it(exported, tmp_path):
    datasets = pytest.importorskip("torchvision.datasets")
    folder, samples = exported
    (tmp_path / "Kitti").mkdir()
    (tmp_path / "Kitti/raw").symlink_to(folder / "rain/50mm")
    found = datasets.Kitti(tmp_path, train=True)
    assert len(found) == 2
    for k, path in enumerate(found.images):
        picture, boxes = found[k]
        sample = samples[50.0, int(path[-10:-4])]
        np.testing.assert_array_equal(np.array(picture), sample.picture)
        assert [b["type"] for b in boxes] == ["Car"] and boxes[0]["occluded"] == 0
        left, top, right, bottom = boxes[0]["bbox"]
        rows, columns = np.nonzero(sample.actor_id == 1)
        assert left <= columns.min() + 1 and right >= columns.max() - 1
        assert top <= rows.min() + 1 and bottom >= rows.max() - 1


@pytest.mark.filterwarnings("ignore:The image decoding:DeprecationWarning")
def test_torchvision_reads_the_flow_of_the_other_layout(tmp_path):
    datasets = pytest.importorskip("torchvision.datasets")
    plan = plan_with()
    samples = [sample_of(plan, k) for k in range(3)]
    for sample in samples:
        for file in kitti.sample_files(sample, plan):
            write_file(tmp_path, file)
    (tmp_path / "KittiFlow").symlink_to(tmp_path / "rain/10mm")
    found = datasets.KittiFlow(tmp_path, "train")
    assert len(found) == 2
    for k in range(2):
        first, second, flow, valid = found[k]
        np.testing.assert_array_equal(np.array(first), samples[k].picture)
        np.testing.assert_array_equal(np.array(second), samples[k + 1].picture)
        own = samples[k].flow_mask > 0
        np.testing.assert_array_equal(valid, own)
        off = np.abs(flow.transpose(1, 2, 0) - samples[k].flow)[own]
        assert off.max() < 1 / 64
