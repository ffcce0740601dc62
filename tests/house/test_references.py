"""What stands in backticks exists: modules, functions, attributes, arguments, files.

References are looked up in the syntax trees, so that nothing is imported, CUDA's files neither.
"""

import ast
import builtins
import functools
import re
import sys
from collections import defaultdict
from pathlib import Path

import rainsim
from source import MODULES, PACKAGE, ROOT, TEXTS, functions_in, name_of, nodes, prose, text, tree

REFERENCE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
TESTS = sorted([*ROOT.glob("tests/**/*.py"), *ROOT.glob("benchmarks/tests/*.py")])
WORD = re.compile(r"[A-Za-z_]\w*")
NAME = re.compile(r"\.?[A-Za-z_]\w*(\.[A-Za-z_]\w*)*(\([\w, ]*\))?")  # of a thing, or its call
# Ends of file names: the files of others' formats and those that are written need not exist here.
DATA = {"bin", "exr", "hdr", "jpg", "json", "npy", "npz", "ply", "png", "sog", "splat", "spz",
        "tif", "tiff", "toml", "txt", "webp", "webm", "mov", "mp4", "ksplat", "csv", "xml",
        "cfg", "usd", "usda", "usdc", "usdz", "glb", "gltf", "blend"}  # fmt: skip
OURS = "rainsim", "benchmarks"
ELSEWHERE = {"numpy", "np", "numba", "scipy", "click", *sys.stdlib_module_names}
# Words of file formats and of other programs, named in texts only.
WORDS_OF_OTHERS = {"ruff", "pytest", "_out", "benchmarks.NAME"}


def module_of(path):
    """Return a file's name below the package, with dots; the package's own is empty."""
    parts = Path(name_of(path)).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


@functools.cache
def identifiers(path):
    """Return the names that a file's code uses, and the words of its strings but docstrings."""
    found, documentation = set(), set()
    for node in nodes(path):
        for field in ("id", "attr", "arg", "name", "asname", "module"):
            name = getattr(node, field, None)
            if isinstance(name, str):
                found.update(name.split("."))
        body = getattr(node, "body", None)
        if isinstance(body, list) and body and isinstance(body[0], ast.Expr):
            documentation.add(id(body[0].value))
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in documentation:
                found.update(WORD.findall(node.value))
    return found


def bound(node):
    """Yield the names that a statement binds."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield node.name
    elif isinstance(node, ast.Import | ast.ImportFrom):
        yield from (alias.asname or alias.name.partition(".")[0] for alias in node.names)
    elif isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign):
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            yield from (n.id for n in ast.walk(target) if isinstance(n, ast.Name))
    elif isinstance(node, ast.If | ast.Try | ast.With):
        for inner in ast.iter_child_nodes(node):
            yield from bound(inner)


@functools.cache
def symbols():
    """Return the top-level names of each module, and the members of each class by its name."""
    names, members = {}, defaultdict(set)
    for path in MODULES:
        here = names[module_of(path)] = set()
        for node in tree(path).body:
            here.update(bound(node))
        strings = {n.value for n in nodes(path)
                   if isinstance(n, ast.Constant) and isinstance(n.value, str)}  # fmt: skip
        if path.name == "__init__.py":
            here |= strings  # names that are loaded when first used
        for node in nodes(path):
            if isinstance(node, ast.ClassDef):
                inside = members[node.name]
                for statement in node.body:
                    inside.update(bound(statement))
                inside |= {n.attr for n in ast.walk(node) if isinstance(n, ast.Attribute)
                           and isinstance(n.value, ast.Name) and n.value.id == "self"}  # fmt: skip
    names[""] |= set(rainsim.__all__)
    for module in list(names):  # modules are names of their packages
        if module:
            names[module.rpartition(".")[0]].add(module.rpartition(".")[2])
    return names, members


@functools.cache
def everywhere():
    """Return all names that code of ours uses, keys of presets and classes among them."""
    found = set(dir(builtins))
    for path in [*MODULES, *ROOT.glob("examples/*.py"), ROOT / "tests/set_up.py"]:
        found |= identifiers(path)
    for path in [*PACKAGE.rglob("*.toml"), ROOT / "setup.cfg", ROOT / ".ci/run"]:
        found |= set(WORD.findall(text(path)))
    for path in MODULES:
        found |= set(Path(name_of(path)).with_suffix("").parts)
    for path in TESTS:
        found |= {name for name, _ in functions_in(path)}
    return found


def in_a_module(parts, module):
    """Tell whether names, one in another, exist in a module."""
    names, members = symbols()
    if not parts:
        return True
    first, *rest = parts
    deeper = f"{module}.{first}".strip(".")
    if deeper in names and in_a_module(rest, deeper):
        return True
    if deeper in names or first not in names[module]:
        return False
    return not rest or rest[0] in members.get(first, {rest[0]})


def resolves(reference, path):
    """Tell whether what stands in backticks in a file exists."""
    names, members = symbols()
    reference = reference.partition("(")[0].strip()
    parts = reference.strip(".").split(".")
    if reference.startswith(".") or parts[-1] in DATA:
        return True  # an attribute's or a file's ending, a file's name
    if parts[-1] in ("py", "md"):
        return any(file.name == reference for file in [*MODULES, *TEXTS, *TESTS])
    here = identifiers(path) if path.suffix == ".py" else set()
    if parts[0] == "rainsim":
        return in_a_module(parts[1:], "")
    if len(parts) == 1:
        return reference in here or reference in everywhere()
    for module in names:
        if f".{module}".endswith(f".{parts[0]}") and in_a_module(parts[1:], module):
            return True
    if parts[0] in members:
        return parts[1] in members[parts[0]]
    if parts[0] in ELSEWHERE:
        return True
    # An argument or a local name, with an attribute that some class of ours has.
    return parts[0] in here and any(parts[1] in inside for inside in members.values())


def references(path):
    """Yield (line, text) of the references in a file's comments and docstrings, or in a text."""
    fenced = False
    for number, line in prose(path):
        if line.strip().startswith("```"):
            fenced = not fenced
        if not fenced:
            yield from ((number, found) for found in REFERENCE.findall(line))


