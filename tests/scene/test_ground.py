"""The ground frame: found, given, refused, stored."""

import json
import math
import os
import re
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import captures
from benchmarks import ground as suite
from made_captures import patio, ring, splats_at
from rainsim.errors import GroundError, InputError, ParameterError
from rainsim.scene import ground
from rainsim.scene.cameras import look_at, read_cameras
from rainsim.scene.formats import read_splats
from rainsim.scene.types import GroundFrame


def random_frame(seed=1):
    """A frame whose capture is tilted, not metric and set off."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return GroundFrame(turn * np.sign(np.linalg.det(turn)), 0.37, rng.normal(size=3) * 5)


def captured(frame, points, cameras=()):
    """The splats and cameras of a ground frame's scene as `frame`'s capture holds them."""
    return (
        splats_at(frame.to_capture(points), scale=0.02 / frame.meters_per_unit),
        [frame.camera_in_capture(camera) for camera in cameras],
    )


ASSUMED = ground.ASSUMED_CAMERA_HEIGHT / 1.5  # over the height of `ring`


def angle(a, b):
    return math.degrees(math.atan2(np.linalg.norm(np.cross(a, b)), a @ b))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_paving_is_found_in_any_capture_frame(seed):
    frame = random_frame(seed)
    found = ground.estimate_ground_frame(*captured(frame, patio(), ring()))
    assert angle(found.up, frame.up) < 0.1
    # The paving stands for the ground, not the lawn 6 cm above it, nor the table top.
    assert abs(found.to_ground(frame.to_capture(np.zeros(3)))[2]) < 0.002
    assert found.meters_per_unit == pytest.approx(ASSUMED * frame.meters_per_unit, rel=0.002)
    assert found.scale_assumed and "SCALE IS ASSUMED" in found.notes[-1]
    assert "--known-length" in found.notes[-1] and "the 12 cameras stood" in found.notes[-1]
    assert found.confidence > 0.8
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found.rotation) > 0


def test_axes_and_origin_follow_the_cameras():
    cameras = ring()
    frame = random_frame()
    found = ground.estimate_ground_frame(*captured(frame, patio(), cameras))
    first = found.camera_in_ground(frame.camera_in_capture(cameras[0]))
    assert abs(first.forward[1]) < 1e-9 and first.forward[0] > 0.9
    middle = found.to_ground(frame.to_capture(np.mean([c.position for c in cameras], axis=0)))
    np.testing.assert_allclose(middle, [0, 0, ground.ASSUMED_CAMERA_HEIGHT], atol=1e-9)


def test_scale_given_as_length_or_camera_height():
    frame = random_frame()
    scene = captured(frame, patio(), ring())
    given = ground.estimate_ground_frame(*scene, meters_per_unit=0.9)
    assert given.meters_per_unit == 0.9 and not given.scale_assumed
    high = ground.estimate_ground_frame(*scene, camera_height=3.0)
    assert high.meters_per_unit == pytest.approx(2 * frame.meters_per_unit, rel=0.002)
    assert not high.scale_assumed and "3 m" in high.notes[-1]


def test_cameras_held_on_their_side_and_a_stray_camera():
    turn = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    sideways = []
    for camera in ring():
        matrix = camera.camera_from_world.copy()
        matrix[:3] = turn @ matrix[:3]
        sideways.append(type(camera)(48, 64, 50, 50, 24, 32, matrix))
    buried = look_at((0.5, 0, -0.5), (0, 0, -1), (0, 1, 0), 60, 64, 48)
    for cameras in (sideways, [*ring(count=30), buried]):
        found = ground.estimate_ground_frame(splats_at(patio()), cameras)
        assert angle(found.up, np.array([0, 0, 1.0])) < 0.1


def test_one_camera_is_enough():
    camera = look_at((3, 0, 1.5), (0, 0, 0.5), (0, 0, 1), 60, 64, 48)
    found = ground.estimate_ground_frame(splats_at(patio()), [camera])
    assert angle(found.up, np.array([0, 0, 1.0])) < 0.5


def test_camera_that_looks_straight_down_takes_x_from_its_image_up():
    camera = look_at((0, 0, 2), (0, 0, 0), (0, 1, 0), 60, 64, 48)
    found = ground.estimate_ground_frame(splats_at(patio()), [camera], up=(0, 0, 1))
    np.testing.assert_allclose(found.rotation[0], [0, 1, 0], atol=0.01)


def test_seeds_agree_and_the_answer_is_fixed():
    scene = captured(random_frame(), patio(), ring())
    frames = [ground.estimate_ground_frame(*scene, seed=seed) for seed in range(10)]
    assert max(angle(f.up, frames[0].up) for f in frames) < 0.02
    again = ground.estimate_ground_frame(*scene)
    assert np.array_equal(again.rotation, frames[0].rotation)
    assert np.array_equal(again.translation, frames[0].translation)


def test_far_floaters_and_haze_do_not_matter():
    rng = np.random.default_rng(5)
    points = np.concatenate(
        [patio(), rng.normal(size=(3000, 3)) * 3000, rng.normal(size=(4000, 3))]
    )
    splats = splats_at(points)
    splats.opacity[-4000:] = 0.05
    splats.scale[-7000:-4000] = 300
    found = ground.estimate_ground_frame(splats, ring())
    assert angle(found.up, np.array([0, 0, 1.0])) < 0.1
    assert found.meters_per_unit == pytest.approx(ASSUMED, rel=0.002)


def test_without_cameras_up_and_scale_are_needed_and_enough():
    frame = random_frame()
    splats, _ = captured(frame, patio())
    rough = np.add(frame.up, (0.1, 0, 0))
    found = ground.estimate_ground_frame(splats, [], up=rough, meters_per_unit=0.37)
    assert angle(found.up, frame.up) < 0.1 and found.meters_per_unit == 0.37
    assert "degrees from the up that was given" in found.notes[0]
    origin = frame.to_ground(found.to_capture(np.zeros(3)))
    assert abs(origin[2]) < 0.002 and np.hypot(*origin[:2]) < 1
    for given in ({}, {"up": rough}, {"meters_per_unit": 1.0}, {"up": rough, "camera_height": 1.5}):
        with pytest.raises(GroundError, match=r"--up x,y,z and --meters-per-unit S"):
            ground.estimate_ground_frame(splats, [], **given)


def test_an_up_that_the_cameras_speak_against_is_taken_and_told():
    found = ground.estimate_ground_frame(splats_at(patio()), ring(), up=(0, 1, 0.5))
    assert angle(found.up, np.array([0, 1, 0.5])) < 20
    assert any("held 63 degrees from the up that is given" in note for note in found.notes)


def test_an_up_that_is_given_is_never_refused():
    cloud = splats_at(np.random.default_rng(1).normal(size=(20_000, 3)))
    found = ground.estimate_ground_frame(cloud, ring(), up=(0.1, 0, 1))
    assert angle(found.up, np.array([0, 0, 1.0])) < 1  # as the cameras were held
    assert any("too poor to be found" in note for note in found.notes)


def shell(radius):
    points = np.random.default_rng(2).normal(size=(20_000, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)


@pytest.mark.parametrize(
    "points",
    [
        np.random.default_rng(1).normal(size=(20_000, 3)),
        shell(1.0),
        shell(4.0),
        np.random.default_rng(3).uniform([-5, 3.99, 0], [5, 4.01, 5], (20_000, 3)),  # a wall
        np.zeros((50, 3)),
    ],
    ids=["cloud", "ball", "room without floor", "wall", "one point"],
)
def test_what_has_no_ground_is_refused(points):
    with pytest.raises(GroundError, match=r"cannot be found.*--up"):
        ground.estimate_ground_frame(splats_at(points), ring())


def typed(text):
    return np.array(list(map(float, text.split(","))))


@pytest.mark.parametrize(("degrees", "share"), [(8, 0.5), (25, 0.55), (-15, 0.5)])
def test_of_two_planes_as_good_the_cameras_tell_the_level_one(degrees, share):
    scene, truth = captures.fold(3, degrees, share)
    found = ground.estimate_ground_frame(scene.splats, scene.cameras)
    assert angle(found.up, truth.frame.up) < 0.1
    # Three cameras do not tell: then both are named, and each can be said.
    with pytest.raises(
        GroundError, match=r"two planes .* degrees apart are as good.*--up="
    ) as told:
        ground.estimate_ground_frame(scene.splats, scene.cameras[::8])
    ways = [typed(text) for text in re.search(r"up (\S+) and (\S+);", str(told.value)).groups()]
    assert angle(*ways) == pytest.approx(abs(degrees), abs=0.2)
    for way in ways:
        found = ground.estimate_ground_frame(scene.splats, scene.cameras[::8], up=way)
        assert angle(found.up, way) < 0.2


def test_the_greater_of_two_planes_is_taken():
    scene, truth = captures.fold(3, 15, 0.75)
    assert angle(ground.estimate_ground_frame(scene.splats, scene.cameras).up, truth.frame.up) < 0.1


def test_rough_meadows_without_a_flat_place_are_found():
    rng = np.random.default_rng(4)
    points = rng.uniform(-3, 3, (20_000, 3))
    points[:, 2] = np.abs(rng.normal(0, 0.12, 20_000))
    frame = random_frame()
    splats, cameras = captured(frame, points, ring())
    found = ground.estimate_ground_frame(splats, cameras)
    assert angle(found.up, frame.up) < 1 and found.confidence < 1


@pytest.mark.slow
def test_up_of_fifty_captures_tilted_with_floaters():
    """With cameras and with none, of which few are refused."""
    rows = []
    for seed in range(50):
        capture = captures.yard(seed, (1e-3, 3e-3, 10e-3)[seed % 3], kerb=seed % 2 == 1, step=0.05)
        rows.append(suite.measure_frames(*capture, seed))
    blind = [row["blind_degrees"] for row in rows if row["blind_degrees"] is not None]
    assert max(row["up_degrees"] for row in rows) < 0.2  # 0.09 when written; a wrong sign: 180
    assert max(blind) < 1 and len(blind) >= 48


@pytest.mark.slow
def test_fifty_folds_are_right_or_refused():
    rows = [suite.measure_fold(*suite.FOLDS[seed % len(suite.FOLDS)], seed) for seed in range(50)]
    assert sum(row["wrong"] for row in rows) == 0
    assert max(row["told_degrees"] for row in rows) < 0.2
    assert sum(row["needlessly"] or 0 for row in rows) <= 1


def test_a_capture_of_haze_is_refused():
    with pytest.raises(GroundError, match="opacity"):
        ground.estimate_ground_frame(splats_at(patio(), opacity=0.01), ring())


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"up": (0, 0, 0)}, "up is"),
        ({"up": (0, 1)}, "up is"),
        ({"up": (0, math.nan, 1)}, "up is"),
        ({"up": "z"}, "up is"),
        ({"meters_per_unit": 0}, "meters-per-unit is 0"),
        ({"meters_per_unit": math.nan}, "meters-per-unit is nan"),
        ({"camera_height": -1.5}, "camera-height is -1.5 m"),
        ({"camera_height": 1.5, "meters_per_unit": 1.0}, "one way only"),
    ],
)
def test_impossible_values_are_refused(given, expected):
    with pytest.raises(ParameterError, match=expected):
        ground.estimate_ground_frame(splats_at(patio(60)), ring(), **given)


def test_rescaling_keeps_the_ground_and_the_axes():
    frame = random_frame()
    splats, cameras = captured(frame, patio(), ring())
    found = ground.estimate_ground_frame(splats, cameras)
    by_length = ground.rescale_ground_frame(found, cameras, meters_per_unit=0.9)
    again = ground.estimate_ground_frame(splats, cameras, meters_per_unit=0.9)
    np.testing.assert_allclose(by_length.rotation, again.rotation)
    np.testing.assert_allclose(by_length.translation, again.translation, atol=1e-9)
    assert by_length.notes == again.notes and not by_length.scale_assumed
    by_height = ground.rescale_ground_frame(
        found, cameras, camera_height=2 * ground.ASSUMED_CAMERA_HEIGHT
    )
    assert by_height.meters_per_unit == pytest.approx(2 * found.meters_per_unit)


def test_ground_frame_file_reads_back_exactly(tmp_path):
    found = ground.estimate_ground_frame(*captured(random_frame(), patio(), ring()))
    found = replace(found, notes=(*found.notes, "long" * 400))  # is kept whole
    ground.write_ground_frame(tmp_path / "g.json", found)
    assert json.loads((tmp_path / "g.json").read_text())["rainsim_ground_frame"] == 1
    back = ground.read_ground_frame(tmp_path / "g.json")
    assert np.array_equal(back.rotation, found.rotation)
    assert np.array_equal(back.translation, found.translation)
    for name in ("meters_per_unit", "confidence", "notes", "scale_assumed"):
        assert getattr(back, name) == getattr(found, name)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[]", "ground frame is not an object"),
        ('{"rainsim_ground_frame": 2}', "has rainsim_ground_frame 2; it must be 1"),
        ('{"rotation": [[1,0,0],[0,1,0],[0,0,1]]}', "meters_per_unit is missing"),
        ('{"rotation": [[1,0,0],[0,1,0],[0,0,-1]], "meters_per_unit": 1}', "right-handed"),
        ('{"rotation": [[1,0,0],[0,1,0],[0,0,2]], "meters_per_unit": 1}', "right-handed"),
        ('{"rotation": 3}', "rotation is 3"),
        ('{"rotation": [[1,0,0],[0,1,0],[0,0,1]], "meters_per_unit": -1}', "meters_per_unit is -1"),
        ('{"rotation": [[1,0,0],[0,1,0],[0,0,1]], "meters_per_unit": 1}', "translation is missing"),
    ],
)
def test_bad_ground_frame_files(tmp_path, text, expected):
    (tmp_path / "g.json").write_text(text)
    with pytest.raises(InputError, match=expected):
        ground.read_ground_frame(tmp_path / "g.json")


@pytest.mark.slow
def test_the_real_garden(tmp_path, shared):
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    run = [sys.executable, shared("data/unpack.py"), tmp_path]
    subprocess.run(run, check=True, env=environment, stdout=subprocess.DEVNULL)
    cameras = read_cameras(tmp_path / "garden/cameras.json")
    start = time.perf_counter()
    splats, _ = read_splats(tmp_path / "garden/point_cloud/iteration_30000/point_cloud.ply")
    read_time = time.perf_counter() - start
    frames = [ground.estimate_ground_frame(splats, cameras, seed=seed) for seed in range(10)]
    assert max(angle(f.up, frames[0].up) for f in frames) < 0.02
    found = frames[0]
    heights = found.to_ground([c.position for c in cameras])[:, 2] / found.meters_per_unit
    assert heights.min() == pytest.approx(2.1, abs=0.05)  # above the paving, not the lawn
    assert heights.max() == pytest.approx(4.4, abs=0.05)
    assert heights.mean() == pytest.approx(3.14, abs=0.01)
    assert found.meters_per_unit == pytest.approx(0.574, abs=0.001)
    assert read_time < 5  # some 0.4 s on an idle core
