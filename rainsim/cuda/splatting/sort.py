"""The sort of a picture's entries: cuda.compute's radix sort, in the simulator numpy's."""

import functools
import hashlib
import os
import threading
import time

import numpy as np

from rainsim.compiling import folder, gpu, shipped
from rainsim.compiling.checked_files import CheckedFiles, ShippedFiles
from rainsim.compiling.recorded import SORT
from rainsim.compiling.signatures import from_text
from rainsim.compiling.waiting import wait_for
from rainsim.cuda.jit import SIMULATED
from rainsim.jit import KERNELS


def sort_pairs(key, value, key_out, value_out, count, workspace):
    """Queue the sort of the first `count` keys and values into the arrays that follow them."""
    if SIMULATED:
        order = np.argsort(key.copy_to_host()[:count], kind="stable")
        for array, array_out in ((key, key_out), (value, value_out)):
            array_out[:count].copy_to_device(array.copy_to_host()[:count][order])
        return
    sort = RADIX_SORT.load(key.dtype, value.dtype)
    options = {
        "d_in_keys": key, "d_out_keys": key_out, "d_in_values": value, "d_out_values": value_out,
        "num_items": count, "begin_bit": 0, "end_bit": 32, "stream": None,
    }  # fmt: skip
    size = int(sort(temp_storage=None, **options))
    (memory,) = workspace.take("to sort with", max(size, 1), (1, np.uint8))
    sort(temp_storage=memory, **options)


class _Typed:
    """An array's type, to compile for.

    The library's own placeholder for an array has no address. For values without an address the
    library compiles a sort of keys alone (cuda-cccl 1.2.1).
    """

    def __init__(self, dtype):
        self.__cuda_array_interface__ = {
            "shape": (1,), "typestr": np.dtype(dtype).str, "data": (256, False), "strides": None,
            "version": 3,
        }  # fmt: skip


class KeptSort:
    """The machine code of cuda.compute's radix sort, kept and made ahead as that of a kernel is.

    The library compiles it in each process, which takes seconds. Its argument types are the arrays
    of keys and of values.
    """

    kernel_name = SORT
    targetctx = None  # of a kernel; nothing here needs one

    def __init__(self):
        self._cache = self  # what a kernel is asked for
        self._loaded = threading.local()  # a sort must not be queued by two threads at once
        self.watcher = None  # watcher(kinds, seconds): called where the library is first loaded

    def compile(self, kinds):
        """Compile for argument types and the compute capability here, and keep it; return it."""
        from cuda.compute import SortOrder, make_radix_sort

        key, value = (_Typed(str(kind.dtype)) for kind in kinds)
        made = make_radix_sort(
            d_in_keys=key, d_out_keys=key, d_in_values=value, d_out_values=value,
            order=SortOrder.ASCENDING, compute_capability=_capability(),
        )  # fmt: skip
        code = made.serialize()
        try:
            os.makedirs(self._place(folder.CACHE_FOLDER), mode=0o700, exist_ok=True)
            self._files(CheckedFiles, folder.CACHE_FOLDER).save(str(kinds), code)
        except OSError as error:  # the next run compiles it again
            folder.unsaved = str(error)
        return code

    def holds(self, kinds, target_context=None):
        """Return whether the machine code for argument types is on disk."""
        return self.ships(kinds) or self._files(CheckedFiles, folder.CACHE_FOLDER).holds(str(kinds))

    def ships(self, kinds, target_context=None):
        """Return whether the package rainsim-kernels has the machine code for argument types."""
        pack = shipped.PACK
        return pack is not None and self._files(ShippedFiles, pack.folder).holds(str(kinds))

    def load(self, *dtypes):
        """Return this thread's sort of keys and values of two dtypes."""
        known = self._loaded.__dict__
        if dtypes not in known:
            known[dtypes] = self._load(tuple(from_text(f"{dtype}[::1]") for dtype in dtypes))
        return known[dtypes]

    def _load(self, kinds):
        from cuda.compute import deserialize

        begin = time.thread_time()
        code, pack = None, shipped.PACK
        if pack is not None:
            code = self._files(ShippedFiles, pack.folder).load(str(kinds))
        if code is None:
            wait_for(self.kernel_name)  # another process may be at it
            code = self._files(CheckedFiles, folder.CACHE_FOLDER).load(str(kinds))
        compiled = code is None
        code = self.compile(kinds) if compiled else code
        if self.watcher is not None:
            self.watcher(kinds, time.thread_time() - begin if compiled else None)
        return deserialize(code)

    def _files(self, kind, base):
        """Return the files below a folder that fit the library, the toolkit and the GPU here."""
        made_for = hashlib.sha256("\n".join(gpu.versions(_capability())).encode()).hexdigest()
        return kind(self._place(base), f"radix_sort-{made_for[:16]}", made_for)

    def _place(self, base):
        return os.fspath(base / __name__)


@functools.cache
def _capability():
    return os.environ.get(gpu.CAPABILITY) or gpu.capability()


RADIX_SORT = KeptSort()
if not SIMULATED:
    KERNELS[KeptSort.kernel_name] = RADIX_SORT
