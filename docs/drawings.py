"""The maps of the architecture page: `python docs/drawings.py` writes them to docs/_static.

Rooms, passes and inputs are drawn from the code; `tests/site` fails when a map is older.
"""

from __future__ import annotations

import ast
import re
from html import escape
from pathlib import Path

from rainsim.render.frame import INPUTS, PASSES

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs/_static"
WIDTH = 760
STYLE = """<style>
text { font-family: sans-serif; font-size: 13px; fill: #243240 }
.t { font-size: 15px; font-weight: bold } .s { font-size: 12px; fill: #4a5866 }
.p { fill: #f7f9fb; stroke: #b4c1ce }
.a { fill: #e8edf3; stroke: #8497aa } .b { fill: #cfe3f6; stroke: #2865b0 }
.c { fill: #dcecd9; stroke: #2e7d46 } .d { fill: #f6e3cf; stroke: #8a5a1f }
.g { stroke: #d4dce4; fill: none } .n { stroke-linecap: round; fill: none }
.l { stroke: #51606f; stroke-width: 1.6; fill: none }
.w { stroke: #b3261e; stroke-width: 11; fill: none } .r { stroke: #2865b0; stroke-width: 10 }
.o { stroke: #2865b0; stroke-width: 9 } .i { stroke: #f7f9fb; stroke-width: 6.5 }
.l.e { marker-end: url(#e) }
</style>
<defs><marker id="e" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="6" markerHeight="6"
 orient="auto"><path d="M0 0L10 5L0 10z" fill="#51606f"/></marker></defs>"""


def drawing(title, height, parts):
    """Return an SVG of a height [px] on a light ground, readable on light and dark pages."""
    return "\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" '
        f'viewBox="0 0 {WIDTH} {height}" role="img">',
        f"<title>{escape(title)}</title>", STYLE,
        f'<rect class="p" x="1" y="1" width="{WIDTH - 2}" height="{height - 2}" rx="6"/>',
        *parts, "</svg>", "",
    ])  # fmt: skip


def text(x, y, words, kind="", more=""):
    """Return a line of text."""
    kind = f' class="{kind}"' if kind else ""
    return f'<text{kind} x="{x}" y="{y}"{more}>{escape(words)}</text>'


def box(x, y, width, height, kind):
    """Return a filled box."""
    return f'<rect class="{kind}" x="{x}" y="{y}" width="{width}" height="{height}" rx="4"/>'


def upright(x, y, words):
    """Return a text that runs upwards from a place."""
    return f'<text transform="translate({x} {y}) rotate(-90)">{escape(words)}</text>'


def path(kind, steps):
    """Return one path of steps, texts of its data, so that many marks take few bytes."""
    return f'<path class="{kind}" d="{"".join(steps)}"/>'


def dots(places, hollow=False):
    """Return round marks at places (x, y)."""
    steps = [f"M{x} {y}h0" for x, y in places]
    return [path("n o", steps), path("n i", steps)] if hollow else [path("n r", steps)]


def squares(places):
    """Return square marks at places (x, y)."""
    return [path("w", [f"M{x - 5.5:g} {y}h11" for x, y in places])]


# ---- rooms


def order():
    """Return the rooms that each line of the order of imports has, from the test of the order."""
    tree = ast.parse((ROOT / "tests/house/test_layers.py").read_text(encoding="utf-8"))
    named = {node.targets[0].id: node.value for node in tree.body
             if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)}  # fmt: skip
    found = re.search(r'ORDER = """(.*?)"""', ast.unparse(tree).replace("\\n", "\n"), re.S)
    lines = found[1] if found else ast.literal_eval(named["ORDER"].func.value.func.value)
    return [line.split() for line in lines.strip().splitlines()]


def short(words):
    """Return words that fit into a line of `rooms`: whole parts between commas."""
    words = words.replace("`", "")
    while len(words) > 104:
        words = words.rpartition(",")[0]
    return words


