"""Water in the air that comes down at known times, around known cells."""

from __future__ import annotations

import numpy as np

END, OWN = 0, 4  # columns of a table of landings


class Landings:
    """Water that is still to come down.

    A table of it has a row for each part: end [s], row and column of the cell in the middle, which
    may lie beside the map, volume, and the account's part of that [m3].
    """

    def __init__(self):
        # Tables, the order in which their rows come down, how many of them have, and for each row
        # in that order the account's part of it and of those that follow.
        self._tables = []

    def add(self, table):
        """Add a table, ndarray of shape (n, 5), float64."""
        order = table[:, END].argsort(kind="stable")
        rest = table[order[::-1], OWN].cumsum()[::-1]
        self._tables.append((table, order, 0, rest))

    def due(self, time):
        """Take out and return what comes down before a time [s], a table in the order of `add`."""
        down, left = [np.zeros((0, 5))], []
        for table, order, done, rest in self._tables:
            end = int(np.searchsorted(table[:, END], time, sorter=order))
            if end > done:
                down.append(table[np.sort(order[done:end])])
            if end < len(table):
                left.append((table, order, max(end, done), rest))
        self._tables = left
        return np.concatenate(down)

    @property
    def own(self):
        """Volume [m3] of the account that is still to come down."""
        return sum(float(rest[done]) for *_, done, rest in self._tables)
