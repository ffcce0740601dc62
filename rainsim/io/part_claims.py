"""Claims on the parts of a work that several processes share, on one machine or on many.

A claim is a file PART.N in a folder that all see. It is created with its text whole, by one
process alone, which network file systems grant too. A claim stays when its part is finished: what
is claimed and not finished is being made, or was left behind.

While a process works on a part it refreshes the time of the claim's file. A claim that has not
been refreshed for a while is taken over by creating PART.N+1: of several processes that find the
same claim stale, one alone can create the next. No two clocks are compared: who looks at a claim
measures with its own clock how long the file's time does not change.
"""

from __future__ import annotations

import errno
import os
import platform
import re
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

from rainsim.io.claim import whoami

STALE = 60.0  # s
BEATS = 6  # in that time
PATIENCE = 10  # times STALE: who works on a part for longer hangs, and its claim is not refreshed
NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK)
_HOLDER = re.compile(r"process (\d+) on (\S+) since ")


class PartClaims:
    """The claims of one process; use as a context manager, which gives up those not finished.

    All processes see the folder. A claim may be taken over once it was not refreshed for `stale`
    seconds.
    """

    def __init__(self, folder, stale=STALE):
        self.folder, self.stale = Path(folder), stale
        self._mine, self._lock = {}, threading.Lock()  # claim file and time since, by part
        self._seen = {}  # of claims of others: time of the file, and when it was first seen
        self._ended = threading.Event()
        self._beating = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self):
        self._beating.start()
        return self

    def __exit__(self, *exception):
        self._ended.set()
        self._beating.join()
        for part in list(self._mine):
            self.give_up(part)

    def take(self, part):
        """Claim a part that nobody holds, and return whether it became ours.

        A stale claim is taken over. OSError if the folder is gone or cannot be written to.
        """
        if part in self._mine:
            return False
        last = self._last(part)
        if last is not None and not self._is_stale(self.folder / f"{part}.{last}"):
            return False
        path = self.folder / f"{part}.{0 if last is None else last + 1}"
        if not create(path, whoami()):
            return False
        with self._lock:
            self._mine[part] = path, time.monotonic()
        return True

    def finish(self, part):
        """Leave a claim as it is: its part is finished, and noted as finished."""
        with self._lock:
            self._mine.pop(part, None)

    def give_up(self, part):
        """Remove a claim whose part was not made."""
        with self._lock:
            path, _ = self._mine.pop(part)
        with suppress(OSError):
            path.unlink()

    def _last(self, part):
        """Return the number of the last claim on a part, None without any."""
        last = None
        while (self.folder / f"{part}.{0 if last is None else last + 1}").exists():
            last = 0 if last is None else last + 1
        return last

    def _is_stale(self, path):
        try:
            with open(path, "rb") as file:  # on a network disk opening asks for the time again
                holder = _HOLDER.match(file.read(200).decode("utf-8", "replace"))
                changed = os.fstat(file.fileno()).st_mtime_ns
        except FileNotFoundError:
            return False  # it was given up just now
        if holder and holder[2] == platform.node() and not _lives(int(holder[1])):
            return True
        before = self._seen.get(path)
        if before is None or before[0] != changed:
            self._seen[path] = changed, time.monotonic()
            return False
        return time.monotonic() - before[1] >= self.stale

    def _beat(self):
        while not self._ended.wait(self.stale / BEATS):
            with self._lock:
                mine = list(self._mine.values())
            for path, since in mine:
                if time.monotonic() - since < PATIENCE * self.stale:
                    with suppress(OSError):  # the next claim finds out what is wrong
                        os.utime(path)


def create(path, text):
    """Create a file with its text whole; return False if there is one already.

    A hard link is made to a temporary file: of several processes one alone succeeds, also where the
    folder lies on a network disk. Where there are no links the file is created exclusively.
    """
    path = Path(path)
    handle, name = tempfile.mkstemp(prefix=".", dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        try:
            os.link(name, path)
        except FileExistsError:
            return os.stat(name).st_nlink == 2  # ours: a network disk lost the first answer
        except OSError as error:
            if error.errno not in NO_LINKS:
                raise
            return _create_exclusively(path, text)
        return True
    finally:
        Path(name).unlink(missing_ok=True)


def _create_exclusively(path, text):
    try:
        with open(path, "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        return False
    return True


def _lives(process):
    """Whether a process of this machine still runs."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass  # it is somebody else's
    return True
