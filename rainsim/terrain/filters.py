"""Filters of scipy.ndimage for maps, on several threads and equal to scipy's but for rounding.

A map is filtered in bands of rows that its shape alone decides, each with the rows that bear on it.
"""

import numpy as np
from scipy import ndimage

from rainsim.numerics.blocks import in_blocks

BAND = 1 << 18  # cells of a band, about; and so many times the rows that bear on one, at least
LEAST = 4
REACH = 4.0  # deviations that a Gaussian filter reaches


def gaussian_filter(values, sigma):
    """Return `values` (ny, nx) blurred by a Gaussian of `sigma` cells, see scipy.ndimage."""
    return _in_bands(ndimage.gaussian_filter, values, int(REACH * sigma) + 1, sigma)


def uniform_filter(values, size):
    """Return the means of `values` (ny, nx) over squares of `size` cells, see scipy.ndimage."""
    return _in_bands(ndimage.uniform_filter, values, size, size)


def minimum_filter(values, size):
    """Return the minima of `values` (ny, nx) over squares of `size` cells, see scipy.ndimage."""
    return _in_bands(ndimage.minimum_filter, values, size, size)


def maximum_filter(values, size):
    """Return the maxima of `values` (ny, nx) over squares of `size` cells, see scipy.ndimage."""
    return _in_bands(ndimage.maximum_filter, values, size, size)


def grey_opening(values, size):
    """Return the minima of `values` (ny, nx) over squares of `size` cells, then their maxima."""
    return _in_bands(ndimage.grey_opening, values, 2 * size, size)


def median_filter(values):
    """Return the median of `values` (ny, nx) over squares of 3 x 3 cells, see scipy.ndimage."""
    return _in_bands(ndimage.median_filter, values, 1, 3)


def distance(mask, most):
    """Return how far off [cells] the nearest cell is at which `mask` (ny, nx) is false, float64.

    Exact up to `most`; what is farther is farther than that here, too.
    """

    def away(near):
        far = np.full(near.shape, np.inf)
        return far if near.all() else ndimage.distance_transform_edt(near)

    return _in_bands(away, mask, int(most) + 1, kind=np.float64)


def _in_bands(function, values, reach, *arguments, kind=None):
    """Return what a function makes of `values`, whose rows bear on those within a `reach`."""
    out = np.empty(values.shape, kind or values.dtype)

    def work(part):
        start = max(part.start - reach, 0)
        found = function(values[start : part.stop + reach], *arguments)
        out[part] = found[part.start - start :][: len(out[part])]

    in_blocks(work, len(values), max(LEAST * reach, BAND // values.shape[1]))
    return out
