"""The tiles of a map, and those of them in which water moves."""

import numpy as np

from rainsim.water.conserving import PAD
from rainsim.water.rows import COLUMNS, ROWS, runs_of

STILL_STEPS = 2  # after which both copies of a tile's velocity are zero


class Tiles:
    """Tiles of a map with `PAD` ghost cells around; still ones sleep.

    A tile sleeps when it and its neighbours were still for two steps: then both copies of its
    fields are the same, and a step would change no number.

    all, active : int64 array (tiles, 4). First and last row + 1, first and last
        column + 1 of each tile, of all and of those that take part in steps.
    runs : int64 array (runs, 6). Of the active tiles, see `rows.runs_of`.
    """

    def __init__(self, ny, nx, dtype):
        south, west = np.arange(PAD, ny - PAD, ROWS), np.arange(PAD, nx - PAD, COLUMNS)
        self._shape = len(south), len(west)
        tiles = np.empty((*self._shape, 4), np.int64)
        tiles[..., 0], tiles[..., 2] = south[:, None], west
        tiles[..., 1] = np.minimum(south + ROWS, ny - PAD)[:, None]
        tiles[..., 3] = np.minimum(west + COLUMNS, nx - PAD)
        self.all = tiles.reshape(-1, 4)
        count = len(self.all)
        self._speeds, self.still_steps = np.zeros((2, count), dtype), np.zeros(count, np.int64)
        self._moving = None
        self.wake()

    def wake(self, which=slice(None)):
        """Let the tiles `which` and their neighbours take part in the next steps."""
        self.still_steps[which] = 0
        moving = self.still_steps < STILL_STEPS
        if not np.array_equal(moving, self._moving):
            self._moving = moving
            near = np.pad(moving.reshape(self._shape), 1)
            near = near[:-2] | near[1:-1] | near[2:]
            near = near[:, :-2] | near[:, 1:-1] | near[:, 2:]
            self._active = np.flatnonzero(near)
            self.active = self.all[self._active]
            self.runs = runs_of(self.active, self._active, self._shape[1])

    def wake_wet(self, wet):
        """Wake the tiles with a cell of which `wet`, ndarray of shape (ny, nx) of bool, is true."""
        rows, columns = np.arange(0, wet.shape[0], ROWS), np.arange(0, wet.shape[1], COLUMNS)
        wet = np.logical_or.reduceat(np.logical_or.reduceat(wet, rows, axis=0), columns, axis=1)
        self.wake(wet.reshape(-1))

    def wake_cells(self, rows, columns):
        """Wake the tiles of cells, whose depths have changed."""
        self.wake(rows // ROWS * self._shape[1] + columns // COLUMNS)

    def speeds(self):
        """Return where kernels write the fastest wave and face [m/s] of each active tile."""
        return self._speeds[:, : len(self.active)]

    def let_sleep(self, water_speeds):
        """Take over the fastest faces [m/s] of the active tiles, and let still tiles sleep."""
        still = self.still_steps[self._active] + 1
        self.still_steps[self._active] = np.where(water_speeds > 0, 0, still)
        self.wake(slice(0, 0))

    def restore(self, still_steps):
        """Take over how long each tile has been still."""
        self.still_steps[:] = still_steps
        self.wake(slice(0, 0))
