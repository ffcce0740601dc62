"""Results on disk for the next run: generated scenes, ground frames, height maps.

An entry's name is a SHA-256 of all that the result depends on: the content of the inputs, the code
of the stages up to the one that computed the result, the versions of the libraries, the processor.
If any of these changes, so does the name. An entry is therefore never out of date, only unused; the
entries that were not used for the longest time are deleted first. An entry that is damaged and a
folder that cannot be written count as no entry: the result is computed again.

RAINSIM_CACHE names the folder, or is "off". The default is rainsim/results in the user's cache
folder (XDG_CACHE_HOME, or .cache in the home folder).
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import os
import platform
import shutil
import time
import weakref
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

import rainsim.compiling.shipped  # noqa: F401  (it may choose the processor that code is for)
from rainsim.io.files import replacing
from rainsim.io.fingerprint import versions

VARIABLE, OFF = "RAINSIM_CACHE", "off"
MOST_ENTRIES, MOST_OF_A_KIND = 64, 16  # a drive keeps some of each of its windows
MOST_BYTES = 2_000_000_000  # of all entries; a map of 2048 x 2048 cells takes 143 MB
MOST_OF_THE_DISK = 0.1  # of what is free on the disk or held by entries
STALE = 86_400.0  # s after which the temporary file of a run that was killed is deleted
SUFFIX = ".kept"
MAGIC = b"rainsim result 1\n"
ALIGNMENT = 64  # bytes, of each array in the file
BLOCK = 1 << 23  # bytes that are hashed at once; a multiple of every item's size
HASHING_THREADS = 4

# The rooms in the order of their imports: what one computes can depend on no later one. The order
# is a house rule with a test, which also holds this list to it.
STAGES = (
    "errors", "jit", "constants", "ledger", "compiling", "numerics", "config", "io", "scene",
    "actors", "splatting", "raster", "surface", "lod", "demo_scenes", "terrain", "rain", "drops",
    "water", "grid", "shading", "daylight", "ssr", "reflection", "particles", "simulation",
)  # fmt: skip
LIBRARIES = ("numpy", "scipy", "scikit-image", "numba", "llvmlite")
# Variables that choose machine code, and with it the last digits of results.
CODE_VARIABLES = ("NUMBA_", "NPY_", "OPENBLAS_")
# Kept results are the CPU's: variables of the GPU's code, which `rainsim.cuda.jit` sets, do not
# count.
NOT_OF_THE_CODE = (
    "NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_CUDA_",
)  # fmt: skip
PACKAGE = Path(__file__).resolve().parent.parent


def folder():
    """Return the Path of the folder for results; None if RAINSIM_CACHE is "off"."""
    given = os.environ.get(VARIABLE)
    if given == OFF:
        return None
    if given:
        return Path(given).expanduser()
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "rainsim" / "results"


# --- names ----------------------------------------------------------------------------------------


def name_of(stage, *inputs):
    """Return the name of the entry for a stage's result from `inputs`, 64 hexadecimal digits.

    `stage` is the room of the code that computes the result, one of `STAGES`. `inputs` are all that
    the result depends on besides the code: None, bool, int, float, str, bytes, Path, ndarray,
    dataclass, and tuples, lists and dicts of these. Another type raises TypeError: leaving it out
    would let two results share a name.
    """
    digest = hashlib.sha256()
    for part in (_code(stage), _machine(), _variables(), *inputs):
        _add(digest, part)
    return digest.hexdigest()


@functools.cache
def _code(stage):
    """Return the SHA-256 of all files of the rooms up to `stage`."""
    digest = hashlib.sha256()
    for room in STAGES[: STAGES.index(stage) + 1]:
        files = sorted((PACKAGE / room).rglob("*")) or [PACKAGE / f"{room}.py"]
        for file in files:
            if file.suffix in (".py", ".toml"):
                _add(digest, file.relative_to(PACKAGE).as_posix())
                _add(digest, file.read_bytes())
    return digest.hexdigest()


@functools.cache
def _machine():
    """Return versions and the processor, of which the last digits of results depend."""
    from llvmlite import binding

    found = list(versions(LIBRARIES).values())
    features = dict(binding.get_host_cpu_features())
    return [found, platform.platform(), binding.get_host_cpu_name(), features]


def _variables():
    """Return the environment's variables that choose machine code."""
    return {
        name: value
        for name, value in os.environ.items()
        if name.startswith(CODE_VARIABLES) and not name.startswith(NOT_OF_THE_CODE)
    }


