"""Small helpers of the readers and writers: clear errors on reading, whole files on writing."""

from __future__ import annotations

import json
import math
import os
import tempfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from rainsim.errors import InputError

MAX_LENGTH = 1e12  # capture units; squares and products beyond overflow float32


def require_file(path, what):
    """Return `path` as a Path, or raise InputError unless it is a file that can be opened."""
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} is a folder; {what} must be a file; name the file itself")
    if not path.exists():
        raise InputError(f"{path} does not exist; {what} must be a file; check the path")
    if not os.access(path, os.R_OK):
        raise InputError(f"{path} cannot be read; {what} must be readable; check its permissions")
    return path


@contextmanager
def replacing(path):
    """Yield a temporary path beside `path`; rename it to `path` if the block ends without error.

    An existing file stays untouched until the new one is complete, and if the block fails.
    """
    path = Path(path)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o666 & ~_umask())  # mkstemp makes files that only their owner can read
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


def read_json(path, what):
    """Return the data of the JSON file `path`, or raise InputError that names the wrong line."""
    path = require_file(path, what)
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, RecursionError):
        raise InputError(
            f"{path} is not text; {what} must be a JSON file; check the path"
        ) from None
    except json.JSONDecodeError as error:
        raise InputError(
            f"{path} is not valid JSON ({error.msg}, line {error.lineno}); {what} must be a JSON "
            "file; write it again"
        ) from None


def write_json(path, data):
    """Write `data` as an indented JSON file; numbers read back exactly, NaN is refused."""
    text = json.dumps(data, indent=1, allow_nan=False) + "\n"
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def json_number(value):
    """Return a number from JSON as a float, or None if it is not a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        value = float(value)
    except OverflowError:
        return None
    return value if math.isfinite(value) else None


def number_array(value, shape):
    """Return nested lists of numbers as a float64 array of `shape`, None if they are not that.

    Values that are not finite or beyond MAX_LENGTH are not taken for numbers.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    if array.shape != shape or not (np.abs(array) < MAX_LENGTH).all():  # false for NaN
        return None
    return array
