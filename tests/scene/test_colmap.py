"""COLMAP sparse models, binary and text."""

import struct

import numpy as np
import pytest

import made_formats as made
from made_captures import ring, splats_at
from made_formats import write_splats
from rainsim.errors import InputError
from rainsim.scene.cameras import load_cameras, read_cameras
from rainsim.scene.colmap import find_model
from rainsim.scene.folder import cameras_beside, import_scene
from rainsim.scene.types import GroundFrame


@pytest.mark.parametrize("write", [made.colmap_binary, made.colmap_text])
@pytest.mark.parametrize("points", [0, 3])
def test_cameras_come_back(tmp_path, write, points):
    cameras = ring(count=5)
    write(tmp_path, list(reversed(cameras)), points=points)
    found, notes = load_cameras(tmp_path)
    assert notes == [] and [c.name for c in found] == [c.name for c in cameras]
    for camera, expected in zip(found, cameras, strict=True):
        assert (camera.width, camera.height) == (64, 48)
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == made.LENS[2]
        np.testing.assert_allclose(camera.camera_from_world, expected.camera_from_world, atol=1e-12)
        np.testing.assert_allclose(camera.position, expected.position, atol=1e-12)


LENSES = {
    "SIMPLE_PINHOLE": (0, (50.0, 32.0, 24.0), False),
    "SIMPLE_RADIAL": (2, (50.0, 32.0, 24.0, 0.1), True),
    "RADIAL": (3, (50.0, 32.0, 24.0, 0.0, 0.0), False),
    "OPENCV": (4, (50.0, 51.0, 32.0, 24.0, 0.0, 0.0, 1e-4, 0.0), True),
    "OPENCV_FISHEYE": (5, (50.0, 51.0, 32.0, 24.0, 0.0, 0.0, 0.0, 0.0), True),
    "FULL_OPENCV": (6, (50.0, 51.0, 32.0, 24.0, *[0.1] * 8), True),
    "FOV": (7, (50.0, 51.0, 32.0, 24.0, 0.9), True),
    "SIMPLE_RADIAL_FISHEYE": (8, (50.0, 32.0, 24.0, 0.0), True),
    "RADIAL_FISHEYE": (9, (50.0, 32.0, 24.0, 0.0, 0.0), True),
    "THIN_PRISM_FISHEYE": (10, (50.0, 51.0, 32.0, 24.0, *[0.0] * 8), True),
    "RAD_TAN_THIN_PRISM_FISHEYE": (11, (50.0, 51.0, 32.0, 24.0, *[0.0] * 12), True),
    "SIMPLE_DIVISION": (12, (50.0, 32.0, 24.0, -0.1), True),
    "DIVISION": (13, (50.0, 51.0, 32.0, 24.0, 0.0), False),
    "SIMPLE_FISHEYE": (14, (50.0, 32.0, 24.0), True),
    "FISHEYE": (15, (50.0, 51.0, 32.0, 24.0), True),
    "EUCM": (16, (50.0, 51.0, 32.0, 24.0, 0.5, 1.0), True),
}


@pytest.mark.parametrize("model", LENSES)
@pytest.mark.parametrize("write", [made.colmap_binary, made.colmap_text])
def test_distortion_is_ignored_and_said(tmp_path, model, write):
    number, values, bent = LENSES[model]
    write(tmp_path, ring(count=2), (model, number, values))
    cameras, notes = load_cameras(tmp_path)
    assert (cameras[0].fx, cameras[0].cx, cameras[0].cy) == (50, 32, 24)
    assert cameras[0].fy == (51 if values[1] == 51 else 50)
    assert len(notes) == bent and all(model in note and "distortion" in note for note in notes)


@pytest.mark.parametrize("write", [made.colmap_binary, made.colmap_text])
def test_a_panorama_is_named_as_what_it_is(tmp_path, write):
    write(tmp_path, ring(count=2), ("EQUIRECTANGULAR", 17, ()))
    with pytest.raises(InputError, match="EQUIRECTANGULAR, a panorama"):
        load_cameras(tmp_path)


def test_the_largest_of_a_solvers_models_is_taken_and_said(tmp_path):
    for name, count in (("0", 2), ("1", 5), ("2", 3), ("old", 9)):
        made.colmap_binary(tmp_path / "sparse" / name, ring(count=count))
    for given in (tmp_path, tmp_path / "sparse"):
        cameras, notes = load_cameras(given)
        assert len(cameras) == 5 and "left 3 models; the largest, sparse/1 of 5" in notes[0]
    cameras, notes = load_cameras(tmp_path / "sparse" / "2")  # who names one gets that one
    assert len(cameras) == 3 and not notes


