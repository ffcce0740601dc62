"""Watch which kernels a program calls, for which arguments: how the list is recorded."""

import contextlib
import importlib
import time

from numba.core.dispatcher import Dispatcher

from rainsim.compiling.recorded import SORT
from rainsim.compiling.signatures import UnknownType, to_text
from rainsim.jit import KERNELS


@contextlib.contextmanager
def watched_cuda(found):
    """Record, as `watched` does, which kernels of the GPU are called."""
    from numba.cuda.dispatcher import CUDADispatcher

    importlib.import_module(SORT.partition(":")[0])
    sort = KERNELS[SORT]

    def sorts(kinds, seconds):
        found(SORT, ", ".join(map(to_text, kinds)), seconds)

    original = CUDADispatcher.compile

    def compile_one(kernel, kinds):
        missed = sum(kernel._cache_misses.values())
        begin = time.thread_time()
        result = original(kernel, kinds)
        seconds = time.thread_time() - begin
        name = getattr(kernel._cache, "kernel_name", None)
        if name is not None:
            compiled = sum(kernel._cache_misses.values()) > missed
            found(name, ", ".join(map(to_text, kinds)), seconds if compiled else None)
        return result

    CUDADispatcher.compile, sort.watcher = compile_one, sorts
    try:
        yield
    finally:
        CUDADispatcher.compile, sort.watcher = original, None


@contextlib.contextmanager
def watched(found):
    """Call found(kernel, arguments, seconds) at each kernel's first call for a list of types."""
    names = {id(kernel): name for name, kernel in KERNELS.items()}
    original = Dispatcher._compile_for_args

    def call(kernel, *arguments, **others):
        name = names.get(id(kernel)) or next((n for n, k in KERNELS.items() if k is kernel), None)
        missed = sum(kernel.stats.cache_misses.values())
        begin = time.thread_time()
        result = original(kernel, *arguments, **others)
        seconds = time.thread_time() - begin
        if name is not None:
            compiled = sum(kernel.stats.cache_misses.values()) > missed
            try:
                texts = ", ".join(to_text(kernel.typeof_pyval(value)) for value in arguments)
            except UnknownType as error:
                raise UnknownType(f"{name}: {error}") from None
            found(name, texts, seconds if compiled else None)
        return result

    Dispatcher._compile_for_args = call
    try:
        yield
    finally:
        Dispatcher._compile_for_args = original
