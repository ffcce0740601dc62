"""Claims: a file that one process alone holds, on one machine or on several that share a disk."""

import errno
import fcntl
import os
import platform
import time
from contextlib import contextmanager, suppress
from pathlib import Path

HELD = (errno.EAGAIN, errno.EACCES)
SHARED = "shared by "  # begins the text of a claim that many may hold


class ClaimedError(Exception):
    """Another process holds the claim file.

    The message is that process's number, its machine and since when it holds the claim.
    """


@contextmanager
def claim(path, shared=False, wait=0.0):
    """Hold the claim file `path` until the block ends; its folders are made.

    The claim is a lock on the file. It ends with the process, however that ends, so that a claim
    which nobody holds any more is taken over. Where the file system has no locks the file itself is
    the claim, and one that was left behind counts. Other processes may hold a shared one if they
    share it, too. ClaimedError if another process holds it after `wait` [s], or another claim of
    this process.
    """
    path, file = Path(path), None
    kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
    deadline = time.monotonic() + (max(wait, 1.0) if shared else wait)
    while file is None:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            file = _held(path, kind)
        except ClaimedError:
            if time.monotonic() >= deadline:  # one who shares it locks it for a moment at the end
                raise
            time.sleep(0.02)
    try:
        os.ftruncate(file, 0)
        os.pwrite(file, f"{SHARED if shared else ''}{whoami()}".encode(), 0)
        yield
    finally:
        with suppress(OSError):  # the disk may be gone; the lock ends with the file's descriptor
            if not shared or _locked(file, fcntl.LOCK_EX):  # nobody else has it
                path.unlink(missing_ok=True)
        os.close(file)


def whoami():
    """Return process, host and time in words."""
    now = time.strftime("%Y-%m-%dT%H:%M:%S%z")
    return f"process {os.getpid()} on {platform.node()} since {now}"


def _locked(file, kind):
    """Whether a file could be locked at once."""
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _held(path, kind):
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
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except OSError as error:
        holder = os.pread(file, 200, 0).decode("utf-8", "replace")
        without_locks = new or (kind == fcntl.LOCK_SH and holder.startswith(SHARED))
        if error.errno in HELD or not without_locks:
            os.close(file)
            raise ClaimedError(holder or "a process that has just begun") from None
    try:
        if os.path.samestat(os.fstat(file), os.stat(path)):
            return file
    except FileNotFoundError:
        pass
    except OSError:  # the disk is gone; the lock would last as long as this process
        os.close(file)
        raise
    os.close(file)
    return None
