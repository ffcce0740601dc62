"""How the C library keeps freed memory: in few heaps, large blocks of big captures in none.

The allocator of glibc begins a heap for each new thread. Each keeps what lies between blocks in
use, and none is ever returned: 1.43 in place of 1.56 GB for a first picture of half a million
splats. It serves blocks below a threshold from a heap, which shrinks from its end only, and raises
the threshold to the size of what was freed, up to 32 MB. Where arrays of megabytes come and go in
another order, as the pages of a big capture do, the heap then keeps what lies between those in use:
0.4 of 2.0 GB on a kilometre of street.
"""

import contextlib
import ctypes
import os

# By which a user chooses otherwise.
VARIABLES = "MALLOC_ARENA_MAX", "MALLOC_MMAP_THRESHOLD_", "GLIBC_TUNABLES"
MMAP_THRESHOLD, MOST_HEAPS = -3, -8  # numbers of the parameters in glibc's malloc.h
HEAPS = 2  # of all threads
LARGE = 128 * 1024  # bytes, the value that glibc begins with; once set it no longer rises


def share_heaps():
    """Let all threads share HEAPS heaps; as `return_large_blocks`."""
    return _set(MOST_HEAPS, HEAPS)


def return_large_blocks():
    """Give each block of LARGE bytes or more a mapping of its own, which ends when it is freed.

    Return whether the C library took the setting; not so where there is no glibc, or where a
    variable of VARIABLES is set.
    """
    return share_heaps() and _set(MMAP_THRESHOLD, LARGE)


def _set(parameter, value):
    if any(name in os.environ for name in VARIABLES):
        return False
    try:
        return ctypes.CDLL(None).mallopt(parameter, value) == 1
    except (AttributeError, OSError, TypeError):  # another C library, or a system without one
        return False


def trim():
    """Return free memory in the C library's heaps to the system; do nothing without glibc.

    Large blocks return at once, small ones only from the end of a heap, until this is called.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
