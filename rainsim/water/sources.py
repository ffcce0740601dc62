"""Rain, films, infiltration and drains: gains and losses of each cell by itself."""

import numpy as np

from rainsim.jit import cpu_kernel, device_function, prange


@device_function
def infiltrate_and_fill(free, film, demand, store):
    """Return the losses of free water and of film to the ground, and the water that fills the film.

    The ground takes up to `demand`, first from the free water; then free water fills the film up
    to `store`. All are depths [m], float64.
    """
    from_free = min(demand, free)
    from_film = min(demand - from_free, film)
    return from_free, from_film, min(store - (film - from_film), free - from_free)


def drain_cells(h, remainder, depth, dry):
    """Take up to `depth` [m] from each of some cells.

    Parameters
    ----------
    h, remainder : ndarray of shape (n,) [m]
        Flowing depth of the cells and its remainder.
    depth : ndarray of shape (n,) [m]
    dry : float [m]
        Water less deep is all remainder.

    Returns
    -------
    h, remainder : ndarray of shape (n,) [m]
        What the cells keep.
    taken : float [m]
        Summed over the cells.
    """
    free = h.astype(np.float64) + remainder
    stays = np.maximum(free - depth, 0.0)
    h = np.where(stays >= dry, stays, 0.0).astype(h.dtype)
    remainder = (stays - h).astype(remainder.dtype)
    return h, remainder, float((free - (h.astype(np.float64) + remainder)).sum())


def lift_cells(h, remainder, film, left, area, dry):
    """Take the water of some cells down to a depth of `left` [m], the film's last.

    Parameters
    ----------
    h, remainder, film : ndarray of shape (n,) [m]
        Flowing depth of the cells, its remainder and what is held back.
    left : float [m]
    area : float [m2]
        Of a cell.
    dry : float [m]
        Water less deep is all remainder.

    Returns
    -------
    h, remainder, film : ndarray of shape (n,) [m]
        What the cells keep.
    taken : float [m3]
        Summed over the cells.
    """
    held = film.astype(np.float64)
    keeps = np.minimum(held, left)
    free = h.astype(np.float64) + remainder
    from_free = np.maximum(free - (left - keeps), 0.0) * area
    h, remainder, taken = drain_cells(h, remainder, from_free / area, dry)
    film = keeps.astype(film.dtype)
    return h, remainder, film, taken * area + float((held - film.astype(np.float64)).sum()) * area


@cpu_kernel
def apply_sources(
    tiles, rain, infiltration, storage, dt, dry, h_out, remainder_out, film_out, infiltrated_out
):
    """Add rain, take infiltration and fill the films; the remaining water flows.

    All sums are float64, so that rain far below the rounding of `h` is not lost.

    Parameters
    ----------
    tiles : ndarray of shape (tiles, 4), int64
        First and last row + 1, first and last column + 1 of each tile to treat.
    rain, infiltration : ndarray of the shape of the maps [m/s]
        Rate of the rain, and rate at which the ground takes water as long as there is some.
    storage : ndarray [m]
        Depth held back in the cell.
    dt : float [s]
    dry : float [m]
        Depths below do not flow.
    h_out, remainder_out, film_out : ndarray [m]
        Flowing depth, its remainder and the held film; modified in place.
    infiltrated_out : ndarray of shape (tiles,), float64 [m]
        Depth taken by the ground, summed over each tile.
    """
    for t in prange(tiles.shape[0]):
        taken = 0.0
        west, east = tiles[t, 2], tiles[t, 3]
        for j in range(tiles[t, 0], tiles[t, 1]):
            fall, takes, store = (
                rain[j, west:east],
                infiltration[j, west:east],
                storage[j, west:east],
            )
            h, extra, films = (
                h_out[j, west:east],
                remainder_out[j, west:east],
                film_out[j, west:east],
            )
            for c in range(east - west):
                free = np.float64(h[c]) + np.float64(extra[c]) + dt * fall[c]
                film = np.float64(films[c])
                from_free, from_film, held = infiltrate_and_fill(
                    free, film, dt * takes[c], store[c]
                )
                taken += from_free + from_film
                films[c] = film - from_film + held
                # What the film's type cannot represent stays with the free water.
                held = np.float64(films[c]) - (film - from_film)
                free -= from_free + held
                h[c] = free if free >= dry else 0.0
                extra[c] = free - np.float64(h[c])
        infiltrated_out[t] = taken


@cpu_kernel
def sum_tiles(tiles, h, remainder, film, ground_out, film_out, least_out):
    """Sum up the water that stands in each of `tiles`.

    Parameters
    ----------
    tiles : ndarray of shape (tiles, 4), int64
    h, remainder, film : ndarray of the shape of the maps [m]
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
            d, extra, films = h[j, west:east], remainder[j, west:east], film[j, west:east]
            for c in range(east - west):
                ground += np.float64(d[c]) + np.float64(extra[c])
            for c in range(east - west):
                held += np.float64(films[c])
            for c in range(east - west):
                free = np.float64(d[c]) + np.float64(extra[c])
                lows[c] = min(lows[c], free + np.float64(films[c]))
        ground_out[t], film_out[t], least_out[t] = ground, held, lows.min()
