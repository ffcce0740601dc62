"""Rain, films, infiltration and drains: gains and losses of each cell by itself."""

import numpy as np

from rainsim.jit import cpu_kernel, device_function, prange
from rainsim.water.inputs import field

DRY_DEPTH = 1e-6  # m, below this water does not flow (RainyGS supplement, step 2)


class Sources:
    """The rain on a map, its films, and what its ground and its drains take.

    storage, infiltration : array (ny, nx) [m], [m/s]
    drains : tuple of ndarray. Rows, columns and rates [m3/s].
    film, storage, infiltration : ndarray of the shape of `flow.water.h` [m], [m],
        [m/s]. Depth held back in each cell, its limit, and what the ground takes.
    drains : tuple of ndarray
    exposure : array (ny, nx) or None. Share of the rain that falls on each cell;
        None for all of it everywhere.
    has_storage, has_losses : bool. Whether cells hold water back, and whether the
        ground or drains take water.
    unbooked_time : float [s]. Of steps whose rain and losses are still to be
        applied.
    """

    def __init__(self, flow, cell_area, storage, infiltration, drains):
        self._flow, self._area, self.drains = flow, cell_area, drains
        self.film, self._rain, self.storage, self.infiltration = (
            np.zeros_like(flow.water.h) for _ in range(4)
        )
        self.storage[flow.inner], self.infiltration[flow.inner] = storage, infiltration
        self.has_storage = bool(storage.any())
        self.has_losses = bool(infiltration.any()) or len(drains[0]) > 0
        self._infiltrated = np.zeros(len(flow.tiles(True)))  # m, in each tile in one step
        self._rain_rate, self.rain_sum, self.unbooked_time = 0.0, 0.0, 0.0
        self.exposure, self._most = None, 0.0

    def set_rain(self, rain):
        """Fill the map of rain rates [m/s] from a number or a map of shape (ny, nx)."""
        if np.ndim(rain) > 0 or rain != self._rain_rate:
            inside = self._rain[self._flow.inner]
            rain_map = field("rain", rain, inside.shape)
            inside[:] = rain_map if self.exposure is None else rain_map * self.exposure
            self.rain_sum = float(self._rain.sum(dtype=np.float64))
            self._most = float(self._rain.max())
            self._rain_rate = rain if np.ndim(rain) == 0 else None

    def shelter(self, share):
        """Let a share (ny, nx) of the rain fall on each cell from the next `set_rain` on."""
        if share is not self.exposure:
            self.exposure, self._rain_rate = share, None

    def restore(self, arrays):
        """Take over film and rain of a saved state."""
        self.film[:] = arrays["film"]
        self.set_rain(arrays["rain"])

    @property
    def rain(self):
        """Rain rates, ndarray of shape (ny, nx) [m/s]; a view."""
        return self._rain[self._flow.inner]

    def is_rain(self, rain):
        """Whether the map of rain rates [m/s] is that already."""
        return (np.ndim(rain) == 0 and rain == self._rain_rate) or bool(
            (self.rain == np.asarray(rain, self._rain.dtype)).all()
        )

    def most_rain(self):
        """Return the largest rate of the rain [m/s]."""
        return self._most

    def are_idle(self):
        """Whether they would change no number: no rain, and nothing that losses could take."""
        if self.rain_sum > 0.0:
            return False
        water = self._flow.water
        return not (self.has_losses and (water.h.any() or water.remainder.any() or self.film.any()))

    def apply(self, ledger, dt, everywhere):
        """Add deposited drops and the rain of `dt` [s] to film and water, take losses, book both.

        Without rain and losses only water that moves can still fill films, unless drops came:
        `everywhere`.
        """
        flow, everywhere = self._flow, everywhere or self.rain_sum > 0.0 or self.has_losses
        tiles, water = flow.tiles(everywhere), flow.water
        infiltrated = self._infiltrated[: len(tiles)]
        apply_sources(
            tiles, self._rain, self.infiltration, self.storage, dt, DRY_DEPTH,
            water.h, water.remainder, self.film, infiltrated,
        )  # fmt: skip
        ledger.rain += self.rain_sum * dt * self._area
        ledger.infiltrated += float(infiltrated.sum()) * self._area
        rows, columns, rates = self.drains
        if len(rows):
            ledger.drained += self.drain(rows, columns, rates * dt)
        flow.note_sources(everywhere)

    def drain(self, rows, columns, volumes):
        """Take up to `volumes` [m3] of free water from cells; return the volume taken [m3]."""
        flow, water = self._flow, self._flow.water
        at = np.asarray(rows) + flow.pad, np.asarray(columns) + flow.pad
        water.h[at], water.remainder[at], taken = drain_cells(
            water.h[at], water.remainder[at], volumes / self._area, DRY_DEPTH
        )
        return taken * self._area


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

    Returns h, remainder : array (n,) [m]. What the cells keep.
        taken : float [m]. Summed over the cells.
    """
    free = h.astype(np.float64) + remainder
    stays = np.maximum(free - depth, 0.0)
    h = np.where(stays >= dry, stays, 0.0).astype(h.dtype)
    remainder = (stays - h).astype(remainder.dtype)
    return h, remainder, float((free - (h.astype(np.float64) + remainder)).sum())


@cpu_kernel
def apply_sources(
    tiles, rain, infiltration, storage, dt, dry, h_out, remainder_out, film_out, infiltrated_out
):
    """Add rain, take infiltration and fill the films; the remaining water flows.

    All sums are float64, so that rain far below the rounding of `h` is not lost.

    rain, infiltration : ndarray of the shape of the maps [m/s]. Rate of the rain,
        and rate at which the ground takes water as long as there is some.
    infiltrated_out : float64 array (tiles,) [m]. Depth taken by the ground,
        summed over each tile.
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

    ground_out, film_out : float64 array (tiles,) [m]. Sums of flowing water with
        its remainder, and of the held film.
    least_out : float64 array (tiles,) [m]. Smallest depth, film included.
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
        for c in range(1, east - west):
            lows[0] = min(lows[0], lows[c])
        ground_out[t], film_out[t], least_out[t] = ground, held, lows[0]
