"""Compiler options and the compile cache: the only module that names either.

`device_function` marks a scalar formula that kernels call and that stays plain Python.
`cpu_kernel` is a parallel loop, `serial_kernel` a loop on one thread that may run beside others.
"""

import functools
import hashlib
import re
import shutil
from pathlib import Path

from rainsim.compiling.folder import CACHE_FOLDER  # before numba: it sets where numba looks

# Kernels of the CPU are kept by `compiling.kernel_cache`. Those of a GPU are kept by numba, which
# keys them on the file that holds a kernel, not on the files of the functions that the kernel
# calls: an edited helper would keep its old machine code. So every such module has a folder for its
# kernels, named by a hash of that module and of all modules of ours that it imports.
_KEPT_VERSIONS = 4  # of a module, whose machine code is kept
_PACKAGE = Path(__file__).parent
_IMPORT = re.compile(
    r"^\s*(?:from (rainsim[\w.]*) import (\([^)]*\)|[^\n]*)|import (rainsim[\w.]+))", re.M
)


def _file_of(module):
    path = _PACKAGE.joinpath(*module.split(".")[1:])
    for file in (path.with_suffix(".py") if path != _PACKAGE else path, path / "__init__.py"):
        if file.is_file():
            return file
    return None


@functools.cache
def _content_and_imports(module):
    """Return the bytes of a module and the names of the modules of ours that it imports."""
    content = _file_of(module).read_bytes()
    names = {module.rpartition(".")[0]} - {""}
    for package, members, plain in _IMPORT.findall(content.decode()):
        names.add(package or plain)
        names.update(f"{package}.{name}" for name in re.findall(r"\w+", members) if package)
    return content, {name for name in names if _file_of(name)}


@functools.cache
def kernel_folder(module):
    """Return the folder for the machine code of one module."""
    if module.partition(".")[0] != "rainsim":
        return CACHE_FOLDER / module  # a test's own kernel, a variant in a benchmark
    found, todo = set(), {module}
    while todo:
        name = todo.pop()
        found.add(name)
        todo |= _content_and_imports(name)[1] - found
    digest = hashlib.sha256()
    for name in sorted(found):
        digest.update(_content_and_imports(name)[0])
    folder = CACHE_FOLDER / module / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.touch()  # the newest are kept
        others = sorted(folder.parent.iterdir(), key=lambda f: f.stat().st_mtime, reverse=True)
        for old in others[_KEPT_VERSIONS:]:
            shutil.rmtree(old, ignore_errors=True)
    except OSError:  # another process tidies up at the same time
        pass
    return folder


import numba  # noqa: E402  (the cache folder must be known before numba is imported)
import numpy as np  # noqa: E402
from llvmlite import ir  # noqa: E402
from numba import (  # noqa: E402
    get_num_threads,
    njit,
    prange,
    types,
)
from numba.core import cgutils  # noqa: E402
from numba.extending import intrinsic, register_jitable  # noqa: E402

from rainsim.compiling import callees  # noqa: E402
from rainsim.compiling.kernel_cache import KernelCache  # noqa: E402

# Not fastmath=True: that assumes away NaN and infinity, which kernels must see.
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}

callees.watch()

# All kernels whose modules have been imported, by "module:name".
KERNELS = {}


# Kernels alone call device functions: an entry from Python and one from C for each of them took 8 %
# of the time of compiling.
_WITHOUT_WRAPPERS = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


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


def _kernel(thorough=False, **options):
    options = {"nogil": True, "error_model": "numpy", "fastmath": _FAST, **options}
    shown = str({**options, "fastmath": sorted(_FAST), "thorough": thorough})

    def decorate(function):
        kernel = njit(**options)(function)
        if not numba.config.DISABLE_JIT:
            folder = CACHE_FOLDER / function.__module__
            kernel._cache = KernelCache(function, folder, shown)
            KERNELS[kernel._cache.kernel_name] = kernel
        kernel.thorough = thorough  # see `callees`
        return kernel

    return decorate


cpu_kernel = _kernel(parallel=True)
thorough_kernel = _kernel(parallel=True, thorough=True)
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

    Parameters
    ----------
    taken : ndarray of shape (1,), int64
        Iterations that have been taken, see `none_taken`.
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
    "cgutils",
    "cpu_kernel",
    "interleaved",
    "device_function",
    "get_num_threads",
    "inlined_function",
    "intrinsic",
    "ir",
    "kernel_folder",
    "lean_function",
    "may_run_beside",
    "none_taken",
    "prange",
    "serial_kernel",
    "take_next",
    "thorough_kernel",
    "types",
]


def interleaved(count):
    """Return 0 to count - 1, int64, in the order in which a parallel loop should take rows.

    A loop gives each thread a run of iterations: this way each gets every n-th row, so that rows
    with much to do are shared out.
    """
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


def processor():
    """Return the processor that kernels are compiled for and its features, as LLVM names them."""
    from numba.core.registry import cpu_target

    return " ".join(cpu_target.target_context.codegen().magic_tuple())


def set_threads(count):
    """Use `count` threads in all kernels (None: all cores that numba found at start)."""
    if count is not None:
        numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    return numba.get_num_threads()
