"""A hash of all that the machine code of a kernel was compiled from.

A kernel's machine code depends on its own byte code, on that of each function it calls, on the
constants that these read, and so on. Comments, other functions of the same files and files that
are imported for another purpose do not matter: editing them recompiles nothing.
"""

import enum
import functools
import hashlib
import inspect
import sys
import types

import numpy as np

_OURS = "rainsim"
# What comes with a version of its own, which the salt holds.
_VERSIONED = {"numba", "numpy", "llvmlite", *sys.stdlib_module_names}


def source_key(function, salt=""):
    """Return 16 hexadecimal digits that change whenever the machine code of `function` may.

    function : function. The Python function of a kernel. Everything it uses must
        have been defined: the key is computed when the kernel is first called,
        not when it is decorated.
    salt : str. What else the machine code depends on: versions and compiler
        options.
    """
    digest = hashlib.sha256(salt.encode())
    found, todo = set(), [function]
    texts = []
    while todo:
        one = todo.pop()
        if one not in found:
            found.add(one)
            text, used = _described(one)
            texts.append(text)
            todo += used
    for text in sorted(texts):
        digest.update(text.encode())
    return digest.hexdigest()[:16]


@functools.cache
def _described(function):
    """Return all that a function itself holds, as text, and the functions that it uses."""
    used = []
    names, parts = set(), []
    _read_code(function.__code__, names, parts, function.__doc__)
    values = dict(inspect.getclosurevars(function).nonlocals) if function.__closure__ else {}
    modules = []
    for name in sorted(names):
        if name in function.__globals__:
            value = function.__globals__[name]
            if inspect.ismodule(value) and _is_ours(value.__name__):
                modules.append(value)
            values[name] = value
    for module in modules:  # any name may be an attribute of any of them
        for name in names & vars(module).keys():
            values[f"{module.__name__}.{name}"] = vars(module)[name]
    for name in sorted(values):
        parts.append(f"{name}={_value(values[name], used)}")
    parts.append(f"defaults={[_value(v, used) for v in function.__defaults__ or ()]}")
    parts.append(f"options={getattr(function, 'compiler_options', '')}")
    return f"{function.__module__}:{function.__qualname__}\n" + "\n".join(parts), tuple(used)


def _read_code(code, names, parts, documentation=None):
    """Append the content of a code object and of those inside it; collect the names they look up.

    A text among the constants that is the documentation is left out.
    """
    names.update(code.co_names)
    constants = []
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            _read_code(constant, names, parts)
        elif isinstance(constant, frozenset):
            constants.append(repr(sorted(constant, key=repr)))
        else:
            constants.append(repr(constant))
    if documentation is not None and code.co_consts[:1] == (documentation,):
        constants[0] = "documentation"
    parts.append(
        f"{code.co_name} {code.co_code.hex()} {code.co_exceptiontable.hex()} {constants} "
        f"{code.co_names} {code.co_varnames} {code.co_freevars} {code.co_argcount}"
    )


def _value(value, used):
    """Return a global's value as text; functions of ours are appended to `used` instead."""
    value = getattr(value, "py_func", value)  # a kernel
    value = getattr(value, "_defn", value)  # an intrinsic
    if inspect.isfunction(value):
        if value.__module__.partition(".")[0] not in _VERSIONED:
            used.append(value)
        return f"{value.__module__}:{value.__qualname__}"
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, tuple):
        return f"{type(value).__qualname__}({', '.join(_value(v, used) for v in value)})"
    if isinstance(value, type):
        return _of_class(value)
    if inspect.ismodule(value):
        return value.__name__
    return f"{type(value).__qualname__} {value!r}"  # numbers, strings, dtypes, built-in functions


def _of_class(value):
    """Return a class as text: a bundle's fields with their types, an enumeration's members."""
    text = f"{value.__module__}:{value.__qualname__}"
    if issubclass(value, enum.Enum):
        return f"{text} {[(member.name, member.value) for member in value]}"
    if issubclass(value, tuple):
        return f"{text} {getattr(value, '_fields', ())}"
    return text


def _is_ours(module):
    return module is not None and module.partition(".")[0] == _OURS
