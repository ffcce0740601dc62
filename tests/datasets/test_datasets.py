"""Data sets: encodings and layouts by their published rules."""

import io
import json
import os
import struct
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.stored_views import read_points, read_views
from rainsim.config.settings import Config
from rainsim.datasets import (
    LAYOUTS,
    acdc,
    beside,
    colmap,
    kitti,
    nerfstudio,
    replicator,
)
from rainsim.datasets.card import card_of, card_text
from rainsim.datasets.data_files import PNG48, DataFile, condition, write_file
from rainsim.datasets.export import check_lenses, layout_of, safe_names
from rainsim.datasets.points import ply_bytes, points_of
from rainsim.datasets.sample import Plan, Sample, View, depth_mm, keep_mask, kitti_depth, kitti_flow
from rainsim.datasets.splits import held_out
from rainsim.datasets.user_labels import read_labels
from rainsim.errors import InputError, ParameterError
from rainsim.io import images
from rainsim.render.labels import class_names
from rainsim.render.shutter import moved
from rainsim.scene.colmap import read_model
from rainsim.scene.types import Camera
from rainsim.sensors.lens import Lens
from rainsim.sensors.lens_files import lens_named
from scenes import tiny_scene

CAMERA = Camera(40, 30, 35.0, 36.0, 19.0, 16.0, np.eye(4), "a.jpg")
RENDER = Config().render
POINT = np.array([0.4, -0.3, 2.5])  # in the frame of the first camera


def plan_with(lens=None, count=3):
    cameras = [moved(CAMERA, k * np.array([0.1, 0.2, 0]), np.array([0.1, 0.3 * k, 0.2]))
               for k in range(count)]  # fmt: skip
    views = [View(k, f"v{k}", camera, lens) for k, camera in enumerate(cameras)]
    places = np.array([[1, 2, 3], [4, 5, 6]], np.float32)
    colors = np.array([[9, 8, 7], [255, 0, 1]], np.uint8)
    return Plan("yard", held_out(views, 3), (0.0, 10.0), True, places, colors, class_names())


def sample_of(plan, index=0, rate=10.0, **more):
    shape = (30, 40)
    rng = np.random.default_rng(3)
    depth = rng.uniform(1, 90, shape).astype(np.float32)
    depth[0] = np.inf
    ids = np.full(shape, 255, np.uint16)
    ids[10:20], ids[20:25] = 0, 4
    puddles = np.where(ids == 4, np.uint16(7), np.uint16(0))
    flow = rng.normal(0, 20, (*shape, 2)).astype(np.float32)
    mask = rng.integers(0, 4, shape).astype(np.uint16)
    facts = {"weather": {}, "puddles": [{"id": 7, "box": [0, 20, 40, 25], "pixels": 200}]}
    return Sample(
        plan.views[index], rate, rng.integers(0, 255, (*shape, 3)).astype(np.uint8), depth,
        depth * 1.2, ids, puddles, puddles * 0, ids != 4, flow, mask, facts=facts, **more,
    )  # fmt: skip


def projected(camera, point):
    x, y, z = camera.camera_from_world[:3, :3] @ point + camera.camera_from_world[:3, 3]
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z


