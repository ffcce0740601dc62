"""Physically right, good-looking rain in captured 3D Gaussian Splatting scenes."""

import re
from pathlib import Path

__version__ = "1.0.0"

_NAME = r"^# ([A-Z].+)$|^from (\S+) import (\w+) as \3$"  # a subject, or a name and its module


def _by_subject():
    """Return the public names of each subject with their modules, as the stub declares them."""
    found, stub = {}, Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    for subject, module, name in re.findall(_NAME, stub, re.MULTILINE):
        if subject:
            names = found[subject] = {}
        else:
            names[name] = module
    return found


_MODULES = _by_subject()
_PUBLIC = {name: where for names in _MODULES.values() for name, where in names.items()}
__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name):
    # Public names load on first use, so that `rainsim --help` never imports numba.
    if name in _PUBLIC:
        from importlib import import_module

        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'rainsim' has no attribute {name!r}")


def __dir__():
    return sorted(__all__)
