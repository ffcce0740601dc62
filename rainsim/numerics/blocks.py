"""Array work in blocks on several threads, and the stable order of whole numbers.

numpy and scipy.ndimage work outside Python's lock, so that blocks of one array can be computed
side by side. Each function returns the same bytes for any number of threads.
"""

from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np

from rainsim.jit import get_num_threads, may_run_beside, set_threads

ROWS = 1 << 16  # of a block: some 2 MB of positions, which stay in a core's cache
_INDEX_BITS = np.uint64(32)


def in_blocks(work, count, size=ROWS):
    """Call `work(part)` for slices of at most `size` that cover 0 to `count`, in several threads.

    The calls must not depend on each other's results. An error in one is raised here. numpy's
    handling of floating point errors is the caller's.
    """
    parts = [slice(start, min(start + size, count)) for start in range(0, count, size)]
    if len(parts) < 2:
        for part in parts:
            work(part)
        return
    handling = np.geterr()  # of this thread alone

    def handled(part):
        with np.errstate(**handling):
            work(part)

    with ThreadPoolExecutor(get_num_threads()) as pool:
        list(pool.map(handled, parts))


def of_each(function, *values):
    """Return the list of what a function returns for each of some values, in several threads."""
    with ThreadPoolExecutor(get_num_threads()) as pool:
        return list(pool.map(function, *values))


def beside(function, *values):
    """Return a function of the result of `function(*values)`, which another thread begins to find.

    With one thread, or where kernels may not run on two, it is found when it is asked for.
    """
    threads = get_num_threads()
    if threads == 1 or not may_run_beside():
        return cache(lambda: function(*values))
    pool = ThreadPoolExecutor(1, initializer=set_threads, initargs=(threads,))
    return pool.submit(function, *values).result


def stable_order(numbers):
    """Return the order of `np.argsort(numbers, kind="stable")`, int64, in a third of the time.

    Number and place are sorted as one 64-bit word: no two are equal, so any sort keeps the order.
    At most 2^32 numbers, each an integer from 0 to 2^32 - 1.
    """
    words = numbers.astype(np.uint64)
    words <<= _INDEX_BITS
    words |= np.arange(len(words), dtype=np.uint64)
    words.sort()
    words &= np.uint64(0xFFFFFFFF)
    return words.view(np.int64)
