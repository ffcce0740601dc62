"""The parts that a changed setting makes out of date, so that nothing else is computed again."""

from __future__ import annotations

from rainsim.config.declare import LIGHT, PASSES, TERRAIN, WATER
from rainsim.config.tables import SETTINGS

PARTS = (TERRAIN, WATER, LIGHT, PASSES)  # in the order in which they are made
NEEDS = {name: one.touches for name, one in SETTINGS.items() if one.touches}
# Settings that are read for each picture: a changed one needs a new picture and nothing else.
PICTURE = frozenset(SETTINGS) - set(NEEDS)
# A part that is made again takes these with it.
WITH = {
    TERRAIN: frozenset(PARTS), WATER: frozenset({WATER}), LIGHT: frozenset({LIGHT, PASSES}),
    PASSES: frozenset({PASSES}),
}  # fmt: skip


def settings():
    """Return the names of all settings, whatever their group."""
    return list(SETTINGS)


def changed(before, after):
    """Return the names of the settings in which two `Config` differ."""
    return [n for n in settings() if before.value(n) != after.value(n)]


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
        wanted = wanted.union(*(WITH[part] for part in NEEDS.get(name, ())))
    return tuple(part for part in PARTS if part in wanted)
