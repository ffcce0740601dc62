"""Rigs: each sensor at its place and times, all in one rain; calibration and layouts agree."""

import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.datasets import beside, colmap, kitti, kitti_object, nerfstudio, semantic_kitti
from rainsim.datasets.data_files import write_file
from rainsim.datasets.rig_shots import RigShots, check_rig, offset_notes, rig_views
from rainsim.datasets.sample import Plan
from rainsim.datasets.splits import held_out, lists_of
from rainsim.errors import InputError, ParameterError
from rainsim.render.labels import class_names
from rainsim.render.shutter import moved
from rainsim.sensors.rig import read_rig
from scenes import moving_scene

SIZE = "width = 128\nheight = 96\nfov = 60\n"
RIG = f"""
[vehicle]
path_camera = [0.2, 0, 1.0]
[[camera]]
name = "left"
at = [0.2, 0.03, 1.0]
look = [0, -40, 0]
{SIZE}
[[camera]]
name = "right"
at = [0.2, -0.03, 1.0]
look = [0, -40, 0]
{SIZE}
[[camera]]
name = "side"
at = [0.2, -0.1, 1.0]
look = [-10, -45, 5]
rate = 4
offset = 125
lens = "opencv:-0.1,0.02,0.001,0.002"
{SIZE}
[[lidar]]
name = "top"
sensor = "vlp16"
at = [0.0, 0.0, 1.1]
look = [0, -40, 0]
"""
FPS, RATES = 2.0, (0.0, 100.0)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Return rig, plan, samples and clouds by rate and name, and the folder of their files."""
    folder, scene = tmp_path_factory.mktemp("rig"), moving_scene()
    (folder / "rig.toml").write_text(RIG)
    rig = read_rig(folder / "rig.toml", FPS)
    config = Config.from_preset("downpour").replace(
        past=6e-3, extent=1.0, spacing=0.04, relight="off", fps=FPS
    )
    first = scene.ground_frame.camera_in_ground(scene.cameras[0])
    path = [moved(first, k * np.array([0.1, 0.05, 0]), np.zeros(3)) for k in range(2)]
    views, turns = rig_views(rig, path, FPS)
    plan = Plan("yard", held_out(views, 2), RATES, True, np.zeros((0, 3), np.float32),
                np.zeros((0, 3), np.uint8), class_names(), rig=rig, turns=turns)  # fmt: skip
    terrain = pipeline.extract_terrain(scene, config)
    shots, found = RigShots(scene, terrain, plan, config, partners=True), {}
    for rate in RATES:
        for sample in shots.draw(rate, range(len(plan.parts))):
            found[rate, sample.view.name] = sample
            if sample.view in plan.turns:
                files = [*kitti_object.cloud_files(sample, plan)]
            else:
                files = [*kitti_object.sample_files(sample, plan),
                         *beside.sample_files(sample, plan)]  # fmt: skip
            for file in files:
                write_file(folder, file)
    for file in (*kitti_object.plan_files(plan, folder), *beside.plan_files(plan)):
        write_file(folder, file)
    return rig, plan, found, folder


def test_each_sensor_has_its_own_times(drawn):
    rig, plan, found, folder = drawn
    times = {}
    for view in plan.parts:
        times.setdefault(view.mount.name, []).append(view.time)
    assert times == {"left": [0, 0.5], "right": [0, 0.5], "top": [0, 0.5],
                     "side": [0.125, 0.375, 0.625, 0.875]}  # fmt: skip
    assert rig.step() == Fraction(1, 8)
    assert set(found) == {(rate, view.name) for rate in RATES for view in plan.parts}
    # Where the box that moves is says when a picture was taken.
    place = {v.time: found[100.0, v.name].facts["actors"][0]["box3d"]["centre"][0]
             for v in plan.views}  # fmt: skip
    when = sorted(place)
    assert np.ptp(np.diff([place[t] for t in when]) / np.diff(when)) < 1e-4
    about = json.loads((folder / "rain/100mm/rainsim/side_000002.json").read_text())
    assert (about["sensor"], about["time_s"]) == ("side", 0.625)


def test_pictures_of_one_time_are_in_one_list(drawn):
    _, plan, *_ = drawn
    train, val, test = lists_of(plan.views)
    parts = [{view.time for view in part} for part in (train, val, test)]
    assert not parts[0] & parts[2] and not parts[1] and len(train) == len(test) == 4


def seen_at(view, places):
    """Return pixels (n, 2) of places in the ground frame, through the lens, and their depths."""
    camera = view.camera
    x, y, z = (places @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]).T
    ahead = z > 0.2
    x, y, z = (part[ahead] for part in (x, y, z))
    x, y = x / z, y / z
    near = np.hypot(x, y) < 1
    x, y, z = x[near], y[near], z[near]
    x, y = (x, y) if view.lens is None else view.lens.distort(x, y)
    return np.column_stack([camera.fx * x + camera.cx, camera.fy * y + camera.cy]), z


def depth_off(sample, places):
    """Return how far depths of places are from those of their pixels, a share of them."""
    pixel, z = seen_at(sample.view, places)
    column, row = np.floor(pixel).astype(int).T
    height, width = sample.depth.shape
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    assert inside.sum() > 50
    return np.abs(z[inside] / sample.depth[row[inside], column[inside]] - 1)


def test_points_of_the_lidar_have_the_depths_of_each_camera(drawn):
    _, _, found, _ = drawn
    cloud = found[0.0, "top_000000"]
    turn = cloud.view.ground_from_sensor
    places = cloud.cloud[0][:, :3] @ turn[:3, :3].T + turn[:3, 3]
    places = places[cloud.cloud[1] >> 16 == 0]  # what stands
    for name in ("left_000000", "right_000000", "side_000000"):
        sample = found[0.0, name]
        assert np.median(depth_off(sample, places)) < 0.006
        lifted = np.median(depth_off(sample, places + np.array([0, 0, 0.05])))
        assert lifted > 0.03, "a lidar that is 5 cm too high is found out"


def test_kittis_projections_and_boxes_are_of_one_frame(drawn):
    _, _, found, folder = drawn
    text = (folder / "clear/training/calib/000000.txt").read_text()
    rows = {k: np.array(v.split(), float) for k, v in (r.split(":") for r in text.splitlines())}
    points = np.fromfile(folder / "clear/training/velodyne/000000.bin", "<f4").reshape(-1, 4)
    first = np.column_stack([points[:, :3], np.ones(len(points))])
    first = first @ rows["Tr_velo_to_cam"].reshape(3, 4).T
    first = np.column_stack([first, np.ones(len(first))])[first[:, 2] > 0.3]
    for channel, name in ((2, "left_000000"), (3, "right_000000")):
        u, v, w = (first @ rows[f"P{channel}"].reshape(3, 4).T).T
        column, row = np.rint(u / w).astype(int), np.rint(v / w).astype(int)
        depth = found[0.0, name].depth
        inside = (column >= 0) & (row >= 0) & (column < 128) & (row < 96)
        off = np.abs(w[inside] / depth[row[inside], column[inside]] - 1)
        assert inside.sum() > 50 and np.median(off) < 0.006
    baseline = (rows["P3"] - rows["P2"])[3] / rows["P2"][0]
    assert baseline == pytest.approx(-0.06)
    # The same thing at the same time has the same place in all cameras' boxes.
    left, right = ((folder / f"clear/training/label_{k}/000000.txt").read_text().split()
                   for k in (2, 3))  # fmt: skip
    np.testing.assert_allclose(np.array(left[8:15], float), np.array(right[8:15], float), atol=2e-4)
    assert left[4:8] != right[4:8] and left[2] != "3"


def falling(sample):
    """Return what falls, (height, width), as a change of the picture."""
    change = sample.picture.astype(float) - sample.partners["clear_air"]
    return change.mean(axis=2)


def agreement(first, second):
    """Return the mean correlation of the strongest streaks with their best place in a row."""
    found, rows = [], slice(12, 84)
    strongest = np.argsort(-np.abs(first[rows, 45:120]).ravel())[:2000:50]
    for where in strongest:
        row, column = divmod(int(where), 75)
        row, column = row + 12, column + 45
        patch = first[row - 8 : row + 9, column - 2 : column + 3].ravel()
        best = 0.0
        for shift in range(41):
            other = second[row - 8 : row + 9, column - 2 - shift : column + 3 - shift].ravel()
            if other.std() > 0 and patch.std() > 0:
                best = max(best, np.corrcoef(patch, other)[0, 1])
        found.append(best)
    return float(np.mean(found))


def test_a_stereo_pair_sees_the_same_drops(drawn):
    _, _, found, _ = drawn
    left, right, later = (falling(found[100.0, name])
                          for name in ("left_000000", "right_000000", "right_000001"))  # fmt: skip
    same, other = agreement(left, right), agreement(left, later)
    assert same > 0.5 and same > other + 0.15, (same, other)


def test_flow_leads_to_the_next_picture_of_the_same_camera(drawn):
    _, _, found, _ = drawn
    for before, after in (("left_000000", "left_000001"), ("right_000000", "right_000001")):
        sample, following = found[0.0, before], found[0.0, after].view
        camera = sample.view.camera
        row, column = np.mgrid[30:90:7, 20:110:9].reshape(2, -1)
        known = np.isfinite(sample.depth[row, column])
        row, column = row[known], column[known]
        z = sample.depth[row, column].astype(float)
        x = (column + 0.5 - camera.cx) / camera.fx * z
        y = (row + 0.5 - camera.cy) / camera.fy * z
        back = np.linalg.inv(camera.camera_from_world)
        places = np.column_stack([x, y, z]) @ back[:3, :3].T + back[:3, 3]
        stands = (sample.actor_id[row, column] == 0) & (sample.flow_mask[row, column] > 0)
        own = sample.flow[row, column][stands]
        pixel, _ = seen_at(following, places[stands])
        wanted = pixel - np.column_stack([column, row])[stands] - 0.5
        assert stands.sum() > 20 and np.median(np.abs(own - wanted)) < 0.05
        assert np.median(np.abs(own)) > 1


def test_colmaps_frames_hold_the_pictures_of_one_time(drawn, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    _, plan, *_ = drawn
    for file in colmap.plan_files(plan, None):
        write_file(tmp_path, file)
    found = pycolmap.Reconstruction(str(tmp_path / "clear/sparse/0"))
    assert len(found.rigs) == 1 and len(found.cameras) == 3 and len(found.frames) == 6
    by_name = {image.name: image for image in found.images.values()}
    for view in plan.views:
        pose = by_name[f"{view.name}.png"].cam_from_world().matrix()
        np.testing.assert_allclose(pose, view.camera.camera_from_world[:3], atol=1e-9)


def test_nerfstudio_has_a_lens_for_each_view(drawn):
    _, plan, *_ = drawn
    frames = nerfstudio.transforms(plan)["frames"]
    assert [frame.get("k1") for frame in frames] == [None] * 4 + [-0.1] * 4


def test_other_layouts_of_kitti(drawn):
    """The flow benchmark has flow of its left camera; SemanticKITTI has the same calibration."""
    _, plan, found, folder = drawn
    named = {f.name for n in ("left_000000", "right_000001")
             for f in kitti.sample_files(found[0.0, n], plan)}  # fmt: skip
    place = "clear/training"
    wanted = {"image_2/000000_10.png", "calib/000000.txt", "image_3/000001_10.png",
              "image_3/000000_11.png", "flow_occ/000000_10.png", "flow_noc/000000_10.png",
              "label_2/000000.txt", "label_3/000001.txt",
              "proj_depth/groundtruth/image_02/000000_10.png",
              "proj_depth/groundtruth/image_03/000001_10.png"}  # fmt: skip
    assert named == {f"{place}/{name}" for name in wanted}
    files = {f.name: f.content for f in semantic_kitti.plan_files(plan, None)}
    rows = files["clear/sequences/00/calib.txt"].splitlines()
    own = (folder / place / "calib/000000.txt").read_text().splitlines()
    assert rows == [*own[:4], own[5].replace("Tr_velo_to_cam", "Tr")]
    assert np.fromstring(files["clear/sequences/00/times.txt"], sep="\n").tolist() == [0, 0.5]
    assert len(files["clear/sequences/00/poses.txt"].splitlines()) == 2
    cloud = {f.name for f in semantic_kitti.cloud_files(found[0.0, "top_000001"], plan)}
    assert "clear/sequences/00/velodyne/000001.bin" in cloud


def test_the_calibration_lies_beside(drawn):
    _, plan, _, folder = drawn
    data = json.loads((folder / "rig.json").read_text())
    kinds = [(s["name"], s["kind"], s["rate_hz"], s["offset_s"]) for s in data["sensors"]]
    assert kinds == [("left", "camera", 2, 0), ("right", "camera", 2, 0),
                     ("side", "camera", 4, 0.125), ("top", "lidar", 2, 0)]  # fmt: skip
    channels = [kitti.channel_of(v, plan) for v in plan.views if v.frame == 0]
    assert channels == [2, 3, 0] and data["sensors"][2]["lens"]["model"] == "opencv"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "right"', 'name = "left"', "two sensors named left"),
        ('name = "right"', 'name = "../x"', "name is '../x'; it must be a word"),
        ("fov = 60", "fov = 60\nfocal = [9, 9]", "fov is 60; it must be given, or focal"),
        ("offset = 125", "offset = 0.125\nrate = 7", "TOML"),
        ("offset = 125", "offset = 125.3", "common step of 0.1 ms; it must be 1 ms"),
        ('sensor = "vlp16"', 'sensor = "x"', "sensor is 'x'; it must be one of vlp16"),
        ("at = [0.0, 0.0, 1.1]", "at = [0.0, 0.0]", "at is .* finite numbers of shape 3"),
        ("[[lidar]]", "[[sonar]]", "table 'sonar'; no rig has one"),
        ("rate = 4", "rats = 4", "key 'rats'; the nearest is 'rate'"),
    ],
)
def test_what_is_no_rig(tmp_path, old, new, message):
    (tmp_path / "rig.toml").write_text(RIG.replace(old, new, 1))
    with pytest.raises((InputError, ParameterError), match=message):
        read_rig(tmp_path / "rig.toml", FPS)


def test_no_number_of_kitti_lacks_a_cloud(drawn):
    """A lidar that begins late has no turn for the last picture: nobody has a number for that."""
    rig, plan, *_ = drawn
    early, late = (
        replace(rig, sensors=(*rig.sensors[:2], replace(rig.lidars[0], offset=Fraction(offset))))
        for offset in ("1/4", "3/5")
    )
    path = [view.camera for view in plan.views[:2]]
    for layout, pictures in (("kitti_object", 1), ("semantic_kitti", 1), ("colmap", 2)):
        views, turns = rig_views(late, path, FPS, layout)
        assert [len(views), len(turns)] == [2 * pictures, 1]
        assert {turn.frame for turn in turns} <= {view.frame for view in views}
        views, turns = rig_views(early, path, FPS, layout)
        assert [len(views), len(turns)] == [4, 2]
    (told,) = offset_notes(early, "kitti_object")
    assert "begin 0 to 250 ms after" in told and told.startswith("WARNING")
    alike = replace(rig, sensors=(*rig.sensors[:2], rig.lidars[0]))
    assert offset_notes(early, "colmap") == offset_notes(alike, "kitti_object") == []


def test_layouts_say_which_rigs_they_hold(drawn):
    rig, *_ = drawn
    with pytest.raises(ParameterError, match="layout is acdc; with --rig it must be one of"):
        check_rig(rig, "acdc")
    with pytest.raises(ParameterError, match="rates of 2, 4/s; in the layout kitti"):
        check_rig(rig, "kitti")
    check_rig(rig, "colmap")
    bent = replace(rig.cameras[2], lens=replace(rig.cameras[2].lens, model="fisheye"))
    with pytest.raises(ParameterError, match="fisheyes and other lenses"):
        check_rig(replace(rig, sensors=(*rig.sensors[:2], bent)), "nerfstudio")
