"""The page's tools that take something home: screenshots, keyframes, paths, films drawn here."""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import numpy as np

from rainsim.config.frame_settings import MAX_SIDE
from rainsim.errors import ParameterError, RainsimError
from rainsim.io.files import parsed_json, printable_name
from rainsim.render.leaving import HARDLY_SEEN, MUCH
from rainsim.scene.camera_path import path_keyframes
from rainsim.view.home import Run
from rainsim.view.keyframes import Keyframe, smooth_path

GOES_ON, AS_SEEN = "goes on", "as at the keyframes"  # time of the rain along a path
LOOK_EVERY = 0.5  # s between looks at how far a film is
FRUSTUM = 0.15  # m, size of a keyframe in the scene


def behind(view, aspect):
    """Return where a frustum stands whose wide end is just behind a view's eye [m], (3,).

    With its tip at the eye its rim would frame the picture of a page that looks from there.
    """
    tangent = math.tan(view.fov / 2)
    length = FRUSTUM / math.cbrt(tangent**2 * aspect / 3)  # viser's: its volume is the scale cubed
    return np.array(view.position) - 1.02 * length * view.rotation[:, 2]


class HomeTools:
    """Screenshots and camera paths, the same on all pages.

    Attributes
    ----------
    keyframes : list of Keyframe
    taken : Taken or None
        What was saved last.
    """

    def __init__(self, page, home):
        self.page, self.painter, self.home = page, page.painter, home
        self.keyframes, self._nodes, self.taken, self._run = [], [], None, None
        gui, config = page.server.gui, page.painter.config

        def button(label, function, **more):
            made = gui.add_button(label, **more)
            made.on_click(page.guarded(function))
            return made

        with gui.add_folder("Take home", order=5, expand_by_default=False):
            self.width = gui.add_number("width [px]", config.width, min=8, max=MAX_SIDE, step=8)
            height = config.height or round(config.width / 1.5)
            self.height = gui.add_number("height [px]", height, min=8, max=MAX_SIDE, step=4)
            button("save this picture", self._save_shot)
            button("print its command", self._print_command)
            self.seconds = gui.add_number("seconds to it", 2.0, min=0.05, max=600.0, step=0.05)
            self.time = gui.add_dropdown("time of the rain", (GOES_ON, AS_SEEN))
            button("add a keyframe", self._add)
            button("remove the last keyframe", self._remove)
            button("save the path", self._save_path)
            self.load = gui.add_upload_button("load a path", mime_type="application/json")
            button("draw the saved one here", self._draw_here)
            self.stop = button("cancel", lambda _: self.cancel(), disabled=True)
            self.progress = gui.add_progress_bar(0.0, visible=False)
            self.words = gui.add_markdown("no keyframe")
        self.load.on_upload(page.guarded(self._load))

    # --- files ------------------------------------------------------------------------------------

    @property
    def size(self):
        """Width and height of saved pictures [px]."""
        return int(self.width.value), int(self.height.value)

    def _save_shot(self, event):
        self._take_view(event, self.home.save_shot)

    def _print_command(self, event):
        self._take_view(event, self.home.save_view)

    def _take_view(self, event, save):
        """Let save(session, view, index, width, height) write the page's view."""
        view, index, size = self.page.viewpoint_of(event), self.painter.clock.index, self.size
        self._took(self.painter.ask(lambda session: save(session, view, index, *size)))

    def _save_path(self, event):
        keyframes, size = list(self.keyframes), self.size
        if self.time.value == GOES_ON:
            keyframes = [replace(keyframe, time=None) for keyframe in keyframes]
        self._took(self.painter.ask(lambda session: self.home.save_path(session, keyframes, *size)))

    def _took(self, future):
        self.taken = future.result()
        self.home.say(self.taken.line)
        self.words.content = f"saved in `{self.taken.folder}`\n\n```\n{self.taken.line}\n```"

    # --- keyframes --------------------------------------------------------------------------------

    def _add(self, event):
        keyframe = Keyframe(
            self.page.viewpoint_of(event), self.painter.config, float(self.seconds.value),
            self.painter.clock.time,
        )  # fmt: skip
        self.keyframes.append(keyframe)
        self._show_path()
        share = self.page.badly_seen(event)
        if share > MUCH:
            event.client.add_notification(
                "rainsim", f"{share:.0%} of this keyframe's picture {HARDLY_SEEN}", color="yellow"
            )  # fmt: skip

    def _load(self, event):
        """Take the keyframes of a file; settings are the present ones, since it has none."""
        name = printable_name(self.load.value.name)
        data = parsed_json(self.load.value.content.decode("utf-8", "replace"))
        loaded = path_keyframes(data, name)
        views = self.painter.ask(
            lambda s: [s.viewpoint_of(camera) for camera, *_ in loaded]
        ).result()
        config = self.painter.config
        self.keyframes = [
            Keyframe(view, config, seconds, time)
            for view, (_, seconds, time) in zip(views, loaded, strict=True)
        ]
        has_times = all(keyframe.time is not None for keyframe in self.keyframes)
        self.time.value = AS_SEEN if has_times else GOES_ON
        self._show_path()

    def _remove(self, event):
        if not self.keyframes:
            raise ParameterError("there is no keyframe; add one first")
        self.keyframes.pop()
        self._show_path()

    def _show_path(self):
        """Show keyframes and the path through them in the scene."""
        for node in self._nodes:
            node.remove()
        self._nodes, scene = [], self.page.server.scene
        aspect = self.size[0] / self.size[1]
        for n, keyframe in enumerate(self.keyframes):
            view = keyframe.view
            self._nodes.append(
                scene.add_camera_frustum(
                    f"/keyframes/{n}", fov=view.fov, aspect=aspect, scale=FRUSTUM, wxyz=view.turn,
                    position=behind(view, aspect), color=(86, 180, 233),
                )
            )  # fmt: skip
        count = len(self.keyframes)
        if count > 1:
            views = smooth_path(self.keyframes, 24.0)
            places = np.array([view.position for view in views], np.float32)
            self._nodes.append(
                scene.add_line_segments(
                    "/path", np.stack([places[:-1], places[1:]], axis=1), (230, 159, 0)
                )
            )
        seconds = sum(keyframe.seconds for keyframe in self.keyframes[1:])
        self.words.content = f"keyframes: {count}, {seconds:g} s"
        self.page.use_depth()

    @property
    def views(self):
        """Views of the keyframes."""
        return [keyframe.view for keyframe in self.keyframes]

    def move(self, views):
        """Take the keyframes to other views, one each."""
        pairs = zip(self.keyframes, views, strict=True)
        self.keyframes = [replace(keyframe, view=view) for keyframe, view in pairs]
        self._show_path()

    # --- drawing here -----------------------------------------------------------------------------

    def _draw_here(self, event):
        if self.taken is None:
            raise ParameterError("nothing is saved yet; save the picture or the path first")
        if self._run is not None:
            raise RainsimError("a film is being drawn; wait for it or cancel it")
        self._run = run = Run(self.taken)
        self.stop.disabled, self.progress.visible, self.progress.value = False, True, 0.0
        self.page.begin(lambda: self._follow(run))

    def _follow(self, run):
        """Show how far a film is until it has ended."""
        ended = threading.Event()

        def look():
            while not ended.wait(LOOK_EVERY):
                self.progress.value = 100.0 * run.drawn / run.frames

        self.page.begin(look)
        code = run.follow(lambda line: None)
        ended.set()
        self._run = None
        self.stop.disabled, self.progress.value = True, 100.0 * run.drawn / run.frames
        how = "drawn in" if code == 0 else "ended early"
        self.words.content = (
            f"{run.drawn} of {run.frames} frames, {how} `{run.taken.folder}`\n\n{run.last_line}"
        )

    def cancel(self):
        """Interrupt the film that is being drawn, if there is one."""
        run = self._run
        if run is not None:
            run.cancel()