def test_models_are_found_where_tools_leave_them(tmp_path):
    cameras = ring(count=3)
    write_splats(tmp_path / "garden.ply", splats_at(np.eye(3)))
    for place in ("sparse/0", "sparse", "."):
        folder = tmp_path / place
        made.colmap_text(folder, cameras)
        assert find_model(tmp_path) == folder and find_model(folder) == folder
        assert len(read_cameras(tmp_path)) == len(read_cameras(folder / "images.txt")) == 3
        found, _ = cameras_beside(tmp_path / "garden.ply", tmp_path)
        assert [c.name for c in found] == [c.name for c in cameras]
        for name in ("cameras.txt", "images.txt"):
            (folder / name).unlink()
    assert find_model(tmp_path) is None
    assert cameras_beside(tmp_path / "garden.ply", tmp_path) == ([], [])


def test_the_binary_model_wins_and_a_json_file_before_it(tmp_path):
    made.colmap_binary(tmp_path, ring(count=3))
    made.colmap_text(tmp_path, ring(count=4))
    assert len(read_cameras(tmp_path)) == 3
    (tmp_path / "cameras.json").write_text("[]")
    with pytest.raises(InputError, match="holds no cameras"):
        read_cameras(tmp_path)


def test_scene_notes_tell_of_distortion(tmp_path):
    write_splats(tmp_path / "garden.ply", splats_at(np.eye(3)))
    made.colmap_binary(tmp_path / "sparse/0", ring(count=3), ("OPENCV", 4, LENSES["OPENCV"][1]))
    frame = GroundFrame(np.eye(3), 1.0, np.zeros(3))
    for given in (None, tmp_path / "sparse"):
        scene = import_scene(tmp_path / "garden.ply", cameras=given, ground_frame=frame)
        assert len(scene.cameras) == 3 and "OPENCV" in scene.notes[-1]


def test_names_keep_their_folder_only_where_needed(tmp_path):
    cameras = ring(count=2)
    object.__setattr__(cameras[0], "name", "left/0001")
    object.__setattr__(cameras[1], "name", "right/0002")
    made.colmap_binary(tmp_path, cameras)
    assert [c.name for c in read_cameras(tmp_path)] == ["0001", "0002"]
    object.__setattr__(cameras[1], "name", "right/0001")
    made.colmap_binary(tmp_path, cameras)
    assert [c.name for c in read_cameras(tmp_path)] == ["left/0001", "right/0001"]


def damaged_text(name, before, after):
    def write(folder):
        made.colmap_text(folder, ring(count=3))
        path = folder / name
        text = path.read_text()
        assert before in text
        path.write_text(text.replace(before, after, 1))

    return write


def damaged_binary(name, place, form, value):
    def write(folder):
        made.colmap_binary(folder, ring(count=3))
        data = bytearray((folder / name).read_bytes())
        struct.pack_into(form, data, place, value)
        (folder / name).write_bytes(data)

    return write


BAD = {
    "model": (damaged_text("cameras.txt", "PINHOLE", "PERISCOPE"), "line 2 .*a camera"),
    "few parameters": (damaged_text("cameras.txt", " 25.0", ""), "line 2 .*parameters"),
    "width": (damaged_text("cameras.txt", " 64 ", " 0 "), "is 0 x 48 px"),
    "focal": (damaged_text("cameras.txt", " 50.0", " nan"), "centre nan, 51"),
    "word": (damaged_text("images.txt", " 7 ring00", " seven ring00"), "line 3 .*an image"),
    "lens": (damaged_text("images.txt", " 7 ring00", " 8 ring00"), "ring00.JPG has camera 8"),
    "binary model": (damaged_binary("cameras.bin", 12, "<i", 99), "camera 7 has the model 99"),
    "lying count": (damaged_binary("images.bin", 0, "<Q", 2**63), "ends within an entry"),
    "lying points": (damaged_binary("images.bin", 8 + 64 + 11, "<Q", 2**62), "ends within"),
    "no rotation": (damaged_binary("images.bin", 12, "<d", np.nan), "has rotation .nan"),
    "no images": (damaged_binary("images.bin", 0, "<Q", 0), "has no images"),
}


@pytest.mark.parametrize("case", BAD)
def test_damaged_models_end_in_one_clear_line(tmp_path, case):
    write, expected = BAD[case]
    write(tmp_path)
    with pytest.raises(InputError, match=expected) as caught:
        read_cameras(tmp_path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


def test_folders_without_a_model_and_empty_files(tmp_path):
    with pytest.raises(InputError, match="no COLMAP model"):
        read_cameras(tmp_path)
    made.write_folder(tmp_path, {"cameras.bin": b"", "images.bin": b""})
    with pytest.raises(InputError, match="is empty"):
        read_cameras(tmp_path)


def test_transforms_json_tells_of_distortion(tmp_path):
    frame = '{"transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}'
    head = '{"w": 8, "h": 6, "fl_x": 9, "camera_model": "OPENCV", "k1": %s, "frames": [%s]}'
    for k1, count in (("0.0", 0), ("0.03", 1)):
        (tmp_path / "transforms.json").write_text(head % (k1, frame))
        cameras, notes = load_cameras(tmp_path)
        assert len(cameras) == 1 and len(notes) == count
