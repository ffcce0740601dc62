"""The program's own files of arrays (.npz): written with a version, read with every value checked.

A reader declares what each array must be, as a table of `Field`. Nothing of a file is believed:
sizes are compared with the file before memory is taken, shapes with each other, values with their
range. A file that is cut, altered or made up therefore ends in an InputError of one line, never in
an index out of range or in minutes of a kernel.
"""

import errno
import math
import zipfile
from dataclasses import dataclass

import numpy as np

from rainsim.errors import InputError
from rainsim.io.files import MAX_LENGTH, replacing, require_file

VERSION = "version"  # the array that holds the version; files without it are of version 1
HEADER_LIMIT = 4096  # bytes of text that say an array's type and shape
MOST_MEMBERS = 256  # arrays of a file
TEXT = "text"  # in place of a dtype


@dataclass(frozen=True, slots=True)
class Field:
    """The rule for one array of a file: its type, shape and bounds.

    A name in the shape stands for a length that is the same wherever the name stands. What is not
    finite lies in no range.
    """

    kind: str  # the dtype, or `TEXT` for strings of any length
    shape: tuple = ()
    low: float = -MAX_LENGTH
    high: float = MAX_LENGTH  # ends included
    needed: bool = True  # whether a file without it is damaged


def write_arrays(path, version, arrays):
    """Write arrays by name as an uncompressed .npz file, whole or not at all."""
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays, **{VERSION: np.int64(version)})


def read_arrays(path, what, fields, version, remedy, oldest=1):
    """Return the arrays of a file that `write_arrays` wrote, as a dict.

    `what` and `remedy` say in messages what the file is ("height map") and what makes a sound one.
    Arrays that are not among `fields` are not read; `version` is the latest that can be, `oldest`
    the first. Arrays are writable and C-contiguous, text is str or, of an array, a list of str;
    those that are not needed and not there are left out. InputError names the array, what it is and
    what it must be.
    """
    path = require_file(path, f"a {what}", remedy)
    reader = _Reader(path, what, remedy)
    try:
        with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
            members = reader.members(archive)
            found = 1
            if VERSION + ".npy" in members:
                found = reader.array(archive, members, VERSION, Field("int64"), {})
            if found < oldest:
                raise reader.error(f"it is of version {found}, at least {oldest} is read")
            if found > version:
                raise reader.error(f"it is of version {found}, at most {version} is read")
            arrays, lengths = {}, {}
            for name, field in fields.items():
                if name + ".npy" in members:
                    arrays[name] = reader.array(archive, members, name, field, lengths)
                elif field.needed:
                    raise reader.error(f"it has no array {name}")
    except InputError:
        raise
    except MemoryError:
        raise reader.error("it does not fit into the memory") from None
    # zipfile, zlib and numpy raise whatever the damage leads to, EINVAL among it.
    except Exception as error:
        if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):
            error.filename = error.filename or str(path)
            raise
        raise reader.error(f"it is damaged, {type(error).__name__}") from None
    return arrays


class _Reader:
    """Reads the members of one archive; words the errors about its faults."""

    def __init__(self, path, what, remedy):
        self.path, self.what, self.remedy = path, what, remedy
        self.size = path.stat().st_size

    def error(self, text):
        return InputError(f"{self.path} is no {self.what} of rainsim ({text}); {self.remedy}")

    def wrong(self, name, found, rule):
        return InputError(
            f"{self.path}: {name} is {found}; in a {self.what} it must be {rule}; {self.remedy}"
        )

    def members(self, archive):
        """Return the archive's members by name; each lies in the file as it is, once."""
        listed = archive.infolist()
        members = {info.filename: info for info in listed}
        stored = all(
            info.compress_type == zipfile.ZIP_STORED
            and not info.flag_bits & 1  # encrypted
            and info.file_size == info.compress_size <= self.size
            for info in listed
        )
        if len(members) < len(listed) or len(listed) > MOST_MEMBERS or not stored:
            raise self.error("its arrays are packed or stand there twice")
        return members

    def array(self, archive, members, name, field, lengths):
        """Return one array; `lengths` takes the lengths that its shape names."""
        info = members[name + ".npy"]
        with archive.open(info) as file:
            shape, dtype = npy_header(file)
            self._check_type(name, field, shape, dtype)
            self._check_shape(name, field, shape, lengths)
            if math.prod(shape) * dtype.itemsize != info.file_size - file.tell():
                raise self.error(f"it is damaged, {name} does not fill its place")
        with archive.open(info) as file:  # the archive compares the bytes' checksum at their end
            array = np.lib.format.read_array(file, max_header_size=HEADER_LIMIT)
        if field.kind == TEXT:
            return array.tolist()
        self._check_values(name, field, array)
        return np.ascontiguousarray(array) if array.ndim else array[()]

    def _check_type(self, name, field, shape, dtype):
        fits = dtype.kind == "U" if field.kind == TEXT else dtype == np.dtype(field.kind)
        if not fits:
            raise self.wrong(name, f"{dtype} of shape {_shown(shape)}", field.kind)

    def _check_shape(self, name, field, shape, lengths):
        fits = len(shape) == len(field.shape)
        for want, length in zip(field.shape, shape, strict=False):
            if isinstance(want, str):
                want = lengths.setdefault(want, length) if fits else want
            fits = fits and length == want
        if not fits:
            rule = [lengths.get(want, want) for want in field.shape]
            raise self.wrong(name, f"of shape {_shown(shape)}", f"of shape {_shown(rule)}")

    def _check_values(self, name, field, array):
        if not array.size or array.dtype == bool:
            return
        low, high = array.min(), array.max()
        if not (field.low <= low and high <= field.high):  # also for NaN
            rule = f"finite and from {field.low:g} to {field.high:g}"
            found = f"{low:g}" if low == high else f"from {low:g} to {high:g}"
            raise self.wrong(name, found, rule)


def npy_header(file):
    """Return shape and dtype of the array that begins here."""
    version = np.lib.format.read_magic(file)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[version]
    shape, _, dtype = read(file, max_header_size=HEADER_LIMIT)
    if dtype.hasobject or not all(0 <= length for length in shape):
        raise ValueError("no plain array")
    return shape, dtype


def _shown(shape):
    return " x ".join(map(str, shape)) or "a single value"
