"""The page in a real browser: it opens, follows a drag and each slider, and gives pictures away."""

import re
import shlex
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from naive import decibel
from pages import viewing
from rainsim.config.tables import SLIDERS
from rainsim.io.images import read_image
from rainsim.scene.cameras import read_cameras

pytestmark = pytest.mark.slow
WIDTH = 400
# A value for each slider that shows in the picture of the tiny scene.
VALUES = {
    "rain_mm_per_hour": 120, "past_rain_mm": 0, "drying_hours": 20, "wind_speed_m_per_s": 18,
    "wind_direction_degrees": 120, "gusts": 0.5, "water_level_m": 0.05, "cloudiness": 0.1,
    "sun_azimuth_degrees": 20, "sun_elevation_degrees": 28, "brightness": 2, "exposure_ms": 30,
    "aperture_mm": 30, "focus_m": 0.5, "puddles": 0, "wetness": 1.5, "ripples": 0.2,
    "streak_strength": 4,
    "exposure_bias_ev": 0.6,
}  # fmt: skip


def differs(a, b):
    return a.shape != b.shape or (a != b).any()


def act(page, what):
    """Do something on the page and return the full pictures before and after it."""
    before, end = page.pixels(), time.monotonic() + 20
    what()
    # Another picture may come first that shows no change; a change may need a new terrain.
    page.wait_until(lambda: differs(before, page.pixels()) or time.monotonic() > end)
    page.settle(WIDTH)
    return before, page.pixels()


def test_a_drag_changes_the_picture_and_the_full_one_follows(server, open_page):
    page = open_page(server[1])
    page.settle(WIDTH)
    before, after = act(page, page.drag)
    assert before.shape[1] == after.shape[1] == WIDTH
    assert decibel(before, after) < 35
    shown = page.page.inner_text("body")
    assert re.search(r"finished: 400 x \d+ px in \d+ ms", shown)


def test_each_slider_acts(server, open_page):
    page = open_page(server[1])
    page.settle(WIDTH)
    for name in ("rain", "light", "camera", "flood"):
        page.open_folder(f"More: {name}")
    page.choose("sun", "angles")
    page.settle(WIDTH)
    assert {slider.key for slider in SLIDERS} == set(VALUES)
    for slider in SLIDERS:
        if slider.key == "water_level_m":
            act(page, lambda: page.tick("flood"))
        before, after = act(page, lambda s=slider: page.type_into(s.label, VALUES[s.key]))
        assert (before != after).any(), slider.key
        if slider.key == "drying_hours":  # water again, for the sun to glint on
            act(page, lambda: page.type_into("drying [h]", 0))
            act(page, lambda: page.type_into("past rain [mm]", 8))
        if slider.key == "puddles":
            act(page, lambda: page.type_into("puddles", 1))
        if slider.key == "water_level_m":
            act(page, lambda: page.tick("flood"))
    before, after = act(page, lambda: page.choose("preset", "drizzle"))
    assert (before != after).mean() > 0.2
    assert page.field("rain [mm/h]").input_value() == "2.5"  # the controls follow the preset


def test_modes_show_something_else_and_time_goes_on(server, open_page):
    page = open_page(server[1])
    page.settle(WIDTH)
    for mode in ("depth", "classes", "puddles after N mm"):
        before, after = act(page, lambda m=mode: page.choose("show", m))
        assert (before != after).mean() > 0.1, mode
    act(page, lambda: page.choose("show", "rain"))
    count = len(page.pictures())
    page.press("play")
    page.wait_until(lambda: len(page.pictures()) > count + 10)
    page.press("pause")
    page.settle(WIDTH)


def test_water_that_is_put_on_the_ground_shows_and_is_saved(server, open_page):
    page = open_page(server[1])
    page.settle(WIDTH)
    page.open_folder("Ground")
    page.choose("a click", "put water")
    page.type_into("water put [mm]", 30)
    page.wait_until(lambda: page.says("a click puts 30 mm of water that stays within 0.30 m"))
    before, after = act(page, lambda: page.page.mouse.click(350, 350))
    changed = np.abs(after.astype(float) - before).max(axis=-1) > 8
    assert 0.005 < changed.mean() < 0.5  # a puddle, not the whole picture
    page.press("save ground and classes")
    page.wait_until(lambda: page.says("saved in"))
    assert page.says("--water-mask-use stays")
    assert list(server[2].glob("home/ground-001/water-mask.png"))


def test_a_saved_picture_is_that_of_the_page_and_of_its_command(server, open_page):
    page = open_page(server[1])
    page.settle(WIDTH)
    act(page, page.drag)
    act(page, lambda: page.type_into("rain [mm/h]", 70))
    seen = page.pixels()
    page.open_folder("Take home")
    page.type_into("width [px]", WIDTH)
    page.type_into("height [px]", len(seen))
    page.press("save this picture")
    folder = server[2] / "home/shot-001"
    page.wait_until(lambda: (folder / "command.txt").is_file())
    picture = read_image(folder / "picture.png")
    assert decibel(seen, picture.astype(int)) > 33  # the page has a JPEG of it
    command = shlex.split((folder / "command.txt").read_text())
    subprocess.run([sys.executable, "-m", *command], check=True, cwd=server[2])
    (frame,) = (folder / "drawn/frames").iterdir()
    np.testing.assert_array_equal(read_image(frame), picture)
    page.press("show its command")
    line = (folder / "command.txt").read_text().strip()
    page.wait_until(lambda: page.says(line.replace("shot-001", "view-001")))
    assert not (server[2] / "home/view-001/picture.png").exists()


