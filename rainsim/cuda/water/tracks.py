"""Twin of `rainsim.water.tracks`: tracks of tyres in the film of a road, found on a CUDA device.

The device knows since which step a tyre has passed a cell, so that it can show a step as it was
when the next one has begun.
"""

from __future__ import annotations

import numpy as np

from rainsim.cuda.driver import Staging, fetch, to_device
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.graph import Repeated
from rainsim.cuda.jit import SIMULATED, cuda, cuda_device, cuda_kernel
from rainsim.shading.wetness import Wetness
from rainsim.terrain.table import class_table
from rainsim.water.tracks import blur_weights, mirrored
from rainsim.water.tyres import LEFT as LEAST
from rainsim.water.tyres import SHOULDER

BLOCK = (8, 4) if SIMULATED else (32, 8)  # threads, a cell each
THREADS = 8 if SIMULATED else 128
NEVER = 2**31 - 1  # no tyre has passed
FULL = 255
FILM = Wetness._fields.index("film")
TOP, LEFT, BOTTOM, RIGHT, STEP = range(5)  # places in a window


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


@cuda_device
def _cell(window):
    """Return row and column of a thread's cell, and whether the window has it; see `blur_down`."""
    i, j = cuda.grid(2)
    return j, i, window[TOP] <= j < window[BOTTOM] and window[LEFT] <= i < window[RIGHT]


@cuda_kernel
def blur_down(window, depth, since, holds, weights, share_out):
    """Write how full the film is, blurred along the columns; 1 where no tyre has passed.

    Parameters
    ----------
    window : device array of shape (5,), int64
        First row and column, those behind the last, and the step: what tyres have passed after it
        does not count.
    depth : device array of shape (ny, nx), float32 [m]
        Of the water.
    since : device array of shape (ny, nx), int32
        See `mark`.
    holds : device array of shape (ny, nx), float32 [m]
        Depth of a full film.
    weights : device array of shape (n,), float64
        See `blur_weights`.
    share_out : device array of shape (ny, nx), float32
    """
    j, i, is_there = _cell(window)
    if not is_there:
        return
    total = 0.0
    for k in range(len(weights) - 1, -len(weights), -1):
        row = mirrored(j + k, depth.shape[0])
        share = np.float32(1)
        if since[row, i] <= window[STEP]:
            share = min(max(depth[row, i] / holds[row, i], np.float32(0)), share)
        total += weights[abs(k)] * share
    share_out[j, i] = total


@cuda_kernel
def blur_across(window, share, weights, tracks_out):
    """Write how full the film is, of FULL, from what `blur_down` has written."""
    j, i, is_there = _cell(window)
    if not is_there:
        return
    total = 0.0
    for k in range(len(weights) - 1, -len(weights), -1):
        total += weights[abs(k)] * share[j, mirrored(i + k, share.shape[1])]
    tracks_out[j, i] = np.uint8(np.float32(FULL) * np.float32(total) + np.float32(0.5))


@cuda_kernel
def thin_film(window, tracks, film, ground_out):
    """Thin the film of the ground under tracks; see `rainsim.shading.wetness.thin_film`.

    Parameters
    ----------
    window : device array of shape (5,), int64
        See `blur_down`.
    tracks : device array of shape (ny, nx), uint8
    film : device array of shape (ny, nx), float32
        Of ground that no tyre has passed.
    ground_out : device array of shape (ny, nx, 4), float32
        See `rainsim.shading.wetness.ground_wetness`.
    """
    j, i, is_there = _cell(window)
    if is_there:
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
        self._holds = to_device(np.maximum(holds, np.float32(LEAST)).astype(np.float32), stream)
        self._since = to_device(np.where(passed, 0, NEVER).astype(np.int32), stream)
        self._weights = to_device(blur_weights(SHOULDER), stream)
        self._share = to_device(np.ones(passed.shape, np.float32), stream)
        self._tracks = to_device(np.full(passed.shape, FULL, np.uint8), stream)
        self._cells = to_device(np.zeros(0, np.int64), stream)
        self._now, self._queues = FrameUniforms(stream, {"window": ((5,), np.int64)}), {}
        ny, nx = passed.shape
        self._grid = (-(-nx // BLOCK[0]), -(-ny // BLOCK[1])), BLOCK

    def mark(self, rows, columns, step):
        """Queue that tyres pass cells in a step."""
        count = len(rows)
        if count > len(self._cells):
            self._stream.synchronize()
            self._cells = to_device(np.zeros(2 * count, np.int64), self._stream)
        self._staging.send(self._cells[:count], rows * self._shape[1] + columns)
        mark[-(-count // THREADS), THREADS, self._stream](self._cells, count, step, self._since)

    def _set(self, window, step):
        rows, columns = (s.indices(n)[:2] for s, n in zip(window, self._shape, strict=True))
        self._now.update(window=(rows[0], columns[0], rows[1], columns[1], step))

    def _lay(self, depth, stream):
        """Queue the finding of the tracks in a window that was set."""
        self._now.send(stream)
        window = self._now["window"]
        blur_down[*self._grid, stream](
            window, depth, self._since, self._holds, self._weights, self._share
        )
        blur_across[*self._grid, stream](window, self._share, self._weights, self._tracks)

    def thin(self, window, depth, step, film, ground_out, stream):
        """Queue the thinning of the film under the tracks of a step; see `thin_film`.

        Parameters
        ----------
        window : tuple of slice
            Rows and columns about all that tyres have passed.
        depth : device array of shape (ny, nx), float32 [m]
            Of the step's water; one of two arrays.
        step : int
        film, ground_out : device array
            The same for each step.
        stream : numba.cuda.stream
        """

        def queue():
            self._lay(depth, stream)
            thin_film[*self._grid, stream](self._now["window"], self._tracks, film, ground_out)

        key = tuple(map(id, (depth, film, ground_out, stream)))
        if key not in self._queues:
            self._queues[key] = Repeated(stream, queue)
        self._set(window, step)
        self._queues[key].launch()

    def fetch(self, window, depth, step):
        """Return the tracks of a step on the host, see `Tyres.tracks`; waits for the device."""
        cuda.synchronize()  # another stream may use the same arrays
        self._set(window, step)
        self._lay(depth, self._stream)
        return fetch(self._tracks, self._stream)
