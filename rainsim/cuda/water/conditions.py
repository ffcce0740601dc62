"""Conditions at edges on a CUDA device: the host treats the cells along them.

The functions of `rainsim.water.conditions` act on the fields that the host has, of which a strip
along the conditions is sent before each launch and read after it. The rest of the map stays on the
device.
"""

import numpy as np

from rainsim.cuda.driver import send
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.water.flow import LEAD
from rainsim.water.conserving import PAD
from rainsim.water.inputs import EDGES
from rainsim.water.rows import RUN

THREADS = 8 if SIMULATED else 128
FIRST = "west", "south"  # the edges at which rows and columns begin
# Rows of a table of cells: depth [m], face velocities [m/s], remainder and film [m].
DEPTH, U, V, REMAINDER, FILM = range(5)


@cuda_kernel
def read_cells(places, parity, w, remainder, film, table_out):
    """Copy the numbers of some cells into a table.

    table_out : float32 device array (5, cells). See DEPTH to FILM.
    """
    n = cuda.grid(1)
    if n < len(places):
        at, plane = places[n], len(remainder)
        for k in range(3):
            table_out[DEPTH + k, n] = w[(3 * parity + k) * plane + at]
        table_out[REMAINDER, n], table_out[FILM, n] = remainder[at], film[at]


@cuda_kernel
def write_cells(places, parity, table, w_out, remainder_out):
    """Copy a table back to the cells that `read_cells` read, but for their films."""
    n = cuda.grid(1)
    if n < len(places):
        at, plane = places[n], len(remainder_out)
        for k in range(3):
            w_out[(3 * parity + k) * plane + at] = table[DEPTH + k, n]
        remainder_out[at] = table[REMAINDER, n]


def walls_at(condition, shape, is_open):
    """Return the walls that a condition's cells touch, its own edge last.

    Returns list of (edge, last, near). The row or column [cells] of the last
        cells before the wall, and the slice of the rows or columns near the
        condition.
    """
    (rows, columns), found = condition.at, []
    for edge in sorted(EDGES, key=lambda edge: edge == condition.edge):
        across, along = (columns, rows) if edge in ("west", "east") else (rows, columns)
        last = PAD if edge in FIRST else shape[edge in ("west", "east")] - PAD - 1
        if last in (across[0], across[-1]) and not is_open[edge]:
            found.append((edge, last, slice(along[0] - PAD, along[-1] + 4)))
    return found


class Strip:
    """The cells along conditions, and their ghosts, between a device and its host."""

    def __init__(self, conditions, flow, sources):
        self._flow, self._sources = flow, sources
        marked = np.zeros(flow.bed.shape, bool)
        for condition in conditions:  # the cells, their ghosts, the cells behind them
            rows, columns = condition.at
            marked[rows[0] - PAD : rows[-1] + 3, columns[0] - PAD : columns[-1] + 3] = True
        self._at = np.nonzero(marked)
        rows, columns = self._at
        self._places = cuda.to_device(rows * flow.layout.pitch + columns + LEAD)
        self._blocks, shape = -(-len(rows) // THREADS), (FILM + 1, len(rows))
        self._values = np.zeros(shape, np.float32)
        self._table = cuda.to_device(self._values)
        wide = RUN - 1
        runs = [
            (c.at[0][0], c.at[0][-1] + 1, west, min(west + wide, c.at[1][-1] + 1))
            for c in conditions for west in range(c.at[1][0], c.at[1][-1] + 1, wide)
        ]  # fmt: skip
        self._tiles, count = np.array(runs, np.int64), np.arange(len(runs))[:, None]
        self._runs = np.hstack([self._tiles, count, count + 1])
        self._walls = [wall for c in conditions for wall in walls_at(c, marked.shape, flow.is_open)]

    def speeds(self, dt, pressure_time):
        """Return the fastest wave and face [m/s] that a step makes in the conditions' cells."""
        with self._flow.by_strip():
            return self._flow.speeds_of(dt, pressure_time, self._runs, self._tiles)

    def send(self):
        """Write the strip to the device, with what comes in through its faces."""
        flow = self._flow
        with flow.by_strip():
            self._mirror()
            flow._set_entries()
            h, remainder, u, v = flow.water
        for k, field in ((DEPTH, h), (U, u), (V, v), (REMAINDER, remainder)):
            self._values[k] = field[self._at]
        send(self._table, self._values)
        write_cells[self._blocks, THREADS](
            self._places, flow.parity, self._table, flow.fields, flow.remainder
        )

    def receive(self):
        """Read the strip."""
        flow, sources = self._flow, self._sources
        read_cells[self._blocks, THREADS](
            self._places, flow.parity, flow.fields, flow.remainder, sources.film_there, self._table
        )
        values = self._table.copy_to_host()
        with flow.by_strip():
            h, remainder, u, v = flow.water
            film = sources.film
        for k, field in ((DEPTH, h), (U, u), (V, v), (REMAINDER, remainder), (FILM, film)):
            field[self._at] = values[k]

    def _mirror(self):
        """Mirror the water in the ghosts beyond the conditions, as at all walls of the CPU."""
        h, _, u, v = self._flow.water
        fields = [
            (u, v, h) if edge in ("west", "east") else (v.T, u.T, h.T) for edge, *_ in self._walls
        ]
        for (edge, last, near), (across, *_) in zip(self._walls, fields, strict=True):
            face, out = (last, -1) if edge in FIRST else (last + 1, 1)
            across[near, face], across[near, face + out] = 0, -across[near, face - out]
        for (edge, last, near), (_, *along) in zip(self._walls, fields, strict=True):
            out = -1 if edge in FIRST else 1
            for k in range(1, PAD + 1):
                for field in along:
                    field[near, last + k * out] = field[near, last + (1 - k) * out]
