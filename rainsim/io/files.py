"""Small helpers of the readers and writers: clear errors on reading, whole files on writing."""

import json
import math
import os
import stat
import tempfile
import threading
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from rainsim.errors import InputError

MAX_LENGTH = 1e12  # capture units; squares and products beyond overflow float32
MOST_NAME = 255  # characters of a camera's or scene's name
_ASKING = threading.Lock()  # two threads at once would leave the mask at 0
MOST_TEXT = 1 << 28  # bytes of a JSON file; one of 100,000 cameras has a quarter


def require_file(path, what, remedy="check the path"):
    """Return `path` as a Path, or raise InputError unless it is a file that can be opened.

    Devices and pipes are refused: they may never end.
    """
    path = Path(path)
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):  # ValueError: a zero byte
        raise InputError(f"{path} does not exist; {what} must be a file; {remedy}") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); {remedy}") from None
    if stat.S_ISDIR(found.st_mode):
        raise InputError(f"{path} is a folder; {what} must be a file; name the file itself")
    if not stat.S_ISREG(found.st_mode):
        raise InputError(
            f"{path} is a pipe or a device; {what} must be a regular file; copy it to one first"
        )
    if not os.access(path, os.R_OK):
        raise InputError(f"{path} cannot be read; {what} must be readable; check its permissions")
    return path


def read_text(path, what, limit=MOST_TEXT):
    """Return the text of a file in UTF-8, without a byte order mark, or raise InputError.

    `what` names it in messages, with its article: "a preset file"; it has at most `limit` bytes.
    """
    path = require_file(path, what)
    size = path.stat().st_size
    if size > limit:
        raise InputError(
            f"{path} has {size} bytes; {what} must have at most {limit}; check the path"
        )
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path} is not text; {what} must be UTF-8; check the path") from None


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
        with naming(path):
            yield temporary
            put_in_place(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def put_in_place(temporary, path):
    """Rename a file that mkstemp has made to `path`, with the permissions of any new file."""
    os.chmod(temporary, 0o666 & ~_umask())  # mkstemp's files are their owner's alone
    os.replace(temporary, path)


@contextmanager
def naming(path):
    """Name `path` in errors of the system that name no file: those of writing."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def _umask():
    with _ASKING:
        mask = os.umask(0)
        os.umask(mask)
    return mask


def named_path(path, folder):
    """Return how a record in `folder` names a path: seen from it unless absolute."""
    path = Path(path)
    if path.is_absolute():
        return str(path)
    return os.path.relpath(path.resolve(), Path(folder).resolve())


def path_named(name, folder):
    """Return the path that a record in `folder` names."""
    seen = Path(folder) / name
    # Older records name paths as seen from where the command was started.
    # `os.path` takes a name that no file can have for one of no file, pathlib raises.
    return seen if os.path.exists(seen) or not os.path.exists(name) else Path(name)


def printable_name(name, most=MOST_NAME):
    """Return a name that was found in a file, cut and without characters that command a terminal.

    `name` is any value of JSON: one that is neither text nor number is no name. `most` characters
    stay.
    """
    text = str(name)[:most] if isinstance(name, str | int | float) else "?"
    return "".join(c if c.isprintable() else "?" for c in text)


def read_json(path, what):
    """Return the data of the JSON file `path`, or raise InputError that names the wrong line."""
    text = read_text(path, what)
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        fault = f"{error.msg}, line {error.lineno}"
    except RecursionError:
        fault = "lists within lists without end"
    except ValueError:  # Python reads no number of more than 4,300 digits
        fault = "a number of thousands of digits"
    raise InputError(
        f"{path} is not valid JSON ({fault}); {what} must be a JSON file; write it again"
    )


def parsed_json(text):
    """Return the data of a JSON text, None if it is none."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


def card_in(path):
    """Return the data of a card, a JSON file that this program wrote; None if there is none."""
    try:
        card = read_json(path, "a card")
    except (OSError, InputError):
        return None
    return card if isinstance(card, dict) and card.get("program") == "rainsim" else None


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
    """Return lists as float64 of `shape`, None if not finite numbers below MAX_LENGTH."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        return None
    if array.shape != shape or not (np.abs(array) < MAX_LENGTH).all():  # false for NaN
        return None
    return array
