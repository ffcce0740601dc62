"""Twins of the hot loops for NVIDIA GPUs: `--backend cuda`.

Optional: `pip install "rainsim[cuda]"` and a driver. These modules are imported only for the
backend "cuda". Where it cannot run, an error names what is missing; there is no fallback to the
CPU.

A twin stands at the path of its CPU module, calls the same scalar formulas and differs in how the
work is shared out. `rainsim.cuda.render.renderer` puts the kernels of a frame into queues that run
on the device until the picture is finished.
"""

import importlib.util
import os

from rainsim.compiling.gpu import compiles_for
from rainsim.errors import BackendError

REMEDY = 'pip install "rainsim[cuda]"'


def simulated():
    """Return whether numba's CUDA simulator stands in for the GPU (NUMBA_ENABLE_CUDASIM=1)."""
    return os.environ.get("NUMBA_ENABLE_CUDASIM") == "1"


def trouble():
    """Return why the CUDA backend cannot run here, with the remedy; None if it can."""
    if simulated():
        return None
    needs = ("numba_cuda", "cuda.compute")
    for package in needs[:1] if compiles_for() else needs:
        if not _is_installed(package):
            name = {"numba_cuda": "numba-cuda", "cuda.compute": "cuda-cccl"}[package]
            return f"{name} is not installed; {REMEDY}"
    if compiles_for():
        return None
    import numba.cuda as numba_cuda

    try:
        import cuda.compute  # noqa: F401
    except Exception as error:  # its libraries raise errors of their own kinds while they load
        return f"cuda.compute of cuda-cccl does not load ({error}); {REMEDY}"
    try:
        devices = len(numba_cuda.list_devices())
    except Exception as error:
        first = str(error).strip().splitlines() or [type(error).__name__]
        return f"no CUDA driver answers ({first[0]}); install NVIDIA's driver, or take backend cpu"
    if devices == 0:
        return "the CUDA driver finds no GPU; take backend cpu"
    return None


def _is_installed(package):
    try:
        return importlib.util.find_spec(package) is not None
    except ImportError:  # of the package that it lies in
        return False


def require():
    """Raise BackendError unless kernels can run on a GPU (or in the simulator)."""
    found = trouble()
    if found is not None:
        raise BackendError(f"backend is 'cuda', but {found}")


def gpus():
    """Return the number of GPUs of this machine, at least 1."""
    from numba import cuda

    return max(len(cuda.gpus), 1)


def device():
    """Return name, compute capability and memory [bytes] of the GPU in use, as a dict."""
    from numba import cuda

    chosen = cuda.get_current_device()
    free, total = (0, 0) if simulated() else cuda.current_context().get_memory_info()
    name = chosen.name.decode() if isinstance(chosen.name, bytes) else str(chosen.name)
    capability = ".".join(map(str, chosen.compute_capability))
    return {"name": name, "capability": capability, "free": int(free), "total": int(total)}


def free_memory():
    """Return the free bytes of the GPU in use; the simulator's is as large as the machine's."""
    if simulated():
        from rainsim.compiling import pool

        return pool.free_memory()
    return device()["free"]
