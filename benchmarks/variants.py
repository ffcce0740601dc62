"""Copies of the rasterizer with other constants, each compiled by itself.

The kernels' accuracy depends on constants that are fixed when they are compiled, so that no frame
pays for the bench's choices. Here the modules are executed again under another name, and the
constants are replaced before numba compiles them.
"""

from __future__ import annotations

import hashlib
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import rainsim.jit
from rainsim.splatting import blend, lanes, prepared, project, tiles

_PACKAGE = import_module("rainsim.raster")
_MODULES = (project, lanes, blend, _PACKAGE)  # each imports only from those before it


def variant(**changes):
    """Return a copy of `rainsim.raster` with other values for the named constants or functions.

    Names are those of the modules `project`, `lanes` and `blend`; another one raises KeyError.
    Without changes the module is `rainsim.raster` itself.
    """
    if not changes:
        return _PACKAGE
    unknown = [name for name in changes if not any(hasattr(m, name) for m in _MODULES)]
    if unknown:
        raise KeyError(f"the rasterizer has no {', '.join(unknown)}")
    digest, replaced, copies = _digest(changes), dict(changes), {}
    done = sys.modules.get(_name(_PACKAGE, digest))
    if done:
        return done
    for original in _MODULES:
        own = {name: value for name, value in replaced.items() if hasattr(original, name)}
        own |= {
            name: copies[value]
            for name, value in vars(original).items()
            if isinstance(value, ModuleType) and value in copies
        }
        if not own:
            continue  # this module is shared by all variants
        path = Path(original.__file__)
        copy = copies[original] = ModuleType(_name(original, digest))
        copy.__file__ = original.__file__
        sys.modules[copy.__name__] = copy  # numba looks up the module of a cached kernel here
        exec(compile(path.read_text(encoding="utf-8"), path, "exec"), vars(copy))
        # Functions of the copy replace the original ones in the modules that follow.
        for name, value in vars(copy).items():
            copied = callable(value) and getattr(value, "__module__", None) == copy.__name__
            if copied and name not in own:
                replaced[name] = value
        vars(copy).update(own)
    return copy


def _name(module, digest):
    return f"{module.__name__.replace('.', '_')}_{digest}"


def _digest(changes):
    """Return a hash of the changes and of the source of all modules concerned, for the name."""
    functions = [value for value in changes.values() if callable(value)]
    plain = {name: getattr(value, "__qualname__", value) for name, value in changes.items()}
    digest = hashlib.sha256(repr(sorted(plain.items())).encode())
    files = [module.__file__ for module in (*_MODULES, prepared, tiles, rainsim.jit)]
    for file in files + [function.__code__.co_filename for function in functions]:
        digest.update(Path(file).read_bytes())
    return digest.hexdigest()[:12]