def faults(path):
    """Yield each reference of a file that resolves to nothing."""
    for number, reference in references(path):
        if not NAME.fullmatch(reference) or reference in WORDS_OF_OTHERS:
            continue  # an expression, an option, a command, a path
        if not resolves(reference, path):
            yield f"{path.relative_to(ROOT).as_posix()}:{number}: `{reference}`"


def test_references_in_code_resolve():
    found = [fault for path in MODULES for fault in faults(path)]
    assert not found, f"{len(found)} references:\n" + "\n".join(found)


def test_references_in_texts_resolve():
    found = [fault for path in TEXTS if path.name != "CHANGELOG.md" for fault in faults(path)]
    assert not found, f"{len(found)} references:\n" + "\n".join(found)


def test_stale_references_are_found():
    path = PACKAGE / "pipeline.py"
    good = """rainsim.raster.Layers pipeline.render_rain Config.replace() state.index scene.json
        render_rain(scene,cameras) pipeline.py numpy.linalg config.settings.Config.frames"""
    assert [name for name in good.split() if not resolves(name, path)] == []
    stale = """rainsim.mirrorlight rainsim.raster.Nothing mirrorlight.mirror_light mirrorlight.py
        pipeline.nothing Config.nothing no_such_name() rainsim.config.settings.Config.nothing"""
    assert [name for name in stale.split() if resolves(name, path)] == []


def test_tests_and_examples_take_names_that_exist():
    """A test that names what has moved would fail only when it runs, and slow ones run rarely."""
    names, _ = symbols()
    found = []
    for path in [*TESTS, *ROOT.glob("examples/*.py")]:
        modules = {}
        for node in nodes(path):
            if not (isinstance(node, ast.ImportFrom) and node.module.startswith(OURS)):
                continue
            parts = node.module.removeprefix("rainsim").strip(".").split(".")
            parts = [part for part in parts if part]
            for alias in node.names:
                if not in_a_module([*parts, alias.name], ""):
                    found.append(f"{path.relative_to(ROOT)}: {node.module}.{alias.name}")
                if ".".join([*parts, alias.name]) in names:
                    modules[alias.asname or alias.name] = [*parts, alias.name]
        for node in nodes(path):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                module = modules.get(node.value.id)
                if module and not node.attr.startswith("__"):
                    if not in_a_module([*module, node.attr], ""):
                        found.append(f"{path.relative_to(ROOT)}: {'.'.join(module)}.{node.attr}")
    assert not found, "\n".join(sorted(set(found)))
