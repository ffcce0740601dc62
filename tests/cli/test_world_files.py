"""Cameras of other programs on the command line, and `rainsim world`."""

import json

import numpy as np
import pytest

from rainsim.errors import InputError
from rainsim.scene.cameras import read_cameras
from rainsim.scene.library import load_scene
from rainsim.scene.shot import read_shot
from run_folders import written

FILM = ["--spacing", "0.04", "--extent", "1", "--relight", "off", "--width", "48"]


def shot_json(folder, **world):
    """Write what the script for Blender writes: two frames that look along y, z up."""
    frames = [
        {"file_path": str(n), "fl_x": 90, "fl_y": 90, "cx": 48, "cy": 30,
         "transform_matrix": [[1, 0, 0, 0.1 * n], [0, 0, -1, -2], [0, 1, 0, 1.2], [0, 0, 0, 1]]}
        for n in (1001, 1002)
    ]  # fmt: skip
    shot = {"camera": "Cam", "up_axis": "Z", "meters_per_unit": 1, "fps": 30, "first_frame": 1001}
    data = {"shot": {**shot, **world}, "w": 96, "h": 72, "frames": frames}
    (folder / "camera.json").write_text(json.dumps(data))


@pytest.mark.parametrize("first", [1e15, -1e300])
def test_frames_of_absurd_numbers_are_refused(tmp_path, first):
    shot_json(tmp_path, first_frame=first)
    with pytest.raises(InputError, match=r"begins at frame |first_frame is"):
        read_shot(tmp_path / "camera.json")


@pytest.mark.parametrize("option", ["--path", "--cameras"])
def test_a_run_draws_the_frames_of_a_camera_in_the_ground_frame(
    option, rainsim, scene_folder, tmp_path
):
    shot_json(tmp_path)
    done = rainsim("run", "--scene", scene_folder, *FILM, option, "camera.json", "--out", "out")
    assert done.code == 0, done.err
    assert "2 frames in out/frames" in done.err
    assert json.loads((tmp_path / "out/provenance.json").read_text())["settings"]["fps"] == 30
    frame = load_scene(scene_folder).ground_frame
    for n, camera in zip((1001, 1002), read_cameras(tmp_path / "out/transforms.json"), strict=True):
        assert (camera.width, camera.height, camera.fx) == (48, 36, 45)
        ground = frame.camera_in_ground(camera)
        np.testing.assert_allclose(ground.position, [0.1 * n, -2, 1.2], atol=1e-9)
        np.testing.assert_allclose(ground.forward, [0, 1, 0], atol=1e-9)


def test_files_are_numbered_as_the_camera_s_frames(rainsim, scene_folder, tmp_path):
    pytest.importorskip("OpenEXR")
    shot_json(tmp_path)
    run = "run", "--scene", scene_folder, *FILM, "--path", "camera.json", "--exr"
    for more, first in (((), 1001), (("--frame-start", "7"), 7)):
        done = rainsim(*run, *more, "--frames", "1", "--out", f"from_{first}")
        assert done.code == 0, done.err
        (path,) = (tmp_path / f"from_{first}/exr").iterdir()
        assert path.name == f"rain.{first:04}.exr"


def test_numbers_of_a_camera_over_the_capture_count_as_they_stand(rainsim, scene_folder, tmp_path):
    shot_json(tmp_path, up_axis="Y", meters_per_unit=7)
    done = rainsim("run", "--scene", scene_folder, *FILM, "--path", "camera.json", "--fps", "12",
                   "--path-in", "capture", "--frames", "1", "--out", "out")  # fmt: skip
    assert done.code == 0, done.err
    assert "the path has 30 frames/s and is drawn at 12" in done.err
    (camera,) = read_cameras(tmp_path / "out/transforms.json")
    np.testing.assert_allclose(camera.position, [100.1, -2, 1.2], atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--path-in", "capture"], "--path-in capture is about a --path of USD, glTF or Blender"),
        (["--path", "camera.json", "--path-camera", "Other"], "1 camera (Cam) and none is 'Other'"),
        (["--path", "camera.json", "--cameras", "camera.json"], "--path is given, too"),
        (["--cameras", "camera.json", "--orbit"], "--path and --orbit are both given"),
    ],
)
def test_options_of_a_path_that_do_not_fit_are_refused(arguments, message, rainsim, tmp_path):
    shot_json(tmp_path)
    done = rainsim("run", *FILM, *arguments)
    assert done.code == 2 and message in done.error


@pytest.mark.parametrize("command", ["import", "splat"])
def test_a_camera_of_a_film_is_no_camera_of_a_capture(command, rainsim, scene_folder, tmp_path):
    shot_json(tmp_path)
    out = "imported" if command == "import" else "a.png"
    done = rainsim(command, scene_folder, "--cameras", "camera.json", "--out", out)
    assert done.code == 2 and "draw along it with `rainsim run --path`" in done.error


def test_a_world_has_the_frames_of_its_camera(rainsim, scene_folder, tmp_path):
    pytest.importorskip("pxr")
    pytest.importorskip("trimesh")
    shot_json(tmp_path)
    world = "world", scene_folder, *FILM[:4]
    done = rainsim(*world, "--path", "camera.json", "--width", "48", "--out", "out", "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)
    assert (result["frames"], result["first_frame"], result["fps"]) == (2, 1001, 30)
    kept = json.loads((tmp_path / "out/provenance.json").read_text())
    assert sorted(kept["files"]) == sorted(result["files"]) and len(result["files"]) == 7
    assert rainsim(*world, "--out", "out").code == 2  # it is kept
    done = rainsim(*world, "--parts", "ground", "--out", "out", "--overwrite")
    assert done.code == 0, done.err
    left = {path.name for path in (tmp_path / "out").iterdir()}
    assert left == {"world.usda", "ground.usdc", "ground.glb", "provenance.json"}
    assert "startTimeCode" not in (tmp_path / "out/world.usda").read_text()
    done = rainsim(*world, "--parts", "sky", "--out", "out2")
    assert done.code == 2 and "--parts has 'sky'; each must be one of camera, ground" in done.error


def test_a_world_that_was_stopped_is_written_again_to_the_same_bytes(
    rainsim, scene_folder, tmp_path, monkeypatch
):
    pytest.importorskip("pxr")
    pytest.importorskip("trimesh")
    words = "world", scene_folder, *FILM[:4], "--frames", "3", "--width", "48", "--out"
    assert rainsim(*words, "whole").code == 0
    whole = written(tmp_path / "whole")

    def interrupted(*_):
        raise KeyboardInterrupt

    for out in ("write_glb", "falling_at", "usd_files.write_world"):
        with monkeypatch.context() as patched:
            patched.setattr(f"rainsim.world.write.{out}", interrupted)
            assert rainsim(*words, out).code == 130
        again = rainsim(*words, out)
        assert again.code == 2 and "--resume to go on with an unfinished run" in again.error
        other = rainsim(*words, out, "--resume", "--rain", "3")
        assert other.code == 2 and "was another" in other.error
        done = rainsim(*words, out, "--resume")
        assert done.code == 0, done.err
        assert written(tmp_path / out) == whole


def test_a_world_needs_usd(rainsim, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pxr", None)
    done = rainsim("world", "bicycle")
    assert done.code == 1 and "usd-core is not installed" in done.error
