"""Print the house's figures: `python tests/house/counts.py [CHECKOUT]`."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

from source import ROOT, arguments_of, functions, length_of

# In scripts given as strings and for lazily loaded names a module stands as text.
MODULE = re.compile(r"rainsim(\.\w+)+")


def lines_of(folder):
    """Return the lines of all Python files below a folder."""
    return sum(len(p.read_text(encoding="utf-8").splitlines()) for p in folder.rglob("*.py"))


def imports_of(tree):
    """Return the modules of ours that a file imports anywhere, as names with `rainsim.`."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= {node.value} if MODULE.fullmatch(node.value) else set()
    return found


def circles(graph):
    """Return the sets of files that import one another (strongly connected, two files or more)."""
    order, low, stack, found = {}, {}, [], []

    def visit(name):
        order[name] = low[name] = len(order)
        stack.append(name)
        for other in sorted(graph[name]):
            if other not in order:
                visit(other)
                low[name] = min(low[name], low[other])
            elif other in stack:
                low[name] = min(low[name], order[other])
        if low[name] == order[name]:
            start = stack.index(name)
            component = stack[start:]
            del stack[start:]
            if len(component) > 1:
                found.append(sorted(component))

    for name in sorted(graph):
        if name not in order:
            visit(name)
    return found


def count(root):
    """Return the figures of a checkout by their names."""
    package = root / "rainsim"
    trees = {}
    for path in sorted(package.rglob("*.py")):
        module = ".".join(path.relative_to(root).with_suffix("").parts)
        trees[module.removesuffix(".__init__")] = ast.parse(path.read_text(encoding="utf-8"))
    graph = {}
    for module, tree in trees.items():
        named = imports_of(tree) & set(trees)
        # A package counts as imported where nothing below it is named.
        files = {n for n in named if not any(o.startswith(f"{n}.") for o in named)}
        graph[module] = files - {module}
    every = [(len(arguments_of(node)), length_of(node), f"{module}.{name}")
             for module, tree in trees.items() for name, node in functions(tree)]  # fmt: skip
    return {
        "modules in the root": len(list(package.glob("*.py"))) - (package / "__init__.py").exists(),
        "functions": len(every),
        "functions of 10 arguments or more": sum(n >= 10 for n, _, _ in every),
        "functions of 20 arguments or more": sum(n >= 20 for n, _, _ in every),
        "functions above 20 arguments": sum(n > 20 for n, _, _ in every),
        "most arguments": max((n, name) for n, _, name in every),
        "functions above 80 lines": sum(n > 80 for _, n, _ in every),
        "longest function": max((n, name) for _, n, name in every),
        "import circles (files in each)": [len(c) for c in circles(graph)] or "none",
        "lines of rainsim/": lines_of(package),
        "lines of tests/": lines_of(root / "tests"),
        "lines of benchmarks/": lines_of(root / "benchmarks"),
    }


if __name__ == "__main__":
    for name, figure in count(Path(sys.argv[1]) if sys.argv[1:] else ROOT).items():
        print(f"{name}: {figure}")
