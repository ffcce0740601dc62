"""Twin of `rainsim.water.tracks`: tracks of tyres in the film of a road, found on a CUDA device.

The device knows since which step a tyre has passed a cell, so that it can show a step as it was
when the next one has begun.
"""

from __future__ import annotations

import numpy as np

from rainsim.cuda.driver import Staging, fetch, to_device
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.shading.wetness import Wetness
from rainsim.terrain.table import class_table
from rainsim.water.tracks import blur_weights, mirrored
from rainsim.water.tyres import LEFT, SHOULDER

BLOCK = (8, 4) if SIMULATED else (32, 8)  # threads, a cell each
THREADS = 8 if SIMULATED else 128
NEVER = 2**31 - 1  # no tyre has passed
FULL = 255
FILM = Wetness._fields.index("film")


@cuda_kernel
def mark(cells, count, step, since_out):
    """Say from which step on tyres have passed cells, unless they had before.

    Parameters
    ----------
    cells : device array of shape (room,), int64
        Rows times nx plus columns.
    count, step : int
    since_out : device array of shape (ny, nx), int32
    """
    n = cuda.grid(1)
    if n < count:
        row, column = cells[n] // since_out.shape[1], cells[n] % since_out.shape[1]
        since_out[row, column] = min(since_out[row, column], step)


@cuda_kernel
def blur_down(first, last, depth, since, step, holds, weights, share_out):
    """Write how full the film is, blurred along the columns; 1 where no tyre has passed.

    Parameters
    ----------
    first, last : tuple of int
        Row and column of the first cell, and of the one behind the last.
    depth : device array of shape (ny, nx), float32 [m]
        Of the water.
    since : device array of shape (ny, nx), int32
        See `mark`.
    step : int
        What tyres have passed since does not count.
    holds : device array of shape (ny, nx), float32 [m]
        Depth of a full film.
    weights : device array of shape (n,), float64
        See `blur_weights`.
    share_out : device array of shape (ny, nx), float32
    """
    i, j = cuda.grid(2)
    i, j = i + first[1], j + first[0]
    if j >= last[0] or i >= last[1]:
        return
    total = 0.0
    for k in range(len(weights) - 1, -len(weights), -1):
        row = mirrored(j + k, depth.shape[0])
        share = np.float32(1)
        if since[row, i] <= step:
            share = min(max(depth[row, i] / holds[row, i], np.float32(0)), share)
        total += weights[abs(k)] * share
    share_out[j, i] = total


@cuda_kernel
def blur_across(first, last, share, weights, tracks_out):
    """Write how full the film is, of FULL, from what `blur_down` has written."""
    i, j = cuda.grid(2)
    i, j = i + first[1], j + first[0]
    if j >= last[0] or i >= last[1]:
        return
    total = 0.0
    for k in range(len(weights) - 1, -len(weights), -1):
        total += weights[abs(k)] * share[j, mirrored(i + k, share.shape[1])]
    tracks_out[j, i] = np.uint8(np.float32(FULL) * np.float32(total) + np.float32(0.5))


@cuda_kernel
def thin_film(first, last, tracks, film, ground_out):
    """Thin the film of the ground under tracks; see `rainsim.shading.wetness.thin_film`.

    Parameters
    ----------
    first, last : tuple of int
        See `blur_down`.
    tracks : device array of shape (ny, nx), uint8
    film : device array of shape (ny, nx), float32
        Of ground that no tyre has passed.
    ground_out : device array of shape (ny, nx, 4), float32
        See `rainsim.shading.wetness.ground_wetness`.
    """
    i, j = cuda.grid(2)
    i, j = i + first[1], j + first[0]
    if j < last[0] and i < last[1]:
        ground_out[j, i, FILM] = film[j, i] * (np.float32(tracks[j, i]) / np.float32(FULL))


class Tracks:
    """Where tyres have passed on a terrain, and how full the film is there.

    Parameters
    ----------
    terrain : Terrain
    passed : ndarray of shape (ny, nx), bool
        Cells that tyres have passed before the first step.
    stream : numba.cuda.stream
        Of the water.
    """

    def __init__(self, terrain, passed, stream):
        self._stream, self._staging, self._shape = stream, Staging(stream), passed.shape
        holds = class_table().column("storage")[terrain.ground_class]
        self._holds = to_device(np.maximum(holds, np.float32(LEFT)).astype(np.float32), stream)
        self._since = to_device(np.where(passed, 0, NEVER).astype(np.int32), stream)
        self._weights = to_device(blur_weights(SHOULDER), stream)
        self._share = to_device(np.ones(passed.shape, np.float32), stream)
        self._tracks = to_device(np.full(passed.shape, FULL, np.uint8), stream)
        self._cells = to_device(np.zeros(0, np.int64), stream)

    def mark(self, rows, columns, step):
        """Queue that tyres pass cells in a step."""
        count = len(rows)
        if count > len(self._cells):
            self._stream.synchronize()
            self._cells = to_device(np.zeros(2 * count, np.int64), self._stream)
        self._staging.send(self._cells[:count], rows * self._shape[1] + columns)
        mark[-(-count // THREADS), THREADS, self._stream](self._cells, count, step, self._since)

    def _lay(self, window, depth, step, stream):
        """Queue the finding of a window's tracks; return how the window's kernels are launched."""
        rows, columns = (slice(*s.indices(n)) for s, n in zip(window, self._shape, strict=True))
        size = columns.stop - columns.start, rows.stop - rows.start
        grid = tuple(-(-n // side) for n, side in zip(size, BLOCK, strict=True)), BLOCK, stream
        cells = (rows.start, columns.start), (rows.stop, columns.stop)
        blur_down[grid](
            *cells, depth, self._since, step, self._holds, self._weights, self._share
        )
        blur_across[grid](*cells, self._share, self._weights, self._tracks)
        return grid, cells

    def thin(self, window, depth, step, film, ground_out, stream):
        """Queue the thinning of the film under the tracks of a step; see `thin_film`.

        Parameters
        ----------
        window : tuple of slice
            Rows and columns about all that tyres have passed.
        depth : device array of shape (ny, nx), float32 [m]
            Of the step's water.
        step : int
        film, ground_out : device array
        stream : numba.cuda.stream
        """
        grid, cells = self._lay(window, depth, step, stream)
        thin_film[grid](*cells, self._tracks, film, ground_out)

    def fetch(self, window, depth, step):
        """Return the tracks of a step on the host, see `Tyres.tracks`; waits for the device."""
        cuda.synchronize()  # another stream may use the same arrays
        self._lay(window, depth, step, self._stream)
        return fetch(self._tracks, self._stream)
