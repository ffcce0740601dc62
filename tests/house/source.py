"""The files of rainsim and its benchmarks as syntax trees, for the tests of this folder."""

from __future__ import annotations

import ast
import functools
import io
import tokenize
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
PACKAGE = ROOT / "rainsim"
MODULES = sorted([*PACKAGE.rglob("*.py"), *ROOT.glob("benchmarks/*.py")])
TEXTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])

# What marks a function that numba compiles, on either backend.
KERNELS = {
    "cpu_kernel", "serial_kernel", "cuda_kernel", "fast_kernel", "tight_kernel", "cuda.jit",
}  # fmt: skip
FORMULAS = {
    "device_function", "lean_function", "inlined_function", "called_function", "cuda_device",
    "fast_device",
}  # fmt: skip


def name_of(path):
    """Return a file's path below the package; of a file beside it, below the checkout."""
    return path.relative_to(PACKAGE if path.is_relative_to(PACKAGE) else ROOT).as_posix()


@functools.cache
def text(path):
    """Return what a file holds."""
    return path.read_text(encoding="utf-8")


@functools.cache
def tree(path):
    """Return a file's syntax tree."""
    return ast.parse(text(path))


@functools.cache
def nodes(path):
    """Return all nodes of a file's syntax tree."""
    return tuple(ast.walk(tree(path)))


@functools.cache
def functions_in(path):
    """Return (qualified name, node) of each function in a file, methods and inner ones too."""
    return list(functions(tree(path)))


def functions(root, prefix=""):
    """Yield (qualified name, node) of each function below a syntax tree's node."""
    for node in ast.iter_child_nodes(root):
        if isinstance(node, ast.expr):
            continue
        named = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        inner = f"{prefix}.{node.name}".strip(".") if named else prefix
        if named and not isinstance(node, ast.ClassDef):
            yield inner, node
        yield from functions(node, inner)


def arguments_of(function):
    """Return the names of a function's arguments."""
    of = function.args
    named = [*of.posonlyargs, *of.args, *of.kwonlyargs, of.vararg, of.kwarg]
    return [argument.arg for argument in named if argument is not None]


def length_of(function):
    """Return a function's lines, from its `def` to its end."""
    return function.end_lineno - function.lineno + 1


def is_compiled(function):
    """Tell whether a decorator of the function compiles it for either backend."""
    marks = set()
    for decorator in function.decorator_list:
        called = decorator.func if isinstance(decorator, ast.Call) else decorator
        marks.add(ast.unparse(called).removeprefix("jit."))
    return bool(marks & (KERNELS | FORMULAS))


@functools.cache
def prose(path):
    """Return (line number, text) of comments and docstrings; of a Markdown file, of its lines.

    Code between fences of Markdown and between backticks is left to the reader of the lines.
    """
    if path.suffix == ".md":
        return list(enumerate(text(path).splitlines(), 1))
    found = []
    for token in tokenize.generate_tokens(io.StringIO(text(path)).readline):
        if token.type == tokenize.COMMENT:
            found.append((token.start[0], token.string))
    holders = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in nodes(path):
        if isinstance(node, holders) and ast.get_docstring(node):
            first = node.body[0]
            found += enumerate(first.value.value.splitlines(), first.lineno)
    return found