def rooms():
    """Draw the order of imports with what each room makes."""
    page = (ROOT / "docs/developers/architecture.md").read_text(encoding="utf-8")
    makes = dict(re.findall(r"^\| `rainsim/(\w+)/` \| ([^|]+) \|", page, re.M))
    lines, step = order(), 20
    parts = [text(14, 24, "Rooms and files of the root, in the order of imports", "t"),
             text(14, 44, "Each imports from its own block and from those above it. Blue: rooms, "
                  "with what they make.", "s")]  # fmt: skip
    y = 56
    for names in lines:
        rows = [(name, makes[name]) for name in names if name in makes]
        bare = ", ".join(name for name in names if name not in makes)
        rows += [(bare, "")] if bare else []
        parts.append(box(26, y, 720, len(rows) * step - 3, "b" if names[-1] in makes else "a"))
        for k, (name, made) in enumerate(rows):
            parts.append(text(34, y + 13 + k * step, name))
            if made:
                parts.append(text(140, y + 13 + k * step, short(made), "s"))
        y += len(rows) * step
    parts.append(path("l e", [f"M14 {y - 8}V60"]))
    return drawing("Rooms: who imports from whom, what each makes", y + 10, parts)


# ---- passes and inputs


def passes():
    """Draw which buffers each pass reads and writes."""
    names = [name for each in PASSES for name in each.writes]
    x0, y0, wide, step = 180, 176, 25, 22
    parts = [text(14, 24, "Passes of a frame and their buffers", "t"),
             *squares([(336, 20)]), text(348, 24, "writes"), *dots([(410, 20)]),
             text(420, 24, "reads")]  # fmt: skip
    grid, written, read = [], [], []
    for k, name in enumerate(names):
        x = x0 + k * wide
        parts.append(upright(x + 4, y0 - 14, name))
        grid.append(f"M{x} {y0 - 8}v{step * len(PASSES)}")
    for j, each in enumerate(PASSES):
        y = y0 + j * step
        parts.append(box(10, y - 9, 154, 19, "a"))
        parts.append(text(16, y + 5, each.name))
        grid.append(f"M166 {y}h{WIDTH - 176}")
        written += [(x0 + names.index(name) * wide, y) for name in each.writes]
        read += [(x0 + names.index(name) * wide, y) for name in each.reads if name in names]
    parts += [path("g", grid), *squares(written), *dots(read)]
    return drawing("Passes of a frame: what each reads and writes",
                   y0 + step * len(PASSES), parts)  # fmt: skip


def inputs():
    """Draw which passes run again when an input changes."""
    x0, y0, wide, step = 150, 172, 30, 20
    parts = [text(14, 24, "What makes a pass run again", "t"),
             *dots([(290, 20)]), text(300, 24, "reads the input"), *dots([(428, 20)], True),
             text(438, 24, "reads what was made of it")]  # fmt: skip
    grid, direct, indirect = [], [], []
    for k, each in enumerate(PASSES):
        x = x0 + k * wide
        parts.append(box(x - 9, 60, 19, 102, "a"))
        parts.append(upright(x + 5, 158, each.name.replace("light on wet", "light on")))
        grid.append(f"M{x} {y0 - 10}v{step * len(INPUTS)}")
    for j, name in enumerate(INPUTS):
        y = y0 + 6 + j * step
        parts.append(text(14, y + 4, name))
        grid.append(f"M110 {y}h{WIDTH - 120}")
        stale = {name}
        for k, each in enumerate(PASSES):
            if stale.isdisjoint(each.reads):
                continue
            stale.update(each.writes)
            (direct if name in each.reads else indirect).append((x0 + k * wide, y))
    parts += [path("g", grid), *dots(direct), *dots(indirect, True)]
    return drawing("Inputs of a frame: which passes run again when one changes",
                   y0 + step * len(INPUTS) + 10, parts)  # fmt: skip


# ---- by hand: what no table of the code holds