def test_boxes_of_actors_as_kitti_has_them():
    from scipy.spatial.transform import Rotation

    from rainsim.datasets.kitti import object_labels

    level = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]], float)  # looks along x
    matrix = np.eye(4)
    matrix[:3, :3] = level
    matrix[:3, 3] = -level @ (0, 0, 1.5)
    camera = Camera(400, 300, 350.0, 350.0, 200.0, 150.0, matrix)
    turn = Rotation.from_euler("z", 0.4)
    size, centre = np.array([4.0, 1.8, 1.5]), np.array([12.0, 1.0, 0.75])
    box = {"centre": centre.tolist(), "size": size.tolist(),
           "rotation": np.roll(turn.as_quat(), 1).tolist()}  # fmt: skip
    seen = {"class": "car", "box3d": box, "box2d": [150, 150, 200, 180], "box2d_seen": None,
            "pixels": 50}  # fmt: skip
    text = object_labels([seen, {**seen, "pixels": 0}, {**seen, "class": "tent"}], camera)
    kind, cut, hidden, alpha, *rest = text.splitlines()[0].split()
    left, _, _, bottom, height, width, length, x, y, z, about = map(float, rest)
    assert (kind, hidden) == ("Car", "3") and text.splitlines()[1].startswith("Misc ")
    assert len(text.splitlines()) == 2 and (left, bottom) == (149.5, 179.5)
    assert (height, width, length) == (1.5, 1.8, 4.0)
    # The corners by KITTI's own rule: turned about y, x ahead, y from 0 up to -height.
    c, s = np.cos(about), np.sin(about)
    turned = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    signs = np.array([(a, b, d) for a in (-1, 1) for b in (0, -1) for d in (-1, 1)])
    corners = signs * (length / 2, height, width / 2) @ turned.T + (x, y, z)
    own = 0.5 * np.array([(a, b, d) for a in (-1, 1) for b in (-1, 1) for d in (-1, 1)]) * size
    truth = (turn.apply(own) + centre) @ level.T + matrix[:3, 3]
    apart = np.linalg.norm(corners[:, None] - truth[None], axis=-1)
    assert apart.min(axis=1).max() < 1e-3 and len(set(apart.argmin(axis=1))) == 8
    assert float(alpha) == pytest.approx(about - np.arctan2(x, z), abs=1e-3)
    u, v = 350 * truth[:, 0] / truth[:, 2], 350 * truth[:, 1] / truth[:, 2]
    assert float(cut) == pytest.approx(1 - 1500 / (np.ptp(u) * np.ptp(v)), abs=0.01)


# --- encodings ------------------------------------------------------------------------------------


def test_depth_in_millimetres_and_as_kitti_has_it():
    depth = np.array([[1.2344, 0.0004, 65.535, 65.6, 300.0, np.inf]])
    assert depth_mm(depth).tolist() == [[1234, 0, 65535, 0, 0, 0]]
    found = kitti_depth(depth)
    assert found.tolist() == [[316, 1, 16777, 16794, 0, 0]]
    np.testing.assert_allclose(found[0, [0, 2, 3]] / 256, depth[0, [0, 2, 3]], atol=1 / 512)


def test_flow_as_kitti_has_it(tmp_path):
    flow = np.array([[[0.0, 0.0], [3.25, -7.5], [-512.0, 511.98], [600.0, 0.0], [1.0, 1.0]]])
    valid = np.array([[True, True, True, True, False]])
    values = kitti_flow(flow, valid)
    write_file(tmp_path, DataFile("f/flow.png", PNG48, values))
    imagecodecs = pytest.importorskip("imagecodecs")
    back = imagecodecs.png_decode((tmp_path / "f/flow.png").read_bytes())
    np.testing.assert_array_equal(back, values)
    assert back[0, :, 2].tolist() == [1, 1, 1, 0, 0]  # too far for 16 bits: not valid
    decoded = (back[..., :2].astype(float) - 2**15) / 64
    np.testing.assert_allclose(decoded[0, :3], flow[0, :3], atol=1 / 128)
    assert not back[0, 3:].any()


def test_what_is_no_48_bit_picture_is_refused(tmp_path):
    with pytest.raises(ParameterError, match=r"uint8 of shape \(2, 2, 3\)"):
        images.write_png48(tmp_path / "a.png", np.zeros((2, 2, 3), np.uint8))


def test_what_rain_spoils_is_left_out():
    drops, splash = np.array([[0.0, 0.2, 0.02, 0.0, 0.02]]), np.array([[0, 0, 0.02, 0, 0]])
    kept = keep_mask(drops, splash, np.array([[0, 1, 0, 4, 255]]))  # 4 is water
    assert kept.tolist() == [[True, False, False, False, True]]


def test_folders_and_names():
    assert [condition(r) for r in (0, 10, 2.5)] == ["clear", "rain/10mm", "rain/2.5mm"]
    cameras = [SimpleNamespace(name=n) for n in ("a/b.png", "a b", "a_b", "", "../x", "ü.JPG")]
    names = safe_names(cameras)
    assert names[:2] == ["a_b", "a_b_00001"] and len(set(names)) == 6
    made = safe_names([SimpleNamespace(name=n) for n in ("a", "a_00002", "a")])
    assert len(set(made)) == 3  # what is made of a name may be another's
    assert all("/" not in name and not name.startswith(".") for name in names)
    for name in LAYOUTS:
        assert callable(layout_of(name).sample_files)
    with pytest.raises(ParameterError, match="layout is 'coco'; it must be one of nerfstudio"):
        layout_of("coco")


