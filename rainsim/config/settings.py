"""All settings as frozen data in SI units, and the preset files that hold them in human units.

The attribute names of all groups differ, so `config.replace(rate=..., width=...)` needs no group.
Human units (mm/h, degrees, ms) exist here and on the command line only.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import rainsim.config.timeline as timeline
from rainsim.config.preset_files import (
    DEFAULT_PRESET,
    HUMAN_KEYS,
    MM_PER_HOUR,
    from_human,
    is_number,
    nearest,
    parsed_toml,
    preset_file,
    preset_names,
    preset_text,
)
from rainsim.config.ranges import check_ranges
from rainsim.config.rules import check_sky, pair, require_whole, rounded
from rainsim.errors import (
    ParameterError,
    require_choice,
    require_finite,
    require_not_negative,
    require_positive,
    shown,
)

__all__ = [
    "HUMAN_KEYS", "MM_PER_HOUR", "Config", "RainConfig", "RenderConfig", "TerrainConfig",
    "WaterConfig", "check_sky", "mm_per_hour", "nearest", "preset_names", "preset_text",
]  # fmt: skip

WATER_SCHEMES = ("auto", "accurate", "lean", "paper")
REFLECTIONS = ("auto", "mirror", "ssr", "traced", "paper")
# Where there are two choices, the second is the paper's.
FILMS = ("auto", "mirror", "environment")
MIRROR_SIZES = ("auto", "full", "half")
REFRACTIONS = ("snell", "shift")
FRESNELS = ("exact", "schlick")
HIGHLIGHTS = ("cox-munk", "blinn-phong")
COVERAGES = ("soft", "hard")
METERINGS = ("auto", "off")
RELIGHTS = ("auto", "off")
WETTINGS = ("class", "none")
WATER_GEOMETRIES = ("height-field", "spheres")
DROP_RADII = ("measured", "paper")
STREAKS = ("shutter", "paper")
SPLASHES = ("crowns", "paper")
TOPS = ("auto", "off")
SPRAYS = ("auto", "off")
GLARES = ("off", "spencer")
LOOKS = {  # attributes of the light and look that take one of some words
    "metering": METERINGS, "relight": RELIGHTS, "wetting": WETTINGS, "reflections": REFLECTIONS,
    "mirror_size": MIRROR_SIZES, "film": FILMS, "tops": TOPS, "refraction": REFRACTIONS,
    "fresnel": FRESNELS, "highlight": HIGHLIGHTS, "coverage": COVERAGES,
    "water_geometry": WATER_GEOMETRIES, "streaks": STREAKS, "splashes": SPLASHES,
    "spray": SPRAYS, "glare": GLARES,
}  # fmt: skip
GROUND_MAPS = ("auto", "whole", "path")
CHOICES = {
    "scheme": WATER_SCHEMES, "drop_radii": DROP_RADII, "ground_map": GROUND_MAPS, **LOOKS,
}  # fmt: skip

MAX_RATE = 1000.0  # mm/h: the heaviest minutes ever measured stay below 2500, an hour below 400
MAX_PAST = 1000.0  # mm: more than a day's record almost anywhere
MAX_WIND = 60.0  # m/s: beyond hurricane strength drops no longer fall as modelled
MAX_APERTURE = 0.1  # m
MAX_ROUGHNESS = 2.0  # m: Davenport's roughest class
MAX_GUSTS = 0.5  # beyond it the wind would turn around now and then
MIN_SIDE, MAX_SIDE = 8, 16384  # px
MAX_FRAMES = 99_999  # what the five digits of a frame's file name hold
MAX_THREADS = 4096
MAX_SEED = 2**32 - 1


def mm_per_hour(rate):
    """Convert a rain rate from mm/h to m/s."""
    return rate * MM_PER_HOUR


@dataclass(frozen=True)
class TerrainConfig:
    """The height map below the scene."""

    spacing: float | None = None  # m; None: chosen from splats, cameras and the map's size
    extent: float | None = None  # m, half the width of the square map; None: chosen from cameras
    ground_map: str = "auto"  # path: fine windows follow the cameras; whole: one map for all

    def check(self):
        """Raise ParameterError if a value breaks its rule."""
        require_choice("ground_map", self.ground_map, GROUND_MAPS)
        if self.spacing is not None:
            require_positive("terrain spacing", self.spacing, "m", "0.02 is usual")
        if (self.spacing or 0) > 0.5:
            raise ParameterError(f"terrain spacing is {self.spacing} m; it must be at most 0.5 m")
        if self.extent is not None:
            require_positive("terrain extent", self.extent, "m", "leave it out to have it chosen")
            least = 4 * (self.spacing or 0.005)
            if self.extent < least:
                raise ParameterError(
                    f"terrain extent is {self.extent} m; it must be at least {least:g} m, 4 cells; "
                    "make it larger"
                )


@dataclass(frozen=True)
class RainConfig:
    """What falls, and what has fallen before the first frame."""

    rate: float = mm_per_hour(10.0)  # m/s, as a gauge on level ground collects it
    past: float = 3e-3  # m of rain that fell before the first frame; it stands at rest
    drying: float = 0.0  # s since the past rain ended; water films, pores and puddles dry meanwhile
    puddles: float = 1.0  # factor on the past rain that stands in the ground's dips
    wind: tuple = (0.0, 0.0)  # speed at 10 m [m/s] and the way it goes, from x towards y [rad]
    roughness: float = 0.03  # m, roughness length of the land around: grass; 0: one wind everywhere
    gusts: float = 0.0  # standard deviation of the wind's speed over its mean, 0 to 0.5
    drips: bool = True  # what falls on objects drips from their edges
    drop_radii: str = "measured"  # paper: one exponential for all rates, one speed for all drops
    seed: int = 0

    @property
    def wind_velocity(self):
        """Horizontal wind at 10 m (x, y) in the ground frame [m/s]."""
        speed, direction = self.wind
        return speed * math.cos(direction), speed * math.sin(direction)

    def check(self):
        """Raise ParameterError if a value breaks its rule."""
        rate = self.rate / MM_PER_HOUR if is_number(self.rate) else self.rate
        require_not_negative("rain", rounded(rate), "mm/h", "0 is no rain, 50 a downpour")
        if rate > MAX_RATE * (1 + 1e-9):
            raise ParameterError(
                f"rain is {rounded(rate)} mm/h; it must be at most {MAX_RATE:g}; 50 is a downpour"
            )
        past = self.past * 1e3 if is_number(self.past) else self.past
        require_not_negative("past rain", rounded(past), "mm", "0 leaves no puddles")
        if past > MAX_PAST * (1 + 1e-9):
            raise ParameterError(
                f"past rain is {rounded(past)} mm; it must be at most {MAX_PAST:g}; "
                "for a flood give a water level"
            )
        drying = self.drying / 3600 if is_number(self.drying) else self.drying
        require_not_negative("drying", drying, "h", "0 is still wet from the rain")
        require_not_negative("puddles", self.puddles, "", "1 is as it rained, 0 leaves none")
        speed, direction = pair("wind", self.wind, "a speed and a direction")
        require_not_negative("wind speed", speed, "m/s", "turn the direction instead")
        if speed > MAX_WIND:
            raise ParameterError(f"wind speed is {speed} m/s; it must be at most {MAX_WIND:g} m/s")
        require_finite("wind direction", direction)
        require_not_negative("roughness length", self.roughness, "m", "0.03 is grass")
        if self.roughness > MAX_ROUGHNESS:
            raise ParameterError(
                f"roughness length is {self.roughness} m; it must be at most {MAX_ROUGHNESS:g} m, "
                "that of a city centre"
            )
        require_not_negative("gusts", self.gusts, "", "0.3 is a gusty wind")
        if self.gusts > MAX_GUSTS:
            raise ParameterError(f"gusts is {self.gusts}; it must be at most {MAX_GUSTS}")
        require_choice("drop_radii", self.drop_radii, DROP_RADII)
        require_choice("drips", self.drips, (True, False))
        require_whole("seed", self.seed, 0, MAX_SEED)


@dataclass(frozen=True)
class WaterConfig:
    """Water on the ground."""

    scheme: str = "auto"  # auto: the solver chooses and reports its choice
    level: float | None = None  # m above the 5th percentile of the bed: still water, a flood
    surface_film: float = 0.0  # 0 clean water to 1 a film of dirt that damps rings most
    courant: float | None = None  # share of the largest stable time step; None: the scheme's own

    def check(self):
        """Raise ParameterError if a value breaks its rule."""
        require_choice("water scheme", self.scheme, WATER_SCHEMES, "auto chooses by itself")
        require_not_negative("surface film", self.surface_film, "", "0 is clean, 1 street dirt")
        if self.surface_film > 1:
            raise ParameterError(f"surface film is {self.surface_film}; it must be at most 1")
        if self.level is not None:
            require_finite("water level", self.level, "give metres, or leave it out for no flood")
        if self.courant is not None:
            require_positive("courant", self.courant, "", "leave it out for the scheme's own")
            if self.courant > 1:
                raise ParameterError(f"courant is {self.courant}; it must be at most 1")


@dataclass(frozen=True)
class RenderConfig:
    """Light, shutter and look."""

    exposure: float = 1 / 60  # s; longer draws longer and fainter streaks
    sky: str = "overcast"  # or "capture", or the path of an equirectangular Radiance .hdr
    sun: tuple | str | None = None  # azimuth from x towards y, elevation [rad]; "sky": the sky's
    cloudiness: float = 0.8  # 0 clear to 1 overcast
    daylight: float = 1.0  # share of an overcast day's light that is left; 0.04 is dusk
    relight: str = "auto"  # a captured sun goes as clouds cover the sky; off: it stays
    brightness: float = 1.0  # factor on the finished picture
    metering: str = "auto"  # exposed as by a camera's meter; off: as the capture was
    exposure_bias: float = -0.3  # EV on the meter's choice, as far as open ground is wet
    ground_albedo: float | None = None  # of the open ground; None: guessed, class by class
    wetting: str = "class"  # things darken and gloss by class; none: they stay dry, the paper's
    wetness: float = 1.0  # factor on how much what is wet darkens and glosses
    ripples: float = 1.0  # factor on the height of ripples
    reflections: str = "auto"  # mirror: one mirrored pass; ssr: march the depth; auto: a mirror
    # for each level of much water, else the march; traced: rays, slow; paper: a point test
    mirror_size: str = "auto"  # of mirrored pictures; half: of the frame's sides; auto: by ripples
    film: str = "auto"  # wet-ground mirror where it shows; mirror: always; environment: gloss only
    tops: str = "auto"  # what lies flat above the ground carries water; off: it only darkens
    refraction: str = "snell"  # shift: the image shifted by the normal, the paper's
    fresnel: str = "exact"  # schlick: the paper's approximation
    highlight: str = "cox-munk"  # of the sun; blinn-phong: the paper's (n.h)^p
    coverage: str = "soft"  # hard: a pixel is water or it is not, the nearer, the paper's
    water_geometry: str = "height-field"  # spheres: of 6 mm at the map's cells, the paper's
    streaks: str = "shutter"  # paper: opaque lines of spheres, whatever the shutter
    splashes: str = "crowns"  # paper: one Gaussian for each drop
    spray: str = "auto"  # tyres of cars throw the water that they meet; off: they leave it alone
    glare: str = "off"  # of lamps; spencer: the eye's point spread
    streak_far: float = 8.0  # m; farther drops are fog
    aperture: float = 0.0  # m, diameter of the lens's opening: near drops blur; 0: all are sharp
    focus: float = 4.0  # m, what is in focus
    merge: float = 4.0  # px: finer splats are one in cells of this side; 0: all are drawn
    detail: float = 0.7  # px: what a level of a big capture merges is at most so wide; 0: nothing
    memory: float = 0.6e9  # bytes that a big capture's splats may take
    surroundings: tuple | None = None  # x, y, z [capture units] from where the light is drawn that
    # rain and water mirror; None: the first camera's place

    def check(self):
        """Raise ParameterError if a value breaks its rule."""
        exposure = self.exposure * 1e3 if is_number(self.exposure) else self.exposure
        require_positive("exposure", rounded(exposure), "ms", "16.7 is 1/60 s")
        check_sky(self.sky)
        if self.sun not in (None, "sky"):
            azimuth, elevation = pair("sun", self.sun, "an azimuth and an elevation")
            require_finite("sun azimuth", azimuth)
            degrees = math.degrees(require_finite("sun elevation", elevation))
            if not 0 <= degrees <= 90 + 1e-9:
                raise ParameterError(
                    f"sun elevation is {rounded(degrees)} degrees; it must lie from 0 (horizon) "
                    "to 90 (zenith); for no sun give none"
                )
        require_finite("cloudiness", self.cloudiness)
        if not 0 <= self.cloudiness <= 1:
            raise ParameterError(
                f"cloudiness is {self.cloudiness}; it must lie from 0 (clear) to 1 (overcast)"
            )
        require_positive("daylight", self.daylight, "", "0.04 is dusk")
        if self.daylight > 1:
            raise ParameterError(
                f"daylight is {self.daylight}; it must be at most 1, an overcast day; for a "
                "brighter picture raise brightness"
            )
        require_positive("brightness", self.brightness, "", "1 is as graded, 0.5 half as bright")
        require_finite("exposure_bias", self.exposure_bias)
        require_not_negative("wetness", self.wetness, "", "1 is as measured, 0 stays dry")
        require_not_negative("ripples", self.ripples, "", "1 is as measured, 0 is calm water")
        if self.ground_albedo is not None:
            require_positive("ground_albedo", self.ground_albedo, "", "0.2 is worn paving")
            if self.ground_albedo > 1:
                raise ParameterError(
                    f"ground_albedo is {self.ground_albedo}; it must be at most 1: no ground gives "
                    "more light than it gets"
                )
        for name, choices in LOOKS.items():
            require_choice(name, getattr(self, name), choices)
        aperture = self.aperture * 1e3 if is_number(self.aperture) else self.aperture
        require_not_negative(
            "aperture", rounded(aperture), "mm", "0 is sharp, 18 that of 50 mm f/2.8"
        )
        if aperture > MAX_APERTURE * 1e3:
            raise ParameterError(f"aperture is {rounded(aperture)} mm; it must be at most 100")
        require_positive("focus", self.focus, "m", "4 is usual")
        require_positive("streak_far", self.streak_far, "m", "8 is usual")
        require_not_negative("merge", self.merge, "px", "4 is usual, 0 draws all")
        require_not_negative("detail", self.detail, "px", "0.7 is usual, 0 draws all")
        require_positive("memory", self.memory, "bytes", "1e9 is usual")
        if self.surroundings is not None:
            if not isinstance(self.surroundings, tuple | list) or len(self.surroundings) != 3:
                place = shown(self.surroundings)
                raise ParameterError(f"surroundings is {place}; it must be a place x, y, z")
            for value in self.surroundings:
                require_finite("surroundings", value, "leave it out for the first camera's place")


@dataclass(frozen=True)
class Config:
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
    frames: int = 24
    fps: float = 24.0  # 1/s
    width: int | None = 648  # px; None: the camera's own
    height: int | None = None  # px; None: follows from the camera's shape
    frame_range: tuple | None = None  # (first, end), end excluded; None: all frames
    threads: int | None = None  # None: all cores
    keyframes: tuple = ()  # what changes in time, see `rainsim.config.timeline`
    moments: tuple = ()  # number of the water's state that each frame shows; (): its own number

    def key_times(self):
        """Return the times [s] of the keyframes; a single 0 if there are none."""
        return [time for time, _ in self.keyframes] or [0.0]

    def at(self, time):
        """Return the settings as they are at a time [s], without keyframes."""
        if not self.keyframes:
            return self

        def base(name):
            return getattr(getattr(self, _GROUP_OF[name]), name)

        values = timeline.values_at(self.keyframes, base, time)
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
    def from_preset(cls, name=DEFAULT_PRESET):
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
        return cls.from_toml(*preset_file(name))

    @classmethod
    def from_toml(cls, text, where="settings", folder=None):
        """Return the settings of the TOML `text`; settings not in it keep their defaults.

        `where` names the text in errors; a relative sky file is looked for in `folder`.
        """
        table = parsed_toml(text, where)
        frames = table.pop(timeline.LIST_KEY, [])
        config = cls().replace(**from_human(table, where, folder))
        frames = timeline.read_keyframes(frames, from_human, where)
        config = dataclasses.replace(config, keyframes=frames)
        try:
            config._check_each()  # not one against another: options may change either yet
            return config
        except ParameterError as error:
            raise ParameterError(f"{where}: {error}") from None

    def replace(self, **changes):
        """Return the settings with some attributes changed, named without their group (SI units).

        A changed setting holds for all times: it is removed from the keyframes.

        Raises
        ------
        ParameterError
            If a name is unknown; it names the nearest one.
        """
        grouped = {}
        for name, value in changes.items():
            if name not in _GROUP_OF:
                raise ParameterError(
                    f"{name} is not a setting; {nearest(name, _GROUP_OF)}; correct the name"
                )
            grouped.setdefault(_GROUP_OF[name], {})[name] = value
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
        for group in _GROUPS:
            getattr(self, group).check()
            check_ranges(getattr(self, group))
        require_whole("frames", self.frames, 1, MAX_FRAMES)
        require_positive("fps", self.fps, "frames/s", "24 is usual")
        check_ranges(self)
        for name in ("width", "height"):
            if getattr(self, name) is not None:
                require_whole(name, getattr(self, name), MIN_SIDE, MAX_SIDE, "px")
        if self.threads is not None:
            require_whole("threads", self.threads, 1, MAX_THREADS)

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
        flat = {name: value for name, value in groups.items() if name not in _GROUPS}
        for group in _GROUPS:
            own = groups.get(group, {})
            if not isinstance(own, dict):
                raise ParameterError(f"the settings of {group} are no table; correct them")
            flat.update(own)
        # JSON has lists where we have tuples.
        flat = {n: tuple(v) if isinstance(v, list) else v for n, v in flat.items()}
        flat["keyframes"] = timeline.from_json(flat.get("keyframes", ()))
        return cls().replace(**flat).check()


_GROUPS = {
    "terrain": TerrainConfig,
    "rain": RainConfig,
    "water": WaterConfig,
    "render": RenderConfig,
}
_GROUP_OF = {f.name: None for f in dataclasses.fields(Config) if f.name not in _GROUPS}
for _name, _group in _GROUPS.items():
    _GROUP_OF |= {f.name: _name for f in dataclasses.fields(_group)}


def group_of(name):
    """Return the group of a setting, such as "rain"; None if `Config` has it itself."""
    return _GROUP_OF[name]
