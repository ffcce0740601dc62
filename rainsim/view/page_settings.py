"""The page's sliders: settings, time, and the sizes of pictures."""

from rainsim.config.frame_settings import MAX_SIDE
from rainsim.config.preset_files import from_human, preset_names
from rainsim.config.preset_writer import human_values
from rainsim.config.rain_settings import MAX_SEED
from rainsim.config.settings import Config
from rainsim.config.tables import HUMAN_KEYS, PARTS, SETTINGS, SLIDERS
from rainsim.errors import ParameterError

SUN_CHOICES = ("none", "sky", "angles")
SPEEDS = ("1", "1/2", "1/4", "1/8")
CHOICES = {name: one.choices for name, one in SETTINGS.items() if one.dropdown}
USUAL = (  # keys of sliders that are not folded
    "rain_mm_per_hour", "past_rain_mm", "drying_hours", "wind_speed_m_per_s",
    "wind_direction_degrees", "cloudiness", "brightness", "wetness", "ripples",
)  # fmt: skip
NO_LEVEL = 0.1  # m, where the slider of the flood begins
SUN = {"sun_azimuth_degrees": 0.0, "sun_elevation_degrees": 45.0}  # where its sliders begin
KEPT = ("frames", "fps", "width", "height", "surroundings", "spacing", "extent", "threads")


