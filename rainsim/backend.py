"""What draws and what simulates on each backend: the one place that knows both."""

from __future__ import annotations

from rainsim.errors import require_choice
from rainsim.render import Renderer
from rainsim.simulation import simulate

BACKENDS = ("cpu", "cuda")


def on_backend(backend):
    """Return the class that draws frames on a backend, and the function that simulates there.

    Raises
    ------
    ParameterError
        If there is no such backend.
    BackendError
        If it cannot run here; the message names the remedy.
    """
    require_choice("backend", backend, BACKENDS)
    if backend == "cpu":
        return Renderer, simulate
    from rainsim.cuda import require

    require()
    from rainsim.cuda.frame import Renderer as OnGpu
    from rainsim.cuda.simulate import simulate as simulate_on_gpu

    return OnGpu, simulate_on_gpu