# --- layouts --------------------------------------------------------------------------------------


def test_nerfstudio_by_its_parsers_rules():
    """What its data parser (nerfstudio_dataparser.py, commit 01595f7) asserts and computes."""
    plan = plan_with(Lens("opencv", (0.1, 0.02, 0.001, -0.002)))
    meta = json.loads(json.dumps(nerfstudio.transforms(plan)))
    assert {f"{split}_filenames" for split in ("train", "val", "test")} <= set(meta)
    files = [frame["file_path"] for frame in meta["frames"]]
    assert [meta[f"{split}_filenames"] for split in ("train", "val", "test")] == [
        files[:2], [], files[2:]]  # fmt: skip
    assert meta["camera_model"] in ("OPENCV", "OPENCV_FISHEYE")
    for frame, view in zip(meta["frames"], plan.views, strict=True):
        assert {"mask_path", "depth_file_path"} <= set(frame)
        assert (frame["k1"], frame["p2"]) == (0.1, -0.002)
        # Its rays: ((i + 0.5 - cx) / fx, -(j + 0.5 - cy) / fy, -1) turned by the pose.
        u, v, z = projected(view.camera, POINT + view.camera.position)
        pose = np.array(frame["transform_matrix"])
        ray = np.array([(u - frame["cx"]) / frame["fl_x"], -(v - frame["cy"]) / frame["fl_y"], -1])
        np.testing.assert_allclose(
            pose[:3, :3] @ ray * z + pose[:3, 3], POINT + view.camera.position, atol=1e-12
        )
    named = {f.name for f in nerfstudio.sample_files(sample_of(plan, 1), plan)}
    assert named == {f"rain/10mm/{kind}/v1.png" for kind in ("images", "depths", "masks")}
    assert {f.name for f in nerfstudio.plan_files(plan, None)} == {
        f"{c}/{n}" for c in ("clear", "rain/10mm") for n in ("transforms.json", "points.ply")
    }


def write_set(folder, plan, **changes):
    """Write a data set of nerfstudio's layout with its card; return its samples in 10 mm/h."""
    samples = [sample_of(plan, k) for k in range(len(plan.views))]
    for file in (*nerfstudio.plan_files(plan, None),
                 *(f for s in samples for f in nerfstudio.sample_files(s, plan)),
                 *(f for s in samples for f in beside.sample_files(s, plan))):  # fmt: skip
        write_file(folder, file)
    rains = [{"rain_mm_per_hour": rate} for rate in plan.rates]
    card = {"rainsim_data_set": 1, "layout": "nerfstudio", "complete": True, "rains": rains}
    (folder / "card.json").write_text(json.dumps({**card, **changes}))
    return samples


def test_partners_are_data_sets_of_nerfstudio_too():
    plan = replace(plan_with(), partners=("clear_air", "dry"))
    files = {f.name: f.content for f in nerfstudio.plan_files(plan, None)}
    assert "clear/transforms_dry.json" not in files
    rain, air, dry = (files[f"rain/10mm/transforms{n}.json"] for n in ("", "_clear_air", "_dry"))
    for name, data in (("clear_air", air), ("dry", dry)):
        assert data["train_filenames"] == [
            p.replace("images/", f"rainsim/{name}/") for p in rain["train_filenames"]
        ]
        for frame, own in zip(data["frames"], rain["frames"], strict=True):
            assert frame["file_path"] == own["file_path"].replace("images/", f"rainsim/{name}/")
            assert frame["transform_matrix"] == own["transform_matrix"]
            assert ("mask_path" in frame) == (name != "dry")