def test_a_path_is_saved_and_drawn_here(server, open_page):
    page = open_page(server[1])
    page.settle(WIDTH)
    page.open_folder("Take home")
    page.press("add a keyframe")
    act(page, page.drag)
    page.type_into("seconds from the last", 0.1)
    page.press("add a keyframe")
    page.press("save the path")
    folder = server[2] / "home/path-001"
    page.wait_until(lambda: (folder / "command.txt").is_file())
    page.open_folder("Edit a keyframe")
    page.press("delete this keyframe")
    page.wait_until(lambda: page.says("keyframes: 1"))
    with page.page.expect_file_chooser() as chooser:
        page.press("load a path or preset")
    chooser.value.set_files(folder / "camera_path.json")
    page.wait_until(lambda: page.says("keyframes: 2, 0.1 s"))
    page.press("save the path")  # the same path again
    again = server[2] / "home/path-002"
    page.wait_until(lambda: (again / "command.txt").is_file())
    first, second = (read_cameras(f / "camera_path.json") for f in (folder, again))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_allclose(one.camera_from_world, other.camera_from_world, atol=1e-9)
    page.press("draw what was saved")
    page.wait_until(lambda: page.says("3 of 3 frames, drawn in"), 300)
    assert len(list((again / "drawn/frames").iterdir())) == 3
    pytest.importorskip("imageio_ffmpeg")
    page.press("make a video of the path")  # saves it and draws it
    film = server[2] / "home/path-003"
    page.wait_until((film / "drawn/video.mp4").is_file, 300)
    page.wait_until(lambda: page.says("3 of 3 frames, drawn in"))
    assert "--video" in (film / "command.txt").read_text()
    assert (film / "drawn/video.mp4").stat().st_size > 1000


def test_the_list_of_keyframes_is_edited_and_played(server, open_page, root):
    page = open_page(server[1])
    page.settle(WIDTH)
    page.open_folder("Take home")
    page.press("add a keyframe")
    page.wait_until(lambda: page.says("keyframes: 1"))
    act(page, page.drag)
    page.press("add a keyframe")
    page.wait_until(lambda: page.says("keyframes: 2, 2 s"))
    with page.page.expect_file_chooser() as chooser:
        page.press("load a path or preset")
    chooser.value.set_files(root / "examples/timeline.toml")
    page.wait_until(lambda: page.says("keyframes: 7, 8 s"))  # at 2 s, too
    assert page.says("5\t5\t50\t8\t3 to 40\t1")
    page.open_folder("Edit a keyframe")
    page.choose("keyframe", "5")
    page.type_into("its rain [mm/h]", 77)
    page.type_into("its wind to [deg]", 90)
    page.type_into("its wetness", 1.5)
    page.type_into("at [s]", 4)
    page.wait_until(lambda: page.says("5\t4\t77\t8\t3 to 90\t1.5"))
    page.type_into("at [s]", 8)  # where another is
    page.wait_until(lambda: page.says("two keyframes are at 8 s"))
    page.press("delete this keyframe")
    page.wait_until(lambda: page.says("keyframes: 6, 8 s"))
    page.choose("keyframe", "6")
    page.type_into("at [s]", 90)  # a slow machine sees some of it, too
    page.wait_until(lambda: page.says("keyframes: 6, 90 s"))
    page.choose("keyframe", "1")
    before = page.pixels()
    page.press("look from this keyframe")
    page.wait_until(lambda: page.differs(before))
    page.press("play along the path")
    page.wait_until(lambda: re.search(r"t = [1-9]\d?\.", page.page.inner_text("body")))
    page.press("stop")
    page.wait_until(lambda: page.says("play along the path"))
    page.tick("path with a video")
    page.press("save the path")
    page.wait_until(lambda: page.says("--video"))
    assert "--video" in (server[2] / "home/path-001/command.txt").read_text()
    assert (server[2] / "home/path-001/preset.toml").read_text().count("[[keyframe]]") == 6


def test_two_pages_a_reload_and_a_lost_connection(server, open_page):
    one, two = open_page(server[1]), open_page(server[1])
    one.settle(WIDTH)
    two.settle(WIDTH)
    act(two, two.drag)
    assert decibel(one.pixels(), two.pixels()) < 35  # each has its camera
    count = len(one.pictures())
    act(two, lambda: two.type_into("rain [mm/h]", 90))
    one.wait_until(lambda: len(one.pictures()) > count)  # and both the rain
    two.close()
    one.page.reload()
    one.wait_for_pictures()
    one.settle(WIDTH)
    assert one.field("rain [mm/h]").input_value() == "90"
    act(one, one.drag)


def test_it_listens_here_only_and_ends_at_once(scene_folder, tmp_path):
    given = ["--spacing", "0.04", "--extent", "1", "--width", "64"]
    with viewing(scene_folder, *given, folder=tmp_path) as (process, address):
        assert urllib.request.urlopen(address).status == 200
        listening = Path("/proc/net/tcp").read_text() if sys.platform == "linux" else ""
        port = f":{int(address.rpartition(':')[2]):04X} "
        assert all(
            "0100007F" in line for line in listening.splitlines() if f"{port}00000000:0000" in line
        )
    assert process.returncode == 0
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(address)
    assert not list(tmp_path.iterdir())  # nothing was saved, nothing is written
