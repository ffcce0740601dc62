"""The page's list of keyframes: camera and settings at their times, to be edited and played."""

import math
import time
from dataclasses import replace

import numpy as np

from rainsim.config.preset_files import from_human
from rainsim.config.preset_writer import human_values
from rainsim.config.settings import Config
from rainsim.config.tables import HUMAN_KEYS, SETTINGS
from rainsim.errors import ParameterError
from rainsim.io.files import parsed_json, printable_name
from rainsim.render.leaving import HARDLY_SEEN, MUCH
from rainsim.scene.camera_path import path_keyframes
from rainsim.view.keyframes import (
    Keyframe,
    path_config,
    placed,
    smooth_path,
    times_of,
    view_at,
    with_timeline,
    without,
)

GOES_ON, AS_SEEN = "goes on", "as at the keyframes"  # time of the rain along a path
FRUSTUM = 0.15  # m, size of a keyframe in the scene
PLAYED = 12.0  # views a second of a path that is played
NONE = "none"
SETTINGS_EVERY = 1.0  # s between its settings, which make light and water again
EDITED = {  # setting of a keyframe: its name in the list, least, most and step of its number
    "rain_mm_per_hour": ("rain [mm/h]", 0, 300, 0.1),
    "past_rain_mm": ("past rain [mm]", 0, 100, 0.1),
    "wind_speed_m_per_s": ("wind [m/s]", 0, 30, 0.1),
    "wind_direction_degrees": ("wind to [deg]", -360, 360, 1.0),
    "wetness": ("wetness", 0, 2, 0.05),
}


def behind(view, aspect):
    """Return where a frustum stands whose wide end is just behind a view's eye [m], (3,).

    With its tip at the eye its rim would frame the picture of a page that looks from there.
    """
    tangent = math.tan(view.fov / 2)
    length = FRUSTUM / math.cbrt(tangent**2 * aspect / 3)  # viser's: its volume is the scale cubed
    return np.array(view.position) - 1.02 * length * view.rotation[:, 2]


def values_of(config):
    """Return the numbers of `EDITED` that settings have, by their keys."""
    names = dict.fromkeys(HUMAN_KEYS[key][0] for key in EDITED)
    found = {}
    for name in names:
        found |= human_values(name, config.value(name))
    return {key: found[key] for key in EDITED}


def table_of(keyframes):
    """Return the list as Markdown."""
    head = "| | s | rain mm/h | past mm | wind m/s, to ° | wetness |"
    lines = [head, "|---|--:|--:|--:|--:|--:|"]
    for n, (at, keyframe) in enumerate(zip(times_of(keyframes), keyframes, strict=True), 1):
        rain, past, speed, way, wetness = values_of(keyframe.config).values()
        wind = f"{speed:.3g} to {way:.0f}"
        lines.append(f"| **{n}** | {at:g} | {rain:.4g} | {past:.4g} | {wind} | {wetness:.3g} |")
    return "\n".join(lines)


