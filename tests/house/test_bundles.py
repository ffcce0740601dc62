"""Bundles are read-only: numba drops writes through them in parallel loops without a word.

Outputs of compiled functions are flat arrays, arguments of their own that end in `_out`.
"""

import ast
from functools import cache

from source import MODULES, arguments_of, functions, functions_in, is_compiled, name_of, tree


@cache  # made by the test that asks, not by all processes that collect tests
def outputs():
    """Return where the arguments that end in `_out` stand, by a function's name."""
    return {
        function.name: [k for k, n in enumerate(arguments_of(function)) if n.endswith("_out")]
        for path in MODULES
        for _, function in functions_in(path)
        if is_compiled(function)
    }


def through_a_field(node):
    """Tell whether an expression such as `view.depth[j, i]` passes through a field."""
    while isinstance(node, ast.Subscript | ast.Attribute | ast.Starred):
        if isinstance(node, ast.Attribute):
            return True
        node = node.value
    return False


def root_name(node):
    """Return the name that an expression such as `depth[j, i]` begins with, or None."""
    while isinstance(node, ast.Subscript | ast.Starred):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None


def targets_of(statement):
    """Return what a statement assigns to, tuples taken apart."""
    if isinstance(statement, ast.Assign):
        found = list(statement.targets)
    elif isinstance(statement, ast.AugAssign | ast.AnnAssign | ast.For | ast.NamedExpr):
        found = [statement.target]
    else:
        return []
    flat = []
    while found:
        target = found.pop()
        if isinstance(target, ast.Tuple | ast.List):
            found.extend(target.elts)
        else:
            flat.append(target)
    return flat


def fields_in_names(function):
    """Return the names that stand for a bundle's field: `h = water.h`, or `h, q = water`."""
    arguments, found = set(arguments_of(function)), set()
    for node in ast.walk(function):
        if not isinstance(node, ast.Assign):
            continue
        whole = isinstance(node.value, ast.Name) and node.value.id in arguments
        for target in node.targets:
            if isinstance(target, ast.Name) and isinstance(node.value, ast.Attribute):
                found.add(target.id)
            elif isinstance(target, ast.Tuple) and whole:
                found |= {t.id for t in target.elts if isinstance(t, ast.Name)}
            elif isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = zip(target.elts, node.value.elts, strict=False)
                found |= {t.id for t, v in pairs
                          if isinstance(t, ast.Name) and isinstance(v, ast.Attribute)}  # fmt: skip
    return found


def writes_through_bundles(function):
    """Yield the line and the text of each write that passes through a bundle."""
    fields = fields_in_names(function)

    def passes(node):
        return through_a_field(node) or root_name(node) in fields

    for node in ast.walk(function):
        for target in targets_of(node):
            if isinstance(target, ast.Subscript | ast.Attribute) and passes(target):
                yield target.lineno, ast.unparse(target)
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        places = outputs().get(called.rpartition(".")[2], ())
        places = [0] if ".atomic." in f".{called}" else places
        for k in places:
            if k < len(node.args) and passes(node.args[k]) and "local" not in called:
                yield node.lineno, ast.unparse(node)


def test_compiled_functions_do_not_write_through_bundles():
    faults = []
    for path in MODULES:
        for name, function in functions_in(path):
            place = f"{name_of(path)} {name}"
            if is_compiled(function):
                found = writes_through_bundles(function)
                faults += [f"{place}, line {line}: {what}" for line, what in found]
    assert not faults, "write to an argument that ends in _out:\n" + "\n".join(faults)


SAMPLE = '''
@cpu_kernel
def bad(water, view, flat_out):
    for j in prange(4):
        water.h[j] = 1
        water.h[j] += 1
        water.count = 2
        view.rows[j].depth[0] = 3
    h = water.h
    h[0] = 1
    p, q = view
    q[1] += 1
    a, b = view.a, 3
    a[0] = 1
    cuda.atomic.add(view.sums, 0, 1)


@cpu_kernel
def good(water, flat_out, sums_out):
    total = 0
    for j in prange(4):
        flat_out[j] = water.h[j]
        total += water.h[j]
    pair = water.h[0], 2
    here = np.empty(3)
    here[0] = water.h[1]
    cuda.atomic.add(sums_out, 0, water.h[2])
'''  # fmt: skip


def test_the_walk_finds_writes():
    bad, good = (function for _, function in functions(ast.parse(SAMPLE)))
    assert is_compiled(bad)
    assert len(list(writes_through_bundles(bad))) == 8
    assert not list(writes_through_bundles(good))


def test_most_kernels_are_seen():
    kernels = [f for path in MODULES for _, f in functions_in(path) if is_compiled(f)]
    assert len(kernels) > 200


def test_no_bundle_has_a_field_named_index():
    """On a GPU numba takes `tops.index` for the method of tuples; its simulator does not."""
    sample = ast.parse("class Tops(NamedTuple):\n    index: int\n    form: float\n")
    assert list(fields_named_index(sample)) == ["Tops"]
    found = [
        f"{name_of(path)}: {name}" for path in MODULES for name in fields_named_index(tree(path))
    ]
    assert not found, found


def fields_named_index(tree):
    """Yield the name of each named tuple that has a field `index`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and "NamedTuple" in map(ast.unparse, node.bases):
            fields = [ast.unparse(f.target) for f in node.body if isinstance(f, ast.AnnAssign)]
            if "index" in fields:
                yield node.name