def test_our_reader_gives_back_what_was_written(tmp_path):
    plan = plan_with()
    samples = write_set(tmp_path, plan)
    found = read_views(tmp_path, 10)
    assert [v.held_out for v in found] == [v.held_out for v in plan.views] == [False, False, True]
    for view, sample in zip(found, samples, strict=True):
        assert view.name == sample.view.name
        np.testing.assert_array_equal(view.picture, sample.picture)
        np.testing.assert_array_equal(view.keep, sample.keep)
        np.testing.assert_array_equal(view.class_id, sample.class_id)
        known = sample.depth < 65
        np.testing.assert_allclose(view.depth[known], sample.depth[known], atol=6e-4)
        assert np.isinf(view.depth[0]).all()
        own = sample.view.camera
        assert (view.camera.fx, view.camera.cy) == (own.fx, own.cy)
        np.testing.assert_allclose(view.camera.camera_from_world, own.camera_from_world, atol=1e-12)
    places, colors = read_points(tmp_path, 10)
    np.testing.assert_array_equal(places, plan.points)
    np.testing.assert_array_equal(colors, plan.colors)


def test_our_reader_says_what_it_cannot_read(tmp_path):
    with pytest.raises(InputError):
        read_views(tmp_path, 10)
    write_set(tmp_path, plan_with())
    with pytest.raises(ParameterError, match=r"rain is 25 mm/h; .* has 0, 10; take"):
        read_views(tmp_path, 25)
    images.write_png16(tmp_path / "rain/10mm/depths/v1.png", np.zeros((3, 4)))
    with pytest.raises(InputError, match=r"depth of images/v1.png .* has the shape \(3, 4\)"):
        read_views(tmp_path, 10)
    wrong = {"complete": False}, {"layout": "kitti"}, {"rainsim_data_set": 2}
    for changes, message in zip(
        wrong, ("unfinished", "kitti", "version 2; it must be 1"), strict=True
    ):
        write_set(tmp_path, plan_with(), **changes)
        with pytest.raises(InputError, match=message):
            read_views(tmp_path, 10)
    (tmp_path / "card.json").write_text("[]")
    with pytest.raises(InputError, match="no data set's card"):
        read_views(tmp_path, 0)
    points = tmp_path / "rain/10mm/points.ply"
    points.write_bytes(points.read_bytes()[:-15])
    with pytest.raises(InputError, match="as many points"):
        read_points(tmp_path, 10)


def write_colmap(folder, plan):
    for file in colmap.plan_files(plan, None):
        write_file(folder, file)
    return folder / "rain/10mm/sparse/0"


LENSES = [None, Lens("opencv", (0.1, 0.02, 0.001, -0.002)), Lens("opencv", (0.1, 0, 0, 0, 0.3)),
          Lens("fisheye", (0.1, 0.02, 0.001, -0.002)), Lens("division", (-0.2,)),
          Lens("eucm", (0.6, 1.1))]  # fmt: skip


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: "none" if lens is None else lens.model)
def test_colmap_as_our_reader_reads_it(tmp_path, lens):
    plan = plan_with(lens)
    cameras, notes = read_model(write_colmap(tmp_path, plan))
    assert len(notes) == (lens is not None)
    found = lens_named(str(tmp_path / "rain/10mm"))
    assert found == lens or len(lens.values) == 5  # FULL_OPENCV names no k3 alone
    for camera, view in zip(cameras, plan.views, strict=True):
        assert camera.name == view.name and (camera.cx, camera.fy) == (19, 36)
        np.testing.assert_allclose(camera.camera_from_world, view.camera.camera_from_world,
                                   atol=1e-12)  # fmt: skip


@pytest.mark.parametrize("layout", ["nerfstudio", "replicator"])
def test_lenses_that_a_layout_has_no_name_for_are_refused(layout):
    for lens in LENSES[-2:]:
        with pytest.raises(ParameterError, match=f"{layout} it must be opencv or fisheye; give"):
            check_lenses(plan_with(lens).views, layout)
        check_lenses(plan_with(lens).views, "colmap")
    check_lenses(plan_with(LENSES[1]).views, layout)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: "none" if lens is None else lens.model)
def test_colmap_as_pycolmap_reads_it(tmp_path, lens):
    pycolmap = pytest.importorskip("pycolmap")
    plan = plan_with(lens)
    found = pycolmap.Reconstruction(str(write_colmap(tmp_path, plan)))
    assert len(found.points3D) == 2 and len(found.images) == 3
    first = next(p for p in found.points3D.values() if p.color[0] == 9)
    np.testing.assert_allclose(first.xyz, [1, 2, 3])
    by_name = {image.name: image for image in found.images.values()}
    for view in plan.views:
        image = by_name[f"{view.name}.png"]
        place = POINT + view.camera.position
        x, y, z = view.camera.camera_from_world[:3, :3] @ POINT
        pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        np.testing.assert_allclose(pose * place, [x, y, z], atol=1e-9)
        a, b = (x / z, y / z) if lens is None else lens.distort(x / z, y / z)
        camera = found.cameras[image.camera_id]
        seen = camera.img_from_cam(np.array([x / z, y / z, 1.0]))
        np.testing.assert_allclose(seen, [35 * a + 19, 36 * b + 16], atol=1e-6)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: "none" if lens is None else lens.model)
