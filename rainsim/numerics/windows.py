"""Windows of maps: rows and columns, a tuple of two slices."""

import numpy as np


def window_of(mask):
    """Return the smallest window with all cells of a mask (ny, nx); None if it has none."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def widened(window, margin, shape):
    """Return a window with a margin of cells around it, on a map of a shape, and itself in that."""
    wide = tuple(
        slice(max(s.start - margin, 0), min(s.stop + margin, n))
        for s, n in zip(window, shape, strict=True)
    )
    inner = (slice(s.start - w.start, s.stop - w.start) for s, w in zip(window, wide, strict=True))
    return wide, tuple(inner)


def placed(inner, wide):
    """Return a window of a window of a map as one of the map."""
    return tuple(
        slice(s.start + w.start, s.stop + w.start) for s, w in zip(inner, wide, strict=True)
    )