def _add(digest, value):
    """Feed a value with its type and length to a hash, so that no two values feed the same."""
    if isinstance(value, np.ndarray):
        _add(digest, ["ndarray", value.dtype.str, list(value.shape)])
        digest.update(_array_hash(value))
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [(f.name, getattr(value, f.name)) for f in dataclasses.fields(value)]
        _add(digest, ["dataclass", type(value).__qualname__, fields])
    elif isinstance(value, dict):
        _add(digest, ["dict", sorted(value.items())])
    elif isinstance(value, tuple | list):
        digest.update(b"(%d:" % len(value))
        for item in value:
            _add(digest, item)
    elif isinstance(value, np.generic):
        _add(digest, [value.dtype.str, value.tobytes()])
    elif isinstance(value, bytes):
        digest.update(b"bytes %d:" % len(value))
        digest.update(value)
    elif value is None or isinstance(value, bool | int | float | str | Path):
        text = repr(value).encode()
        digest.update(b"%s %d:" % (type(value).__name__.encode(), len(text)))
        digest.update(text)
    else:
        raise TypeError(f"an input of a kept result is a {type(value).__name__}; it has no hash")


_known = {}  # by the id of an array: a weak reference to it and its hash


def know_hash(array, *content):
    """Take the hash of the source of an array's bytes in place of a hash of the bytes.

    A capture of four million splats is a gigabyte, which is hashed once, as a file. The array is
    never written to again; `content` (see `name_of`) and the code determine it.
    """
    digest = hashlib.sha256()
    _add(digest, content)
    take_hash(array, digest.digest())


def take_hash(array, digest):
    """Take the hash that `known_hash` returned of a copy of an array, as in another process."""
    key = id(array)
    _known[key] = weakref.ref(array, lambda _: _known.pop(key, None)), digest


def known_hash(array):
    """Return the hash that was taken in place of one of the array's bytes; None without such."""
    reference, known = _known.get(id(array), (None, None))
    return known if known and reference() is array else None


def _array_hash(array):
    """Return the hash that is known of an array, or that of its bytes."""
    return known_hash(array) or _content_hash(array)


def _content_hash(array):
    """Return a hash of an array's bytes: the SHA-256 of those of its blocks, in several threads."""
    flat = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
    blocks = [flat[start : start + BLOCK] for start in range(0, len(flat), BLOCK)]
    if len(blocks) < 2:
        return hashlib.sha256(flat).digest()
    with ThreadPoolExecutor(min(HASHING_THREADS, os.cpu_count() or 1)) as pool:
        parts = pool.map(lambda block: hashlib.sha256(block).digest(), blocks)
        return hashlib.sha256(b"".join(parts)).digest()


# --- entries --------------------------------------------------------------------------------------


def read(kind, name):
    """Return the facts and arrays of an entry, or None if there is no whole one.

    `kind` is what the entry holds, such as "terrain", and part of the file's name; `name` comes of
    `name_of`. Facts are as `write` took them, lists in place of tuples; arrays are writable and
    equal to the byte.
    """
    at = folder()
    if at is None:
        return None
    path = at / f"{kind}-{name}{SUFFIX}"
    try:
        with open(path, "rb") as file:
            found = _read(file)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, MemoryError):
        found = None
    try:
        if found is None:  # damaged
            path.unlink()
        else:
            os.utime(path)  # used now: others are deleted before it
    except OSError:
        pass
    return found


def kept_arrays(kind, stage, compute, *inputs):
    """Return the arrays of an entry, or compute them and keep them for the next run.

    `kind` is as for `read`, `stage` and `inputs` as for `name_of`; `compute` returns a dict of str
    to ndarray that depends on nothing but the code and the inputs.
    """
    name = name_of(stage, *inputs) if folder() else None
    found = name and read(kind, name)
    if found:
        return found[1]
    arrays = compute()
    if name:
        write(kind, name, {}, arrays)
    return arrays


