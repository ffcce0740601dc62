"""The machine code of CUDA kernels on disk, kept as that of the CPU's, and made without a GPU.

numba-cuda keys its own cache on the file that holds a kernel and its time, not on the functions
that the kernel calls.
"""

import hashlib
import inspect
import os
from pathlib import Path
from types import SimpleNamespace

import numba_cuda
from numba.cuda import api, dispatcher, utils
from numba.cuda.cudadrv import devices
from numba.cuda.dispatcher import CUDACache, CUDACacheImpl

from rainsim.compiling.gpu import compiles_for
from rainsim.compiling.kernel_cache import KEPT_VERSIONS, KeptKernel

_VARIANTS = 4  # of a kernel that a function makes: `splatting.blend`
# What numpy's functions are for CUDA is found by numba alone: it stands in no kernel's byte code.
_FORMULAS = hashlib.sha256(Path(__file__).with_name("scalars.py").read_bytes()).hexdigest()


class _Implementation(CUDACacheImpl):
    """numba-cuda's serialisation of machine code, with the files at a place of ours."""

    def __init__(self, function, locator):
        self._locator_classes = [locator]  # what is asked for a locator; this one gives itself
        super().__init__(function)

    def reduce(self, kernel):
        """Return what a kernel is loaded from: its machine code, without what that was made of."""
        states = kernel._reduce_states()
        library = states["codelibrary"]
        bare = library._reduce_states() | {"llvm_strs": [], "ptx_cache": {}}
        return states | {"codelibrary": type(library)._rebuild(**bare)}


class CudaKernelCache(KeptKernel, CUDACache):
    """The cache of one CUDA kernel; numba's key has the toolkit's version and the capability."""

    _implementation = _Implementation
    _kept = _VARIANTS * KEPT_VERSIONS
    # No kernel of ours depends on how it is launched.
    _launch_config_key, _launch_config_sensitive_flag = None, False
    _launch_config_marker_path = os.devnull

    def __init__(self, function, place, options):
        options = f"{options} numba-cuda {numba_cuda.__version__} {_FORMULAS}"
        super().__init__(function, place, options)
        made_for = inspect.getclosurevars(function).nonlocals
        if made_for:  # one of several that a function makes
            self.kernel_name += str(sorted(made_for.items()))

    def load_overload(self, sig, target_context):
        """Return the machine code for a signature, None if there is none on disk."""
        with utils.numba_target_override():
            return super().load_overload(sig, target_context)


def leave_the_device_alone(capability):
    """Compile for a compute capability from now on; kernels cannot run in this process.

    numba-cuda asks the context of a device for the capability, and loads what it has compiled.
    """
    context = SimpleNamespace(device=SimpleNamespace(compute_capability=capability))
    devices.get_context = api.current_context = lambda number=None: context
    dispatcher._Kernel.bind = lambda kernel: kernel._codelibrary.get_cubin()


if compiles_for():
    leave_the_device_alone(compiles_for())
