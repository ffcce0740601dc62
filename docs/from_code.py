"""Tables of the site that come from the code: commands, keys, layers, files, names of the API.

A page has a comment such as `<!-- code: keys -->`; when the site is built, the comment is replaced
by the Markdown that the function of this name in `PARTS` returns.
"""

from __future__ import annotations

import ast
import functools
import inspect
import re
from pathlib import Path

import click

import rainsim
from rainsim.cli import INTERRUPTED, cli
from rainsim.config import preset_files
from rainsim.config.tables import table as key_table

ROOT = Path(__file__).resolve().parent.parent
PLACE = re.compile(r"<!-- code: ([\w /.-]+) -->")
SOURCE = "[the source](../rainsim)", '<a href="_modules/index.html">the source</a>'
OUTSIDE = {"../CONTRIBUTING.md": "contributing.md", "../CHANGELOG.md": "changelog.md",
           "../SECURITY.md": "security.md", "../README.md": "index.md"}  # fmt: skip
# The environment variables that rainsim reads; a test compares with the code. Those that begin with
# NUMBA, XDG or CUDA belong to other programs, and mean what they mean there.
VARIABLES = {
    "RAINSIM_SCENES": "folders with scenes that are known by name, separated as in PATH",
    "RAINSIM_CACHE": "folder of kept results (built-in scenes, ground frames, height maps), or off "
    "to keep nothing; default: rainsim/results in the user's cache folder",
    "RAINSIM_COMPILE_PROCESSES": "number of processes that compile kernels; 1 compiles in the "
    "command itself; default: one for each core and 700 MB of free memory",
    "RAINSIM_KERNELS": "off leaves the package rainsim-kernels unused: all kernels are compiled "
    "here, for the processor of this machine",
    "RAINSIM_CUDA_CAPABILITY": "compute capability, such as 9.0, that a process compiles for "
    "without a GPU; rainsim sets it for those that compile",
    "NUMBA_CACHE_DIR": "folder of compiled kernels; default: the user's cache folder",
    "NUMBA_NUM_THREADS": "most threads; --threads takes some of them",
    "NUMBA_CPU_NAME": "processor that kernels are compiled for; x86-64-v3, with "
    "NUMBA_CPU_FEATURES empty, gives the same bytes on processors of several kinds",
    "NUMBA_CPU_FEATURES": "instructions beyond those of NUMBA_CPU_NAME, as LLVM names them; empty: "
    "none; default: those of this processor",
    "NUMBA_DISABLE_JIT": "1 runs the formulas as plain Python, for tests of them",
    "NUMBA_ENABLE_CUDASIM": "1 runs the GPU's kernels in numba's simulator, for tests of them",
    "CUDA_VISIBLE_DEVICES": "GPUs that --backend cuda may use; --workers deals them out in turn",
    "XDG_CACHE_HOME": "the user's cache folder; default: ~/.cache",
    "XDG_DATA_HOME": "the user's data folder, in whose rainsim/scenes scenes are found by name",
}


