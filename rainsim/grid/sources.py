"""Rain, films and infiltration: what adds to or takes from a cell's water where it stands."""

import numpy as np

from rainsim.grid.paper import split_depth
from rainsim.jit import cpu_kernel, prange


@cpu_kernel
def soak(rain, infiltration, storage, dt, dry, h_out, damp_out, film_out, infiltrated_out):
    """Add rain, let the ground drink, fill the film; the rest flows.

    All sums are float64, so that rain far below the rounding of `h` is not lost.

    Parameters
    ----------
    rain, infiltration : ndarray of shape (ny, nx) [m/s]
        Rate that falls, and rate that the ground takes as long as there is water.
    storage : ndarray of shape (ny, nx) [m]
        Depth held back in the cell.
    dt : float [s]
    dry : float [m]
        Depths below do not flow.
    h_out, damp_out, film_out : ndarray of shape (ny, nx) [m]
        Flowing depth, its remainder and the held film; modified in place.
    infiltrated_out : ndarray of shape (ny,), float64 [m]
        Depth taken by the ground, summed over each row.
    """
    ny, nx = h_out.shape
    for j in prange(ny):
        drunk = 0.0
        for i in range(nx):
            free = np.float64(h_out[j, i]) + np.float64(damp_out[j, i]) + dt * rain[j, i]
            film = np.float64(film_out[j, i])
            thirst = dt * infiltration[j, i]
            from_free = min(thirst, free)
            from_film = min(thirst - from_free, film)
            drunk += from_free + from_film
            held = min(storage[j, i] - (film - from_film), free - from_free)
            film_out[j, i] = film - from_film + held
            # What the film's type cannot represent stays with the free water.
            held = np.float64(film_out[j, i]) - (film - from_film)
            split_depth(j, i, free - from_free - held, dry, h_out, damp_out)
        infiltrated_out[j] = drunk
