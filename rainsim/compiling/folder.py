"""Where compiled kernels are kept, and a stamp that says that all that a use needs lie there.

Nothing here imports numba: a command asks for the stamp before anything else, and on a machine
without compiled kernels the other processes start while this one still imports.
"""

import hashlib
import os
import platform
import tempfile
from importlib.util import find_spec
from pathlib import Path

from rainsim.compiling import shipped
from rainsim.compiling.shipped import COMPILERS, CPU_INFO

NAME = "rainsim-kernels"
LOST = f"{NAME}-"  # begins the names of folders that no later run looks into
OTHERS, ENTER = 0o022, 0o011  # permissions of group and others to write, and to enter
PACKAGE = Path(__file__).parent.parent
CPU_LINES = ("model name", "flags", "CPU part", "Features")  # of the first core


def is_mine(found):
    """Return whether a file or folder, by its `os.stat_result`, belongs to who runs this."""
    return not hasattr(os, "geteuid") or found.st_uid == os.geteuid()


def fault_of(folder):
    """Return why machine code must not be loaded from a folder, None if it may be.

    Who can write there can run code as this user.
    """
    inside = []
    if os.stat(folder).st_mode & ENTER:  # else nobody comes to what is inside
        with os.scandir(folder) as entries:
            inside = [entry.path for entry in entries if entry.is_dir()]
    for place in (folder, *inside):
        found = os.stat(place)
        if not is_mine(found):
            return f"{place} belongs to another user"
        if os.name == "posix" and found.st_mode & OTHERS:
            return f"others can write to {place}"
    return None


def _cache_folder():
    """Return a folder that the user alone can write to, and sentences on those refused."""
    wanted = [os.environ.get("NUMBA_CACHE_DIR")]
    home = os.path.expanduser("~/.cache")  # stays as it is for an account without a home
    wanted.append(os.environ.get("XDG_CACHE_HOME") or (None if home.startswith("~") else home))
    refused = []
    for base in map(Path, filter(None, wanted)):
        folder = base if base.name == NAME else base / NAME  # ours: set by a parent process
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode=0o700, exist_ok=True)
            fault = fault_of(folder) if os.access(folder, os.W_OK) else ""
        except OSError:
            continue
        if fault is None:
            return folder, tuple(refused)
        if fault:
            refused.append(f"{fault}: compiled kernels could be planted there; delete {folder}")
    try:
        return Path(tempfile.mkdtemp(prefix=LOST)) / NAME, tuple(refused)
    except OSError:  # not even there: nothing is kept
        return Path(os.devnull) / NAME, tuple(refused)


CACHE_FOLDER, REFUSED = _cache_folder()
unsaved = None  # why a kernel's machine code could not be written, once one could not
os.environ["NUMBA_CACHE_DIR"] = str(CACHE_FOLDER)
# An idle thread of GNU's OpenMP looks for work so many times before it sleeps, 300,000 by default:
# milliseconds, in which it keeps a core from a thread that has work. A frame then takes three to
# four times as long beside other programs. With 2,000 an idle machine draws as fast as before.
SPINS = "GOMP_SPINCOUNT", "2000"
if not os.environ.keys() & {"OMP_WAIT_POLICY", SPINS[0]}:
    os.environ[SPINS[0]] = SPINS[1]


def stamp(names):
    """Return the file that exists if the kernels of a list have been found compiled.

    Its name is a hash of the list, of size and time of each file of the package, of the compilers'
    files, of the processor and of shipped kernels: when any of these change the kernels must be
    looked for one by one.
    """
    digest = hashlib.sha256("\n".join(sorted(names)).encode())
    digest.update(f"{platform.python_version()} {platform.machine()} {_processor()}".encode())
    made_for = [os.environ.get(name) for name in shipped.PROCESSOR]
    digest.update(f"{made_for} {shipped.PACK and shipped.PACK.identity}".encode())
    files = [entry for entry in _python_files(PACKAGE)]
    files += [Path(find_spec(name).origin) for name in COMPILERS]
    for file in sorted(map(str, files)):
        found = os.stat(file)
        digest.update(f"{file} {found.st_size} {found.st_mtime_ns}\n".encode())
    return CACHE_FOLDER / "ready" / digest.hexdigest()[:24]


def _python_files(folder):
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir():
                yield from _python_files(entry.path)
            elif entry.name.endswith(".py"):
                yield entry.path


def _processor():
    """Return the lines of /proc/cpuinfo that differ where a processor's instructions do."""
    try:
        with CPU_INFO.open() as lines:
            found = []
            for line in lines:
                if line.startswith(CPU_LINES):
                    found.append(line)
                elif not line.strip() and found:
                    break
        return "".join(found)
    except OSError:
        return platform.processor()
