"""Rain, films, infiltration and drains on a CUDA device: twin of `rainsim.water.sources`.

Drops that are deposited wait as whole numbers, so that their order does not matter, until the
sources are applied for no time. A cell drains or its ground takes water, not both.
"""

from typing import NamedTuple

import numpy as np

from rainsim.constants import ZERO
from rainsim.cuda.driver import SentRows, fetch
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.cuda.moving_map import MovingMap, joined
from rainsim.cuda.water.flow import (
    HEIGHT,
    LEAD,
    SIDE,
    SQUARE,
    STRIPE,
    UNIT,
    Layout,
    block_sum,
    blocks_of_cells,
)
from rainsim.errors import ParameterError
from rainsim.water.conserving import PAD
from rainsim.water.inputs import field
from rainsim.water.sources import DRY_DEPTH, drain_cells, infiltrate_and_fill

SUMS = 5  # of each block, float64 [m], of drops in UNIT
DRUNK, DRAINED, DROPPED, GROUND, FILM = range(SUMS)


class Soil(NamedTuple):
    """Flat maps of the ground, as the device has them.

    exposure : Share of the rain that falls here.
    infiltration : [m/s]. Rate that the ground takes; negative: rate that a drain
        takes.
    storage : [m]. Depth held back.
    """

    exposure: object
    infiltration: object
    storage: object


@cuda_kernel
def apply_sources(
    soil: Soil, layout: Layout, parity, rate, dt, w_out, remainder_out, film_out, waiting_out,
    depth_out, sums_out,
):  # fmt: skip
    """Add rain, take losses and fill the films, then sum up; see `water.sources.apply_sources`.

    dt : float [s]. If 0 the drops that wait are added; if negative nothing is
        done but the sums and the depth.
    waiting_out : int64 device array (cells,). Depth of drops, in UNIT; blanked
        where they are added.
    depth_out : float32 device array (ny - 4, nx - 4) [m]. Depth above the bed,
        film included.
    sums_out : float64 device array (SUMS, blocks). Taken by the ground and by
        drains; drops added; water that can flow and films.
    """
    exposure, infiltration, storage = soil.exposure, soil.infiltration, soil.storage
    ny, nx, pitch = layout.ny, layout.nx, layout.pitch
    room = cuda.shared.array(SQUARE, np.float64)
    i = cuda.blockIdx.x * SIDE + cuda.threadIdx.x + PAD
    first = (cuda.blockIdx.y * HEIGHT + cuda.threadIdx.y) * STRIPE + PAD
    plane = 3 * parity * (ny + 1) * pitch
    infiltrated, drained, dropped, ground, films = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(first, min(first + STRIPE, ny - PAD)):
        if i >= nx - PAD:
            continue
        at = j * pitch + i + LEAD
        value, remainder, kept = w_out[plane + at], remainder_out[at], film_out[at]
        if dt == 0.0 and waiting_out[at] != 0:
            drops = np.float64(waiting_out[at])
            waiting_out[at] = 0
            dropped += drops
            remainder += np.float32(drops * UNIT)
        if dt >= 0.0:
            film = np.float64(kept)
            free = np.float64(value) + np.float64(remainder) + dt * np.float64(rate * exposure[at])
            loss = dt * np.float64(infiltration[at])
            from_free, from_film, held = infiltrate_and_fill(
                free, film, max(loss, 0.0), np.float64(storage[at])
            )
            infiltrated += from_free + from_film
            kept = np.float32(film - from_film + held)
            free -= from_free + (np.float64(kept) - (film - from_film))
            stays = free - min(-loss, free) if loss < 0.0 else free
            value = np.float32(stays) if stays >= DRY_DEPTH else ZERO
            remainder = np.float32(stays - np.float64(value))
            if loss < 0.0:
                drained += free - np.float64(value) - np.float64(remainder)
            w_out[plane + at], remainder_out[at], film_out[at] = value, remainder, kept
        ground += np.float64(value) + np.float64(remainder)
        films += np.float64(kept)
        depth_out[j - PAD, i - PAD] = kept + (value + remainder)
    block = cuda.blockIdx.y * cuda.gridDim.x + cuda.blockIdx.x
    lane = cuda.threadIdx.y * SIDE + cuda.threadIdx.x
    infiltrated, drained = block_sum(room, lane, infiltrated), block_sum(room, lane, drained)
    dropped, ground = block_sum(room, lane, dropped), block_sum(room, lane, ground)
    films = block_sum(room, lane, films)
    if lane == 0:
        sums_out[DRUNK, block], sums_out[DRAINED, block] = infiltrated, drained
        sums_out[DROPPED, block], sums_out[GROUND, block] = dropped, ground
        sums_out[FILM, block] = films