def table(head, rows):
    """Return a Markdown table; bars in cells are escaped."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        "| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def commands(group=cli, prefix="rainsim"):
    """Yield (name, click command) of each command, those of groups too."""
    for name in group.list_commands(None):
        command = group.commands[name]
        if isinstance(command, click.Group):
            yield from commands(command, f"{prefix} {name}")
        else:
            yield f"{prefix} {name}", command


def option_row(option):
    """Return name, default and meaning of an option."""
    names = ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))
    metavar = option.make_metavar(click.Context(click.Command("x"))) if not option.is_flag else ""
    default = option.show_default if isinstance(option.show_default, str) else option.default
    if option.is_flag or default is None or callable(default) or "Sentinel" in repr(default):
        default = ""
    meaning = re.sub(r"(?<![\w`-])--[a-z][a-z-]*", r"`\g<0>`", option.help)  # kept on one line
    return f"{names} {metavar}".strip(), default, meaning


def command_pages():
    """Return a section for each command: its help and its options."""
    parts = []
    for name, command in commands():
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        usage = " ".join([name, *(a.make_metavar(click.Context(command)) for a in arguments)])
        text, _, example = inspect.cleandoc(command.help).partition("\b\nExample:")
        lines = [f"## {name}\n", f"`{usage} [OPTIONS]`\n", escaped(text)]
        if example:
            lines.append("```\n" + dedented(example) + "\n```\n")
        options = [option_row(p) for p in command.params if p.param_type_name == "option"]
        if options:
            lines.append(table(("option", "default", "meaning"), options) + "\n")
        parts.append("\n".join(lines))
    return "\n".join(parts)


def escaped(text):
    """Return a help text as Markdown: paragraphs, with what Markdown would take for its own."""
    text = text.replace("\b\n", "")
    return re.sub(r"([*_<>\[\]])", r"\\\1", text.strip()) + "\n"


def dedented(text):
    """Return lines without their common indent."""
    lines = [line for line in text.splitlines() if line.strip()]
    return "\n".join(line.strip() for line in lines)


def keys():
    """Return the table of the keys of preset files."""
    rows = []
    for key, unit, default, choices, changing, meaning in key_table():
        shown = "" if default is None else f"`{str(default).lower()}`"
        meaning = f"{meaning} ({', '.join(f'`{c}`' for c in choices)})" if choices else meaning
        rows.append((f"`{key}`", unit, shown, "yes" if changing else "", meaning))
    return table(("key", "unit", "default", "in keyframes", "meaning"), rows)


def presets():
    """Return the built-in presets as they stand in their files."""
    parts = [
        f"### {name}\n\n```toml\n{preset_files.preset_text(name).strip()}\n```\n"
        for name in preset_files.preset_names()
    ]
    return "\n".join(parts)


def variables():
    """Return the table of environment variables."""
    return table(("variable", "meaning"), [(f"`{n}`", m) for n, m in VARIABLES.items()])


def exit_codes():
    """Return the table of exit codes, from what `rainsim.cli` says of itself."""
    import rainsim.cli

    listed = re.search(r"Exit codes: (.*)\.", rainsim.cli.__doc__)[1]
    rows = [part.strip().split(" ", 1) for part in listed.split(",")]
    assert str(INTERRUPTED) in dict(rows)
    return table(("code", "meaning"), rows)


def classes():
    """Return the table of the classes of ground."""
    import tomllib

    text = (ROOT / "rainsim/config/classes.toml").read_text(encoding="utf-8")
    found = tomllib.loads(text)
    columns = list(next(iter(found.values())))
    return table(("class", *columns), [(n, *(c.get(k, "") for k in columns))
                                       for n, c in found.items()])  # fmt: skip


def formats():
    """Return the table of rainsim's own files, with the version that is written and read."""
    from rainsim.actors import actor_files
    from rainsim.commands import film
    from rainsim.datasets import card
    from rainsim.io import images, states
    from rainsim.output_folder.names import VERSION
    from rainsim.render import frame_files
    from rainsim.scene import folder, ground, painted
    from rainsim.sensors import drive
    from rainsim.terrain import map_files

    rows = [
        ("scene.json, splats.npz", folder.VERSION, "`import`", "cameras, ground frame; splats"),
        ("actors.npz", actor_files.VERSION, "`import`", "actors that move through a scene"),
        ("classes.npz", painted.VERSION, "`view`", "classes painted on the ground of a scene"),
        (
            "terrain.npz",
            map_files.VERSION,
            "`heightmap`",
            "ground, what stands on it, classes, noise",
        ),
        ("states/NNNNN.npz", states.VERSION, "`simulate`", "water at a frame's time"),
        ("simulation.json", film.VERSION, "`simulate`", "settings and input of the states"),
        ("layers/NAME/NNNNN.npz", images.VERSION, "`run`, `render`", "a float layer"),
        ("FILE.npz", images.VERSION, "`splat`", "colour, alpha, depth, normals of a dry picture"),
        (
            "layers/NNNNN.json",
            frame_files.VERSION,
            "`run`, `render`",
            "a frame's light, units, weather, names of classes, boxes",
        ),
        (
            "ground_frame.json",
            ground.VERSION,
            "`import`, `heightmap`, `view`",
            "up, scale and origin of a capture",
        ),
        (
            "card.json, pictures.jsonl",
            card.VERSION,
            "`export`",
            "what a data set holds, and which pictures are finished",
        ),
        ("lidar.json", drive.CARD_VERSION, "`lidar`", "sensor, rains, counts of points"),
        (
            "provenance.json, finished.jsonl",
            VERSION,
            "all that write to a folder",
            "the record of a run, and which frames or states are finished",
        ),
    ]
    return table(("file", "version", "written by", "holds"), rows)


DATA = {  # public names that are neither functions nor classes, with their meaning
    "AOVS": "The layers, a dict: for each name its kind, unit, meaning and the names of its "
    "channels. :doc:`/layers` shows it as a table.",
}


