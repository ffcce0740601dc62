"""The page: a viser server, its clients, and the pictures that they are shown.

With its neighbours `page_settings`, `page_ground`, `page_home` and `page_keyframes` the only code
that speaks to viser. Callbacks run in viser's threads and only hand on to the `Painter`.
"""

import contextlib
import io
import re
import threading
import time
from dataclasses import dataclass

import numpy as np

from rainsim.errors import BackendError, ParameterError
from rainsim.render.leaving import HARDLY_SEEN, MUCH
from rainsim.view import schedule
from rainsim.view.modes import MODES, PUDDLES, RAIN
from rainsim.view.page_ground import GroundTools
from rainsim.view.page_home import HomeTools
from rainsim.view.page_messages import MOST_BYTES, Checks, connections_of, may_show
from rainsim.view.page_settings import SettingsTools
from rainsim.view.painter import named
from rainsim.view.session import Viewpoint

HOST = "127.0.0.1"  # no other: the server has no sign-in
OWN_PAGES = re.compile(r"http://(127\.0\.0\.1|localhost)(:\d+)?")  # as a browser names them
MOVING_QUALITY, STILL_QUALITY = 75, 92  # of JPEG
STATE_EVERY = 0.4  # s between words on moving pictures
LOOK_AHEAD = 4.0  # m to the point that a page's camera turns about, where no ground is seen
REMEDY = 'the page needs viser; pip install "rainsim[view]"'


@dataclass
class Client:
    """The state of one page: its controls, its view and the size of its picture.

    size : tuple of int. Width and height of the picture that was shown last [px].
    said : tuple of (str, float). The first word of its state and when it was last
        shown [s].
    badly_seen : float. Share of the finished picture that was shown last, see
        `render.leaving`.
    """

    handle: object
    rain: object
    state: object
    view: Viewpoint | None = None
    size: tuple = (0, 0)
    said: tuple = ("", 0.0)
    badly_seen: float = 0.0


