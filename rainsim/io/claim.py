"""Claims: a file that one process alone holds, on one machine or on several that share a disk."""

from __future__ import annotations

import errno
import fcntl
import os
import platform
import time
from contextlib import contextmanager
from pathlib import Path

HELD = (errno.EAGAIN, errno.EACCES)


class ClaimedError(Exception):
    """Another process holds the claim file.

    The message is that process's number, its machine and since when it holds the claim.
    """


@contextmanager
def claim(path):
    """Hold the claim file `path` until the block ends; its folders are made.

    The claim is a lock on the file. It ends with the process, however that ends, so that a claim
    which nobody holds any more is taken over. Where the file system has no locks the file itself is
    the claim, and one that was left behind counts.

    Raises
    ------
    ClaimedError
        If another process holds it, or another claim of this process.
    OSError
        If the file cannot be made.
    """
    path = Path(path)
    file = None
    while file is None:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = _held(path)
    now = time.strftime("%Y-%m-%dT%H:%M:%S%z")
    try:
        os.ftruncate(file, 0)
        os.pwrite(file, f"process {os.getpid()} on {platform.node()} since {now}".encode(), 0)
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(file)


def _held(path):
    """Return the locked file; None if another process has removed it or its folder meanwhile."""
    try:
        file, new = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666), True
    except FileNotFoundError:
        return None
    except FileExistsError:
        try:
            file, new = os.open(path, os.O_RDWR), False
        except FileNotFoundError:
            return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in HELD or not new:
            holder = os.pread(file, 200, 0).decode("utf-8", "replace")
            os.close(file)
            raise ClaimedError(holder or "a process that has just begun") from None
    try:
        if os.path.samestat(os.fstat(file), os.stat(path)):
            return file
    except FileNotFoundError:
        pass
    os.close(file)
    return None
