"""Every setting is declared once, and keys, tables and choices say what the declaration says."""

import json

import pytest

from rainsim.config import tables
from rainsim.config.preset_files import preset_text
from rainsim.config.preset_writer import preset_text_of
from rainsim.config.settings import Config, preset_names
from rainsim.errors import ParameterError


def test_units_are_those_that_are_parsed():
    factors = {
        "mm/h": 1e-3 / 3600,
        "mm": 1e-3,
        "ms": 1e-3,
        "h": 3600.0,
        "degrees": 0.0174532925,
        "GB": 1e9,
    }
    for key, unit, *_ in tables.table():
        factor = tables.HUMAN_KEYS[key][1]
        if factor is not None:
            assert factor == pytest.approx(factors.get(unit, 1.0)), key


@pytest.mark.parametrize(
    "key", [key for key in tables.HUMAN_KEYS if tables.default_of(key) is not None]
)
def test_a_default_written_down_changes_nothing(key):
    attribute = tables.HUMAN_KEYS[key][0]
    keys = [name for name, _ in tables.PARTS.get(attribute, ((key, None),))]
    lines = [f"{name} = {json.dumps(tables.default_of(name))}" for name in keys]
    written, plain = Config.from_toml("\n".join(lines)).as_dict(), Config().as_dict()
    for group, values in plain.items():
        if isinstance(values, dict):
            for name, value in values.items():
                near = isinstance(value, float | tuple)  # written with six digits
                assert written[group][name] == (
                    pytest.approx(value, rel=1e-5) if near else value
                ), name
        else:
            assert written[group] == values


@pytest.mark.parametrize("attribute", tables.CHOICES)
def test_choices_are_those_that_are_taken(attribute):
    for choice in tables.CHOICES[attribute]:
        Config().replace(**{attribute: choice}).check()
    with pytest.raises(ParameterError, match=tables.CHOICES[attribute][0]):
        Config().replace(**{attribute: "no-such-choice"}).check()


def test_every_setting_is_reached_or_says_who_needs_it():
    presets = "\n".join(preset_text(name) for name in preset_names() if name != "paper")
    for one in tables.SETTINGS.values():
        reached = (
            one.option or one.dropdown or one.paper is not None
            or any(key.slider or f"\n{key.name} =" in presets for key in one.keys)
        )  # fmt: skip
        assert bool(reached) != bool(one.kept_for) or not one.keys, one.name


def test_the_look_sets_the_choices_of_the_paper_and_each_can_still_be_set_by_itself():
    paper = tables.look_settings("paper")
    assert len(paper) == 10
    assert all(f" {name}" in tables.LOOK.keys[0].meaning for name in paper)
    together = Config.from_toml('look = "paper"')
    assert together == Config().replace(**paper) == Config().replace(look="paper")
    assert together.look == "paper" and Config().look == "physical"
    assert together.replace(look="physical") == Config()
    for name, value in paper.items():
        assert Config().value(name) != value
        alone = Config().replace(**{name: value})
        assert alone.look == "physical" and alone.value(name) == value
        but = f'{name} = {json.dumps(Config().value(name))}\nlook = "paper"\n'
        assert Config.from_toml(but) == together.replace(**{name: Config().value(name)})
        assert Config.from_toml(preset_text_of(alone)) == alone
    assert preset_text_of(together) == 'look = "paper"\n'
    with pytest.raises(ParameterError, match=r"a.toml: look is 3; it must be one of physical, pap"):
        Config.from_toml("look = 3", "a.toml")


def test_attributes_are_described_in_si_units():
    assert "rate : float\n        rain rate, as a gauge" in Config().rain.__doc__
    assert "it [m/s]\n" in Config().rain.__doc__
