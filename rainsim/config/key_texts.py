"""What each key of a preset file means, for the reference and for `rainsim presets --keys`.

`HUMAN_KEYS` reads the keys and knows their units, the settings know defaults and choices; here
stands what neither can say. A test demands a line for every key.
"""

from __future__ import annotations

from rainsim.config.preset_files import HUMAN_KEYS, PARTS
from rainsim.config.settings import CHOICES, Config, group_of
from rainsim.config.timeline import CHANGING

MEANINGS = {
    "rain_mm_per_hour": "rain rate, as a gauge on level ground collects it",
    "past_rain_mm": "rain that fell before the first frame; it stands in puddles, at rest",
    "drying_hours": "time since the past rain ended: first the gloss dries, then the darkening",
    "puddles": "factor on the past rain that stands in the ground's dips, 0 to 2",
    "wind_speed_m_per_s": "wind at a height of 10 m",
    "wind_direction_degrees": "the way the air goes, from the first camera's view, "
    "counter-clockwise seen from above",
    "wind_roughness_m": "roughness length of the land around; 0.03 is grass, 0 one wind at all "
    "heights",
    "gusts": "standard deviation of the wind's speed over its mean, 0 to 0.5",
    "drop_radii": "sizes of drops: measured is Marshall and Palmer's distribution, paper one "
    "exponential for all rates",
    "drips": "whether rain on objects drips from their edges",
    "seed": "number of the random drops; another number gives other drops",
    "water_scheme": "how the flow is computed; auto takes accurate on a CPU and lean, the only one "
    "there, on a GPU, and the run says which",
    "water_level_m": "level of still water above the low ground; without it there is no flood",
    "surface_film": "dirt on the water that damps ripples, 0 clean to 1 full",
    "courant": "Courant number of the flow; without it the scheme chooses",
    "exposure_ms": "shutter time, at most the time from one frame to the next",
    "sky": "overcast, capture, or the path of an equirectangular Radiance .hdr",
    "sun_azimuth_degrees": "direction of the sun on the ground, as the wind's; without it "
    "there is no sun",
    "sun_elevation_degrees": "height of the sun, 0 horizon to 90 zenith",
    "cloudiness": "share of the sky under clouds, 0 clear to 1 overcast",
    "daylight": "share of an overcast day's light that is left, 0.04 at dusk; lamps keep theirs",
    "relight": "auto takes the captured sun away as clouds cover the sky, off leaves it",
    "brightness": "factor on the finished picture",
    "metering": "auto exposes the land as a camera's meter does, off as it was captured",
    "exposure_bias_ev": "added to the meter's choice in f-stops, as far as open ground is wet: a "
    "meter takes back what wetting darkens",
    "ground_albedo": "share of the light that the open dry ground reflects; without it guessed",
    "wetting": "class darkens and glosses things by their class, none keeps them dry",
    "wetness": "factor on the darkening and the gloss of what is wet, 0 to 2; 1 is as measured",
    "ripples": "factor on the height of ripples, 0 to 2; 1 is as measured",
    "reflections": "how mirrored light is found",
    "mirror_size": "size of mirrored pictures; auto halves them where ripples blur them",
    "film": "the mirror of wet ground between puddles; auto draws it where it shows",
    "tops": "auto lets tables and benches carry water, off only darkens them",
    "refraction": "snell bends rays to the bed, shift moves the picture as the paper does",
    "fresnel": "law of reflectance: exact for a dielectric, or Schlick's approximation",
    "highlight": "the sun's glint on water",
    "coverage": "soft shares a pixel between water and land, hard chooses one",
    "water_geometry": "what is drawn as water: the height field, or spheres of 6 mm",
    "streaks": "shutter draws drops over the exposure, paper lines of opaque spheres",
    "splashes": "crowns, jets and droplets, or one Gaussian for each drop",
    "spray": "auto lets tyres of cars that drive throw water, off leaves it on the road",
    "glare": "halo of lamps: off, or the eye's point spread after Spencer and others",
    "streak_far_m": "depth beyond which drops are drawn as fog",
    "aperture_mm": "diameter of the lens's opening: near drops blur; 0 is sharp",
    "focus_m": "distance that is in focus",
    "merge_px": "splats finer than cells of so many pixels are drawn as one for each cell; 0 draws "
    "all",
    "detail_px": "of a capture in chunks: splats that are merged take at most so much of the "
    "picture; 0 draws all",
    "memory_gb": "that the splats of a capture in chunks may take",
    "surroundings_x": "place from which the light is drawn that rain and water mirror, in capture "
    "units; without it the first camera's",
    "surroundings_y": "see `surroundings_x`",
    "surroundings_z": "see `surroundings_x`",
    "frames": "number of frames",
    "fps": "frames per second",
    "width": "width of the frames",
    "height": "height of the frames; without it it follows from the camera's shape",
    "terrain_spacing_m": "cell size of the height map; without it chosen",
    "terrain_extent_m": "half the width of the height map; without it chosen",
    "ground_map": "whole is one height map for all frames, path windows of fine cells that follow "
    "the cameras of `rainsim run`; auto takes windows where one map would be too coarse",
}
UNITS = {  # endings of keys, and the unit as a table shows it
    "_mm_per_hour": "mm/h", "_m_per_s": "m/s", "_mm": "mm", "_ms": "ms", "_hours": "h",
    "_degrees": "degrees", "_m": "m", "fps": "1/s", "width": "px", "height": "px",
    "_px": "px", "_gb": "GB", "_ev": "EV",
}  # fmt: skip


def unit_of(key):
    """Return the unit of a key's number as it is written, "" for none."""
    return next((unit for ending, unit in UNITS.items() if key.endswith(ending)), "")


def default_of(key):
    """Return a key's default in the key's unit, None where the program chooses."""
    attribute, unit = HUMAN_KEYS[key]
    group = group_of(attribute)
    config = Config()
    value = getattr(getattr(config, group) if group else config, attribute)
    if attribute in PARTS and value is not None:
        value = value[[name for name, _ in PARTS[attribute]].index(key)]
    if value is None or unit is None:
        return value
    return float(f"{value / unit:.6g}")


def table():
    """Return a row for each key: key, unit, default, choices, whether it may change, meaning.

    Returns
    -------
    list of tuple
        (str, str, value or None, tuple of str, bool, str), in the order of `HUMAN_KEYS`.
    """
    return [
        (
            key, unit_of(key), default_of(key), CHOICES.get(attribute, ()), attribute in CHANGING,
            MEANINGS[key],
        )
        for key, (attribute, _) in HUMAN_KEYS.items()
    ]  # fmt: skip
