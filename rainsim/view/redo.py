"""The parts that a changed setting makes out of date, so that nothing else is computed again."""

from __future__ import annotations

import dataclasses

from rainsim.config.preset_writer import value_of
from rainsim.config.settings import Config

# Parts of what a picture is drawn from, in the order in which they are made.
TERRAIN, WATER, LIGHT, PASSES = "terrain", "water", "light", "passes"
PARTS = (TERRAIN, WATER, LIGHT, PASSES)
_RAIN = (WATER, LIGHT)  # it falls on the water, and wets what the light falls on
# Settings that are read for each picture: a changed one needs a new picture and nothing else.
PICTURE = frozenset({
    "exposure", "brightness", "exposure_bias", "streak_far", "aperture", "focus", "streaks",
    "splashes", "glare", "frames", "width", "height", "frame_range", "threads", "moments",
})  # fmt: skip
NEEDS = {
    "spacing": (TERRAIN,), "extent": (TERRAIN,), "ground_map": (TERRAIN,),
    "rate": _RAIN, "past": _RAIN, "drying": _RAIN, "puddles": (WATER,),
    "level": _RAIN, "wind": _RAIN, "roughness": _RAIN, "tops": _RAIN, "keyframes": _RAIN,
    "scheme": (WATER,), "courant": (WATER,),
    "seed": (WATER, PASSES), "gusts": (WATER, PASSES), "drop_radii": (WATER, PASSES),
    "drips": (WATER, PASSES), "surface_film": (WATER, PASSES), "fps": (WATER, PASSES),
    "spray": (WATER, PASSES),
    "sky": (LIGHT,), "sun": (LIGHT,), "cloudiness": (LIGHT,),
    "daylight": (LIGHT,), "relight": (LIGHT,),
    "ground_albedo": (LIGHT,), "wetting": (LIGHT,), "wetness": (LIGHT,),
    "surroundings": (LIGHT,), "film": (LIGHT,), "detail": (LIGHT,), "memory": (LIGHT,),
    "merge": (LIGHT,), "metering": (PASSES,), "ripples": (PASSES,),
    "reflections": (PASSES,), "mirror_size": (PASSES,), "refraction": (PASSES,),
    "fresnel": (PASSES,), "highlight": (PASSES,), "coverage": (PASSES,),
    "water_geometry": (PASSES,),
}  # fmt: skip
# A part that is made again takes these with it.
WITH = {
    TERRAIN: frozenset(PARTS), WATER: frozenset({WATER}), LIGHT: frozenset({LIGHT, PASSES}),
    PASSES: frozenset({PASSES}),
}  # fmt: skip


def settings():
    """Return the names of all settings, whatever their group."""
    groups = (Config, *(f.default_factory for f in dataclasses.fields(Config)
                        if isinstance(f.default_factory, type)))  # fmt: skip
    names = [f.name for group in groups for f in dataclasses.fields(group)]
    return [name for name in names if name not in ("terrain", "rain", "water", "render")]


def changed(before, after):
    """Return the names of the settings in which two `Config` differ."""
    return [n for n in settings() if value_of(before, n) != value_of(after, n)]


def out_of_date(before, after):
    """Return the parts that a change of settings makes out of date, in the order of `PARTS`.

    Parameters
    ----------
    before, after : Config

    Returns
    -------
    tuple of str
        Of `PARTS`; empty where a new picture is all that it takes.
    """
    wanted = set()
    for name in changed(before, after):
        for part in NEEDS.get(name, () if name in PICTURE else PARTS):
            wanted |= WITH[part]
    return tuple(part for part in PARTS if part in wanted)
