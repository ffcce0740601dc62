"""All settings by name, and what follows from their declarations: keys, options, sliders, choices.

Importing this file takes no numpy: the command line's help is made from it.
"""

import dataclasses

from rainsim.config.declare import UNITS, Key, Setting
from rainsim.config.frame_settings import FrameConfig
from rainsim.config.rain_settings import RainConfig
from rainsim.config.render_settings import RenderConfig
from rainsim.config.rules import OneOf
from rainsim.config.water_settings import TerrainConfig, WaterConfig

# In the order of the reference; None: `Config` itself.
GROUPS = {
    "rain": RainConfig, "water": WaterConfig, "render": RenderConfig, None: FrameConfig,
    "terrain": TerrainConfig,
}  # fmt: skip
FOLDERS = ("Rain", "Flood", "Light", "Camera")  # of the page's sliders

SETTINGS = {
    field.name: dataclasses.replace(
        field.metadata["setting"], name=field.name, group=group, kind=field.type,
        default=field.default,
    )
    for group, kind in GROUPS.items() for field in dataclasses.fields(kind)
}  # fmt: skip
# Sets others, each of which a key beside it may set differently.
LOOK = Setting(
    (Key("look", "", "paper takes the paper's choice for each setting that names one: "
         + ", ".join(name for name, one in SETTINGS.items() if one.paper is not None)),),
    rule=OneOf("physical", "paper"), name="look", default="physical",
)  # fmt: skip

_WITH_KEYS = [(key, one) for one in (*SETTINGS.values(), LOOK) for key in one.keys]
# Key in a preset file: attribute and what one unit of the key is in SI (None: not a number).
HUMAN_KEYS = {
    key.name: (one.name, UNITS[key.unit][0] if one.is_number else None) for key, one in _WITH_KEYS
}
# Attributes that several keys fill, with what stands for a missing one (None: required).
PARTS = {
    name: tuple((key.name, key.missing) for key in one.keys)
    for name, one in SETTINGS.items() if len(one.keys) > 1
}  # fmt: skip
CHOICES = {one.name: one.choices for one in (*SETTINGS.values(), LOOK) if one.choices}
CHANGING = tuple(name for name, one in SETTINGS.items() if one.changing)  # a keyframe may set them
# Option of the command line, without its dashes: the preset keys that it sets, in its units.
OPTION_KEYS = {
    one.option.name: tuple(key.name for key in one.keys) for one in SETTINGS.values() if one.option
}
SUN_WORDS = {"none": None, "sky": "sky"}  # of --sun, in place of angles


def look_settings(look):
    """Return the settings of a look by their names, or raise ParameterError for another word."""
    LOOK.check("look", look)
    return {
        name: one.default if look == LOOK.default else one.paper
        for name, one in SETTINGS.items() if one.paper is not None
    }  # fmt: skip


def _sliders():
    """Return the sliders of the page, by folder and in the order in which they stand."""
    found = []
    for key in (key for key, _ in _WITH_KEYS if key.slider):
        unit = f" [{key.unit.replace('degrees', 'deg')}]" if key.unit else ""
        label = key.slider.label + unit
        found.append(dataclasses.replace(key.slider, key=key.name, label=label))
    found.sort(key=lambda slider: FOLDERS.index(slider.group))
    for slider in [slider for slider in found if slider.after]:
        found.remove(slider)
        found.insert([one.key for one in found].index(slider.after) + 1, slider)
    return tuple(found)


SLIDERS = _sliders()


def si_value(key, number):
    """Return the SI value of one preset key's number."""
    unit = HUMAN_KEYS[key][1]
    return number if unit is None else number * unit


def group_of(name):
    """Return the group of a setting, such as "rain"; None if `Config` has it itself."""
    return SETTINGS[name].group if name in SETTINGS else None


def default_of(key):
    """Return a key's default in the key's unit, None where the program chooses."""
    attribute, unit = HUMAN_KEYS[key]
    value = LOOK.default if attribute == "look" else SETTINGS[attribute].default
    if attribute in PARTS and value is not None:
        value = value[[name for name, _ in PARTS[attribute]].index(key)]
    return value if value is None or unit is None else float(f"{value / unit:.6g}")


def table():
    """Return rows of key, unit, default, choices, whether it may change, and meaning."""
    return [
        (key.name, key.unit, default_of(key.name), one.choices, one.changing, key.meaning)
        for key, one in _WITH_KEYS
    ]