class KeyframeTools:
    """The keyframes of all pages, one of which is chosen to be edited."""

    def __init__(self, page, gui, aspect):
        self.page, self.painter, self._aspect = page, page.painter, aspect
        self.keyframes, self._nodes, self._playing = [], [], False

        def button(label, function):
            made = gui.add_button(label)
            made.on_click(page.guarded(function))
            return made

        self.seconds = gui.add_number("seconds from the last", 2.0, min=0.05, max=600.0, step=0.05)
        button("add a keyframe", self._add)
        self.list = gui.add_markdown("no keyframe")
        self.time = gui.add_dropdown("time of the rain", (GOES_ON, AS_SEEN))
        self.play = button("play along the path", self._play)
        self.load = gui.add_upload_button("load a path or preset", mime_type=".json,.toml")
        self.load.on_upload(page.guarded(self._load))
        with gui.add_folder("Edit a keyframe", expand_by_default=False):
            self.chosen = gui.add_dropdown("keyframe", (NONE,))
            self.chosen.on_update(self._of_a_page(lambda event: self._show_chosen()))
            self.at = gui.add_number("at [s]", 0.0, min=0.0, max=36000.0, step=0.05)
            self.at.on_update(self._of_a_page(self._move_in_time))
            self.values = {}
            for key, (label, low, high, step) in EDITED.items():
                usual = float(values_of(self.painter.config)[key])
                field = gui.add_number(f"its {label}", usual, min=low, max=high, step=step)
                field.on_update(self._of_a_page(lambda event, key=key: self._change(key)))
                self.values[key] = field
            button("look from this keyframe", self._look_from)
            button("move it to this view", self._take_view)
            button("delete this keyframe", self._delete)

    def _of_a_page(self, function):
        """Return a callback for what a user turns, not for what the program sets."""
        return self.page.guarded(lambda event: event.client is not None and function(event))

    # --- the list ---------------------------------------------------------------------------------

    @property
    def index(self):
        """Number of the keyframe that is edited."""
        if not self.keyframes:
            raise ParameterError("there is no keyframe; add one first")
        return int(self.chosen.value) - 1

    def set(self, keyframes, chosen=None):
        """Take other keyframes and show them; `chosen` is the number of the one to be edited."""
        times_of(keyframes)  # raises
        self.keyframes = list(keyframes)
        count = len(self.keyframes)
        now = self.index if chosen is None and count and self.chosen.value != NONE else chosen
        self.chosen.options = tuple(str(n + 1) for n in range(count)) or (NONE,)
        self.chosen.value = NONE if not count else str(min(now or 0, count - 1) + 1)
        self._show_path()
        self._show_chosen()

    def _show_chosen(self):
        if not self.keyframes:
            return
        self.at.value = round(float(times_of(self.keyframes)[self.index]), 3)
        for key, value in values_of(self.keyframes[self.index].config).items():
            self.values[key].value = float(f"{value:.6g}")

    def _add(self, event):
        view = self.page.viewpoint_of(event)
        keyframe = Keyframe(
            view, self.painter.config, float(self.seconds.value), self.painter.clock.time
        )
        self.set([*self.keyframes, keyframe], len(self.keyframes))
        share = self.page.badly_seen(event)
        if share > MUCH:
            event.client.add_notification(
                "rainsim", f"{share:.0%} of this keyframe's picture {HARDLY_SEEN}", color="yellow"
            )  # fmt: skip

    def _delete(self, event):
        n = self.index
        self.set(without(self.keyframes, n), max(n - 1, 0))

    def _move_in_time(self, event):
        n, times = self.index, times_of(self.keyframes)
        if math.isclose(times[n], self.at.value, abs_tol=1e-3):
            return
        times[n] = float(self.at.value)
        try:
            self.set(placed(self.keyframes, times), int(np.sum(times < times[n])))
        except ParameterError:
            self._show_chosen()
            raise

    def _change(self, key):
        """Take over a number of the chosen keyframe, and the others of its setting."""
        attribute, n = HUMAN_KEYS[key][0], self.index
        keys = [k.name for k in SETTINGS[attribute].keys]
        given = {k: float(self.values[k].value) for k in keys}
        try:
            config = self.keyframes[n].config.replace(**from_human(given, "the page")).check()
        except ParameterError:
            self._show_chosen()
            raise
        changed = replace(self.keyframes[n], config=config)
        self.set([*self.keyframes[:n], changed, *self.keyframes[n + 1 :]], n)

    def _take_view(self, event):
        n = self.index
        changed = replace(self.keyframes[n], view=self.page.viewpoint_of(event))
        self.set([*self.keyframes[:n], changed, *self.keyframes[n + 1 :]], n)

    def _look_from(self, event):
        client, keyframe = self._client(event), self.keyframes[self.index]
        self.page.turn(client, keyframe.view)

    def _client(self, event):
        client = self.page.clients.get(event.client.client_id) if event.client else None
        if client is None:
            raise ParameterError("the page is gone; load it again")
        return client

    # --- files ------------------------------------------------------------------------------------

    def _load(self, event):
        """Take the keyframes of a path's file, or the settings of a preset's timeline."""
        name = printable_name(self.load.value.name)
        text = self.load.value.content.decode("utf-8", "replace")
        if name.endswith(".toml"):
            self._load_timeline(event, text, name)
            return
        loaded = path_keyframes(parsed_json(text), name)
        views = self.painter.ask(
            lambda s: [s.viewpoint_of(camera) for camera, *_ in loaded]
        ).result()
        config = self.painter.config  # a path's file has no settings
        keyframes = [
            Keyframe(view, config, seconds, time)
            for view, (_, seconds, time) in zip(views, loaded, strict=True)
        ]
        has_times = all(keyframe.time is not None for keyframe in keyframes)
        self.time.value = AS_SEEN if has_times else GOES_ON
        self.set(keyframes, 0)

    def _load_timeline(self, event, text, name):
        timeline = Config.from_toml(text, name).keyframes
        if not timeline:
            raise ParameterError(
                f"{name} has no [[keyframe]]; the list takes those of a timeline; choose another"
            )
        config = replace(self.painter.config, keyframes=timeline).check()
        view = None if self.keyframes else self.page.viewpoint_of(event)
        self.time.value = GOES_ON
        self.set(with_timeline(self.keyframes, config, view), 0)

    # --- the scene --------------------------------------------------------------------------------

    def _show_path(self):
        """Show list, keyframes and the path through them."""
        for node in self._nodes:
            node.remove()
        self._nodes, scene, aspect = [], self.page.server.scene, self._aspect()
        for n, keyframe in enumerate(self.keyframes):
            view = keyframe.view
            self._nodes.append(
                scene.add_camera_frustum(
                    f"/keyframes/{n}", fov=view.fov, aspect=aspect, scale=FRUSTUM, wxyz=view.turn,
                    position=behind(view, aspect), color=(86, 180, 233),
                )
            )  # fmt: skip
        count, seconds = len(self.keyframes), 0.0
        if count > 1:
            views = smooth_path(self.keyframes, 24.0)
            places = np.array([view.position for view in views], np.float32)
            self._nodes.append(
                scene.add_line_segments(
                    "/path", np.stack([places[:-1], places[1:]], axis=1), (230, 159, 0)
                )
            )
            seconds = times_of(self.keyframes)[-1]
        head = f"keyframes: {count}, {seconds:g} s"
        self.list.content = f"{head}\n\n{table_of(self.keyframes)}" if count else "no keyframe"
        self.page.use_depth()

    def move(self, views):
        """Take the keyframes to other views, one each."""
        pairs = zip(self.keyframes, views, strict=True)
        self.set([replace(keyframe, view=view) for keyframe, view in pairs])

    def given(self):
        """Return the keyframes as a path takes them: without times of the rain if time goes on."""
        if self.time.value == GOES_ON:
            return [replace(keyframe, time=None) for keyframe in self.keyframes]
        return list(self.keyframes)

    # --- playing ----------------------------------------------------------------------------------

    def _play(self, event):
        """Take the page along the path in its time, with its settings; or stop that."""
        if self._playing:
            self._playing = False
            return
        client, keyframes, before = self._client(event), self.given(), self.painter.config
        config = path_config(keyframes, before)
        self._playing, self.play.label = True, "stop"
        self.page.begin(lambda: self._go_along(client, keyframes, config, before))

    def _go_along(self, client, keyframes, config, before):
        begin, end = time.monotonic(), times_of(keyframes)[-1]
        changes = dict.fromkeys(name for _, own in config.keyframes for name, _ in own)
        frames = max(before.frames, config.frames)
        try:
            self.painter.set_config(lambda c: c.replace(frames=frames))
            at, due = 0.0, 0.0
            while self._playing and client.handle.client_id in self.page.clients:
                view = view_at(keyframes, at)
                with client.handle.atomic():
                    self.page.turn(client, view)
                    client.handle.camera.fov = view.fov
                frame = config.moment(min(int(at * config.fps), config.frames - 1))
                if changes and at >= due:
                    now, due = config.at(frame / config.fps), at + SETTINGS_EVERY
                    values = {name: now.value(name) for name in changes}
                    self.painter.set_config(lambda c, values=values: c.replace(**values))
                self.painter.turn(lambda clock, _, frame=frame: (clock.pause(), clock.go_to(frame)))
                if at >= end:
                    break
                time.sleep(1 / PLAYED)
                at = min(time.monotonic() - begin, end)
        finally:
            self._playing, self.play.label = False, "play along the path"
            values = {name: before.value(name) for name in ("frames", *changes)}
            self.painter.set_config(lambda c: c.replace(**values))
