"""Words that make a reader guess: they are not used in comments, docstrings, messages or texts.

A sentence names its subject and its object; `that`, `those` and `it` have their noun in it.
"""

import ast
import re

from source import MODULES, ROOT, TEXTS, functions_in, name_of, nodes, prose

# A pattern, and what to write instead.
BANNED = {
    r"told": "known from, given by, reported",
    r"tell(s|ing)? of\b": "names, describes",
    r"anew": "again",
    r"what is (done|made) (with|of)": "say what the reader does with it",
    r"that which|what wets that|is that that": "name the thing",
    r"who(so)?ever": "the caller, the user: name who",
    r"the rest\b(?! of)": "name what is left",
    r"(?<!that )that of (that|those|it|them)\b": "repeat the noun",
    r"\bof (that|those)(?=[.,;:)]|$)": "repeat the noun",
    r"who holds (an?|the) (array|buffer)s?|counts? who": "reference counting",
    r"place in memory": "an array index",
    r"nor keep one|as has it|it knows not": "plain words",
    r"frames? of (a|the|its) film|film of \d+ frames|(a|the) film's (first |last )?frames?":
        "frame sequence: film is water's depth on a surface",
}  # fmt: skip
PATTERNS = [re.compile(rf"(?<![\w-])(?:{word})", re.I) for word in BANNED]

# Names of functions that say nothing of what they do.
RIDDLES = {"dealt", "give", "laid", "others", "take", "tell", "tell_film", "told"}


def messages(path):
    """Yield (line number, text) of a file's strings with spaces in them, docstrings too."""
    for node in nodes(path):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield from enumerate(node.value.splitlines(), node.lineno)


def lines_of(path):
    """Return the lines to be read in a file, each once, by number and text."""
    found = dict.fromkeys(prose(path))
    if path.suffix == ".py":
        found.update(dict.fromkeys(messages(path)))
    return sorted(found)


def uses(paths):
    """Yield each use of a banned word."""
    for path in paths:
        for number, line in lines_of(path):
            for pattern, better in zip(PATTERNS, BANNED.values(), strict=True):
                for match in pattern.finditer(line):
                    place = f"{path.relative_to(ROOT).as_posix()}:{number}"
                    yield f"{place}: {match[0]!r} (better: {better}): {line.strip()[:80]}"


def test_no_words_that_make_a_reader_guess():
    texts = [path for path in TEXTS if path.name != "CHANGELOG.md"]
    found = list(dict.fromkeys(uses([*MODULES, *texts])))
    assert not found, f"{len(found)} uses:\n" + "\n".join(found)


def test_names_of_functions_are_no_riddles():
    found = [
        f"{name_of(path)} {name}"
        for path in MODULES
        for name, _ in functions_in(path)
        if name.strip("_") in RIDDLES  # a method says whose it is: `Splats.take`
    ]
    assert not found, "\n".join(found)


def test_the_patterns_find_what_they_ban_and_no_more():
    bad = """is told by the cameras|What is done with it|0 for NaN: it is no place in memory
        it then has the variance of that.|Numba counts who holds an array|the others take the rest
        drawn anew|Return what wets that which is no mapped ground|a film of 24 frames"""
    good = """the rest of the test|of those cameras|a water film of 2 mm|of that size, or larger
        the ground that holds water|Tell whether a value is a number|the frame of the camera"""
    for line in bad.split("|"):
        assert any(pattern.search(line) for pattern in PATTERNS), line
    for line in good.split("|"):
        assert not any(pattern.search(line) for pattern in PATTERNS), line
