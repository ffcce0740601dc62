"""The renderer and the simulation of each backend: the only module that imports both backends."""

from rainsim.errors import require_choice
from rainsim.render.renderer import Renderer
from rainsim.simulation import simulate

BACKENDS = ("cpu", "cuda")


def on_backend(backend):
    """Return the renderer class and the `simulate` of a backend, or raise with the remedy."""
    require_choice("backend", backend, BACKENDS)
    if backend == "cpu":
        return Renderer, simulate
    from rainsim.cuda import require

    require()
    from rainsim.cuda.render.renderer import Renderer as OnGpu
    from rainsim.cuda.simulation import simulate as simulate_on_gpu

    return OnGpu, simulate_on_gpu


def free_device_memory(backend):
    """Return the free bytes of the GPU that a backend draws on; None for the CPU."""
    if backend == "cpu":
        return None
    from rainsim import cuda

    return cuda.free_memory()
