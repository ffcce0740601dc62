"""Camera files and cameras placed by hand."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from made_captures import ring
from rainsim.commands.given import cameras_of, settings
from rainsim.config.settings import Config
from rainsim.errors import InputError, ParameterError
from rainsim.io.images import write_png
from rainsim.scene.camera_rule import focal_length, require_camera
from rainsim.scene.cameras import (
    load_cameras,
    look_at,
    orbit,
    read_cameras,
    resize_to,
    write_transforms,
)
from rainsim.scene.types import GroundFrame
from scenes import tiny_scene

# A quarter turn about y: the camera's x, y, z axes are -z, y, x of the world (columns).
TURN = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
CAPTURE = {
    "id": 0, "img_name": "a", "width": 400, "height": 300, "position": [1, 2, 3], "rotation": TURN,
    "fx": 500.0, "fy": 510.0,
}  # fmt: skip
NERF = {"w": 400, "h": 300, "fl_x": 500.0, "fl_y": 510.0, "frames": [
    {"file_path": "./images/one.png", "transform_matrix": np.eye(4).tolist()},
]}  # fmt: skip


def read(tmp_path, data):
    path = tmp_path / "cameras.json"
    path.write_text(data if isinstance(data, str) else json.dumps(data))
    return read_cameras(path)


def project(camera, point):
    """Return the image point [px] and the depth of a point of the world."""
    x, y, z = camera.camera_from_world[:3, :3] @ point + camera.camera_from_world[:3, 3]
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z


def same(a, b):
    return np.array_equal(a.camera_from_world, b.camera_from_world) and replace(
        a, camera_from_world=None
    ) == replace(b, camera_from_world=None)


def test_cameras_of_the_original_code(tmp_path):
    (camera,) = read(tmp_path, [CAPTURE])
    assert (camera.width, camera.height, camera.fx, camera.fy) == (400, 300, 500, 510)
    assert (camera.cx, camera.cy, camera.name) == (200, 150, "a")
    np.testing.assert_allclose(camera.position, [1, 2, 3])
    np.testing.assert_allclose(camera.forward, [1, 0, 0])
    np.testing.assert_allclose(camera.image_up, [0, -1, 0])
    np.testing.assert_allclose(project(camera, [6, 3, 3]), (200, 150 + 510 / 5, 5))


def test_nerf_cameras_look_along_their_minus_z_with_y_up(tmp_path):
    (camera,) = read(tmp_path, NERF)
    np.testing.assert_allclose(camera.forward, [0, 0, -1])
    np.testing.assert_allclose(camera.image_up, [0, 1, 0])
    assert (camera.cx, camera.cy, camera.name) == (200, 150, "one")


def test_nerf_scenes_that_give_an_angle_alone(tmp_path):
    data = {
        "camera_angle_x": math.pi / 2,
        "frames": [{"file_path": "./train/r_0", "transform_matrix": np.eye(4).tolist()}],
    }
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    (camera,), (note,) = load_cameras(tmp_path / "transforms.json")
    assert (camera.width, camera.height, camera.name) == (800, 800, "r_0") and "ASSUMED" in note
    assert camera.fx == camera.fy == pytest.approx(400)
    (tmp_path / "train").mkdir()
    write_png(tmp_path / "train" / "r_0.png", np.zeros((30, 40, 3), np.uint8))
    (camera,), notes = load_cameras(tmp_path / "transforms.json")
    assert (camera.width, camera.height) == (40, 30) and notes == []
    assert camera.fx == pytest.approx(20)


def test_nerf_field_of_view_and_values_per_frame(tmp_path):
    matrix = np.eye(4)
    matrix[:3, 3] = 4, 5, 6
    data = {
        "camera_angle_x": math.pi / 2,
        "w": 400,
        "h": 300,
        "frames": [
            {"file_path": "a", "transform_matrix": matrix.tolist()},
            {"file_path": "b", "transform_matrix": matrix[:3].tolist(), "w": 200, "cx": 90,
             "fl_x": 150},
        ],
    }  # fmt: skip
    first, second = read(tmp_path, data)
    assert first.fx == pytest.approx(200) and first.fy == pytest.approx(200)
    assert (second.width, second.cx, second.fx, second.fy) == (200, 90, 150, 150)
    np.testing.assert_allclose(first.position, [4, 5, 6])
    np.testing.assert_allclose(second.position, [4, 5, 6])


def test_what_is_written_is_read_exactly(tmp_path):
    cameras = [
        look_at((1.1 * i, -0.3, 2 / 3), (0, 0.1, 0), (0.1, 0.2, 1), 50 + i, 320, 200, f"n{i}")
        for i in range(1, 9)
    ]
    cameras[3] = replace(cameras[3], cx=11.25, fy=77.7)
    write_transforms(tmp_path / "t.json", cameras, [f"frames/{i:05d}.png" for i in range(8)])
    assert all(map(same, read_cameras(tmp_path / "t.json"), cameras))
    write_transforms(tmp_path / "t2.json", read_cameras(tmp_path / "t.json"))
    assert all(map(same, read_cameras(tmp_path / "t2.json"), cameras))


def test_an_edited_matrix_counts_and_not_our_copy(tmp_path):
    write_transforms(tmp_path / "t.json", ring(count=2))
    data = json.loads((tmp_path / "t.json").read_text())
    data["frames"][1]["transform_matrix"][0][3] += 0.5
    first, second = read(tmp_path, data)
    assert same(first, ring(count=2)[0])
    np.testing.assert_allclose(second.position, np.add(ring(count=2)[1].position, (0.5, 0, 0)))


def test_other_programs_read_the_pose_that_we_write(tmp_path):
    camera = ring()[1]
    write_transforms(tmp_path / "t.json", [camera])
    frame = json.loads((tmp_path / "t.json").read_text())["frames"][0]
    matrix = np.array(frame["transform_matrix"])
    np.testing.assert_allclose(matrix[:3, 3], camera.position)
    np.testing.assert_allclose(-matrix[:3, 2], camera.forward)
    np.testing.assert_allclose(matrix[:3, 1], camera.image_up)
    np.testing.assert_allclose(matrix[3], [0, 0, 0, 1])


def test_rounded_rotations_are_cleaned_up(tmp_path):
    camera = ring()[1]
    rounded = np.round(camera.camera_from_world[:3, :3].T, 5).tolist()
    (read_back,) = read(tmp_path, [{**CAPTURE, "rotation": rounded}])
    turn = read_back.camera_from_world[:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(turn, camera.camera_from_world[:3, :3], atol=1e-5)


BAD = {
    "no JSON": ("{", "not valid JSON"),
    "empty list": ([], "holds no cameras"),
    "no frames": ({"frames": []}, "holds no cameras"),
    "a number": (3, "holds no cameras"),
    "not objects": ([1], "camera 0 is not an object"),
    "missing": ([CAPTURE, {**CAPTURE, "fx": None}], "camera 1: fx is missing; .* above 0"),
    "focal": ([{**CAPTURE, "fx": -1}], "fx is -1"),
    "NaN": (json.dumps([{**CAPTURE, "fy": math.nan}]), "fy is nan"),
    "huge": ([{**CAPTURE, "fy": 10**400}], "fy is 1000"),
    "bool": ([{**CAPTURE, "width": True}], "width is True"),
    "fraction": ([{**CAPTURE, "width": 3.5}], "width is 3.5; .* whole number"),
    "side": ([{**CAPTURE, "height": 10**9}], "height is 1000000000"),
    "position": ([{**CAPTURE, "position": [1, 2]}], "position is .* shape 3"),
    "text": ([{**CAPTURE, "position": ["a", 2, 3]}], "position is"),
    "no rotation": ([{**CAPTURE, "rotation": None}], "rotation is missing; .* shape 3 x 3"),
    "ragged": ([{**CAPTURE, "rotation": [[1, 2], [3]]}], "rotation is"),
    "scaled": ([{**CAPTURE, "rotation": (2 * np.eye(3)).tolist()}], "without scale or mirroring"),
    "mirrored": ([{**CAPTURE, "rotation": np.diag([1, 1, -1]).tolist()}], "mirroring"),
    "no size": ({**NERF, "w": None}, "frame 0: w is missing"),
    "no focal": ({**NERF, "fl_x": None, "fl_y": None}, "fl_x is missing; .* camera_angle_x"),
    "panorama": ({**NERF, "camera_model": "EQUIRECTANGULAR"}, "camera_model is 'EQUIRECTANGULAR'"),
    "angle": ({**NERF, "fl_x": None, "camera_angle_x": 4}, "camera_angle_x is 4"),
}  # fmt: skip


def test_the_lens_of_a_fisheye_is_left_out_and_said(tmp_path):
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({**NERF, "camera_model": "OPENCV_FISHEYE"}))
    cameras, notes = load_cameras(path)
    assert len(cameras) == 1 and "OPENCV_FISHEYE" in notes[0] and "pinhole" in notes[0]


@pytest.mark.parametrize("case", BAD)
def test_bad_files_end_in_one_clear_line(tmp_path, case):
    data, expected = BAD[case]
    with pytest.raises(InputError, match=expected) as caught:
        read(tmp_path, data)
    message = str(caught.value)
    assert "cameras.json" in message and "\n" not in message and len(message) < 400


def test_orthographic_cameras_are_not_written(tmp_path):
    with pytest.raises(ParameterError, match="orthographic"):
        write_transforms(tmp_path / "t.json", [replace(ring()[0], orthographic=True)])
    assert not list(tmp_path.iterdir())


def test_look_at_puts_the_target_in_the_middle_and_up_upwards():
    camera = look_at((4, -3, 2), (1, 1, 1), (0, 0, 1), 70, 640, 360)
    column, row, depth = project(camera, [1, 1, 1])
    assert (column, row) == pytest.approx((320, 180)) and depth == pytest.approx(math.sqrt(26))
    assert project(camera, [1, 1, 1.5])[:2] == (pytest.approx(320), pytest.approx(row, abs=180))
    assert project(camera, [1, 1, 1.5])[1] < 180
    np.testing.assert_allclose(camera.position, [4, -3, 2])
    turn = camera.camera_from_world[:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(turn) > 0
    assert math.degrees(2 * math.atan(320 / camera.fx)) == pytest.approx(70)


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"eye": (1, 1, 1)}, "must differ"),
        ({"eye": (1, 1, 5)}, "runs along up"),
        ({"up": (0, 0, 0)}, "runs along up"),
        ({"eye": (1, 2)}, "three finite numbers"),
        ({"target": (1, 2, math.nan)}, "look-at is"),
        ({"fov_degrees": 180}, "fov is 180"),
        ({"fov_degrees": math.nan}, "fov is nan"),
        ({"width": 0}, "width is 0"),
        ({"height": 2.5}, "height is 2.5"),
    ],
)
def test_impossible_views_are_refused(changed, expected):
    view = {"eye": (4, 3, 2), "target": (1, 1, 1), "up": (0, 0, 1), "fov_degrees": 60, "width": 64,
            "height": 48}  # fmt: skip
    with pytest.raises(ParameterError, match=expected):
        look_at(**{**view, **changed})


# The capture frame of these tests: y down, half a metre per unit, set off.
FRAME = GroundFrame(
    rotation=np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
    meters_per_unit=0.5,
    translation=np.array([1.0, 2, 3]),
)


def test_orbit_is_a_level_circle_about_what_the_cameras_look_at():
    capture = [FRAME.camera_in_capture(camera) for camera in ring(3.0, 1.5, 7)]
    placed = orbit(FRAME, capture, count=8)
    eyes = np.array([FRAME.to_ground(camera.position) for camera in placed])
    np.testing.assert_allclose(eyes[:, 2], 1.5)
    np.testing.assert_allclose(np.hypot(eyes[:, 0], eyes[:, 1]), 3)
    np.testing.assert_allclose(eyes[0], [3, 0, 1.5], atol=1e-12)
    np.testing.assert_allclose(eyes[2], [0, 3, 1.5], atol=1e-12)  # counter-clockwise
    for camera in placed:
        seen = FRAME.camera_in_ground(camera)
        assert project(seen, [0, 0, 0.5])[:2] == pytest.approx((32, 24))
        assert seen.image_up[2] > 0.9 and seen.fx == pytest.approx(capture[0].fx)
    assert [c.name for c in placed[:2]] == ["orbit_000", "orbit_001"]


def test_orbit_of_one_camera_looks_at_the_ground_ahead():
    camera = look_at((0, 0, 2), (2, 0, 0), (0, 0, 1), 60, 64, 48)
    frame = GroundFrame(np.eye(3), 1.0, np.zeros(3))
    placed = orbit(frame, [camera], count=4)
    np.testing.assert_allclose(placed[0].position, [0, 0, 2], atol=1e-12)
    np.testing.assert_allclose(placed[2].position, [4, 0, 2], atol=1e-12)


def test_orbit_needs_cameras_and_frames():
    with pytest.raises(ParameterError, match="there are none"):
        orbit(FRAME, [])
    with pytest.raises(ParameterError, match="0 frames"):
        orbit(FRAME, ring(), count=0)


def test_resize_keeps_the_shape_unless_both_sides_are_given():
    camera = replace(ring()[0], cx=30.0)
    assert resize_to(camera) is camera
    wide = resize_to(camera, width=128)
    assert (wide.height, wide.cx, wide.cy, wide.fx) == (96, 60, 48, pytest.approx(2 * camera.fx))
    assert resize_to(camera, height=24).width == 32
    cropped = resize_to(camera, 64, 20)
    assert (cropped.height, cropped.cy, cropped.fy) == (20, 10, camera.fy)
    with pytest.raises(ParameterError, match="width is 0"):
        resize_to(camera, width=0)


def test_the_frame_range_is_checked_by_the_length_of_the_path():
    scene = replace(tiny_scene(), cameras=tiny_scene().cameras * 10)
    usual = Config().frames
    assert usual < len(scene.cameras)
    drive = {"drive": True, "frame_range": (usual + 1, len(scene.cameras))}
    _, config = cameras_of(scene, settings("moderate", drive), drive)
    assert (config.frames, len(config.indices)) == (30, 5)
    too_far = drive | {"frame_range": (0, 31)}
    with pytest.raises(ParameterError, match="0:31; it must satisfy 0 <= A < B <= 30"):
        cameras_of(scene, settings("moderate", too_far), too_far)
    cut = drive | {"frames": 26}
    with pytest.raises(ParameterError, match=f"{usual + 1}:30; .* <= 26"):
        settings("moderate", cut)
    with pytest.raises(ParameterError, match=f"B <= {usual} "):
        settings("moderate", {"orbit": True, "frame_range": (usual + 1, 30)})


def path_of(fov):
    matrix = np.eye(4).ravel().tolist()
    frames = [{"camera_to_world": matrix, "fov": fov}]
    return {"camera_path": frames, "render_width": 64, "render_height": 64}


RULE = r"must be from 0\.1 to 170|must be a number above 0 and below 1e"
WAYS = {  # of a camera of 64 x 64 px with an angle [degrees]
    "option": lambda _, fov: look_at((0, -3, 1), (0, 0, 0), (0, 0, 1), fov, 64, 64),
    "cameras.json": lambda at, fov: read(
        at, [CAPTURE | {"width": 64, "height": 64} | dict.fromkeys(("fx", "fy"), focal_length(
            64, math.radians(fov)))]),
    "transforms.json": lambda at, fov: read(
        at, {"camera_angle_x": math.radians(fov), "w": 64, "h": 64, "frames": NERF["frames"]}),
    "path": lambda at, fov: read(at, path_of(fov)),
}  # fmt: skip


@pytest.mark.parametrize("way", WAYS)
def test_one_rule_for_the_angle_of_all_cameras(tmp_path, way):
    for fov in (0.1, 60.0, 170.0):
        assert WAYS[way](tmp_path, fov)
    for fov in (1e-300, 1e-30, 0.0999, 170.1, 179.9999):
        with pytest.raises((InputError, ParameterError), match=RULE) as seen:
            WAYS[way](tmp_path, fov)
        assert "\n" not in str(seen.value) and str(seen.value).count(";") >= 2


def test_lenses_and_poses_that_cannot_be_drawn_from():
    camera, good = ring()[0], {"fx": 70.0, "cx": 300.0}
    assert require_camera(replace(camera, **good), "it")
    mirrored = camera.camera_from_world * np.diag([-1.0, 1, 1, 1])
    for changes, message in (
        ({"width": 70_000}, "70000 x 48 px"), ({"fx": math.nan}, "nan"), ({"cy": math.inf}, "inf"),
        ({"fx": 5000.0}, "16 times"), ({"cx": 1e6}, "1e\\+06, 24 px; no pixel"),
        ({"camera_from_world": mirrored}, "no mirroring"),
        ({"camera_from_world": 1e13 * np.eye(4)}, "no rotation"),
        ({"orthographic": True, "fx": 1e-300, "fy": 1e-300}, "from 1e-09"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            require_camera(replace(camera, **changes), "it")


def test_a_size_cannot_widen_the_angle_beyond_the_rule():
    with pytest.raises(ParameterError, match=r"angle of 17\d degrees; .*--width or --height"):
        resize_to(ring()[0], 8, 300)