def flow(title, height, boxes, arrows):
    """Draw boxes (x, y, width, kind, lines of text) and arrows (paths)."""
    parts = [text(14, 26, title, "t")]
    for x, y, width, kind, *lines in boxes:
        parts.append(box(x, y, width, 12 + 17 * len(lines), kind))
        for k, line in enumerate(lines):
            parts.append(text(x + 8, y + 17 + 17 * k, line, "s" if k else ""))
    parts += [path("l e", [way]) for way in arrows]
    return drawing(title, height, parts)


def drops():
    """Draw the life of a drop and of its water."""
    return flow("The life of a drop, and the ledger of its water", 434, (
        (14, 44, 224, "a", "size_distribution.py", "how many drops of which size a",
         "cubic metre of a rain holds"),
        (268, 44, 224, "a", "drops.py", "which a cube of air holds, by random",
         "words: none is stored"),
        (522, 44, 224, "d", "streaks.py, fog.py", "their picture in the air"),
        (14, 138, 224, "b", "supply: initial, rain, inflow", "what came onto the map"),
        (268, 138, 224, "a", "impacts.py", "where they land, and on what"),
        (522, 138, 224, "d", "splash_pass.py", "their picture as they land"),
        (14, 214, 224, "c", "obstacles", "on_objects.py: what objects hold"),
        (268, 214, 224, "c", "film", "sources.py: storage of the cells"),
        (522, 214, 224, "a", "ripples.py", "rings on standing water"),
        (14, 290, 224, "c", "airborne", "dripping.py: falls again from edges"),
        (268, 290, 224, "c", "ground", "grid.py: flows, stands in puddles"),
        (522, 290, 224, "d", "water_pass.py", "the picture of the water"),
        (14, 366, 224, "b", "ledger.py", "blue supplies what the green hold"),
        (268, 366, 478, "c", "infiltrated, drained, outflow",
         "gone into the ground, through drains, over open edges"),
    ), (
        "M238 74H266", "M492 66H520", "M380 107V136", "M492 160H520",
        "M126 184V212", "M200 184L290 212", "M492 170L560 212", "M126 260V288", "M238 306L286 262",
        "M380 260V288", "M380 336V364", "M492 312H520", "M634 260V288",
    ))  # fmt: skip


def kernels():
    """Draw how a compiled kernel comes to the command that calls it."""
    return flow("How a compiled kernel comes to the command that calls it", 404, (
        (14, 44, 224, "a", "cpu_kernel, inlined_function", "jit.py: the compiler's options"),
        (268, 44, 224, "a", "source_key.py", "key: byte code, constants and all", "that it calls"),
        (522, 44, 224, "b", "checked_files.py", "machine code on disk, with a digest"),
        (14, 140, 224, "c", "record.py", "runs each use once, and lists its", "kernels"),
        (268, 140, 224, "c", "kernels.json", "kernel, types, seconds, uses"),
        (522, 140, 224, "c", "start.py", "the use that is most like the run"),
        (14, 242, 224, "d", "a command", "goes on meanwhile; calls a kernel"),
        (268, 242, 224, "d", "kernel_cache.py", "on disk: read; in work: waited",
         "for; else compiled here"),
        (522, 242, 224, "d", "pool.py, worker.py", "a process for each core compiles:",
         "terrain first, then the longest"),
        (268, 346, 224, "a", "machine code in memory", "called as a function"),
    ), (
        "M238 64H266", "M492 64H520", "M238 160H266", "M492 160H520", "M634 181V240",
        "M238 262H266", "M522 262H494", "M380 305V344", "M706 242C752 200 752 130 716 94",
        "M540 92L480 240",
    ))  # fmt: skip


DRAWINGS = {"rooms": rooms, "passes": passes, "inputs": inputs,
            "drops": drops, "kernels": kernels}  # fmt: skip

if __name__ == "__main__":
    for name, draw in DRAWINGS.items():
        (FOLDER / f"{name}.svg").write_text(draw(), encoding="utf-8")
