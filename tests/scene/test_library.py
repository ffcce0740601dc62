"""Captures and scene folders as files, and scenes by name."""

import hashlib
import json
import os
import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from made_captures import patio, ring, splats_at
from made_formats import write_splats
from rainsim.errors import GroundError, InputError, ParameterError
from rainsim.scene import library
from rainsim.scene.cameras import write_transforms
from rainsim.scene.folder import import_scene, read_scene, write_scene
from rainsim.scene.ground import write_ground_frame
from rainsim.scene.library import find_scene, list_scenes, load_scene
from rainsim.scene.painted import PaintedClasses, read_painted, write_painted
from rainsim.scene.types import GroundFrame, Scene

FRAME = GroundFrame(np.eye(3), 0.8, np.array([0.0, 0, 0.1]), notes=("made", "scale given: 0.8"))
ARRAYS = ("position", "rotation", "scale", "opacity", "sh")


@pytest.fixture(autouse=True)
def no_scenes_of_the_user(monkeypatch, tmp_path):
    monkeypatch.delenv("RAINSIM_SCENES", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data-home"))


@pytest.fixture
def model(tmp_path):
    """A trained model's folder with two iterations; the newer has one splat more."""
    for iteration, extra in ((7000, 0), (30_000, 1)):
        folder = tmp_path / f"yard/point_cloud/iteration_{iteration}"
        folder.mkdir(parents=True)
        write_splats(folder / "point_cloud.ply", splats_at(patio(3000 + extra)))
    write_transforms(tmp_path / "yard/cameras.json", ring())
    return tmp_path / "yard"


def made_scene(name="made"):
    return Scene(name, splats_at(patio(2000), 4), tuple(ring()), FRAME, notes=("one", "two"))


def test_newest_iteration_and_the_cameras_beside_it(model):
    scene = import_scene(model)
    file = model / "point_cloud/iteration_30000/point_cloud.ply"
    assert scene.name == "yard" and scene.source == model and len(scene.splats) == 3501
    assert scene.source_hash == hashlib.sha256(file.read_bytes()).hexdigest()
    assert [c.name for c in scene.cameras] == [c.name for c in ring()]
    assert scene.ground_frame.meters_per_unit == pytest.approx(1.2, rel=0.005)
    by_file = import_scene(file)
    assert by_file.name == "yard" and len(by_file.cameras) == 12


def test_a_lone_file_is_read_with_an_up_and_a_scale_that_are_assumed(tmp_path):
    write_splats(tmp_path / "lone.ply", splats_at(patio(3000)))
    assert import_scene(tmp_path / "lone.ply").ground_frame.scale_assumed
    scene = import_scene(tmp_path / "lone.ply", up=(0, 0, 1), meters_per_unit=2.0)
    assert scene.name == "lone" and scene.cameras == ()
    assert scene.ground_frame.meters_per_unit == 2 and not scene.ground_frame.scale_assumed
    with pytest.raises(GroundError, match="no cameras"):
        import_scene(tmp_path / "lone.ply", camera_height=1.5)
    write_transforms(tmp_path / "transforms.json", ring())
    assert len(import_scene(tmp_path / "lone.ply").cameras) == 12
    assert import_scene(tmp_path).name == tmp_path.name  # the only PLY in its folder
    write_splats(tmp_path / "other.ply", splats_at(patio(3000)))
    with pytest.raises(InputError, match=r"2 splat files \(lone.ply, other.ply\).*name it, as"):
        import_scene(tmp_path)


def test_ground_frame_given_as_a_file_wins(model, tmp_path):
    write_ground_frame(tmp_path / "g.json", FRAME)
    scene = import_scene(model, ground_frame=tmp_path / "g.json", meters_per_unit=3.0)
    assert scene.ground_frame.meters_per_unit == 0.8


@pytest.mark.parametrize("cameras", [tuple(ring()), ()])
def test_scene_folder_reads_back_exactly(tmp_path, cameras):
    drains = ((0.1, -2.0, 1 / 3), (4.0, 5.0, 6.0)) if cameras else ()
    scene = replace(made_scene(), cameras=cameras, source_hash="abc", drains=drains)
    write_scene(tmp_path / "a/scene", scene)
    back = read_scene(tmp_path / "a/scene")
    assert back.drains == drains
    for name in ARRAYS:
        assert np.array_equal(getattr(back.splats, name), getattr(scene.splats, name))
        assert getattr(back.splats, name).dtype == np.float32
    assert (back.name, back.notes, back.source_hash) == ("made", ("one", "two"), "abc")
    assert back.source == tmp_path / "a/scene" and len(back.cameras) == len(cameras)
    for camera, wanted in zip(back.cameras, cameras, strict=True):
        assert np.array_equal(camera.camera_from_world, wanted.camera_from_world)
    assert np.array_equal(back.ground_frame.rotation, FRAME.rotation)
    assert back.ground_frame.notes == FRAME.notes
    assert sorted(p.name for p in (tmp_path / "a/scene").iterdir()) == ["scene.json", "splats.npz"]
    assert len(import_scene(tmp_path / "a/scene/scene.json").splats) == len(scene.splats)


def painted_corner():
    """Two of four cells of 2 m painted."""
    cells = np.array([[1, -1], [-1, 0]], np.int16)
    return PaintedClasses(("grass", "paving"), cells, (-2.0, -2.0), 2.0)


def test_painted_classes_stay_with_their_scene_and_its_ground_frame(tmp_path):
    write_scene(tmp_path, replace(made_scene(), painted=painted_corner()))
    back = read_scene(tmp_path)
    np.testing.assert_array_equal(back.painted.cells, painted_corner().cells)
    assert back.painted.sha256 == back.painted_hash == painted_corner().sha256
    assert replace(painted_corner(), spacing=1.0).sha256 != painted_corner().sha256
    same = import_scene(tmp_path, ground_frame=back.ground_frame)
    assert same.painted_hash == back.painted_hash and same.notes == back.notes
    other = import_scene(tmp_path, meters_per_unit=1.6)  # their places are no longer known
    assert other.painted is None and "left out" in other.notes[-1]
    write_scene(tmp_path, made_scene())
    assert read_scene(tmp_path).painted is None
    write_painted(tmp_path / "c.npz", replace(painted_corner(), name=("grass",)))
    with pytest.raises(InputError, match="class 1; it must be below 1"):
        read_painted(tmp_path / "c.npz")


def test_overrides_of_a_scene_folder(tmp_path):
    write_scene(tmp_path / "s", made_scene())
    rescaled = import_scene(tmp_path / "s", meters_per_unit=1.6).ground_frame
    np.testing.assert_allclose(rescaled.translation, [0, 0, 0.2])
    assert rescaled.meters_per_unit == 1.6 and rescaled.notes[0] == "made"
    assert sum("scale" in note.lower() for note in rescaled.notes) == 1
    turned = import_scene(tmp_path / "s", up=(0, 0.05, 1)).ground_frame
    assert turned.meters_per_unit == 0.8  # known, so kept
    assert turned.translation[2] == pytest.approx(0, abs=0.01)
    assert len(import_scene(tmp_path / "s", cameras=ring(count=4)).cameras) == 4


def test_writing_again_replaces_both_files_and_nothing_else(tmp_path):
    write_scene(tmp_path, made_scene())
    (tmp_path / "mine.txt").write_text("keep")
    write_scene(tmp_path, replace(made_scene("other"), splats=splats_at(patio(500))))
    assert read_scene(tmp_path).name == "other"
    assert (tmp_path / "mine.txt").read_text() == "keep" and len(list(tmp_path.iterdir())) == 3


def damage_not_an_archive(folder):
    with open(folder / "splats.npz", "wb") as file:
        np.save(file, np.zeros(3))


def damage_mixed_up(folder):
    write_scene(folder.parent / "b", replace(made_scene(), splats=splats_at(patio(500))))
    os.replace(folder.parent / "b/splats.npz", folder / "splats.npz")


def damage_missing(folder):
    (folder / "splats.npz").unlink()


def damage_drains(folder):
    scene = json.loads((folder / "scene.json").read_text())
    (folder / "scene.json").write_text(json.dumps(scene | {"drains": [[0, 1, "down"]]}))


def damage_version(folder):
    (folder / "scene.json").write_text('{"rainsim_scene": 99}')


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (damage_not_an_archive, "damaged"),
        (damage_mixed_up, "belong together"),
        (damage_missing, "does not exist"),
        (damage_drains, "finite numbers of shape 1 x 3"),
        (damage_version, "version 1"),
    ],
)
def test_damaged_scene_folders(tmp_path, damage, expected):
    write_scene(tmp_path / "s", made_scene())
    damage(tmp_path / "s")
    with pytest.raises(InputError, match=expected) as caught:
        read_scene(tmp_path / "s")
    assert "\n" not in str(caught.value)


