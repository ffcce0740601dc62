"""The GPU that kernels are compiled for: its compute capability, and what compiles for it.

Nothing here imports numba or makes a context on the device.
"""

import ctypes
import os
from importlib import metadata
from importlib.util import find_spec

# Set, to a compute capability such as 9.0, in processes that compile for a GPU and use none.
CAPABILITY = "RAINSIM_CUDA_CAPABILITY"
# What makes machine code beside numba-cuda; the sort of splats is cuda-cccl's.
TOOLKIT = ("nvidia-nvvm", "nvidia-cuda-nvrtc", "nvidia-nvjitlink", "cuda-cccl")
_MAJOR, _MINOR = 75, 76  # of the compute capability, among the attributes of a device


def compiles_for():
    """Return the compute capability that this process compiles for without a GPU, or None."""
    text = os.environ.get(CAPABILITY)
    return tuple(map(int, text.split("."))) if text else None


def capability():
    """Return the first GPU's compute capability as text, asked of the driver; None without."""
    if os.environ.get("NUMBA_ENABLE_CUDASIM") == "1" or find_spec("numba_cuda") is None:
        return None
    found = ctypes.c_int(), ctypes.c_int(), ctypes.c_int()
    device, *parts = found
    try:
        cuda = driver()
        faults = [cuda.cuInit(0), cuda.cuDeviceGet(ctypes.byref(device), 0)]
        for part, attribute in zip(parts, (_MAJOR, _MINOR), strict=True):
            faults.append(cuda.cuDeviceGetAttribute(ctypes.byref(part), attribute, device))
    except (OSError, AttributeError):
        return None
    return None if any(faults) else ".".join(str(part.value) for part in parts)


def driver():
    """Return NVIDIA's driver; OSError without."""
    return ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")


def versions(capability):
    """Return what machine code for a compute capability, a text, depends on, as texts; or []."""
    if not capability:
        return []
    found = [f"{name} {_version(name)}" for name in ("numba-cuda", *TOOLKIT)]
    return [f"capability {capability}", *found]


def _version(distribution):
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:  # the toolkit may be the system's
        return None
