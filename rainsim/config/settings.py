"""All settings as frozen data in SI units, and the preset files that hold them in human units.

The attribute names of all groups differ, so `config.replace(rate=..., width=...)` needs no group.
Human units (mm/h, degrees, ms) exist here and on the command line only.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import rainsim.config.timeline as timeline
from rainsim.config import preset_files, tables
from rainsim.config.frame_settings import MAX_FRAMES, FrameConfig
from rainsim.config.preset_files import nearest, preset_names, preset_text
from rainsim.config.rain_settings import RainConfig
from rainsim.config.render_settings import RenderConfig
from rainsim.config.rules import MM_PER_HOUR, check_sky, pair, require_whole
from rainsim.config.tables import HUMAN_KEYS
from rainsim.config.water_settings import TerrainConfig, WaterConfig
from rainsim.errors import ParameterError

__all__ = [
    "HUMAN_KEYS", "MM_PER_HOUR", "Config", "RainConfig", "RenderConfig", "TerrainConfig",
    "WaterConfig", "check_sky", "mm_per_hour", "nearest", "preset_names", "preset_text",
]  # fmt: skip


def mm_per_hour(rate):
    """Convert a rain rate from mm/h to m/s."""
    return rate * MM_PER_HOUR


@dataclass(frozen=True)
class Config(FrameConfig):
    """Everything that shapes the frames but the scene and its cameras.

    The groups `terrain`, `rain`, `water` and `render`, and `frames`, `fps`, `width`, `height`,
    `frame_range`, `threads`, `keyframes` and `moments`. All values are in SI units.

    Examples
    --------
    >>> config = rainsim.Config.from_preset("downpour").replace(frames=12)
    >>> config.frames, round(config.rain.rate / rainsim.mm_per_hour(1))
    (12, 50)
    """

    terrain: TerrainConfig = field(default_factory=TerrainConfig)
    rain: RainConfig = field(default_factory=RainConfig)
    water: WaterConfig = field(default_factory=WaterConfig)
    render: RenderConfig = field(default_factory=RenderConfig)

    @property
    def look(self):
        """The look: "paper" where every choice of the paper is taken, else "physical"."""
        paper = tables.look_settings("paper")
        taken = all(self.value(name) == value for name, value in paper.items())
        return "paper" if taken else "physical"

    def value(self, name):
        """Return the value [SI] of a setting by its name, whatever its group."""
        group = tables.group_of(name)
        return getattr(self if group is None else getattr(self, group), name)

    def key_times(self):
        """Return the times [s] of the keyframes; a single 0 if there are none."""
        return [time for time, _ in self.keyframes] or [0.0]

    def at(self, time):
        """Return the settings as they are at a time [s], without keyframes."""
        if not self.keyframes:
            return self
        values = timeline.values_at(self.keyframes, self.value, time)
        return dataclasses.replace(self, keyframes=()).replace(**values)

    @property
    def frame_interval(self):
        """Time from one frame to the next [s]."""
        return 1 / self.fps

    def moment(self, index):
        """Return the number of the water's state that a frame shows."""
        return self.moments[index] if self.moments else index

    @property
    def indices(self):
        """The range of frame numbers that are to be drawn."""
        return range(*(self.frame_range or (0, self.frames)))

    @classmethod
    def from_preset(cls, name=preset_files.DEFAULT_PRESET):
        """Return the settings of a built-in preset or of a TOML file.

        Parameters
        ----------
        name : str or path-like
            One of `preset_names()`, or the path of a file that ends in .toml.

        Raises
        ------
        ParameterError
            If there is no such preset, or a key or value in it is wrong.
        """
        return cls.from_toml(*preset_files.preset_file(name))

    @classmethod
    def from_toml(cls, text, where="settings", folder=None):
        """Return the settings of the TOML `text`; settings not in it keep their defaults.

        `where` names the text in errors; a relative sky file is looked for in `folder`.
        """
        table = preset_files.parsed_toml(text, where)
        frames = table.pop(timeline.LIST_KEY, [])
        changes = preset_files.from_human(table, where, folder)
        frames = timeline.read_keyframes(frames, preset_files.from_human, where)
        try:
            config = dataclasses.replace(cls().replace(**changes), keyframes=frames)
            config._check_each()  # not one against another: options may change either yet
            return config
        except ParameterError as error:
            raise ParameterError(f"{where}: {error}") from None

    def replace(self, **changes):
        """Return the settings with some attributes changed, named without their group (SI units).

        A changed setting holds for all times: it is removed from the keyframes. `look` sets all
        choices of a look but those that are named beside it.

        Raises
        ------
        ParameterError
            If a name is unknown; it names the nearest one.
        """
        grouped = {}
        if "look" in changes:
            changes = tables.look_settings(changes.pop("look")) | changes
        for name, value in changes.items():
            if name not in tables.SETTINGS:
                known = nearest(name, [*tables.SETTINGS, "look"])
                raise ParameterError(f"{name} is not a setting; {known}; correct the name")
            grouped.setdefault(tables.group_of(name), {})[name] = value
        top = grouped.pop(None, {})
        if self.keyframes:
            top.setdefault("keyframes", timeline.without(self.keyframes, set(changes)))
        for group, own in grouped.items():
            top[group] = dataclasses.replace(getattr(self, group), **own)
        return dataclasses.replace(self, **top)

    def check(self):
        """Return `self`, or raise ParameterError for the first value that breaks a rule."""
        self._check_each()
        if self.frame_range is not None:
            self._check_range()
        timeline.check_moments(self.moments, self.frames)
        interval = self.frame_interval
        exposure = max(self.at(time).render.exposure for time in self.key_times())
        if exposure > interval * (1 + 1e-9):
            raise ParameterError(
                f"exposure is {exposure * 1e3:.4g} ms; it must be at most one frame, "
                f"{interval * 1e3:.4g} ms at {self.fps:g} frames/s; shorten it or lower fps"
            )
        return self

    def _check_each(self):
        """Check every value by itself; `check` compares values of different groups."""
        timeline.from_json(self.keyframes)
        for time in self.key_times() if self.keyframes else ():
            try:
                self.at(time)._check_each()
            except ParameterError as error:
                raise ParameterError(f"at {time:g} s: {error}") from None
        for group in filter(None, tables.GROUPS):
            getattr(self, group).check()
        super().check()

    def _check_range(self):
        first, end = pair("frame range", self.frame_range, "a first frame and an end")
        require_whole("first frame of the range", first, 0, MAX_FRAMES)
        require_whole("end of the frame range", end, 0, MAX_FRAMES)
        if not first < end <= self.frames:
            raise ParameterError(
                f"frame range is {first}:{end}; it must satisfy 0 <= A < B <= {self.frames} "
                f"(the end is not included); for all frames give 0:{self.frames}"
            )

    def as_dict(self):
        """Return nested plain values in SI units, as JSON holds them; see `from_dict`."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, groups):
        """Return the Config of an `as_dict` result, exactly, also if it was stored as JSON.

        Raises
        ------
        ParameterError
            If `groups` is no such dict or a value breaks its rule.
        """
        if not isinstance(groups, dict):
            raise ParameterError("the settings are no table of names and values; correct them")
        flat = {name: value for name, value in groups.items() if name not in tables.GROUPS}
        for group in filter(None, tables.GROUPS):
            own = groups.get(group, {})
            if not isinstance(own, dict):
                raise ParameterError(f"the settings of {group} are no table; correct them")
            flat.update(own)
        # JSON has lists where we have tuples.
        flat = {n: tuple(v) if isinstance(v, list) else v for n, v in flat.items()}
        flat["keyframes"] = timeline.from_json(flat.get("keyframes", ()))
        return cls().replace(**flat).check()
