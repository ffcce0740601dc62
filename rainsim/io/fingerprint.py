"""Fingerprints: whether two runs would write the same bytes.

A fingerprint is a hash of what the bytes depend on: the content of scene and settings, and the
versions of rainsim and its libraries. Names of paths, hosts and systems have no part.
"""

import functools
import hashlib
import json
import platform
from importlib import metadata

import numpy as np

from rainsim import __version__
from rainsim.io.files import require_file

LIBRARIES = ("numpy", "scipy", "scikit-image", "numba", "llvmlite", "pillow", "imageio")


def fingerprint(content):
    """Return the fingerprint of a run's inputs (plain JSON) and versions, 64 hexadecimal digits."""
    return hash_of({"content": content, "rainsim": __version__, "versions": versions()})


def hash_of(facts):
    """Return the SHA-256 of plain JSON values."""
    text = json.dumps(facts, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def hash_of_array(array):
    """Return the SHA-256 of an array's type, shape and values."""
    digest = hashlib.sha256(f"{array.dtype.str} {array.shape}".encode())
    digest.update(np.ascontiguousarray(array).reshape(-1))  # `tobytes` would copy it
    return digest.hexdigest()


def hash_of_file(path):
    """Return the SHA-256 of a file's content."""
    with open(require_file(path, "an input"), "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@functools.cache
def versions(names=LIBRARIES):
    """Return the versions of Python and of libraries, None for those that are not there."""
    found = {"python": platform.python_version()}
    for name in names:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found
