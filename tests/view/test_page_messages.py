"""What pages send: values that cannot be are answered and not kept, and the server goes on."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from hostile_page import LEVEL, HostilePage, hostile_messages, serves
from pages import free_port, viewing
from rainsim.config.settings import Config
from rainsim.errors import ParameterError, RainsimError
from rainsim.view import page_messages
from rainsim.view.home import Home
from rainsim.view.painter import Painter
from rainsim.view.session import Viewpoint

QUICK, THOROUGH = 300, 4000
CAMERA = {name: value for name, value in LEVEL.items() if name != "type"}


def test_a_camera_that_can_be_passes_and_others_do_not():
    page_messages.require_values("ViewerCameraMessage", CAMERA)
    for name, value in (
        ("wxyz", [0, 0, 0, 0]), ("wxyz", [1, 1, 0, 0]), ("position", [0, float("nan"), 0]),
        ("position", [1e300, 0, 0]), ("fov", 1e-300), ("fov", 3.1), ("fov", True),
        ("image_width", 1e300), ("image_height", 0), ("near", "x"), ("look_at", None),
        ("owner", []),
    ):  # fmt: skip
        with pytest.raises(ParameterError):
            page_messages.require_values("ViewerCameraMessage", CAMERA | {name: value})


def test_controls_keep_to_their_limits():
    number = SimpleNamespace(label="width", value=8, min=8, max=64)
    choice = SimpleNamespace(label="sky", value="a", options=("a", "b"))
    tick, button = (
        SimpleNamespace(label="loop", value=True),
        SimpleNamespace(label="go", value=True),
    )
    for control, value in (
        (number, 8),
        (number, 63.5),
        (choice, "b"),
        (tick, False),
        (button, True),
    ):
        page_messages.require_value(control, value)
    stopped = SimpleNamespace(label="stop", value=False, disabled=True)
    for control, value in ((number, 1e300), (number, -7), (number, float("nan")), (number, "9"),
                           (number, True), (choice, "c"), (choice, []), (tick, 1), (stopped, True),
                           (SimpleNamespace(label="file", value=None), b"")):  # fmt: skip
        with pytest.raises(ParameterError, match=f"{control.label} is .*; it must be"):
            page_messages.require_value(control, value)
    with pytest.raises(page_messages.UnfinishedError):  # of 64, the first digit
        page_messages.require_value(number, 6)
    page_messages.require_upload(SimpleNamespace(label="file", value=SimpleNamespace(content=b"")))
    with pytest.raises(ParameterError, match="width takes no file"):
        page_messages.require_upload(number)


def test_uploads_do_not_pile_up():
    uploads, pages = (
        page_messages.Uploads(),
        [threading.Event(), threading.Event()],
    )  # what can be kept weakly
    start = {"transfer_uuid": "0", "size_bytes": 9}
    for n in range(page_messages.MOST_UPLOADS):
        uploads.receive(pages[n % 2], "FileTransferStartUpload", start | {"transfer_uuid": str(n)})
    with pytest.raises(ParameterError, match="on their way already"):
        uploads.receive(pages[0], "FileTransferStartUpload", start | {"transfer_uuid": "more"})
    for content in (b"1234", b"56789"):
        uploads.receive(pages[0], "FileTransferPart", {"transfer_uuid": "0", "content": content})
    with pytest.raises(ParameterError, match="more of a file than it has"):
        uploads.receive(pages[0], "FileTransferPart", {"transfer_uuid": "0", "content": b"x"})
    del pages[1]  # a page that leaves takes its files with it
    for n in "abc":
        uploads.receive(pages[0], "FileTransferStartUpload", start | {"transfer_uuid": n})


@pytest.mark.parametrize("turn", [(0, 0, 0, 0), (2, 0, 0, 0), (1, 0, 0), "abcd"])
def test_a_view_turns_by_a_unit_quaternion(turn):
    assert Viewpoint((0, 0, 1), (1, 0, 0, 0), 1.0).rotation[0, 0] == 1
    with pytest.raises(ParameterError, match="unit quaternion"):
        Viewpoint((0, 0, 1), turn, 1.0)


class Bare:
    """A session without a scene: all that it draws is grey, and one width cannot be drawn."""

    backend, stale, is_ready = "cpu", frozenset(), False

    def __init__(self):
        self.config = Config().replace(width=64, frames=4)

    def set_config(self, config):
        self.config = config

    def out_of_place(self, view):
        return ""

    def draw_bare(self, view, width, height):
        assert np.isfinite(view.rotation).all() and 0 < width * height < 1e9
        if width == 72:
            raise MemoryError("no room")
        return np.full((height, width, 3), 128, np.uint8), np.ones((height, width), np.float32)


@pytest.fixture
def served(tmp_path):
    """A page's server with a `Bare` session: its port, its painter and the thread that draws."""
    pytest.importorskip("viser")
    from rainsim.view.page import Page

    errors = []
    painter = Painter(Bare(), lambda *shown: page.show(*shown), fail=errors.append)
    page = Page(
        painter, Home(tmp_path, "none"), free_port(), Viewpoint((0, -3, 1), (1, 0, 0, 0), 1.0)
    )
    drawing = threading.Thread(target=painter.run)
    drawing.start()
    yield page.server.get_port(), painter, drawing, errors
    painter.end()
    drawing.join(20)
    page.close()


def entered(port):
    """A page that is connected, knows its controls and was shown a picture."""
    page = HostilePage(port)
    page.send(LEVEL)
    assert page.wait_for(lambda: len(page.controls) > 20 and page.pictures, 60.0)
    return page


def sent(page, port, rng, count):
    """Send hostile messages; a page that the server has closed enters again."""
    for message in hostile_messages(rng, page.controls, count):
        if not page.send(message):
            print("closed before", message)
            page = entered(port)
    return page


def test_hostile_messages_are_answered_and_the_server_goes_on(served, capfd):
    port, painter, drawing, errors = served
    page = entered(port)
    page.send(LEVEL | {"wxyz": [0, 0, 0, 0]})
    assert page.wait_for(lambda: any("wxyz [0, 0, 0, 0]" in note for note in page.notes))
    sent(page, port, np.random.default_rng(1), QUICK)
    later = entered(port)

    def is_said():  # messages that are still on their way may set the size again
        painter.set_sizes(full=72)
        return any("MemoryError" in str(error) for error in errors)

    assert later.wait_for(is_said)
    painter.set_sizes(full=64)
    assert serves(port) and drawing.is_alive()
    assert isinstance(errors[-1], RainsimError) and "Traceback" not in "".join(capfd.readouterr())


@pytest.mark.slow
def test_hostile_messages_by_the_thousand(scene_folder, tmp_path):
    pytest.importorskip("viser")
    arguments = scene_folder, "--width", 64, "--extent", 1, "--spacing", 0.04, "-o", tmp_path
    with viewing(*arguments, folder=tmp_path) as (process, address):
        port, rng = int(address.rpartition(":")[2]), np.random.default_rng(2)
        page = entered(port)
        for _ in range(THOROUGH // 100):
            page = sent(page, port, rng, 100)
            page.wait_for(lambda: False, page_messages.WORDS_EVERY)  # one answer a second
            assert process.poll() is None and serves(port)
        later = entered(port)
        print(f"{THOROUGH} messages, {len(page.notes)} answers, {len(later.controls)} controls")
    assert process.returncode == 0
