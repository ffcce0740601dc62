"""What the pages of the site hold: fenced blocks, commands, links, anchors."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.rglob("*.md"), ROOT / "README.md"])
FENCE = re.compile(r"^```(\S*) *\n(.*?)^```", re.M | re.S)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
BENCHMARKS = ["python", "-m", "benchmarks"]  # words of its commands, from a checkout


class Block(NamedTuple):
    """A fenced block of a page: its language ("" for commands and formulas) and its text."""

    language: str
    text: str


class Command(NamedTuple):
    """A command of rainsim or its benchmarks: its words; the file for what it prints, or None."""

    words: list
    into: str | None


def name_of(path):
    """Return a page's path below the root."""
    return path.relative_to(ROOT).as_posix()


def blocks(path):
    """Return the fenced blocks of a page in their order."""
    return [Block(*match) for match in FENCE.findall(path.read_text(encoding="utf-8"))]


def commands(block):
    """Return the commands of rainsim and its benchmarks in a block without a language."""
    if block.language:
        return []
    found = []
    for line in block.text.replace("\\\n", " ").splitlines():
        for part in re.split(r"\s&&\s", line.split("  #")[0]):
            words = shlex.split(part, comments=True) if "'" not in part else part.split()
            while words and re.fullmatch(r"[A-Z_]+=\S*", words[0]):
                words = words[1:]
            if words[:3] == BENCHMARKS:
                words = words[2:]
            if words and words[0] in ("rainsim", "benchmarks"):
                into = words[words.index(">") + 1] if ">" in words else None
                found.append(Command(words[: words.index(">")] if into else words, into))
    return found


def anchors(path):
    """Return the anchors of a page's headings, as git hosts make them."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    heads = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def links(path):
    """Return the targets of a page's links."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    return LINK.findall(text)


def sentences(path):
    """Return the sentences of a page, without code, formulas, links' targets and tables' bars."""
    text = path.read_text(encoding="utf-8")
    text = re.sub(r"^```.*?^```|!\[[^\]]*\]|^ {4}\S.*?$|\$\$.*?\$\$", "", text, flags=re.M | re.S)
    text = re.sub(r"`[^`]*`|\$[^$]*\$", "x", re.sub(r"\]\([^)\s]+\)", "]", text))
    parts = re.split(r"\n\s*\n|\n\s*(?:[-|#>]|\d+\.) |\|", text)
    found = [one for part in parts for one in re.split(r"[.!?][)*\"]*(?:\s|$)", part)]
    return [" ".join(one.split()) for one in found if one.strip()]