@cuda_kernel
def add_drops(count, places, depths, waiting_out):
    """Let drops of some depths, in UNIT, wait in cells."""
    for n in range(cuda.grid(1), count, cuda.gridsize(1)):
        cuda.atomic.add(waiting_out, places[n], depths[n])


class DeviceSources:
    """The sources of a `DeviceLeanFlow`: what `Sources` has, on the device.

    exposure : float32 array (ny, nx), optional. Share of the rain that falls on
        each cell; that of `given` by default.
    waiting : int64 device array. Depth of drops that were deposited since, in UNIT.
    depth : float32 device array (ny, nx) [m]. Depth above the bed, film included,
        as of the last `apply` or `standing`.
    """

    def __init__(self, flow, given, exposure=None):
        self._flow, self._area = flow, flow._spacing**2
        self.drains, self.storage, self.infiltration = (
            given.drains, given.storage, given.infiltration
        )  # fmt: skip
        self.has_storage, self.has_losses = given.has_storage, given.has_losses
        shape = flow.layout.ny - 2 * PAD, flow.layout.nx - 2 * PAD
        exposure = given.exposure if exposure is None else exposure
        self.exposure = np.ones(shape, np.float32) if exposure is None else exposure
        self.exposure = np.asarray(self.exposure, np.float32)
        maps = np.zeros_like(self.storage), self._taken(), self.storage
        self._soil = Soil(*map(flow.sent, maps))
        self.waiting = cuda.to_device(np.zeros((flow.layout.ny + 1) * flow.layout.pitch, np.int64))
        self.depth = cuda.to_device(np.zeros(shape, np.float32))
        self._blocks = blocks_of_cells(flow.layout)
        sums = SUMS, self._blocks[0] * self._blocks[1]
        self._sums = cuda.to_device(np.zeros(sums))
        self._places, self._drops = SentRows((), np.int64), SentRows((), np.int64)
        west = LEAD + PAD
        there = self._soil.exposure.reshape(-1, flow.layout.pitch)
        there = there[PAD : PAD + shape[0], west : west + shape[1]]
        self._map, self._share, self.exposed = MovingMap(there), None, 0.0
        self._film, self._is_ahead = np.zeros_like(given.film), False
        self._set_rain(0.0, self.exposure)
        self.unbooked_time = 0.0

    def _taken(self):
        """Return the rate [m/s] at which each cell's ground takes water; negative: its drain does.

        Raises ParameterError if a drain lies in ground that takes water by itself.
        """
        takes = self.infiltration.copy()
        for row, column, rate in zip(*self.drains, strict=True):
            if takes[row + PAD, column + PAD] > 0:
                raise ParameterError(
                    f"the drain in cell ({row}, {column}) lies in ground that takes water by "
                    'itself; a CUDA device has no such drains; use backend "cpu"'
                )
            takes[row + PAD, column + PAD] -= rate / self._area
        return takes

    # -- rain --------------------------------------------------------------------------------------

    def _as_rate(self, rain):
        """Return rain as one rate [m/s] and the share of it that falls on each cell."""
        rain = field("rain", rain, self.exposure.shape if np.ndim(rain) else ())
        if rain.ndim:
            return 1.0, (rain * self.exposure).astype(np.float32)
        return float(rain), self.exposure

    def _set_rain(self, rate, share):
        self._rate = np.float32(rate)
        if share is not self._share:
            self._map.send(share, [], share)
            self._share, self.exposed, self._most = share, _sum_of(share), share.max()

    def set_rain(self, rain):
        """Set the rain from a rate or a map of rates of shape (ny, nx) [m/s]."""
        self._set_rain(*self._as_rate(rain))

    def shelter(self, share, windows):
        """Let less of a rain of one rate fall on some windows, and on no other cells.

        share : float32 array (ny, nx). In place of `exposure`.
        windows : list of tuple of slice. Rows and columns.
        """
        kept_off = (_sum_of(self.exposure[w]) - _sum_of(share[w]) for w in joined(windows))
        self._set_rain(self._rate, self.exposure)
        self.exposed = _sum_of(self.exposure) - sum(kept_off)
        self._map.send(share, windows, self.exposure)

    @property
    def rain(self):
        """Rain rates, ndarray of shape (ny, nx) [m/s]."""
        return self._rate * self._share

    def is_rain(self, rain):
        """Whether the rain [m/s] is that already."""
        rate, share = self._as_rate(rain)
        if share is self._share:
            return np.float32(rate) == self._rate
        return bool((self.rain == np.float32(rate) * share).all())

    @property
    def rain_sum(self):
        """Rates of the rain, summed over the cells [m/s]."""
        return float(self._rate) * self.exposed

    def most_rain(self):
        """Return the largest rate of the rain [m/s], where nothing shelters."""
        return float(self._rate * self._most)

    # -- what is done to the water -----------------------------------------------------------------

    def are_idle(self):
        """Whether they would change no number: no rain, and nothing takes water."""
        return self.rain_sum == 0.0 and not self.has_losses

    def apply(self, ledger, dt, everywhere):
        """Add drops that wait, if `dt` is 0, or the rain of `dt` [s]; take losses, book both."""
        with self._flow.launching():
            self._launch(dt)
            self._is_ahead = True
        taken, drained, dropped, *_ = fetch(self._sums).sum(axis=1)
        ledger.rain += (self.rain_sum * dt + float(dropped) * UNIT) * self._area
        ledger.infiltrated += float(taken) * self._area
        ledger.drained += float(drained) * self._area
        self._flow.note_sources(everywhere)

    def _launch(self, dt):
        flow = self._flow
        apply_sources[self._blocks, (SIDE, HEIGHT)](
            self._soil, flow.layout, flow.parity, self._rate, float(dt), flow.fields,
            flow.remainder, self.film_there, self.waiting, self.depth, self._sums,
        )  # fmt: skip
        flow.has_changed = False

    def standing(self):
        """Return the water that can flow and that in films [m], each summed; set `depth`."""
        if self._flow.has_changed:
            if self._flow.strip is not None:
                self._flow.strip.send()
            self._launch(-1.0)
        return fetch(self._sums)[GROUND:].sum(axis=1).tolist()

    def deposit(self, rows, columns, volumes):
        """Let drops of some volumes [m3] wait in cells."""
        depth = np.rint(np.asarray(volumes, np.float64) / (self._area * UNIT)).astype(np.int64)
        places = self._places.send(self._flow.places(rows, columns))
        count, depths = len(depth), self._drops.send(depth)
        add_drops[-(-count // SQUARE), SQUARE](count, places, depths, self.waiting)

    def drain(self, rows, columns, volumes):
        """Take up to `volumes` [m3] of free water from cells; return the volume taken [m3]."""
        flow, cells = self._flow, self._flow.places(rows, columns)
        h, remainder = flow.present(0).copy_to_host(), flow.remainder.copy_to_host()
        h[cells], remainder[cells], taken = drain_cells(
            h[cells], remainder[cells], volumes / self._area, DRY_DEPTH
        )
        with flow.launching():
            flow.present(0).copy_to_device(h)
            flow.remainder.copy_to_device(remainder)
        return taken * self._area

    # -- state -------------------------------------------------------------------------------------

    @property
    def film(self):
        """Depth held back in each cell on the host [m], with ghosts; see `DeviceLeanFlow.water`."""
        if self._is_ahead and not self._flow.is_by_strip:
            self._flow.bring(self.film_there.copy_to_host(), self._film)
            self._is_ahead = False
        return self._film

    def restore(self, arrays):
        """Take over film and rain of a saved state."""
        self._film[:], self._is_ahead = arrays["film"], False
        self.film_there = self._flow.sent(self._film)
        rain = np.array(arrays["rain"], np.float32)
        self._set_rain(*(1.0, rain) if rain.any() else (0.0, self.exposure))


def _sum_of(share):
    return float(share.sum(dtype=np.float64))
