"""Captures in large coordinates, as those of a survey."""

import json

import numpy as np

from made_captures import capture_cameras, patio, ring, splats_at
from made_formats import stored_columns
from rainsim.output_folder.facts import input_facts
from rainsim.scene.folder import import_scene, read_scene, write_scene
from rainsim.scene.origin import capture_from_ground, moved, near_origin
from rainsim.scene.types import GroundFrame

UTM = np.array([512_345.0, 5_412_345.0, 0.0])  # zone 32, near Stuttgart
FRAME = GroundFrame(np.eye(3), 1.0, np.zeros(3))


def write_survey(folder, shift, kind="f8", cameras=0.0):
    """Write a PLY whose places are moved by `shift`, and cameras.json moved by `cameras`."""
    columns = stored_columns(splats_at(patio(600)))
    rows = np.zeros(700, [(name, f"<{kind}") for name in columns])
    for name, values in columns.items():
        rows[name] = values
    for name, value in zip("xyz", np.broadcast_to(shift, 3), strict=True):
        rows[name] += value
    word = {"f8": "double", "f4": "float"}[kind]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    lines += [f"property {word} {name}" for name in columns]
    (folder / "survey.ply").write_bytes(
        ("\n".join([*lines, "end_header"]) + "\n").encode() + rows.tobytes()
    )
    data = json.dumps(capture_cameras(moved(ring(), cameras)))
    (folder / "cameras.json").write_text(data, encoding="utf-8")
    return folder / "survey.ply"


def test_splats_and_cameras_of_a_survey_are_read_near_0_and_put_back(tmp_path):
    small = import_scene(write_survey(tmp_path, 0.0), ground_frame=FRAME)
    large = import_scene(write_survey(tmp_path, UTM, cameras=UTM), ground_frame=FRAME)
    assert small.origin == (0.0, 0.0, 0.0) and np.abs(large.origin - UTM).max() <= 6
    near = np.array(large.origin) - UTM
    np.testing.assert_allclose(
        large.splats.position + near, small.splats.position, atol=1e-6
    )  # float32 would have lost .5
    for one, other in zip(moved(large.cameras, near), small.cameras, strict=True):
        np.testing.assert_allclose(one.camera_from_world, other.camera_from_world, atol=1e-6)
    assert near_origin(large.cameras, large.origin) == list(large.cameras)
    write_scene(tmp_path / "scene", large)
    back = read_scene(tmp_path / "scene")
    assert back.origin == large.origin
    given = import_scene(tmp_path / "scene", cameras=moved(large.cameras, large.origin))
    np.testing.assert_allclose(given.cameras[0].position, large.cameras[0].position, atol=1e-6)
    place = np.append(back.ground_frame.to_ground(back.splats.position[:1]), 1.0)
    put_back = (capture_from_ground(back) @ place)[:3] - UTM
    np.testing.assert_allclose(put_back, small.splats.position[0], atol=1e-6)
    assert input_facts(back, tmp_path)["origin"] == list(large.origin)


def test_the_step_of_32_bit_numbers_far_from_0_is_said(tmp_path):
    path = write_survey(tmp_path, UTM, "f4", UTM)
    scene = import_scene(path, ground_frame=FRAME)
    assert scene.origin == (0.0, 0.0, 0.0)
    assert any("whose step there is 0.5" in note for note in scene.notes)
