"""`rainsim import`: a capture becomes a scene folder, with its ground frame printed."""

import json
from dataclasses import replace

import numpy as np
import pytest

from made_formats import write_splats
from rainsim.config.settings import Config
from rainsim.io import cache
from rainsim.scene.cameras import write_transforms
from rainsim.scene.folder import read_scene
from rainsim.scene.ground import read_ground_frame
from rainsim.scene.library import load_scene
from rainsim.terrain import kept_terrain
from scenes import tiny_scene


def capture(folder):
    """A splat PLY with cameras beside it, as a user has it."""
    scene = tiny_scene()
    write_splats(folder / "tiny.ply", scene.splats)
    write_transforms(folder / "transforms.json", scene.cameras)
    return scene


def test_the_scale_is_assumed_and_says_so(rainsim, tmp_path):
    scene = capture(tmp_path)
    done = rainsim("import", "tiny.ply")
    assert done.code == 0, done.err
    assert "ASSUMED" in done.out and "ASSUMED" in done.err
    assert "x captured colour" in done.out and "--ground-albedo sets it" in done.out
    assert "x white, under clouds" in done.out
    found = read_scene(tmp_path / "tiny-scene")
    assert found.ground_frame.scale_assumed
    assert found.ground_frame.up @ scene.ground_frame.up > np.cos(np.radians(0.2))
    heights = [found.ground_frame.to_ground(camera.position)[2] for camera in found.cameras]
    assert abs(np.mean(heights) - 1.8) < 1e-6


def test_a_given_scale_is_kept_and_json_is_on_stdout(rainsim, tmp_path):
    scene = capture(tmp_path)
    done = rainsim("import", "tiny.ply", "--meters-per-unit", "0.6", "--out", "s", "--json", "-q")
    assert done.code == 0 and done.err == ""
    shown = json.loads(done.out)
    assert shown["splats"] == len(scene.splats)
    assert shown["cameras"] == [camera.name for camera in scene.cameras]
    assert shown["ground_frame"]["meters_per_unit"] == 0.6
    assert 0.2 < shown["calibration"]["albedo"] < 2.5
    assert shown["calibration"]["zenith"] == pytest.approx(0.9 / shown["calibration"]["albedo"])
    frame = read_ground_frame(tmp_path / "s" / "ground_frame.json")
    assert np.array_equal(frame.rotation, shown["ground_frame"]["rotation"])
    points = scene.ground_frame.to_capture(np.array([[0.0, 0, 0], [1, 0.5, 0], [0, 0, 0.5]]))
    assert np.allclose(frame.to_ground(points)[:, 2], [0, 0, 0.5], atol=0.005)


def test_its_ground_frame_can_be_given_back(rainsim, tmp_path):
    capture(tmp_path)
    rainsim("import", "tiny.ply", "--camera-height", "1.1", "--out", "one")
    done = rainsim("import", "tiny.ply", "--ground-frame", "one/ground_frame.json", "--out", "two")
    assert done.code == 0, done.err
    one, two = (read_scene(tmp_path / name) for name in ("one", "two"))
    assert np.array_equal(one.ground_frame.rotation, two.ground_frame.rotation)
    assert one.ground_frame.meters_per_unit == two.ground_frame.meters_per_unit
    record = json.loads((tmp_path / "two" / "provenance.json").read_text())
    assert record["complete"] and record["input"]["sha256"] == two.source_hash != ""


def test_the_map_of_the_folder_is_kept_for_its_runs(rainsim, tmp_path, monkeypatch):
    """Content of the folder names the map, not that of the capture."""
    monkeypatch.setenv("RAINSIM_CACHE", str(tmp_path / "kept"))
    capture(tmp_path)
    assert rainsim("import", "tiny.ply", "--out", "one").code == 0
    scene, terrain, kind = load_scene(tmp_path / "one"), Config().terrain, kept_terrain.KIND
    assert (
        cache.read(kind, cache.name_of(kind, *kept_terrain.inputs_of(scene, terrain))) is not None
    )
    other = replace(terrain, spacing=0.03)
    assert cache.read(kind, cache.name_of(kind, *kept_terrain.inputs_of(scene, other))) is None


def test_overwriting_keeps_what_is_not_ours(rainsim, tmp_path):
    capture(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    assert rainsim("import", "tiny.ply", "--out", "out").code == 2
    assert rainsim("import", "tiny.ply", "--out", "out", "--overwrite").code == 0
    assert rainsim("import", "tiny.ply", "--out", "out", "--overwrite").code == 0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    ours = {"scene.json", "splats.npz", "ground_frame.json", "provenance.json"}
    assert names == ours | {"mine.txt"}
