"""The files of a kernel's machine code, each with a digest of its content.

A flipped bit in machine code ends the process, a cut file is an error of its reader. A file whose
digest is not that of its content counts as absent: the kernel is compiled again and replaces it.
"""

import hashlib
import os
import pickle

from numba.core import caching

from rainsim.compiling import shipped
from rainsim.compiling.folder import is_mine

DIGEST = 32  # bytes at the beginning of a file


def _digest(content):
    return hashlib.blake2b(content, digest_size=DIGEST).digest()


def read_checked(path):
    """Return the content of a file whose digest is right and that no other user wrote, or None."""
    try:
        with open(path, "rb") as file:
            if not is_mine(os.fstat(file.fileno())):
                return None
            digest, content = file.read(DIGEST), file.read()
    except OSError:  # absent, or no file at all
        return None
    return content if digest == _digest(content) else None


class CheckedFiles(caching.IndexDataCacheFile):
    """numba's index and data files of one kernel, written and read with their digests."""

    _read = staticmethod(read_checked)

    def _load_index(self):
        content = self._read(self._index_path)
        version, stamp, overloads = (None, None, {}) if content is None else pickle.loads(content)
        known = version == self._version and stamp == self._source_stamp
        return overloads if known else {}

    def _save_index(self, overloads):
        self._write(self._index_path, (self._version, self._source_stamp, overloads))

    def _load_data(self, name):
        content = self._read(self._data_path(name))
        return None if content is None else pickle.loads(content)

    def _save_data(self, name, data):
        self._write(self._data_path(name), data)

    def _write(self, path, data):
        content = self._dump(data)
        with self._open_for_write(path) as file:
            file.write(_digest(content) + content)

    def holds(self, key):
        """Return whether there is whole machine code for a key of the index; loads none of it."""
        name = self._load_index().get(key)
        return name is not None and self._read(self._data_path(name)) is not None


class ShippedFiles(CheckedFiles):
    """The files of one kernel in `shipped.PACK`, read by the hashes of its manifest."""

    def _read(self, path):
        content = shipped.PACK.read(path)
        return None if content is None else content[DIGEST:]
