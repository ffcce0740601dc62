"""The page on captures that tell little: bare splats, up by a drag, marks of clicked points."""

import json
import shlex
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from made_formats import splat_records
from pages import viewing
from rainsim.io.images import read_image
from scenes import tiny_scene

pytestmark = pytest.mark.slow
WIDTH = 400


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """The tiny scene as a .splat file without cameras."""
    path = tmp_path_factory.mktemp("bare") / "bare.splat"
    path.write_bytes(splat_records(tiny_scene().splats))
    return path


def red(picture):
    """Number of pixels of a mark's colour."""
    r, g, b = (picture[..., n].astype(int) for n in range(3))
    return int(((r > 120) & (r > 2 * g) & (r > 2 * b)).sum())


def test_a_bare_splat_file_opens_with_a_view_and_is_drawn_by_the_command(bare, open_page, tmp_path):
    with viewing(bare, "--width", WIDTH, "--out", "home", folder=tmp_path) as (_, address):
        page = open_page(address)
        page.settle(WIDTH)
        assert page.says("UP IS ASSUMED") and page.says("the view is offered")
        before = page.pixels()
        assert before.std() > 10  # of something, not of the sky alone
        page.drag()
        page.wait_until(lambda: page.pixels().shape == before.shape and page.differs(before))
        page.settle(WIDTH)
        page.open_folder("Take home")
        page.type_into("width [px]", 96)
        page.type_into("height [px]", 64)
        page.press("save this picture")
        folder = tmp_path / "home/shot-001"
        page.wait_until(lambda: (folder / "command.txt").is_file())
    command = shlex.split((folder / "command.txt").read_text())
    subprocess.run([sys.executable, "-m", *command], check=True, cwd=tmp_path)
    (frame,) = (folder / "drawn/frames").iterdir()
    np.testing.assert_array_equal(read_image(frame), read_image(folder / "picture.png"))


def test_the_walk_from_an_unknown_capture_to_a_film(bare, open_page, tmp_path):
    """The steps of "From an unknown capture to a saved film" in the guide."""
    with viewing(bare, "--width", WIDTH, "--out", "home", folder=tmp_path) as (_, address):
        page = open_page(address)
        page.settle(WIDTH)
        page.choose("show", "confidence of the map")
        page.settle(WIDTH)
        page.open_folder("Settings")
        page.open_folder("Ground")
        page.choose("a click", "measure: two points")
        page.page.mouse.click(150, 600)
        page.wait_until(lambda: page.says("1 more to click"))
        page.page.mouse.click(550, 600)
        page.wait_until(lambda: page.says("between the points"))
        page.type_into("known length [m]", 0.8)
        page.press("set the scale by this length")
        page.wait_until(lambda: page.says("m per capture unit"))
        page.settle(WIDTH)

        page.choose("a click", "up: three points")
        for n, place in enumerate([(150, 600), (550, 600), (330, 450)]):
            page.page.mouse.click(*place)
            page.wait_until(lambda n=n: page.says("ground at" if n == 2 else f"{2 - n} more to"))
        page.press("set up by these points")
        page.wait_until(lambda: page.says("nearest to it is level"))
        page.settle(WIDTH)

        page.choose("show", "rain")
        page.choose("a click", "paint a class")
        page.choose("class", "grass")
        page.wait_until(lambda: page.says("a click paints grass"))
        page.page.mouse.click(350, 600)
        page.settle(WIDTH)
        page.press("save as a scene of its own")
        page.wait_until(lambda: page.says("scene-001"))
        page.press("save ground and classes")
        page.wait_until(lambda: page.says("ground-001"))

        page.open_folder("Ground")
        page.open_folder("Take home")
        page.type_into("width [px]", 96)
        page.type_into("height [px]", 64)
        page.press("add a keyframe")
        page.wait_until(lambda: page.says("keyframes: 1"))
        before = page.pixels()
        page.drag()
        page.wait_until(lambda: page.differs(before))
        page.settle(WIDTH)
        page.type_into("seconds from the last", 0.1)
        page.press("add a keyframe")
        page.wait_until(lambda: page.says("keyframes: 2"))
        page.press("save the path")
        folder = tmp_path / "home/path-001"
        page.wait_until(lambda: (folder / "command.txt").is_file())
        page.press("draw what was saved")
        page.wait_until(lambda: page.says("3 of 3 frames, drawn in"), 300)
    frames = sorted((folder / "drawn/frames").iterdir())
    assert len(frames) == 3
    assert (read_image(frames[0]) != read_image(frames[2])).any()
    command = (folder / "command.txt").read_text()
    assert "--class-mask" in command and "--ground-frame" in command
    frame = json.loads((folder / "ground_frame.json").read_text())
    assert frame["scale_assumed"] is False
    assert (tmp_path / "home/scene-001/scene.json").is_file()
    assert (tmp_path / "home/ground-001/class-mask.png").is_file()


def test_a_mark_goes_when_another_tool_is_chosen(server, open_page):
    page = open_page(server[1])
    page.settle(WIDTH)
    page.open_folder("Ground")
    few = red(page.screen())
    page.page.mouse.click(350, 380)
    page.wait_until(lambda: page.says("ground at"))
    page.settle(WIDTH)
    page.wait_until(lambda: red(page.screen()) > few + 10)
    page.choose("a click", "measure: two points")
    page.wait_until(lambda: red(page.screen()) <= few + 2)


def test_a_click_that_is_answered_after_another_tool_was_chosen_leaves_no_mark():
    viser = pytest.importorskip("viser")
    from rainsim.view.page_ground import MEASURE, TOOLS, GroundTools
    from rainsim.view.probe import ProbeReading

    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        asked, reading = [], ProbeReading((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), None, 0.0, 0.0, "")
        painter = SimpleNamespace(
            clock=SimpleNamespace(index=0),
            ask=lambda function: SimpleNamespace(result=lambda: asked.pop()()),
        )
        page = SimpleNamespace(
            server=server, painter=painter, guarded=lambda function: function,
            viewpoint_of=lambda event: SimpleNamespace(position=(0.0, 0.0, 1.0)),
            clients={1: SimpleNamespace(size=(64, 48))}, use_depth=lambda: None,
        )  # fmt: skip
        tools = GroundTools(page)
        event = SimpleNamespace(
            client=SimpleNamespace(client_id=1), client_id=1, screen_pos=(0.5, 0.5)
        )
        asked.append(lambda: (reading, None))
        tools._click(event)
        assert len(tools._marks) == len(tools.points) == 1

        def meanwhile():
            tools.tool.value = TOOLS[MEASURE]
            return reading, None

        asked.append(meanwhile)
        tools._click(event)
        assert not tools._marks and not tools.points
    finally:
        server.stop()