def test_tracks_of_points_as_pycolmap_reads_them(tmp_path, lens, rng):
    """A wall of points before the cameras, half of them behind it: the front ones have tracks."""
    pycolmap = pytest.importorskip("pycolmap")
    plan = plan_with(lens)
    views = [replace(v, camera=moved(CAMERA, k * np.array([0.1, 0, 0]), np.zeros(3)))
             for k, v in enumerate(plan.views)]  # fmt: skip
    places = np.column_stack([rng.uniform(-1, 1, (200, 2)), np.repeat([3.0, 4.0], 100)])
    plan = replace(plan, views=tuple(views), points=places.astype(np.float32),
                   colors=np.zeros((200, 3), np.uint8))  # fmt: skip
    wall = np.full((30, 40), 3.0, np.float32)
    for view in views:
        name = f"clear/stereo/depth_maps/{view.name}.png.geometric.bin"
        write_file(tmp_path, DataFile(name, 6, colmap.depth_map(wall)))
    for file in colmap.plan_files(plan, tmp_path):
        write_file(tmp_path, file)
    found = pycolmap.Reconstruction(str(tmp_path / "clear/sparse/0"))
    tracks = {k: len(p.track.elements) for k, p in found.points3D.items()}
    assert max(tracks[k] for k in range(101, 201)) == 0
    assert 50 < sum(tracks[k] > 1 for k in range(1, 101)) <= 100
    assert found.compute_num_observations() == sum(tracks.values())
    errors = []
    for k, point in found.points3D.items():
        for element in point.track.elements:
            image = found.images[element.image_id]
            assert image.points2D[element.point2D_idx].point3D_id == k
            seen = image.project_point(point.xyz)
            errors.append(np.abs(seen - image.points2D[element.point2D_idx].xy).max())
    assert max(errors) < 1e-5


def test_colmap_depth_maps_are_as_its_script_reads_them():
    """scripts/python/read_write_dense.py of COLMAP: the text w&h&c&, then columns of float32."""
    depth = np.arange(12, dtype=np.float32).reshape(3, 4) + 1
    depth[1, 2] = np.inf
    data = colmap.depth_map(depth)
    width, height, channels = (int(n) for n in data.split(b"&", 3)[:3])
    numbers = np.frombuffer(data.split(b"&", 3)[3], np.float32)
    found = numbers.reshape((width, height, channels), order="F").transpose((1, 0, 2)).squeeze()
    expected = depth.copy()
    expected[1, 2] = 0
    np.testing.assert_array_equal(found, expected)


def test_kitti_by_its_development_kit():
    plan = plan_with()
    files = {f.name: f for f in kitti.sample_files(sample_of(plan, 1), plan)}
    training = "rain/10mm/training"
    assert set(files) == {
        f"{training}/{n}" for n in (
            "image_2/000001_10.png", "image_2/000000_11.png", "flow_occ/000001_10.png",
            "flow_noc/000001_10.png", "calib/000001.txt",
            "proj_depth/groundtruth/image_02/000001_10.png")}  # fmt: skip
    last = {f.name for f in kitti.sample_files(sample_of(plan, 2), plan)}
    assert f"{training}/image_2/000001_11.png" in last
    assert not any("flow" in name for name in last)  # there is no next picture
    occ, noc = (files[f"{training}/flow_{n}/000001_10.png"].content[..., 2] for n in ("occ", "noc"))
    assert (noc <= occ).all() and noc.sum() < occ.sum()
    rows = dict(
        line.split(": ") for line in files[f"{training}/calib/000001.txt"].content.splitlines()
    )
    matrix = np.array(rows["P2"].split(), float).reshape(3, 4)
    x = matrix @ np.append(POINT, 1)
    u, v, _ = projected(CAMERA, POINT)
    np.testing.assert_allclose(x[:2] / x[2], [u - 0.5, v - 0.5])  # first pixel's middle at 0, 0
    ahead = np.array(rows["Tr_velo_to_cam"].split(), float).reshape(3, 4) @ [5, 0, 0, 1]
    np.testing.assert_allclose(ahead, [0, 0, 5])
    poses = np.array([line.split() for line in kitti.poses(plan.views).splitlines()], float)
    np.testing.assert_allclose(poses[0], np.eye(3, 4).ravel(), atol=1e-9)
    second = plan.views[1].camera
    local = np.linalg.inv(second.camera_from_world) @ [0, 0, 0, 1]
    np.testing.assert_allclose(
        poses[1].reshape(3, 4)[:, 3],
        (plan.views[0].camera.camera_from_world @ local)[:3],
        atol=1e-8,
    )