def names():
    """Return the reference of all public names of the package."""
    parts = []
    for subject, members in rainsim._MODULES.items():
        parts.append(f"## {subject}\n")
        for name in members:
            value = getattr(rainsim, name)
            kind = "autoclass" if isinstance(value, type) else "autofunction"
            if isinstance(value, type) and issubclass(value, BaseException):
                kind = "autoexception"
            inside = "   :members:\n" if kind == "autoclass" else ""
            if name in DATA:
                kind, inside = "py:data", f"\n   {DATA[name]}\n"
            parts.append(
                f"### rainsim.{name}\n\n```{{eval-rst}}\n.. {kind}:: rainsim.{name}\n{inside}```\n"
            )
    return "\n".join(parts)


def documented(nodes):
    """Return how many of these syntax nodes have a docstring, and how many there are."""
    nodes = list(nodes)
    return sum(bool(ast.get_docstring(node)) for node in nodes), len(nodes)


@functools.cache
def modules():
    """Return the syntax trees of the package's modules."""
    paths = sorted((ROOT / "rainsim").rglob("*.py"))
    return [ast.parse(path.read_text(encoding="utf-8")) for path in paths]


def public_nodes(kinds):
    """Yield the syntax nodes of all public functions, methods or classes of the package."""
    for module in modules():
        classes = [node for node in module.body if isinstance(node, ast.ClassDef)]
        for place in [module, *(one for one in classes if not one.name.startswith("_"))]:
            for node in place.body:
                if isinstance(node, kinds) and not node.name.startswith("_"):
                    yield node


def counts():
    """Return how many of each kind of thing are documented, of all that exist."""
    from rainsim.render.aov import AOVS

    every = [command for _, command in commands()]
    options = [p for command in every for p in command.params if p.param_type_name == "option"]
    shown = [name for name in rainsim.__all__ if name != "__version__"]
    listed = re.findall(r"^### rainsim\.(\w+)", names(), re.M)
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    pairs = {
        "commands": (sum(bool(command.help) for command in every), len(every)),
        "options": (sum(bool(option.help) for option in options), len(options)),
        "keys of preset files": (sum(bool(row[-1]) for row in key_table()), len(key_table())),
        "presets": (presets().count("\n### ") + 1, len(preset_files.preset_names())),
        "layers": (sum(bool(aov.what) for aov in AOVS.values()), len(AOVS)),
        "environment variables": (sum(map(bool, VARIABLES.values())), len(VARIABLES)),
        "public names of the library": (len(set(listed) & set(shown)), len(shown)),
        "functions and methods without a leading underscore": documented(public_nodes(functions)),
        "classes without a leading underscore": documented(public_nodes(ast.ClassDef)),
    }
    return table(("what", "documented", "exist"), [(k, *pair) for k, pair in pairs.items()])


CONTENTS = {
    "Begin": "start capture recipes gallery limits compared",
    "Roads": "roads/film roads/perception roads/hydraulics",
    "How it works": "concepts ground water rain light conventions measurements",
    "Subjects": "view layers actors worlds big datasets sensors cuda many_machines",
    "Reference": "reference/commands reference/settings reference/files reference/python "
    "reference/counts",
    "Project": "changelog contributing security developers/architecture developers/splatting "
    "developers/lanes developers/gpu developers/validate developers/release",
}


def contents():
    """Return the order of the pages, as Sphinx takes it."""
    parts = []
    for caption, pages in CONTENTS.items():
        listed = "\n".join(pages.split())
        parts.append(f"```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{listed}\n```\n")
    return "\n".join(parts)


PARTS = {
    "contents": contents,
    "commands": command_pages, "keys": keys, "presets": presets,
    "variables": variables, "exit codes": exit_codes, "classes": classes, "formats": formats,
    "names": names, "counts": counts,
}  # fmt: skip


def filled(text):
    """Return a page with its comments replaced; `include NAME` is a file of the checkout."""

    def part(match):
        if match[1].startswith("include "):
            return included((ROOT / match[1].removeprefix("include ")).read_text("utf-8"))
        return PARTS[match[1]]()

    for outside, inside in OUTSIDE.items():
        text = text.replace(f"]({outside})", f"]({inside})")
    return PLACE.sub(part, text.replace(*SOURCE))


def included(text):
    """Return a file of the root as a page of the site: without its title, links from docs/."""
    text = (
        re.sub(r"\A# .*\n", "", text)
        .replace("](docs/", "](")
        .replace("](CHANGELOG.md)", "](changelog.md)")
    )
    text = text.replace("](CONTRIBUTING.md)", "](contributing.md)")
    return re.sub(r"\]\((examples/[^)]*|LICENSE)\)", r"](../\1)", text)


def fill(app, name, source):
    """Fill a page in when Sphinx has read it."""
    source[0] = filled(source[0])
