"""Numbers of the splats of a big capture, which pictures of its chunks name in their hits.

The splats of the finest level are numbered leaf by leaf in the order of the index, those that are
always drawn after them. A splat of a coarser level stands for several. It has the number of the
nearest splat of the finest level in its leaf.
"""

import numpy as np
from scipy.spatial import cKDTree

from rainsim.errors import InputError
from rainsim.scene.pages import ALWAYS, levels_at


class FinestNumbers:
    """The number of each splat of the runs of a capture in chunks; `count` is that of all."""

    def __init__(self, pages):
        self._pages, tree = pages, pages.tree
        self._finest = levels_at(tree, 0)
        counts = tree.count[np.arange(len(self._finest)), self._finest]
        self._first = np.concatenate([[0], np.cumsum(counts)])
        always = len(pages.splats(ALWAYS, 0)) if pages.always else 0
        self.count = int(self._first[-1]) + always

    def of_run(self, leaf, level, splats):
        """Return the numbers of a run's `Splats`, (n,); InputError if it lacks some."""
        if leaf == ALWAYS:
            return np.arange(self._first[-1], self.count, dtype=np.int32)
        finest = int(self._finest[leaf])
        first, count = int(self._first[leaf]), int(self._first[leaf + 1] - self._first[leaf])
        own = splats if level == finest else self._pages.splats(leaf, finest)
        if len(own) != count:
            raise InputError(
                f"a leaf of {self._pages.tree.folder} has {count - len(own)} splats with absurd "
                "values, without which its splats cannot be numbered; export the capture again"
            )
        if level == finest:
            return np.arange(first, first + count, dtype=np.int32)
        near = cKDTree(own.position).query(splats.position)[1]
        return (first + near).astype(np.int32)

    def runs(self):
        """Yield the numbers of each leaf's splats, then those of the splats always drawn."""
        for first, end in zip(self._first, [*self._first[1:], self.count], strict=True):
            if end > first:
                yield np.arange(first, end)

    def positions(self, numbers):
        """Return the positions (n, 3) [capture units], float32, of splats by their numbers."""
        numbers = np.asarray(numbers)
        found = np.empty((len(numbers), 3), np.float32)
        leaf = np.searchsorted(self._first[1:], numbers, side="right")
        for n in np.unique(leaf):
            mine, always = leaf == n, n == len(self._finest)
            run = (ALWAYS, 0) if always else (int(n), int(self._finest[n]))
            found[mine] = self._pages.splats(*run).position[numbers[mine] - self._first[n]]
        return found
