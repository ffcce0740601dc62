"""Weights in files that `torch.save` wrote, read without torch and without running code.

Such a file is a zip archive: data.pkl, a pickle that names tensors by the keys of their storages,
and data/KEY, the numbers of each storage. A pickle can ask for any function to be called; this
reader knows a dozen names, all of them made here, and refuses every other. So torch is not needed,
and a file from anywhere can do no more than be refused.
"""

from __future__ import annotations

import io
import pickle
import pickletools
import zipfile
from collections import OrderedDict
from typing import NamedTuple

import numpy as np

from rainsim.errors import InputError, shown
from rainsim.io.files import require_file

REMEDY = "save the weights again with torch.save, tensors and plain values only"
MOST_PICKLE = 1 << 22  # bytes of data.pkl; a real one has some ten thousand
MOST_COPIES = 4  # of a file's bytes in its tensors: real ones name each storage once
MOST_AXES = 16
TYPES = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8",
    "IntStorage": "<i4", "ShortStorage": "<i2", "CharStorage": "<i1", "ByteStorage": "<u1",
    "BoolStorage": "?",
}  # fmt: skip


class _Kind(NamedTuple):
    """A kind of storage, in place of torch's class."""

    dtype: str


class _Storage(NamedTuple):
    """The numbers of a storage, in place of torch's object."""

    values: np.ndarray


def read_weights(path):
    """Return the content of a file of weights: dicts, lists, plain values, tensors as ndarrays.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    InputError
        If it is no such file, is damaged, or asks for anything but tensors.
    """
    path = require_file(path, "a file of weights")
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            found = [name for name in names if name.endswith("/data.pkl") and name.count("/") == 1]
            if len(found) != 1 or len(set(names)) < len(names):
                raise InputError(f"{path} is no file of weights of torch; {REMEDY}")
            folder = found[0].removesuffix("data.pkl")
            if any(i.compress_type != zipfile.ZIP_STORED or i.flag_bits & 1
                   for i in archive.infolist()):  # fmt: skip
                raise InputError(
                    f"{path} is packed; torch stores its weights as they are; {REMEDY}"
                )
            _require_little_endian(path, archive, folder, names)
            if archive.getinfo(found[0]).file_size > MOST_PICKLE:
                raise InputError(f"{path}: its index has over {MOST_PICKLE} bytes; {REMEDY}")
            index = archive.read(found[0])
            _require_small_memo(index)
            return _Reader(index, path, archive, folder).load()
    except InputError:
        raise
    except zipfile.BadZipFile:
        raise InputError(f"{path} is no zip archive, as torch writes since 1.6; {REMEDY}") from None
    except MemoryError:
        raise InputError(f"{path} does not fit into the memory; {REMEDY}") from None
    # pickle raises whatever the damage leads to.
    except Exception as error:
        raise InputError(f"{path} is damaged, {type(error).__name__}; {REMEDY}") from None


def _require_little_endian(path, archive, folder, names):
    order = folder + "byteorder"
    if order in names and archive.read(order).strip() != b"little":
        raise InputError(f"{path} is big-endian; little-endian weights are read; {REMEDY}")


def _require_small_memo(index):
    """Raise ValueError if a pickle numbers its memo beyond the length of the file.

    pickle makes a table as long as the largest number: nine bytes would take gigabytes.
    """
    for code, number, _ in pickletools.genops(index):
        if code.name in ("PUT", "LONG_BINPUT") and number > len(index):
            raise ValueError("a memo beyond the file")


class _Reader(pickle.Unpickler):
    """Reads the index; every name that it asks for is looked up in `_KNOWN`."""

    def __init__(self, index, path, archive, folder):
        super().__init__(io.BytesIO(index))
        self._path, self._archive, self._folder = path, archive, folder
        self._storages = {}
        self._left = MOST_COPIES * path.stat().st_size

    def find_class(self, module, name):
        """Return the stand-in for a name in the pickle; refuse unknown ones."""
        if module == "torch" and name in TYPES:
            return _Kind(TYPES[name])
        if (module, name) not in _KNOWN:
            raise InputError(
                f"{self._path} asks for {shown(f'{module}.{name}')}; only weights are read and no "
                f"code is run; {REMEDY}"
            )
        return self._tensor if name == "_rebuild_tensor_v2" else _KNOWN[module, name]

    def _tensor(self, *given):
        tensor = _tensor(*given)
        self._left -= tensor.nbytes
        if self._left < 0:
            raise ValueError("more tensors than numbers")
        return tensor

    def persistent_load(self, pid):
        """Return the storage that a tensor names."""
        what, kind, key, _, count = pid
        if what != "storage" or not isinstance(kind, _Kind) or not isinstance(key, str):
            raise ValueError("no storage")
        if key not in self._storages:
            values = np.frombuffer(self._archive.read(f"{self._folder}data/{key}"), kind.dtype)
            self._storages[key] = values
        values = self._storages[key]
        if values.dtype != np.dtype(kind.dtype) or not 0 <= count <= len(values):
            raise ValueError("a storage of another size")
        return _Storage(values)


def _tensor(storage, offset, size, stride, *_):
    """Return a tensor of a storage as an array of its own."""
    values, size, stride = storage.values, tuple(size), tuple(stride)
    numbers = (offset, *size, *stride)
    whole = all(type(n) is int and n >= 0 for n in numbers) and len(size) == len(stride)
    if not whole or len(size) > MOST_AXES:
        raise ValueError("no tensor")
    count = 1
    for length in size:
        count *= length
    if count == 0:
        return np.zeros(size, values.dtype)
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
    if last >= len(values) or count > len(values):
        raise ValueError("a tensor beyond its storage")
    steps = [step * values.itemsize for step in stride]
    return np.array(np.lib.stride_tricks.as_strided(values[offset:], size, steps, writeable=False))


def _parameter(data, *_):
    return data


_KNOWN = {
    ("collections", "OrderedDict"): OrderedDict,
    ("torch", "Size"): tuple,
    ("torch._utils", "_rebuild_tensor_v2"): _tensor,
    ("torch._utils", "_rebuild_parameter"): _parameter,
}
