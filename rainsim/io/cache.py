"""Results on disk for the next run: generated scenes, ground frames, height maps.

An entry's name is a SHA-256 of what the result depends on: the version of rainsim and KEPT_FORMAT,
the content of the input files, the settings, the versions of the libraries and the processor. Who
edits the code sets RAINSIM_CACHE to "off". The entries that were not used for the longest time are
deleted when room is needed. An entry that is damaged and a folder that cannot be written count as
no entry: the result is computed again.

RAINSIM_CACHE names the folder, or is "off". The default is rainsim/results in the user's cache
folder (XDG_CACHE_HOME, or .cache in the home folder).
"""

import dataclasses
import hashlib
import json
import os
import shutil
import weakref
from contextlib import suppress
from pathlib import Path

import numpy as np

from rainsim import __version__
from rainsim.io.files import replacing
from rainsim.io.fingerprint import hash_of_array, versions

KEPT_FORMAT = 5  # to be raised by who changes what is kept, or how a kept result is computed

VARIABLE, OFF = "RAINSIM_CACHE", "off"
MOST_BYTES = 2_000_000_000  # of all entries; a map of 2048 x 2048 cells takes 143 MB
MOST_OF_THE_DISK = 0.1  # of what is free on the disk or held by entries
SUFFIX = ".kept"
FACTS = "facts"  # name of the array of text beside those of an entry
LIBRARIES = ("numpy", "scipy", "scikit-image", "numba", "llvmlite")


def folder():
    """Return the Path of the folder for results; None if RAINSIM_CACHE is "off", or no home."""
    given = os.environ.get(VARIABLE)
    if given == OFF:
        return None
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    try:
        return Path(given or f"{base}/rainsim/results").expanduser()
    except RuntimeError:  # an account without a home keeps nothing
        return None


# --- names ----------------------------------------------------------------------------------------


def name_of(*inputs):
    """Return the name of the entry for a result from `inputs`, 64 hexadecimal digits.

    `inputs` are all that the result depends on besides the code: None, bool, int, float, str,
    bytes, Path, ndarray, dataclass, and tuples, lists and dicts of these. Another type raises
    TypeError: leaving it out would let two results share a name.
    """
    from rainsim.jit import processor

    digest = hashlib.sha256()
    _add(digest, (__version__, KEPT_FORMAT, versions(LIBRARIES), processor(), inputs))
    return digest.hexdigest()


def _add(digest, value):
    """Feed a value with its type to a hash, so that no two values feed the same."""
    if isinstance(value, np.ndarray):
        reference, known = _known.get(id(value), (None, None))
        is_known = known and reference() is value
        digest.update(f"ndarray {known if is_known else hash_of_array(value)};".encode())
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
        _add(digest, (type(value).__qualname__, fields))
    elif isinstance(value, dict):
        _add(digest, ("dict", sorted(value.items())))
    elif isinstance(value, tuple | list):
        digest.update(b"(")
        for item in value:
            _add(digest, item)
        digest.update(b")")
    elif value is None or isinstance(value, bool | int | float | str | bytes | Path | np.generic):
        digest.update(f"{type(value).__name__} {value!r};".encode())
    else:
        raise TypeError(f"an input of a kept result is a {type(value).__name__}; it has no hash")


_known = {}  # by the id of an array: a weak reference to it and the hash that stands for its bytes


def know_hash(array, *content):
    """Take the hash of the source of an array's bytes in place of a hash of the bytes.

    A capture of four million splats is a gigabyte, which is hashed once, as a file. The array is
    never written to again; `content` (see `name_of`) determines it.
    """
    key, digest = id(array), hashlib.sha256()
    _add(digest, content)
    gone = weakref.ref(array, lambda _: _known.pop(key, None))
    _known[key] = gone, digest.hexdigest()


# --- entries --------------------------------------------------------------------------------------


def kept(kind, compute, *inputs):
    """Return the facts and arrays of an entry, or compute them and keep them for the next run.

    `kind` is what the entry holds, such as "terrain", and part of the file's name. `compute`
    returns facts and arrays, as `write` takes them, that depend on nothing but the code and the
    inputs, which are as for `name_of`.
    """
    name = name_of(kind, *inputs) if folder() else None
    found = name and read(kind, name)
    if not found:
        found = compute()
        if name:
            write(kind, name, *found)
    return found


def kept_arrays(kind, compute, *inputs):
    """Return the arrays of an entry without facts, see `kept`; `compute` returns them alone."""
    return kept(kind, lambda: ({}, compute()), *inputs)[1]


def read(kind, name):
    """Return the facts and arrays of an entry, or None if there is no whole one.

    `kind` is as for `kept`; `name` comes of `name_of`. Facts are as `write` took them, lists in
    place of tuples; arrays are writable and equal to the byte.
    """
    at = folder()
    if at is None:
        return None
    path = at / f"{kind}-{name}{SUFFIX}"
    try:
        # A byte that changed is found by the file's checksums.
        with open(path, "rb") as file, np.load(file) as entry:
            arrays = {key: entry[key] for key in entry.files}
        facts, names = json.loads(arrays.pop(FACTS).item())
        if list(arrays) != names:  # the file's table of contents has no checksum
            raise ValueError("damaged")
    except FileNotFoundError:
        return None
    except Exception:  # of any kind: the file is damaged
        with suppress(OSError):
            path.unlink()
        return None
    with suppress(OSError):
        os.utime(path)  # used now: others are deleted before it
    return facts, arrays


def write(kind, name, facts, arrays):
    """Keep a result (JSON facts, arrays of numbers); do nothing if off or not writable."""
    at = folder()
    if at is None:
        return
    arrays = {key: np.ascontiguousarray(array) for key, array in arrays.items()}
    try:
        at.mkdir(parents=True, exist_ok=True)
        if _make_room(at, sum(array.nbytes for array in arrays.values())):
            with replacing(at / f"{kind}-{name}{SUFFIX}") as path, open(path, "wb") as file:
                np.savez(file, **{FACTS: json.dumps([facts, list(arrays)])}, **arrays)
    except OSError:
        pass


def _make_room(at, needed):
    """Delete the entries unused for longest until `needed` bytes fit; return whether they do."""
    entries = sorted(_entries(at))
    held = sum(size for _, size, _ in entries)
    room = min(MOST_BYTES, MOST_OF_THE_DISK * (shutil.disk_usage(at).free + held)) - needed
    for _, size, path in entries if room >= 0 else ():
        if held > room:
            path.unlink(missing_ok=True)
            held -= size
    return room >= 0


def _entries(at):
    """Return (time of last use, bytes, path) of a folder's entries, half written ones, too."""
    found = []
    for path in at.glob(f"*{SUFFIX}"):
        with suppress(OSError):  # another process has deleted it
            facts = path.stat()
            found.append((facts.st_mtime, facts.st_size, path))
    return found


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
