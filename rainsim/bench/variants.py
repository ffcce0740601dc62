"""The rasterizer with other constants, each baked into machine code of its own.

The product's kernels hold their accuracy in constants that are fixed when they are compiled, so
that no chart costs a frame anything. Here the modules are run once more under another name, and the
constants are replaced before anything is compiled.
"""

from __future__ import annotations

import hashlib
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import rainsim.jit
from rainsim.raster import blend, lanes, prepared, project, tiles

_PACKAGE = import_module("rainsim.raster")
_MODULES = (project, lanes, blend, _PACKAGE)  # each imports only from those before it


def variant(**changes):
    """Return a copy of `rainsim.raster` in which the named constants or functions are others.

    Parameters
    ----------
    **changes
        Names as the modules `project`, `lanes` and `blend` have them, and their new values.

    Returns
    -------
    module
        With `Rasterizer` and all else that `rainsim.raster` has; that itself without changes.

    Raises
    ------
    KeyError
        If none of the modules has one of the names.
    """
    if not changes:
        return _PACKAGE
    unknown = [name for name in changes if not any(hasattr(m, name) for m in _MODULES)]
    if unknown:
        raise KeyError(f"the rasterizer has no {', '.join(unknown)}")
    digest, replaced = _digest(changes), dict(changes)
    done = sys.modules.get(_name(_PACKAGE, digest))
    if done:
        return done
    for original in _MODULES:
        own = {name: value for name, value in replaced.items() if hasattr(original, name)}
        if not own:
            continue  # and so is compiled once for all
        path = Path(original.__file__)
        copy = ModuleType(_name(original, digest))
        copy.__file__ = original.__file__
        sys.modules[copy.__name__] = copy  # where numba looks for the home of cached machine code
        exec(compile(path.read_text(encoding="utf-8"), path, "exec"), vars(copy))
        # What was defined anew takes the place of the original in the modules that follow.
        for name, value in vars(copy).items():
            anew = callable(value) and getattr(value, "__module__", None) == copy.__name__
            if anew and name not in own:
                replaced[name] = value
        vars(copy).update(own)
    return copy


def _name(module, digest):
    return f"{module.__name__.replace('.', '_')}_{digest}"


def _digest(changes):
    """Return a name for the changes that an edit of any module concerned changes as well."""
    functions = [value for value in changes.values() if callable(value)]
    plain = {name: getattr(value, "__qualname__", value) for name, value in changes.items()}
    digest = hashlib.sha256(repr(sorted(plain.items())).encode())
    files = [module.__file__ for module in (*_MODULES, prepared, tiles, rainsim.jit)]
    for file in files + [function.__code__.co_filename for function in functions]:
        digest.update(Path(file).read_bytes())
    return digest.hexdigest()[:12]
