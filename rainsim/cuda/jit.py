"""Compiler options and intrinsics of the CUDA twins: the only module that names either.

`cuda_kernel` keeps NaN and infinity, as the CPU kernels do; `fast_kernel` assumes there are none.
In numba's simulator the intrinsics are plain Python. The simulator has no warp instructions, so
kernels that use them have a second version without.
"""

import os

import numpy as np

from rainsim.cuda import require
from rainsim.jit import CACHE_FOLDER, KERNELS

require()

from numba import cuda, types  # noqa: E402

SIMULATED = bool(cuda.config.ENABLE_CUDASIM)
if not SIMULATED:
    from rainsim.cuda.kernel_cache import CudaKernelCache
    from rainsim.cuda.launch import LaunchedKernel
# Small maps and pictures are legitimate, so numba must not warn of low occupancy. Numba reads the
# environment again when it changes, so the variable is set too.
os.environ["NUMBA_CUDA_LOW_OCCUPANCY_WARNINGS"] = "0"
cuda.config.CUDA_LOW_OCCUPANCY_WARNINGS = 0
FULL = 0xFFFFFFFF  # all lanes of a warp


def _kernel(**options):
    def decorate(function):
        kernel = cuda.jit(**options)(function)
        if not SIMULATED:
            folder = CACHE_FOLDER / function.__module__
            kernel._cache = CudaKernelCache(function, folder, str(options))
            KERNELS[kernel._cache.kernel_name] = kernel
            return LaunchedKernel(kernel)
        return kernel

    return decorate


cuda_kernel = _kernel()
fast_kernel = _kernel(fastmath=True)
# Fewer registers a thread than the compiler would use, so that more warps are resident at once.
_TIGHT = {} if SIMULATED else {"max_registers": 96}
tight_kernel = _kernel(fastmath=True, **_TIGHT)
# For functions that only the twins' kernels call. Formulas shared with the CPU need no decorator
# from here.
_INLINED = {} if SIMULATED else {"forceinline": True}
cuda_device = cuda.jit(device=True)


def fast_device(function):
    """Mark a function of the device that is compiled into its callers, without NaN."""
    options = {"fastmath": True, **_INLINED}
    function.compiler_options = str(options)  # part of its users' keys in the cache
    return cuda.jit(device=True, **options)(function)


if SIMULATED:

    @cuda.jit(device=True)
    def load4(array, i):
        """Return the four numbers of a float32 array from index i on, a multiple of 4."""
        return array[i], array[i + 1], array[i + 2], array[i + 3]

    @cuda.jit(device=True)
    def store4(array, i, x, y, z, w):
        """Store four numbers in a float32 array from index i on, a multiple of 4."""
        array[i], array[i + 1], array[i + 2], array[i + 3] = x, y, z, w

    @cuda.jit(device=True)
    def load_halves(array, i):
        """Return eight numbers of a float16 array from index i on, a multiple of 8, as float32."""
        return tuple(np.float32(array[i + k]) for k in range(8))

else:
    from llvmlite import ir
    from numba.cuda import cgutils
    from numba.cuda.extending import intrinsic

    _FLOAT = ir.FloatType()
    _FOUR = ir.VectorType(_FLOAT, 4)
    _HALVES, _WORDS = ir.VectorType(ir.HalfType(), 8), ir.VectorType(ir.IntType(32), 4)

    def _place(context, builder, kind, array, index):
        data = cgutils.create_struct_proxy(kind)(context, builder, array).data
        return builder.bitcast(builder.gep(data, [index]), _FOUR.as_pointer())

    @intrinsic
    def load4(typingctx, array, i):
        """Return the four numbers of a float32 array from index i on, a multiple of 4."""

        def codegen(context, builder, signature, arguments):
            place = _place(context, builder, signature.args[0], arguments[0], arguments[1])
            four = builder.load(place)
            four.align = 16
            numbers = [builder.extract_element(four, ir.IntType(32)(k)) for k in range(4)]
            return context.make_tuple(builder, signature.return_type, numbers)

        return types.UniTuple(types.float32, 4)(array, types.int64), codegen

    @intrinsic
    def load_halves(typingctx, array, i):
        """Return eight numbers of a float16 array from index i on, a multiple of 8, as float32."""

        def codegen(context, builder, signature, arguments):
            place = _place(context, builder, signature.args[0], arguments[0], arguments[1])
            eight = builder.load(builder.bitcast(place, _WORDS.as_pointer()))
            eight.align = 16
            eight = builder.bitcast(eight, _HALVES)
            numbers = [
                builder.fpext(builder.extract_element(eight, ir.IntType(32)(k)), _FLOAT)
                for k in range(8)
            ]
            return context.make_tuple(builder, signature.return_type, numbers)

        return types.UniTuple(types.float32, 8)(array, types.int64), codegen

    @intrinsic
    def store4(typingctx, array, i, x, y, z, w):
        """Store four numbers in a float32 array from index i on, a multiple of 4."""

        def codegen(context, builder, signature, arguments):
            four = ir.Constant(_FOUR, ir.Undefined)
            for k in range(4):
                four = builder.insert_element(four, arguments[2 + k], ir.IntType(32)(k))
            place = _place(context, builder, signature.args[0], arguments[0], arguments[1])
            builder.store(four, place).align = 16
            return context.get_dummy_value()

        x = types.float32
        return types.void(array, types.int64, x, x, x, x), codegen


if not SIMULATED:
    import rainsim.cuda.scalars  # noqa: F401  (numpy's functions of numbers, for CUDA)

__all__ = [
    "CACHE_FOLDER",
    "FULL",
    "SIMULATED",
    "cuda",
    "cuda_device",
    "cuda_kernel",
    "fast_device",
    "fast_kernel",
    "load4",
    "load_halves",
    "store4",
    "tight_kernel",
]
