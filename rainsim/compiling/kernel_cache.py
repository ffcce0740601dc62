"""The machine code of kernels on disk, keyed by a hash of its sources.

numba keys its own cache on the file that holds a kernel, not on the functions that the kernel
calls: an edited helper would keep its old machine code. Here the name of a kernel's files carries
`source_key`, which takes in all that the kernel uses and what compiles it: versions and our files.
"""

import functools
import hashlib
import os
import platform
import sys
from pathlib import Path

import llvmlite
import numba
import numpy as np
from numba.core import caching, types
from numba.core.runtime import rtsys

from rainsim.compiling import folder, shipped
from rainsim.compiling.checked_files import CheckedFiles, ShippedFiles
from rainsim.compiling.source_key import source_key
from rainsim.compiling.waiting import wait_for

KEPT_VERSIONS = 4  # of a kernel, whose machine code is kept
VERSIONS = (
    f"numba {numba.__version__} llvmlite {llvmlite.__version__} numpy {np.__version__} "
    f"{platform.python_implementation()} {sys.version_info.major}.{sys.version_info.minor}"
)
# Of the files that decide what numba makes of a kernel.
_REWRITERS = [
    hashlib.sha256(Path(__file__).with_name(name).read_bytes()).hexdigest()
    for name in ("callees.py", "parts.py")
]


class KeptKernel:
    """The part of a cache of one kernel that CPU and GPU share; numba's own is the next base.

    Its files lie in a folder and under a name of our own.

    The name is found when the kernel is first called or asked for, because all functions that it
    uses must exist by then.
    """

    _kept = KEPT_VERSIONS

    def __init__(self, function, place, options):
        self._name = repr(function)
        self._py_func = function
        self._folder, self._options = place, options
        self.kernel_name = f"{function.__module__}:{function.__qualname__}"
        self.enable()

    @functools.cached_property
    def key(self):
        """The hash of the sources, versions and options that the machine code is compiled from."""
        return source_key(self._py_func, f"{VERSIONS} {_REWRITERS} {self._options}")

    @functools.cached_property
    def _impl(self):
        return self._implementation(self._py_func, _KeyedLocator(self._folder, self.key))

    @property
    def _cache_path(self):
        return str(self._folder)

    @functools.cached_property
    def _cache_file(self):
        return CheckedFiles(self._cache_path, self._impl.filename_base, self.key)

    @functools.cached_property
    def _shipped(self):
        if shipped.PACK is None:
            return None
        place = os.fspath(shipped.PACK.folder / self._folder.name)
        return ShippedFiles(place, self._impl.filename_base, self.key)

    def load_overload(self, sig, target_context):
        """Return the machine code for a signature, None if there is none on disk.

        numba would first load all that it compiles with, which takes it up to half a second.
        """
        self._prepare_to_load(target_context)
        if self._shipped is not None:
            data = self._shipped.load(self._index_key(sig, target_context.codegen()))
            if data is not None:
                return self._impl.rebuild(target_context, data)
        wait_for(self.kernel_name)  # another process may be at it
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def _prepare_to_load(self, target_context):
        """Make the process ready to link machine code."""

    def save_overload(self, sig, data):
        """Write the machine code for a signature; the oldest versions of this kernel go."""
        try:
            super().save_overload(sig, data)
        except OSError as error:  # the kernel runs all the same; the next run compiles it again
            folder.unsaved = str(error)
            return
        self._forget_old()

    def holds(self, sig, target_context):
        """Return whether the machine code for a signature is on disk; loads none of it."""
        key = self._index_key(sig, target_context.codegen())
        return self.ships(sig, target_context) or self._cache_file.holds(key)

    def ships(self, sig, target_context):
        """Return whether the package rainsim-kernels has the machine code for a signature."""
        key = self._index_key(sig, target_context.codegen())
        return self._shipped is not None and self._shipped.holds(key)

    def _index_key(self, sig, codegen):
        """Return numba's key of a signature, with the fields of bundles: they may change places."""
        key, bundles = super()._index_key(sig, codegen), tuple(_fields(sig))
        return (*key, bundles) if bundles else key

    def _forget_old(self):
        name = self._py_func.__qualname__.replace("<", "").replace(">", "")
        try:
            versions = sorted(
                self._folder.glob(f"*.{name}-*.nbi"), key=lambda file: -file.stat().st_mtime
            )
            for index in versions[self._kept :]:
                for file in self._folder.glob(f"{index.stem}.*"):
                    file.unlink(missing_ok=True)
        except OSError:  # another process tidies up at the same time
            pass


def _fields(kinds):
    """Yield the class and the names of the fields of each bundle among some types."""
    for kind in kinds:
        if isinstance(kind, types.BaseNamedTuple):
            yield f"{kind.instance_class.__qualname__}{kind.fields}"
        if isinstance(kind, types.BaseTuple):
            yield from _fields(kind.types)


class _Implementation(caching.CompileResultCacheImpl):
    """numba's serialisation of machine code, with the files at a place of ours."""

    def __init__(self, function, locator):
        self._locator_classes = [locator]  # what is asked for a locator; this one gives itself
        super().__init__(function)

    def reduce(self, data):
        """Return numba's parts of machine code, less the one text: sources, only to be shown."""
        return tuple("" if isinstance(part, str) else part for part in super().reduce(data))


class _KeyedLocator(caching._CacheLocator):
    """Locator of a kernel's files: in its module's folder, with the key in their names."""

    def __init__(self, folder, key):
        self._folder, self._key = folder, key

    def from_function(self, py_func, py_file):
        self._py_file, self._lineno = py_file, py_func.__code__.co_firstlineno  # for warnings
        return self

    def get_cache_path(self):
        return os.fspath(self._folder)

    def ensure_cache_path(self):
        os.makedirs(self._folder, mode=0o700, exist_ok=True)
        super().ensure_cache_path()

    def get_source_stamp(self):
        return self._key

    def get_disambiguator(self):
        return self._key


class KernelCache(KeptKernel, caching.FunctionCache):
    """The cache of one kernel of the CPU."""

    _implementation = _Implementation

    def _prepare_to_load(self, target_context):
        rtsys.initialize(target_context)  # what kernels allocate memory with
