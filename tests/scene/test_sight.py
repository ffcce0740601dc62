"""Cameras and splats that do not belong together are said to; frames of tools are found."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import made_formats as made
from made_formats import write_splats
from rainsim.errors import InputError, ParameterError
from rainsim.scene.cameras import look_at, write_transforms
from rainsim.scene.formats.spz import UNSAID, half_turned
from rainsim.scene.sight import in_nerfstudio_frame, require_sight, seen_shares, settled

SPLATS = made.tame_splats(900, 4)


def around(count=8, radius=6.0, at=(0.0, 0.0, 0.0), up=(0.0, -1.0, 0.0)):
    """Cameras in a ring that look at a place from above it."""
    at = np.array(at)
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    ring = [(radius * np.cos(a), -2.0, radius * np.sin(a)) for a in angles]
    return [look_at(eye, at, up, 60, 64, 48, f"c{k}") for k, eye in enumerate(at + ring)]


def test_the_share_of_splats_in_a_picture_is_counted():
    splats = dataclasses.replace(SPLATS, position=SPLATS.position * np.float32(0.2))
    near, away = around(4, 3.0), [look_at((0, -1, 9), (0, -1, 20), (0, -1, 0), 60, 64, 48)]
    shares = seen_shares(splats, near + away)
    camera = near[0]
    seen = splats.position @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    x, y = (camera.fx * seen[:, k] / seen[:, 2] + c for k, c in ((0, camera.cx), (1, camera.cy)))
    within = (seen[:, 2] > 0) & (x > 0) & (x < 64) & (y > 0) & (y < 48)
    assert shares[0] == pytest.approx(within.mean()) and shares[0] > 0.5 and shares[4] == 0


def test_cameras_of_another_place_are_refused_and_a_few_of_them_noted():
    good, far = around(), around(at=(500.0, 0.0, 0.0))
    assert require_sight("a.ply", SPLATS, good) == []
    assert require_sight("a.ply", SPLATS, ()) == []
    # Two of these look towards the splats from afar: a speck is not seen.
    with pytest.raises(InputError, match=r"none of its 8 cameras sees.*\(500,.*--cameras") as told:
        require_sight("a.ply", SPLATS, far)
    assert "\n" not in str(told.value)
    [note] = require_sight("a.ply", SPLATS, good + far[:4])
    assert note.startswith("4 of 12 cameras see less")
    assert require_sight("a.ply", SPLATS, good + far[:1]) == []  # one misplaced camera


def test_an_spz_without_axes_is_taken_as_its_cameras_see_it():
    below = SPLATS.position * np.float32([1, 0.2, 1]) + np.float32([0, 9, 0])
    splats = dataclasses.replace(SPLATS, position=below)  # y down: on the ground 9 units below
    cameras = around(at=(0.0, 8.0, 0.0))
    found, notes = settled(splats, ["a", UNSAID], cameras)
    assert found is splats and notes[0] == "a" and "(rub), in which its cameras see" in notes[1]
    found, notes = settled(half_turned(splats), [UNSAID], cameras)
    np.testing.assert_array_equal(found.position, splats.position)
    np.testing.assert_array_equal(found.sh, splats.sh)
    assert "(rdf), in which its cameras see" in notes[0]
    found, [note] = settled(splats, [UNSAID], ())
    assert found is splats and "neither confirm nor deny" in note
    found, [note] = settled(splats, [UNSAID], cameras, "rdf")
    np.testing.assert_array_equal(found.position, half_turned(splats).position)
    assert "as given" in note
    with pytest.raises(ParameterError, match="--spz-frame is 'up'; it must be one of rub, rdf"):
        settled(splats, [UNSAID], cameras, "up")
    with pytest.raises(ParameterError, match="no SPZ file or says its frame"):
        settled(splats, [], cameras, "rub")


def nerfstudio(folder, turn, shift, scale, applied):
    """Write a capture as nerfstudio leaves it; return its cameras in the frame of the splats."""
    cameras = around()
    write_transforms(folder / "transforms.json", cameras)
    data = json.loads((folder / "transforms.json").read_text())
    for frame in data["frames"]:
        del frame["camera_from_world"]
    data["applied_transform"], data["applied_scale"] = applied[:3].tolist(), 2.0
    (folder / "transforms.json").write_text(json.dumps(data))
    splats = dataclasses.replace(
        SPLATS, position=(scale * (SPLATS.position @ turn.T + shift)).astype(np.float32)
    )
    write_splats(folder / "splat.ply", splats)
    text = (folder / "splat.ply").read_bytes()
    (folder / "splat.ply").write_bytes(
        text.replace(b"1.0\n", b"1.0\ncomment Vertical Axis: z\n", 1)
    )
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = turn, shift
    saved = {"transform": (whole @ applied)[:3].tolist(), "scale": 2 * scale}
    (folder / "dataparser_transforms.json").write_text(json.dumps(saved))
    return splats, cameras


def test_cameras_follow_the_splats_into_nerfstudios_frame(tmp_path):
    turn = Rotation.from_euler("xyz", (80, 10, -30), degrees=True).as_matrix()
    applied = np.eye(4)[[0, 2, 1, 3]] * [[1], [1], [-1], [1]]
    applied[:3, 3] = 0.2, 0.1, -0.4
    moved, cameras = nerfstudio(tmp_path, turn, np.array([1.0, -2.0, 0.5]), 0.3, applied)
    files = tmp_path / "splat.ply", tmp_path / "transforms.json"
    found, [note] = in_nerfstudio_frame(*files, cameras)
    assert "by dataparser_transforms.json (scale 0.3)" in note
    np.testing.assert_allclose(seen_shares(moved, found), seen_shares(SPLATS, cameras), atol=0.01)
    one = found[3].camera_from_world @ [*moved.position[5], 1]
    before = cameras[3].camera_from_world @ [*SPLATS.position[5], 1]
    np.testing.assert_allclose(one[:3], 0.3 * before[:3], atol=1e-5)
    (tmp_path / "dataparser_transforms.json").write_text('{"transform": [[1]], "scale": 1}')
    with pytest.raises(InputError, match="shape 3 x 4"):
        in_nerfstudio_frame(*files, cameras)
    (tmp_path / "dataparser_transforms.json").unlink()
    same, [note] = in_nerfstudio_frame(*files, cameras)
    assert same is cameras and "copy it there" in note
    write_transforms(tmp_path / "transforms.json", cameras)  # our own lie in the splats' frame
    assert in_nerfstudio_frame(*files, cameras) == (cameras, [])
    write_splats(tmp_path / "other.ply", SPLATS)
    assert in_nerfstudio_frame(tmp_path / "other.ply", files[1], cameras) == (cameras, [])
