"""How a setting is declared: one call of `setting` says all that is known about it.

`rainsim.config.tables` makes the keys of preset files, the options of the command line, the page's
controls and the tables of the reference from these declarations.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

from rainsim.config.rules import MM_PER_HOUR, OneOf, is_number, rounded

UNITS = {  # as people write them: one of it in SI, and its SI unit
    "mm/h": (MM_PER_HOUR, "m/s"), "m/s": (1.0, "m/s"), "mm": (1e-3, "m"), "m": (1.0, "m"),
    "ms": (1e-3, "s"), "h": (3600.0, "s"), "degrees": (math.pi / 180, "rad"), "GB": (1e9, "bytes"),
    "frames/s": (1.0, "1/s"), "px": (1.0, "px"), "EV": (1.0, "EV"), "": (1.0, ""),
}  # fmt: skip
# Parts of what a picture is drawn from, in the order in which they are made: a changed setting
# makes those out of date that it touches, and a new picture is drawn in any case: what its passes
# do again follows from what they read, see `rainsim.render.frame`.
BASES = TERRAIN, WATER, LIGHT = ("terrain", "water", "light")


@dataclass(frozen=True)
class Slider:
    """How a number is turned on the page, in the units of its key."""

    group: str  # folder of the page
    label: str  # without its unit, which `tables.SLIDERS` adds
    low: float  # the usual range, within what the rule of the setting allows
    high: float
    step: float
    after: str = ""  # key whose slider it follows; by default it is the next of its folder
    key: str = ""  # that it turns; `tables.SLIDERS` has it


@dataclass(frozen=True)
class Option:
    """How a setting is given on the command line, in the units of its keys."""

    name: str  # without dashes, words joined by an underscore
    metavar: str | None = None  # the value in the help: its unit or choices; None: its type
    default: str = "the preset's"  # as the help shows it
    panel: str = ""  # options that commands take together; by default those of its group
    help: str = ""  # by default what its key means


@dataclass(frozen=True)
class Key:
    """Key of a preset file."""

    name: str
    unit: str  # of `UNITS`
    meaning: str  # for the reference, `rainsim presets --keys` and the command line's help
    slider: Slider | None = None
    missing: float | None = None  # where only other keys of its setting are given; None: an error


@dataclass(frozen=True)
class Setting:
    """All that is known about a setting: one of `tables.SETTINGS`."""

    keys: tuple = ()  # one, or one for each part of the value; none: no preset file holds it
    rule: Callable | None = None  # rule(name, value, unit) raises an error, see `rules`
    option: Option | None = None
    changing: bool = False  # whether a keyframe may set it
    touches: tuple = BASES  # made again when it changes
    paper: object = None  # its value in the look of the paper; None: the look leaves it alone
    dropdown: bool = False  # whether the page chooses it beside the light's sliders
    kept_for: str = ""  # where no option, no slider and no built-in preset sets it: who needs it
    name: str = ""  # of the attribute
    group: str | None = None  # attribute of `Config` that has it; None: `Config` itself
    kind: str = ""  # annotation of the attribute, such as "float | None"
    default: object = None  # [SI]

    @property
    def choices(self):
        """The words that it takes one of; none where it takes others."""
        found = self.rule.choices if isinstance(self.rule, OneOf) else ()
        return tuple(choice for choice in found if isinstance(choice, str))

    @property
    def is_number(self):
        """Whether its keys hold numbers with a unit."""
        return self.kind.startswith(("float", "tuple"))

    def check(self, name, value):
        """Raise an error if the value [SI] of a setting breaks its rule."""
        if self.rule is None:
            return
        unit = self.keys[0].unit if len(self.keys) == 1 else ""
        si = UNITS[unit][0]
        if si != 1.0 and is_number(value):
            value = rounded(value / si)
        self.rule(name, value, unit)


def setting(default, key="", unit="", meaning="", rule=None, *, slider=None, keys=(), **more):
    """Return the field of a setting, for a subclass of `Group`.

    `default` is in SI units; None: the program chooses. `key`, `unit`, `meaning` and `slider` are
    those of its `Key`; `keys` come in place of these, where the value has several parts. `more` are
    further attributes of `Setting`.
    """
    keys = (Key(key, unit, meaning, slider),) if key else keys
    return dataclasses.field(default=default, metadata={"setting": Setting(keys, rule, **more)})


class Group:
    """Settings of one subject; its subclasses are frozen dataclasses."""

    def __init_subclass__(cls):
        """Describe the attributes in the docstring."""
        found = {name: f.metadata["setting"] for name, f in vars(cls).items()
                 if isinstance(f, dataclasses.Field) and "setting" in f.metadata}  # fmt: skip
        lines = []
        for name, one in found.items():
            lines.append(f"    {name} : {cls.__annotations__[name]}")
            units = {UNITS[key.unit][1]: None for key in one.keys}
            unit = ", ".join(filter(None, units))
            lines += [f"        {key.meaning}" + f" [{unit}]" * bool(unit) for key in one.keys]
        if lines and cls.__doc__:  # none with `python -OO`
            cls.__doc__ += "\n\n    Attributes\n    ----------\n" + "\n".join(lines) + "\n"

    def check(self):
        """Raise an error for the first value that breaks its rule."""
        for field in dataclasses.fields(self):
            value, one = getattr(self, field.name), field.metadata.get("setting")
            if one is not None and not (value is None and "None" in field.type):
                one.check(field.name, value)
