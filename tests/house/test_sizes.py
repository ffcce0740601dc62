"""Sizes of functions: how many arguments they take, and how long they are."""

import re

from source import MODULES, arguments_of, functions_in, length_of, name_of, text

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
        f"{name_of(path)} {name} takes {count} arguments"
        for path in MODULES for name, function in functions_in(path)
        if (count := len(arguments_of(function))) > MOST_ARGUMENTS
    ]  # fmt: skip
    assert not faults, "\n".join(faults)


def test_functions_are_short_or_say_why_not():
    faults = [
        f"{name_of(path)} {name} has {length} lines"
        for path in MODULES for name, function in functions_in(path)
        if (length := length_of(function)) > LONGEST and not has_reason(path, function)
    ]  # fmt: skip
    assert not faults, "\n".join(faults)


def test_the_walk_sees_methods_and_functions_within():
    found = {name for path in MODULES for name, _ in functions_in(path)}
    assert "Config.replace" in found  # a method
    assert any("." in name and name.split(".")[0].islower() for name in found)
    assert len(found) > 1000
