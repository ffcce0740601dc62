"""The water over time of all who look at one scene: simulated once, kept as far as memory goes."""

import numpy as np

KEPT_BYTES = 256e6  # of states; those first forgotten that were asked for longest ago


class SharedWater:
    """States of one simulation by their index, simulated as they are asked for.

    simulate : callable. simulate(terrain, config) yields the states from the
        first on.
    most : float. Bytes of states that are kept; the first state and the last one
        always are.
    """

    def __init__(self, simulate, most=KEPT_BYTES):
        self._simulate, self._most = simulate, most
        self._terrain = self._config = self._states = None
        self.restart(None, None)

    def restart(self, terrain, config):
        """Forget all states; simulate with these from now on."""
        self._terrain, self._config = terrain, config
        self._states, self._next, self._kept = None, 0, {}

    @property
    def indices(self):
        """Indices of the kept states, in rising order."""
        return sorted(self._kept)

    def state(self, index, check=lambda: None):
        """Return the `SimState` number `index`, simulated up to it; `check` may end each step."""
        if index in self._kept:
            self._kept[index] = self._kept.pop(index)  # now the last that is forgotten
            return self._kept[index]
        if self._states is None or index < self._next:
            self._states, self._next = self._simulate(self._terrain, self._config), 0
        while self._next <= index:
            check()
            state = next(self._states)
            self._next += 1
            self._keep(state)
        return self._kept[index]

    def _keep(self, state):
        self._kept.pop(state.index, None)
        self._kept[state.index] = state
        size = _bytes_of(state)
        while len(self._kept) > 2 and len(self._kept) * size > self._most:
            oldest = next(index for index in self._kept if index != 0)
            if oldest == state.index:
                return
            del self._kept[oldest]

    def depths_at(self, row, column):
        """Return times [s] and water depths [m] (n,) of a cell, over the kept states."""
        states = [self._kept[index] for index in self.indices]
        times = np.array([state.time for state in states])
        return times, np.array([state.depth[row, column] for state in states], np.float64)


def _bytes_of(state):
    """Return the bytes of a state's arrays."""
    arrays = (value for value in vars(state).values() if isinstance(value, np.ndarray))
    return sum(array.nbytes for array in arrays)
