"""The package rainsim-kernels: machine code of the recorded kernels that a release compiled.

`benchmarks/pack.py` makes it. It is loaded from the site-packages of this Python alone, if all
versions are those that it was made for and the processor has its instructions. This process then
compiles for the same processor, so that its kernels are of one kind. Nothing here imports numba.
"""

import hashlib
import json
import os
import platform
import site
import sys
from importlib import metadata
from pathlib import Path

DISTRIBUTION, FOLDER, MANIFEST = "rainsim-kernels", "rainsim_kernels", "manifest.json"
VARIABLE, OFF = "RAINSIM_KERNELS", "off"
COMPILERS = ("numba", "llvmlite", "numpy")
CPU_INFO = Path("/proc/cpuinfo")
# The processor that they are made for, as numba takes it: a level of x86-64, and nothing beyond it.
PROCESSOR = {"NUMBA_CPU_NAME": "x86-64-v3", "NUMBA_CPU_FEATURES": ""}
# Its instructions as Linux names them; abm has LZCNT, pni is SSE3.
FLAGS = (
    "abm", "avx", "avx2", "bmi1", "bmi2", "cx16", "f16c", "fma", "lahf_lm", "movbe", "pni",
    "popcnt", "sse4_1", "sse4_2", "ssse3", "xsave",
)  # fmt: skip


def versions():
    """Return the versions here that machine code is tied to, by name."""
    from rainsim import __version__

    minor = ".".join(platform.python_version_tuple()[:2])
    found = {"rainsim": __version__, platform.python_implementation(): minor}
    return found | {name: metadata.version(name) for name in COMPILERS}


class Pack:
    """Shipped kernels, from which a file is read if its hash is that of the manifest.

    identity : str. Hash of the manifest, and by it of all files.
    """

    def __init__(self, folder):
        self.folder = folder
        text = (folder / MANIFEST).read_bytes()
        self.identity = hashlib.sha256(text).hexdigest()
        content = json.loads(text)
        self.versions, self._flags = dict(content["versions"]), list(content["flags"])
        self._files = dict(content["files"])

    def fault(self, info=CPU_INFO):
        """Return why the kernels must not be loaded here, None if they may be."""
        here = versions()
        for name in {**here, **self.versions}:
            if here.get(name) != self.versions.get(name):
                made, has = self.versions.get(name, "none"), here.get(name, "none")
                return f"made for {name} {made}, and {name} here is {has}"
        lacking = sorted(set(self._flags) - _flags(info))
        if lacking:
            level = PROCESSOR["NUMBA_CPU_NAME"]
            return f"made for {level}, and this processor lacks {', '.join(lacking)}"
        for name, value in PROCESSOR.items():
            if os.environ.get(name, value) != value:
                return f"made for {name}={value}, and it is set to {os.environ[name]!r}"
            if "numba" in sys.modules and name not in os.environ:
                return "numba was imported before rainsim: it compiles for this machine by now"
        return None

    def read(self, path):
        """Return the content of a file, None if it is absent or not the one of the manifest."""
        try:
            content = Path(path).read_bytes()
        except OSError:
            return None
        name = Path(path).relative_to(self.folder).as_posix()
        return content if hashlib.sha256(content).hexdigest() == self._files.get(name) else None

    def damaged(self):
        """Return the names of the files that are absent or not those of the manifest."""
        return [name for name in self._files if self.read(self.folder / name) is None]


def find(folders):
    """Return the first `Pack` that may be loaded, or None; and why one that is there is not."""
    if os.environ.get(VARIABLE) == OFF:
        return None, None
    for folder in folders:
        place = Path(folder) / FOLDER
        if place.is_dir():
            try:
                pack = Pack(place)
                fault = pack.fault()
            except (OSError, ValueError, KeyError, TypeError, ImportError) as error:
                return None, f"damaged ({MANIFEST}: {type(error).__name__}: {error})"
            return (None, fault) if fault else (pack, None)
    return None, None


def _flags(info):
    """Return the instructions that /proc/cpuinfo lists for the first core."""
    try:
        with open(info, encoding="utf-8") as lines:
            return set(next((line for line in lines if line.startswith("flags")), "").split())
    except OSError:
        return set()


# Not found along `sys.path`, which begins with the user's own folders.
PACK, FAULT = find(site.getsitepackages())
if PACK is not None:
    os.environ.update(PROCESSOR)
elif FAULT is not None:
    os.environ[VARIABLE] = OFF  # the processes that this one starts compile as it does
