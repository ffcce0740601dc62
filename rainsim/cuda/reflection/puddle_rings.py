"""Twin of `reflection.puddle_rings`: rings where shores are near, a thread for each block."""

from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.reflection.puddle_rings import ring_amplitude, wet_share


@cuda_kernel
def share_wet(depth, mirrors, wet_out):
    """Write the share of each block's cells that carry rings."""
    i, j = cuda.grid(2)
    rows, columns = wet_out.shape
    if j < rows and i < columns:
        wet_out[j, i] = wet_share(depth, mirrors, j, i)


@cuda_kernel
def spread_rings(wet, reach, rings_out):
    """Write the amplitude of rings in each block."""
    i, j = cuda.grid(2)
    rows, columns = wet.shape
    if j < rows and i < columns:
        rings_out[j, i] = ring_amplitude(wet, reach, j, i)
