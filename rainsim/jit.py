"""Compiler options and the compile cache: the only module that names either.

`device_function` marks a scalar formula that kernels call and that stays plain Python.
`cpu_kernel` is a parallel loop, `serial_kernel` a loop on one thread that may run beside others.
"""

import hashlib
import os
import shutil
import tempfile
from pathlib import Path

# numba keys its cache on the file that holds a kernel, not on the files of the functions that the
# kernel calls: an edited helper would keep its old machine code. So the folder carries a hash of
# all our sources.
_FOLDER = "rainsim-kernels"
_KEPT_CACHES = 4  # versions of the program whose machine code is kept


def _source_hash():
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder():
    """Return a writable folder for compiled kernels, the user's own if it can be."""
    wanted = [os.environ.get("NUMBA_CACHE_DIR")]
    wanted.append(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    for base in map(Path, filter(None, wanted)):
        if base.parent.name == _FOLDER:  # set by a process of ours that started this one
            base = base.parent.parent
        folder = base / _FOLDER / _source_hash()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            folder.touch()  # the newest are kept
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            _drop_old(folder.parent)
            return folder
    return Path(tempfile.mkdtemp(prefix="rainsim-kernels-"))


def _drop_old(parent):
    folders = sorted(parent.iterdir(), key=lambda f: f.stat().st_mtime, reverse=True)
    for folder in folders[_KEPT_CACHES:]:
        shutil.rmtree(folder, ignore_errors=True)


CACHE_FOLDER = _cache_folder()
os.environ["NUMBA_CACHE_DIR"] = str(CACHE_FOLDER)

import numba  # noqa: E402  (the cache folder must be known before numba is imported)
from llvmlite import ir  # noqa: E402
from numba import (  # noqa: E402
    get_num_threads,
    njit,
    prange,
    types,
)
from numba.core import cgutils  # noqa: E402
from numba.extending import intrinsic, register_jitable  # noqa: E402

numba.config.CACHE_DIR = str(CACHE_FOLDER)  # in case numba had been imported before

# Not fastmath=True: that assumes away NaN and infinity, which kernels must see.
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}

device_function = register_jitable
cpu_kernel = njit(parallel=True, nogil=True, error_model="numpy", fastmath=_FAST, cache=True)
serial_kernel = njit(nogil=True, error_model="numpy", fastmath=_FAST, cache=True)

__all__ = [
    "CACHE_FOLDER",
    "cgutils",
    "cpu_kernel",
    "device_function",
    "get_num_threads",
    "intrinsic",
    "ir",
    "prange",
    "serial_kernel",
    "types",
]


def set_threads(count):
    """Use `count` threads in all kernels (None: all cores that numba found at start)."""
    if count is not None:
        numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    return numba.get_num_threads()