class SettingsTools:
    """Controls of settings, time and sizes, the same on all pages."""

    def __init__(self, page):
        self.page, self.painter, gui = page, page.painter, page.server.gui
        self._handles = {}
        with gui.add_folder("Settings", order=1):
            self.preset = gui.add_dropdown(
                "preset", ("as started", *preset_names()), initial_value="as started"
            )
            self._on(self.preset, self._take_preset)
            config, usual = self.painter.config, {s.key: s for s in SLIDERS if s.key in USUAL}
            for key in USUAL:
                self._add_slider(gui, usual[key], config)
            for group in dict.fromkeys(slider.group for slider in SLIDERS):
                with gui.add_folder(f"More: {group.lower()}", expand_by_default=False):
                    self._add_group(gui, group)
        with gui.add_folder("Time", order=2):
            self._add_time(gui)
        with gui.add_folder("Picture", order=3, expand_by_default=False):
            self._add_sizes(gui)

    def _on(self, handle, function):
        """Call function(event) when a user turns a control, not when we do."""

        def turned(event):
            if event.client is not None:
                function(event)

        handle.on_update(self.page.guarded(turned))

    # --- settings ---------------------------------------------------------------------------------

    def _add_group(self, gui, group):
        config = self.painter.config
        if group == "Light":
            self._add_light(gui, config)
        if group == "Flood":
            self.flood = gui.add_checkbox("flood", config.water.level is not None)
            self._on(self.flood, self._turn_level)
        for slider in (s for s in SLIDERS if s.group == group and s.key not in USUAL):
            self._add_slider(gui, slider, config)
        if group == "Rain":
            self.seed = gui.add_number("seed", config.rain.seed, min=0, max=MAX_SEED, step=1)
            self._on(self.seed, lambda _: self.change({"seed": int(self.seed.value)}))

    def _add_light(self, gui, config):
        skies = tuple(dict.fromkeys(("overcast", "capture", config.render.sky)))
        self.sky = gui.add_dropdown("sky", skies, initial_value=config.render.sky)
        self._on(self.sky, lambda _: self.change({"sky": self.sky.value}))
        self.sun = gui.add_dropdown("sun", SUN_CHOICES, initial_value=_sun_choice(config))
        self._on(self.sun, self._turn_sun)
        self._choices = {}
        for name, choices in CHOICES.items():
            handle = gui.add_dropdown(name, choices, initial_value=config.value(name))
            self._on(handle, lambda _, n=name, h=handle: self.change({n: h.value}))
            self._choices[name] = handle

    def _add_slider(self, gui, slider, config):
        value = _shown(slider, config)
        low, high = min(slider.low, value), max(slider.high, value)
        handle = gui.add_slider(
            slider.label, float(low), float(high), float(slider.step), float(value)
        )
        self._on(handle, lambda _: self._turn(slider.key))
        self._handles[slider.key] = handle

    def _turn(self, key):
        """Take over the value of a slider, and of the other sliders of its setting."""
        attribute = HUMAN_KEYS[key][0]
        if attribute == "sun" and self.sun.value != "angles":
            return
        if attribute == "level":
            self._turn_level(None)
            return
        keys = [name for name, _ in PARTS[attribute]] if attribute in PARTS else [key]
        self.change(from_human({k: float(self._handles[k].value) for k in keys}, "the page"))

    def _turn_level(self, event):
        level = float(self._handles["water_level_m"].value) if self.flood.value else None
        self.change({"level": level})

    def _turn_sun(self, event):
        if self.sun.value == "angles":
            self._turn("sun_azimuth_degrees")
        else:
            self.change({"sun": None if self.sun.value == "none" else "sky"})

    def change(self, values):
        """Set values [SI] of settings, by their names, for the next pictures."""
        try:
            self.painter.set_config(lambda config: config.replace(**values))
        except ParameterError:
            self.show_config(self.painter.config)
            raise

    def _take_preset(self, event):
        if self.preset.value not in preset_names():
            return
        fresh = Config.from_preset(self.preset.value)

        def change(config):
            return fresh.replace(**{name: config.value(name) for name in KEPT})

        self.painter.set_config(change)
        self.show_config(self.painter.config)

    def show_config(self, config):
        """Set all controls to settings."""
        self.flood.value = config.water.level is not None
        self.sun.value = _sun_choice(config)
        self.seed.value = config.rain.seed
        if config.render.sky in self.sky.options:
            self.sky.value = config.render.sky
        for name, handle in self._choices.items():
            handle.value = config.value(name)
        for slider in SLIDERS:
            handle, value = self._handles[slider.key], float(_shown(slider, config))
            handle.value = min(max(value, handle.min), handle.max)

    # --- time and sizes ---------------------------------------------------------------------------

    def _add_time(self, gui):
        clock = self.painter.clock
        self.play = gui.add_button("play")
        self.step = gui.add_button("next frame")
        self.index = gui.add_slider("frame", 0, max(clock.frames - 1, 1), 1, 0)
        self.loops = gui.add_checkbox("loop", True)
        self.speed = gui.add_dropdown("speed", SPEEDS, initial_value=SPEEDS[0])
        self.frames = gui.add_number("frames", clock.frames, min=2, max=9999, step=1)

        @self.play.on_click
        def _(_):
            plays = self.painter.clock.plays
            self.painter.turn(lambda c, now: c.pause() if plays else c.play(now))
            self._show_time()

        @self.step.on_click
        def _(_):
            self.painter.turn(lambda c, now: (c.pause(), c.go_to((c.index + 1) % c.frames)))
            self._show_time()

        @self.index.on_update
        def _(event):
            if event.client is not None:
                self.painter.turn(lambda c, now: (c.pause(), c.go_to(self.index.value)))
                self._show_time()

        @self.loops.on_update
        @self.speed.on_update
        def _(_):
            top, _, bottom = self.speed.value.partition("/")
            self.painter.turn(
                lambda c, now: (
                    setattr(c, "loops", self.loops.value),
                    setattr(c, "speed", float(top) / float(bottom or 1)),
                )
            )

        def resize(_):
            self.change({"frames": int(self.frames.value)})
            self.index.max = max(int(self.frames.value) - 1, 1)

        self._on(self.frames, resize)

    def _show_time(self):
        clock = self.painter.clock
        self.play.label = "pause" if clock.plays else "play"
        self.index.value = min(clock.index, self.index.max)

    def _add_sizes(self, gui):
        plan = self.painter.schedule
        full = gui.add_number("width at rest [px]", plan.full, min=64, max=MAX_SIDE, step=8)
        least = gui.add_number("least width [px]", plan.least, min=64, max=MAX_SIDE, step=4)
        adapts = gui.add_checkbox("smaller while moving", plan.adapts)
        simplifies = gui.add_checkbox("simple reflections while moving", plan.simplifies)

        @full.on_update
        @least.on_update
        @adapts.on_update
        @simplifies.on_update
        def _(_):
            sizes = int(full.value), int(least.value)
            self.painter.set_sizes(*sizes, adapts.value, simplifies.value)


def _sun_choice(config):
    sun = config.render.sun
    return "none" if sun is None else "sky" if sun == "sky" else "angles"


def _shown(slider, config):
    """Return the number that a slider shows for settings."""
    attribute = HUMAN_KEYS[slider.key][0]
    value = config.value(attribute)
    values = {} if value is None else human_values(attribute, value)
    return values.get(slider.key, SUN.get(slider.key, NO_LEVEL))
