"""Sizes: arguments and lines of functions, lines of rooms."""

import json
import re

import pytest
from counts import lines_of

from source import MODULES, PACKAGE, ROOT, arguments_of, functions_in, length_of, name_of, text

MOST_ARGUMENTS = 20
LONGEST = 80  # lines; a reason for more stands as `# long: reason` beside or above the def
REASON = re.compile(r"# long: \w.{9,}")


def has_reason(path, function):
    """Tell whether a reason for the length stands above the decorators or beside the def."""
    lines = text(path).splitlines()
    first = min([function.lineno, *(d.lineno for d in function.decorator_list)])
    end = function.body[0].lineno - 1
    return any(REASON.search(line) for line in lines[max(first - 2, 0) : end])


def test_functions_take_few_arguments():
    faults = [
        f"{name_of(path)} {name} takes {count} arguments: join some in a bundle"
        for path in MODULES for name, function in functions_in(path)
        if (count := len(arguments_of(function))) > MOST_ARGUMENTS
    ]  # fmt: skip
    assert not faults, "\n".join(faults)


def test_functions_are_short_or_say_why_not():
    faults = [
        f"{name_of(path)} {name} has {length} lines: split it, or say why not (# long: why)"
        for path in MODULES for name, function in functions_in(path)
        if (length := length_of(function)) > LONGEST and not has_reason(path, function)
    ]  # fmt: skip
    assert not faults, "\n".join(faults)


def test_the_walk_sees_methods_and_functions_within():
    found = {name for path in MODULES for name, _ in functions_in(path)}
    assert "Config.replace" in found  # a method
    assert any("." in name and name.split(".")[0].islower() for name in found)
    assert len(found) > 1000


ROOMS = json.loads((ROOT / "tests/house/room_lines.json").read_text(encoding="utf-8"))
SLACK = 60  # lines that a budget may stand above its room


def lines_of_rooms():
    """Return the lines of each folder of the package, and of the files beside them as "."."""
    rooms = {p.name: lines_of(p) for p in PACKAGE.iterdir() if any(p.rglob("*.py"))}
    files = PACKAGE.glob("*.py")
    return {**rooms, ".": sum(len(p.read_text(encoding="utf-8").splitlines()) for p in files)}


@pytest.mark.parametrize("room", sorted(ROOMS))
def test_a_room_keeps_its_budget_of_lines_and_the_budget_falls_with_the_room(room):
    lines, budget = lines_of_rooms().get(room, 0), ROOMS[room]
    entry = f"its {budget} in tests/house/room_lines.json"
    assert lines <= budget, f"{room}: {lines} lines; delete some, or raise {entry} and say for what"
    assert lines >= budget - SLACK, f"{room}: {lines} lines; lower {entry}"


def test_each_room_has_a_budget():
    assert set(lines_of_rooms()) == set(ROOMS), "each room has a line in room_lines.json"