class Page:
    """Serves a `Painter`'s pictures.

    port : int. If it is in use the next free one is taken.
    """

    def __init__(self, painter, home, port, first, greeting=""):
        self.painter, self.clients, self._lock = painter, {}, threading.Lock()
        self._greeting = greeting
        self._has_nodes = False
        self._threads = []
        checks = Checks()
        self.server = _server(port, checks)
        checks.controls, checks.complain = self._controls, self._complain_to
        self.server.request_share_url = lambda *_, **__: None  # no tunnel to the world
        self.server.gui.configure_theme(show_share_button=False, show_logo=False, dark_mode=True)
        self._place(first)
        self.settings = SettingsTools(self)
        self.ground = GroundTools(self)
        self.home = HomeTools(self, home)
        self.server.on_client_connect(self._connect)
        self.server.on_client_disconnect(self._disconnect)

    @property
    def address(self):
        """The URL that is typed into the browser."""
        return f"http://{HOST}:{self.server.get_port()}"

    def _place(self, view):
        """Set the view with which new pages begin."""
        start = self.server.initial_camera
        start.position, start.look_at = _looking(view)
        start.fov = view.fov

    def turn(self, client, view):
        """Let a page look from a view, with the ground level in its picture."""
        camera = client.handle.camera
        camera.up_direction = (0.0, 0.0, 1.0)
        camera.position, camera.look_at = _looking(view)

    # --- clients ----------------------------------------------------------------------------------

    def _connect(self, handle):
        gui = handle.gui
        state = gui.add_markdown("connected", order=-3)
        mode = gui.add_dropdown("show", MODES, initial_value=RAIN, order=-2)
        rain = gui.add_slider("after rain of [mm]", 1, 50, 1, 8, order=-1, visible=False)
        client = Client(handle, rain, state)
        key = handle.client_id
        with self._lock:
            self.clients[key] = client
        self.painter.add(key)

        @mode.on_update
        @rain.on_update
        def _(_):
            rain.visible = mode.value == PUDDLES
            self.painter.set_mode(key, mode.value, float(rain.value))

        handle.camera.on_update(lambda camera: self._look(key, camera))
        self.ground.connect(handle)
        if self._greeting:
            handle.add_notification("rainsim", self._greeting, color="yellow")
        self._look(key, handle.camera)

    def _disconnect(self, handle):
        with self._lock:
            self.clients.pop(handle.client_id, None)
        self.painter.remove(handle.client_id)

    def _look(self, key, camera):
        client = self.clients.get(key)
        if client is None:
            return
        position, turn = (tuple(map(float, v)) for v in (camera.position, camera.wxyz))
        client.view = Viewpoint(position, turn, float(camera.fov))
        self.painter.look(key, client.view, float(camera.aspect))

    def show(self, key, shown):
        """Show a picture to a client; called by the drawing thread."""
        client = self.clients.get(key)
        if client is None:
            return
        still = shown.job.step == schedule.EXACT
        depth = shown.depth if still and self._has_nodes else None
        client.handle.scene.set_background_image(
            shown.picture, "jpeg", depth=depth,
            jpeg_quality=STILL_QUALITY if still else MOVING_QUALITY,
        )  # fmt: skip
        client.handle.flush()
        job, now = shown.job, time.perf_counter()
        client.size = job.width, job.height
        word = "finished" if still else "moving" if job.step == schedule.SMALL else "refining"
        if still or word != client.said[0] or now - client.said[1] > STATE_EVERY:
            client.said = word, now
            client.state.content = (
                f"{word}: {job.width} x {job.height} px in {shown.seconds * 1e3:.0f} ms, "
                f"t = {self.painter.clock.time:.2f} s"
            )
            place = self.painter.session.out_of_place(job.view)
            client.state.content += f"  \n**the camera is {place}**" if place else ""

    def show_badly_seen(self, key, share):
        """Tell a page how much of its finished picture is badly seen; of the drawing thread."""
        client = self.clients.get(key)
        if client is None:
            return
        client.badly_seen = share
        if share > MUCH:
            client.state.content += f"  \n**{share:.0%} of it {HARDLY_SEEN}**"
            client.handle.flush()

    def say(self, text):
        """Show all pages which parts are being computed."""
        if text.startswith("computing"):
            for client in list(self.clients.values()):
                client.state.content = f"**{text}** ..."
                client.handle.flush()

    def fail(self, error):
        """Show all pages an error."""
        for client in list(self.clients.values()):
            self.complain(client.handle, error)

    def complain(self, handle, error):
        """Show one page an error."""
        if handle is not None:
            handle.add_notification("rainsim", str(error), color="red", auto_close_seconds=12.0)

    def guarded(self, function):
        """Return a callback that shows errors of a user's values on the page that caused them."""

        def callback(event):
            try:
                function(event)
            except Exception as error:  # of any kind: one page's value must not end the server
                self.complain(getattr(event, "client", None), named(error))

        return callback

    def _controls(self):
        """Yield the controls of all pages and of each, by their identifiers."""
        for owner in (self.server, *(c.handle for c in list(self.clients.values()))):
            yield owner.gui._gui_input_handle_from_uuid

    def _complain_to(self, connection, error):
        """Show the page at the end of a connection the error in its message."""
        live = self.server._websock_server._live_connections
        key = next((key for key, one in list(live.items()) if one is connection), None)
        client = self.clients.get(key)
        if client is not None and may_show(connection):
            self.complain(client.handle, error)

    def viewpoint_of(self, event):
        """Return the View of the page that an event came from."""
        client = self.clients.get(event.client.client_id) if event.client else None
        if client is None or client.view is None:
            raise ParameterError("the page has no camera yet; move it once")
        return client.view

    def badly_seen(self, event):
        """Return the share that is badly seen of the page that an event came from."""
        client = self.clients.get(event.client.client_id) if event.client else None
        return 0.0 if client is None else client.badly_seen

    def use_depth(self):
        """Send depth with finished pictures from now on: there are things in the scene."""
        self._has_nodes = True

    def begin(self, function):
        """Run a function in a thread of its own, which the page waits for when it ends."""
        thread = threading.Thread(target=function, daemon=True)
        self._threads = [t for t in self._threads if t.is_alive()] + [thread]
        thread.start()

    def close(self):
        """Stop the server, its threads and a run in progress."""
        self.home.cancel()
        with contextlib.redirect_stdout(io.StringIO()):  # it says so on stdout, which is for data
            self.server.stop()
        for thread in self._threads:
            thread.join(5.0)


def _looking(view):
    """Return a view's place and the point on the ground that it looks at, (3,) each [m]."""
    position, forward = np.array(view.position), view.rotation[:, 2]
    away = position[2] / -forward[2] if forward[2] < -0.05 else LOOK_AHEAD
    return position, position + forward * min(max(away, 0.5), 4 * LOOK_AHEAD)


def _server(port, checks):
    try:
        import viser
    except ImportError:
        raise BackendError(REMEDY) from None
    with contextlib.redirect_stdout(io.StringIO()), _own_pages_only(checks):
        return viser.ViserServer(host=HOST, port=port, label="rainsim", verbose=False)


@contextlib.contextmanager
def _own_pages_only(checks):
    """Let servers that start in this block refuse pages of other sites and malformed messages.

    A browser lets every site open a socket to 127.0.0.1 and says which site it is. viser has no
    option for that check, nor for one of values, which its socket library makes.
    """
    from websockets.asyncio import server

    serve = server.serve

    def checked(*given, **named):
        named |= {"origins": [OWN_PAGES, None], "max_size": MOST_BYTES}  # None: not a browser
        return serve(*given, **named, create_connection=connections_of(checks))

    server.serve = checked
    try:
        yield
    finally:
        server.serve = serve
