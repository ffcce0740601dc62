"""Every command and every Python block of the pages runs, in the order of its page.

Each page has a fresh folder with a stand-in for the reader's capture, called garden, the same as a
file without cameras, called park.ply, and painted masks of its cameras; the same from the air,
called survey, and as nerfstudio leaves it, called yard. Commands run as they stand.
"""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from made_captures import write_model_folder
from made_formats import write_splats
from pages import viewing
from rainsim.io.images import write_png
from rainsim.scene.cameras import look_at, write_transforms
from site_pages import PAGES, ROOT, blocks, commands, name_of

FOREIGN = {  # words of commands that do not run here, and what they need
    "cuda": "a GPU", "--scheduler": "a scheduler", "--video": "the extra video",
    "--exr": "the extra exr", "world": "the extra usd", "shot.usda": "a camera of Blender",
    "npm": "another program",
}  # fmt: skip
QUICK = ("docs/roads/hydraulics.md",)
NAMES = ("DSC07956", "DSC07960")  # of cameras that pages ask for


def has_work(path):
    """Whether a page has a block that runs."""
    return any(commands(block) or block.language == "python" for block in blocks(path))


@pytest.fixture(scope="session")
def garden(tmp_path_factory, bicycle_scene):
    """The built-in yard as a trained model's folder, and as a file without cameras, park.ply."""
    folder = tmp_path_factory.mktemp("captures")
    cameras = tuple(camera.resized(5184, 3456) for camera in bicycle_scene.cameras)
    names = [*NAMES, *(camera.name for camera in cameras[len(NAMES) :])]
    scene = replace(bicycle_scene, cameras=cameras)
    write_model_folder(folder / "garden", scene, names)
    shutil.copy(next((folder / "garden").rglob("*.ply")), folder / "park.ply")
    (folder / "masks").mkdir()
    for name in names:
        write_png(folder / "masks" / f"{name}.png", np.full((48, 72), 7, np.uint8))
    _write_survey(folder / "survey", scene)
    _write_yard(folder / "yard", scene)
    return folder


def _write_survey(folder, scene):
    """A scene under cameras that look straight down from 25 m."""
    frame = scene.ground_frame
    places = [(3.0 * i, 3.0 * j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    eyes = [frame.to_capture((x, y, 25.0)) for x, y in places]
    north = frame.rotation[1]
    cameras = [look_at(eye, eye - frame.up, north, 40, 1200, 900) for eye in eyes]
    names = [f"DJI_{number:04}" for number in range(len(cameras))]
    write_model_folder(folder, replace(scene, cameras=tuple(cameras)), names)


def _write_yard(folder, scene):
    """A scene as nerfstudio leaves it: its splats are half as large as its cameras say."""
    folder.mkdir()
    splats, half = scene.splats, np.float32(0.5)
    small = replace(splats, position=half * splats.position, scale=half * splats.scale)
    write_splats(folder / "splat.ply", small)
    whole = (folder / "splat.ply").read_bytes()
    said = whole.replace(b"1.0\n", b"1.0\ncomment Vertical Axis: z\n", 1)
    (folder / "splat.ply").write_bytes(said)
    write_transforms(folder / "transforms.json", scene.cameras)
    file = folder / "transforms.json"
    data = json.loads(file.read_text(encoding="utf-8"))
    for entry in data["frames"]:
        del entry["camera_from_world"]  # our own, which the other program does not write
    file.write_text(json.dumps(data), encoding="utf-8")
    saved = {"transform": np.eye(4)[:3].tolist(), "scale": 0.5}
    (folder / "dataparser_transforms.json").write_text(json.dumps(saved), encoding="utf-8")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder; programs that are started in it find this checkout."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), *filter(None, sys.path)]))
    monkeypatch.setenv("RAINSIM_CACHE", str(tmp_path / "kept"))
    monkeypatch.delenv("RAINSIM_SCENES", raising=False)
    return tmp_path


def run(command):
    """Run a command of the program as it stands; fail with what it said."""
    if command.words[1] == "view":
        with viewing(*command.words[2:]):
            return  # it has printed its address
    words = [sys.executable, "-m", *command.words]
    done = subprocess.run(words, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, f"{' '.join(command.words)}\n{done.stderr}"
    if command.into:
        with open(command.into, "w", encoding="utf-8") as file:
            file.write(done.stdout)


def is_foreign(command):
    """Whether a command needs what is not here."""
    return not set(command.words).isdisjoint(FOREIGN)


def walk(path, only_python=False):
    """Run the blocks of a page in their order; keyframes go to the preset file made last."""
    names, preset = {}, None
    for block in blocks(path):
        if block.language == "python":
            exec(compile(block.text, name_of(path), "exec"), names)
        elif block.language == "toml" and preset:
            with open(preset, "a", encoding="utf-8") as file:
                file.write("\n" + block.text)
        for command in [] if only_python else commands(block):
            if not is_foreign(command):
                run(command)
                preset = command.into or preset


@pytest.mark.parametrize("name", QUICK)
def test_python_of_a_page_runs(name, here, capsys):
    (here / "valley").mkdir()
    from made_files import small_state, small_terrain
    from rainsim import write_state, write_terrain

    terrain = small_terrain()
    write_terrain("valley", terrain)
    (here / "flow/states").mkdir(parents=True)
    write_state("flow/states/00023.npz", small_state())
    walk(ROOT / name, only_python=True)
    assert "relative error 0.00" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", [pytest.param(path, id=name_of(path)) for path in PAGES if has_work(path)]
)
def test_a_page_runs_as_it_stands(path, here, garden):
    for name in ("garden", "masks", "park.ply", "survey", "yard"):
        (here / name).symlink_to(garden / name)
    (here / "examples").symlink_to(ROOT / "examples")
    walk(path)


def test_what_is_left_out_is_little():
    every = [command for path in PAGES for block in blocks(path) for command in commands(block)]
    left_out = [command for command in every if is_foreign(command)]
    assert len(every) > 100 and len(left_out) <= 10, (len(every), left_out)
