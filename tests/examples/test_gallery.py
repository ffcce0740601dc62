"""The pictures of pages: drawn by the commands below them, of built-in scenes, in all weathers."""

import shlex
import subprocess

import numpy as np
import pytest
from PIL import Image
from test_examples import load

from rainsim.config.preset_files import preset_names
from rainsim.scene.library import BUILT_IN
from site_pages import DOCS, ROOT

MOST = 9e6  # bytes of docs: a clone stays small


@pytest.fixture
def module():
    return load("gallery")


def commands_in(path):
    """Return the commands that are stored in a picture."""
    with Image.open(path) as picture:
        return picture.getexif().get(0x010E, "").split("; ")


def shown(module):
    """Return (path, commands) of all pictures that the program draws."""
    return [entry for page in module.PAGES for entry in module.entries(ROOT / page)]


def value(command, option, default=None):
    """Return what a command gives for an option."""
    words = shlex.split(command)
    return words[words.index(option) + 1] if option in words else default


def test_every_picture_was_drawn_by_the_command_below_it(module):
    every = shown(module)
    assert len(every) >= 20
    for path, commands in every:
        assert commands_in(path) == commands, path.name
        for command in commands:
            assert value(command, "--scene", "bicycle") in BUILT_IN
            assert value(command, "--out").startswith(path.stem)


def test_the_gallery_has_all_scenes_in_all_weathers(module):
    commands = [c for _, given in module.entries(DOCS / "gallery.md") for c in given]
    there = {(value(c, "--scene", "bicycle"), value(c, "--preset")) for c in commands}
    weathers = set(preset_names()) - {"paper"}
    assert {(scene, name) for scene in BUILT_IN for name in weathers} <= there


def test_films_move_and_stills_are_sharp(module):
    films = 0
    for path, commands in shown(module):
        with Image.open(path) as picture:
            count = getattr(picture, "n_frames", 1)
            width = int(value(commands[0], "--width") or 648) * len(commands)
            assert picture.width == width, path.name
            assert (count > 1) == (path.suffix == ".webp")
            if count > 1:
                first = np.asarray(picture.convert("RGB"), float)
                picture.seek(count - 1)
                assert np.abs(np.asarray(picture.convert("RGB"), float) - first).mean() > 0.5
                films += 1
    assert films >= 3


def test_documents_stay_small():
    listed = subprocess.run(["git", "ls-files", "docs"], cwd=ROOT, capture_output=True, text=True)
    paths = [ROOT / name for name in listed.stdout.split()] or list(DOCS.rglob("*"))
    assert 1e6 < sum(path.stat().st_size for path in paths if path.is_file()) < MOST


PAGE = """# Pictures

![two stills](own/pair.jpg)

```
rainsim run --width 32 --out pair-left
rainsim run --width 32 --out pair-right
```

![no command](other.jpg)

text

![a film](own/film.webp)

```
rainsim run --fps 4 --width 32 --out film
```
"""


def test_pictures_are_drawn_as_the_page_says(module, tmp_path, monkeypatch, capsys):
    (tmp_path / "page.md").write_text(PAGE, encoding="utf-8")
    frames = [np.full((20, 32, 3), level, np.uint8) for level in (0, 90, 180)]
    asked = []

    def drawn(command):
        asked.append(command)
        return frames

    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "frames_of", drawn)
    module.main(pages=["page.md"], only=())
    assert [line.split()[1] for line in asked] == ["run"] * 3
    pair, film = tmp_path / "own/pair.jpg", tmp_path / "own/film.webp"
    assert commands_in(pair) == asked[:2] and commands_in(film) == asked[2:]
    still = np.asarray(Image.open(pair), int)
    assert still.shape == (20, 64, 3) and np.abs(still - 180).max() < 6
    with Image.open(film) as moving:
        assert moving.n_frames == 3
        moving.seek(1)
        assert np.abs(np.asarray(moving.convert("RGB"), int) - 90).max() < 12
        assert moving.info["duration"] == 250
    assert capsys.readouterr().out.count("kB") == 2
    asked.clear()
    module.main(pages=["page.md"], only=["film.webp"])
    assert len(asked) == 1


@pytest.mark.slow
def test_a_command_runs_in_an_empty_folder(module, scene_folder):
    command = (
        f"rainsim run --scene {scene_folder} --spacing 0.04 --extent 1 --frames 2 --width 48 "
        "--out tiny"
    )
    frames = module.frames_of(command)
    assert len(frames) == 2 and frames[0].shape == (36, 48, 3)
    assert (frames[0] != frames[1]).any()
