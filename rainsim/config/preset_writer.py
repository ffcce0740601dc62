"""Settings as the text of a preset file, in human units, such that they are read back exactly."""

import json
import math

from rainsim.config import timeline
from rainsim.config.settings import Config
from rainsim.config.tables import HUMAN_KEYS, PARTS, SETTINGS


def preset_text_of(config, about=""):
    """Return the text of a preset file that `Config.from_toml` reads back as `config`.

    Settings that have their default value are left out, and so are those that no preset file can
    hold: `threads`, `frame_range`, `moments`, a sun that is where the sky has it, a size that is
    not given. `about` is one line for the head of the file, `rainsim presets` shows it.
    """
    usual, lines = Config(), [f"# {about}\n"] if about else []
    if config.look != usual.look:
        lines.append(as_toml({"look": config.look}))
        usual = usual.replace(look=config.look)
    for attribute in (name for name, one in SETTINGS.items() if one.keys):
        value = config.value(attribute)
        if value is not None and value != usual.value(attribute):
            lines.append(as_toml(human_values(attribute, value)))
    for time, changes in config.keyframes:
        table = {timeline.TIME_KEY: time}
        for name, value in changes:
            table |= human_values(name, value)
        lines.append(f"\n[[{timeline.LIST_KEY}]]\n{as_toml(table)}")
    return "".join(lines)


def human(value, unit):
    """Return the number of a preset key that `from_human` turns into the SI `value` exactly.

    The shortest of such numbers; the nearest one if there is none.
    """
    if unit is None or unit == 1.0 or isinstance(value, bool):
        return value
    guess = value / unit
    near = [float(f"{guess:.{digits}g}") for digits in range(1, 17)]
    near += [guess, math.nextafter(guess, math.inf), math.nextafter(guess, -math.inf)]
    return next((number for number in near if number * unit == value), guess)


def human_values(attribute, value):
    """Return the preset keys of an attribute with the values that its SI `value` has there."""
    keys = [(key, unit) for key, (name, unit) in HUMAN_KEYS.items() if name == attribute]
    parts = value if attribute in PARTS and isinstance(value, tuple | list) else (value,)
    if len(parts) != len(keys):  # a sun that is where the sky has it
        return {}
    return {key: human(part, unit) for (key, unit), part in zip(keys, parts, strict=True)}


def as_toml(table):
    """Return the lines of a preset file for a table of plain values."""
    return "".join(f"{key} = {_toml_value(value)}\n" for key, value in table.items())


def _toml_value(value):
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):  # quoted as in JSON but for one character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)
