"""Small copies between pinned memory of the host and the device, each by a kernel.

The copies of all streams go through one copy engine for each direction, in the order in which they
were queued: one that waits for its stream keeps all behind it waiting, whichever stream they are
on. A kernel, which reads and writes pinned memory itself, waits for its own stream alone.
"""

from __future__ import annotations

from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel

_THREADS, _MOST_BLOCKS = 128, 32


@cuda_kernel
def copy_words(words, words_out):
    """Copy int32 numbers (n,)."""
    for i in range(cuda.grid(1), len(words), cuda.gridsize(1)):
        words_out[i] = words[i]


def copy_small(values, values_out, stream):
    """Queue the copy between a device array and an array in pinned memory, either way.

    Both are contiguous and have the same number of bytes, a multiple of four.
    """
    if SIMULATED:
        if hasattr(values, "copy_to_host"):
            values.copy_to_host(values_out)
        else:
            values_out.copy_to_device(values)
        return
    words, words_out = _words(values), _words(values_out)
    blocks = min(-(-len(words) // _THREADS), _MOST_BLOCKS)
    copy_words[blocks, _THREADS, stream](words, words_out)


def _words(array):
    """Return the memory of a device array or of a pinned one as int32 numbers on the device."""
    on_device = hasattr(array, "__cuda_array_interface__")
    place = array.__cuda_array_interface__["data"][0] if on_device else array.ctypes.data
    return cuda.from_cuda_array_interface(
        {"shape": (array.nbytes // 4,), "typestr": "<i4", "data": (place, False), "version": 3},
        owner=array,
    )