def _read(file):
    """Return facts and arrays of an open entry; raise ValueError if a byte of it is wrong."""
    if file.read(len(MAGIC)) != MAGIC:
        raise ValueError("not an entry")
    length, check = int.from_bytes(file.read(8), "little"), file.read(32)
    if length > os.fstat(file.fileno()).st_size:
        raise ValueError("cut off")
    text = file.read(length)
    if hashlib.sha256(text).digest() != check:
        raise ValueError("damaged")
    header, arrays = json.loads(text), {}
    for entry in header["arrays"]:
        file.seek(_aligned(file.tell()))
        dtype, shape = np.dtype(entry["dtype"]), tuple(entry["shape"])
        array = np.empty(shape, dtype)
        if file.readinto(array.reshape(-1).view(np.uint8).data) != array.nbytes:
            raise ValueError("cut off")
        if _content_hash(array).hex() != entry["sha256"]:
            raise ValueError("damaged")
        arrays[entry["name"]] = array
    return header["facts"], arrays


def write(kind, name, facts, arrays):
    """Keep a result; do nothing if keeping is off or the folder cannot be written.

    Facts are JSON values, arrays hold numbers or bool.
    """
    at = folder()
    if at is None:
        return
    arrays = {key: np.ascontiguousarray(array) for key, array in arrays.items()}
    try:
        at.mkdir(parents=True, exist_ok=True)
        room = _room(at)
        if sum(array.nbytes for array in arrays.values()) > room:
            return
        with replacing(at / f"{kind}-{name}{SUFFIX}") as temporary, open(temporary, "wb") as file:
            _write(file, facts, arrays)
        _delete_old(at, room)
    except OSError:
        pass


def _write(file, facts, arrays):
    header = {
        "facts": facts,
        "arrays": [
            {"name": name, "dtype": array.dtype.str, "shape": array.shape,
             "sha256": _content_hash(array).hex()}
            for name, array in arrays.items()
        ],
    }  # fmt: skip
    text = json.dumps(header).encode()
    file.write(MAGIC + len(text).to_bytes(8, "little") + hashlib.sha256(text).digest() + text)
    for array in arrays.values():
        file.write(bytes(_aligned(file.tell()) - file.tell()))
        file.write(array.reshape(-1).view(np.uint8).data)


def _aligned(offset):
    return -(-offset // ALIGNMENT) * ALIGNMENT


def _room(at):
    """Return how many bytes all entries of a folder may take."""
    held = sum(size for _, size, _ in _entries(at))
    return min(MOST_BYTES, MOST_OF_THE_DISK * (shutil.disk_usage(at).free + held))


def _entries(at):
    """Return (time of last use, bytes, path) of the entries in a folder, the latest first."""
    found = []
    for path in at.glob(f"*{SUFFIX}"):
        try:
            facts = path.stat()
        except OSError:  # another process has deleted it
            continue
        if not path.name.startswith("."):
            found.append((facts.st_mtime, facts.st_size, path))
        elif time.time() - facts.st_mtime > STALE:
            path.unlink(missing_ok=True)
    return sorted(found, reverse=True)


def _delete_old(at, room):
    """Delete the entries that were not used for the longest time until the others fit."""
    total, kinds = 0, Counter()
    for number, (_, size, path) in enumerate(_entries(at)):
        kind = path.name.rpartition("-")[0]
        kinds[kind] += 1
        total += size
        too_many = number >= MOST_ENTRIES or kinds[kind] > MOST_OF_A_KIND
        if too_many or (total > room and number > 0):
            path.unlink(missing_ok=True)


def summary():
    """Return a dict of the folder (None: off), its entries, their size [bytes], and "writable"."""
    at = folder()
    if at is None:
        return {"folder": None, "entries": 0, "size": 0, "writable": False}
    entries = _entries(at) if at.is_dir() else []
    existing = next((p for p in (at, *at.parents) if p.exists()), at)
    return {
        "folder": str(at), "entries": len(entries), "size": sum(size for _, size, _ in entries),
        "writable": existing.is_dir() and os.access(existing, os.W_OK),
    }  # fmt: skip
