"""Compiler options and the compile cache: the only module that names either.

`device_function` marks a scalar formula that kernels call and that stays plain Python.
`cpu_kernel` is a parallel loop, `serial_kernel` a loop on one thread that may run beside others.
"""

import contextlib
import functools
import os
import sys
import threading

from rainsim.compiling.folder import CACHE_FOLDER  # before numba: it sets where numba looks

# isort: split
import numba
import numpy as np
from llvmlite import ir
from numba import get_num_threads, njit, prange, types
from numba.core import cgutils
from numba.extending import intrinsic, register_jitable

from rainsim.compiling import callees
from rainsim.compiling.kernel_cache import KernelCache

# Not fastmath=True: that assumes away NaN and infinity, which kernels must see.
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}

callees.watch()

# All kernels whose modules have been imported, by "module:name".
KERNELS = {}


# Nothing calls kernels by an entry from C, and kernels alone call device functions: an entry from
# Python and one from C for each of these took 8 % of the time of compiling.
_NO_C = {"no_cfunc_wrapper": True}
_WITHOUT_WRAPPERS = {"no_cpython_wrapper": True, **_NO_C}


def device_function(function=None, **options):
    """Mark a scalar formula that kernels call and that stays plain Python."""
    if function is None:
        return functools.partial(device_function, **options)
    function.compiler_options = str(options)  # part of its users' keys in the cache
    return register_jitable(**_WITHOUT_WRAPPERS, **options)(function)


# Numba does reference counting of each array of each call: for functions of many arrays that takes
# longer than their arithmetic. Lean functions neither make nor keep arrays, and count nothing.
lean_function = device_function(_nrt=False)
# Inlined by force: loops that LLVM is to vectorise must not hold calls.
inlined_function = device_function(forceinline=True, _nrt=False)
# A lean function that stays a call where inlined functions call it, too: numba inlines by force all
# that an inlined function calls, and compiles it once more for that.
called_function = device_function(forceinline=False, _nrt=False)


def _kernel(in_threads=False, **options):
    by_parts = in_threads and callees.IS_TESTED
    options = {"nogil": True, "error_model": "numpy", "fastmath": _FAST, **_NO_C, **options}
    options |= {"parallel": True} if in_threads and not by_parts else {}
    shown = {**options, "fastmath": sorted(_FAST), "by_parts": by_parts}

    def decorate(function):
        kernel = njit(**options)(function)
        if not numba.config.DISABLE_JIT:
            folder = CACHE_FOLDER / function.__module__
            kernel._cache = KernelCache(function, folder, str(shown))
            KERNELS[kernel._cache.kernel_name] = kernel
        kernel.by_parts = by_parts  # see `callees`
        return kernel

    return decorate


cpu_kernel = _kernel(in_threads=True)
serial_kernel = _kernel()


# Of a parallel loop whose threads take what is to be done with `take_next`: more than there are
# threads. The first iteration of each thread takes all that it can, the others find nothing left.
TAKERS = 256


@intrinsic
def _take_next(typingctx, taken):
    def codegen(context, builder, signature, arguments):
        array = cgutils.create_struct_proxy(signature.args[0])(context, builder, arguments[0])
        one = ir.Constant(ir.IntType(64), 1)
        return builder.atomic_rmw("add", array.data, one, "monotonic")

    return types.int64(taken), codegen


def take_next(taken):
    """Return taken[0] and add one to it, in one step for all threads.

    A parallel loop gives each thread a run of iterations beforehand. With a loop over `TAKERS` in
    which each thread takes the next part until none is left, no thread waits for another that got
    the dearer parts, or that other programs keep from its core. Only for parts whose results do
    not depend on who takes them, and when.

    taken : int64 array (1,). Iterations that have been taken, see `none_taken`.
    """
    count = taken[0]
    taken[0] += 1
    return count


if not numba.config.DISABLE_JIT:  # above is what it does for one thread, without the compiler
    take_next = _take_next


@device_function
def none_taken():
    """Return a count for `take_next` that begins at 0; made before the parallel loop."""
    taken = np.empty(1, np.int64)
    taken[0] = 0
    return taken


__all__ = [
    "CACHE_FOLDER",
    "KERNELS",
    "TAKERS",
    "called_function",
    "cgutils",
    "cpu_kernel",
    "interleaved",
    "device_function",
    "get_num_threads",
    "inlined_function",
    "intrinsic",
    "ir",
    "lean_function",
    "may_run_beside",
    "none_taken",
    "one_caller",
    "prange",
    "serial_kernel",
    "take_next",
    "types",
]


def interleaved(count):
    """Return 0 to count - 1 so that each thread of a parallel loop gets every n-th row."""
    threads = numba.get_num_threads()
    return np.concatenate([np.arange(n, count, threads) for n in range(threads)]).astype(np.int64)


def held(kernel, signature):
    """Return whether the cache on disk holds a kernel's machine code for the argument types."""
    return kernel._cache.holds(signature, kernel.targetctx)


def shipped_for(kernel, signature):
    """Return whether the package rainsim-kernels has a kernel for the argument types."""
    return kernel._cache.ships(signature, kernel.targetctx)


def threading_layer():
    """Return the name of numba's threading layer, once a kernel has run, and its threads."""
    return numba.threading_layer(), numba.get_num_threads()


def may_run_beside():
    """Tell whether kernels may run on two Python threads at once.

    The threading layer "workqueue" aborts the process if they do; before the first kernel has run
    it is not known which layer numba takes.
    """
    try:
        return numba.threading_layer() != "workqueue"
    except ValueError:
        return False


def _warn_before_fork():
    """Print one line where a process forks whose kernels OpenMP runs: GNU's ends the children.

    A pool then starts new ones and waits for ever, so this is the last moment to say it.
    """
    global _has_warned
    try:
        layer = numba.threading_layer()  # known once a kernel has run
    except ValueError:
        return
    # A child of `subprocess` becomes another program, such as the encoder of a video.
    program = sys._getframe(1).f_globals.get("__name__") == "subprocess"
    if layer == "omp" and not _has_warned and not program:
        _has_warned = True
        print(
            "rainsim: this process forks after compiled kernels have run; OpenMP ends a forked "
            'process that runs one; start workers by "spawn", as '
            'torch.utils.data.DataLoader(..., multiprocessing_context="spawn")',
            file=sys.stderr,
        )


_has_warned = False
if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_warn_before_fork)

_alone = threading.RLock()


def one_caller(method):
    """Let one thread at a time call a method, where kernels may not run beside others."""

    @functools.wraps(method)
    def call(*given, **named):
        with contextlib.nullcontext() if may_run_beside() else _alone:
            return method(*given, **named)

    return call


def processor():
    """Return the processor that kernels are compiled for and its features, as LLVM names them."""
    from numba.core.registry import cpu_target

    return " ".join(cpu_target.target_context.codegen().magic_tuple())


def set_threads(count):
    """Use `count` threads in all kernels (None: all cores that numba found at start)."""
    if count is not None:
        numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    return numba.get_num_threads()
