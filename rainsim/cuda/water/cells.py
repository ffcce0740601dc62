"""Some cells of the water on a CUDA device, read by the host together and written back together."""

from __future__ import annotations

import numpy as np

from rainsim.cuda.driver import Staging, fetch, to_device
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.water.step_control import DRAINED, DROPPED, PARITY

THREADS = 8 if SIMULATED else 128
# Rows of a table of cells: depth [m], face velocities [m/s], remainder and film [m], drops that
# wait in `step_control.UNIT`; and how many.
DEPTH, U, V, REMAINDER, FILM, WAITING, NUMBERS = range(7)


@cuda_kernel
def read_cells(cells, count, state, w, remainder, film, waiting, table_out):
    """Copy the numbers of some cells into a table.

    cells : int64 device array (room,). Their places.
    count : int
    state : device array. See `step_control`.
    w, remainder, film : device arrays, float32. As `flow.step` has them.
    waiting : device array, int64. As `step_control.take_in` has it.
    table_out : float64 device array (NUMBERS, room)
    """
    n = cuda.grid(1)
    if n < count:
        at, plane = cells[n], remainder.shape[0]
        here = 3 * state[PARITY] * plane + at
        for k in range(3):
            table_out[DEPTH + k, n] = w[here + k * plane]
        table_out[REMAINDER, n], table_out[FILM, n] = remainder[at], film[at]
        table_out[WAITING, n] = waiting[at]


@cuda_kernel
def write_cells(
    cells, count, table, dropped, taken, state, control_out, w_out, remainder_out, film_out,
    waiting_out,
):  # fmt: skip
    """Copy a table back to the cells that `read_cells` read, and book what changed.

    cells, count, state. As `read_cells` takes them.
    table : float64 device array (NUMBERS, room)
    dropped, taken : float [m]. Depths of drops that no longer wait, and of water
        taken, summed over the cells.
    control_out, w_out, remainder_out, film_out, waiting_out : device arrays
    """
    n = cuda.grid(1)
    if n == 0:
        control_out[DROPPED] += dropped
        control_out[DRAINED] += taken
    if n < count:
        at, plane = cells[n], remainder_out.shape[0]
        here = 3 * state[PARITY] * plane + at
        for k in range(3):
            w_out[here + k * plane] = table[DEPTH + k, n]
        remainder_out[at], film_out[at] = table[REMAINDER, n], table[FILM, n]
        waiting_out[at] = np.int64(table[WAITING, n])


class Cells:
    """Some cells of a `Water`, each named once.

    water : rainsim.cuda.grid.Water
    room : int. Cells that there is room for at first.
    places : int64 array (cells,). See `Water.places`.
    on_device : int64 device array (room,). The same.
    """

    def __init__(self, water, room):
        self._water, self.places = water, np.zeros(0, np.int64)
        self._staging = Staging(water.stream)
        self._make_room(room)

    def _make_room(self, room):
        stream = self._water.stream
        self.on_device = to_device(np.zeros(room, np.int64), stream)
        self._table = to_device(np.zeros((NUMBERS, room)), stream)

    def choose(self, places):
        """Take other cells."""
        stream, count = self._water.stream, len(places)
        if count > len(self.on_device):
            stream.synchronize()
            self._make_room(2 * count)
        self._staging.send(self.on_device[:count], places)
        self.places = places

    def grid(self):
        """Return the launch of a thread for each cell: blocks, threads and stream."""
        return -(-len(self.places) // THREADS), THREADS, self._water.stream

    def read(self):
        """Return the table of the cells, ndarray of shape (NUMBERS, cells), float64; waits."""
        water, count = self._water, len(self.places)
        read_cells[self.grid()](
            self.on_device, count, water.account.state, *water.arrays, water.waiting, self._table
        )
        return fetch(self._table, water.stream)[:, :count]

    def write(self, values, dropped=0.0, taken=0.0):
        """Write a table that `read` returned back; see `write_cells`."""
        water, count = self._water, len(self.places)
        self._staging.send(self._table, values, (slice(0, NUMBERS), slice(0, count)))
        write_cells[self.grid()](
            self.on_device, count, self._table, dropped, taken, water.account.state,
            water.account.control, *water.arrays, water.waiting,
        )  # fmt: skip
