"""The sort of a picture's entries: cuda.compute's radix sort, in the simulator numpy's."""

from __future__ import annotations

from functools import partial

import numpy as np

from rainsim.cuda.jit import SIMULATED


def sorter(lists, stream, workspace):
    """Return sort(), which queues the sort of keys and values into the arrays that follow them."""
    if SIMULATED:
        return partial(_sort_on_host, *lists)
    return _Sorter(*lists, stream, workspace)


def _sort_on_host(key, value, key_out, value_out):
    """Sort as `_Sorter` does, in the simulator, which has no such library."""
    order = np.argsort(key.copy_to_host(), kind="stable")
    for array, array_out in ((key, key_out), (value, value_out)):
        array_out.copy_to_device(array.copy_to_host()[order])


class _Sorter:
    """cuda.compute's radix sort of a fixed number of pairs, with memory of the workspace."""

    def __init__(self, key, value, key_out, value_out, stream, workspace):
        from cuda.compute import SortOrder, make_radix_sort

        arrays = {
            "d_in_keys": key, "d_out_keys": key_out, "d_in_values": value,
            "d_out_values": value_out,
        }  # fmt: skip
        self._sort = make_radix_sort(**arrays, order=SortOrder.ASCENDING)
        self._options = {**arrays, "num_items": len(key), "begin_bit": 0, "end_bit": 32}
        self._stream = stream
        size = self._sort(temp_storage=None, stream=stream, **self._options)
        self._memory = workspace.memory(max(1, int(size)))

    def __call__(self):
        self._sort(temp_storage=self._memory, stream=self._stream, **self._options)