def test_acdc_by_its_rules():
    plan = plan_with()
    rain = {f.name: f for f in acdc.sample_files(sample_of(plan, 0), plan)}
    clear = {f.name: f for f in acdc.sample_files(sample_of(plan, 0, rate=0.0), plan)}
    name = "yard10mm/yard10mm_frame_000000"
    assert {f"rgb_anon/rain/train/{name}_rgb_anon.png",
            f"gt/rain/train/{name}_gt_labelTrainIds.png",
            f"gt/rain/train/{name}_gt_invIds.png"} <= set(rain)  # fmt: skip
    assert f"rgb_anon/rain/train_ref/{name}_rgb_ref_anon.png" in clear
    ids = rain[f"gt/rain/train/{name}_gt_labelTrainIds.png"].content
    assert ids.dtype == np.uint8 and set(np.unique(ids)) == {0, 255}
    assert (ids[20:25] == 0).all()  # the puddle counts as the road below it
    held = {f.name for f in acdc.sample_files(sample_of(plan, 2), plan)}
    assert any(n.startswith("rgb_anon/rain/val/") for n in held)
    own = sample_of(plan, 0, labels=np.full((30, 40), 13, np.uint16))
    assert (acdc.train_ids(own) == 13).all()


def test_replicator_by_its_pages():
    plan = plan_with()
    files = {
        f.name.rpartition("/")[2]: f for f in replicator.sample_files(sample_of(plan, 1), plan)
    }
    assert set(files) == {
        "rgb_0001.png", "distance_to_image_plane_0001.npy", "distance_to_camera_0001.npy",
        "semantic_segmentation_0001.png", "semantic_segmentation_labels_0001.json",
        "bounding_box_2d_tight_0001.npy", "bounding_box_2d_tight_labels_0001.json",
        "camera_params_0001.json"}  # fmt: skip
    colors = files["semantic_segmentation_0001.png"].content
    labels = files["semantic_segmentation_labels_0001.json"].content
    assert labels[str(tuple(colors[22, 5].tolist()))] == {"class": "water"}
    assert labels[str(tuple(colors[12, 5].tolist()))] == {"class": "paving"}
    assert labels["(0, 0, 0, 0)"] == {"class": "BACKGROUND"} and not colors[28, 5].any()
    box = files["bounding_box_2d_tight_0001.npy"].content
    assert box.dtype.names[0] == "semanticId" and box[0].tolist()[1:5] == (0, 20, 39, 24)
    params = files["camera_params_0001.json"].content
    view = np.array(params["cameraViewTransform"]).reshape(4, 4)
    projection = np.array(params["cameraProjection"]).reshape(4, 4)
    camera = plan.views[1].camera
    place = POINT + camera.position
    x, y, z, w = np.append(place, 1) @ view @ projection  # row vectors
    u, v, depth = projected(camera, place)
    np.testing.assert_allclose([(x / w + 1) / 2 * 40, (1 - y / w) / 2 * 30, w], [u, v, depth])
    assert 0 < z / w < 1
    focal = params["cameraFocalLength"] / params["cameraAperture"][0] * 40
    assert focal == pytest.approx(camera.fx)


