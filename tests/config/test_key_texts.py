"""Every key of a preset file has its meaning, unit and default in the table of the reference."""

import json

import pytest

from rainsim.config.key_texts import MEANINGS, default_of, table, unit_of
from rainsim.config.preset_files import HUMAN_KEYS, PARTS
from rainsim.config.settings import CHOICES, Config
from rainsim.errors import ParameterError


def test_every_key_is_explained_once_and_in_the_order_of_the_parser():
    assert list(MEANINGS) == list(HUMAN_KEYS)
    assert [row[0] for row in table()] == list(HUMAN_KEYS)


def test_units_are_those_that_are_parsed():
    factors = {
        "mm/h": 1e-3 / 3600,
        "mm": 1e-3,
        "ms": 1e-3,
        "h": 3600.0,
        "degrees": 0.0174532925,
        "GB": 1e9,
    }
    for key, (_, factor) in HUMAN_KEYS.items():
        if factor is not None:
            assert factor == pytest.approx(factors.get(unit_of(key), 1.0)), key


@pytest.mark.parametrize("key", [key for key in HUMAN_KEYS if default_of(key) is not None])
def test_a_default_written_down_changes_nothing(key):
    attribute = HUMAN_KEYS[key][0]
    keys = [name for name, _ in PARTS.get(attribute, ((key, None),))]
    lines = [f"{name} = {json.dumps(default_of(name))}" for name in keys]
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


@pytest.mark.parametrize("attribute", CHOICES)
def test_choices_are_those_that_are_taken(attribute):
    for choice in CHOICES[attribute]:
        Config().replace(**{attribute: choice}).check()
    with pytest.raises(ParameterError, match=CHOICES[attribute][0]):
        Config().replace(**{attribute: "no-such-choice"}).check()
