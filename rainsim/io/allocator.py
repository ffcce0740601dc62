"""How the C library keeps freed memory: large blocks go back to the system at once.

The allocator of glibc serves blocks below a threshold from a heap, which shrinks from its end only,
and raises the threshold to the size of what was freed, up to 32 MB. Where arrays of megabytes come
and go in another order, as the pages of a big capture do, the heap then keeps what lies between
those in use: 0.4 of 2.0 GB on a kilometre of street.
"""

from __future__ import annotations

import ctypes
import os

VARIABLES = "MALLOC_MMAP_THRESHOLD_", "GLIBC_TUNABLES"  # by which a user chooses another threshold
MMAP_THRESHOLD = -3  # number of the parameter in glibc's malloc.h
LARGE = 128 * 1024  # bytes, the value that glibc begins with; once set it no longer rises


def return_large_blocks():
    """Give each block of LARGE bytes or more a mapping of its own, which ends when it is freed.

    Returns
    -------
    bool
        Whether the C library took the setting; False where there is no glibc, or where a variable
        of VARIABLES is set.
    """
    if any(name in os.environ for name in VARIABLES):
        return False
    try:
        return ctypes.CDLL(None).mallopt(MMAP_THRESHOLD, LARGE) == 1
    except (AttributeError, OSError, TypeError):  # another C library, or a system without one
        return False