def test_paths_that_hold_no_scene(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        load_scene(str(tmp_path / "none"))
    with pytest.raises(InputError, match=r"no splat file.*name the splat file itself"):
        load_scene(tmp_path)


def test_a_folder_around_a_model_is_answered_with_the_model(model):
    with pytest.raises(InputError) as caught:
        load_scene(model.parent)
    assert str(caught.value).endswith(f"name {model}, which is one")


@pytest.fixture
def fake_built_in(monkeypatch):
    module = types.ModuleType("rainsim.demo_scenes.hut")
    module.make_hut = lambda: made_scene("hut")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(library, "BUILT_IN", {"hut": module.__name__})


def test_built_in_scene_says_that_it_is_generated(fake_built_in):
    scene = load_scene("hut")
    assert scene.name == "hut" and "generated" in scene.notes[-1]
    assert scene.ground_frame.meters_per_unit == 0.8
    assert load_scene("hut", meters_per_unit=2.0).ground_frame.meters_per_unit == 2
    with pytest.raises(ParameterError, match="its own cameras"):
        load_scene("hut", cameras=ring())


def test_scenes_of_the_user_come_first(fake_built_in, monkeypatch, tmp_path):
    first, second = tmp_path / "first", tmp_path / "data-home/rainsim/scenes"
    write_scene(first / "hut", made_scene("renamed"))
    write_scene(second / "hut", made_scene())
    write_scene(second / "barn", made_scene())
    write_splats(second / "shed.ply", splats_at(patio(500)))
    (second / "not a scene").mkdir()
    monkeypatch.setenv("RAINSIM_SCENES", os.pathsep.join([str(tmp_path / "none"), str(first)]))
    assert list_scenes() == [
        ("barn", str(second / "barn"), False),
        ("hut", str(first / "hut"), False),
        ("shed", str(second / "shed.ply"), False),
    ]
    scene = load_scene("hut")
    assert scene.source == first / "hut" and scene.name == "hut"
    assert load_scene("shed", up=(0, 0, 1), meters_per_unit=1.0).name == "shed"


def test_a_path_in_the_current_folder_is_taken_before_a_name(monkeypatch, tmp_path):
    write_scene(tmp_path / "bicycle", made_scene())
    monkeypatch.chdir(tmp_path)
    assert str(load_scene("bicycle").source) == "bicycle"


def test_a_folder_that_hides_a_built_in_scene_is_named(monkeypatch, tmp_path):
    """Results in a folder called street, and the scene of that name is gone."""
    (tmp_path / "street").mkdir()
    (tmp_path / "yard").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="hides the built-in scene street"):
        load_scene("street")
    with pytest.raises(InputError) as other:
        load_scene("yard")
    assert "built-in" not in str(other.value)
    with pytest.raises(InputError, match="the built-in scene traffic needs no import"):
        load_scene(Path("traffic"))  # as `rainsim import` has it


def test_unknown_names_are_answered_with_the_known_ones(fake_built_in):
    with pytest.raises(ParameterError, match=r"'barn' is not known; .* one of hut; .*RAINSIM"):
        load_scene("barn")


@pytest.mark.parametrize("name", ["", ".hidden", "...", "..\\hut", "hut\0", "a\nb"])
def test_names_that_climb_out_or_are_no_names(fake_built_in, name):
    with pytest.raises(ParameterError, match="scene name is"):
        load_scene(name)


def test_names_are_not_looked_up_outside_the_scene_folders(monkeypatch, tmp_path):
    write_scene(tmp_path / "secret", made_scene())
    (tmp_path / "scenes").mkdir()
    monkeypatch.setenv("RAINSIM_SCENES", str(tmp_path / "scenes"))
    monkeypatch.chdir("/")  # from where "../secret" is no path that exists
    with pytest.raises((InputError, ParameterError)):
        load_scene("../secret")
    assert find_scene("bicycle") is None
