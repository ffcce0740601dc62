"""Settings of light, shutter and look."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rainsim.config.declare import LIGHT, WATER, Group, Key, Option, Slider, setting
from rainsim.config.rain_settings import TURNS
from rainsim.config.rules import OneOf, check_sky, finite, not_negative, pair, positive, rounded
from rainsim.errors import ParameterError, require_finite, shown

FARTHEST = 1e12  # capture units, as `rainsim.io.files.MAX_LENGTH`


def check_sun(name, value, unit):
    """Raise ParameterError unless `value` is an azimuth and an elevation [rad], or of sun "sky"."""
    if name == "sun" and value == "sky":
        return
    azimuth, elevation = pair(name, value, "an azimuth and an elevation")
    sun = name.replace("_", " ")
    require_finite(f"{sun} azimuth", azimuth)
    degrees = math.degrees(require_finite(f"{sun} elevation", elevation))
    if not 0 <= degrees <= 90 + 1e-9:
        none = "give none" if name == "sun" else "give --relight off"
        raise ParameterError(
            f"{sun} elevation is {rounded(degrees)} degrees; it must lie from 0 (horizon) to 90 "
            f"(zenith); for no sun {none}"
        )
    finite(low=-TURNS, high=TURNS)(name, azimuth, "rad")


def check_place(name, value, unit):
    """Raise ParameterError unless `value` is a place x, y, z [capture units]."""
    if not isinstance(value, tuple | list) or len(value) != 3:
        raise ParameterError(f"{name} is {shown(value)}; it must be a place x, y, z")
    for part in value:
        require_finite(name, part, "leave it out for the first camera's place")
        finite(low=-FARTHEST, high=FARTHEST)(name, part, "units")


@dataclass(frozen=True)
class RenderConfig(Group):
    """Light, shutter and look."""

    # fmt: off
    exposure: float = setting(  # longer draws longer and fainter streaks
        1 / 60, "exposure_ms", "ms", "shutter time, at most the time from one frame to the next",
        positive("16.7 is 1/60 s", low=1e-3, high=1e4),
        option=Option("exposure", "MS"), slider=Slider("Camera", "shutter", 0.5, 40, 0.5),
        changing=True, touches=())
    sky: str = setting(
        "overcast", "sky", "",
        "light that water mirrors where the capture shows nothing: overcast, capture (its own "
        "sky), or the path of an equirectangular Radiance .hdr",
        lambda name, value, unit: check_sky(value),
        option=Option("sky", "FILE.hdr|overcast|capture"), touches=(LIGHT,))
    cloudiness: float = setting(
        0.8, "cloudiness", "", "share of the sky under clouds, 0 clear to 1 overcast",
        finite("0 is clear, 1 overcast", low=0.0, high=1.0),
        option=Option("cloudiness", "0..1"), slider=Slider("Light", "cloudiness", 0, 1, 0.05),
        changing=True, touches=(LIGHT,))
    sun: tuple | str | None = setting(  # azimuth from x towards y
        None, rule=check_sun, keys=(
            Key("sun_azimuth_degrees", "degrees",
                "direction of the sun on the ground, as the wind's; without it there is no sun",
                Slider("Light", "sun azimuth", -180, 180, 5)),
            Key("sun_elevation_degrees", "degrees", "height of the sun, 0 horizon to 90 zenith",
                Slider("Light", "sun elevation", 0, 90, 1)),
        ),
        option=Option("sun", "AZIMUTH,ELEVATION|none|sky", help=
                      "direction of the sun in degrees, azimuth as for --wind; sky: the brightest "
                      "spot of the sky"),
        touches=(LIGHT,))
    captured_sun: tuple | None = setting(
        None, rule=check_sun, keys=(
            Key("captured_sun_azimuth_degrees", "degrees",
                "direction of the sun that the capture was taken in, as the wind's; without it by "
                "place and time of photographs, else looked for"),
            Key("captured_sun_elevation_degrees", "degrees", "height of that sun, 0 to 90"),
        ),
        option=Option("captured_sun", "AZIMUTH,ELEVATION", "looked for", help=
                      "where the sun stood when the capture was taken, in degrees as for --sun, "
                      "within 5 degrees; --relight takes it away"),
        touches=(LIGHT,))
    daylight: float = setting(
        1.0, "daylight", "",
        "share of an overcast day's light that is left, 0.04 at dusk; lamps keep theirs",
        positive("0.04 is dusk", low=1e-4, high=1.0,
                 most="1, an overcast day; for a brighter picture raise brightness"),
        touches=(LIGHT,))
    reflections: str = setting(
        "auto", "reflections", "",
        "how reflections are found: mirror draws the capture again from the mirrored camera; ssr "
        "marches rays through the picture; auto uses mirror at the levels of most water and ssr "
        "elsewhere; paper does as the RainyGS paper",
        OneOf("auto", "mirror", "ssr", "paper",
              remedy="auto is nearest to traced rays, which only python -m benchmarks look draws"),
        dropdown=True,
        option=Option("reflections", "NAME"), touches=())
    relight: str = setting(
        "auto", "relight", "", "auto: shadows and colour of the sun that a capture was taken in go "
        "as clouds cover the sky; off: they stay",
        OneOf("auto", "off"), dropdown=True, option=Option("relight", "auto|off"), touches=(LIGHT,))
    brightness: float = setting(
        1.0, "brightness", "", "factor on the brightness of the finished picture",
        positive("1 is as graded, 0.5 half as bright", low=1e-3, high=1e3),
        option=Option("brightness", "FACTOR"), slider=Slider("Light", "brightness", 0.25, 4, 0.05),
        changing=True, touches=())
    metering: str = setting(
        "auto", "metering", "", "auto exposes the land as a camera's meter does on a rainy day; "
        "off keeps the capture's exposure",
        OneOf("auto", "off"), dropdown=True, option=Option("metering", "auto|off"),
        touches=())
    exposure_bias: float = setting(
        -0.3, "exposure_bias_ev", "EV",
        "added to the meter's choice as far as open ground is wet: a meter takes back what wetting "
        "darkens",
        finite(low=-5.0, high=5.0), option=Option("exposure_bias", "EV"),
        slider=Slider("Light", "exposure bias", -2, 2, 0.1), changing=True, touches=())
    wetting: str = setting(
        "class", "wetting", "",
        "class darkens and glosses things by their class, none keeps them dry",
        OneOf("class", "none"), touches=(LIGHT,), paper="none")
    wetness: float = setting(
        1.0, "wetness", "",
        "factor on the darkening and the gloss of what is wet, 0 to 2; 1 is as measured",
        not_negative("1 is as measured, 0 stays dry", high=2.0),
        option=Option("wetness", "0..2"),
        slider=Slider("Rain", "wetness", 0, 2, 0.05, after="puddles"),
        changing=True, touches=(LIGHT,))
    ripples: float = setting(
        1.0, "ripples", "", "factor on the height of ripples, 0 to 2; 1 is as measured",
        not_negative("1 is as measured, 0 is calm water", high=2.0),
        option=Option("ripples", "0..2"),
        slider=Slider("Rain", "ripples", 0, 2, 0.05, after="wetness"), touches=())
    streak_strength: float = setting(
        1.0, "streak_strength", "",
        "factor on how strongly falling drops and splashes show, 0 to 5: a look; 1 is what drops "
        "cover in a lens",
        not_negative("1 is true, 3 shows moderate rain in films", high=5.0, most="5"),
        option=Option("streaks", "0..5"),
        slider=Slider("Rain", "streaks", 0, 5, 0.1, after="ripples"), touches=())
    ground_albedo: float | None = setting(
        None, "ground_albedo", "",
        "share of the light that the open dry ground reflects, such as 0.3 for clean concrete: it "
        "sets how bright the sky is against the land; without it guessed, class by class",
        positive("0.2 is worn paving", low=1e-3, high=1.0,
                 most="1: no ground gives more light than it gets"),
        option=Option("ground_albedo", "0..1", "guessed"), touches=(LIGHT,))
    mirror_size: str = setting(
        "auto", "mirror_size", "",
        "size of mirrored pictures; auto halves them where ripples blur them",
        OneOf("auto", "full", "half"), touches=(),
        kept_for="`benchmarks look` and `benchmarks frame` compare other sizes with these")
    film: str = setting(
        "auto", "film", "", "the mirror of wet ground between puddles: auto draws it where it "
        "shows, mirror always, environment glosses only",
        OneOf("auto", "mirror", "environment"), touches=(LIGHT,),
        kept_for="frames without the mirror, or with it everywhere (docs/light.md)")
    tops: str = setting(
        "auto", "tops", "", "auto lets tables and benches carry water, off only darkens them",
        OneOf("auto", "off"), touches=(WATER, LIGHT), paper="off")
    refraction: str = setting(
        "snell", "refraction", "",
        "snell bends rays to the bed, shift moves the picture as the paper does",
        OneOf("snell", "shift"), touches=(), paper="shift")
    fresnel: str = setting(
        "exact", "fresnel", "",
        "law by which water and all that is wet reflects: exact for a dielectric, or "
        "Schlick's approximation",
        OneOf("exact", "schlick"), touches=(LIGHT,), paper="schlick")
    highlight: str = setting(
        "cox-munk", "highlight", "", "the sun's glint on water",
        OneOf("cox-munk", "blinn-phong"), touches=(), paper="blinn-phong")
    coverage: str = setting(
        "soft", "coverage", "", "soft shares a pixel between water and land, hard chooses one",
        OneOf("soft", "hard"), touches=(), paper="hard")
    water_geometry: str = setting(
        "height-field", "water_geometry", "",
        "what is drawn as water: the height field, or spheres of 6 mm",
        OneOf("height-field", "spheres"), touches=(), paper="spheres")
    streaks: str = setting(
        "shutter", "streaks", "",
        "shutter draws drops over the exposure, paper lines of opaque spheres",
        OneOf("shutter", "paper", remedy="their strength is streak_strength"), touches=(),
        paper="paper")
    splashes: str = setting(
        "crowns", "splashes", "", "crowns, jets and droplets, or one Gaussian for each drop",
        OneOf("crowns", "paper"), touches=(), paper="paper")
    spray: str = setting(
        "auto", "spray", "",
        "auto draws the water that tyres of cars throw, and their tracks; off draws neither",
        OneOf("auto", "off"), touches=(),
        kept_for="cars without spray and tracks (docs/actors.md)")
    glare: str = setting(
        "off", "glare", "",
        "halo of lamps: off, or the eye's point spread after Spencer and others",
        OneOf("off", "spencer"), touches=())
    streak_far: float = setting(
        8.0, "streak_far_m", "m", "depth beyond which drops are drawn as fog",
        positive("8 is usual", low=0.1, high=1e3), touches=(),
        kept_for="`benchmarks frame` compares rain to 3 m, 8 m and 16 m")
    reach_exposure: float = setting(  # s; 0: that of the shutter
        0.0, rule=not_negative(), touches=(),
        kept_for="pictures of parts of an exposure draw the drops that one of the whole would draw")
    aperture: float = setting(
        0.0, "aperture_mm", "mm", "diameter of the lens's opening: near drops blur; 0 is sharp",
        not_negative("0 is sharp, 18 that of 50 mm f/2.8", high=100.0, most="100"),
        slider=Slider("Camera", "aperture", 0, 30, 0.5), touches=())
    focus: float = setting(
        4.0, "focus_m", "m", "distance that is in focus",
        positive("4 is usual", low=1e-3, high=1e6),
        slider=Slider("Camera", "focus", 0.2, 20, 0.1), touches=())
    merge: float = setting(
        4.0, "merge_px", "px", "splats finer than cells of so many px are drawn as one for each "
        "cell; larger is coarser and faster, 0 draws all",
        not_negative("4 is usual, 0 draws all", high=1e4),
        option=Option("merge", "PX"), touches=(LIGHT,))
    detail: float = setting(
        0.7, "detail_px", "px", "of a capture in chunks: splats that are merged take at most so "
        "many px of the picture; larger is coarser and faster, 0 draws all",
        not_negative("0.7 is usual, 0 draws all", high=1e4),
        option=Option("detail", "PX", panel="big"), touches=(LIGHT,))
    memory: float = setting(
        0.6e9, "memory_gb", "GB",
        "what the splats of a capture in chunks may take; what does not fit is drawn coarser",
        positive("1 is usual", low=1e-3, high=1e6),
        option=Option("memory", "GB", panel="big"), touches=(LIGHT,))
    surroundings: tuple | None = setting(
        None, rule=check_place, keys=(
            Key("surroundings_x", "", "place from which the light is drawn that rain and water "
                "mirror, in capture units; without it the first camera's"),
            Key("surroundings_y", "", "see `surroundings_x`"),
            Key("surroundings_z", "", "see `surroundings_x`"),
        ),
        touches=(LIGHT,), kept_for="the page sets it: one light for all views (docs/view.md)")
    # fmt: on
