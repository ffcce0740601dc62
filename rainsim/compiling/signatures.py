"""The types of a kernel's arguments as text, and back: how the recorded list names them.

Arrays are written as numba writes them, `float32[:, ::1]`; a trailing `const` is an array that must
not be written, `unaligned` one whose items may lie anywhere. Tuples stand in parentheses, a bundle
is its class and its fields: `rainsim.drops:Box(float32, float32[::1])`. A number that is known when
a kernel calls another is `literal(3)`.
"""

import ast
import importlib

from numba import types

_DIMENSIONS = {"A": lambda n: [":"] * n, "C": lambda n: [":"] * (n - 1) + ["::1"],
               "F": lambda n: ["::1"] + [":"] * (n - 1)}  # fmt: skip


class UnknownType(ValueError):
    """A type that has no text, or a text that names no type (any more)."""


def to_text(kind):
    """Return a numba type as text."""
    if isinstance(kind, types.Array):
        shape = ", ".join(_DIMENSIONS[kind.layout](kind.ndim))
        marks = ("" if kind.mutable else " const") + ("" if kind.aligned else " unaligned")
        return f"{to_text(kind.dtype)}[{shape}]{marks}"
    if isinstance(kind, types.Literal):
        return f"literal({kind.literal_value!r})"
    if isinstance(kind, types.BaseNamedTuple):
        bundle = kind.instance_class
        return f"{bundle.__module__}:{bundle.__qualname__}({_listed(kind.types)})"
    if isinstance(kind, types.BaseTuple):
        return f"({_listed(kind.types)})"
    if isinstance(kind, types.Number | types.Boolean | types.NoneType):
        return str(kind)
    raise UnknownType(f"{kind} ({type(kind).__name__}) has no text; add it to {__name__}")


def _listed(kinds):
    return ", ".join(to_text(kind) for kind in kinds)


def from_text(text):
    """Return the numba type that a text names, or raise UnknownType."""
    text = text.strip()
    if text.endswith((" const", " unaligned")):
        array, _, mark = text.rpartition(" ")
        kind = from_text(array)
        change = {"readonly": True} if mark == "const" else {"aligned": False}
        return kind.copy(**change)
    if text.endswith("]"):
        item, _, shape = text.rpartition("[")
        parts = [part.strip() for part in shape[:-1].split(",")]
        layout = next((k for k, write in _DIMENSIONS.items() if write(len(parts)) == parts), None)
        if len(parts) == 1:
            layout = "C" if parts == ["::1"] else "A"
        if layout is None:
            raise UnknownType(f"{text} is no array")
        return types.Array(from_text(item), len(parts), layout)
    if text.endswith(")"):
        name, _, inner = text.partition("(")
        if name == "literal":
            return types.literal(ast.literal_eval(inner[:-1]))
        kinds = tuple(from_text(part) for part in split(inner[:-1]))
        return _bundle(name, kinds) if name else types.Tuple(kinds)
    kind = getattr(types, {"bool": "boolean"}.get(text, text), None)
    if not isinstance(kind, types.Type):
        raise UnknownType(f"{text} is no type")
    return kind


def split(text):
    """Split a list of texts at the commas that stand in no bracket."""
    parts, depth, begin = [], 0, 0
    for i, character in enumerate(text):
        depth += (character in "([") - (character in ")]")
        if character == "," and depth == 0:
            parts.append(text[begin:i])
            begin = i + 1
    parts.append(text[begin:])
    return [part.strip() for part in parts if part.strip()]


def _bundle(name, kinds):
    """Return the type of a named tuple of a class of ours whose fields have these types."""
    module, _, qualname = name.partition(":")
    try:
        bundle = importlib.import_module(module)
        for part in qualname.split("."):
            bundle = getattr(bundle, part)
        fields = len(bundle._fields)
    except (ImportError, AttributeError, ValueError) as error:
        raise UnknownType(f"{name} does not exist ({error})") from None
    if fields != len(kinds):
        raise UnknownType(f"{name} has {fields} fields, not {len(kinds)}")
    if kinds and all(kind == kinds[0] for kind in kinds):
        return types.NamedUniTuple(kinds[0], len(kinds), bundle)
    return types.NamedTuple(kinds, bundle)
