"""Rain, films and infiltration: what adds to or takes from a cell's water where it stands."""

import numpy as np

from rainsim.jit import cpu_kernel, device_function, prange


@device_function
def soaked(free, film, thirst, store):
    """Return what the ground takes of the free water and of the film, and what the film takes.

    The ground drinks up to `thirst`; then free water fills the film up to `store`. All in depth
    [m], float64.
    """
    from_free = min(thirst, free)
    from_film = min(thirst - from_free, film)
    return from_free, from_film, min(store - (film - from_film), free - from_free)


def drawn_off(h, damp, depth, dry):
    """Return the water and damp that cells keep, and what they gave up to `depth` in all [m].

    Water less deep than `dry` [m] is damp.
    """
    free = h.astype(np.float64) + damp
    stays = np.maximum(free - depth, 0.0)
    h = np.where(stays >= dry, stays, 0.0).astype(h.dtype)
    damp = (stays - h).astype(damp.dtype)
    return h, damp, float((free - (h.astype(np.float64) + damp)).sum())


@cpu_kernel
def soak(tiles, rain, infiltration, storage, dt, dry, h_out, damp_out, film_out, infiltrated_out):
    """Add rain, let the ground drink, fill the film; the rest flows.

    All sums are float64, so that rain far below the rounding of `h` is not lost.

    Parameters
    ----------
    tiles : ndarray of shape (tiles, 4), int64
        First and last row + 1, first and last column + 1 of each tile to treat.
    rain, infiltration : ndarray of the shape of the maps [m/s]
        Rate that falls, and rate that the ground takes as long as there is water.
    storage : ndarray [m]
        Depth held back in the cell.
    dt : float [s]
    dry : float [m]
        Depths below do not flow.
    h_out, damp_out, film_out : ndarray [m]
        Flowing depth, its remainder and the held film; modified in place.
    infiltrated_out : ndarray of shape (tiles,), float64 [m]
        Depth taken by the ground, summed over each tile.
    """
    for t in prange(tiles.shape[0]):
        drunk = 0.0
        west, east = tiles[t, 2], tiles[t, 3]
        for j in range(tiles[t, 0], tiles[t, 1]):
            fall, takes, store = (
                rain[j, west:east],
                infiltration[j, west:east],
                storage[j, west:east],
            )
            h, damp, films = h_out[j, west:east], damp_out[j, west:east], film_out[j, west:east]
            for c in range(east - west):
                free = np.float64(h[c]) + np.float64(damp[c]) + dt * fall[c]
                film = np.float64(films[c])
                from_free, from_film, held = soaked(free, film, dt * takes[c], store[c])
                drunk += from_free + from_film
                films[c] = film - from_film + held
                # What the film's type cannot represent stays with the free water.
                held = np.float64(films[c]) - (film - from_film)
                free -= from_free + held
                h[c] = free if free >= dry else 0.0
                damp[c] = free - np.float64(h[c])
        infiltrated_out[t] = drunk


@cpu_kernel
def tally(tiles, h, damp, film, ground_out, film_out, least_out):
    """Sum up what stands in each of `tiles`.

    Parameters
    ----------
    tiles : ndarray of shape (tiles, 4), int64
    h, damp, film : ndarray of the shape of the maps [m]
    ground_out, film_out : ndarray of shape (tiles,), float64 [m]
        Sums of flowing water with its remainder, and of the held film.
    least_out : ndarray of shape (tiles,), float64 [m]
        Smallest depth, film included.
    """
    for t in prange(tiles.shape[0]):
        ground, held = 0.0, 0.0
        west, east = tiles[t, 2], tiles[t, 3]
        lows = np.full(east - west, np.inf)  # a minimum along the row would be taken cell by cell
        for j in range(tiles[t, 0], tiles[t, 1]):
            d, rest, films = h[j, west:east], damp[j, west:east], film[j, west:east]
            for c in range(east - west):
                ground += np.float64(d[c]) + np.float64(rest[c])
            for c in range(east - west):
                held += np.float64(films[c])
            for c in range(east - west):
                free = np.float64(d[c]) + np.float64(rest[c])
                lows[c] = min(lows[c], free + np.float64(films[c]))
        ground_out[t], film_out[t], least_out[t] = ground, held, lows.min()
