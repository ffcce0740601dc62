"""The page's tools that take something home: screenshots, keyframes, paths, films drawn here."""

import threading

from rainsim.config.frame_settings import MAX_SIDE
from rainsim.errors import ParameterError, RainsimError
from rainsim.io.video import VideoFormat, require_video
from rainsim.view.home import CommandRun
from rainsim.view.page_keyframes import KeyframeTools

LOOK_EVERY = 0.5  # s between looks at how far a film is


class HomeTools:
    """Screenshots, camera paths and films, the same on all pages."""

    def __init__(self, page, home):
        self.page, self.painter, self.home = page, page.painter, home
        self.saved, self._run = None, None
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
            button("show its command", self._print_command)
            self.keyframes = KeyframeTools(page, gui, lambda: self.size[0] / self.size[1])
            self.video = gui.add_checkbox("path with a video", False)
            button("save the path", self._save_path)
            button("draw what was saved", self._draw_here)
            button("make a video of the path", self._make_video)
            self.stop = button("cancel", lambda _: self.cancel(), disabled=True)
            self.progress = gui.add_progress_bar(0.0, visible=False)
            self.words = gui.add_markdown("nothing is saved yet")

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
        given = self.keyframes.given(), *self.size, bool(self.video.value)
        self._took(self.painter.ask(lambda session: self.home.save_path(session, *given)))

    def _make_video(self, event):
        require_video(VideoFormat())
        self.video.value = True
        self._save_path(event)
        self._draw_here(event)

    def _took(self, future):
        self.saved = future.result()
        self.home.say(self.saved.line)
        self.words.content = f"saved in `{self.saved.folder}`\n\n```\n{self.saved.line}\n```"

    # --- drawing here -----------------------------------------------------------------------------

    def _draw_here(self, event):
        if self.saved is None:
            raise ParameterError("nothing is saved yet; save the picture or the path first")
        if self._run is not None:
            raise RainsimError("a film is being drawn; wait for it or cancel it")
        self._run = run = CommandRun(self.saved)
        self.stop.disabled, self.progress.visible, self.progress.value = False, True, 0.0
        self.page.begin(lambda: self._follow(run))

    def _follow(self, run):
        """Show how far a film is until it has ended."""
        ended = threading.Event()

        def look():
            while not ended.wait(LOOK_EVERY):
                self.progress.value = 100.0 * run.drawn / run.saved.frames

        self.page.begin(look)
        code, count = run.follow(), run.saved.frames
        ended.set()
        self._run = None
        self.stop.disabled, self.progress.value = True, 100.0 * run.drawn / count
        how = "drawn in" if code == 0 else "ended early"
        self.words.content = (
            f"{run.drawn} of {count} frames, {how} `{run.saved.folder}`\n\n{run.last_line}"
        )

    def cancel(self):
        """Interrupt the film that is being drawn, if there is one."""
        run = self._run
        if run is not None:
            run.cancel()