def test_points_are_the_scenes():
    scene = tiny_scene()
    places, colors = points_of(scene, most=500)
    assert places.shape == colors.shape == (500, 3) and places.dtype == np.float32
    assert np.abs(places[:, :2]).max() < 1.1  # metres, ground frame
    data = ply_bytes(places, colors)
    header, _, body = data.partition(b"end_header\n")
    assert b"element vertex 500" in header and len(body) == 500 * 15
    assert struct.unpack_from("<3f3B", body, 15) == (*places[1].tolist(), *colors[1].tolist())


def test_the_card_says_by_which_numbers_it_rained():
    from rainsim.config.settings import mm_per_hour

    base = Config.from_preset("downpour")
    card = card_of(plan_with(), "kitti", tiny_scene(), lambda r: base.replace(rate=mm_per_hour(r)))
    clear, rain = card["rains"]
    assert clear["drops"] is None and clear["optical_range_m"] is None
    assert rain["rain_mm_per_hour"] == pytest.approx(10)
    assert rain["radar_db_per_km_vertical"]["77_ghz"] == pytest.approx(5.8, abs=0.06)
    assert rain["drops"]["decay_per_m"] == pytest.approx(4100 * 10**-0.21, rel=1e-4)
    text = card_text(card)
    assert "| 10 | `rain/10mm` |" in text and "| 0 | `clear` | clear |" in text
    assert json.loads(json.dumps(card, allow_nan=False))["held_out"] == ["v2"]


# --- the user's labels ----------------------------------------------------------------------------


def test_ids_by_splat_and_masks_give_the_same_labels(tmp_path):
    """Masks drawn of ids by splat vote the same ids back, but for splats at the rims."""
    scene = tiny_scene()
    high = scene.ground_frame.to_ground(scene.splats.position.astype(float))[:, 2] > 0.2
    ids = np.where(high, 11, 3).astype(np.int32)
    np.save(tmp_path / "ids.npy", ids)
    own = read_labels(tmp_path / "ids.npy", scene, RENDER)
    (tmp_path / "masks").mkdir()
    for camera in scene.cameras:
        images.write_png(tmp_path / f"masks/{camera.name}.png", own.picture(camera).astype("u1"))
    voted = read_labels(tmp_path / "masks", scene, RENDER)
    assert (voted.ids == ids).mean() > 0.95
    for camera in scene.cameras:
        one, other = own.picture(camera), voted.picture(camera)
        assert {3, 11} <= set(np.unique(one)) and (one == other).mean() > 0.97


def test_labels_that_do_not_fit_are_named(tmp_path):
    scene = tiny_scene()
    np.save(tmp_path / "few.npy", np.zeros(5, int))
    (tmp_path / "no.npy").write_bytes(b"x")
    (tmp_path / "empty").mkdir()
    os.mkfifo(tmp_path / "pipe.npy")
    np.save(tmp_path / "whole.npy", np.full(len(scene.splats), 70_000))
    whole = (tmp_path / "whole.npy").read_bytes()
    short, long = f"({len(scene.splats)},), }}".encode(), b"(1000000000000,), }"
    (tmp_path / "cut.npy").write_bytes(whole[:-8])
    padded = short + b" " * (len(long) - len(short))
    (tmp_path / "huge.npy").write_bytes(whole.replace(padded, long))
    (tmp_path / "braces.npy").write_bytes(whole.replace(b"{", b"((("))
    (tmp_path / "names.npy").write_bytes(whole.replace(b"'<i8'", b"'<j8'"))
    for name, message in (
        ("few.npy", r"int64 of shape \(5,\); they must fit"), ("no.npy", "cannot be read"),
        ("empty", "such as view_0.png"), ("none.npy", "does not exist"), ("pipe.npy", "is a pipe"),
        ("whole.npy", "cut or beyond 0 to 65535"), ("cut.npy", "cut or beyond 0 to 65535"),
        ("huge.npy", r"int64 of shape \(1000000000000,\); they must fit"),
        ("braces.npy", "cannot be read"), ("names.npy", "cannot be read"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message) as caught:
            read_labels(Path(tmp_path) / name, scene, RENDER)
        assert "\n" not in str(caught.value)


def test_arrays_are_written_as_numpy_reads_them(tmp_path):
    values = np.array([[1.5, np.inf]], np.float32)
    write_file(tmp_path, DataFile("a/b.npy", 3, values))
    np.testing.assert_array_equal(np.load(io.BytesIO((tmp_path / "a/b.npy").read_bytes())), values)
