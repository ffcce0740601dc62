"""Cells of a map that have no height: walls, or a rim over which water leaves."""

import numpy as np
from scipy.ndimage import binary_dilation, grey_erosion

from rainsim.errors import ParameterError
from rainsim.water.inputs import EDGES

ABOVE = 100.0  # m, and the relief of the map, that a wall stands above its highest cell
RATE = 1e9  # m3/s that a cell of an open rim takes: all that reaches it


def without_nodata(bed, way):
    """Return the bed with heights in all cells, which had none, and the drains of an open rim.

    Where water leaves, it falls into a cell beside the map that is as low as its lowest neighbour,
    and is drained there.

    way : {"closed", "open"}. Whether cells without a height are walls, or let the
        water go that reaches them.
    Returns bed : array (ny, nx) [m]
        absent : bool array (ny, nx)
        drains : list of (row, column, rate [m3/s])
    """
    absent = np.isnan(bed)
    if absent.all():
        raise ParameterError("the bed has no cell with a height; all are nodata; check the file")
    lowest, highest = np.nanmin(bed), np.nanmax(bed)
    filled = np.where(absent, 2 * highest - lowest + ABOVE, bed)
    if way == "closed" or not absent.any():
        return filled, absent, []
    sides = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], bool)
    rim = absent & binary_dilation(~absent, sides)
    filled[rim] = grey_erosion(np.where(absent, highest, bed), footprint=sides, mode="nearest")[rim]
    return filled, absent, [(row, column, RATE) for row, column in np.argwhere(rim).tolist()]


def require_heights(absent, edge, span, what):
    """Raise ParameterError if cells of an edge on which something is given have no height."""
    if edge not in EDGES:
        return  # the solver refuses it
    cells = {"west": absent[:, 0], "east": absent[:, -1], "south": absent[0], "north": absent[-1]}
    cells = cells[edge][slice(*(span or (None,)))]
    if cells.any():
        raise ParameterError(
            f"{what} at {edge} has {len(cells)} cells, {int(cells.sum())} of them nodata; give the "
            f"cells that have a height, as in {edge}:8:12"
        )
